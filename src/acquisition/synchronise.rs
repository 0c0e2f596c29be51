//! Lines, tilts and poses, each with stamps of their own, put together to triples.

use super::cyclic::Triple;
use super::triples::RecordedTriples;
use crate::geometry::lie::se3_between;
use crate::scan::LaserLine;
use crate::time::{Span, Stamp};
use nalgebra::Isometry3;

/// Collects what a session recorded, in whatever order it came.
#[derive(Clone, Debug, Default)]
pub struct Synchroniser {
    lines: Vec<LaserLine>,
    tilts: Vec<At<f64>>,
    poses: Vec<At<Isometry3<f64>>>,
}

/// What a [`Synchroniser`] made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Synchronised {
    /// A triple for each line that tilts surround.
    pub record: RecordedTriples,
    /// Lines that no two readings of the tilt surround closely enough.
    pub without_tilt: usize,
    /// Triples that no two poses surround: the robot is taken to stand where it was seen next to them.
    pub without_pose: usize,
}

/// Readings farther apart than this tell nothing of what was between them: five of USARSim's bursts.
const FARTHEST: Span = Span::from_millis(1_000);

impl Synchroniser {
    /// Takes note of a line whose rays were cast at `cast`.
    pub fn line(&mut self, cast: Stamp, line: LaserLine) {
        self.lines.push(LaserLine { stamp: cast, ..line });
    }

    /// Takes note of a reading of the tilt, in radians, down positive.
    pub fn tilt(&mut self, stamp: Stamp, tilt_rad: f64) {
        self.tilts.push((stamp, tilt_rad));
    }

    /// Takes note of the robot's pose by odometry, in a frame that stays the same.
    pub fn pose(&mut self, stamp: Stamp, frame_from_robot: Isometry3<f64>) {
        self.poses.push((stamp, frame_from_robot));
    }

    /// The triples: tilts on the straight line, poses on the screw between their two neighbours.
    pub fn triples(mut self) -> Synchronised {
        self.tilts.sort_by_key(|&(stamp, _)| stamp);
        self.poses.sort_by_key(|&(stamp, _)| stamp);
        let (mut without_tilt, mut without_pose) = (0, 0);
        let mut triples = Vec::with_capacity(self.lines.len());
        for line in self.lines {
            let stamp = line.stamp;
            let Some(([before, after], share)) =
                around(&self.tilts, stamp).filter(|([a, b], _)| b.0 - a.0 <= FARTHEST)
            else {
                without_tilt += 1;
                continue;
            };
            let tilt_rad = before.1 + share * (after.1 - before.1);
            let frame_from_robot = match around(&self.poses, stamp) {
                Some(([before, after], share)) => se3_between(&before.1, &after.1, share),
                None => {
                    without_pose += 1;
                    let at = self.poses.partition_point(|pose| pose.0 < stamp);
                    let next = self.poses.get(at).or(self.poses.last());
                    next.map_or_else(Isometry3::identity, |pose| pose.1)
                }
            };
            triples.push(Triple { stamp, frame_from_robot, tilt_rad, line });
        }
        Synchronised { record: RecordedTriples::new(triples), without_tilt, without_pose }
    }
}

/// Something, and when it was.
type At<T> = (Stamp, T);

/// The two entries around `stamp` and how far it is from the first to the second, in 0..=1.
fn around<T>(entries: &[At<T>], stamp: Stamp) -> Option<([&At<T>; 2], f64)> {
    let after = entries.partition_point(|entry| entry.0 < stamp);
    let late = entries.get(after)?;
    if late.0 == stamp {
        return Some(([late, late], 0.0));
    }
    let early = entries.get(after.checked_sub(1)?)?;
    Some(([early, late], (stamp - early.0).seconds() / (late.0 - early.0).seconds()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn s(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    fn line() -> LaserLine {
        LaserLine {
            stamp: s(0.0),
            first_bearing_rad: -1.0,
            bearing_step_rad: 0.5,
            min_range_m: 0.1,
            max_range_m: 20.0,
            phantom_m: None,
            ranges_m: vec![1.0; 5],
        }
    }

    #[test]
    fn tilts_and_poses_are_those_of_the_lines_time_whatever_order_they_came_in() {
        let mut synchroniser = Synchroniser::default();
        for t in [10.0, 10.4, 10.2, 10.6] {
            synchroniser.tilt(s(t), 0.05 * (t - 10.0));
            synchroniser.pose(s(t + 0.05), Isometry3::translation(0.2 * t, 0.0, 0.0));
        }
        for cast in [10.5, 10.1, 10.02, 10.6] {
            synchroniser.line(s(cast), line());
        }
        let found = synchroniser.triples();
        assert_eq!((found.without_tilt, found.without_pose), (0, 1));
        let triples = found.record.triples();
        for (triple, cast) in triples.iter().zip([10.02, 10.1, 10.5, 10.6]) {
            assert_eq!((triple.stamp, triple.line.stamp), (s(cast), s(cast)));
            assert!((triple.tilt_rad - 0.05 * (cast - 10.0)).abs() < 1e-9, "{}", triple.tilt_rad);
        }
        let x_m: Vec<f64> = triples.iter().map(|t| t.frame_from_robot.translation.x).collect();
        assert!((x_m[1] - 2.01).abs() < 1e-6 && (x_m[2] - 2.09).abs() < 1e-6, "{x_m:?}");
        assert!((x_m[0] - 2.0).abs() < 1e-6, "before the first pose it stood there: {x_m:?}");
    }

    #[test]
    fn a_line_between_readings_far_apart_has_no_tilt() {
        let mut synchroniser = Synchroniser::default();
        [1.0, 1.2, 3.0].into_iter().for_each(|t| synchroniser.tilt(s(t), t));
        [0.9, 1.1, 2.0, 3.1].into_iter().for_each(|t| synchroniser.line(s(t), line()));
        let found = synchroniser.triples();
        assert_eq!((found.record.triples().len(), found.without_tilt), (1, 3));
    }
}
