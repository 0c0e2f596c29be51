//! The agent: events in, actions out.

mod journal;
mod motion;
mod opening;
mod operator;

pub use journal::{Journal, Level, Note};
pub use motion::{BodyAttitude, MotionTracker, PlanarPose};
pub use opening::{Opening, OpeningConfig, OpeningStep, Placement};
pub use operator::{DRIVE_LEASE, DriveLease, Mode, OperatorDecodeError, OperatorEvent};
