//! What an inertial unit's angles are off by.
//!
//! USARSim's unit adds up the changes of each angle and errs by 5 % of every step of them (protocol
//! reference, section 5.2): each kerb and ramp leaves it some milliradians further off, for good. Where planes
//! have told the robot's attitude better than the unit can, what it reads there is off by the difference, and
//! so is what it reads next.

use super::motion::BodyAttitude;
use crate::geometry::wrap_pi;
use serde::{Deserialize, Serialize};

/// Standard deviation of roll and pitch up to which a pose tells the unit's error, in radians: less than the
/// unit's own resolution of a hundredth.
const WELL_KNOWN_RAD: f64 = 0.003;

/// The error as last told, and what may have been added to it since.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct LevelDrift {
    roll_rad: f64,
    pitch_rad: f64,
    heading_rad: f64,
    /// Sum of the squared steps of both angles since the error was told, in rad².
    steps_rad2: f64,
    last: Option<BodyAttitude>,
}

impl LevelDrift {
    /// Takes note of a reading as the unit gives it.
    pub(super) fn note(&mut self, read: BodyAttitude) {
        if let Some(last) = self.last.replace(read) {
            let steps = [read.roll_rad - last.roll_rad, read.pitch_rad - last.pitch_rad];
            self.steps_rad2 += steps.map(|step| step * step).iter().sum::<f64>();
        }
    }

    /// A reading without the unit's error.
    pub(super) fn corrected(&self, read: &BodyAttitude) -> BodyAttitude {
        BodyAttitude {
            roll_rad: read.roll_rad - self.roll_rad,
            pitch_rad: read.pitch_rad - self.pitch_rad,
            heading_rad: wrap_pi(read.heading_rad - self.heading_rad),
        }
    }

    /// Standard deviation of roll and pitch that the steps since have added, of which each errs by
    /// `step_share`, in radians.
    pub(super) fn sigma_rad(&self, step_share: f64) -> f64 {
        step_share * self.steps_rad2.sqrt()
    }

    /// Takes the heading of `known` for that at the last reading, and its roll and pitch if they are known to
    /// `sigma_rad` well enough for that.
    pub(super) fn settle(&mut self, known: &BodyAttitude, sigma_rad: f64) {
        let Some(read) = self.last else { return };
        self.heading_rad = wrap_pi(read.heading_rad - known.heading_rad);
        if sigma_rad > WELL_KNOWN_RAD {
            return;
        }
        self.roll_rad = read.roll_rad - known.roll_rad;
        self.pitch_rad = read.pitch_rad - known.pitch_rad;
        self.steps_rad2 = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_heading_is_always_taken_over() {
        let mut drift = LevelDrift::default();
        let turned = |heading_rad| BodyAttitude { heading_rad, ..BodyAttitude::default() };
        drift.note(turned(3.1));
        drift.settle(&turned(-3.13), f64::INFINITY);
        let now = drift.corrected(&turned(-3.1)).heading_rad;
        assert!((now - wrap_pi(-3.13 + (std::f64::consts::TAU - 6.2))).abs() < 1e-12, "{now}");
    }

    fn pitched(pitch_rad: f64) -> BodyAttitude {
        BodyAttitude { pitch_rad, ..BodyAttitude::default() }
    }

    #[test]
    fn what_a_ramp_has_added_is_taken_off_once_planes_have_told_it() {
        let mut drift = LevelDrift::default();
        drift.note(pitched(0.0));
        // Up a ramp of 0.2 rad and down again, read 5 % too large on the way up.
        drift.note(pitched(-0.21));
        drift.note(pitched(-0.01));
        assert_eq!(drift.corrected(&pitched(-0.01)), pitched(-0.01));
        assert!(drift.sigma_rad(0.05) > 0.01);
        drift.settle(&pitched(0.0), 0.02);
        assert_eq!(drift.corrected(&pitched(-0.01)), pitched(-0.01), "nobody knows better");
        drift.settle(&pitched(0.0), 0.0005);
        assert_eq!(drift.corrected(&pitched(-0.11)), pitched(-0.1));
        assert_eq!(drift.sigma_rad(0.05), 0.0);
    }
}
