//! Rows of the measurements of axes and centres.
//!
//! Both are differences between where the map has the curve and where the scan shows it, in the frame
//! of what was seen: of an axis the point where it pierces the plane across the seen axis, and its
//! slope to that axis; of a centre the three coordinates.

use super::super::scan_errors::{COMMON, CommonColumns, CommonErrors};
use super::factor::Linearised;
use crate::geometry::lie::skew;
use crate::mapping::perturbation::rotation_matrix;
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2x3, Matrix3, Matrix4, Point3, SMatrix, SVector, Vector3,
    Vector4,
};

/// Least cosine between the axis of the map and the one seen for which slopes are finite.
const LEAST_COSINE: f64 = 0.1;

/// Rows of an axis: residual `[x, y, dx/dz, dy/dz]`, columns those of the pose, of the axis and of the
/// common errors.
pub(super) fn axis_rows(
    pose: &Isometry3<f64>,
    axis: &Isometry3<f64>,
    common: Option<(&CommonColumns<4>, &CommonErrors)>,
    robot_from_axis: &Isometry3<f64>,
    covariance: &Matrix4<f64>,
) -> Linearised {
    let seen = pose * robot_from_axis;
    let seen_from_world = rotation_matrix(&seen).transpose();
    let rotation = rotation_matrix(axis);
    let point = axis.translation.vector;
    let direction = rotation.column(2).into_owned();
    let p = seen_from_world * (point - seen.translation.vector);
    let d = seen_from_world * direction;
    // An axis has no sign; nothing that associates pairs axes which are far from parallel.
    let dz = if d.z.abs() < LEAST_COSINE { LEAST_COSINE.copysign(d.z) } else { d.z };
    let slope = d.xy() / dz;
    let pierced = p.xy() - slope * p.z;

    // Derivatives of slope and piercing point with respect to d and p.
    let slope_by_d = Matrix2x3::new(1.0, 0.0, -slope.x, 0.0, 1.0, -slope.y) / dz;
    let pierced_by_p = Matrix2x3::new(1.0, 0.0, -slope.x, 0.0, 1.0, -slope.y);
    let rows = |p_by: &Matrix3<f64>, d_by: &Matrix3<f64>| {
        let mut rows = SMatrix::<f64, 4, 3>::zeros();
        rows.fixed_rows_mut::<2>(0).copy_from(&(pierced_by_p * p_by - slope_by_d * d_by * p.z));
        rows.fixed_rows_mut::<2>(2).copy_from(&(slope_by_d * d_by));
        rows
    };
    // A shift of the robot moves the point by its opposite; a turn moves point and direction.
    let by_shift = rows(&-seen_from_world, &Matrix3::zeros());
    let lever = point - pose.translation.vector;
    let by_turn = rows(&(seen_from_world * skew(&lever)), &(seen_from_world * skew(&direction)));
    let own = seen_from_world * rotation;
    let by_own_shift = rows(&own, &Matrix3::zeros());
    let by_own_tilt = rows(&Matrix3::zeros(), &own);

    let weight = whitener(covariance);
    let mut jacobian = DMatrix::zeros(4, 10 + if common.is_some() { COMMON } else { 0 });
    jacobian.fixed_view_mut::<4, 3>(0, 0).copy_from(&(weight * by_shift));
    jacobian.fixed_view_mut::<4, 3>(0, 3).copy_from(&(weight * by_turn));
    jacobian.fixed_view_mut::<4, 2>(0, 6).copy_from(&(weight * by_own_shift).fixed_columns::<2>(0));
    jacobian.fixed_view_mut::<4, 2>(0, 8).copy_from(&(weight * by_own_tilt).fixed_columns::<2>(0));
    let mut residual = Vector4::new(pierced.x, pierced.y, slope.x, slope.y);
    if let Some((by_errors, errors)) = common {
        // The errors have moved what was seen, so what is left of the difference is less by that.
        residual += by_errors * errors;
        jacobian.fixed_view_mut::<4, COMMON>(0, 10).copy_from(&(weight * by_errors));
    }
    let residual = weight * residual;
    Linearised { jacobian, residual: DVector::from_column_slice(residual.as_slice()) }
}

/// Rows of a centre, in the robot frame.
pub(super) fn centre_rows(
    pose: &Isometry3<f64>,
    centre: &Point3<f64>,
    common: Option<(&CommonColumns<3>, &CommonErrors)>,
    robot_point: &Point3<f64>,
    covariance: &Matrix3<f64>,
) -> Linearised {
    let robot_from_world = rotation_matrix(pose).transpose();
    let lever: Vector3<f64> = centre.coords - pose.translation.vector;
    let weight = whitener(covariance);
    let mut jacobian = DMatrix::zeros(3, 9 + if common.is_some() { COMMON } else { 0 });
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-(weight * robot_from_world)));
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(weight * robot_from_world * skew(&lever)));
    jacobian.fixed_view_mut::<3, 3>(0, 6).copy_from(&(weight * robot_from_world));
    let mut residual = robot_from_world * lever - robot_point.coords;
    if let Some((by_errors, errors)) = common {
        residual += by_errors * errors;
        jacobian.fixed_view_mut::<3, COMMON>(0, 9).copy_from(&(weight * by_errors));
    }
    let residual: SVector<f64, 3> = weight * residual;
    Linearised { jacobian, residual: DVector::from_column_slice(residual.as_slice()) }
}

/// `L⁻¹` of a covariance `L Lᵀ`.
fn whitener<const N: usize>(covariance: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    covariance
        .cholesky()
        .and_then(|cholesky| cholesky.l().solve_lower_triangular(&SMatrix::identity()))
        .expect("an observation's covariance is positive, which is checked when it is made")
}
