//! Taking 3D scans: stop, step the tilt, wait, file the line.
mod clock;
mod profile;
mod servo;
pub use clock::{ClockStep, StampClock};
pub use profile::{Clipped, FanConfig, Profile, QUARTER_DEGREE_RAD, QuarterDegrees};
pub use servo::{Demand, HINGE_GAP_RAD, ServoLaw, ServoState};
