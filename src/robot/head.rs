use super::mount::{JointKind, Mount};
use crate::geometry::AngleSpan;
use crate::time::Stamp;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Where the scan head points: core angles of its pan and tilt joints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeadPose {
    /// Pan in radians, left positive.
    pub pan_rad: f64,
    /// Tilt in radians, down positive: the paper's sweep runs from -25° (up) to +29.75°.
    pub tilt_rad: f64,
}

impl HeadPose {
    /// Straight ahead under the given tilt.
    pub fn tilted(tilt_rad: f64) -> Self {
        Self { pan_rad: 0.0, tilt_rad }
    }
}

/// What a joint is told to do, in core angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Demand {
    /// Go to an angle in radians (order 0).
    Angle(f64),
    /// Turn at a constant rate in radians per second (order 1, UT2004 alone).
    Rate(f64),
}

/// What a joint said of itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointAngle {
    /// Core angle in radians.
    pub angle_rad: f64,
    /// The true angle lies within this of it: servers cut and quantise what they print.
    pub half_width_rad: f64,
}

/// A status line of the package that carries the laser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeadReading {
    /// When, by the server's stamp.
    pub stamp: Stamp,
    /// The pan joint, if the line named it.
    pub pan: Option<JointAngle>,
    /// The tilt joint, if the line named it.
    pub tilt: Option<JointAngle>,
}

/// One joint of the scan head in core terms.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Mission package or actuator to be commanded.
    pub package: String,
    /// Link number on the wire, counted from 1.
    pub link: u32,
    /// +1 or -1: core angle = this × wire value.
    pub core_per_wire: f64,
    /// Core angles the link reaches; `None` without a limit.
    pub limits: Option<AngleSpan>,
    /// Greatest speed in radians per second, where the server names one.
    pub speed_rad_s: Option<f64>,
    joint: usize,
}

impl Axis {
    /// The wire value of a core angle.
    pub fn wire_value(&self, core_rad: f64) -> f64 {
        core_rad * self.core_per_wire
    }

    /// The core angle of a wire value.
    pub fn core_angle_rad(&self, wire: f64) -> f64 {
        wire * self.core_per_wire
    }

    /// The reachable angle nearest to `core_rad`.
    pub fn clamp(&self, core_rad: f64) -> f64 {
        self.limits.map_or(core_rad, |limits| limits.clamp(core_rad))
    }
}

/// A device and those joints of its mount that point it.
///
/// Which link pans and which tilts follows from the axes, not from their numbers: the outermost
/// revolute joint whose axis lies across the body tilts, the outermost upright one pans. All other
/// joints are taken to rest at zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanHead {
    mount: Mount,
    pan: Option<Axis>,
    tilt: Option<Axis>,
}

/// A joint axis counts as upright or as lying across when it is within 25° of that direction.
const AXIS_AGREEMENT: f64 = 0.9;

impl ScanHead {
    /// The head that carries a device on `mount`.
    pub fn new(mount: Mount) -> Self {
        let outermost = |component: fn(&nalgebra::Vector3<f64>) -> f64| {
            (0..mount.joints.len()).rev().find_map(|index| {
                let along = component(&mount.axis(index));
                let revolute = mount.joints[index].kind == JointKind::Revolute;
                (revolute && along.abs() > AXIS_AGREEMENT)
                    .then(|| axis_of(&mount, index, along.signum()))
            })
        };
        let (pan, tilt) = (outermost(|axis| axis.z), outermost(|axis| axis.y));
        Self { mount, pan, tilt }
    }

    /// The joint that turns the device left and right.
    pub fn pan(&self) -> Option<&Axis> {
        self.pan.as_ref()
    }

    /// The joint that turns the device up and down; a device without one scans a single plane.
    pub fn tilt(&self) -> Option<&Axis> {
        self.tilt.as_ref()
    }

    /// Where and on what the device is mounted.
    pub fn mount(&self) -> &Mount {
        &self.mount
    }

    /// Pose of the device in the robot frame with the head at `pose`.
    pub fn robot_from_device(&self, pose: HeadPose) -> Isometry3<f64> {
        let wire_of = |axis: &Option<Axis>, index: usize, core_rad: f64| {
            axis.as_ref().filter(|axis| axis.joint == index).map(|axis| axis.wire_value(core_rad))
        };
        self.mount.robot_from_device(|index| {
            wire_of(&self.tilt, index, pose.tilt_rad)
                .or_else(|| wire_of(&self.pan, index, pose.pan_rad))
                .unwrap_or(0.0)
        })
    }

    /// The same head with the tilt joint turning the other way round.
    #[must_use]
    pub fn with_tilt_inverted(self) -> Self {
        let joint = self.tilt.as_ref().map(|axis| axis.joint);
        self.with_inverted(joint)
    }

    /// The same head with the pan joint turning the other way round.
    #[must_use]
    pub fn with_pan_inverted(self) -> Self {
        let joint = self.pan.as_ref().map(|axis| axis.joint);
        self.with_inverted(joint)
    }

    /// Lets a link of a package turn the other way round, if it is one of this head's joints.
    pub fn invert(&mut self, package: &str, link: u32) {
        let joints = &self.mount.joints;
        let joint = joints.iter().position(|j| j.package == package && j.link == link);
        *self = self.clone().with_inverted(joint);
    }

    /// Narrows or widens what the tilt joint reaches, in core angles, as far as it was found out.
    pub fn limit_tilt(&mut self, limits: Option<AngleSpan>) {
        let Some(tilt) = &mut self.tilt else { return };
        tilt.limits = limits;
        let sign = tilt.core_per_wire;
        self.mount.joints[tilt.joint].limits =
            limits.map(|core| AngleSpan::new(core.min_rad * sign, core.max_rad * sign));
    }

    fn with_inverted(self, joint: Option<usize>) -> Self {
        let mut mount = self.mount;
        if let Some(joint) = joint {
            mount.joints[joint].inverted = !mount.joints[joint].inverted;
        }
        Self::new(mount)
    }
}

fn axis_of(mount: &Mount, index: usize, core_per_wire: f64) -> Axis {
    let joint = &mount.joints[index];
    Axis {
        package: joint.package.clone(),
        link: joint.link,
        core_per_wire,
        limits: joint
            .limits
            .map(|wire| AngleSpan::new(wire.min_rad * core_per_wire, wire.max_rad * core_per_wire)),
        speed_rad_s: joint.max_speed,
        joint: index,
    }
}

#[cfg(test)]
mod tests {
    use super::super::mount::Joint;
    use super::*;
    use nalgebra::Point3;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn joint(link: u32, location: [f64; 3], orientation: [f64; 3]) -> Joint {
        Joint::from_wire("PanTilt", link, JointKind::Revolute, location, orientation)
    }

    fn head(joints: Vec<Joint>) -> ScanHead {
        ScanHead::new(Mount { joints, part_from_device: Isometry3::translation(0.06, 0.0, 0.0) })
    }

    fn stock() -> ScanHead {
        let mut tilt = joint(2, [0.0, 0.0, 0.0599], [FRAC_PI_2, 0.0, 0.0]);
        tilt.limits = Some(AngleSpan::new(-0.16, 0.40));
        head(vec![joint(1, [0.1239, 0.0, -0.2036], [PI, 0.0, 0.0]), tilt])
    }

    #[test]
    fn roles_follow_from_the_axes_and_not_from_the_numbers() {
        let stock = stock();
        assert_eq!(stock.pan().map(|a| (a.link, a.core_per_wire)), Some((1, 1.0)));
        assert_eq!(stock.tilt().map(|a| (a.link, a.core_per_wire)), Some((2, -1.0)));
        // A tilt that carries the pan, numbered the other way round.
        let swapped = head(vec![
            joint(1, [0.0; 3], [FRAC_PI_2, 0.0, 0.0]),
            joint(2, [0.0; 3], [-FRAC_PI_2, 0.0, 0.0]),
        ]);
        assert_eq!(swapped.tilt().map(|a| a.link), Some(1));
        assert_eq!(swapped.pan().map(|a| (a.link, a.core_per_wire)), Some((2, -1.0)));
    }

    #[test]
    fn core_tilt_looks_down_whatever_the_wire_says() {
        for head in [stock(), stock().with_tilt_inverted()] {
            let ahead = head.robot_from_device(HeadPose::tilted(0.3)) * Point3::new(1.0, 0.0, 0.0);
            let level = head.robot_from_device(HeadPose::default()) * Point3::new(1.0, 0.0, 0.0);
            assert!(ahead.z < level.z - 0.2);
        }
    }

    #[test]
    fn wire_limits_upwards_are_core_limits_with_the_sign_turned() {
        let limits = stock().tilt().and_then(|a| a.limits).unwrap();
        assert_eq!((limits.min_rad, limits.max_rad), (-0.40, 0.16));
        let inverted = stock().with_tilt_inverted();
        let limits = inverted.tilt().and_then(|a| a.limits).unwrap();
        assert_eq!((limits.min_rad, limits.max_rad), (-0.16, 0.40));
    }

    #[test]
    fn a_device_on_the_body_neither_pans_nor_tilts() {
        let fixed = ScanHead::new(Mount::on_body([0.1439, 0.0, -0.092], [0.0; 3]));
        assert!(fixed.pan().is_none() && fixed.tilt().is_none());
        let pose = fixed.robot_from_device(HeadPose { pan_rad: 1.0, tilt_rad: 1.0 });
        assert!(
            (pose.translation.vector - nalgebra::Vector3::new(0.1439, 0.0, 0.092)).norm() < 1e-12
        );
    }

    #[test]
    fn a_joint_about_the_long_axis_is_neither() {
        let roller = head(vec![joint(1, [0.0; 3], [0.0, FRAC_PI_2, 0.0])]);
        assert!(roller.pan().is_none() && roller.tilt().is_none());
    }
}
