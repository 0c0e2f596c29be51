//! The agent against the stand-in over TCP.

use std::path::Path;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};
use usar_agent::driver::host::Host;
use usar_agent::driver::live::Live;
use usar_agent::driver::replay::Replay;
use usar_agent::files::scenario::load;
use usar_agent::link::{Backoff, SessionClock, connect};
use usar_agent::mission::{Agent, Event, Mode, OperatorEvent, Outcome};
use usar_agent::record::{Header, Writer, read};
use usar_agent::sim::Session;
use usar_agent::sim::server::Server;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_operator_drives_over_tcp_and_the_session_replays() {
    let mut loaded = load(Path::new("box"), &[]).unwrap();
    loaded.agent.mission.mode = Mode::Teleop;
    loaded.agent.mission.time_limit_s = 5.0;
    loaded.agent.opening.listen_s = 0.3;
    let files = &loaded.files;
    let session = Session::new(&files.world, &files.scenario, &files.catalogue).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let (stop, stopped) = oneshot::channel::<()>();
    let server = tokio::spawn(Server::new(session, listener, 4.0).run(async {
        stopped.await.ok();
    }));

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
    let hand = tokio::spawn(async move {
        // As a held key: a press every 100 ms, until the robot has driven a while.
        for _ in 0..45 {
            tokio::time::sleep(Duration::from_millis(100)).await;
            let ahead = OperatorEvent::Drive { linear_mps: -0.3, angular_rps: 0.0 };
            if inputs.send((clock.now(), Event::Operator(ahead))).await.is_err() {
                break;
            }
        }
    });
    let live = Live::new(&mut host, clock, &address, Backoff::once(), received, |_, _| {});
    live.run(link).await.unwrap();
    hand.await.unwrap();
    stop.send(()).ok();
    server.await.unwrap();

    let (agent, bytes) = host.finish().unwrap();
    assert_eq!(agent.outcome(), Some(&Outcome::Time));
    assert!(agent.running().unwrap().belief().path_m() > 0.05, "the operator moved the robot");
    let recording = read(&bytes.unwrap()).unwrap();
    let config = toml::from_str(&recording.header.config).unwrap();
    let again = Agent::new(config, recording.header.placement.clone());
    let mut replay = Replay::new(again, &recording);
    while replay.step().unwrap() {}
    let (again, _, difference) = replay.finish();
    assert_eq!(difference, None);
    assert_eq!(postcard::to_stdvec(&again).unwrap(), postcard::to_stdvec(&agent).unwrap());
}
