//! A laser on a tilt axis, in terms that fit into one line of a file.

use crate::robot::{HeadPose, ScanHead};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Where a laser sits that one axis tilts.
#[derive(Clone, Debug, PartialEq)]
pub struct TiltMount {
    /// The tilt axis in the robot's frame (x forward, y left, z up, metres): it is the y axis of this
    /// pose, so that growing tilts look down.
    pub robot_from_axis: Isometry3<f64>,
    /// The laser as the axis carries it, at tilt 0.
    pub axis_from_laser: Isometry3<f64>,
}

/// A tilt that tells the axis well.
const SAMPLE_RAD: f64 = 1.0;

impl TiltMount {
    /// That of a scan head with its pan at zero; `None` for a head that does not tilt.
    pub fn of(head: &ScanHead) -> Option<Self> {
        head.tilt()?;
        let level = head.robot_from_device(HeadPose::default());
        let turn = head.robot_from_device(HeadPose::tilted(SAMPLE_RAD)) * level.inverse();
        let (axis, angle_rad) = turn.rotation.axis_angle()?;
        // The point of the axis nearest to the robot's origin: what a turn about it leaves in place.
        let moved = turn.translation.vector;
        let moved = moved - axis.into_inner() * axis.dot(&moved);
        let point = 0.5 * (moved + axis.cross(&moved) / (0.5 * angle_rad).tan());
        let rotation = UnitQuaternion::rotation_between(&Vector3::y(), &axis)
            .unwrap_or_else(UnitQuaternion::identity);
        let robot_from_axis = Isometry3::from_parts(Translation3::from(point), rotation);
        Some(Self { axis_from_laser: robot_from_axis.inverse() * level, robot_from_axis })
    }

    /// The laser in the robot's frame under a tilt in radians, down positive.
    pub fn robot_from_laser(&self, tilt_rad: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt_rad);
        self.robot_from_axis * turn * self.axis_from_laser
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Joint, JointKind, Mount};
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_heads_own_kinematics_come_back() {
        // Angles as GEO prints them, and a laser that is mounted askew.
        let joints = vec![
            Joint::from_wire(
                "PT",
                1,
                JointKind::Revolute,
                [0.12, 0.01, -0.2],
                [PI - 1e-4, 0.0, 0.0],
            ),
            Joint::from_wire(
                "PT",
                2,
                JointKind::Revolute,
                [0.0, 0.0, 0.06],
                [FRAC_PI_2 - 1e-4, 0.0, 0.02],
            ),
        ];
        let device = Isometry3::new(Vector3::new(0.06, 0.02, 0.05), Vector3::new(0.1, 0.2, 0.3));
        let head = ScanHead::new(Mount { joints, part_from_device: device });
        let mount = TiltMount::of(&head).unwrap();
        for tilt_rad in [-0.44, 0.0, 0.1, 0.52] {
            let here = mount.robot_from_laser(tilt_rad);
            let off = here.inverse() * head.robot_from_device(HeadPose::tilted(tilt_rad));
            assert!(off.translation.vector.norm() < 1e-12, "{off}");
            assert!(off.rotation.angle() < 1e-7, "{off}");
        }
        let fixed = ScanHead::new(Mount::on_body([0.1, 0.0, -0.1], [PI - FRAC_PI_2, 0.0, 0.0]));
        assert_eq!(TiltMount::of(&fixed), None);
    }
}
