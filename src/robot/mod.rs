//! The rig: mounts, limits and kinematics learned from the server, and wire values turned into
//! project frames and units.
//!
//! A [`RigBuilder`] learns from GEO and CONF, one message at a time, and supposes what is not answered,
//! with a [`RigWarning`] for each supposition. The [`Rig`] it builds is a value: poses of sensors,
//! readings in core axes, commands for wheels and joints, and what ground the laser can see.
//!
//! The wire is x forward, y right, z down; the core is x forward, y left, z up. Here, and nowhere else
//! in the agent, the one is turned into the other. Ground truth has no way through the rig: scoring
//! has its own [`ScoringTruth`].

mod beams;
mod builder;
mod class_table;
mod drive;
mod frames;
mod head;
mod laser;
mod mount;
mod phantom;
mod readings;
mod rig;
mod signs;
mod truth;
mod visibility;
mod warning;
mod wheel_count;

pub use beams::Beams;
pub use builder::RigBuilder;
pub use drive::{BodySpeed, DriveTrain, WheelSpin};
pub use frames::{
    core_point, core_pose, core_rotation, core_vector, wire_location, wire_orientation,
};
pub use head::{Axis, Demand, HeadPose, HeadReading, JointAngle, ScanHead};
pub use laser::{Laser, LaserError};
pub use mount::{Joint, JointKind, Mount};
pub use phantom::PhantomWatch;
pub use readings::{
    Echo, InertialPlace, InsReading, OdometryReading, SonarEcho, TagSighting, VictimSighting,
};
pub use rig::{Body, Device, Rig, SonarSensor};
pub use signs::{SignVerdict, pan_sign, tilt_sign};
pub use truth::ScoringTruth;
pub use visibility::{GroundSight, GroundView, Visibility};
pub use warning::RigWarning;
pub use wheel_count::WheelCount;

#[cfg(test)]
mod tests;
