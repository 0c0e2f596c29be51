//! The plane: weighted least squares of the ranges, with its covariance.

use super::super::moments::Moments;
use super::sums::{PlaneSums, Reference, place};
use super::{GATED_VARIANCE, Model, Readings};
use nalgebra::{
    Isometry3, Matrix2, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};

/// Standard deviation beyond which a rotation says nothing, in radians: what a region one line wide
/// gets about that line.
const FREE_ROTATION_RAD: f64 = 1.0;

/// A plane with its local frame: z along the normal towards the sensor, x and y along the principal
/// axes of the points, the origin under their centroid.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct PlaneFit {
    pub grid_from_plane: Isometry3<f64>,
    /// Offset along z, rotation about y, rotation about x.
    pub covariance: Matrix3<f64>,
    /// Lesser extent of the readings in metres.
    pub width_m: f64,
    /// Standard deviation of a reading, root mean square, in metres.
    pub sigma_m: f64,
    /// Mean square of the distance of all readings from the plane, in m².
    pub square_m2: f64,
}

impl PlaneFit {
    /// Its normal n and offset d: `n · p = d`.
    pub fn equation(&self) -> (Vector3<f64>, f64) {
        let normal = self.grid_from_plane.rotation * Vector3::z();
        (normal, normal.dot(&self.grid_from_plane.translation.vector))
    }

    pub fn model(&self) -> Model {
        let (normal, offset_m) = self.equation();
        Model::Plane { normal, offset_m }
    }
}

/// Centroid of all readings.
pub(in super::super) fn centroid_of(sums: &PlaneSums) -> Vector3<f64> {
    let n = sums.readings.max(1) as f64;
    let Reference { sides: [first, second], foot, .. } = sums.reference;
    let t = &sums.totals;
    // A reading is its place on the plane, and beyond it by its error.
    let (u, v) = (t[place::D] + t[place::SD], t[place::D + 1] + t[place::SD + 1]);
    foot + (first * u + second * v + foot * t[place::S]) / n
}

/// The plane that follows from the sums of a region; `None` for readings that span no line.
///
/// In the local frame the unknowns are the offset and the two rotations: a point at local (x, y)
/// moves by `δz - θ x + ψ y`. A reading errs across the plane by its range noise times the cosine of
/// incidence, which is the plane's offset over the range. The inverse of the normal matrix is the
/// covariance (domain notes 3.4, for unequal weights). Where the readings scatter more than their
/// noise says, it is scaled up by what they show, never down.
pub(in super::super) fn plane_of(sums: &PlaneSums) -> Option<PlaneFit> {
    let t = &sums.totals;
    let (inliers, n) = (t[place::INLIERS], sums.readings as f64);
    let Reference { offset_m, .. } = sums.reference;
    if inliers < 3.0 || offset_m.is_nan() {
        return None;
    }
    let Frame { frame, turn, middle } = frame_of(sums)?;
    let axes = Axes { turn, offset_m };
    let (information, right) = axes.equations(t);
    let covariance = (information + prior()).cholesky()?.inverse();
    let correction = covariance * right;
    let left = (t[place::WSS] - right.dot(&correction)).max(0.0);
    let mean_square = left / ((inliers - 3.0).max(1.0) * GATED_VARIANCE);
    let square = offset_m * offset_m * t[place::SS]
        - 2.0 * offset_m * axes.side(t, place::S, place::SD).dot(&correction)
        + correction.dot(&(axes.form(t, n, place::D, place::DD) * correction));
    let noise = mean_square_range(sums) * n / t[place::GAIN];
    let mut frame = moved(&frame, &correction);
    // The centroid's foot on the plane is the origin.
    let normal = frame.rotation * Vector3::z();
    let centroid = centroid_of(sums);
    let gap = normal.dot(&(centroid - frame.translation.vector));
    let origin = centroid - normal * gap;
    let shift = frame.inverse_transform_vector(&(origin - frame.translation.vector));
    let covariance = moved_covariance(&(covariance * mean_square.max(1.0)), &shift);
    frame.translation = Translation3::from(origin);
    Some(PlaneFit {
        grid_from_plane: frame,
        covariance,
        width_m: (12.0 * middle).sqrt(),
        sigma_m: noise.sqrt(),
        square_m2: (square / n).max(0.0),
    })
}

/// What no reading fixes stays where it is: information of a prior of one radian.
pub(super) fn prior() -> Matrix3<f64> {
    let prior = 1.0 / (FREE_ROTATION_RAD * FREE_ROTATION_RAD);
    Matrix3::from_diagonal(&Vector3::new(0.0, prior, prior))
}

/// The axes of a plane's frame, as they are carried to the sums over its readings.
pub(super) struct Axes {
    /// From the reference's sides to the frame's x and y.
    turn: Matrix2<f64>,
    offset_m: f64,
}

impl Axes {
    pub(super) fn of(frame: &Isometry3<f64>, reference: &Reference) -> Self {
        let [first, second] = reference.sides;
        let (x, y) = (frame.rotation * Vector3::x(), frame.rotation * Vector3::y());
        let turn = Matrix2::new(x.dot(&first), x.dot(&second), y.dot(&first), y.dot(&second));
        Self { turn, offset_m: reference.offset_m }
    }

    /// A sum over the readings of something, times their places along both axes.
    fn flat(&self, totals: &[f64], at: usize) -> Vector2<f64> {
        self.turn * Vector2::new(totals[at], totals[at + 1])
    }

    /// The sum of the outer products of what the three unknowns move a reading by.
    fn form(&self, totals: &[f64], n: f64, at: usize, pairs: usize) -> Matrix3<f64> {
        let d = self.flat(totals, at);
        let square = self.turn * symmetric(totals, pairs) * self.turn.transpose();
        let (xx, xy, yy) = (square.m11, square.m12, square.m22);
        Matrix3::new(n, -d.x, d.y, -d.x, xx, -xy, d.y, -xy, yy)
    }

    /// The sum of what the three unknowns move a reading by, times an error.
    fn side(&self, totals: &[f64], sum: usize, at: usize) -> Vector3<f64> {
        let d = self.flat(totals, at);
        Vector3::new(totals[sum], -d.x, d.y)
    }

    /// Matrix and right side of the normal equations.
    pub(super) fn equations(&self, totals: &[f64]) -> (Matrix3<f64>, Vector3<f64>) {
        let scale = 1.0 / (self.offset_m * self.offset_m);
        let matrix = self.form(totals, totals[place::W], place::WD, place::WDD) * scale;
        (matrix, self.side(totals, place::WS, place::WSD) / self.offset_m)
    }
}

/// Mean square of the distances of the readings' places from the sensor.
fn mean_square_range(sums: &PlaneSums) -> f64 {
    let (t, n) = (&sums.totals, sums.readings.max(1) as f64);
    let Reference { sides: [first, second], foot, .. } = sums.reference;
    let along = first.dot(&foot) * t[place::D] + second.dot(&foot) * t[place::D + 1];
    (t[place::DD] + t[place::DD + 2] + 2.0 * along) / n + foot.norm_squared()
}

/// A frame on a reference plane.
struct Frame {
    frame: Isometry3<f64>,
    /// From the reference's sides to the frame's x and y.
    turn: Matrix2<f64>,
    /// Variance of the points along y.
    middle: f64,
}

/// The frame at the reference plane's foot, x along the greatest extent of the points.
fn frame_of(sums: &PlaneSums) -> Option<Frame> {
    let (t, n) = (&sums.totals, sums.readings as f64);
    let Reference { normal, sides: [first, second], foot, .. } = sums.reference;
    let mean = Vector2::new(t[place::D], t[place::D + 1]) / n;
    let flat = symmetric(t, place::DD) / n - mean * mean.transpose();
    let (half, half_difference) = (0.5 * (flat.m11 + flat.m22), 0.5 * (flat.m11 - flat.m22));
    let root = half_difference.hypot(flat.m12);
    let (greatest, middle) = (half + root, (half - root).max(0.0));
    // One centimetre in ten kilometres: points that are all the same.
    if greatest.is_nan() || greatest <= 1e-12 * foot.norm_squared() {
        return None;
    }
    // Of the two forms of the eigenvector, the one that does not cancel.
    let (a, b) = if half_difference > 0.0 {
        (root + half_difference, flat.m12)
    } else {
        (flat.m12, root - half_difference)
    };
    let ex = largest_positive((first * a + second * b).try_normalize(0.0).unwrap_or(first));
    let ey = normal.cross(&ex);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[ex, ey, normal]));
    let frame = Isometry3::from_parts(foot.into(), UnitQuaternion::from_rotation_matrix(&rotation));
    let turn = Matrix2::new(ex.dot(&first), ex.dot(&second), ey.dot(&first), ey.dot(&second));
    Some(Frame { frame, turn, middle })
}

/// Fits a plane; `None` for readings that span no line.
pub(in super::super) fn fit_plane(readings: &mut Readings) -> Option<(PlaneFit, f64)> {
    let (first, ..) = readings.every(1).next()?;
    let mut moments = Moments::default();
    for (point, gain) in readings.gains() {
        moments.add_point(point.into(), gain * gain);
    }
    let reference = Reference::new(moments.solve(), first.into());
    let (columns, packed) = readings.for_plane();
    let sums = PlaneSums::over_few(reference, columns, packed);
    Some((plane_of(&sums)?, sums.totals[place::ERROR]))
}

fn symmetric(totals: &[f64], at: usize) -> Matrix2<f64> {
    Matrix2::new(totals[at], totals[at + 1], totals[at + 1], totals[at + 2])
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

/// The vector or its opposite: the one whose largest component is positive.
pub(super) fn largest_positive(v: Vector3<f64>) -> Vector3<f64> {
    let largest = v.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    if largest < 0.0 { -v } else { v }
}
