//! Plain clients against the stand-in server, over real sockets on free ports.

mod clients;
mod opening;
mod operator;
mod pictures;
mod reconnect;
mod server;
mod statistics;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::sync::mpsc;
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::oneshot;
use usar_agent::files::world::load_world;
use usar_agent::protocol::Dialect;
use usar_agent::sim::Session;
use usar_agent::sim::server::{ImageType, Server, listen};

/// Level time per wall time: bursts come every 20 ms.
const SPEED: f64 = 10.0;

/// The longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(20);

/// A server on a thread of its own; it ends with the value.
struct Stand {
    address: SocketAddr,
    images: SocketAddr,
    monitor: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Stand {
    /// The server of a scenario in the program.
    fn of(scenario: &str, dialect: Dialect) -> Self {
        let mut files = load_world(Path::new(scenario)).unwrap();
        files.scenario.dialect = dialect;
        let session = Session::new(&files.world, &files.scenario, &files.catalogue).unwrap();
        let (stop, stopped) = oneshot::channel();
        let (tell, told) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_multi_thread()
                .worker_threads(1)
                .enable_all()
                .build()
                .unwrap();
            runtime.block_on(async {
                let free = SocketAddr::from(([127, 0, 0, 1], 0));
                let [robots, viewers, monitors] = [
                    listen(free).await.unwrap(),
                    listen(free).await.unwrap(),
                    listen(free).await.unwrap(),
                ];
                let addresses = [&robots, &viewers, &monitors].map(|l| l.local_addr().unwrap());
                tell.send(addresses).unwrap();
                let server = Server::new(session, robots, SPEED)
                    .with_images(viewers, ImageType::usual(dialect))
                    .with_monitor(monitors);
                let stop = async {
                    let _ = stopped.await;
                };
                server.run(stop).await;
            });
        });
        let [address, images, monitor] = told.recv().unwrap();
        Self { address, images, monitor, stop: Some(stop), thread: Some(thread) }
    }

    fn client(&self) -> Client {
        Client::connect(self.address)
    }
}

impl Drop for Stand {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            assert!(ended.is_ok() || std::thread::panicking(), "the server panicked");
        }
    }
}

/// A client that types lines and reads lines.
struct Client {
    stream: TcpStream,
    reader: BufReader<TcpStream>,
}

impl Client {
    fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let reader = BufReader::new(stream.try_clone().unwrap());
        Self { stream, reader }
    }

    /// Sends octets as they are.
    fn send(&mut self, octets: &str) {
        self.stream.write_all(octets.as_bytes()).unwrap();
    }

    /// The next line, its line end checked and taken off; `None` at the end of the stream.
    fn line(&mut self) -> Option<String> {
        let mut line = Vec::new();
        let length = self.reader.read_until(b'\n', &mut line).expect("a line in time");
        if length == 0 {
            return None;
        }
        let line = String::from_utf8(line).unwrap();
        Some(line.strip_suffix("\r\n").expect("lines end with CR LF").to_owned())
    }

    /// The next line that begins with `start`, others skipped.
    fn line_of(&mut self, start: &str) -> String {
        loop {
            let line = self.line().unwrap_or_else(|| panic!("the stream ended before {start}"));
            if line.starts_with(start) {
                return line;
            }
        }
    }

    /// Sends a line and gives the next one that begins with `verb`.
    fn ask(&mut self, line: &str, verb: &str) -> String {
        self.send(&format!("{line}\r\n"));
        self.line_of(verb)
    }

    /// Reads until the server ends the stream.
    fn read_to_end(mut self) -> Vec<u8> {
        let mut rest = Vec::new();
        let _ = self.reader.read_to_end(&mut rest);
        rest
    }
}
