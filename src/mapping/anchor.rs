//! Errors as seen from an anchor: a pose that is taken to be where it is thought to be, so that what is
//! left is what pose and planes are wrong by beside it.
//!
//! After a long way pose and planes share an error of metres and degrees, and an update that is
//! linear moves all of them along it: over ten metres a heading of 3° bends a way by centimetres, a
//! hundred times what a plane is measured to. Beside a pose of the place itself the errors are those
//! of the last way only (the robot-centred maps of Castellanos et al., "Robocentric map joining", 2007).
//! Roll and pitch stay those of the world where gravity is measured. Where it is not they stray like the rest,
//! and would say of the next step that it leads anywhere between floor and ceiling.

use super::perturbation::rotation_matrix;
use crate::geometry::lie::skew;
use nalgebra::{DMatrix, Isometry3, Matrix3x6, Matrix6, Vector3};

/// Components of a pose's error `[δt; δr]` that an anchor takes away: position and heading, and all of them
/// where no gravity is measured.
const LEVEL: &[usize] = &[0, 1, 2, 5];
const ALL: &[usize] = &[0, 1, 2, 3, 4, 5];
/// Components of a pose's error.
const POSE: usize = 6;

/// The error of a pose per shift and turn of the anchor.
fn pose_rows(anchor: &Isometry3<f64>, pose: &Isometry3<f64>) -> Matrix6<f64> {
    let arm = pose.translation.vector - anchor.translation.vector;
    let mut rows = Matrix6::identity();
    rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&arm));
    rows
}

/// The error of a plane's frame per the same.
fn plane_rows(anchor: &Isometry3<f64>, plane: &Isometry3<f64>) -> Matrix3x6<f64> {
    let rotation = rotation_matrix(plane);
    let normal: Vector3<f64> = rotation.column(2).into_owned();
    let arm = plane.translation.vector - anchor.translation.vector;
    let mut rows = Matrix3x6::zeros();
    rows.fixed_view_mut::<1, 3>(0, 0).copy_from(&normal.transpose());
    rows.fixed_view_mut::<1, 3>(0, 3).copy_from(&arm.cross(&normal).transpose());
    rows.fixed_view_mut::<1, 3>(1, 3).copy_from(&rotation.column(1).transpose());
    rows.fixed_view_mut::<1, 3>(2, 3).copy_from(&rotation.column(0).transpose());
    rows
}

/// The covariance of a pose and planes beside an anchor, from `joint`, that of anchor, pose and planes
/// in the world. `gravity` tells whether roll and pitch are to stay those of the world.
pub(super) fn beside(
    anchor: &Isometry3<f64>,
    pose: &Isometry3<f64>,
    planes: &[Isometry3<f64>],
    joint: &DMatrix<f64>,
    gravity: bool,
) -> DMatrix<f64> {
    let free = if gravity { LEVEL } else { ALL };
    let size = joint.nrows() - POSE;
    let mut rows = DMatrix::zeros(size, free.len());
    rows.fixed_rows_mut::<6>(0).copy_from(&pose_rows(anchor, pose).select_columns(free));
    for (i, plane) in planes.iter().enumerate() {
        let on_plane = plane_rows(anchor, plane).select_columns(free);
        rows.fixed_rows_mut::<3>(POSE + 3 * i).copy_from(&on_plane);
    }
    let own = joint.view((POSE, POSE), (size, size));
    let cross = joint.view((POSE, 0), (size, POSE)).select_columns(free);
    let anchored = joint.fixed_view::<POSE, POSE>(0, 0).select_rows(free).select_columns(free);
    let carried = &rows * cross.transpose();
    own - &carried - carried.transpose() + &rows * anchored * rows.transpose()
}

#[cfg(test)]
mod tests {
    use super::super::perturbation::tests::any_pose;
    use super::super::perturbation::{perturbed_plane, perturbed_pose};
    use super::*;
    use nalgebra::{UnitQuaternion, Vector6};
    use proptest::prelude::*;

    proptest! {
        /// A world moved and turned as a whole has no error beside any of its poses.
        #[test]
        fn what_moves_with_the_anchor_is_exact(
            anchor in any_pose(), pose in any_pose(), plane in any_pose(),
            shift in prop::array::uniform3(-1.0..1.0f64),
            turn in prop::array::uniform3(-1.0..1.0f64),
        ) {
            let (shift, turn) = (Vector3::from(shift) * 1e-5, Vector3::from(turn) * 1e-5);
            let about = UnitQuaternion::from_scaled_axis(turn);
            let centre = anchor.translation.vector;
            let moved = |frame: &Isometry3<f64>| {
                let at = centre + shift + about * (frame.translation.vector - centre);
                Isometry3::from_parts(at.into(), about * frame.rotation)
            };
            let free = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
            let told: Vector6<f64> = pose_rows(&anchor, &pose) * free;
            let off = moved(&pose).inverse() * perturbed_pose(&pose, &told);
            prop_assert!(off.translation.vector.norm() < 1e-8 && off.rotation.angle() < 1e-8);
            // In its plane a frame may lie anywhere, turned about its normal anyhow.
            let off = moved(&plane).inverse() * perturbed_plane(&plane, &(plane_rows(&anchor, &plane) * free));
            let normal = off.rotation * Vector3::z();
            prop_assert!(off.translation.vector.z.abs() < 1e-8 && normal.xy().norm() < 1e-8);
        }
    }

    #[test]
    fn an_anchor_beside_itself_keeps_roll_and_pitch_where_gravity_is_measured_and_nothing_elsewhere()
     {
        let anchor = Isometry3::translation(3.0, 1.0, 0.5);
        let own = DMatrix::from_fn(6, 6, |i, j| if i == j { 1.0 + i as f64 } else { 0.1 });
        let twice = DMatrix::from_fn(12, 12, |i, j| own[(i % 6, j % 6)]);
        assert!(beside(&anchor, &anchor, &[], &twice, false).abs().max() < 1e-12);
        let left = beside(&anchor, &anchor, &[], &twice, true);
        for (i, j) in (0..6).flat_map(|i| (0..6).map(move |j| (i, j))) {
            let kept = if (3..5).contains(&i) && (3..5).contains(&j) { own[(i, j)] } else { 0.0 };
            assert!((left[(i, j)] - kept).abs() < 1e-12, "{left}");
        }
    }
}
