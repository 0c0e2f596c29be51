//! The circular cylinder of any axis: starts from candidate axes, then Gauss-Newton on the distance.

use super::plane::largest_positive;
use super::reach::are_within;
use super::round::{Round, RoundSums, sum_round};
use super::{CONVERGED, FEW_ROUNDS, Model, Phase, RAY_ROUNDS, Readings, STRAY};
use nalgebra::{Matrix3, Matrix5, Vector3};

const ROUNDS: usize = 10;

/// A fitted cylinder.
pub(in super::super) struct CylinderFit {
    /// The point of the axis nearest to the centroid of the readings.
    pub foot: Vector3<f64>,
    pub axis: Vector3<f64>,
    pub radius_m: f64,
    pub covariance: Matrix5<f64>,
}

impl CylinderFit {
    pub fn model(&self) -> Model {
        Model::Cylinder { foot: self.foot, axis: self.axis, radius_m: self.radius_m }
    }
}

/// Fits a cylinder by errors across it from the best of the candidate axes; `None` where none leads
/// anywhere, or the best start has a radius far above `max_radius_m`.
pub(super) fn fit_cylinder(
    readings: &Readings,
    axes: &[Vector3<f64>],
    max_radius_m: f64,
) -> Option<CylinderFit> {
    let centroid = readings.centroid();
    let start = axes
        .iter()
        .filter_map(|axis| circle_across(readings, &centroid, axis))
        .min_by(|a, b| a.mean_square.total_cmp(&b.mean_square))
        .filter(|start| start.radius_m <= STRAY * max_radius_m)?;
    refine(readings, &centroid, start, Phase::Start, ROUNDS)
}

/// Improves a cylinder by a few rounds of errors across it.
pub(super) fn improve_cylinder(
    readings: &Readings,
    model: (Vector3<f64>, Vector3<f64>, f64),
) -> Option<CylinderFit> {
    let centroid = readings.centroid();
    refine(readings, &centroid, Start::at(&centroid, model), Phase::Start, FEW_ROUNDS)
}

/// Settles a cylinder that is nearly right by errors along the rays.
pub(super) fn settle_cylinder(
    readings: &Readings,
    model: (Vector3<f64>, Vector3<f64>, f64),
) -> Option<CylinderFit> {
    let centroid = readings.centroid();
    refine(readings, &centroid, Start::at(&centroid, model), Phase::Rays, RAY_ROUNDS)
}

struct Start {
    axis: Vector3<f64>,
    foot: Vector3<f64>,
    radius_m: f64,
    mean_square: f64,
}

impl Start {
    /// A cylinder with its foot next to the centroid.
    fn at(
        centroid: &Vector3<f64>,
        (foot, axis, radius_m): (Vector3<f64>, Vector3<f64>, f64),
    ) -> Self {
        let foot = foot + axis * axis.dot(&(centroid - foot));
        Self { axis, foot, radius_m, mean_square: 0.0 }
    }
}

/// Two unit vectors that complete `axis` to a frame: the first is `axis × e`, with `e` the
/// coordinate axis that `axis` has least of, the second `axis ×` the first.
pub(in super::super) fn across(axis: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let least = axis.iamin();
    let mut helper = Vector3::zeros();
    helper[least] = 1.0;
    let e1 = axis.cross(&helper).normalize();
    (e1, axis.cross(&e1))
}

/// The circle through the readings seen along `axis`, algebraically.
fn circle_across(
    readings: &Readings,
    centroid: &Vector3<f64>,
    axis: &Vector3<f64>,
) -> Option<Start> {
    let axis = axis.try_normalize(1e-9)?;
    let (e1, e2) = across(&axis);
    let mut normal = Matrix3::<f64>::zeros();
    let mut right = Vector3::<f64>::zeros();
    let points = || readings.every(readings.start_stride()).map(|(p, ..)| p);
    for p in points() {
        let d = p - centroid;
        let (a, b) = (e1.dot(&d), e2.dot(&d));
        let row = Vector3::new(2.0 * a, 2.0 * b, 1.0);
        normal += row * row.transpose();
        right += row * (a * a + b * b);
    }
    let solution = normal.cholesky()?.solve(&right);
    let radius_m = (solution.z + solution.x * solution.x + solution.y * solution.y).sqrt();
    let foot = centroid + e1 * solution.x + e2 * solution.y;
    let model = Model::Cylinder { foot, axis, radius_m };
    let mean_square = points().map(|p| model.distance(&p).0.powi(2)).sum::<f64>();
    mean_square.is_finite().then_some(Start { axis, foot, radius_m, mean_square })
}

/// A cylinder as the rounds take it, seen from without.
pub(super) fn round_of(foot: &Vector3<f64>, axis: &Vector3<f64>, radius_m: f64) -> Round {
    let (e1, e2) = across(axis);
    let sides = [e1.into(), e2.into(), [0.0; 3]];
    Round { foot: (*foot).into(), axis: (*axis).into(), radius_m, sides, hollow: false }
}

fn refine(
    readings: &Readings,
    centroid: &Vector3<f64>,
    start: Start,
    mut phase: Phase,
    rounds: usize,
) -> Option<CylinderFit> {
    let Start { mut axis, mut foot, mut radius_m, .. } = start;
    // Rounds along the rays are so from the first one on.
    let hollow = phase == Phase::Rays && are_within(readings, &foot, &axis);
    let mut last = None;
    for round in 0..rounds {
        phase = Phase::of(round, rounds, phase);
        let stride = phase.stride(round, readings);
        axis = largest_positive(axis);
        let (e1, e2) = across(&axis);
        let round = Round { hollow, ..round_of(&foot, &axis, radius_m) };
        let RoundSums { normal, square, count } = sum_round::<5>(readings, round, phase, stride);
        let (normal, right) = (normal.normal(), normal.right());
        let Some(decomposed) = normal.cholesky() else { break };
        let correction = decomposed.solve(&right);
        foot += e1 * correction[0] + e2 * correction[1];
        axis = (axis + e1 * correction[2] + e2 * correction[3]).normalize();
        foot += axis * axis.dot(&(centroid - foot));
        radius_m += correction[4];
        if !(radius_m > 0.0 && radius_m < 1e3) {
            return None;
        }
        let left = (square - right.dot(&correction)).max(0.0);
        let mean_square = left / ((count - 5.0_f64).max(1.0) * phase.variance());
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
    Some(CylinderFit { foot, axis, radius_m, covariance })
}
