//! The real agent through the real live driver against scripts.

use super::{ScriptedServer, Transcript};
use std::io::{self, Write};
use tokio::sync::mpsc;
use usar_agent::driver::host::Host;
use usar_agent::driver::live::{Live, LiveError};
use usar_agent::driver::replay::Replay;
use usar_agent::link::{Backoff, SessionClock, connect};
use usar_agent::mission::{Agent, AgentConfig, Event, Mode, OperatorEvent, Outcome, Placement};
use usar_agent::record::{Header, Recording, What, Writer, read};
use usar_agent::time::{Arrival, Span};

type Inputs = mpsc::Sender<(Arrival, Event)>;

/// What is left of a run.
struct Run {
    agent: Agent,
    transcript: Transcript,
    recording: Recording,
}

/// Short waits; everything else as it is.
fn config() -> AgentConfig {
    let mut config = AgentConfig::default();
    config.opening.listen_s = 0.15;
    config.opening.answer_timeout_s = 0.3;
    config.opening.sta_timeout_s = 0.4;
    config.mission.settle_s = 0.0;
    config.mission.time_limit_s = 2.5;
    config
}

fn header(config: &AgentConfig) -> Header {
    Header { config: toml::to_string(config).unwrap(), ..Header::default() }
}

fn quick() -> Backoff {
    Backoff { attempts: 3, first_wait_ms: 20, max_wait_ms: 50, attempt_limit_ms: 1000 }
}

/// Runs an agent against a script while `act` does what an operator would.
async fn run<F: Future<Output = ()>>(
    script: &str,
    config: AgentConfig,
    act: impl FnOnce(Inputs, SessionClock) -> F,
) -> Run {
    let (host, transcript, ended) = run_with(script, config, Vec::new(), act).await;
    ended.unwrap();
    let (agent, bytes) = host.finish().unwrap();
    let recording = read(&bytes.unwrap()).unwrap();
    Run { agent, transcript, recording }
}

async fn run_with<W: Write, F: Future<Output = ()>>(
    script: &str,
    config: AgentConfig,
    sink: W,
    act: impl FnOnce(Inputs, SessionClock) -> F,
) -> (Host<W>, Transcript, Result<(), LiveError>) {
    let server = ScriptedServer::start(script).await;
    let clock = SessionClock::start();
    let link = connect(&server.address, &quick(), clock).await.unwrap();
    let recorder = Writer::new(sink, &header(&config)).unwrap();
    let mut host = Host::new(Agent::new(config, Placement::FirstStart), Some(recorder));
    let (inputs, received) = mpsc::channel(64);
    let live = Live::new(&mut host, clock, &server.address, quick(), received, |_, _| {});
    let (ended, ()) = tokio::join!(live.run(link), act(inputs, clock));
    (host, server.finish().await, ended)
}

async fn nobody(_: Inputs, _: SessionClock) {}

/// Replays a recording; panics at the first difference.
fn verified(recording: &Recording) {
    let config = toml::from_str(&recording.header.config).unwrap();
    let agent = Agent::new(config, recording.header.placement.clone());
    let mut replay = Replay::new(agent, recording);
    while replay.step().unwrap() {}
    let (_, _, difference) = replay.finish();
    assert_eq!(difference, None);
}

const STOP: &str = "DRIVE {Left 0.0} {Right 0.0} {Normalized false}";

#[tokio::test]
async fn a_happy_session_is_opened_scanned_stopped_and_replays() {
    let run = run("agent_session", config(), nobody).await;
    assert_eq!(run.agent.outcome(), Some(&Outcome::Time));
    assert_eq!(run.agent.level(), Some("DM-test_250"));
    assert_eq!(run.agent.tally().problems.len(), 0);
    let transcript = &run.transcript;
    assert_eq!(transcript.with_verb("INIT").len(), 1);
    assert!(transcript.with_verb("INIT")[0].contains("{Location 4.5,1.9,1.8}"));
    assert!(!transcript.with_verb("MISPKG").is_empty(), "the tilt was never moved");
    assert_eq!(transcript.lines.last().map(String::as_str), Some(STOP));
    verified(&run.recording);
}

#[tokio::test]
async fn a_server_without_a_status_line_has_no_robot() {
    let run = run("silent_server", config(), nobody).await;
    let Some(Outcome::NoRobot(reason)) = run.agent.outcome() else {
        panic!("{:?}", run.agent.outcome())
    };
    assert!(reason.contains("no STA"), "{reason}");
    verified(&run.recording);
}

#[tokio::test]
async fn unanswered_questions_time_out_one_by_one_and_the_class_table_steps_in() {
    let mut config = config();
    config.mission.time_limit_s = 5.5;
    let waits = Span::from_seconds(config.opening.answer_timeout_s);
    let run = run("agent_unanswered", config, nobody).await;
    assert!(run.agent.running().is_some(), "{:?}", run.agent.outcome());
    let warnings = run.agent.warnings().join("\n");
    for question in [
        "GETGEO Robot",
        "GETCONF Robot",
        "GETGEO RangeScanner",
        "GETCONF RangeScanner Scanner1",
        "GETGEO MisPkg",
        "GETCONF MisPkg CameraPanTilt",
    ] {
        assert!(
            warnings.contains(&format!("{question} was not answered: supposing")),
            "{warnings}"
        );
    }
    let asked: Vec<Arrival> = run
        .recording
        .entries
        .iter()
        .filter(|entry| {
            let question =
                |line: &[u8]| line.starts_with(b"GETGEO") || line.starts_with(b"GETCONF");
            matches!(&entry.what, What::Sent(line) if question(line))
        })
        .map(|entry| entry.arrival)
        .collect();
    assert!(asked.len() >= 6, "{asked:?}");
    // A server that answers one question at a time may still be at the one before.
    assert!(asked.windows(2).all(|pair| pair[1] >= pair[0] + waits), "{asked:?}");
    verified(&run.recording);
}

#[tokio::test]
async fn broken_lines_are_counted_and_the_mission_goes_on() {
    let run = run("agent_broken_lines", config(), nobody).await;
    assert_eq!(run.agent.outcome(), Some(&Outcome::Time));
    assert!(run.agent.running().is_some());
    assert!(run.agent.tally().problems.values().sum::<usize>() > 30);
    let tally = run.agent.tally();
    assert!(tally.quoted.len() <= 3 && tally.damaged > 20 && tally.damaged < tally.lines);
    let warned = run.agent.warnings().iter().filter(|text| text.contains("were damaged"));
    assert_eq!(warned.count(), 1, "{:?}", run.agent.warnings());
    verified(&run.recording);
}

#[tokio::test]
async fn a_connection_lost_in_mid_sweep_is_taken_up_again_where_the_robot_was() {
    let config = {
        let mut config = config();
        config.mission.time_limit_s = 4.0;
        config
    };
    let run = run("agent_disconnect_in_mid_sweep", config, nobody).await;
    assert_eq!(run.agent.outcome(), Some(&Outcome::Time));
    assert_eq!(run.transcript.connections, 2);
    let inits = run.transcript.with_verb("INIT");
    // The same place, raised a little so that the new robot does not begin inside the floor.
    assert!(inits[1].contains("{Location 4.5,1.9,1.75}"), "{inits:?}");
    let lines = &run.transcript.lines;
    let swept = lines.iter().position(|line| line.starts_with("MISPKG"));
    let again = lines.iter().rposition(|line| line.starts_with("INIT"));
    assert!(swept.is_some() && swept < again, "no sweep had begun");
    let count = |is: fn(&What) -> bool| {
        run.recording.entries.iter().filter(|entry| is(&entry.what)).count()
    };
    assert_eq!(count(|what| matches!(what, What::Connected)), 2);
    assert_eq!(count(|what| matches!(what, What::Disconnected(_))), 1);
    assert!(run.agent.running().is_some());
    verified(&run.recording);
}

#[tokio::test]
async fn a_connection_lost_for_good_ends_the_mission_after_its_time() {
    let mut config = config();
    config.mission.time_limit_s = 20.0;
    config.mission.reconnect_s = 0.5;
    let run = run("agent_dropped_for_good", config, nobody).await;
    assert!(matches!(run.agent.outcome(), Some(Outcome::LinkLost(_))), "{:?}", run.agent.outcome());
    assert!(run.agent.running().is_some(), "what was believed is kept");
    verified(&run.recording);
}

#[tokio::test]
async fn the_request_to_end_stops_the_wheels() {
    let mut config = config();
    config.mission.time_limit_s = 20.0;
    let run = run("agent_session", config, |inputs, clock| async move {
        tokio::time::sleep(std::time::Duration::from_millis(1500)).await;
        inputs.send((clock.now(), Event::End("interrupted".into()))).await.unwrap();
    })
    .await;
    assert_eq!(run.agent.outcome(), Some(&Outcome::Stopped("interrupted".into())));
    assert_eq!(run.transcript.lines.last().map(String::as_str), Some(STOP));
    verified(&run.recording);
}

#[tokio::test]
async fn a_drive_command_that_is_not_renewed_stops_within_its_lease() {
    let mut config = config();
    config.mission.mode = Mode::Teleop;
    config.mission.time_limit_s = 3.0;
    let run = run("agent_session", config, |inputs, clock| async move {
        tokio::time::sleep(std::time::Duration::from_millis(1500)).await;
        let turn = OperatorEvent::Drive { linear_mps: 0.0, angular_rps: 0.4 };
        inputs.send((clock.now(), Event::Operator(turn))).await.unwrap();
    })
    .await;
    assert_eq!((run.agent.operator_acts(), run.agent.outcome()), (1, Some(&Outcome::Time)));
    // From the recording, not from the wall clock: the line that turns, then the stop.
    let entries = &run.recording.entries;
    let drives: Vec<(usize, String)> = entries
        .iter()
        .enumerate()
        .filter_map(|(at, entry)| match &entry.what {
            What::Sent(line) if line.starts_with(b"DRIVE") => {
                Some((at, String::from_utf8_lossy(line).trim_end().to_owned()))
            }
            _ => None,
        })
        .collect();
    let turning = drives.iter().position(|(_, line)| line != STOP).expect("it never turned");
    let (turned, _) = drives[turning];
    let (stopped, line) = &drives[turning + 1];
    assert_eq!(line, STOP);
    let ends = entries[turned].arrival + Span::from_millis(300);
    assert!(entries[*stopped].arrival >= ends);
    // The first event after the lease's end is the one that stops the wheels.
    let late = entries[turned..*stopped].iter().filter(|entry| entry.arrival >= ends).count();
    assert_eq!(late, 1, "{:?}", &entries[turned..=*stopped]);
    verified(&run.recording);
}

/// A sink that takes so many writes and then fails, as a full disk does.
struct FullDisk(usize);

impl Write for FullDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.0.checked_sub(1) {
            Some(left) => self.0 = left,
            None => return Err(io::Error::new(io::ErrorKind::StorageFull, "no space left")),
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[tokio::test]
async fn a_recording_that_cannot_be_written_stops_the_wheels_and_is_told() {
    let mut config = config();
    config.mission.time_limit_s = 20.0;
    // The magic and the header fit, the first block of entries does not.
    let (_, transcript, ended) = run_with("agent_session", config, FullDisk(2), nobody).await;
    let error = ended.unwrap_err().to_string();
    assert!(error.contains("recording") && error.contains("no space left"), "{error}");
    assert_eq!(transcript.lines.last().map(String::as_str), Some(STOP));
}

#[tokio::test]
async fn a_panic_stops_the_wheels_and_is_passed_on() {
    let server = ScriptedServer::start("agent_session").await;
    let address = server.address.clone();
    let run = tokio::spawn(async move {
        let clock = SessionClock::start();
        let link = connect(&address, &quick(), clock).await.unwrap();
        let mut host: Host<Vec<u8>> = Host::new(Agent::new(config(), Placement::FirstStart), None);
        let (_inputs, received) = mpsc::channel(1);
        let watch = |agent: &Agent, _| assert!(!agent.is_in_service(), "a bug of the shell");
        Live::new(&mut host, clock, &address, quick(), received, watch).run(link).await
    });
    assert!(run.await.unwrap_err().is_panic());
    assert_eq!(server.finish().await.lines.last().map(String::as_str), Some(STOP));
}
