//! Lines taken between two sweeps: when and where, and into the terrain with them.

use super::belief::Belief;
use crate::geometry::lie::se3_between;
use crate::scan::{ImageRow, LaserLine, RangeImage};
use crate::time::Stamp;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Lines that wait for odometry at most.
const MOST_PENDING: usize = 4;

/// A line that waits for the odometry after it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PendingLine {
    line: LaserLine,
    robot_from_sensor: Isometry3<f64>,
    tilt_rad: f64,
    cast: Stamp,
    /// Whether it is known well enough where the laser was to map what it shows.
    is_sure: bool,
}

/// A robot on its way.
pub(super) struct Passing {
    /// On the leg.
    pub(super) keyframe_from_robot: Isometry3<f64>,
    pub(super) turn_rps: f64,
    pub(super) speed_mps: f64,
}

impl Passing {
    fn resting(keyframe_from_robot: Isometry3<f64>) -> Self {
        Self { keyframe_from_robot, turn_rps: 0.0, speed_mps: 0.0 }
    }
}

impl Belief {
    /// Where the robot was at `stamp`; `None` where no odometry surrounds it.
    fn at(&self, stamp: Stamp) -> Option<Passing> {
        let after = self.history.iter().position(|(at, _)| *at >= stamp)?;
        let (late, pose_late) = self.history[after];
        if after == 0 {
            return (late == stamp).then_some(Passing::resting(pose_late));
        }
        let (early, pose_early) = self.history[after - 1];
        let seconds = (late - early).seconds();
        if seconds <= 0.0 {
            return Some(Passing::resting(pose_late));
        }
        let share = (stamp - early).seconds() / seconds;
        let way = pose_late.translation.vector - pose_early.translation.vector;
        Some(Passing {
            keyframe_from_robot: se3_between(&pose_early, &pose_late, share),
            turn_rps: pose_early.rotation.angle_to(&pose_late.rotation) / seconds,
            speed_mps: way.norm() / seconds,
        })
    }

    /// Takes in a line of the resting laser at `robot_from_sensor` whose rays were cast at `cast`. It is
    /// mapped once odometry tells where the robot was then, unless it is not `is_sure` where the laser was.
    pub fn take_line(
        &mut self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        tilt_rad: f64,
        cast: Stamp,
        is_sure: bool,
    ) {
        // A line that no odometry follows says where the robot still is.
        if self.pending.len() == MOST_PENDING {
            self.pending.pop_front();
        }
        self.pending.push_back(PendingLine {
            line: line.clone(),
            robot_from_sensor: *robot_from_sensor,
            tilt_rad,
            cast,
            is_sure,
        });
        self.map_pending();
    }

    /// Maps the lines that odometry has caught up with.
    pub(super) fn map_pending(&mut self) {
        let newest = self.history.back().map(|(stamp, _)| *stamp);
        let is_caught_up = |pending: &PendingLine| match newest {
            Some(newest) => pending.cast <= newest,
            // Before the wheels tell anything the robot stands.
            None => true,
        };
        while self.pending_flat.front().is_some_and(is_caught_up) {
            if let Some(pending) = self.pending_flat.pop_front() {
                self.map_flat_line(&pending);
            }
        }
        let Some(newest) = newest else { return };
        while self.pending.front().is_some_and(|pending| pending.cast <= newest) {
            if let Some(pending) = self.pending.pop_front() {
                self.map_line(&pending);
            }
        }
    }

    /// Maps a line, unless the robot turned too fast for it.
    fn map_line(&mut self, pending: &PendingLine) {
        let PendingLine { line, robot_from_sensor, tilt_rad, cast, is_sure } = pending;
        let Some(passing) = self.at(*cast) else { return };
        let keyframe_from_robot = self.hold_against_walls(line, robot_from_sensor, &passing);
        if !is_sure || passing.turn_rps > self.config.mapped_turn_rps {
            return;
        }
        let bearings = (0..line.len()).map(|beam| line.bearing_rad(beam)).collect();
        let mut image = RangeImage::new(*robot_from_sensor, bearings, line.max_range_m);
        let row = ImageRow {
            tilt_rad: *tilt_rad,
            tilt_sigma_rad: 0.0,
            scan_from_sensor: Isometry3::identity(),
            stamp: Some(line.stamp),
        };
        image.push_line(row, line);
        self.live.integrate(&image, &(self.keyframe_pose() * keyframe_from_robot));
        self.leg.keep(Some(*cast), &keyframe_from_robot, image);
    }

    /// Maps an image taken under way, its rows displaced to where they were seen from where the robot
    /// is now.
    pub fn take_way_image(&mut self, image: RangeImage) {
        self.live.integrate(&image, &self.world_from_robot());
        self.leg.keep(None, &self.leg.begin_from_robot(), image);
    }

    /// Takes in a level line of a laser at `robot_from_sensor` whose rays were cast at `cast`: it is held
    /// against earlier ones and mapped as flat occupancy (2D mode), once odometry tells where the robot was
    /// then.
    pub fn take_flat_line(
        &mut self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        cast: Stamp,
    ) {
        if self.pending_flat.len() == MOST_PENDING {
            self.pending_flat.pop_front();
        }
        let (line, robot_from_sensor) = (line.clone(), *robot_from_sensor);
        self.pending_flat.push_back(PendingLine {
            line,
            robot_from_sensor,
            tilt_rad: 0.0,
            cast,
            is_sure: true,
        });
        self.map_pending();
    }

    /// Number of level lines mapped so far.
    pub fn flat_lines(&self) -> usize {
        self.flat_lines
    }

    fn map_flat_line(&mut self, pending: &PendingLine) {
        let PendingLine { line, robot_from_sensor, cast, .. } = pending;
        let passing = self.at(*cast).or_else(|| {
            // A robot that has not moved is where it was.
            (self.leg.path_m() == 0.0).then_some(Passing::resting(self.leg.begin_from_robot()))
        });
        let Some(passing) = passing else { return };
        let aligned = self.align_line(line, robot_from_sensor, &passing);
        if passing.turn_rps > self.config.mapped_turn_rps {
            return;
        }
        let world_from_sensor = self.keyframe_pose() * aligned * robot_from_sensor;
        self.live.integrate_line(line, &world_from_sensor);
        self.settled.integrate_line(line, &world_from_sensor);
        self.flat_lines += 1;
    }
}
