//! Candidate axes of a region that may be a cylinder.

use super::field::Field;
use super::moments::Moments;
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Places in a region at which a local normal is taken.
const PLACES: usize = 48;
/// About how many cells tell how a region extends.
const SPREAD: usize = 128;
/// Lanes from the middle of a local window to its side.
const REACH: usize = 1;

/// Directions along which the surface of a region does not curve, best first.
///
/// The normals of a cylinder are perpendicular to its axis: the axis is the direction that the
/// local normals have least of. The principal axes of the points are further candidates, for
/// regions too narrow for normals.
pub(super) fn candidate_axes(
    field: &Field,
    cells: impl Iterator<Item = usize> + Clone,
    count: usize,
    belongs: impl Fn(usize) -> bool,
) -> [Vector3<f64>; 4] {
    let aspect = ((field.across_rad / field.along_rad).round() as usize).clamp(1, 8);
    let mut normals = Matrix3::<f64>::zeros();
    let mut scatter = Matrix3::<f64>::zeros();
    let mut centroid = Vector3::<f64>::zeros();
    let some = cells.clone().step_by(count.div_ceil(SPREAD).max(1));
    for cell in some.clone() {
        centroid += Vector3::from(field.point(cell));
    }
    centroid /= some.clone().count().max(1) as f64;
    for cell in some {
        let d = Vector3::from(field.point(cell)) - centroid;
        scatter += d * d.transpose();
    }
    for cell in cells.step_by(count.div_ceil(PLACES).max(1)) {
        let (step, lane) = (cell / field.lanes, cell % field.lanes);
        let mut moments = Moments::default();
        let reach = 2 * aspect;
        for s in step.saturating_sub(reach)..=(step + reach).min(field.steps - 1) {
            for l in lane.saturating_sub(REACH)..=(lane + REACH).min(field.lanes - 1) {
                let other = s * field.lanes + l;
                if belongs(other) {
                    let range = f64::from(field.range[other]);
                    moments.add_point(field.point(other), range * range);
                }
            }
        }
        if moments.n >= 6.0
            && let Some(normal) = Vector3::from(moments.solve()).try_normalize(1e-12)
        {
            normals += normal * normal.transpose();
        }
    }
    let spread = SymmetricEigen::new(scatter);
    let turning = SymmetricEigen::new(normals);
    let least = turning.eigenvalues.imin();
    [
        turning.eigenvectors.column(least).into_owned(),
        spread.eigenvectors.column(0).into_owned(),
        spread.eigenvectors.column(1).into_owned(),
        spread.eigenvectors.column(2).into_owned(),
    ]
}
