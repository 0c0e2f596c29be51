use nalgebra::{Isometry3, Matrix2x6, UnitQuaternion, Vector2, Vector3};

/// Residual of a measured attitude and its Jacobian per pose error `[δt; δr]`.
///
/// Roll and pitch are those of `Rz Ry Rx` in a world whose z is up. The residual is the rotation
/// about the world's x and y axes from the measured to the estimated attitude; heading plays no part
/// in it, and no attitude is singular.
pub fn attitude_rows(
    world_from_robot: &Isometry3<f64>,
    roll_rad: f64,
    pitch_rad: f64,
) -> (Vector2<f64>, Matrix2x6<f64>) {
    let up_in_robot =
        UnitQuaternion::from_euler_angles(roll_rad, pitch_rad, 0.0).inverse() * Vector3::z();
    // Where the estimate puts what the sensor calls up: the world's z when both agree.
    let up = world_from_robot.rotation * up_in_robot;
    let residual = Vector2::new(-up.y, up.x);
    // A perturbation δr moves `up` by δr × up.
    let mut jacobian = Matrix2x6::zeros();
    jacobian[(0, 3)] = up.z;
    jacobian[(0, 5)] = -up.x;
    jacobian[(1, 4)] = up.z;
    jacobian[(1, 5)] = -up.y;
    (residual, jacobian)
}

#[cfg(test)]
mod tests {
    use super::super::perturbation::perturbed_pose;
    use super::super::perturbation::tests::any_pose;
    use super::*;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    #[test]
    fn the_own_attitude_has_no_residual_at_any_heading() {
        for heading in [0.0, 1.0, -2.5] {
            let rotation = UnitQuaternion::from_euler_angles(0.2, -0.3, heading);
            let pose = Isometry3::from_parts(Vector3::new(1.0, 2.0, 3.0).into(), rotation);
            assert!(attitude_rows(&pose, 0.2, -0.3).0.norm() < 1e-12);
            let turned = attitude_rows(&pose, 0.2 - 0.01, -0.3).0;
            // Roll turns about an axis that pitch has tipped out of the horizontal.
            assert!((turned.norm() - 0.01 * 0.3_f64.cos()).abs() < 1e-4);
        }
    }

    proptest! {
        #[test]
        fn jacobian_matches_central_differences(
            pose in any_pose(), roll in -0.6..0.6f64, pitch in -0.6..0.6f64
        ) {
            let (_, jacobian) = attitude_rows(&pose, roll, pitch);
            let step = 1e-6;
            for axis in 0..6 {
                let mut error = Vector6::zeros();
                error[axis] = step;
                let at = |e: &Vector6<f64>| attitude_rows(&perturbed_pose(&pose, e), roll, pitch).0;
                let numeric = (at(&error) - at(&-error)) / (2.0 * step);
                prop_assert!((jacobian.column(axis) - numeric).norm() < 1e-8);
            }
        }
    }
}
