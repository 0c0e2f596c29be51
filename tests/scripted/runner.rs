//! Runs a script against whoever connects.

use super::script::{NumberedStep, Script, Step, matches};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until, timeout, timeout_at};
use usar_agent::protocol::{Framed, LineSplitter, RawLine};

/// How long a script waits for a connection or for a line that it expects.
const PATIENCE: Duration = Duration::from_secs(5);

/// What a script may take as a whole.
const BOUND: Duration = Duration::from_secs(30);

/// A script that is being served.
pub struct ScriptedServer {
    /// `127.0.0.1:PORT`.
    pub address: String,
    task: JoinHandle<Result<Transcript, String>>,
}

/// What the client sent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Transcript {
    /// All lines in order, over all connections.
    pub lines: Vec<String>,
    /// How many connections there were.
    pub connections: usize,
}

impl Transcript {
    /// Lines with this verb.
    pub fn with_verb(&self, verb: &str) -> Vec<&str> {
        let is = |line: &&String| RawLine::parse(line.as_bytes(), &mut Vec::new()).is(verb);
        self.lines.iter().filter(is).map(String::as_str).collect()
    }
}

impl ScriptedServer {
    /// Listens on a free port and runs `scripts/NAME.script` for whoever connects.
    pub async fn start(name: &str) -> Self {
        Self::run(Script::load(name)).await
    }

    /// Listens on a free port and runs a script.
    pub async fn run(script: Script) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let task = tokio::spawn(async move {
            let name = script.name.clone();
            let mut runner = Runner::new(script.name, listener);
            let run = async {
                runner.accept().await?;
                runner.steps(&script.steps).await?;
                runner.until_closed().await;
                Ok::<_, String>(())
            };
            timeout(BOUND, run)
                .await
                .map_err(|_| format!("{name}: took more than {BOUND:?}"))??;
            Ok(runner.transcript)
        });
        Self { address, task }
    }

    /// Waits for the end of the script; panics with script and line if the client did not do what
    /// it expects.
    pub async fn finish(self) -> Transcript {
        self.task.await.unwrap().unwrap_or_else(|failure| panic!("{failure}"))
    }
}

struct Runner {
    name: String,
    listener: TcpListener,
    stream: Option<TcpStream>,
    splitter: LineSplitter,
    answers: Vec<(RawLine, String)>,
    held_back: Vec<u8>,
    time_cs: i64,
    step_cs: i64,
    transcript: Transcript,
}

impl Runner {
    fn new(name: String, listener: TcpListener) -> Self {
        Self {
            name,
            listener,
            stream: None,
            splitter: LineSplitter::default(),
            answers: Vec::new(),
            held_back: Vec::new(),
            time_cs: 10_000,
            step_cs: 20,
            transcript: Transcript::default(),
        }
    }

    async fn accept(&mut self) -> Result<(), String> {
        let accepted = timeout(PATIENCE, self.listener.accept()).await;
        let (stream, _) = accepted
            .map_err(|_| format!("{}: nobody connected within {PATIENCE:?}", self.name))?
            .map_err(|error| error.to_string())?;
        stream.set_nodelay(true).map_err(|error| error.to_string())?;
        self.stream = Some(stream);
        self.splitter = LineSplitter::default();
        self.transcript.connections += 1;
        Ok(())
    }

    async fn steps(&mut self, steps: &[NumberedStep]) -> Result<(), String> {
        for NumberedStep { line, step } in steps {
            let outcome = Box::pin(self.step(step)).await;
            outcome.map_err(|why| {
                if why.starts_with(&self.name) {
                    why
                } else {
                    format!("{}.script:{line}: {why}", self.name)
                }
            })?;
        }
        Ok(())
    }

    async fn step(&mut self, step: &Step) -> Result<(), String> {
        match step {
            Step::Send(line) => {
                let line = self.line(line);
                self.write(&line).await;
            }
            Step::Bytes(octets) => self.write(octets).await,
            Step::Cut(count, line) => {
                let mut line = self.line(line);
                self.held_back = line.split_off((*count).min(line.len()));
                self.write(&line).await;
            }
            Step::Rest => {
                let rest = std::mem::take(&mut self.held_back);
                self.write(&rest).await;
            }
            Step::Expect(pattern) => self.expect(pattern).await?,
            Step::Answer(pattern, line) => self.answers.push((pattern.clone(), line.clone())),
            Step::Wait(time) => {
                let end = Instant::now() + *time;
                while self.next_line(end).await.is_some() {}
                sleep_until(end).await;
            }
            Step::Quiet(time) => {
                let end = Instant::now() + *time;
                if let Some(line) = self.next_line(end).await {
                    return Err(format!("expected silence for {time:?}, found `{line}`"));
                }
                sleep_until(end).await;
            }
            Step::Stall(Some(time)) => tokio::time::sleep(*time).await,
            Step::Stall(None) => self.until_gone().await,
            Step::Close => {
                if let Some(mut stream) = self.stream.take() {
                    // A client that has gone already needs no close.
                    stream.shutdown().await.ok();
                }
            }
            Step::Accept => self.accept().await?,
            Step::Clock { start_cs, step_cs } => {
                (self.time_cs, self.step_cs) = (*start_cs, *step_cs);
            }
            Step::Tick => self.time_cs += self.step_cs,
            Step::Repeat(count, steps) => {
                for _ in 0..*count {
                    self.steps(steps).await?;
                }
            }
        }
        Ok(())
    }

    /// A line with the simulated time filled in, and CR LF.
    fn line(&self, line: &str) -> Vec<u8> {
        let two = |cs: i64| format!("{}.{:02}", cs / 100, cs % 100);
        let now = two(self.time_cs);
        let line = line.replace("{t2}", &now).replace("{t4}", &format!("{now}00"));
        let mut line = line.replace("{p2}", &two(self.time_cs - self.step_cs)).into_bytes();
        line.extend_from_slice(b"\r\n");
        line
    }

    /// Writes what can be written: a client that has gone is noticed by what it was to send.
    async fn write(&mut self, octets: &[u8]) {
        if let Some(stream) = &mut self.stream {
            stream.write_all(octets).await.ok();
        }
    }

    async fn expect(&mut self, pattern: &RawLine) -> Result<(), String> {
        let before = self.transcript.lines.len();
        let end = Instant::now() + PATIENCE;
        while let Some(line) = self.next_line(end).await {
            if matches(pattern, &RawLine::parse(line.as_bytes(), &mut Vec::new())) {
                return Ok(());
            }
        }
        let found = &self.transcript.lines[before..];
        let wanted = String::from_utf8_lossy(&pattern.encode()).trim_end().to_owned();
        Err(format!("expected `{wanted}` within {PATIENCE:?}, found {found:?}"))
    }

    /// The client's next line, answered if an answer is known; `None` at `end` or when it has gone.
    async fn next_line(&mut self, end: Instant) -> Option<String> {
        loop {
            if let Some(framed) = self.splitter.next_line() {
                let Framed::Line(line) = framed else { continue };
                let line = String::from_utf8_lossy(line).into_owned();
                self.transcript.lines.push(line.clone());
                self.answer(&line).await;
                return Some(line);
            }
            let mut buffer = [0; 4096];
            let read = self.stream.as_mut()?.read(&mut buffer);
            match timeout_at(end, read).await {
                Ok(Ok(count)) if count > 0 => self.splitter.push(&buffer[..count]),
                _ => return None,
            }
        }
    }

    async fn answer(&mut self, line: &str) {
        let line = RawLine::parse(line.as_bytes(), &mut Vec::new());
        let answers = self.answers.iter().filter(|(pattern, _)| matches(pattern, &line));
        let replies: Vec<_> = answers.map(|(_, reply)| self.line(reply)).collect();
        for reply in replies {
            self.write(&reply).await;
        }
    }

    /// Reads to the end of the client's stream.
    async fn until_closed(&mut self) {
        let end = Instant::now() + PATIENCE;
        while self.next_line(end).await.is_some() {}
    }

    /// Waits until the client has gone, without reading a line.
    async fn until_gone(&mut self) {
        let Some(stream) = &mut self.stream else { return };
        let mut ignored = [0; 4096];
        while timeout(BOUND, stream.read(&mut ignored))
            .await
            .is_ok_and(|read| matches!(read, Ok(1..)))
        {}
    }
}
