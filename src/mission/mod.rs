//! The agent: events in, actions out.

mod journal;
mod motion;
mod operator;

pub use journal::{Journal, Level, Note};
pub use motion::{BodyAttitude, MotionTracker, PlanarPose};
pub use operator::{DRIVE_LEASE, DriveLease, Mode, OperatorDecodeError, OperatorEvent};
