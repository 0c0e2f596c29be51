//! The reading half: bytes to lines with their arrival.

use super::{LinkError, SessionClock};
use crate::protocol::{Framed, LineSplitter, Problem, ProblemKind};
use crate::time::Arrival;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::time::timeout;

/// Bytes taken in one read: several bursts of a UT2004 server.
const READ_OCTETS: usize = 16 * 1024;

/// What arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// A whole line without its line end.
    Line {
        /// When its last bytes were read.
        arrival: Arrival,
        /// The line, never empty.
        octets: Vec<u8>,
    },
    /// A line that was dropped: too long, or without an end when the connection closed. The stream
    /// goes on after it.
    Dropped {
        /// When that was known.
        arrival: Arrival,
        /// What was wrong, with the beginning of the line.
        problem: Problem,
    },
}

/// Reads lines from a byte stream.
#[derive(Debug)]
pub struct LinkReader<R> {
    source: R,
    clock: SessionClock,
    splitter: LineSplitter,
    buffer: Vec<u8>,
    arrival: Arrival,
    silence: Option<Duration>,
    ended: bool,
}

impl<R: AsyncRead + Unpin> LinkReader<R> {
    /// A reader without a bound on silence.
    pub fn new(source: R, clock: SessionClock) -> Self {
        Self {
            source,
            clock,
            splitter: LineSplitter::default(),
            buffer: vec![0; READ_OCTETS],
            arrival: clock.now(),
            silence: None,
            ended: false,
        }
    }

    /// Makes [`LinkReader::next_line`] fail when no byte arrives for so long; `None` waits for ever.
    pub fn set_silence_limit(&mut self, limit: Option<Duration>) {
        self.silence = limit;
    }

    /// The next line, or `None` when the server has closed its side.
    ///
    /// Cancel safe: a future that is dropped loses nothing. After [`LinkError::Silent`] the link can
    /// be read on; after [`LinkError::Lost`] every call gives `None`.
    pub async fn next_line(&mut self) -> Result<Option<Incoming>, LinkError> {
        loop {
            if let Some(framed) = self.splitter.next_line() {
                return Ok(Some(incoming(framed, self.arrival)));
            }
            if self.ended {
                return Ok(self.splitter.finish().map(|framed| unfinished(framed, self.arrival)));
            }
            let read = self.source.read(&mut self.buffer);
            let count = match self.silence {
                None => read.await,
                Some(limit) => match timeout(limit, read).await {
                    Ok(read) => read,
                    Err(_) => return Err(LinkError::Silent { limit_ms: limit.as_millis() }),
                },
            };
            self.arrival = self.clock.now();
            match count {
                Ok(0) => self.ended = true,
                Ok(count) => self.splitter.push(&self.buffer[..count]),
                Err(error) => {
                    self.ended = true;
                    return Err(LinkError::lost(&error));
                }
            }
        }
    }
}

fn incoming(framed: Framed<'_>, arrival: Arrival) -> Incoming {
    match framed {
        Framed::Line(line) => Incoming::Line { arrival, octets: line.to_vec() },
        Framed::Overlong(problem) => Incoming::Dropped { arrival, problem },
    }
}

fn unfinished(framed: Framed<'_>, arrival: Arrival) -> Incoming {
    let problem = match framed {
        Framed::Line(line) => Problem::quoting(ProblemKind::Unfinished, line),
        Framed::Overlong(problem) => problem,
    };
    Incoming::Dropped { arrival, problem }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncWriteExt, DuplexStream, duplex};
    use tokio::time::{advance, sleep};

    fn pair() -> (DuplexStream, LinkReader<DuplexStream>) {
        let (server, client) = duplex(64 * 1024);
        (server, LinkReader::new(client, SessionClock::start()))
    }

    fn line(arrival_ms: i64, octets: &[u8]) -> Result<Option<Incoming>, LinkError> {
        let arrival = Arrival(arrival_ms * 1_000_000);
        Ok(Some(Incoming::Line { arrival, octets: octets.to_vec() }))
    }

    #[tokio::test(start_paused = true)]
    async fn a_cut_line_arrives_when_its_end_does() {
        let (mut server, mut reader) = pair();
        server.write_all(b"NFO {A 1}\r").await.unwrap();
        assert_eq!(reader.next_line().await, line(0, b"NFO {A 1}"));
        server.write_all(b"\nSTA {Ti").await.unwrap();
        let server = tokio::spawn(async move {
            sleep(Duration::from_millis(200)).await;
            server.write_all(b"me 1.00}\r\nSEN {B").await.unwrap();
        });
        assert_eq!(reader.next_line().await, line(200, b"STA {Time 1.00}"));
        server.await.unwrap();
        let Ok(Some(Incoming::Dropped { problem, .. })) = reader.next_line().await else {
            panic!("the rest of a closed stream is no line");
        };
        assert_eq!((problem.kind, problem.quote.as_str()), (ProblemKind::Unfinished, "SEN {B"));
        assert_eq!(reader.next_line().await, Ok(None));
    }

    #[tokio::test(start_paused = true)]
    async fn silence_is_told_and_the_link_stays_usable() {
        let (mut server, mut reader) = pair();
        reader.set_silence_limit(Some(Duration::from_millis(500)));
        assert_eq!(reader.next_line().await, Err(LinkError::Silent { limit_ms: 500 }));
        server.write_all(b"STA {A 1}\n").await.unwrap();
        assert_eq!(reader.next_line().await, line(500, b"STA {A 1}"));
    }

    #[tokio::test(start_paused = true)]
    async fn bytes_without_a_line_end_are_no_silence() {
        let (mut server, mut reader) = pair();
        reader.set_silence_limit(Some(Duration::from_millis(500)));
        let server = tokio::spawn(async move {
            for octet in b"STA {A 1}\n" {
                sleep(Duration::from_millis(300)).await;
                server.write_all(&[*octet]).await.unwrap();
            }
        });
        assert_eq!(reader.next_line().await, line(3000, b"STA {A 1}"));
        server.await.unwrap();
    }

    #[tokio::test(start_paused = true)]
    async fn a_dropped_future_loses_nothing() {
        let (mut server, mut reader) = pair();
        server.write_all(b"STA {Ti").await.unwrap();
        let waited = timeout(Duration::from_millis(10), reader.next_line()).await;
        assert!(waited.is_err());
        advance(Duration::from_millis(5)).await;
        server.write_all(b"me 1.00}\r\n").await.unwrap();
        assert_eq!(reader.next_line().await, line(15, b"STA {Time 1.00}"));
    }

    #[tokio::test(start_paused = true)]
    async fn a_line_beyond_the_bound_is_dropped_and_the_next_one_read() {
        let (mut server, mut reader) = pair();
        let server = tokio::spawn(async move {
            server.write_all(&vec![b'x'; 300_000]).await.unwrap();
            server.write_all(b"\r\nSTA {A 1}\r\n").await.unwrap();
        });
        let Ok(Some(Incoming::Dropped { problem, .. })) = reader.next_line().await else {
            panic!("the long line is dropped");
        };
        let limit = crate::protocol::MAX_LINE_OCTETS;
        assert_eq!(problem.kind, ProblemKind::Overlong { length: 300_000, limit });
        assert_eq!(reader.next_line().await, line(0, b"STA {A 1}"));
        server.await.unwrap();
    }
}
