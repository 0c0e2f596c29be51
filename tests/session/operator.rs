//! The agent at an operator's hand against the stand-in server.

use super::Stand;
use std::path::Path;
use std::time::Duration;
use tokio::sync::mpsc;
use usar_agent::driver::host::Host;
use usar_agent::driver::live::Live;
use usar_agent::driver::replay::Replay;
use usar_agent::files::scenario::load;
use usar_agent::link::{Backoff, SessionClock, connect};
use usar_agent::mission::{Agent, Event, Mode, OperatorEvent, Outcome};
use usar_agent::protocol::Dialect;
use usar_agent::record::{Header, Writer, read};

/// What became of an agent in teleop whose operator held a key down.
struct Held {
    agent: Agent,
    recording: Vec<u8>,
}

/// Holds a key that drives at `linear_mps` and turns at `angular_rps` for all of a session of `seconds`
/// against the stand-in.
async fn hold_a_key(linear_mps: f64, angular_rps: f64, seconds: f64) -> Held {
    let mut loaded = load(Path::new("box"), &[]).unwrap();
    loaded.agent.mission.mode = Mode::Teleop;
    loaded.agent.mission.time_limit_s = seconds;
    loaded.agent.opening.listen_s = 0.3;
    let stand = Stand::of("box", Dialect::Ut2004);
    let address = stand.address.to_string();

    let clock = SessionClock::start();
    let link = connect(&address, &Backoff::once(), clock).await.unwrap();
    let header = Header {
        config: toml::to_string(&loaded.agent).unwrap(),
        placement: loaded.placement.clone(),
        ..Header::default()
    };
    let agent = Agent::new(loaded.agent.clone(), loaded.placement.clone());
    let mut host = Host::new(agent, Some(Writer::new(Vec::new(), &header).unwrap()));
    let (inputs, received) = mpsc::channel(64);
    let presses = (10.0 * seconds) as u32;
    let hand = tokio::spawn(async move {
        for _ in 0..presses {
            tokio::time::sleep(Duration::from_millis(100)).await;
            let drive = OperatorEvent::Drive { linear_mps, angular_rps };
            if inputs.send((clock.now(), Event::Operator(drive))).await.is_err() {
                break;
            }
        }
    });
    let live = Live::new(&mut host, clock, &address, Backoff::once(), received, |_, _| {});
    live.run(link).await.unwrap();
    hand.await.unwrap();
    drop(stand);

    let (agent, bytes) = host.finish().unwrap();
    assert_eq!(agent.outcome(), Some(&Outcome::Time));
    Held { agent, recording: bytes.unwrap() }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_operator_drives_over_tcp_and_the_session_replays() {
    let Held { agent, recording } = hold_a_key(0.0, 0.6, 5.0).await;
    let turned_rad = agent.running().unwrap().belief().world_from_robot().rotation.angle();
    assert!(turned_rad > 0.1, "the operator turned the robot: {turned_rad} rad");
    let recording = read(&recording).unwrap();
    let config = toml::from_str(&recording.header.config).unwrap();
    let again = Agent::new(config, recording.header.placement.clone());
    let mut replay = Replay::new(again, &recording);
    while replay.step().unwrap() {}
    let (again, _, difference) = replay.finish();
    assert_eq!(difference, None);
    assert_eq!(postcard::to_stdvec(&again).unwrap(), postcard::to_stdvec(&agent).unwrap());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_held_key_drives_ahead_over_floor_that_no_sweep_has_measured() {
    // The key is down from the first moment on, so that the sweep at the start is dropped and the
    // guard line knows the floor's height from the class alone.
    let Held { agent, .. } = hold_a_key(0.4, 0.0, 14.0).await;
    let running = agent.running().unwrap();
    let way_m = running.belief().path_m();
    assert!(way_m > 1.0, "{way_m:.2} m");
    let told: Vec<&str> = agent.journal().since(0).iter().map(|note| note.text.as_str()).collect();
    assert!(told.iter().any(|text| text.contains("the head is still turning")), "{told:?}");
}

/// Nothing looks behind: there the robot goes over ground that was seen or its own track only.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_held_key_does_not_drive_back_over_ground_that_nothing_has_seen() {
    let Held { agent, .. } = hold_a_key(-0.3, 0.0, 5.0).await;
    let way_m = agent.running().unwrap().belief().path_m();
    assert!(way_m < 0.1, "{way_m:.2} m");
    let notes = agent.journal().since(0);
    assert!(notes.iter().any(|note| note.text.contains("neither seen nor driven over")));
}
