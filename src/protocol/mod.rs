//! The wire: lines to typed messages and commands to lines, in both dialects.
//!
//! Pure functions of bytes; sockets are the business of [`link`](crate::link).
//!
//! ```text
//! bytes ──LineSplitter──▶ line ──parse──▶ Parsed { message, problems }        agent reads
//! Command ──encode_command──▶ line                                          agent writes
//! bytes ──LineSplitter──▶ line ──parse_command──▶ ParsedCommand               stand-in reads
//! Message ──encode_message──▶ line                                          stand-in writes
//! captured text ──capture::Capture──▶ lines + remarks                        replay reads
//! ```
//!
//! - **Reading is tolerant and needs no dialect.** Both forms of every message are taken: keys in
//!   any case, compound segments, bare lists, missing blanks, trailing commas, a missing time.
//!   Damage is a [`Problem`] beside the message and never an error; what is not known is
//!   [`Message::Unknown`] or stands in a struct's `extra`, in wire order. Nothing is lost.
//! - **Writing is strict.** [`encode_message`] and [`encode_command`] take a [`Dialect`] and write
//!   its order, decimals and blanks, ended by CR LF.
//! - **Values are the wire's**: x forward, y right, z down, metres, radians, yaw clockwise; see
//!   [`WirePose`]. `robot` (and `sim` the other way) converts them, nothing else does.
//! - **Times** are [`Stamp`](crate::time::Stamp)s, `None` where the server wrote none.
//! - **Links count from 1** in every type, also in [`command::Act`], whose wire form counts from 0.
//! - **Ground truth is a message of its own**, [`Message::GroundTruth`], and no [`Sen`](message::Sen): what takes
//!   sensor readings cannot be handed the truth.
//!
//! ```
//! use usar_agent::protocol::{Message, message::Sen, parse};
//!
//! let parsed = parse(b"SEN {Type Odometry}{Name Odometry}{Pose 1.0,2.0,-0.0000}");
//! assert!(parsed.problems.is_empty());
//! let Message::Sen(Sen::Odometry(odometry)) = parsed.message else { panic!() };
//! assert_eq!((odometry.x_m, odometry.theta_rad, odometry.time), (1.0, 0.0, None));
//! ```
//!
//! ```
//! use usar_agent::protocol::{Command, Dialect, command::Drive, encode_command, parse_command};
//!
//! let drive = Command::Drive(Drive::skid(1.0, -0.5));
//! let line = encode_command(&drive, Dialect::Ut2004);
//! assert_eq!(line, b"DRIVE {Left 1.0} {Right -0.5} {Normalized false}\r\n");
//! assert_eq!(parse_command(line.trim_ascii_end()).command, drive);
//! ```

pub mod capture;
pub mod command;
mod dialect;
mod encode;
mod fields;
mod grammar;
pub mod message;
mod number;
mod problem;
mod raw;
mod splitter;
mod text;
mod wire;

pub use command::{Command, ParsedCommand, encode_command, parse_command};
pub use dialect::Dialect;
pub use message::{Message, Parsed, encode_message, parse};
pub(crate) use number::engine_number;
pub use problem::{Problem, ProblemKind};
pub use raw::{RawLine, Segment};
pub use splitter::{Framed, LineSplitter, MAX_LINE_OCTETS};
pub use wire::{NamedPose, NamedValue, WirePose};
