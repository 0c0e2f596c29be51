//! The writing half.

use super::LinkError;
use std::time::Duration;
use tokio::io::{AsyncWrite, AsyncWriteExt};
use tokio::time::timeout;
use tracing::debug;

/// How long a server may take nothing before the link counts as stalled.
const DEFAULT_STALL: Duration = Duration::from_secs(5);

/// Writes lines to a byte stream.
#[derive(Debug)]
pub struct LinkWriter<W> {
    sink: W,
    stall: Duration,
}

impl<W: AsyncWrite + Unpin> LinkWriter<W> {
    /// A writer that gives up a line after five seconds.
    pub fn new(sink: W) -> Self {
        Self { sink, stall: DEFAULT_STALL }
    }

    /// How long one line may take to be sent.
    pub fn set_stall_limit(&mut self, limit: Duration) {
        self.stall = limit;
    }

    /// Sends whole lines, each with its CR LF, as the encoder gives them.
    ///
    /// Not cancel safe: a future that is dropped may have sent a part of a line. After an error the
    /// same holds, so the connection should be given up.
    pub async fn send(&mut self, lines: &[u8]) -> Result<(), LinkError> {
        debug_assert!(lines.ends_with(b"\r\n"), "servers take a line only once its CR LF is there");
        let sink = &mut self.sink;
        let send = async {
            sink.write_all(lines).await?;
            sink.flush().await
        };
        match timeout(self.stall, send).await {
            Ok(sent) => sent.map_err(|error| LinkError::lost(&error)),
            Err(_) => {
                Err(LinkError::Stalled { limit_ms: self.stall.as_millis(), octets: lines.len() })
            }
        }
    }

    /// Closes this side; what the server still has to say can be read.
    ///
    /// A connection that is already gone is closed: no error is told.
    pub async fn close(&mut self) {
        match timeout(self.stall, self.sink.shutdown()).await {
            Ok(Ok(())) => {}
            Ok(Err(error)) => debug!(%error, "the connection was gone before it was closed"),
            Err(_) => debug!("the server did not take the close"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{LinkReader, SessionClock};
    use tokio::io::{AsyncReadExt, duplex, split};

    #[tokio::test(start_paused = true)]
    async fn a_server_that_takes_nothing_is_reported() {
        let (_server, client) = duplex(8);
        let mut writer = LinkWriter::new(client);
        writer.set_stall_limit(Duration::from_millis(300));
        let sent = writer.send(b"DRIVE {Left 1.0} {Right 1.0}\r\n").await;
        assert_eq!(sent, Err(LinkError::Stalled { limit_ms: 300, octets: 30 }));
    }

    #[tokio::test]
    async fn a_server_that_is_gone_is_reported() {
        let (server, client) = duplex(64);
        drop(server);
        let sent = LinkWriter::new(client).send(b"GETSTARTPOSES\r\n").await;
        assert!(matches!(sent, Err(LinkError::Lost { .. })));
    }

    #[tokio::test]
    async fn after_the_half_close_the_server_can_still_speak() {
        let (mut server, client) = duplex(64);
        let (read, write) = split(client);
        let mut reader = LinkReader::new(read, SessionClock::start());
        let mut writer = LinkWriter::new(write);
        writer.send(b"DRIVE {Left 0.0}\r\n").await.unwrap();
        writer.close().await;
        let mut heard = String::new();
        server.read_to_string(&mut heard).await.unwrap();
        assert_eq!(heard, "DRIVE {Left 0.0}\r\n");
        server.write_all(b"STA {A 1}\r\n").await.unwrap();
        drop(server);
        assert!(matches!(reader.next_line().await, Ok(Some(_))));
        assert_eq!(reader.next_line().await, Ok(None));
    }
}
