//! How noisy the ranges are, told from the scan itself.
//!
//! Along a lane the inverse range of a smooth surface hardly has a third difference: the angle
//! between neighbours is small, and the inverse range of a plane is linear in the ray's direction.
//! What is left of it is noise of known gain. Edges are outliers that a trimmed variance ignores.

use super::field::Field;
use serde::{Deserialize, Serialize};

/// Variance of a third difference of white noise of unit variance: 1 + 9 + 9 + 1.
const GAIN: f64 = 20.0;
/// Share of the samples, the smallest, that make the estimate: up to 40 % may be edges.
const KEPT: f64 = 0.6;
/// Variance of a standard normal variable that is cut at its KEPT quantile of size (0.8416).
const KEPT_VARIANCE: f64 = 0.2146;
/// The same for differences over wider pitches, up to 65 % of which may be edges.
const FAR_KEPT: f64 = 0.35;
const FAR_KEPT_VARIANCE: f64 = 0.0667;
/// Ratio of variances beyond which the wider pitch counts.
const MUCH_LARGER: f64 = 1.7;
/// Smallest believed standard deviation in metres: what 32-bit points and printed decimals leave.
pub(super) const FLOOR_M: f64 = 4e-4;
/// Classes of range in which the variance is estimated apart.
const RANGE_CLASSES: usize = 12;
/// Classes of size, eight to an octave, taken from the bits of a 32-bit float.
const SIZE_CLASSES: usize = 256;
const SIZE_SHIFT: u32 = 20;
/// Size class of 2^-24 m, the smallest that is told apart.
const FIRST_SIZE: u32 = (127 - 24) << 3;
/// Fewest samples that make a class of range count.
const FEWEST: f64 = 60.0;
/// About how many samples are taken of a scan.
const SAMPLES: usize = 10_000;

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

/// Buffers of the estimate.
#[derive(Clone, Debug)]
pub(super) struct NoiseEstimator {
    counts: Vec<[u32; SIZE_CLASSES]>,
    squares: Vec<[f32; SIZE_CLASSES]>,
    classes: Vec<Class>,
}

/// What one class of range tells.
#[derive(Clone, Copy, Debug)]
struct Class {
    range_m: f64,
    variance: f64,
    samples: f64,
}

impl Default for NoiseEstimator {
    fn default() -> Self {
        Self {
            counts: vec![[0; SIZE_CLASSES]; RANGE_CLASSES],
            squares: vec![[0.0; SIZE_CLASSES]; RANGE_CLASSES],
            classes: Vec::with_capacity(RANGE_CLASSES),
        }
    }
}

/// Cells apart, along and across, of the four readings of a third difference, and what is kept of
/// them.
#[derive(Clone, Copy, Debug)]
struct Probe {
    down: usize,
    right: usize,
    kept: f64,
    /// Variance of a standard normal variable that is cut at its `kept` quantile of size.
    kept_variance: f64,
}

impl NoiseEstimator {
    /// The noise of the ranges in a field. A scan without enough neighbours gets 10 mm.
    ///
    /// Readings of a real scanner err together: they are rounded, a row's tilt is off, a surface is
    /// rough on a scale of several cells. Next neighbours then agree better than a surface is known,
    /// so differences over a wider pitch along, and across, count where they are much larger. These
    /// cross more edges, and a smaller part of them is kept.
    pub fn estimate(&mut self, field: &Field) -> RangeNoise {
        let (mut nearest, mut farthest) = (f32::MAX, 0.0);
        for &range in &field.range {
            nearest = if range > 0.0 && range < nearest { range } else { nearest };
            farthest = if range > farthest { range } else { farthest };
        }
        let span = (nearest, RANGE_CLASSES as f32 / (farthest - nearest).max(1e-3));
        let pitch = ((field.across_rad / field.along_rad).round() as usize).clamp(3, 8);
        let near = Probe { down: 1, right: 0, kept: KEPT, kept_variance: KEPT_VARIANCE };
        let far = Probe { kept: FAR_KEPT, kept_variance: FAR_KEPT_VARIANCE, ..near };
        let near = self.measure(field, span, near);
        let along = self.measure(field, span, Probe { down: pitch, ..far });
        let across = self.measure(field, span, Probe { down: 0, right: 1, ..far });
        self.classes.clear();
        for class in 0..RANGE_CLASSES {
            if let Some(mut merged) = near[class] {
                for wider in [along[class], across[class]].into_iter().flatten() {
                    if wider.variance > MUCH_LARGER * near[class].map_or(0.0, |near| near.variance)
                    {
                        merged.variance = merged.variance.max(wider.variance);
                    }
                }
                self.classes.push(merged);
            }
        }
        model(&self.classes)
    }

    /// The variance in each class of range; `span` is the nearest range and classes per metre.
    fn measure(
        &mut self,
        field: &Field,
        (nearest, per_metre): (f32, f32),
        probe: Probe,
    ) -> [Option<Class>; RANGE_CLASSES] {
        self.counts.iter_mut().for_each(|class| class.fill(0));
        self.squares.iter_mut().for_each(|class| class.fill(0.0));
        let lanes = field.lanes;
        let stride = (field.len() / SAMPLES).max(1);
        let apart = probe.down * lanes + probe.right;
        let last = lanes.saturating_sub(3 * probe.right);
        for step in (0..field.steps.saturating_sub(3 * probe.down)).step_by(stride) {
            for lane in 0..last {
                let cell = step * lanes + lane;
                let [a, b, c, d] = [0, 1, 2, 3].map(|k| field.inverse[cell + k * apart]);
                if a * b * c * d == 0.0 {
                    continue;
                }
                let range = field.range[cell + apart];
                let third = (a - d) + 3.0 * (c - b);
                let error = third.abs() * range * range;
                let class = ((range - nearest) * per_metre) as usize;
                let class = class.min(RANGE_CLASSES - 1);
                let size = (error.to_bits() >> SIZE_SHIFT).saturating_sub(FIRST_SIZE) as usize;
                let size = size.min(SIZE_CLASSES - 1);
                self.counts[class][size] += 1;
                self.squares[class][size] += error * error;
            }
        }
        std::array::from_fn(|class| {
            let range_m = f64::from(nearest) + (class as f64 + 0.5) / f64::from(per_metre);
            let samples: u32 = self.counts[class].iter().sum();
            let samples = f64::from(samples);
            (samples >= FEWEST).then(|| {
                let (counts, squares) = (&self.counts[class], &self.squares[class]);
                let kept = trimmed_mean(counts, squares, samples, probe.kept);
                let variance = (kept / (probe.kept_variance * GAIN)).max(FLOOR_M * FLOOR_M);
                Class { range_m, variance, samples }
            })
        })
    }
}

/// Mean square of the `share` smallest errors.
fn trimmed_mean(
    counts: &[u32; SIZE_CLASSES],
    squares: &[f32; SIZE_CLASSES],
    samples: f64,
    share: f64,
) -> f64 {
    let mut left = share * samples;
    let mut sum = 0.0;
    for (&count, &square) in counts.iter().zip(squares) {
        if count == 0 {
            continue;
        }
        let part = (left / f64::from(count)).min(1.0);
        sum += part * f64::from(square);
        left -= part * f64::from(count);
        if left <= 0.0 {
            break;
        }
    }
    sum / (share * samples)
}

/// The simplest polynomial with non-negative factors that explains the classes.
///
/// Least squares of the relative error of the variance, over all subsets of the three terms; each
/// term has to earn its place. Classes above the model may be clutter, so they pull less.
fn model(classes: &[Class]) -> RangeNoise {
    if classes.is_empty() {
        return RangeNoise::uniform(0.01);
    }
    let mut best = (f64::INFINITY, RangeNoise::uniform(0.01));
    for subset in 1..8_u8 {
        let Some(noise) = fit_terms(classes, subset) else { continue };
        let cost: f64 = classes
            .iter()
            .map(|class| {
                let ratio = (class.variance / noise.variance(class.range_m)).ln();
                // A class of n samples knows its variance to about sqrt(5 / n); no better than 10 %.
                (ratio * ratio / (5.0 / class.samples + 0.01)).min(25.0)
            })
            .sum();
        let cost = cost + 6.0 * f64::from(subset.count_ones());
        if cost < best.0 {
            best = (cost, noise);
        }
    }
    best.1
}

/// Weighted least squares with the terms of `subset` (bits: constant, square, fourth); `None` where
/// a factor would be negative or cannot be told.
fn fit_terms(classes: &[Class], subset: u8) -> Option<RangeNoise> {
    let mut factors = [0.0; 3];
    let weights_from = |class: &Class, factors: &[f64; 3]| {
        let square = class.range_m * class.range_m;
        let noise = RangeNoise { constant: factors[0], square: factors[1], fourth: factors[2] };
        let expected = noise.variance(class.range_m);
        let scale = if expected > 0.0 { expected } else { class.variance };
        let excess = class.variance / scale;
        let trust = if excess > 1.5 { 1.5 / excess } else { 1.0 };
        let weight = trust * class.samples / (scale * scale);
        (weight, [1.0, square, square * square])
    };
    for _ in 0..4 {
        let mut normal = nalgebra::Matrix3::<f64>::zeros();
        let mut right = nalgebra::Vector3::<f64>::zeros();
        for class in classes {
            let (weight, terms) = weights_from(class, &factors);
            for i in 0..3 {
                right[i] += weight * terms[i] * class.variance;
                for j in 0..3 {
                    normal[(i, j)] += weight * terms[i] * terms[j];
                }
            }
        }
        for i in 0..3 {
            if subset & (1 << i) == 0 {
                normal.row_mut(i).fill(0.0);
                normal.column_mut(i).fill(0.0);
                normal[(i, i)] = 1.0;
                right[i] = 0.0;
            }
        }
        // The terms differ by orders of magnitude: scale the diagonal to one.
        let scale = normal.diagonal().map(|d| 1.0 / d.sqrt());
        let scaled = nalgebra::Matrix3::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
        let solution = scaled.cholesky()?.solve(&right.component_mul(&scale)).component_mul(&scale);
        factors = [solution[0], solution[1], solution[2]];
        if factors.iter().any(|factor| factor.is_nan() || *factor < 0.0) {
            return None;
        }
    }
    let noise = RangeNoise { constant: factors[0], square: factors[1], fourth: factors[2] };
    Some(RangeNoise { constant: noise.constant.max(FLOOR_M * FLOOR_M), ..noise })
}
