//! What a sweep came to.

use super::profile::QuarterDegrees;
use crate::robot::HeadPose;
use crate::scan::{ImageRow, LaserLine, RangeImage};
use crate::time::{Arrival, Stamp};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// A finished sweep: the range image and everything that is to be known about how it was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scan {
    /// The organised scan; rows in order of acquisition, gaps where no line could be had.
    pub image: RangeImage,
    /// Name of the profile.
    pub profile: String,
    /// Whether every row asked for was filed.
    pub complete: bool,
    /// Rows that hold a line.
    pub filed: usize,
    /// Rows that were given up.
    pub gaps: usize,
    /// Steps that had to be commanded a second time.
    pub repeats: usize,
    /// Rows that no reading confirmed, filed on the computed waiting time alone.
    pub unverified: usize,
    /// Errors common to the rows.
    pub errors: ScanErrors,
    /// Where the time went.
    pub budget: TimeBudget,
    /// Metres that the robot drove meanwhile; `None` for a scan taken standing. The rows of one taken
    /// under way are displaced to where they were seen from the robot's newest pose.
    pub driven_m: Option<f64>,
    /// When the first command was sent.
    pub started: Arrival,
    /// When the last row was filed or given up, or it was known why no more could be.
    pub ended: Arrival,
    /// What an operator should know, in plain words; empty when all went as told.
    pub remarks: Vec<String>,
}

impl Scan {
    /// Session seconds from the first tilt command to the last filed line.
    pub fn seconds(&self) -> f64 {
        (self.ended - self.started).seconds()
    }
}

/// Errors that do not average out over the points of a scan, one standard deviation each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScanErrors {
    /// Tilt error shared by all rows, in radians: zero of the joint, lag of a servo in one sweep
    /// direction.
    pub tilt_common_rad: f64,
    /// Tilt error of each row on its own, in radians.
    pub tilt_row_rad: f64,
    /// Error of the time at which a line was taken, in seconds; times the tilt rate it is an angle,
    /// already contained in the two above.
    pub time_s: f64,
}

/// Where the time of a sweep went, in session seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TimeBudget {
    /// What the tilt's travel takes at full speed, or at the rate that was asked for.
    pub moving_s: f64,
    /// The servo creeping into its target.
    pub servo_s: f64,
    /// Waiting for the laser, the tilt being where it should, or held back for lines to keep up.
    pub laser_s: f64,
    /// Nothing useful: time-outs, overdue lines, repeated steps, waiting for the server's clock or for
    /// the last reading, finding out whether the tilt still turns.
    pub idle_s: f64,
}

impl std::fmt::Display for TimeBudget {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { moving_s, servo_s, laser_s, idle_s } = self;
        write!(f, "moving {moving_s:.1}, servo {servo_s:.1}, laser {laser_s:.1}, idle {idle_s:.1}")
    }
}

impl TimeBudget {
    /// All of it.
    pub fn total_s(&self) -> f64 {
        self.moving_s + self.servo_s + self.laser_s + self.idle_s
    }

    /// Adds another sweep's.
    pub(super) fn add(&mut self, other: &Self) {
        self.moving_s += other.moving_s;
        self.servo_s += other.servo_s;
        self.laser_s += other.laser_s;
        self.idle_s += other.idle_s;
    }

    /// Adds the time of one row that took `total_s`, of which the servo law explains `slew_s` of
    /// slewing and `settle_s` until the target, both counted from the command.
    pub(super) fn add_row(&mut self, total_s: f64, slew_s: f64, settle_s: f64) {
        let moving = slew_s.clamp(0.0, total_s);
        let servo = settle_s.clamp(moving, total_s.max(moving)) - moving;
        self.moving_s += moving;
        self.servo_s += servo;
        self.laser_s += (total_s - moving - servo).max(0.0);
    }
}

/// One row as it was taken, before the image is put together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct FiledRow {
    /// The tilt asked for.
    pub demanded: QuarterDegrees,
    /// Where the head was; the tilt under which the row is filed.
    pub pose: HeadPose,
    /// Standard deviation of the tilt in radians.
    pub tilt_sigma_rad: f64,
    /// Displacement of the robot since the scan's reference time.
    pub reference_from_robot: Isometry3<f64>,
    /// The line, or `None` for a gap.
    pub line: Option<LaserLine>,
}

impl FiledRow {
    pub(super) fn stamp(&self) -> Option<Stamp> {
        self.line.as_ref().map(|line| line.stamp)
    }
}

/// Puts rows together. The columns are those of the first line; without any line there are none.
pub(super) fn image_of(
    rows: &[FiledRow],
    robot_from_scan: &Isometry3<f64>,
    scan_from_sensor: impl Fn(HeadPose) -> Isometry3<f64>,
) -> RangeImage {
    let first = rows.iter().find_map(|row| row.line.as_ref());
    let bearings =
        first.map_or_else(Vec::new, |line| (0..line.len()).map(|i| line.bearing_rad(i)).collect());
    let max_range_m = first.map_or(0.0, |line| line.max_range_m);
    let mut image = RangeImage::new(*robot_from_scan, bearings, max_range_m);
    let scan_from_robot = robot_from_scan.inverse();
    for row in rows {
        // The sensor moves with the head, and in a scan taken while driving with the robot as well.
        let moved = scan_from_robot * row.reference_from_robot * robot_from_scan;
        let image_row = ImageRow {
            tilt_rad: row.pose.tilt_rad,
            tilt_sigma_rad: row.tilt_sigma_rad,
            scan_from_sensor: moved * scan_from_sensor(row.pose),
            stamp: row.stamp(),
        };
        match &row.line {
            Some(line) => image.push_line(image_row, line),
            None => image.push_gap(image_row),
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_divided_into_slew_creep_and_laser() {
        let mut budget = TimeBudget::default();
        budget.add_row(1.0, 0.3, 0.8);
        assert_eq!((budget.moving_s, budget.laser_s), (0.3, 0.19999999999999996));
        assert!((budget.servo_s - 0.5).abs() < 1e-12);
        // A line that came before the law promised: nothing is negative, the sum is the time.
        budget.add_row(0.2, 0.3, 0.8);
        assert!((budget.total_s() - 1.2).abs() < 1e-12 && budget.laser_s > 0.19);
    }

    #[test]
    fn an_image_without_a_line_has_no_columns() {
        let row = FiledRow {
            demanded: QuarterDegrees(4),
            pose: HeadPose::tilted(0.017),
            tilt_sigma_rad: 0.0,
            reference_from_robot: Isometry3::identity(),
            line: None,
        };
        let image = image_of(&[row], &Isometry3::identity(), |_| Isometry3::identity());
        assert_eq!((image.rows().len(), image.columns()), (1, 0));
    }
}
