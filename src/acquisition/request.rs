//! What sweep to take, and how the tilt is moved along it.

use super::config::AcquisitionConfig;
use super::profile::Profile;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Seconds between the rows of the paper's real robot: its 55° take 19.2 s at 0.05 rad/s, and of 70 rows
/// the first lies at one end and the last at the other.
pub const CONTINUOUS_CYCLE_S: f64 = 55.0 * PI / 180.0 / 0.05 / 69.0;

/// A sweep to be taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepRequest {
    /// The tilts. Rows out of the link's reach are cut off with a remark; the sweep begins at the end
    /// nearer to where the tilt is.
    pub profile: Profile,
    /// Where the pan is held, in radians, left positive.
    pub pan_rad: f64,
    /// How the tilt is moved along the rows.
    pub mode: SweepMode,
}

/// How the tilt is moved along the rows of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SweepMode {
    /// It rests at every row, at most this far off the demanded angle in radians, and the row is
    /// filed under the demanded angle: the paper's way in the simulator.
    Settled {
        /// Radians, above 0.
        tolerance_rad: f64,
    },
    /// It never rests, and each row is filed under the angle at which it was taken. Needs a
    /// calibrated head; a head that is not takes the rows at the coarse tolerance instead.
    Flowing,
    /// The same while the robot drives slowly: rows are displaced by how the body moved, as
    /// [`super::Acquisition::moved`] tells it. The rows are taken in the profile's order. A head that is not
    /// calibrated cannot.
    Nodding,
    /// It turns at a constant rate: the paper's way on the real robot. Where the server knows no
    /// rates, behind a set-point that does.
    Continuous {
        /// Radians per second, above 0.
        rate_rad_s: f64,
        /// Seconds between rows; 0 keeps every line.
        cycle_s: f64,
    },
}

impl SweepRequest {
    /// The paper's full sweep, at its tolerance.
    pub fn paper(config: &AcquisitionConfig) -> Self {
        let tolerance_rad = config.tolerance_deg.to_radians();
        let mode = SweepMode::Settled { tolerance_rad };
        Self { profile: Profile::paper_full(), pan_rad: 0.0, mode }
    }

    /// The paper's full sweep with motion and laser overlapped.
    pub fn model() -> Self {
        let profile = Profile { name: "model".into(), ..Profile::paper_full() };
        Self { profile, pan_rad: 0.0, mode: SweepMode::Flowing }
    }

    /// The paper's real robot (section VI): 0.05 rad/s and 70 rows.
    pub fn continuous() -> Self {
        let profile = Profile { name: "continuous".into(), ..Profile::paper_full() };
        let mode = SweepMode::Continuous { rate_rad_s: 0.05, cycle_s: CONTINUOUS_CYCLE_S };
        Self { profile, pan_rad: 0.0, mode }
    }

    /// A coarse sweep for exploration: `profile` at the coarse tolerance.
    pub fn coarse(profile: Profile, config: &AcquisitionConfig) -> Self {
        let tolerance_rad = config.coarse_tolerance_deg.to_radians();
        Self { profile, pan_rad: 0.0, mode: SweepMode::Settled { tolerance_rad } }
    }

    /// `profile` with motion and laser overlapped.
    pub fn flowing(profile: Profile) -> Self {
        Self { profile, pan_rad: 0.0, mode: SweepMode::Flowing }
    }

    /// `profile` taken on the way.
    pub fn nodding(profile: Profile) -> Self {
        Self { profile, pan_rad: 0.0, mode: SweepMode::Nodding }
    }

    /// The same with the pan held at `pan_rad`.
    #[must_use]
    pub fn at_pan(self, pan_rad: f64) -> Self {
        Self { pan_rad, ..self }
    }
}
