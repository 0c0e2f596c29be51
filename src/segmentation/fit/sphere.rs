//! The sphere: an algebraic start, then Gauss-Newton on the distance.

use super::{GATE, GATED_VARIANCE, LEAST_COSINE, Model, RIM_COSINE, Readings, stride_until};
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

/// Fits a sphere; `None` where the readings lie in a plane or the iteration leaves the region.
pub(in super::super) fn fit_sphere(readings: &Readings) -> Option<SphereFit> {
    let centroid = readings.centroid();
    let (mut centre, mut radius_m) = algebraic(readings, &centroid)?;
    let mut fit = None;
    // First without a gate, until it has converged or for half the rounds; then with it.
    let mut gate = f64::INFINITY;
    for round in 0..ROUNDS {
        if round == ROUNDS / 2 {
            gate = GATE;
        }
        let mut normal = Matrix4::<f64>::zeros();
        let mut right = Vector4::<f64>::zeros();
        let (mut square, mut count) = (0.0, 0.0);
        for i in (0..readings.len()).step_by(stride_until(gate, readings)) {
            let radial = readings.points[i] - centre;
            let length = radial.norm().max(1e-9);
            let n = radial / length;
            let cosine = n.dot(&readings.rays[i]).abs();
            if gate.is_finite() && cosine < RIM_COSINE {
                continue;
            }
            let cosine = cosine.max(LEAST_COSINE);
            let scale = 1.0 / (readings.sigmas[i] * cosine);
            // An error along the ray also leads away from the surface that bends back from it.
            let sigma = readings.sigmas[i];
            let bend = 0.5 * sigma * sigma * (1.0 - cosine * cosine) / length;
            let e = (length - radius_m - bend) * scale;
            if e.abs() > gate {
                continue;
            }
            // Derivative of the distance: -n for the centre, -1 for the radius.
            let j = Vector4::new(n.x, n.y, n.z, 1.0) * scale;
            normal += j * j.transpose();
            right += j * e;
            square += e * e;
            count += 1.0;
        }
        let inverse = normal.cholesky()?.inverse();
        let correction = inverse * right;
        centre += correction.xyz();
        radius_m += correction.w;
        if !(radius_m > 0.0 && radius_m < 1e3) {
            return None;
        }
        let left = (square - right.dot(&correction)).max(0.0);
        let expected = if gate.is_finite() { GATED_VARIANCE } else { 1.0 };
        let mean_square = left / ((count - 4.0_f64).max(1.0) * expected);
        fit = Some(inverse * mean_square.max(1.0));
        // A step of a hundredth of its standard deviation.
        if right.dot(&correction) < 1e-4 * mean_square.max(1.0) {
            if gate.is_finite() {
                break;
            }
            gate = GATE;
        }
    }
    Some(SphereFit { centre, radius_m, covariance: fit? })
}

/// Least squares of `|p|² - 2 p·c + (|c|² - R²)`, which is linear; biased small on noisy caps, so
/// good as a start only.
fn algebraic(readings: &Readings, centroid: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
    let mut normal = Matrix4::<f64>::zeros();
    let mut right = Vector4::<f64>::zeros();
    for p in &readings.points {
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
