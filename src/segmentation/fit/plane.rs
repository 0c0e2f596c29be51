//! The plane: weighted least squares of the distance, with its covariance.

use super::{GATE, GATED_VARIANCE, LEAST_COSINE, Model, Readings};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Standard deviation beyond which a rotation says nothing, in radians: what a region one line wide
/// gets about that line.
const FREE_ROTATION_RAD: f64 = 1.0;
/// Rounds of reweighting; the second changes the result by less than a tenth of its deviation.
const ROUNDS: usize = 3;
/// Fewest core readings, and their least share, for which the border readings can be spared.
const FEWEST_CORE: usize = 12;
const LEAST_CORE_SHARE: f64 = 0.3;

/// A plane with its local frame: z along the normal towards the sensor, x and y along the principal
/// axes of the points, the origin under their centroid.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct PlaneFit {
    pub grid_from_plane: Isometry3<f64>,
    /// Offset along z, rotation about y, rotation about x.
    pub covariance: Matrix3<f64>,
    /// Mean square of the errors of the readings used, in units of their noise.
    pub mean_square: f64,
    /// Number of readings used.
    pub inliers: usize,
}

impl PlaneFit {
    pub fn model(&self) -> Model {
        let normal = self.grid_from_plane.rotation * Vector3::z();
        Model::Plane { normal, offset_m: normal.dot(&self.grid_from_plane.translation.vector) }
    }
}

/// Fits a plane; `None` for readings that span no line.
///
/// Weighted least squares in the local frame, whose unknowns are the offset and the two rotations:
/// a point at local (x, y) moves by `δz - θ x + ψ y`. The inverse of the normal matrix is the
/// covariance (domain notes 3.4, for unequal weights). Where the readings scatter more than their
/// noise says, the covariance is scaled up by what they show, never down.
pub(in super::super) fn fit_plane(readings: &Readings) -> Option<PlaneFit> {
    let mut frame = principal_frame(readings)?;
    let use_core = {
        let core = readings.core.iter().filter(|&&core| core).count();
        core >= FEWEST_CORE && core as f64 >= LEAST_CORE_SHARE * readings.len() as f64
    };
    let mut fit = None;
    for round in 0..ROUNDS {
        let gate = if round == 0 { f64::INFINITY } else { GATE };
        let sums = accumulate(readings, &frame, use_core, gate);
        let (normal, right, square, inliers) = sums;
        if inliers < 3 {
            return None;
        }
        // What no reading fixes stays where it is: a prior of one radian.
        let prior = 1.0 / (FREE_ROTATION_RAD * FREE_ROTATION_RAD);
        let information = normal + Matrix3::from_diagonal(&Vector3::new(0.0, prior, prior));
        let inverse = information.cholesky()?.inverse();
        let correction = inverse * right;
        frame = moved(&frame, &correction);
        let left = (square - right.dot(&correction)).max(0.0);
        let freedom = (inliers as f64 - 3.0).max(1.0);
        let expected = if round == 0 { 1.0 } else { GATED_VARIANCE };
        let mean_square = left / (freedom * expected);
        fit = Some((inverse * mean_square.max(1.0), mean_square, inliers));
    }
    let (covariance, mean_square, inliers) = fit?;
    let (frame, covariance) = facing_the_sensor(frame, covariance);
    let mut frame = frame;
    // The centroid's foot on the final plane is the origin; in-plane shifts are below the noise.
    let normal = frame.rotation * Vector3::z();
    let centroid = readings.centroid();
    let gap = normal.dot(&(centroid - frame.translation.vector));
    let origin = centroid - normal * gap;
    let shift = frame.inverse_transform_vector(&(origin - frame.translation.vector));
    let covariance = moved_covariance(&covariance, &shift);
    frame.translation = Translation3::from(origin);
    Some(PlaneFit { grid_from_plane: frame, covariance, mean_square, inliers })
}

type Sums = (Matrix3<f64>, Vector3<f64>, f64, usize);

/// Normal matrix, right side, sum of squares and count of the readings within the gate.
fn accumulate(readings: &Readings, frame: &Isometry3<f64>, use_core: bool, gate: f64) -> Sums {
    let rotation = frame.rotation.to_rotation_matrix();
    let (ex, ey, ez) = (rotation * Vector3::x(), rotation * Vector3::y(), rotation * Vector3::z());
    let origin = frame.translation.vector;
    let (mut s, mut r) = ([0.0; 6], [0.0; 3]);
    let (mut square, mut count) = (0.0, 0);
    for i in 0..readings.len() {
        if use_core && !readings.core[i] {
            continue;
        }
        let d = readings.points[i] - origin;
        let cosine = ez.dot(&readings.rays[i]).abs().max(LEAST_COSINE);
        let scale = 1.0 / (readings.sigmas[i] * cosine);
        let e = ez.dot(&d) * scale;
        if e.abs() > gate {
            continue;
        }
        let (jx, jy) = (-ex.dot(&d) * scale, ey.dot(&d) * scale);
        for (sum, value) in
            s.iter_mut().zip([scale * scale, scale * jx, scale * jy, jx * jx, jx * jy, jy * jy])
        {
            *sum += value;
        }
        for (sum, value) in r.iter_mut().zip([scale * e, jx * e, jy * e]) {
            *sum += value;
        }
        square += e * e;
        count += 1;
    }
    let normal = Matrix3::new(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]);
    (normal, Vector3::from(r), square, count)
}

/// The same plane with its z axis towards the origin: half a turn about x where it looks away.
fn facing_the_sensor(
    frame: Isometry3<f64>,
    covariance: Matrix3<f64>,
) -> (Isometry3<f64>, Matrix3<f64>) {
    if (frame.rotation * Vector3::z()).dot(&frame.translation.vector) <= 0.0 {
        return (frame, covariance);
    }
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let signs = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    (frame * half_turn, signs * covariance * signs)
}

/// The frame after a perturbation (offset along z, rotation about y, rotation about x).
fn moved(frame: &Isometry3<f64>, correction: &Vector3<f64>) -> Isometry3<f64> {
    let rotation =
        UnitQuaternion::from_scaled_axis(Vector3::new(correction[2], correction[1], 0.0));
    frame * Isometry3::from_parts(Translation3::new(0.0, 0.0, correction[0]), rotation)
}

/// The covariance of the offset at a point `shift` away in the local frame.
fn moved_covariance(covariance: &Matrix3<f64>, shift: &Vector3<f64>) -> Matrix3<f64> {
    let jacobian = Matrix3::new(1.0, -shift.x, shift.y, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    jacobian * covariance * jacobian.transpose()
}

/// The principal frame of the points, z towards the sensor.
///
/// Where the points lie on one line within their noise, all planes through it fit. Then the one
/// that faces the sensor most is taken: the eigenvectors across the line are noise, and a plane
/// along the rays would explain any scatter.
fn principal_frame(readings: &Readings) -> Option<Isometry3<f64>> {
    if readings.len() < 3 {
        return None;
    }
    let centroid = readings.centroid();
    let eigen = readings.covariance(&centroid).symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]).then(a.cmp(&b)));
    let [greatest, middle, _] = order.map(|i| eigen.eigenvalues[i].max(0.0));
    let noise = readings.sigmas.iter().map(|s| s * s).sum::<f64>() / readings.len() as f64;
    // One centimetre in ten kilometres: points that are all the same.
    if greatest.is_nan() || greatest <= 1e-12 * centroid.norm_squared() {
        return None;
    }
    let ex = largest_positive(eigen.eigenvectors.column(order[0]).into_owned());
    let towards = -centroid;
    let mut ez = if middle <= 4.0 * noise {
        towards - ex * ex.dot(&towards)
    } else {
        eigen.eigenvectors.column(order[2]).into_owned()
    };
    if ez.norm_squared() <= 1e-12 * towards.norm_squared() {
        ez = eigen.eigenvectors.column(order[2]).into_owned();
    }
    let ez = (ez - ex * ex.dot(&ez)).normalize();
    let ez = if ez.dot(&towards) < 0.0 { -ez } else { ez };
    let rotation =
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[ex, ez.cross(&ex), ez]));
    Some(Isometry3::from_parts(
        Translation3::from(centroid),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

/// The vector or its opposite: the one whose largest component is positive.
pub(super) fn largest_positive(v: Vector3<f64>) -> Vector3<f64> {
    let largest = v.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    if largest < 0.0 { -v } else { v }
}
