//! The agent: events in, actions out.
//!
//! [`Agent`] is the whole of it; a driver feeds it and does what it says. Inside, a session is first
//! opened ([`Opening`]), then a robot is in service ([`Running`]): readings enter its [`Belief`],
//! autonomy or an operator decides what to do next, and the pilot lets through what is safe.

mod agent;
mod alignment;
mod autonomy;
mod belief;
mod bridge;
mod closing;
mod config;
mod event;
mod fixing;
mod floor;
mod grip;
mod inertial_way;
mod journal;
mod leaps;
mod ledger;
mod leg;
mod level;
mod lines;
mod looks;
mod motion;
mod nod;
mod observe;
mod opening;
mod operator;
mod pilot;
mod readings;
mod resume;
mod running;
mod sign_test;
mod slow_line;
mod sweeps;
mod tally;
mod teleop;
mod turning;
mod wall_alignment;

pub use agent::Agent;
pub use belief::{Belief, BeliefConfig, ScanFindings};
pub use config::{AgentConfig, FineSweep, LookPolicy, MissionConfig};
pub use event::{Action, Event, Outcome};
pub use journal::{Journal, Level, Note};
pub use ledger::{Fixes, Ledger, Pastime, SweepEntry, TimeSplit, WeakScan};
pub use motion::{BodyAttitude, MotionTracker, PlanarPose};
pub use opening::{Opening, OpeningConfig, OpeningStep, Placement};
pub use operator::{DRIVE_LEASE, DriveLease, Mode, OperatorDecodeError, OperatorEvent};
pub use running::Running;
pub use tally::Tally;
