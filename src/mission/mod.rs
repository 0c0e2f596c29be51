//! The agent: events in, actions out.

mod journal;
mod operator;

pub use journal::{Journal, Level, Note};
pub use operator::{DRIVE_LEASE, DriveLease, Mode, OperatorDecodeError, OperatorEvent};
