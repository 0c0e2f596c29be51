//! The sphere: an algebraic start, then Gauss-Newton on the distance.

use super::reach::are_within;
use super::round::{Round, RoundSums, sum_round};
use super::{CONVERGED, FEW_ROUNDS, Model, Phase, RAY_ROUNDS, Readings, STRAY};
use nalgebra::{Matrix4, Vector3, Vector4};

const ROUNDS: usize = 8;

/// A fitted sphere.
pub(in super::super) struct SphereFit {
    pub centre: Vector3<f64>,
    pub radius_m: f64,
    pub covariance: Matrix4<f64>,
}

impl SphereFit {
    pub fn model(&self) -> Model {
        Model::Sphere { centre: self.centre, radius_m: self.radius_m }
    }
}

/// Fits a sphere by errors across it; `None` where the readings lie in a plane or the iteration
/// leaves the region, or where the start has a radius far above `max_radius_m`.
pub(super) fn fit_sphere(readings: &Readings, max_radius_m: f64) -> Option<SphereFit> {
    let start = algebraic(readings, &readings.centroid())?;
    if start.1 > STRAY * max_radius_m {
        return None;
    }
    refine(readings, start, Phase::Start, ROUNDS)
}

/// Improves a sphere by a few rounds of errors across it.
pub(super) fn improve_sphere(readings: &Readings, start: (Vector3<f64>, f64)) -> Option<SphereFit> {
    refine(readings, start, Phase::Start, FEW_ROUNDS)
}

/// Settles a sphere that is nearly right by errors along the rays.
pub(super) fn settle_sphere(readings: &Readings, start: (Vector3<f64>, f64)) -> Option<SphereFit> {
    refine(readings, start, Phase::Rays, RAY_ROUNDS)
}

fn refine(
    readings: &Readings,
    (mut centre, mut radius_m): (Vector3<f64>, f64),
    mut phase: Phase,
    rounds: usize,
) -> Option<SphereFit> {
    // Rounds along the rays are so from the first one on.
    let hollow = phase == Phase::Rays && are_within(readings, &centre, &Vector3::zeros());
    let mut last = None;
    for round in 0..rounds {
        phase = Phase::of(round, rounds, phase);
        let stride = phase.stride(round, readings);
        let round = Round { hollow, ..round_of(&centre, radius_m) };
        let sums = sum_round::<4>(readings, round, phase, stride);
        let RoundSums { normal, square, count } = sums;
        let (normal, right) = (normal.normal(), normal.right());
        let Some(decomposed) = normal.cholesky() else { break };
        let correction = decomposed.solve(&right);
        centre += correction.xyz();
        radius_m += correction.w;
        if !(radius_m > 0.0 && radius_m < 1e3) {
            return None;
        }
        let left = (square - right.dot(&correction)).max(0.0);
        let mean_square = left / ((count - 4.0_f64).max(1.0) * phase.variance());
        last = Some((decomposed, mean_square.max(1.0)));
        let step = right.dot(&correction) / mean_square.max(1.0);
        if phase == Phase::Rays {
            // All readings had a say, and from within a deviation of the end one round leads to it.
            if stride == 1 && step < 1.0 {
                break;
            }
        } else if step < CONVERGED {
            let Some(next) = phase.next() else { break };
            phase = next;
        }
    }
    // Only that of the last round is asked for.
    let (decomposed, scale) = last?;
    let covariance = decomposed.inverse() * scale;
    Some(SphereFit { centre, radius_m, covariance })
}

/// A sphere as the rounds take it, seen from without.
pub(super) fn round_of(centre: &Vector3<f64>, radius_m: f64) -> Round {
    let sides = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    Round { foot: (*centre).into(), axis: [0.0; 3], radius_m, sides, hollow: false }
}

/// Least squares of `|p|² - 2 p·c + (|c|² - R²)`, which is linear; biased small on noisy caps, so
/// good as a start only.
fn algebraic(readings: &Readings, centroid: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let mut normal = Matrix4::<f64>::zeros();
    let mut right = Vector4::<f64>::zeros();
    for (p, ..) in readings.every(readings.start_stride()) {
        let d = p - centroid;
        let row = Vector4::new(2.0 * d.x, 2.0 * d.y, 2.0 * d.z, 1.0);
        normal += row * row.transpose();
        right += row * d.norm_squared();
    }
    let solution = normal.cholesky()?.solve(&right);
    let centre = solution.xyz();
    let radius = (solution.w + centre.norm_squared()).sqrt();
    radius.is_finite().then(|| (centre + centroid, radius))
}
