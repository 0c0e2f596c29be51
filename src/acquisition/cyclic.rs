//! Cyclic requests: odometry, tilt and laser of one and the same time, as the paper's real robot is
//! asked for them, live or from a record.
//!
//! The paper calls their timing "of utmost importance": a [`RecordedTriples`] can be replayed with its
//! tilts or poses desynchronised, to see what that does to a scan.

use super::control::HeadControl;
use super::dated::Taken;
use crate::geometry::lie::se3_between;
use crate::robot::{HeadPose, ScanHead};
use crate::scan::{ImageRow, LaserLine, RangeImage};
use crate::time::{Span, Stamp};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use std::fmt::Write as _;

/// Odometry, tilt and laser of one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Triple {
    /// When the rays were cast.
    pub stamp: Stamp,
    /// The robot by odometry and inertial unit then, in any frame that stays the same.
    pub frame_from_robot: Isometry3<f64>,
    /// The tilt then, in radians, down positive.
    pub tilt_rad: f64,
    /// The line.
    pub line: LaserLine,
}

/// Something that answers cyclic requests.
pub trait CyclicSource {
    /// The first triple not earlier than `due`; `None` when there is none any more. Requests come in
    /// order of time.
    fn request(&mut self, due: Stamp) -> Option<Triple>;
}

/// Lines as they came from a server, each answered with the tilt and the place interpolated to the time
/// of its casting.
pub(super) struct LiveTriples<'a> {
    lines: std::slice::Iter<'a, Taken>,
    control: &'a HeadControl,
    driving: bool,
}

impl<'a> LiveTriples<'a> {
    pub(super) fn new(lines: &'a [Taken], driving: bool, control: &'a HeadControl) -> Self {
        Self { lines: lines.iter(), control, driving }
    }

    /// The triple with the line as it was taken.
    pub(super) fn next_from(&mut self, due: Stamp) -> Option<(&'a Taken, Triple)> {
        let (control, driving) = (self.control, self.driving);
        self.lines.find_map(|taken| {
            let stamp = control.cast_time(&taken.line);
            if stamp < due {
                return None;
            }
            let frame_from_robot = match driving {
                true => control.body.displacement(stamp)?,
                false => Isometry3::identity(),
            };
            let tilt_rad = control.tilt.estimate(stamp)?.angle_rad;
            Some((taken, Triple { stamp, frame_from_robot, tilt_rad, line: taken.line.clone() }))
        })
    }
}

impl CyclicSource for LiveTriples<'_> {
    fn request(&mut self, due: Stamp) -> Option<Triple> {
        self.next_from(due).map(|(_, triple)| triple)
    }
}

/// A scan of up to `rows` rows by one request each `cycle`, the first at `start`; its frame is the scan
/// frame of the last row's robot. `None` if nothing answers.
pub fn scan_by_request(
    source: &mut dyn CyclicSource,
    (start, cycle, rows): (Stamp, Span, usize),
    head: &ScanHead,
) -> Option<RangeImage> {
    let mut triples: Vec<Triple> = Vec::new();
    let mut due = start;
    while triples.len() < rows
        && let Some(triple) = source.request(due)
    {
        due = match triples.is_empty() {
            true => triple.stamp + cycle,
            false => due + cycle,
        };
        triples.push(triple);
    }
    let robot_from_scan = head.robot_from_device(HeadPose::default());
    let newest = triples.last()?.frame_from_robot;
    let first = &triples.first()?.line;
    let bearings = (0..first.len()).map(|beam| first.bearing_rad(beam)).collect();
    let mut image = RangeImage::new(robot_from_scan, bearings, first.max_range_m);
    for triple in &triples {
        let robot_from_then = newest.inverse() * triple.frame_from_robot;
        let sensor = head.robot_from_device(HeadPose::tilted(triple.tilt_rad));
        let row = ImageRow {
            tilt_rad: triple.tilt_rad,
            tilt_sigma_rad: 0.0,
            scan_from_sensor: robot_from_scan.inverse() * robot_from_then * sensor,
            stamp: Some(triple.stamp),
        };
        image.push_line(row, &triple.line);
    }
    Some(image)
}

/// Triples read from a record.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedTriples {
    triples: Vec<Triple>,
    next: usize,
    tilt_late: Span,
    pose_late: Span,
}

/// Why a record of triples cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TripleError {
    /// The first line is not the heading.
    #[error("line 1: expected `{HEADING}`")]
    Heading,
    /// A line does not hold a triple.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
}

/// First line of a record.
const HEADING: &str = "usar triples 1";
/// Numbers before the ranges of a line: stamp, place, orientation, tilt, and the laser's geometry.
const FIXED: usize = 13;

impl RecordedTriples {
    /// A record of `triples`, put in order of time.
    pub fn new(mut triples: Vec<Triple>) -> Self {
        triples.sort_by_key(|triple| triple.stamp);
        Self { triples, ..Self::default() }
    }

    /// The same record with tilts `tilt_late` and poses `pose_late` later than their lines, either of
    /// them negative for earlier; times beyond the record are those of its ends.
    #[must_use]
    pub fn desynchronised(self, tilt_late: Span, pose_late: Span) -> Self {
        Self { tilt_late, pose_late, next: 0, ..self }
    }

    /// The triples, in order of time.
    pub fn triples(&self) -> &[Triple] {
        &self.triples
    }

    /// Reads a record: a heading, then a triple a line: stamp in seconds, x y z in metres, the
    /// orientation's w x y z, tilt in radians, first bearing and bearing step in radians, nearest and
    /// greatest distance and all ranges in metres.
    ///
    /// # Errors
    ///
    /// Where the text is no such record.
    pub fn parse(text: &str) -> Result<Self, TripleError> {
        let mut lines = text.lines().enumerate();
        if lines.next().map(|(_, line)| line.trim()) != Some(HEADING) {
            return Err(TripleError::Heading);
        }
        let triples = lines
            .filter(|(_, line)| !line.trim().is_empty())
            .map(|(at, line)| {
                triple_of(line).map_err(|what| TripleError::Line { line: at + 1, what })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self::new(triples))
    }

    /// The record as text, as [`RecordedTriples::parse`] reads it.
    pub fn to_text(&self) -> String {
        let mut text = format!("{HEADING}\n");
        for Triple { stamp, frame_from_robot, tilt_rad, line } in &self.triples {
            let t = frame_from_robot.translation.vector;
            let q = frame_from_robot.rotation.quaternion();
            // Writing to a string cannot fail.
            let _ = write!(
                text,
                "{:.6} {} {} {} {} {} {} {} {tilt_rad} {} {} {} {}",
                stamp.seconds(),
                t.x,
                t.y,
                t.z,
                q.w,
                q.i,
                q.j,
                q.k,
                line.first_bearing_rad,
                line.bearing_step_rad,
                line.min_range_m,
                line.max_range_m,
            );
            for range in &line.ranges_m {
                let _ = write!(text, " {range}");
            }
            text.push('\n');
        }
        text
    }

    /// Tilt and pose at `stamp`, interpolated; those of the ends beyond them.
    fn between(&self, stamp: Stamp) -> (f64, Isometry3<f64>) {
        let after = self.triples.partition_point(|triple| triple.stamp <= stamp);
        let last = self.triples.len() - 1;
        let (a, b) = (&self.triples[after.saturating_sub(1)], &self.triples[after.min(last)]);
        let seconds = (b.stamp - a.stamp).seconds();
        let share = if seconds > 0.0 { (stamp - a.stamp).seconds() / seconds } else { 0.0 };
        let share = share.clamp(0.0, 1.0);
        (
            a.tilt_rad + share * (b.tilt_rad - a.tilt_rad),
            se3_between(&a.frame_from_robot, &b.frame_from_robot, share),
        )
    }
}

impl CyclicSource for RecordedTriples {
    fn request(&mut self, due: Stamp) -> Option<Triple> {
        let ahead = self.triples[self.next..].iter().position(|triple| triple.stamp >= due)?;
        let at = self.next + ahead;
        self.next = at + 1;
        let mut triple = self.triples[at].clone();
        if self.tilt_late != Span::ZERO {
            triple.tilt_rad = self.between(triple.stamp + self.tilt_late).0;
        }
        if self.pose_late != Span::ZERO {
            triple.frame_from_robot = self.between(triple.stamp + self.pose_late).1;
        }
        Some(triple)
    }
}

fn triple_of(line: &str) -> Result<Triple, String> {
    let numbers: Vec<f64> = line
        .split_ascii_whitespace()
        .map(|word| {
            let number: f64 = word.parse().map_err(|_| format!("`{word}` is no number"))?;
            if number.is_finite() { Ok(number) } else { Err(format!("`{word}` is not finite")) }
        })
        .collect::<Result<_, _>>()?;
    let Some((fixed, ranges)) = numbers.split_first_chunk::<FIXED>() else {
        return Err(format!("{} numbers, expected at least {FIXED}", numbers.len()));
    };
    let &[stamp, x, y, z, qw, qx, qy, qz, tilt_rad, first_bearing_rad, bearing_step_rad, min, max] =
        fixed;
    let orientation = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-6)
        .ok_or_else(|| "the orientation is zero".to_owned())?;
    let stamp = Stamp::from_seconds(stamp);
    Ok(Triple {
        stamp,
        frame_from_robot: Isometry3::from_parts(Translation3::new(x, y, z), orientation),
        tilt_rad,
        line: LaserLine {
            stamp,
            first_bearing_rad,
            bearing_step_rad,
            min_range_m: min,
            max_range_m: max,
            ranges_m: ranges.to_vec(),
        },
    })
}

#[cfg(test)]
mod tests {
    use super::super::testbed::{World, head, line_at};
    use super::*;
    use nalgebra::Vector3;

    /// A sweep down at 0.05 rad/s before a room, driven through at 0.2 m/s.
    fn record() -> RecordedTriples {
        let head = head(None, None);
        let triples = (0..60).map(|i| {
            let t = 0.2 * f64::from(i);
            let tilt_rad = 0.05 * t - 0.2;
            let mut line = line_at(&World::default(), &head, HeadPose::tilted(tilt_rad), 1.0);
            line.stamp = Stamp::from_seconds(100.0 + t);
            let place = Vector3::new(0.2 * t, 0.0, 0.0);
            let frame_from_robot = Isometry3::new(place, Vector3::new(0.0, 0.0, 0.01 * t));
            Triple { stamp: line.stamp, frame_from_robot, tilt_rad, line }
        });
        RecordedTriples::new(triples.collect())
    }

    #[test]
    fn a_record_is_read_as_it_was_written() {
        let record = record();
        let again = RecordedTriples::parse(&record.to_text()).unwrap();
        assert_eq!(again.triples().len(), 60);
        for (a, b) in record.triples().iter().zip(again.triples()) {
            assert_eq!((a.stamp, a.tilt_rad, &a.line), (b.stamp, b.tilt_rad, &b.line));
            assert!(a.frame_from_robot.rotation.angle_to(&b.frame_from_robot.rotation) < 1e-12);
        }
        assert_eq!(RecordedTriples::parse("triples"), Err(TripleError::Heading));
        let cut = RecordedTriples::parse("usar triples 1\n1 2 x").unwrap_err();
        assert_eq!(cut.to_string(), "line 2: `x` is no number");
    }

    #[test]
    fn requests_are_answered_in_their_cycle() {
        let head = head(None, None);
        let start = Stamp::from_seconds(101.0);
        let cycle = Span::from_millis(500);
        let image = scan_by_request(&mut record(), (start, cycle, 12), &head).unwrap();
        let tilts: Vec<f64> = image.rows().iter().map(|row| row.tilt_rad).collect();
        assert_eq!(tilts.len(), 12);
        assert!((tilts[0] + 0.15).abs() < 1e-9, "{tilts:?}");
        // Lines come every 0.2 s, so every second request waits a tenth of a second.
        assert!(
            (tilts[1] - tilts[0] - 0.03).abs() < 1e-9 && (tilts[2] - tilts[0] - 0.05).abs() < 1e-9
        );
        let late = Stamp::from_seconds(200.0);
        assert_eq!(scan_by_request(&mut record(), (late, cycle, 12), &head), None);
    }

    #[test]
    fn a_desynchronised_record_is_off_by_speed_times_delay() {
        let late = Span::from_millis(100);
        let mut record = record().desynchronised(late, late);
        let triple = record.request(Stamp::from_seconds(104.0)).unwrap();
        assert!((triple.tilt_rad - 0.005).abs() < 1e-9, "{}", triple.tilt_rad);
        assert!((triple.frame_from_robot.translation.x - 0.82).abs() < 1e-4);
    }
}
