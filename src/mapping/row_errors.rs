//! What a plane is wrong by because each of its rows was taken under a tilt that is a little off.
//!
//! All points of a row are displaced alike, so that these errors average out over the rows of a patch, not
//! over its points: a floor seen in three rows tilts by what one of them errs, however many points it has.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

/// Information of a rotation that no point fixes, in 1/rad²: the same prior of one radian as the fit has.
const FREE: f64 = 1.0;

/// Sums over the points of one patch, row by row.
#[derive(Clone, Debug)]
pub(super) struct RowErrors {
    normal: Vector3<f64>,
    /// Variance of a point across the plane by its own noise, in m².
    own_m2: f64,
    /// Normal matrix of offset, rotation about y, rotation about x.
    information: Matrix3<f64>,
    /// The row that is being summed up, with its tilt's standard deviation.
    row: Option<(usize, f64)>,
    /// What a unit of that row's tilt adds to the right side of the normal equations.
    pull: Vector3<f64>,
    /// Covariance of the right side from the rows before.
    right: Matrix3<f64>,
}

impl RowErrors {
    /// Nothing yet of a patch with that normal in the grid's frame, whose points err across it by `noise_m`.
    pub(super) fn new(normal: Vector3<f64>, noise_m: f64) -> Self {
        Self {
            normal,
            own_m2: noise_m * noise_m,
            information: Matrix3::zeros(),
            row: None,
            pull: Vector3::zeros(),
            right: Matrix3::zeros(),
        }
    }

    /// Adds a point of a row, in the grid's frame and in the patch's; row after row.
    pub(super) fn add(
        &mut self,
        row: usize,
        sigma_rad: f64,
        point: &Point3<f64>,
        local: &Point2<f64>,
    ) {
        if self.row.is_none_or(|(known, _)| known != row) {
            self.end_row();
            self.row = Some((row, sigma_rad));
        }
        // A turn about the grid's y axis moves the point across the plane by so much.
        let shift_m = Vector3::y().cross(&point.coords).dot(&self.normal);
        let moved = shift_m * sigma_rad;
        let weight = 1.0 / (self.own_m2 + moved * moved).max(f64::MIN_POSITIVE);
        // A point at (x, y) is displaced by δz - θ x + ψ y.
        let unknowns = Vector3::new(1.0, -local.x, local.y);
        self.information += unknowns * unknowns.transpose() * weight;
        self.pull += unknowns * (weight * shift_m);
    }

    fn end_row(&mut self) {
        if let Some((_, sigma_rad)) = self.row.take() {
            self.right += self.pull * self.pull.transpose() * (sigma_rad * sigma_rad);
        }
        self.pull = Vector3::zeros();
    }

    /// Covariance that the rows' errors give the least-squares plane: offset, rotation about y, rotation
    /// about x.
    pub(super) fn covariance(mut self) -> Matrix3<f64> {
        self.end_row();
        let prior = Matrix3::from_diagonal(&Vector3::new(0.0, FREE, FREE));
        let Some(inverse) = (self.information + prior).try_inverse() else {
            return Matrix3::zeros();
        };
        let covariance = inverse * self.right * inverse;
        (covariance + covariance.transpose()) * 0.5
    }
}
