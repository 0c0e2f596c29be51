//! The camera image server: pictures of the server's screen on a port of its own (protocol document
//! 7.1).
//!
//! A picture is one octet of type, four octets of length (big-endian), then that many octets. `OK`
//! asks for one; UDK's `U` with x, y, width and height asks for a part. A UT2004 server pushes one at
//! connect. Everything else that a client sends is skipped.

use super::Event;
use crate::protocol::Dialect;
use crate::sim::camera::{Picture, Screen};
use jpeg_encoder::{ColorType, Encoder, EncodingError};
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::timeout;
use tracing::{debug, info, warn};

/// Clients at a time.
const MOST_VIEWERS: usize = 16;

/// Pictures drawn at a time: drawing takes a whole core.
const MOST_DRAWN: usize = 1;

/// A viewer that takes none of its picture for so long is cut off.
const PATIENCE: Duration = Duration::from_secs(10);

/// How pictures are sent, with the wire's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageType {
    /// Width and height in two octets each (big-endian), then red, green, blue of each pixel; rows
    /// are padded to a multiple of four octets.
    Raw,
    /// JPEG of the highest quality.
    Superb,
    /// JPEG of good quality.
    Good,
    /// JPEG of normal quality.
    Normal,
    /// JPEG of average quality.
    Fair,
    /// JPEG of bad quality.
    Bad,
}

impl ImageType {
    /// The type that servers of a dialect send unless told otherwise.
    pub fn usual(dialect: Dialect) -> Self {
        match dialect {
            Dialect::Ut2004 => Self::Good,
            Dialect::Udk => Self::Raw,
        }
    }

    /// The wire's number, and the quality of the picture in percent.
    fn number(self) -> (u8, Option<u8>) {
        match self {
            Self::Raw => (0, None),
            Self::Superb => (1, Some(100)),
            Self::Good => (2, Some(75)),
            Self::Normal => (3, Some(50)),
            Self::Fair => (4, Some(25)),
            Self::Bad => (5, Some(10)),
        }
    }
}

/// What a viewer asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    Whole,
    Part([u32; 4]),
}

/// Takes requests out of a stream of octets, however it is cut.
#[derive(Clone, Debug)]
struct Requests {
    dialect: Dialect,
    buffer: Vec<u8>,
}

impl Requests {
    fn push(&mut self, octets: &[u8]) {
        self.buffer.extend_from_slice(octets);
    }

    fn next(&mut self) -> Option<Request> {
        loop {
            let (request, length) = match (self.dialect, self.buffer.as_slice()) {
                (_, []) | (_, [b'O']) => return None,
                (_, [b'O', b'K', ..]) => (Some(Request::Whole), 2),
                (Dialect::Udk, [b'U', rest @ ..]) => {
                    let (numbers, _) = rest.split_first_chunk::<16>()?;
                    let number = |at: usize| {
                        let octets = numbers[4 * at..4 * at + 4].try_into();
                        u32::from_be_bytes(octets.expect("a quarter of sixteen is four"))
                    };
                    (Some(Request::Part([0, 1, 2, 3].map(number))), 17)
                }
                _ => (None, 1),
            };
            self.buffer.drain(..length);
            if request.is_some() {
                return request;
            }
        }
    }
}

/// Serves viewers until it is dropped; views come from the session's owner through `events`.
pub(super) async fn serve(
    listener: TcpListener,
    image_type: ImageType,
    dialect: Dialect,
    events: mpsc::Sender<Event>,
) {
    let drawing = Arc::new(Semaphore::new(MOST_DRAWN));
    let mut viewers = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = viewers.join_next() => continue,
        };
        match accepted {
            Ok((_, peer)) if viewers.len() >= MOST_VIEWERS => {
                warn!(%peer, MOST_VIEWERS, "turned away: too many viewers");
            }
            Ok((stream, peer)) => {
                let viewer = Viewer {
                    stream,
                    image_type,
                    requests: Requests { dialect, buffer: Vec::new() },
                    events: events.clone(),
                    drawing: drawing.clone(),
                };
                viewers.spawn(async move {
                    info!(%peer, "viewer connected");
                    let reason = viewer.serve(dialect == Dialect::Ut2004).await;
                    debug!(%peer, ?reason, "viewer disconnected");
                });
            }
            Err(error) => {
                warn!(%error, "a viewer could not be accepted");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}

struct Viewer {
    stream: TcpStream,
    image_type: ImageType,
    requests: Requests,
    events: mpsc::Sender<Event>,
    drawing: Arc<Semaphore>,
}

impl Viewer {
    async fn serve(mut self, push_first: bool) -> io::Result<()> {
        if push_first {
            self.send(Request::Whole).await?;
        }
        let mut buffer = [0; 1024];
        loop {
            let length = self.stream.read(&mut buffer).await?;
            if length == 0 {
                return Ok(());
            }
            self.requests.push(&buffer[..length]);
            while let Some(request) = self.requests.next() {
                self.send(request).await?;
            }
        }
    }

    async fn send(&mut self, request: Request) -> io::Result<()> {
        let ended = || io::Error::other("the server has ended");
        let (tell, told) = oneshot::channel();
        self.events.send(Event::Screen(tell)).await.map_err(|_| ended())?;
        let screen = told.await.map_err(|_| ended())?;
        let turn = self.drawing.acquire().await.map_err(|_| ended())?;
        let image_type = self.image_type;
        let bytes =
            tokio::task::spawn_blocking(move || picture_bytes(&screen, request, image_type))
                .await
                .map_err(io::Error::other)?
                .map_err(io::Error::other)?;
        drop(turn);
        let written = timeout(PATIENCE, self.stream.write_all(&bytes)).await;
        written.unwrap_or_else(|_| Err(io::Error::new(io::ErrorKind::TimedOut, "it does not read")))
    }
}

fn picture_bytes(
    screen: &Screen,
    request: Request,
    image_type: ImageType,
) -> Result<Vec<u8>, EncodingError> {
    let whole = screen.draw();
    let picture = match request {
        Request::Whole => whole,
        // No more than the screen has, whatever is asked for.
        Request::Part([x, y, width, height]) => {
            let (width, height) = (width.clamp(1, whole.width), height.clamp(1, whole.height));
            whole.cut(x, y, width, height)
        }
    };
    framed(&picture, image_type)
}

/// A picture as it goes over the wire.
fn framed(picture: &Picture, image_type: ImageType) -> Result<Vec<u8>, EncodingError> {
    let (number, quality) = image_type.number();
    let [width, height] = [picture.width, picture.height].map(|size| size as u16);
    let mut data = Vec::new();
    match quality {
        Some(quality) => {
            let encoder = Encoder::new(&mut data, quality);
            encoder.encode(&picture.rgb, width, height, ColorType::Rgb)?;
        }
        None => {
            data.extend(width.to_be_bytes());
            data.extend(height.to_be_bytes());
            let row = picture.width as usize * 3;
            for pixels in picture.rgb.chunks(row) {
                data.extend_from_slice(pixels);
                data.resize(data.len() + row.next_multiple_of(4) - row, 0);
            }
        }
    }
    let mut bytes = vec![number];
    bytes.extend((data.len() as u32).to_be_bytes());
    bytes.extend(data);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn requests(dialect: Dialect, pieces: &[&[u8]]) -> Vec<Request> {
        let mut requests = Requests { dialect, buffer: Vec::new() };
        let mut found = Vec::new();
        for piece in pieces {
            requests.push(piece);
            found.extend(std::iter::from_fn(|| requests.next()));
        }
        assert!(requests.buffer.len() < 17, "nothing piles up");
        found
    }

    #[test]
    fn a_picture_is_asked_for_by_ok_however_it_is_cut() {
        use Request::Whole;
        assert_eq!(requests(Dialect::Ut2004, &[b"OK\r\n", b"OOK", b"O", b"K"]), [Whole; 3]);
        assert_eq!(requests(Dialect::Ut2004, &[b"hello\0\xffU", &[0; 40]]), []);
    }

    #[test]
    fn udk_gives_parts_too() {
        let part = b"U\0\0\0\x01\0\0\0\x02\0\0\x01\x40\0\0\0\xf0OK";
        let expected = [Request::Part([1, 2, 320, 240]), Request::Whole];
        assert_eq!(requests(Dialect::Udk, &[part]), expected);
        assert_eq!(requests(Dialect::Udk, &[&part[..5], &part[5..]]), expected);
        // UT2004 knows no parts: the octets are skipped, the OK behind them counts.
        assert_eq!(requests(Dialect::Ut2004, &[part]), [Request::Whole]);
    }

    #[test]
    fn raw_rows_are_padded_and_the_length_counts_what_follows_it() {
        let picture = Picture { width: 3, height: 2, rgb: (1..=18).collect() };
        let bytes = framed(&picture, ImageType::Raw).unwrap();
        assert_eq!(bytes[..9], [0, 0, 0, 0, 28, 0, 3, 0, 2]);
        assert_eq!(bytes[9..21], [1, 2, 3, 4, 5, 6, 7, 8, 9, 0, 0, 0]);
        assert_eq!(bytes.len(), 5 + 28);
    }

    #[test]
    fn jpegs_carry_their_number_and_a_picture() {
        let picture = Picture { width: 16, height: 8, rgb: vec![200; 16 * 8 * 3] };
        for (image_type, number) in
            [(ImageType::Superb, 1), (ImageType::Good, 2), (ImageType::Bad, 5)]
        {
            let bytes = framed(&picture, image_type).unwrap();
            assert_eq!(bytes[0], number);
            let length = u32::from_be_bytes(bytes[1..5].try_into().unwrap());
            assert_eq!(length as usize, bytes.len() - 5);
            assert_eq!(
                (&bytes[5..7], &bytes[bytes.len() - 2..]),
                (&[0xff, 0xd8][..], &[0xff, 0xd9][..])
            );
        }
    }
}
