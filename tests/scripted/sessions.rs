//! Whole sessions: a client of `link` and `protocol` against scripts.

use super::{ScriptedServer, Transcript};
use std::time::Duration;
use usar_agent::link::{
    Backoff, Incoming, LinkError, LinkReader, LinkWriter, SessionClock, connect,
};
use usar_agent::protocol::command::{Init, Query};
use usar_agent::protocol::message::Nfo;
use usar_agent::protocol::{
    Command, Dialect, Message, Problem, ProblemKind, encode_command, parse,
};

pub use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};

/// A client that does no more than it is told.
pub struct Client {
    pub reader: LinkReader<OwnedReadHalf>,
    pub writer: LinkWriter<OwnedWriteHalf>,
}

/// What a client heard to the end of a connection.
#[derive(Debug, Default)]
pub struct Heard {
    pub messages: Vec<Message>,
    /// Damage in lines that arrived.
    pub problems: Vec<Problem>,
    /// Lines that did not arrive as such.
    pub dropped: Vec<Problem>,
}

impl Client {
    pub async fn connect(address: &str) -> Self {
        let link = connect(address, &Backoff::once(), SessionClock::start()).await;
        let (mut reader, writer) = link.unwrap();
        reader.set_silence_limit(Some(Duration::from_secs(5)));
        Self { reader, writer }
    }

    pub async fn say(&mut self, command: Command) {
        self.writer.send(&encode_command(&command, Dialect::Ut2004)).await.unwrap();
    }

    pub async fn init(&mut self) {
        self.say(Command::Init(Init::at_start("USARBot.P2AT", "R1", "PlayerStart"))).await;
    }

    pub async fn next(&mut self) -> Result<Option<Message>, LinkError> {
        loop {
            match self.reader.next_line().await? {
                Some(Incoming::Line { octets, .. }) => return Ok(Some(parse(&octets).message)),
                Some(Incoming::Dropped { .. }) => {}
                None => return Ok(None),
            }
        }
    }

    pub async fn hear(&mut self) -> Heard {
        let mut heard = Heard::default();
        while let Some(incoming) = self.reader.next_line().await.unwrap() {
            match incoming {
                Incoming::Line { octets, .. } => {
                    let parsed = parse(&octets);
                    heard.messages.push(parsed.message);
                    heard.problems.extend(parsed.problems);
                }
                Incoming::Dropped { problem, .. } => heard.dropped.push(problem),
            }
        }
        heard
    }
}

/// Plays a script against a client that sends INIT and `more` at once, then listens to the end.
pub async fn play(script: &str, more: &[Command]) -> (Heard, Transcript) {
    let server = ScriptedServer::start(script).await;
    let mut client = Client::connect(&server.address).await;
    client.init().await;
    for command in more {
        client.say(command.clone()).await;
    }
    let heard = client.hear().await;
    client.writer.close().await;
    (heard, server.finish().await)
}

#[tokio::test]
async fn a_happy_session_gives_every_answer_and_every_burst() {
    let server = ScriptedServer::start("happy_session").await;
    let mut client = Client::connect(&server.address).await;
    assert!(matches!(client.next().await, Ok(Some(Message::Nfo(Nfo::Greeting(_))))));
    client.say(Command::GetStartPoses).await;
    let Ok(Some(Message::Nfo(Nfo::StartPoses(poses)))) = client.next().await else { panic!() };
    assert_eq!((poses[0].name.as_str(), poses[0].pose.location), ("PlayerStart", [4.5, 1.9, 1.8]));
    client.say(Command::GetGeo(Query::of("Robot"))).await;
    assert!(matches!(client.next().await, Ok(Some(Message::Geo(_)))));
    client.say(Command::GetConf(Query::of("MisPkg"))).await;
    assert!(matches!(client.next().await, Ok(Some(Message::Conf(_)))));
    client.init().await;
    let heard = client.hear().await;
    assert_eq!((heard.messages.len(), heard.problems.len()), (20, 0));
    client.writer.close().await;
    let transcript = server.finish().await;
    assert_eq!(transcript.with_verb("init").len(), 1);
}

#[tokio::test]
async fn a_server_without_a_status_line_is_told_as_silent() {
    let server = ScriptedServer::start("silent_server").await;
    let mut client = Client::connect(&server.address).await;
    client.reader.set_silence_limit(Some(Duration::from_millis(200)));
    assert!(matches!(client.next().await, Ok(Some(Message::Nfo(_)))));
    client.init().await;
    assert_eq!(client.next().await, Err(LinkError::Silent { limit_ms: 200 }));
    drop(client);
    server.finish().await;
}

#[tokio::test]
async fn a_mute_server_is_told_as_silent() {
    let server = ScriptedServer::start("mute_server").await;
    let mut client = Client::connect(&server.address).await;
    client.reader.set_silence_limit(Some(Duration::from_millis(200)));
    assert_eq!(client.next().await, Err(LinkError::Silent { limit_ms: 200 }));
    drop(client);
    server.finish().await;
}

#[tokio::test]
async fn broken_laser_lines_are_told_and_the_good_ones_kept() {
    let (heard, _) = play("broken_line", &[]).await;
    let scans = heard.messages.iter().filter(|message| matches!(message, Message::Sen(_))).count();
    let unknown =
        heard.messages.iter().filter(|message| matches!(message, Message::Unknown(_))).count();
    // The line that lost its middle has its ranges whole and is a scan without a name.
    assert_eq!((scans, unknown), (3, 2));
    assert!(heard.problems.iter().any(|problem| problem.kind == ProblemKind::SegmentNotClosed));
    let bad_number = ProblemKind::NotANumber("Range".to_owned());
    assert!(heard.problems.iter().any(|problem| problem.kind == bad_number));
}

#[tokio::test]
async fn a_connection_lost_in_mid_sweep_ends_cleanly_without_the_cut_line() {
    let (heard, _) = play("disconnect_in_mid_sweep", &[]).await;
    assert_eq!(heard.messages.len(), 10);
    assert_eq!(heard.problems, []);
    let [cut] = heard.dropped.as_slice() else { panic!("{:?}", heard.dropped) };
    assert_eq!(cut.kind, ProblemKind::Unfinished);
}

#[tokio::test]
async fn a_second_connection_is_a_new_session() {
    let server = ScriptedServer::start("reconnect").await;
    for _ in 0..2 {
        let mut client = Client::connect(&server.address).await;
        client.init().await;
        assert_eq!(client.hear().await.messages.len(), 2);
    }
    let transcript = server.finish().await;
    assert_eq!((transcript.connections, transcript.with_verb("INIT").len()), (2, 2));
}

#[tokio::test]
async fn a_script_names_the_step_that_the_client_did_not_take() {
    let script = super::Script::parse("t", "send NFO {A 1}\nexpect INIT {ClassName}");
    let server = ScriptedServer::run(script).await;
    let mut client = Client::connect(&server.address).await;
    client.say(Command::GetStartPoses).await;
    client.writer.close().await;
    let failure = tokio::spawn(server.finish()).await.unwrap_err().into_panic();
    let text = failure.downcast_ref::<String>().unwrap();
    assert!(text.starts_with("t.script:2: expected `INIT {ClassName}`"), "{text}");
    assert!(text.ends_with("found [\"GETSTARTPOSES\"]"), "{text}");
}
