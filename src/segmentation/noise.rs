//! What the readings of a scan err by.

use crate::scan::Rounding;
use serde::{Deserialize, Serialize};

/// Most that common errors add to a sum of squares, per reading: two standard deviations.
const COMMON_RISE: f64 = 4.0;

/// Variance of a range reading as a polynomial of the range: `constant + square r² + fourth r⁴`.
///
/// A constant fits a time-of-flight laser, r² a reading with relative noise (USARSim's laser), r⁴ a
/// triangulating camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeNoise {
    /// Part that does not depend on range, in m².
    pub constant: f64,
    /// Factor of the square of the range, without unit.
    pub square: f64,
    /// Factor of the fourth power of the range, in 1/m².
    pub fourth: f64,
}

impl RangeNoise {
    /// The same standard deviation at all ranges, in metres.
    pub fn uniform(sigma_m: f64) -> Self {
        Self { constant: sigma_m * sigma_m, square: 0.0, fourth: 0.0 }
    }

    /// Variance of a reading of `range_m`, in m².
    pub fn variance(&self, range_m: f64) -> f64 {
        let square = range_m * range_m;
        self.constant + square * (self.square + square * self.fourth)
    }

    /// Standard deviation of a reading of `range_m`, in metres.
    pub fn sigma_m(&self, range_m: f64) -> f64 {
        self.variance(range_m).sqrt()
    }

    /// The model with all variances multiplied.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            constant: self.constant * factor,
            square: self.square * factor,
            fourth: self.fourth * factor,
        }
    }
}

/// What the readings of a scan err by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReadingErrors {
    /// Variance of the ranges.
    pub noise: RangeNoise,
    /// Standard deviation of the rays' angles in the finer direction, in radians: what the tilt of a
    /// nodding scanner is off by. Zero where it does not show.
    pub angle_rad: f64,
    /// Share of the variance that neighbouring readings have in common, 0 to 1: it does not average
    /// out over a few of them.
    pub common: f64,
    /// Readings along the finer direction that tell as much as one whose error is its own, 1 or more.
    pub run: f64,
    /// The same over an area, 1 or more.
    pub patch: f64,
    /// Factor of the fits' covariances, 1 or more: `patch`, but for what cut ranges have in common, which
    /// whoever has the readings tells better patch by patch.
    pub inflation: f64,
}

impl Default for ReadingErrors {
    fn default() -> Self {
        Self::independent(RangeNoise::default())
    }
}

impl ReadingErrors {
    /// Errors of which each reading has its own.
    pub fn independent(noise: RangeNoise) -> Self {
        Self { noise, angle_rad: 0.0, common: 0.0, run: 1.0, patch: 1.0, inflation: 1.0 }
    }

    /// The errors where ranges are cut to a grid, of which `run` readings along and `patch` over an area
    /// agree on average: these agree better than any of them is known. The share that they have in common
    /// is told at `range_m`.
    #[must_use]
    pub fn cut(mut self, rounding: &Rounding, (run, patch): (f64, f64), range_m: f64) -> Self {
        let variance = rounding.sigma_m().powi(2);
        self.noise.constant = self.noise.constant.max(variance);
        self.common = self.common.max(variance / self.noise.variance(range_m));
        self.run = self.run.max(run);
        self.patch = self.patch.max(patch);
        self
    }

    /// Variance of the mean of `n` neighbouring readings, in units of that of one.
    pub fn mean_variance(&self, n: f64) -> f64 {
        (1.0 - self.common) / n + self.common
    }

    /// Rise of a sum of squares, in units of the noise, that `rise` is worth where errors are each
    /// reading's own; `n` is the number of readings. Common errors are of the size of one reading's
    /// each, whatever the number of patches.
    pub fn price(&self, rise: f64, n: f64) -> f64 {
        rise + (rise * (self.patch - 1.0)).min(COMMON_RISE * self.common * n)
    }
}
