//! The rig: mounts, limits and kinematics learned from the server, and wire values turned into project frames.
mod beams;
mod drive;
mod frames;
mod head;
mod mount;
mod visibility;
pub use beams::Beams;
pub use drive::{BodySpeed, DriveTrain, WheelSpin};
pub use frames::{
    core_point, core_pose, core_rotation, core_vector, wire_location, wire_orientation,
};
pub use head::{Axis, Demand, HeadPose, HeadReading, JointAngle, ScanHead};
pub use mount::{Joint, JointKind, Mount};
pub use visibility::{GroundSight, GroundView, Visibility};
