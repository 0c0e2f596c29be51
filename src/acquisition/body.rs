//! Where the robot's body was over time, for scans that are taken while it drives.

use crate::geometry::lie::se3_between;
use crate::time::{Span, Stamp};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Poses of the robot's body by odometry and inertial unit, all in one frame that need not be known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyTrack {
    poses: VecDeque<(Stamp, Isometry3<f64>)>,
}

/// Two minutes of ten poses a second: longer than any sweep on the way.
const KEPT: usize = 1_200;
/// A body is taken to go on as it did for this long after its last pose; stamps of lines and of
/// odometry differ by less.
const RUNS_ON: Span = Span::from_millis(250);

impl BodyTrack {
    /// Forgets everything, as when the frame of the poses changes.
    pub fn forget(&mut self) {
        self.poses.clear();
    }

    /// Takes note of a pose; one that is not later than the last is left out.
    pub fn note(&mut self, stamp: Stamp, frame_from_robot: Isometry3<f64>) {
        if self.poses.back().is_some_and(|&(last, _)| stamp <= last) {
            return;
        }
        if self.poses.len() == KEPT {
            self.poses.pop_front();
        }
        self.poses.push_back((stamp, frame_from_robot));
    }

    /// The pose at `stamp`, on the screw between the two poses that surround it; `None` before the
    /// first pose and too long after the last.
    pub fn at(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        let after = self.poses.partition_point(|&(at, _)| at < stamp);
        if let Some(&(at, pose)) = self.poses.get(after)
            && (at == stamp || after == 0)
        {
            return (at == stamp).then_some(pose);
        }
        let upper = after.min(self.poses.len().checked_sub(1)?);
        let (late, pose_late) = *self.poses.get(upper)?;
        let (early, pose_early) = *self.poses.get(upper.checked_sub(1)?)?;
        if stamp > late + RUNS_ON {
            return None;
        }
        let share = (stamp - early).seconds() / (late - early).seconds();
        Some(se3_between(&pose_early, &pose_late, share))
    }

    /// Where the body was at `stamp` as seen from its newest pose.
    pub fn displacement(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        let &(_, newest) = self.poses.back()?;
        Some(newest.inverse() * self.at(stamp)?)
    }

    /// Whether the body neither drove nor turned between two stamps, as far as its poses tell.
    pub fn stood(&self, from: Stamp, to: Stamp) -> bool {
        // What odometry and inertial unit of a robot at rest differ by.
        const STILL_M: f64 = 0.01;
        const STILL_RAD: f64 = 0.01;
        let (Some(from), Some(to)) = (self.at(from), self.at(to)) else { return true };
        let moved = from.inverse() * to;
        moved.translation.vector.norm() < STILL_M && moved.rotation.angle() < STILL_RAD
    }

    /// Metres driven between `from` and the newest pose.
    pub fn driven_m(&self, from: Stamp) -> f64 {
        let since = self.poses.iter().filter(|&&(stamp, _)| stamp >= from);
        let places: Vec<_> = since.map(|(_, pose)| pose.translation.vector).collect();
        places.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    fn s(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// On a circle to the left of radius 2 m at 0.5 rad/s.
    fn on_circle(t: f64) -> Isometry3<f64> {
        let (sin, cos) = (0.5 * t).sin_cos();
        Isometry3::from_parts(
            Vector3::new(2.0 * sin, 2.0 - 2.0 * cos, 0.0).into(),
            UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5 * t),
        )
    }

    #[test]
    fn a_body_on_a_circle_is_found_between_its_poses() {
        let mut track = BodyTrack::default();
        for i in 0..20 {
            let t = 0.2 * f64::from(i);
            track.note(s(t), on_circle(t));
        }
        for t in [0.05, 1.13, 2.7, 3.9] {
            let off = (track.at(s(t)).unwrap().inverse() * on_circle(t)).translation.vector.norm();
            assert!(off < 1e-9, "{off} m off at {t} s");
        }
        assert_eq!(track.at(s(-0.01)), None);
        assert_eq!(track.at(s(4.2)), None);
        let moved = track.displacement(s(1.0)).unwrap();
        let expected = on_circle(3.8).inverse() * on_circle(1.0);
        assert!((moved.translation.vector - expected.translation.vector).norm() < 1e-9);
        assert!((track.driven_m(s(0.0)) - 3.8).abs() < 0.01);
        assert!(!track.stood(s(1.0), s(1.2)) && track.stood(s(1.0), s(1.005)));
    }

    #[test]
    fn a_body_that_was_never_seen_is_nowhere() {
        let mut track = BodyTrack::default();
        assert_eq!(track.at(s(1.0)), None);
        track.note(s(1.0), Isometry3::identity());
        assert_eq!(track.at(s(1.1)), None);
        track.forget();
        assert_eq!(track.displacement(s(1.0)), None);
    }
}
