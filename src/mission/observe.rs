//! Looking on: lines of a session that somebody else drives.

use super::running::Running;
use crate::robot::HeadPose;
use crate::scan::LaserLine;
use crate::time::{Span, Stamp};

/// The head counts as at rest when it pointed the same way this long before.
const REST: Span = Span::from_millis(250);

/// Motion of the head within [`REST`] that counts as none, in radians: readings have four decimals.
const STILL_RAD: f64 = 0.002;

/// Tilt up to which a line is taken as level, in radians: its beams then stay at the laser's height.
const LEVEL_RAD: f64 = 0.087;

impl Running {
    /// A line in a recording of another client. With the head at rest and level it enters the grid as
    /// flat rays, at rest and tilted as points in space; with the head in motion, or pointing nobody
    /// knows where, not at all.
    pub(super) fn observed_line(&mut self, line: &LaserLine) {
        let Some(pose) = self.resting_head(line.stamp) else { return };
        let robot_from_sensor = self.rig.robot_from_sensor(pose);
        if pose.tilt_rad.abs() <= LEVEL_RAD {
            self.take_level_line(line, &robot_from_sensor);
        } else {
            self.belief.take_line(line, &robot_from_sensor, pose.tilt_rad);
        }
    }

    /// Where the head pointed at `stamp` if it was at rest then. A head that was never heard of has
    /// not moved from zero.
    fn resting_head(&self, stamp: Stamp) -> Option<HeadPose> {
        let Some(acquisition) = &self.acquisition else { return Some(HeadPose::default()) };
        let Some(pose) = acquisition.pose_at(stamp) else { return Some(HeadPose::default()) };
        let before = acquisition.pose_at(stamp + Span(-REST.0)).unwrap_or(pose);
        let still = (pose.tilt_rad - before.tilt_rad).abs() <= STILL_RAD
            && (pose.pan_rad - before.pan_rad).abs() <= STILL_RAD;
        still.then_some(pose)
    }
}
