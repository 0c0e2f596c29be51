//! Exponential and logarithm maps of SO(3) and SE(3), with the Jacobians that filters need.
//!
//! A rotation perturbation is a rotation vector in radians. An SE(3) tangent vector is
//! `[translation; rotation vector]`, in that order, as a 6-vector.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Below this angle the closed forms lose digits and their series are used instead.
const SMALL_ANGLE_RAD: f64 = 1e-5;

/// The cross-product matrix: `skew(a) * b == a × b`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Left Jacobian of SO(3): the derivative of `exp` with the perturbation on the left.
pub fn so3_left_jacobian(rotation: &Vector3<f64>) -> Matrix3<f64> {
    let angle = rotation.norm();
    let k = skew(rotation);
    if angle < SMALL_ANGLE_RAD {
        return Matrix3::identity() + k * 0.5 + k * k / 6.0;
    }
    let (sin, cos) = angle.sin_cos();
    Matrix3::identity()
        + k * ((1.0 - cos) / (angle * angle))
        + k * k * ((angle - sin) / (angle * angle * angle))
}

/// Inverse of [`so3_left_jacobian`]; defined for angles below 2π.
pub fn so3_left_jacobian_inverse(rotation: &Vector3<f64>) -> Matrix3<f64> {
    let angle = rotation.norm();
    let k = skew(rotation);
    if angle < SMALL_ANGLE_RAD {
        return Matrix3::identity() - k * 0.5 + k * k / 12.0;
    }
    let half = 0.5 * angle;
    let cotangent = half * half.cos() / half.sin();
    Matrix3::identity() - k * 0.5 + k * k * ((1.0 - cotangent) / (angle * angle))
}

/// The rigid motion of an SE(3) tangent vector `[translation; rotation vector]`.
pub fn se3_exp(tangent: &Vector6<f64>) -> Isometry3<f64> {
    let translation = Vector3::new(tangent[0], tangent[1], tangent[2]);
    let rotation = Vector3::new(tangent[3], tangent[4], tangent[5]);
    Isometry3::from_parts(
        Translation3::from(so3_left_jacobian(&rotation) * translation),
        UnitQuaternion::from_scaled_axis(rotation),
    )
}

/// The pose on the screw from `from` to `to`, `share` of the way along it; beyond both for shares
/// outside 0 to 1.
pub fn se3_between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    from * se3_exp(&(se3_log(&(from.inverse() * to)) * share))
}

/// The tangent vector of a rigid motion, inverse of [`se3_exp`]; the rotation part has a norm of
/// at most π.
pub fn se3_log(motion: &Isometry3<f64>) -> Vector6<f64> {
    let rotation = motion.rotation.scaled_axis();
    let translation = so3_left_jacobian_inverse(&rotation) * motion.translation.vector;
    Vector6::new(translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn log_undoes_exp(v in prop::array::uniform6(-1.7..1.7f64)) {
            let tangent = Vector6::from_row_slice(&v);
            let back = se3_log(&se3_exp(&tangent));
            prop_assert!((back - tangent).norm() < 1e-9);
        }

        #[test]
        fn left_jacobian_matches_central_differences(
            v in prop::array::uniform3(-1.5..1.5f64), scale in prop::sample::select(vec![1.0, 1e-3, 1e-6])
        ) {
            let rotation = Vector3::from_row_slice(&v) * scale;
            let step = 1e-6;
            let base = UnitQuaternion::from_scaled_axis(rotation);
            let analytic = so3_left_jacobian(&rotation);
            for axis in 0..3 {
                let mut delta = Vector3::zeros();
                delta[axis] = step;
                let plus = (UnitQuaternion::from_scaled_axis(rotation + delta) * base.inverse()).scaled_axis();
                let minus = (UnitQuaternion::from_scaled_axis(rotation - delta) * base.inverse()).scaled_axis();
                let numeric = (plus - minus) / (2.0 * step);
                prop_assert!((analytic.column(axis) - numeric).norm() < 1e-7);
            }
            prop_assert!((so3_left_jacobian_inverse(&rotation) * analytic - Matrix3::identity()).norm() < 1e-9);
        }
    }
}
