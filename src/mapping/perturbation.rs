//! Small errors of poses and plane frames, and how composition carries them.
//!
//! A pose error is the 6-vector `[δt; δr]` in the outer (world) frame: the true pose has translation
//! `t + δt` and rotation `exp(δr) R`. A plane frame's error is the 3-vector (offset along its z,
//! rotation about its y, rotation about its x), applied in the frame itself: the components that
//! the paper's binding matrix B, equation (4), keeps. Neither form has a singularity.

use crate::geometry::lie::skew;
use nalgebra::{
    Isometry3, Matrix3, Matrix6, SymmetricEigen, Translation3, UnitQuaternion, Vector3, Vector6,
};

/// The pose `[δt; δr]` away from `pose`.
pub fn perturbed_pose(pose: &Isometry3<f64>, error: &Vector6<f64>) -> Isometry3<f64> {
    let shift = Vector3::new(error[0], error[1], error[2]);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(error[3], error[4], error[5]));
    let mut rotation = turn * pose.rotation;
    rotation.renormalize();
    Isometry3::from_parts(Translation3::from(pose.translation.vector + shift), rotation)
}

/// The perturbation that leads from `from` to `to`, inverse of [`perturbed_pose`].
pub fn pose_error(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Vector6<f64> {
    let shift = to.translation.vector - from.translation.vector;
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
}

/// `J1⊕` in perturbation form: the error of `a ⊕ b` per error of `a`, where `composed = a ⊕ b`.
pub fn first_jacobian(a: &Isometry3<f64>, composed: &Isometry3<f64>) -> Matrix6<f64> {
    let lever = composed.translation.vector - a.translation.vector;
    let mut jacobian = Matrix6::identity();
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&lever));
    jacobian
}

/// `J2⊕` in perturbation form: the error of `a ⊕ b` per error of `b`.
pub fn second_jacobian(a: &Isometry3<f64>) -> Matrix6<f64> {
    let rotation = rotation_matrix(a);
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    jacobian
}

/// A plane frame moved by (offset along z, rotation about y, rotation about x) of its own.
pub fn perturbed_plane(frame: &Isometry3<f64>, error: &Vector3<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(error[2], error[1], 0.0));
    let mut moved = frame * Isometry3::from_parts(Translation3::new(0.0, 0.0, error[0]), turn);
    moved.rotation.renormalize();
    moved
}

/// The rotation of a pose as a matrix.
pub fn rotation_matrix(pose: &Isometry3<f64>) -> Matrix3<f64> {
    pose.rotation.to_rotation_matrix().into_inner()
}

/// A matrix with its rounding asymmetry taken out.
pub fn symmetric<const N: usize>(
    matrix: &nalgebra::SMatrix<f64, N, N>,
) -> nalgebra::SMatrix<f64, N, N> {
    (matrix + matrix.transpose()) * 0.5
}

/// Smallest eigenvalue of a symmetric 6 × 6 matrix.
pub fn least_eigenvalue(matrix: &Matrix6<f64>) -> f64 {
    SymmetricEigen::new(*matrix).eigenvalues.min()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::geometry::EulerPose;
    use proptest::prelude::*;

    /// Poses within a few metres, of any attitude.
    pub(crate) fn any_pose() -> impl Strategy<Value = Isometry3<f64>> {
        (prop::array::uniform3(-6.0..6.0f64), prop::array::uniform3(-1.7..1.7f64)).prop_map(
            |(t, r)| {
                Isometry3::from_parts(
                    Translation3::new(t[0], t[1], t[2]),
                    UnitQuaternion::from_scaled_axis(Vector3::from(r)),
                )
            },
        )
    }

    proptest! {
        #[test]
        fn error_undoes_perturbation(pose in any_pose(), e in prop::array::uniform6(-0.9..0.9f64)) {
            let error = Vector6::from_row_slice(&e);
            prop_assert!((pose_error(&pose, &perturbed_pose(&pose, &error)) - error).norm() < 1e-9);
        }

        #[test]
        fn composition_jacobians_match_central_differences(a in any_pose(), b in any_pose()) {
            let composed = a * b;
            let step = 1e-6;
            for axis in 0..6 {
                let mut error = Vector6::zeros();
                error[axis] = step;
                let both = |f: &dyn Fn(&Vector6<f64>) -> Isometry3<f64>| {
                    pose_error(&f(&-error), &f(&error)) / (2.0 * step)
                };
                let first = both(&|e| perturbed_pose(&a, e) * b);
                let second = both(&|e| a * perturbed_pose(&b, e));
                prop_assert!((first_jacobian(&a, &composed).column(axis) - first).norm() < 1e-7);
                prop_assert!((second_jacobian(&a).column(axis) - second).norm() < 1e-7);
            }
        }

        /// The paper's Jacobians on Euler angles are the same maps in other coordinates.
        #[test]
        fn perturbation_jacobians_are_the_papers_in_other_coordinates(
            a in any_pose(), b in any_pose()
        ) {
            let (a, b) = (EulerPose::from_isometry(&a), EulerPose::from_isometry(&b));
            let composed = a.compose(b);
            prop_assume!([a, b, composed].iter().all(|pose| pose.theta.abs() < 1.3));
            let carried = composed.perturbation_from_numbers() * a.j1(b);
            let ours = first_jacobian(&a.to_isometry(), &composed.to_isometry());
            prop_assert!((carried - ours * a.perturbation_from_numbers()).norm() < 1e-9);
            let carried = composed.perturbation_from_numbers() * a.j2(b);
            let ours = second_jacobian(&a.to_isometry());
            prop_assert!((carried - ours * b.perturbation_from_numbers()).norm() < 1e-9);
        }
    }
}
