//! The TCP client: connects, cuts lines, stamps their arrival, sends lines. It knows nothing of
//! robots; what a silence or a lost connection means is decided above.
//!
//! [`connect`] gives a [`LinkReader`] and a [`LinkWriter`], which work on any byte stream, so that
//! tests run over `tokio::io::duplex` with paused time.

mod backoff;
mod clock;
mod reader;
mod writer;

pub use backoff::Backoff;
pub use clock::SessionClock;
pub use reader::{Incoming, LinkReader};
pub use writer::LinkWriter;

use std::io;
use std::net::SocketAddr;
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::time::{sleep, timeout};
use tracing::{debug, info};

/// Why there is no connection, or none any more.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// The name has no address, or the address has no port.
    #[error("cannot resolve `{address}`: {reason}; expected HOST:PORT")]
    Resolve {
        /// As it was given.
        address: String,
        /// What the system said.
        reason: String,
    },
    /// Nobody listens there.
    #[error("no server at {address}: connection refused, {attempts} attempts")]
    Refused {
        /// As it was given.
        address: String,
        /// How often it was tried.
        attempts: u32,
    },
    /// Nobody answers there.
    #[error("no answer from {address}: {attempts} attempts of {limit_s} s each")]
    ConnectTimedOut {
        /// As it was given.
        address: String,
        /// How often it was tried.
        attempts: u32,
        /// Whole seconds of one attempt.
        limit_s: u64,
    },
    /// Any other failure to connect.
    #[error("cannot connect to {address}: {reason}, {attempts} attempts")]
    Connect {
        /// As it was given.
        address: String,
        /// How often it was tried.
        attempts: u32,
        /// What the system said.
        reason: String,
    },
    /// The server is connected and sends nothing. The link can still be read.
    #[error("the server sent nothing for {limit_ms} ms")]
    Silent {
        /// The longest silence allowed.
        limit_ms: u128,
    },
    /// The server takes nothing: its side of the connection is full.
    #[error("the server took no data for {limit_ms} ms, {octets} bytes were to be sent")]
    Stalled {
        /// The longest wait allowed.
        limit_ms: u128,
        /// The length of the line.
        octets: usize,
    },
    /// The connection broke.
    #[error("connection lost: {reason}")]
    Lost {
        /// What the system said.
        reason: String,
    },
}

impl LinkError {
    fn lost(error: &io::Error) -> Self {
        Self::Lost { reason: error.to_string() }
    }
}

/// A reader and a writer on one TCP connection.
pub type TcpLink = (LinkReader<OwnedReadHalf>, LinkWriter<OwnedWriteHalf>);

/// Connects to `address` (`HOST:PORT`), trying again as `backoff` says.
///
/// All addresses of a name are tried in each attempt. A name that cannot be resolved is reported
/// at once.
pub async fn connect(
    address: &str,
    backoff: &Backoff,
    clock: SessionClock,
) -> Result<TcpLink, LinkError> {
    let resolved: Vec<SocketAddr> = tokio::net::lookup_host(address)
        .await
        .map_err(|error| resolve_error(address, &error.to_string()))?
        .collect();
    if resolved.is_empty() {
        return Err(resolve_error(address, "no address"));
    }
    let mut failure = None;
    for attempt in 1..=backoff.attempts.max(1) {
        if attempt > 1 {
            sleep(backoff.wait_before(attempt)).await;
        }
        match timeout(backoff.attempt_limit(), TcpStream::connect(&resolved[..])).await {
            Ok(Ok(stream)) => {
                info!(address, attempt, "connected");
                return Ok(link(stream, clock));
            }
            Ok(Err(error)) => {
                debug!(address, attempt, %error, "no connection");
                failure = Some(connect_error(address, attempt, &error));
            }
            Err(_) => {
                debug!(address, attempt, "no answer");
                let limit_s = backoff.attempt_limit().as_secs();
                let address = address.to_owned();
                failure = Some(LinkError::ConnectTimedOut { address, attempts: attempt, limit_s });
            }
        }
    }
    Err(failure.expect("there was at least one attempt"))
}

fn link(stream: TcpStream, clock: SessionClock) -> TcpLink {
    // Commands are short and urgent; a system that refuses the option only makes them later.
    if let Err(error) = stream.set_nodelay(true) {
        debug!(%error, "small packets are delayed");
    }
    let (read, write) = stream.into_split();
    (LinkReader::new(read, clock), LinkWriter::new(write))
}

fn resolve_error(address: &str, reason: &str) -> LinkError {
    LinkError::Resolve { address: address.to_owned(), reason: reason.to_owned() }
}

fn connect_error(address: &str, attempts: u32, error: &io::Error) -> LinkError {
    let address = address.to_owned();
    match error.kind() {
        io::ErrorKind::ConnectionRefused => LinkError::Refused { address, attempts },
        _ => LinkError::Connect { address, attempts, reason: error.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::net::TcpListener;

    fn quick() -> Backoff {
        Backoff { attempts: 3, first_wait_ms: 5, max_wait_ms: 10, attempt_limit_ms: 1000 }
    }

    /// A port on which nobody listens.
    async fn free_port() -> String {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        listener.local_addr().unwrap().to_string()
    }

    #[tokio::test]
    async fn a_port_without_a_server_is_refused_after_all_attempts() {
        let address = free_port().await;
        let error = connect(&address, &quick(), SessionClock::start()).await.err();
        assert_eq!(error, Some(LinkError::Refused { address, attempts: 3 }));
    }

    #[tokio::test]
    async fn an_address_without_a_port_cannot_be_resolved() {
        let error = connect("127.0.0.1", &quick(), SessionClock::start()).await.err().unwrap();
        assert!(matches!(error, LinkError::Resolve { ref address, .. } if address == "127.0.0.1"));
        assert!(error.to_string().contains("HOST:PORT"));
    }

    #[tokio::test]
    async fn a_server_that_comes_late_is_found() {
        let address = free_port().await;
        let late = address.clone();
        let server = tokio::spawn(async move {
            sleep(std::time::Duration::from_millis(60)).await;
            let listener = TcpListener::bind(late).await.unwrap();
            listener.accept().await.unwrap().0
        });
        let patient = Backoff { attempts: 50, ..quick() };
        let (mut reader, mut writer) =
            connect(&address, &patient, SessionClock::start()).await.unwrap();
        drop(server.await.unwrap());
        assert_eq!(reader.next_line().await, Ok(None));
        writer.close().await;
    }
}
