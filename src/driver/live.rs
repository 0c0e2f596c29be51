//! The agent over TCP: the wire at one side, an operator and Ctrl-C at the other, real time between.
//!
//! Lines are stamped when they are read, on a task of their own, so that an agent busy with a sweep
//! does not make them younger than they are. The agent is fed by one loop, in the order of arrival;
//! what it answers goes to the recording and to the link in the same order.
//!
//! However a run ends, the wheels are told to stop while the link still takes bytes: by the agent
//! itself when its mission ends, by this driver when the agent or the recording fails.

use super::host::Host;
use crate::link::{Backoff, Incoming, LinkError, LinkWriter, SessionClock, TcpLink, connect};
use crate::mission::{Agent, Event};
use crate::protocol::command::Drive;
use crate::protocol::{Command, Dialect, encode_command};
use crate::time::Arrival;
use std::any::Any;
use std::future::pending;
use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::time::Duration;
use tokio::io::AsyncRead;
use tokio::net::tcp::OwnedWriteHalf;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{sleep, sleep_until, timeout};
use tracing::{debug, warn};

/// Lines that may wait for an agent that is busy: half a minute of a talkative server. A server that
/// sends more is slowed down by its own socket.
const QUEUE: usize = 4096;

/// A line that the server does not take within this time means that the link is gone: a command so
/// late is worth nothing.
const STALL: Duration = Duration::from_millis(1500);

/// How long a server may take to close its side after ours, so that our last line is not lost to a
/// reset.
const FAREWELL: Duration = Duration::from_millis(500);

/// Wait before a name that could not be resolved is tried again while a lost link is sought.
const RESOLVE_AGAIN: Duration = Duration::from_secs(1);

/// Why a live run could not go on. A mission that ended, whatever its outcome, is none of these.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The recording could not be written; the wheels were stopped.
    #[error("the recording cannot be written: {0}")]
    Recording(#[from] io::Error),
}

/// What the shell hands to a running agent: an operator's acts, the request to end.
pub type Inputs = mpsc::Receiver<(Arrival, Event)>;

/// A live run: one agent, one server.
pub struct Live<'a, W: Write, F> {
    host: &'a mut Host<W>,
    clock: SessionClock,
    address: String,
    backoff: Backoff,
    inputs: Inputs,
    watch: F,
    now: Arrival,
    line: Option<Line>,
    /// Links lost in a row without a robot in service between.
    losses: u32,
}

/// The link while it is up.
struct Line {
    writer: LinkWriter<OwnedWriteHalf>,
    heard: mpsc::Receiver<Heard>,
    reader: JoinHandle<()>,
}

/// What the reading task has to say.
enum Heard {
    Line(Arrival, Vec<u8>),
    Down(Arrival, String),
}

/// What happens next.
enum Next {
    Input(Arrival, Event),
    Heard(Heard),
    Wake,
}

impl<'a, W: Write, F: FnMut(&Agent, Arrival)> Live<'a, W, F> {
    /// A run of the agent in `host` with the server at `address`. `watch` sees the agent after every
    /// event; `backoff` says how soon a lost link is sought again. How long it is sought is the
    /// agent's to say.
    pub fn new(
        host: &'a mut Host<W>,
        clock: SessionClock,
        address: &str,
        backoff: Backoff,
        inputs: Inputs,
        watch: F,
    ) -> Self {
        let backoff = Backoff { attempts: u32::MAX, ..backoff };
        let address = address.to_owned();
        let now = Arrival::default();
        Self { host, clock, address, backoff, inputs, watch, now, line: None, losses: 0 }
    }

    /// Runs the mission over `link` to its end.
    ///
    /// # Errors
    ///
    /// When the recording cannot be written.
    ///
    /// # Panics
    ///
    /// When the agent or `watch` does; the wheels are stopped first.
    pub async fn run(mut self, link: TcpLink) -> Result<(), LiveError> {
        let result = self.session(link).await;
        self.close().await;
        result
    }

    async fn session(&mut self, link: TcpLink) -> Result<(), LiveError> {
        self.up(link).await?;
        while self.host.outcome().is_none() {
            let Some(reason) = self.serve().await? else { break };
            warn!(%reason, "link lost");
            self.losses = if self.host.agent().is_in_service() { 1 } else { self.losses + 1 };
            self.close().await;
            // The link is down: there is nothing to send on, whatever the agent says.
            let _ = self.feed(&Event::Disconnected(reason), self.clock.now()).await?;
            self.seek().await?;
        }
        Ok(())
    }

    async fn up(&mut self, (mut reader, mut writer): TcpLink) -> Result<(), LiveError> {
        writer.set_stall_limit(STALL);
        // A server that is alive but silent is the agent's watchdog's business.
        reader.set_silence_limit(None);
        let (sender, heard) = mpsc::channel(QUEUE);
        let reader = tokio::spawn(read_on(reader, sender, self.clock));
        self.line = Some(Line { writer, heard, reader });
        self.feed(&Event::Connected, self.clock.now()).await.map(|_| ())
    }

    /// Feeds the agent until the mission is over (`None`) or the link is down (the reason).
    async fn serve(&mut self) -> Result<Option<String>, LiveError> {
        while self.host.outcome().is_none() {
            let sent = match self.next().await {
                Next::Input(at, event) => self.feed(&event, at).await?,
                Next::Heard(Heard::Line(at, octets)) => {
                    let due = self.host.agent().next_wakeup().filter(|due| *due <= at);
                    let woken = match due {
                        // What was due before the line came is done before it, at its own time.
                        Some(due) => self.feed(&Event::Wake, due).await?,
                        None => Ok(()),
                    };
                    if self.host.outcome().is_some() {
                        return Ok(None);
                    }
                    woken.and(self.feed(&Event::Line(octets), at).await?)
                }
                Next::Heard(Heard::Down(at, reason)) => {
                    self.now = self.now.max(at);
                    return Ok(Some(reason));
                }
                Next::Wake => self.feed(&Event::Wake, self.clock.now()).await?,
            };
            if let Err(error) = sent {
                return Ok(Some(error.to_string()));
            }
        }
        Ok(None)
    }

    async fn next(&mut self) -> Next {
        let due = self.host.agent().next_wakeup().map(|due| self.clock.instant(due));
        let wake = async {
            match due {
                Some(due) => sleep_until(due).await,
                None => pending().await,
            }
        };
        let heard = async {
            match &mut self.line {
                Some(line) => line.heard.recv().await,
                None => pending().await,
            }
        };
        tokio::select! {
            biased;
            Some((at, event)) = self.inputs.recv() => Next::Input(at, event),
            heard = heard => Next::Heard(heard.unwrap_or_else(|| {
                Heard::Down(self.now, "the reading task ended".into())
            })),
            () = wake => Next::Wake,
        }
    }

    /// Seeks a lost link until it is there again or the agent has given up.
    async fn seek(&mut self) -> Result<(), LiveError> {
        let (address, backoff, clock) = (self.address.clone(), self.backoff.clone(), self.clock);
        // A server that takes connections only to drop them is not asked again at once.
        let pause = backoff.wait_before(self.losses.saturating_add(1));
        let link = async move {
            sleep(pause).await;
            loop {
                match connect(&address, &backoff, clock).await {
                    Ok(link) => return link,
                    Err(error) => debug!(%error, "no link yet"),
                }
                sleep(RESOLVE_AGAIN).await;
            }
        };
        tokio::pin!(link);
        while self.host.outcome().is_none() {
            let event = tokio::select! {
                biased;
                next = self.next() => match next {
                    Next::Input(at, event) => Some((at, event)),
                    Next::Wake => Some((self.clock.now(), Event::Wake)),
                    Next::Heard(_) => None,
                },
                link = &mut link => return self.up(link).await,
            };
            if let Some((at, event)) = event {
                // There is no link to send on; the agent knows.
                let _ = self.feed(&event, at).await?;
            }
        }
        Ok(())
    }

    /// Feeds one event and sends what the agent answers; the inner error is the link's.
    async fn feed(
        &mut self,
        event: &Event,
        at: Arrival,
    ) -> Result<Result<(), LinkError>, LiveError> {
        self.now = self.now.max(at);
        let dialect = self.host.agent().dialect();
        let fed = catch_unwind(AssertUnwindSafe(|| self.host.feed(event, self.now)));
        let lines = match fed {
            Ok(Ok(lines)) => lines,
            Ok(Err(error)) => {
                self.stop_wheels(dialect).await;
                return Err(error.into());
            }
            Err(panic) => self.abandon(dialect, panic).await,
        };
        let watched = catch_unwind(AssertUnwindSafe(|| (self.watch)(self.host.agent(), self.now)));
        if let Err(panic) = watched {
            self.abandon(dialect, panic).await;
        }
        Ok(self.send(&lines.concat()).await)
    }

    /// Passes a panic on when the wheels have been told to stop.
    async fn abandon(&mut self, dialect: Dialect, panic: Box<dyn Any + Send>) -> ! {
        self.stop_wheels(dialect).await;
        self.close().await;
        resume_unwind(panic)
    }

    async fn send(&mut self, octets: &[u8]) -> Result<(), LinkError> {
        match &mut self.line {
            Some(line) if !octets.is_empty() => line.writer.send(octets).await,
            _ => Ok(()),
        }
    }

    async fn stop_wheels(&mut self, dialect: Dialect) {
        let stop = encode_command(&Command::Drive(Drive::skid(0.0, 0.0)), dialect);
        if let Err(error) = self.send(&stop).await {
            warn!(%error, "the wheels could not be told to stop");
        }
    }

    /// Closes our side and reads on until the server has closed its own: closing with unread bytes
    /// would reset the connection and could take our last line with it.
    async fn close(&mut self) {
        let Some(mut line) = self.line.take() else { return };
        line.writer.close().await;
        let drained = timeout(FAREWELL, async { while line.heard.recv().await.is_some() {} });
        if drained.await.is_err() {
            debug!("the server did not close its side");
        }
        line.reader.abort();
    }
}

async fn read_on<R: AsyncRead + Unpin>(
    mut reader: crate::link::LinkReader<R>,
    sender: mpsc::Sender<Heard>,
    clock: SessionClock,
) {
    loop {
        let heard = match reader.next_line().await {
            Ok(Some(Incoming::Line { arrival, octets })) => Heard::Line(arrival, octets),
            Ok(Some(Incoming::Dropped { problem, .. })) => {
                warn!(kind = %problem.kind, quote = problem.quote, "line dropped");
                continue;
            }
            Ok(None) => Heard::Down(clock.now(), "the server closed the connection".into()),
            Err(error) => Heard::Down(clock.now(), error.to_string()),
        };
        let last = matches!(heard, Heard::Down(..));
        if sender.send(heard).await.is_err() || last {
            return;
        }
    }
}
