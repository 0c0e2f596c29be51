//! Cyclic requests: odometry, tilt and laser of one and the same time, as the paper's real robot is
//! asked for them, live or from a record.
//!
//! The paper calls their timing "of utmost importance": [`RecordedTriples`](super::RecordedTriples) can
//! be replayed with their tilts or poses desynchronised, to see what that does to a scan.

use super::control::HeadControl;
use super::dated::Taken;
use super::tilt_mount::TiltMount;
use crate::scan::{ImageRow, LaserLine, RangeImage};
use crate::time::{Span, Stamp};
use nalgebra::Isometry3;

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

/// A scan of up to `rows` rows by one request each `cycle`, the first at `start`; its frame is that of
/// the laser at tilt 0 on the last row's robot. `None` if nothing answers.
pub fn scan_by_request(
    source: &mut dyn CyclicSource,
    (start, cycle, rows): (Stamp, Span, usize),
    mount: &TiltMount,
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
    let robot_from_scan = mount.robot_from_laser(0.0);
    let newest = triples.last()?.frame_from_robot;
    let first = &triples.first()?.line;
    let bearings = (0..first.len()).map(|beam| first.bearing_rad(beam)).collect();
    let mut image = RangeImage::new(robot_from_scan, bearings, first.max_range_m);
    for triple in &triples {
        let robot_from_then = newest.inverse() * triple.frame_from_robot;
        let sensor = mount.robot_from_laser(triple.tilt_rad);
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

#[cfg(test)]
mod tests {
    use super::super::testbed::head;
    use super::super::triples::{RecordedTriples, tests::record};
    use super::*;

    #[test]
    fn requests_are_answered_in_their_cycle() {
        let mount = TiltMount::of(&head(None, None)).unwrap();
        let start = Stamp::from_seconds(101.0);
        let cycle = Span::from_millis(500);
        let image = scan_by_request(&mut record(), (start, cycle, 12), &mount).unwrap();
        let tilts: Vec<f64> = image.rows().iter().map(|row| row.tilt_rad).collect();
        assert_eq!(tilts.len(), 12);
        assert!((tilts[0] + 0.15).abs() < 1e-9, "{tilts:?}");
        // Lines come every 0.2 s, so every second request waits a tenth of a second.
        assert!(
            (tilts[1] - tilts[0] - 0.03).abs() < 1e-9 && (tilts[2] - tilts[0] - 0.05).abs() < 1e-9
        );
        let late = Stamp::from_seconds(200.0);
        assert_eq!(scan_by_request(&mut record(), (late, cycle, 12), &mount), None);
        let nothing = &mut RecordedTriples::default();
        assert_eq!(scan_by_request(nothing, (start, cycle, 12), &mount), None);
    }
}
