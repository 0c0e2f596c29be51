//! The noise as a function of the range, from its variance in classes of range.

use super::noise::RangeNoise;

/// Smallest believed standard deviation in metres: what 32-bit points and printed decimals leave.
const FLOOR_M: f64 = 4e-4;

/// What one class of range tells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Class {
    /// Its middle.
    pub range_m: f64,
    /// Variance of a reading in m².
    pub variance: f64,
    /// Readings that tell it.
    pub samples: f64,
}

/// The simplest polynomial with non-negative factors that explains the classes.
///
/// Least squares of the relative error of the variance, over all subsets of the three terms; each
/// term has to earn its place. Classes above the model may be clutter, so they pull less.
pub(super) fn model(classes: &[Class]) -> RangeNoise {
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
