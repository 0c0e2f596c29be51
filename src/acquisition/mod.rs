//! Taking 3D scans: stop, step the tilt, wait, file the line.
mod servo;
pub use servo::{Demand, HINGE_GAP_RAD, ServoLaw, ServoState};
