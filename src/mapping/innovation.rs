//! The implicit observation equation of a plane, equations (3)-(6) of the mapping paper.
//!
//! `h = B[⊖x_F ⊕ x_R ⊕ x_O]` is the discrepancy between an observed plane O and a plane F of the map:
//! the gap along the map plane's normal and the two tilts. The gap is `n_F · (c_O - c_F)` and the
//! tilts are the rotation vector that turns F's normal into O's, so nothing here is singular when a
//! wall faces the robot, where Euler angles of a plane's frame are.

use super::perturbation::rotation_matrix;
use crate::geometry::lie::skew;
use nalgebra::{Isometry3, Matrix2x3, Matrix3, Matrix3x6, Vector3};

/// Below this sine the ratio of angle to sine is taken from its limit.
const SMALL_SINE: f64 = 1e-7;

/// The discrepancy of one pair and its derivatives with respect to all three frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// `h`: gap along F's normal in metres, tilt about F's y and about F's x in radians.
    pub h: Vector3<f64>,
    /// `H_x`, equation (5): per pose error `[δt; δr]` in the world frame.
    pub h_x: Matrix3x6<f64>,
    /// `H_z`, equation (6), its third, fifth and sixth columns: per error of the observed plane.
    pub h_z: Matrix3<f64>,
    /// The same per error of the map plane, which the paper takes as exact.
    pub h_f: Matrix3<f64>,
}

impl Innovation {
    /// The discrepancy between the plane frame `robot_from_plane`, observed from `world_from_robot`,
    /// and `world_from_plane` of the map.
    pub fn new(
        world_from_plane: &Isometry3<f64>,
        world_from_robot: &Isometry3<f64>,
        robot_from_plane: &Isometry3<f64>,
    ) -> Self {
        let map_rotation = rotation_matrix(world_from_plane);
        let map_from_world = map_rotation.transpose();
        let map_normal = map_rotation.column(2).into_owned();
        let world_from_observed = world_from_robot * robot_from_plane;
        let relative_rotation = map_from_world * rotation_matrix(&world_from_observed);
        let centroid = world_from_observed.translation.vector;
        let lever = map_from_world * (centroid - world_from_plane.translation.vector);
        // O's normal as F sees it, and the tilt vector as a function of it.
        let normal = relative_rotation.column(2).into_owned();
        let (tilts, tilts_from_normal) = tilts_of(&normal);

        let world_normal = map_rotation * normal;
        let arm = centroid - world_from_robot.translation.vector;
        let mut h_x = Matrix3x6::zeros();
        h_x.fixed_view_mut::<1, 3>(0, 0).copy_from(&map_normal.transpose());
        h_x.fixed_view_mut::<1, 3>(0, 3).copy_from(&arm.cross(&map_normal).transpose());
        let turn = -tilts_from_normal * map_from_world * skew(&world_normal);
        h_x.fixed_view_mut::<2, 3>(1, 3).copy_from(&turn);

        // A rotation (ψ, θ, 0) of O's frame tips its z axis by (θ, -ψ, 0).
        let mut h_z = Matrix3::zeros();
        h_z[(0, 0)] = normal.z;
        let about_y = tilts_from_normal * relative_rotation.column(0);
        let about_x = -(tilts_from_normal * relative_rotation.column(1));
        h_z.fixed_view_mut::<2, 1>(1, 1).copy_from(&about_y);
        h_z.fixed_view_mut::<2, 1>(1, 2).copy_from(&about_x);

        // Turning F by (ψ, θ, 0) turns everything F sees by the opposite.
        let mut h_f = Matrix3::zeros();
        h_f[(0, 0)] = -1.0;
        h_f[(0, 1)] = lever.x;
        h_f[(0, 2)] = -lever.y;
        let about_y = tilts_from_normal * -Vector3::y().cross(&normal);
        let about_x = tilts_from_normal * -Vector3::x().cross(&normal);
        h_f.fixed_view_mut::<2, 1>(1, 1).copy_from(&about_y);
        h_f.fixed_view_mut::<2, 1>(1, 2).copy_from(&about_x);

        Self { h: Vector3::new(lever.z, tilts.0, tilts.1), h_x, h_z, h_f }
    }

    /// The same discrepancy with its tilts about the axes of the observed frame, which is what turns F's
    /// normal into O's as O sees it.
    ///
    /// A map plane's frame may lie and be turned in its plane in any way: here nothing depends on that, so
    /// that no motion of the world as a whole changes anything, to any order in the tilts. About the axes
    /// of F a turn about F's normal turns the tilts, and a thousand of them, each by a milliradian of
    /// noise, add up to a measurement of the world's attitude that nobody made.
    pub fn as_observed(
        world_from_plane: &Isometry3<f64>,
        world_from_robot: &Isometry3<f64>,
        robot_from_plane: &Isometry3<f64>,
    ) -> Self {
        let map_rotation = rotation_matrix(world_from_plane);
        let map_normal = map_rotation.column(2).into_owned();
        let world_from_observed = world_from_robot * robot_from_plane;
        let observed_from_world = rotation_matrix(&world_from_observed).transpose();
        let centroid = world_from_observed.translation.vector;
        let lever = map_rotation.transpose() * (centroid - world_from_plane.translation.vector);
        // F's normal as O sees it; the tilts turn it back.
        let normal = observed_from_world * map_normal;
        let (tilts, tilts_from_normal) = tilts_of(&normal);

        let arm = centroid - world_from_robot.translation.vector;
        let mut h_x = Matrix3x6::zeros();
        h_x.fixed_view_mut::<1, 3>(0, 0).copy_from(&map_normal.transpose());
        h_x.fixed_view_mut::<1, 3>(0, 3).copy_from(&arm.cross(&map_normal).transpose());
        let turn = -tilts_from_normal * observed_from_world * skew(&map_normal);
        h_x.fixed_view_mut::<2, 3>(1, 3).copy_from(&turn);

        // Turning O by (ψ, θ, 0) turns everything O sees by the opposite.
        let mut h_z = Matrix3::zeros();
        h_z[(0, 0)] = normal.z;
        let about_y = tilts_from_normal * Vector3::y().cross(&normal);
        let about_x = tilts_from_normal * Vector3::x().cross(&normal);
        h_z.fixed_view_mut::<2, 1>(1, 1).copy_from(&about_y);
        h_z.fixed_view_mut::<2, 1>(1, 2).copy_from(&about_x);

        // A rotation (ψ, θ, 0) of F's frame tips its z axis by (θ, -ψ, 0).
        let relative_rotation = observed_from_world * map_rotation;
        let mut h_f = Matrix3::zeros();
        h_f[(0, 0)] = -1.0;
        h_f[(0, 1)] = lever.x;
        h_f[(0, 2)] = -lever.y;
        let about_y = -(tilts_from_normal * relative_rotation.column(0));
        let about_x = tilts_from_normal * relative_rotation.column(1);
        h_f.fixed_view_mut::<2, 1>(1, 1).copy_from(&about_y);
        h_f.fixed_view_mut::<2, 1>(1, 2).copy_from(&about_x);

        Self { h: Vector3::new(lever.z, -tilts.0, -tilts.1), h_x, h_z, h_f }
    }

    /// Information of the discrepancy under an observation's own noise (offset, tilts about y and x), its
    /// `H_z R H_zᵀ` inverted; `None` where that is singular.
    pub fn information(&self, covariance: &Matrix3<f64>) -> Option<Matrix3<f64>> {
        (self.h_z * covariance * self.h_z.transpose()).try_inverse()
    }

    /// The angle between both normals in radians.
    pub fn angle_rad(&self) -> f64 {
        self.h.y.hypot(self.h.z)
    }
}

/// Rotation about y and about x that turns the z axis into `normal`, and its derivative.
fn tilts_of(normal: &Vector3<f64>) -> ((f64, f64), Matrix2x3<f64>) {
    let (x, y, z) = (normal.x, normal.y, normal.z);
    let sine = x.hypot(y);
    if sine < SMALL_SINE {
        // A normal that points exactly back leaves the axis open; the derivative is finite here and
        // the pair is refused by its angle long before.
        let jacobian = Matrix2x3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let angle = sine.atan2(z);
        let scale = if sine > 0.0 { angle / sine } else { 1.0 };
        return ((x * scale, -y * scale), jacobian);
    }
    let angle = sine.atan2(z);
    let ratio = angle / sine;
    // With `s = √(x² + y²)` and `α = atan2(s, z)`: `∂α/∂s = z`, `∂α/∂z = -s` on the unit sphere.
    let ratio_per_sine = (z - ratio) / sine;
    let jacobian = Matrix2x3::new(
        ratio + x * x * ratio_per_sine / sine,
        x * y * ratio_per_sine / sine,
        -x,
        -x * y * ratio_per_sine / sine,
        -ratio - y * y * ratio_per_sine / sine,
        y,
    );
    ((x * ratio, -y * ratio), jacobian)
}

#[cfg(test)]
mod tests {
    use super::super::perturbation::tests::any_pose;
    use super::super::perturbation::{perturbed_plane, perturbed_pose};
    use super::*;
    use crate::geometry::EulerPose;
    use nalgebra::{Matrix3x6, Vector6};
    use proptest::prelude::*;

    #[test]
    fn a_plane_seen_where_the_map_has_it_has_no_innovation() {
        let robot = EulerPose::from_numbers([1.0, -2.0, 0.3, 0.7, 0.1, -0.2]).to_isometry();
        let plane = EulerPose::from_numbers([4.0, 1.0, 2.0, -0.4, 1.2, 0.5]).to_isometry();
        let innovation = Innovation::new(&plane, &robot, &(robot.inverse() * plane));
        assert!(innovation.h.norm() < 1e-12);
    }

    #[test]
    fn the_gap_is_measured_along_the_maps_normal() {
        let floor = Isometry3::identity();
        let robot = Isometry3::translation(3.0, 4.0, 0.25);
        let innovation = Innovation::new(&floor, &robot, &Isometry3::identity());
        assert_eq!(innovation.h, Vector3::new(0.25, 0.0, 0.0));
    }

    /// A plane's frame near another: turned freely about its normal, tilted and shifted.
    fn near(tilt: [f64; 3], shift: [f64; 3], scale: f64) -> Isometry3<f64> {
        let turn = Vector3::new(tilt[0] * scale, tilt[1] * scale, 3.0 * tilt[2]);
        Isometry3::new(Vector3::new(shift[0], shift[1], 0.2 * shift[2]), turn)
    }

    proptest! {
        #[test]
        fn jacobians_match_central_differences(
            map in any_pose(), robot in any_pose(),
            tilt in prop::array::uniform3(-0.4..0.4f64), shift in prop::array::uniform3(-2.0..2.0f64),
            scale in prop::sample::select(vec![1.0, 1e-3, 0.0]),
        ) {
            let observed = robot.inverse() * map * near(tilt, shift, scale);
            for of in [Innovation::new, Innovation::as_observed] {
                let innovation = of(&map, &robot, &observed);
                let step = 1e-6;
                for axis in 0..6 {
                    let mut error = Vector6::zeros();
                    error[axis] = step;
                    let at = |e: &Vector6<f64>| of(&map, &perturbed_pose(&robot, e), &observed).h;
                    let numeric = (at(&error) - at(&-error)) / (2.0 * step);
                    prop_assert!((innovation.h_x.column(axis) - numeric).norm() < 1e-6);
                }
                for axis in 0..3 {
                    let mut error = Vector3::zeros();
                    error[axis] = step;
                    let at = |e: &Vector3<f64>| of(&map, &robot, &perturbed_plane(&observed, e)).h;
                    let numeric = (at(&error) - at(&-error)) / (2.0 * step);
                    prop_assert!((innovation.h_z.column(axis) - numeric).norm() < 1e-6);
                    let at = |e: &Vector3<f64>| of(&perturbed_plane(&map, e), &robot, &observed).h;
                    let numeric = (at(&error) - at(&-error)) / (2.0 * step);
                    prop_assert!((innovation.h_f.column(axis) - numeric).norm() < 1e-6);
                }
            }
        }

        /// About O's axes nothing depends on where F's frame lies in its plane, and without a tilt both
        /// ways to tell it are one.
        #[test]
        fn as_observed_a_plane_is_a_plane_whatever_its_frame(
            map in any_pose(), robot in any_pose(),
            tilt in prop::array::uniform3(-0.4..0.4f64), shift in prop::array::uniform3(-2.0..2.0f64),
            slid in prop::array::uniform2(-5.0..5.0f64), turned in -3.0..3.0f64,
        ) {
            let observed = robot.inverse() * map * near(tilt, shift, 1.0);
            let within = Isometry3::new(Vector3::new(slid[0], slid[1], 0.0), Vector3::z() * turned);
            let [own, other] = [map, map * within].map(|map| Innovation::as_observed(&map, &robot, &observed));
            prop_assert!((own.h - other.h).norm() < 1e-9 && (own.h_x - other.h_x).norm() < 1e-9);
            prop_assert!((own.h_z - other.h_z).norm() < 1e-9);
            let untilted = Isometry3::translation(shift[0], shift[1], shift[2]);
            let observed = robot.inverse() * map * untilted;
            let [own, other] = [Innovation::new, Innovation::as_observed].map(|of| of(&map, &robot, &observed));
            prop_assert!((own.h - other.h).norm() < 1e-9 && (own.h_x - other.h_x).norm() < 1e-7);
            prop_assert!((own.h_z - other.h_z).norm() < 1e-7 && (own.h_f - other.h_f).norm() < 1e-7);
        }

        /// Equation (5) as printed, on Euler angles, where those are not singular.
        #[test]
        fn the_pose_jacobian_is_the_papers(robot in any_pose(), plane in any_pose()) {
            let world_from_plane = robot * plane;
            let [map, pose, observed] =
                [world_from_plane, robot, plane].map(|frame| EulerPose::from_isometry(&frame));
            let seen = pose.compose(observed);
            let chain = [map.inverse(), pose, observed, seen, map.inverse().compose(seen)];
            prop_assume!(chain.iter().all(|frame| frame.theta.abs() < 1.3));
            let full = map.inverse().j2(seen) * pose.j1(observed);
            // B keeps z, θ and ψ.
            let printed = Matrix3x6::from_fn(|row, column| full[([2, 4, 5][row], column)]);
            let ours = Innovation::new(&world_from_plane, &robot, &plane);
            let carried = ours.h_x * pose.perturbation_from_numbers();
            prop_assert!((printed - carried).norm() < 1e-8, "{printed} {carried}");
        }
    }
}
