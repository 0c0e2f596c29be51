//! What uneven surfaces mean for the planes of a scan.

use super::field::Field;
use super::fit::{Common, Unevenness};
use super::surface::{PlanePatch, Shape, Surface};
use nalgebra::{Isometry3, Vector3};

/// Variance of a trend over a patch, slope² times extent² / 12, in units of the unevenness.
///
/// Means over a sixth, a quarter and half of the sides of a patch were found to scatter alike, on floors
/// and walls from 0.1 to 2 m across (a nodding SICK scan): waves of all lengths are as high. So what is as
/// long as the patch itself, and which the fit takes for its offset and its tilts, is as high again.
const TREND: f64 = 1.0;
/// Standard deviation of a rotation that says nothing, in radians.
const FREE_RAD: f64 = 1.0;

/// How uneven the planes of a scan are. The buffers are kept from scan to scan.
#[derive(Clone, Debug, Default)]
pub(super) struct UnevenPlanes {
    /// Place among the surfaces, and what blocks tell.
    planes: Vec<(usize, Option<Unevenness>)>,
    /// Unevenness and cells of planes.
    known: Vec<(f64, usize)>,
}

impl UnevenPlanes {
    /// Forgets an earlier scan.
    pub fn start(&mut self) {
        self.planes.clear();
    }

    /// Adds what blocks tell of the plane that will be the surface at `index`, if they tell anything.
    pub fn add(&mut self, index: usize, found: Option<Unevenness>) {
        self.planes.push((index, found));
    }

    /// Adds to the planes' covariances what another look at another part of the same surface may differ
    /// by. What too few readings tell for themselves is taken from what is usual in the scan.
    pub fn tell(&mut self, surfaces: &mut [Surface]) {
        let usual_m2 = self.usual_m2(surfaces);
        for (index, found) in &self.planes {
            let square_m2 = found.map_or(usual_m2, |found| found.told_m2(usual_m2));
            if let (Shape::Plane(patch), true) = (&mut surfaces[*index].shape, square_m2 > 0.0) {
                add(patch, square_m2);
            }
        }
    }

    /// What the smoother half of the cells lies on: none, in a world of even surfaces.
    fn usual_m2(&mut self, surfaces: &[Surface]) -> f64 {
        self.known.clear();
        self.known.extend(self.planes.iter().filter_map(|(index, found)| {
            let found = found.as_ref()?;
            let sure_m2 = if found.is_sure { found.excess_m2.max(0.0) } else { 0.0 };
            Some((sure_m2, surfaces[*index].points))
        }));
        self.known.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let all: usize = self.known.iter().map(|known| known.1).sum();
        let mut below = 0;
        let middle = self.known.iter().find(|known| {
            below += known.1;
            2 * below >= all
        });
        middle.map_or(0.0, |known| known.0)
    }
}

/// What the readings on a plane have in common, a point of which errs across by `noise_m`.
pub(super) fn common(field: &Field, grid_from_plane: &Isometry3<f64>, noise_m: f64) -> Common {
    Common {
        patch: field.errors.patch,
        row_share: row_share(field, grid_from_plane, noise_m),
        rows_are_lanes: field.transposed,
    }
}

fn add(patch: &mut PlanePatch, square_m2: f64) {
    let span_m = |axis: usize| {
        let fresh = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = patch
            .hull
            .iter()
            .fold(fresh, |(low, high), vertex| (low.min(vertex[axis]), high.max(vertex[axis])));
        (high - low).max(f64::MIN_POSITIVE)
    };
    let tilt =
        |span_m: f64| (12.0 * TREND * square_m2 / (span_m * span_m)).min(FREE_RAD * FREE_RAD);
    let (about_y, about_x) = (tilt(span_m(0)), tilt(span_m(1)));
    patch.covariance[(0, 0)] += square_m2;
    patch.covariance[(1, 1)] += about_y;
    patch.covariance[(2, 2)] += about_x;
}

/// Share of the variance across a plane that the errors of the grid's rows, as far as they are known, have
/// in a point at its frame's origin, where the noise of the ranges gives it `noise_m`.
fn row_share(field: &Field, grid_from_plane: &Isometry3<f64>, noise_m: f64) -> f64 {
    let largest = field.row_sigmas_rad.iter().copied().fold(0.0, f32::max);
    let normal = grid_from_plane.rotation * Vector3::z();
    let lever_m = Vector3::y().cross(&grid_from_plane.translation.vector).dot(&normal);
    let row_m2 = (lever_m * f64::from(largest)).powi(2);
    row_m2 / (row_m2 + noise_m * noise_m).max(f64::MIN_POSITIVE)
}
