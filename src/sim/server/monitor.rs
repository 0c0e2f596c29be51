//! The socket of the monitor port: lines in, lines out.

use super::Event;
use crate::protocol::{Framed, LineSplitter};
use std::io;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::timeout;
use tracing::warn;

/// Clients at a time.
const MOST_CLIENTS: usize = 16;

/// The longest request.
const LONGEST_REQUEST: usize = 4096;

/// A client that takes none of its answer for so long is cut off.
const PATIENCE: Duration = Duration::from_secs(10);

/// Serves monitors until it is dropped; answers come from the session's owner through `events`.
pub(super) async fn serve(listener: TcpListener, events: mpsc::Sender<Event>) {
    let mut clients = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = clients.join_next() => continue,
        };
        match accepted {
            Ok((_, peer)) if clients.len() >= MOST_CLIENTS => {
                warn!(%peer, MOST_CLIENTS, "turned away: too many monitors");
            }
            Ok((stream, _)) => {
                clients.spawn(answer(stream, events.clone()));
            }
            Err(error) => {
                warn!(%error, "a monitor could not be accepted");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}

async fn answer(mut stream: TcpStream, events: mpsc::Sender<Event>) -> io::Result<()> {
    let ended = || io::Error::other("the server has ended");
    let mut splitter = LineSplitter::new(LONGEST_REQUEST);
    let mut buffer = [0; 1024];
    loop {
        let length = stream.read(&mut buffer).await?;
        if length == 0 {
            return Ok(());
        }
        splitter.push(&buffer[..length]);
        while let Some(framed) = splitter.next_line() {
            let Framed::Line(line) = framed else { continue };
            let (tell, told) = oneshot::channel();
            let event = Event::Monitor(line.to_vec(), tell);
            events.send(event).await.map_err(|_| ended())?;
            if let Some(answer) = told.await.map_err(|_| ended())? {
                timeout(PATIENCE, stream.write_all(&answer)).await??;
            }
        }
    }
}
