//! How much of a turn by the wheels the robot makes: skid-steered wheels count turns that the ground gives
//! them only in part.

use serde::{Deserialize, Serialize};

/// How much of the turns that the wheels count the robot makes, as long as an inertial unit tells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Grip {
    by_wheels_rad: f64,
    told_rad: f64,
}

impl Grip {
    /// Turns by the wheels that must have been seen, and those of which half is forgotten, in radians.
    const PROOF_RAD: f64 = 1.5;
    const LONG_RAD: f64 = 20.0;
    /// Least turn of one increment that says anything, in radians.
    const TURNING_RAD: f64 = 0.01;
    /// Shares that are believed.
    const LEAST: f64 = 0.2;
    const MOST: f64 = 1.5;

    /// Takes in a turn as the wheels count it and as the unit tells it.
    pub(super) fn learn(&mut self, by_wheels_rad: f64, told_rad: f64) {
        if by_wheels_rad.abs() < Self::TURNING_RAD {
            return;
        }
        if self.by_wheels_rad > Self::LONG_RAD {
            self.by_wheels_rad *= 0.5;
            self.told_rad *= 0.5;
        }
        self.by_wheels_rad += by_wheels_rad.abs();
        self.told_rad += told_rad * by_wheels_rad.signum();
    }

    /// The share that the robot makes of a turn by the wheels; all of it while that is not known.
    pub(super) fn share(&self) -> f64 {
        if self.by_wheels_rad < Self::PROOF_RAD {
            return 1.0;
        }
        (self.told_rad / self.by_wheels_rad).clamp(Self::LEAST, Self::MOST)
    }
}
