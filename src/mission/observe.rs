//! Looking on: lines of a session that somebody else drives.

use super::motion::PlanarPose;
use super::running::{Desk, Running};
use crate::mapping::ScanErrors;
use crate::robot::HeadPose;
use crate::scan::{ImageRow, LaserLine, RangeImage};
use crate::time::{Span, Stamp};
use serde::{Deserialize, Serialize};

/// The head counts as at rest when it pointed the same way this long before.
const REST: Span = Span::from_millis(250);

/// Motion of the head within [`REST`] that counts as none, in radians: readings have four decimals.
const STILL_RAD: f64 = 0.002;

/// Tilt up to which a line is taken as level, in radians: its beams then stay at the laser's height.
const LEVEL_RAD: f64 = 0.087;

/// Least tilt between two rows of a sweep, in radians.
const ROW_RAD: f64 = 0.003;

/// Rows that make a sweep worth segmenting.
const ROWS: usize = 20;

/// Lines at one tilt after the last row that end a sweep: the client has gone on to something else.
const LINGER: usize = 15;

/// Uncertainty of a row's tilt in radians: that of a reading.
const ROW_SIGMA_RAD: f64 = 1e-4;

/// A sweep that somebody else commands, line by line: rows are the lines that were taken with the
/// head at rest, each tilted farther than the one before, while the robot stood.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ObservedSweep {
    rows: Vec<(HeadPose, LaserLine)>,
    stands_at: PlanarPose,
    lingered: usize,
}

impl ObservedSweep {
    /// Whether a line under `pose` goes on with the sweep, so far in one direction and at one place.
    fn goes_on(&self, pose: HeadPose, wheels: PlanarPose) -> bool {
        let step = |a: &HeadPose, b: &HeadPose| b.tilt_rad - a.tilt_rad;
        match self.rows.as_slice() {
            [] => true,
            _ if wheels != self.stands_at || self.lingered >= LINGER => false,
            [_] => true,
            [.., (before, _), (last, _)] => {
                let next = step(last, &pose);
                next.abs() < ROW_RAD || next * step(before, last) > 0.0
            }
        }
    }

    fn push(&mut self, pose: HeadPose, line: &LaserLine, wheels: PlanarPose) {
        let is_new = self
            .rows
            .last()
            .is_none_or(|(last, _)| (pose.tilt_rad - last.tilt_rad).abs() >= ROW_RAD);
        if is_new {
            self.rows.push((pose, line.clone()));
            self.stands_at = wheels;
            self.lingered = 0;
        } else {
            self.lingered += 1;
        }
    }
}

impl Running {
    /// A line in a recording of another client. With the head at rest it is a row of a sweep, and
    /// level it enters the grid as flat rays too. With the head in motion, or pointing nobody knows
    /// where, it tells nothing.
    pub(super) fn observed_line(&mut self, line: &LaserLine, desk: &mut Desk<'_>) {
        let Some(pose) = self.resting_head(line.stamp) else { return };
        if pose.tilt_rad.abs() <= LEVEL_RAD {
            let robot_from_sensor = self.rig.robot_from_sensor(pose);
            self.take_level_line(line, &robot_from_sensor);
        }
        if self.acquisition.is_none() {
            return;
        }
        if !self.observed.goes_on(pose, self.last_wheels) {
            self.finish_observed_sweep(desk);
        }
        self.observed.push(pose, line, self.last_wheels);
    }

    /// Ends the sweep that was being watched; it enters the belief if it is one.
    pub(super) fn finish_observed_sweep(&mut self, desk: &mut Desk<'_>) {
        let ObservedSweep { rows, .. } = std::mem::take(&mut self.observed);
        let [(first_pose, first), .., _] = rows.as_slice() else { return };
        if rows.len() < ROWS {
            return;
        }
        let robot_from_scan = self.rig.robot_from_sensor(HeadPose::default());
        let scan_from_robot = robot_from_scan.inverse();
        let bearings = (0..first.len()).map(|beam| first.bearing_rad(beam)).collect();
        let mut image = RangeImage::new(robot_from_scan, bearings, first.max_range_m);
        for (pose, line) in &rows {
            let row = ImageRow {
                tilt_rad: pose.tilt_rad,
                tilt_sigma_rad: ROW_SIGMA_RAD,
                scan_from_sensor: scan_from_robot * self.rig.robot_from_sensor(*pose),
                stamp: Some(line.stamp),
            };
            image.push_line(row, line);
        }
        let last_tilt_rad = rows.last().map_or(0.0, |(pose, _)| pose.tilt_rad);
        let findings = self.belief.take_scan(image, ScanErrors::default());
        let counts = [findings.planes, findings.spheres, findings.cylinders];
        for (sum, count) in self.ledger.surfaces.iter_mut().zip(counts) {
            *sum += count;
        }
        self.ledger.associations += findings.update.associations.len();
        self.ledger.fixes.book(&findings.update);
        desk.info(format!(
            "sweep seen: {} rows from {:+.1}° to {:+.1}°, {} planes",
            rows.len(),
            first_pose.tilt_rad.to_degrees(),
            last_tilt_rad.to_degrees(),
            findings.planes
        ));
        self.map_sweep(desk.now);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> LaserLine {
        LaserLine {
            stamp: Stamp::default(),
            first_bearing_rad: 0.0,
            bearing_step_rad: 0.1,
            min_range_m: 0.1,
            max_range_m: 20.0,
            phantom_m: None,
            ranges_m: vec![1.0],
        }
    }

    fn sweep(tilts: &[f64]) -> ObservedSweep {
        let mut sweep = ObservedSweep::default();
        for tilt in tilts {
            let pose = HeadPose::tilted(*tilt);
            assert!(sweep.goes_on(pose, PlanarPose::default()));
            sweep.push(pose, &line(), PlanarPose::default());
        }
        sweep
    }

    #[test]
    fn rows_of_one_direction_make_a_sweep_and_repeats_are_one_row() {
        let sweep = sweep(&[-0.1, -0.1, -0.05, 0.0, 0.0, 0.05]);
        assert_eq!(sweep.rows.len(), 4);
        assert!(!sweep.goes_on(HeadPose::tilted(0.0), PlanarPose::default()), "it turned back");
    }

    #[test]
    fn a_robot_that_moves_or_a_head_that_lingers_ends_the_sweep() {
        let mut watched = sweep(&[-0.1, -0.05]);
        let moved = PlanarPose { x_m: 0.01, ..PlanarPose::default() };
        assert!(!watched.goes_on(HeadPose::tilted(0.0), moved));
        for _ in 0..LINGER {
            watched.push(HeadPose::tilted(-0.05), &line(), PlanarPose::default());
        }
        assert!(!watched.goes_on(HeadPose::tilted(0.0), PlanarPose::default()));
    }
}
