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

    /// Variance of a point across the plane by its own noise, in m².
    pub(super) fn own_m2(&self) -> f64 {
        self.own_m2
    }

    /// Adds a point of a row, in the grid's frame and in the patch's; row after row. Returns what a unit
    /// of its displacement across the plane adds to the right side of the normal equations.
    pub(super) fn add(
        &mut self,
        row: usize,
        sigma_rad: f64,
        point: &Point3<f64>,
        local: &Point2<f64>,
    ) -> Vector3<f64> {
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
        unknowns * weight
    }

    fn end_row(&mut self) {
        if let Some((_, sigma_rad)) = self.row.take() {
            self.right += self.pull * self.pull.transpose() * (sigma_rad * sigma_rad);
        }
        self.pull = Vector3::zeros();
    }

    /// Covariance that the rows' errors, and `others` of the right side, give the least-squares plane:
    /// offset, rotation about y, rotation about x.
    pub(super) fn covariance(mut self, others: &Matrix3<f64>) -> Matrix3<f64> {
        self.end_row();
        let prior = Matrix3::from_diagonal(&Vector3::new(0.0, FREE, FREE));
        let Some(inverse) = (self.information + prior).try_inverse() else {
            return Matrix3::zeros();
        };
        let covariance = inverse * (self.right + others) * inverse;
        (covariance + covariance.transpose()) * 0.5
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_core::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    const HEIGHT_M: f64 = 0.6;

    /// A point of a floor under a tilt and a bearing, the first seen `error` too low.
    fn floor_point(tilt_rad: f64, bearing_rad: f64, error_rad: f64) -> Point3<f64> {
        let true_range_m = HEIGHT_M / (tilt_rad.sin() * bearing_rad.cos());
        let filed = tilt_rad - error_rad;
        let (along, aside) = (true_range_m * bearing_rad.cos(), true_range_m * bearing_rad.sin());
        Point3::new(along * filed.cos(), aside, -along * filed.sin())
    }

    /// The plane through points in the frame whose origin is `centre`: offset, rotations about y and x.
    fn fitted(points: &[Point3<f64>], centre: &Point3<f64>) -> Vector3<f64> {
        let mut information = Matrix3::zeros();
        let mut right = Vector3::zeros();
        for point in points {
            let local = point - centre;
            let unknowns = Vector3::new(1.0, -local.x, local.y);
            information += unknowns * unknowns.transpose();
            right += unknowns * local.z;
        }
        information.try_inverse().expect("three rows span a plane") * right
    }

    #[test]
    fn the_covariance_is_that_of_planes_fitted_to_rows_of_wrong_tilts() {
        const SIGMA_RAD: f64 = 0.001;
        let mut rng = Pcg64::seed_from_u64(3);
        let mut normal = || -> f64 {
            let sum: f64 = (0..12).map(|_| f64::from(rng.next_u32()) / f64::from(u32::MAX)).sum();
            sum - 6.0
        };
        for rows in [3_usize, 8, 25] {
            let tilts = (0..rows).map(|row| 0.15 + 0.3 * row as f64 / rows as f64);
            let tilts: Vec<f64> = tilts.collect();
            let bearings: Vec<f64> = (-30..=50).map(|i| f64::from(i) * 0.0175).collect();
            let seen = |errors: &[f64]| -> Vec<Point3<f64>> {
                let rows = tilts.iter().zip(errors);
                rows.flat_map(|(&tilt, &error)| bearings.iter().map(move |&b| (tilt, b, error)))
                    .map(|(tilt, bearing, error)| floor_point(tilt, bearing, error))
                    .collect()
            };
            let exact = seen(&vec![0.0; rows]);
            let sum: Vector3<f64> = exact.iter().map(|p| p.coords).sum();
            let centre = Point3::from(sum / exact.len() as f64);
            // Points that err more by themselves than by their rows weigh alike.
            let mut errors = RowErrors::new(Vector3::z(), 1.0);
            for (i, point) in exact.iter().enumerate() {
                let local = point - centre;
                errors.add(i / bearings.len(), SIGMA_RAD, point, &Point2::new(local.x, local.y));
            }
            let told = {
                // Without the prior, which unit noise gives weight.
                let mut errors = errors;
                errors.information -= Matrix3::from_diagonal(&Vector3::new(0.0, FREE, FREE));
                errors.covariance(&Matrix3::zeros())
            };
            let mut found = Matrix3::zeros();
            const RUNS: usize = 1500;
            for _ in 0..RUNS {
                let wrong: Vec<f64> = (0..rows).map(|_| SIGMA_RAD * normal()).collect();
                let plane = fitted(&seen(&wrong), &centre);
                found += plane * plane.transpose() / RUNS as f64;
            }
            for (i, j) in [(0, 0), (1, 1), (2, 2), (0, 1)] {
                let scale = (told[(i, i)] * told[(j, j)]).sqrt();
                let gap = (found[(i, j)] - told[(i, j)]).abs() / scale;
                assert!(gap < 0.12, "{rows} rows, {i} {j}: {found} {told}");
            }
        }
    }

    #[test]
    fn rows_that_are_known_add_nothing() {
        let mut errors = RowErrors::new(Vector3::z(), 0.001);
        for row in 0..5 {
            let point = floor_point(0.1 + 0.05 * row as f64, 0.2, 0.0);
            errors.add(row, 0.0, &point, &Point2::new(point.x, point.y));
        }
        assert_eq!(errors.covariance(&Matrix3::zeros()), Matrix3::zeros());
    }
}
