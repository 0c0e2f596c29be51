//! The stand-in server on TCP: sockets and the wall clock around a [`Session`], which decides
//! everything.
//!
//! One task owns the session and all writing ends; one small task per client reads. A client can cost
//! no more than a bounded queue of unread bytes, a bounded output buffer and its own socket:
//! one that sends too fast waits, one that does not read is cut off.

mod images;
mod monitor;

pub use images::ImageType;

use super::camera::Screen;
use super::session::{ConnectionId, Session};
use crate::time::Span;
use bytes::{Buf, BytesMut};
use std::collections::BTreeMap;
use std::future::Future;
use std::io;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, oneshot};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::{Instant, MissedTickBehavior, interval};
use tracing::{debug, info, warn};

/// How often the session is advanced, in wall time: the length of its physics step.
const TURN: Duration = Duration::from_millis(5);

/// The most wall time that one turn makes up for. A machine that cannot keep up slows the level's
/// time instead of falling behind for ever.
const LONGEST_TURN: Duration = Duration::from_millis(50);

/// Clients at a time, as the UDK server's `MaxConnections`.
const MOST_CLIENTS: usize = 64;

/// Octets that wait for a client to read them; beyond, it is cut off.
const MOST_UNSENT: usize = 4 << 20;

/// Reads that wait to be taken in, of all clients together; beyond, readers wait.
const MOST_READS: usize = 64;

/// Octets of one read.
const READ_OCTETS: usize = 4096;

/// Why a server could not start.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {reason}")]
    Listen {
        /// The address as asked for.
        address: SocketAddr,
        /// What the system said.
        reason: String,
    },
}

/// A listener on an address, or why there is none.
///
/// # Errors
///
/// When the port is taken or the address is not this machine's.
pub async fn listen(address: SocketAddr) -> Result<TcpListener, ServerError> {
    TcpListener::bind(address).await.map_err(|error| {
        let reason = match error.kind() {
            io::ErrorKind::AddrInUse => "the port is taken".to_owned(),
            _ => error.to_string(),
        };
        ServerError::Listen { address, reason }
    })
}

enum Event {
    Bytes(ConnectionId, Vec<u8>),
    /// The client has sent its last.
    Finished(ConnectionId),
    /// The connection broke.
    Broken(ConnectionId),
    /// A line of the monitor port or the truth port, and where its answer goes.
    Monitor(Vec<u8>, oneshot::Sender<Option<Vec<u8>>>),
    /// A viewer wants to see the screen.
    Screen(oneshot::Sender<Screen>),
}

struct Client {
    write: OwnedWriteHalf,
    unsent: BytesMut,
    reader: AbortHandle,
}

impl Drop for Client {
    fn drop(&mut self) {
        self.reader.abort();
    }
}

/// A session behind a listening socket.
pub struct Server {
    session: Session,
    listener: TcpListener,
    clients: BTreeMap<ConnectionId, Client>,
    events: mpsc::Sender<Event>,
    inbox: mpsc::Receiver<Event>,
    images: Option<(TcpListener, ImageType)>,
    monitors: Vec<TcpListener>,
    speed: f64,
    last_turn: Instant,
}

impl Server {
    /// A server of `session` whose level time runs `speed` times as fast as the wall clock.
    pub fn new(session: Session, listener: TcpListener, speed: f64) -> Self {
        let (events, inbox) = mpsc::channel(MOST_READS);
        Self {
            session,
            listener,
            clients: BTreeMap::new(),
            events,
            inbox,
            images: None,
            monitors: Vec::new(),
            speed,
            last_turn: Instant::now(),
        }
    }

    /// The same server with pictures of its screen on another socket.
    #[must_use]
    pub fn with_images(self, listener: TcpListener, image_type: ImageType) -> Self {
        Self { images: Some((listener, image_type)), ..self }
    }

    /// The same server with one more socket for those who ask where things are: the monitor port, the
    /// truth port.
    #[must_use]
    pub fn with_monitor(mut self, listener: TcpListener) -> Self {
        self.monitors.push(listener);
        self
    }

    /// Serves until `stop` is done; then all connections close.
    pub async fn run(mut self, stop: impl Future<Output = ()>) {
        let mut stop = std::pin::pin!(stop);
        // Side services end with this value.
        let mut services = JoinSet::new();
        if let Some((listener, image_type)) = self.images.take() {
            let dialect = self.session.dialect();
            services.spawn(images::serve(listener, image_type, dialect, self.events.clone()));
        }
        for listener in self.monitors.drain(..) {
            services.spawn(monitor::serve(listener, self.events.clone()));
        }
        let mut turns = interval(TURN);
        turns.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.last_turn = Instant::now();
        loop {
            tokio::select! {
                () = &mut stop => break,
                accepted = self.listener.accept() => self.accept(accepted),
                Some(event) = self.inbox.recv() => self.take(event),
                _ = turns.tick() => self.turn(),
            }
        }
    }

    fn accept(&mut self, accepted: io::Result<(TcpStream, SocketAddr)>) {
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                warn!(%error, "a client could not be accepted");
                return;
            }
        };
        if self.clients.len() >= MOST_CLIENTS {
            warn!(%peer, MOST_CLIENTS, "turned away: too many clients");
            return;
        }
        // Lines are short and urgent; a system that refuses the option only makes them later.
        if let Err(error) = stream.set_nodelay(true) {
            debug!(%error, "small packets are delayed");
        }
        let id = self.session.connect();
        let (read, write) = stream.into_split();
        let reader = tokio::spawn(read_client(read, id, self.events.clone())).abort_handle();
        self.clients.insert(id, Client { write, unsent: BytesMut::new(), reader });
        info!(client = id.0, %peer, "connected");
        self.flush(id);
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Bytes(id, bytes) => self.session.receive(id, &bytes),
            Event::Finished(id) => self.session.finish(id),
            Event::Broken(id) => self.remove(id, "the connection broke"),
            // Who has gone needs no answer.
            Event::Monitor(line, tell) => drop(tell.send(self.session.monitor(&line))),
            Event::Screen(tell) => drop(tell.send(self.session.screen())),
        }
    }

    fn turn(&mut self) {
        let now = Instant::now();
        let wall = (now - self.last_turn).min(LONGEST_TURN);
        self.last_turn = now;
        self.session.advance(Span::from_seconds(wall.as_secs_f64() * self.speed));
        let ids: Vec<ConnectionId> = self.clients.keys().copied().collect();
        ids.into_iter().for_each(|id| self.flush(id));
    }

    /// Hands a client what it has to read, as far as its socket takes it.
    fn flush(&mut self, id: ConnectionId) {
        let closed = self.session.is_closed(id);
        let bytes = self.session.take_output(id);
        let Some(client) = self.clients.get_mut(&id) else { return };
        client.unsent.extend_from_slice(&bytes);
        while !client.unsent.is_empty() {
            match client.write.try_write(&client.unsent) {
                Ok(written) => client.unsent.advance(written),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                Err(error) => {
                    debug!(client = id.0, %error, "cannot write");
                    return self.remove(id, "the connection broke");
                }
            }
        }
        if closed {
            self.remove(id, "done");
        } else if client.unsent.len() > MOST_UNSENT {
            self.remove(id, "it does not read");
        }
    }

    fn remove(&mut self, id: ConnectionId, reason: &str) {
        self.session.disconnect(id);
        if self.clients.remove(&id).is_some() {
            info!(client = id.0, reason, "disconnected");
        }
    }
}

async fn read_client(mut read: OwnedReadHalf, id: ConnectionId, events: mpsc::Sender<Event>) {
    let mut buffer = [0; READ_OCTETS];
    loop {
        let event = match read.read(&mut buffer).await {
            Ok(0) => Event::Finished(id),
            Ok(length) => Event::Bytes(id, buffer[..length].to_vec()),
            Err(_) => Event::Broken(id),
        };
        let last = !matches!(event, Event::Bytes(..));
        if events.send(event).await.is_err() || last {
            return;
        }
    }
}
