//! The agent: events in, actions out.

mod belief;
mod journal;
mod motion;
mod opening;
mod operator;

pub use belief::{Belief, BeliefConfig, ScanFindings};
pub use journal::{Journal, Level, Note};
pub use motion::{BodyAttitude, MotionTracker, PlanarPose};
pub use opening::{Opening, OpeningConfig, OpeningStep, Placement};
pub use operator::{DRIVE_LEASE, DriveLease, Mode, OperatorDecodeError, OperatorEvent};
