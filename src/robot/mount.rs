use super::frames::{core_pose, turned};
use crate::geometry::AngleSpan;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// How a joint moves what it carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum JointKind {
    /// Turns about its axis; values in radians.
    Revolute,
    /// Slides along its axis; values in metres.
    Prismatic,
}

/// One moving link between the robot's body and a device, as GEO and CONF describe it.
///
/// The joint axis is the wire z axis of the link's mounting frame, which is given relative to the
/// parent's mounting frame at zero joint value (protocol 5.4).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Mission package or actuator the link belongs to, as the server spells it.
    pub package: String,
    /// Link number on the wire, counted from 1.
    pub link: u32,
    /// Turning or sliding.
    pub kind: JointKind,
    /// The link's mounting frame in its parent's, in core axes.
    pub parent_from_joint: Isometry3<f64>,
    /// Values the link accepts, on the wire's sign; `None` without a limit.
    pub limits: Option<AngleSpan>,
    /// Highest speed in radians (metres) per second, if the server named one.
    pub max_speed: Option<f64>,
    /// Whether the server turns this link against the sense its axis promises.
    pub inverted: bool,
}

impl Joint {
    /// A link from its wire description, without limits and of unknown speed.
    pub fn from_wire(
        package: &str,
        link: u32,
        kind: JointKind,
        location: [f64; 3],
        roll_pitch_yaw: [f64; 3],
    ) -> Self {
        Self {
            package: package.to_owned(),
            link,
            kind,
            parent_from_joint: core_pose(location, roll_pitch_yaw),
            limits: None,
            max_speed: None,
            inverted: false,
        }
    }

    /// What the joint adds at a wire value. The wire's z axis points along the core's -z, and a
    /// rotation keeps its angle when its axis is carried over.
    fn displacement(&self, value: f64) -> Isometry3<f64> {
        let value = if self.inverted { -value } else { value };
        match self.kind {
            JointKind::Revolute => {
                let rotation = UnitQuaternion::from_axis_angle(&-Vector3::z_axis(), value);
                Isometry3::from_parts(Translation3::identity(), rotation)
            }
            JointKind::Prismatic => Isometry3::translation(0.0, 0.0, -value),
        }
    }
}

/// Where a device sits: joints from the body outwards, then the device on the last of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mount {
    /// Joints from the body outwards; none for a device on the body.
    pub joints: Vec<Joint>,
    /// The device in the axes of the part that carries it.
    pub part_from_device: Isometry3<f64>,
}

impl Mount {
    /// A device on the body, from its wire location and orientation.
    pub fn on_body(location: [f64; 3], roll_pitch_yaw: [f64; 3]) -> Self {
        Self { joints: Vec::new(), part_from_device: core_pose(location, roll_pitch_yaw) }
    }

    /// Pose of the device in the robot frame, given each joint's wire value.
    ///
    /// A part's own axes, in which device mountings are given, are parallel to the body's at zero
    /// joint values, so the turns of the mounting frames are undone at the end (protocol 5.4).
    pub fn robot_from_device(&self, value_of: impl Fn(usize) -> f64) -> Isometry3<f64> {
        let mut robot_from_joint = Isometry3::identity();
        let mut undone = UnitQuaternion::identity();
        for (index, joint) in self.joints.iter().enumerate() {
            robot_from_joint *= joint.parent_from_joint * joint.displacement(value_of(index));
            undone *= joint.parent_from_joint.rotation;
        }
        robot_from_joint * undone.inverse() * self.part_from_device
    }

    /// Direction about which joint `index` turns for growing wire values, in the robot frame at zero
    /// joint values.
    pub fn axis(&self, index: usize) -> Vector3<f64> {
        let turned_by: UnitQuaternion<f64> = self.joints[..=index]
            .iter()
            .fold(UnitQuaternion::identity(), |sum, j| sum * j.parent_from_joint.rotation);
        let axis = turned_by * -Vector3::z();
        if self.joints[index].inverted { -axis } else { axis }
    }
}

/// The mounting frame of a link in its parent's, corrected for the attitude the robot had when GEO
/// was asked.
///
/// K measures the location of link 2 and further in the world and turns it back by the static frame
/// alone (protocol 5.4), so a robot that stands at a heading gets the offset turned by that heading.
/// `body_from_parent` is the parent's static mounting frame, `world_from_body` the robot's attitude,
/// both as wire rotations.
pub(super) fn corrected_link_location(
    reported: [f64; 3],
    body_from_parent: &UnitQuaternion<f64>,
    world_from_body: &UnitQuaternion<f64>,
) -> [f64; 3] {
    let in_world = body_from_parent * Vector3::from(reported);
    let in_parent = body_from_parent.inverse() * (world_from_body.inverse() * in_world);
    in_parent.into()
}

/// The wire rotation of a joint's mounting frame.
pub(super) fn wire_rotation(joint: &Joint) -> UnitQuaternion<f64> {
    turned(&joint.parent_from_joint.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// The pan-tilt of protocol 5.4.
    fn camera_pan_tilt() -> Vec<Joint> {
        vec![
            Joint::from_wire(
                "CameraPanTilt",
                1,
                JointKind::Revolute,
                [0.1239, 0.0, -0.2036],
                [PI, 0.0, 0.0],
            ),
            Joint::from_wire(
                "CameraPanTilt",
                2,
                JointKind::Revolute,
                [0.0, 0.0, 0.0599],
                [FRAC_PI_2, 0.0, 0.0],
            ),
        ]
    }

    #[test]
    fn second_link_sits_six_centimetres_above_the_first() {
        let mount = Mount { joints: camera_pan_tilt(), part_from_device: Isometry3::identity() };
        let pose = mount.robot_from_device(|_| 0.0);
        // (0.1239, 0, -0.2635) on the wire.
        assert!((pose.translation.vector - Vector3::new(0.1239, 0.0, 0.2635)).norm() < 1e-12);
        assert!(pose.rotation.angle() < 1e-7, "at zero angles the part is parallel to the body");
    }

    #[test]
    fn pan_is_positive_to_the_left_and_tilt_positive_upwards() {
        let mount = Mount { joints: camera_pan_tilt(), part_from_device: Isometry3::identity() };
        assert!((mount.axis(0) - Vector3::z()).norm() < 1e-12);
        assert!((mount.axis(1) + Vector3::y()).norm() < 1e-12);
        let ahead = Point3::new(1.0, 0.0, 0.0);
        let panned = mount.robot_from_device(|i| if i == 0 { 0.2 } else { 0.0 }) * ahead;
        assert!(panned.y > 0.19, "left is +y: {panned}");
        let tilted = mount.robot_from_device(|i| if i == 1 { 0.2 } else { 0.0 }) * ahead;
        assert!(tilted.z > 0.2635 + 0.19, "up is +z: {tilted}");
    }

    #[test]
    fn the_chain_equals_the_documents_product_of_wire_matrices() {
        let (t1, t2) = (0.3, -0.4);
        let (l, o) = ([0.06, 0.01, -0.0087], [0.1, 0.2, -0.3]);
        let rx = |a: f64| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), a);
        let rz = |a: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), a);
        let wire = Isometry3::translation(0.1239, 0.0, -0.2036)
            * rx(PI)
            * rz(t1)
            * Isometry3::translation(0.0, 0.0, 0.0599)
            * rx(FRAC_PI_2)
            * rz(t2)
            * (rx(FRAC_PI_2) * rx(PI)).inverse()
            * Isometry3::translation(l[0], l[1], l[2])
            * UnitQuaternion::from_euler_angles(o[0], o[1], o[2]);
        let mount = Mount { joints: camera_pan_tilt(), part_from_device: core_pose(l, o) };
        let core = mount.robot_from_device(|i| [t1, t2][i]);
        let p = [0.7, -0.2, 0.4];
        let expected = wire * Point3::from(p);
        let found = core * super::super::frames::core_point(p);
        assert!((found - Point3::new(expected.x, -expected.y, -expected.z)).norm() < 1e-12);
    }

    #[test]
    fn a_link_location_asked_at_a_heading_is_turned_back() {
        let body_from_parent = UnitQuaternion::from_euler_angles(PI, 0.0, 0.0);
        let world_from_body = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.8);
        let truth = Vector3::new(0.05, 0.02, 0.06);
        // What K does: world difference, turned back by the static frame alone.
        let reported = body_from_parent.inverse() * (world_from_body * (body_from_parent * truth));
        let found = corrected_link_location(reported.into(), &body_from_parent, &world_from_body);
        assert!((Vector3::from(found) - truth).norm() < 1e-12);
    }
}
