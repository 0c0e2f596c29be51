//! Scoring: what the run believed against what was true. Nothing here reaches an agent.

use super::report::PoseError;
use super::timeline::Timeline;
use super::tum::TimedPose;
use crate::protocol::message::Sen;
use crate::protocol::{Message, parse};
use crate::robot::{ScoringTruth, core_pose};
use nalgebra::Isometry3;

/// Readings of a session that are only compared: wheel odometry and INS on their own, and the
/// ground truth sensor where the server has one.
#[derive(Clone, Debug, Default)]
pub struct Bystander {
    odometry: Option<(Isometry3<f64>, Isometry3<f64>)>,
    ins: Option<(Isometry3<f64>, Isometry3<f64>)>,
    truth: Vec<TimedPose>,
}

impl Bystander {
    /// Looks at a line from the server; all but the three types are passed over unread.
    pub fn note(&mut self, line: &[u8]) {
        const WANTED: [&[u8]; 3] = [b"Odometry}", b"INS}", b"GroundTruth}"];
        if !WANTED.iter().any(|word| memchr::memmem::find(line, word).is_some()) {
            return;
        }
        let keep = |slot: &mut Option<(Isometry3<f64>, Isometry3<f64>)>, pose| {
            let first = slot.map_or(pose, |(first, _)| first);
            *slot = Some((first, pose));
        };
        match parse(line).message {
            Message::Sen(Sen::Odometry(odometry)) => {
                let pose =
                    core_pose([odometry.x_m, odometry.y_m, 0.0], [0.0, 0.0, odometry.theta_rad]);
                keep(&mut self.odometry, pose);
            }
            Message::Sen(Sen::Ins(ins)) => {
                keep(&mut self.ins, core_pose(ins.pose.location, ins.pose.orientation));
            }
            Message::GroundTruth(truth) => {
                if let (Some(scoring), Some(stamp)) = (ScoringTruth::of(&truth), truth.time) {
                    let pose = scoring.world_from_robot;
                    self.truth.push(TimedPose { time_s: stamp.seconds(), pose });
                }
            }
            _ => {}
        }
    }

    /// The ground truth sensor's poses.
    pub fn truth(&self) -> &[TimedPose] {
        &self.truth
    }

    /// Motion from the first to the last reading of odometry alone.
    pub fn odometry_motion(&self) -> Option<Isometry3<f64>> {
        self.odometry.map(|(first, last)| first.inverse() * last)
    }

    /// The same of the INS.
    pub fn ins_motion(&self) -> Option<Isometry3<f64>> {
        self.ins.map(|(first, last)| first.inverse() * last)
    }
}

/// Errors of a trajectory against the truth, start poses laid on one another; both in the order in which
/// they were noted, by the stamps of one clock, which may have been set meanwhile. `None` where the two
/// share no time.
pub fn pose_error(
    trajectory: &[TimedPose],
    truth: &[TimedPose],
    distance_m: f64,
    bystander: &Bystander,
) -> Option<PoseError> {
    let line = Timeline::of(truth);
    let (trajectory, truth) = (&line.unfolded(trajectory)[..], &line.unfolded(truth)[..]);
    let last_true = truth.last()?;
    let settled_s = settled_s(truth)?;
    let true_at = |time_s: f64| at(truth, time_s.max(settled_s));
    let first = trajectory.first()?;
    let start_true = true_at(first.time_s)?;
    let settled_true = true_at(settled_s)?;
    let true_from_map = start_true * first.pose.inverse();
    let mut squares = 0.0;
    let mut count = 0_usize;
    for timed in trajectory {
        let Some(pose_true) = true_at(timed.time_s) else { continue };
        let pose = true_from_map * timed.pose;
        squares += (pose.translation.vector - pose_true.translation.vector).norm_squared();
        count += 1;
    }
    let last = trajectory.last()?;
    // A robot that stands writes no more poses: its last one holds until the end.
    let end = true_from_map * last.pose;
    let apart = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        (a.translation.vector - b.translation.vector).norm()
    };
    let final_m = apart(&end, &last_true.pose);
    let alone = |motion: Option<Isometry3<f64>>| {
        motion.map(|motion| apart(&(settled_true * motion), &last_true.pose))
    };
    Some(PoseError {
        ate_rmse_m: if count > 0 { (squares / count as f64).sqrt() } else { 0.0 },
        final_m,
        final_deg: end.rotation.angle_to(&last_true.pose.rotation).to_degrees(),
        drift_percent: if distance_m > 0.0 { 100.0 * final_m / distance_m } else { 0.0 },
        odometry_final_m: alone(bystander.odometry_motion()),
        ins_final_m: alone(bystander.ins_motion()),
    })
}

/// When a robot that was created above the floor has come down on it, in seconds; the beginning for one
/// that never rests. `None` for no truth at all. What came before is no error of anybody's.
pub fn settled_s(truth: &[TimedPose]) -> Option<f64> {
    const WITHIN_S: f64 = 3.0;
    const AT_REST_S: f64 = 0.4;
    const AT_REST_M: f64 = 0.002;
    let first = truth.first()?;
    // Between samples farther apart nobody is seen to come down: poses of scans, say.
    if truth.get(1).is_none_or(|second| second.time_s > first.time_s + AT_REST_S) {
        return Some(first.time_s);
    }
    let rests = |timed: &&TimedPose| {
        let later = truth.iter().find(|later| later.time_s >= timed.time_s + AT_REST_S);
        later.is_some_and(|later| {
            let rise_m = later.pose.translation.z - timed.pose.translation.z;
            rise_m.abs() < AT_REST_M
        })
    };
    let early = truth.iter().take_while(|timed| timed.time_s - first.time_s <= WITHIN_S);
    Some(early.into_iter().find(rests).map_or(first.time_s, |timed| timed.time_s))
}

/// The pose of a trajectory at a time, between its poses; `None` before its beginning. After its end
/// the last one holds.
pub fn at(trajectory: &[TimedPose], time_s: f64) -> Option<Isometry3<f64>> {
    let after = trajectory.partition_point(|timed| timed.time_s < time_s);
    if after == trajectory.len() {
        return trajectory.last().map(|timed| timed.pose);
    }
    let late = &trajectory[after];
    if after == 0 {
        // A stamp of two decimals may lie a little before the first of four.
        return (late.time_s - time_s < 0.25).then_some(late.pose);
    }
    let early = &trajectory[after - 1];
    let span = late.time_s - early.time_s;
    let share = if span > 0.0 { (time_s - early.time_s) / span } else { 1.0 };
    early.pose.try_lerp_slerp(&late.pose, share, 1e-9).or(Some(late.pose))
}

/// The 2019 rules' score with α = 1 and β = 0.5 (rules of 2019, formula of section "scoring"):
/// half for portals, half for victims, wrong detections deducted. The formula's last term rewards
/// victims declared alive; no status is declared yet, so it is zero.
pub fn score_2019(portals: (usize, usize), found: usize, wrong: usize, victims: usize) -> f64 {
    let share = |part: f64, whole: usize| if whole > 0 { part / whole as f64 } else { 0.0 };
    let exploration = share(portals.0 as f64, portals.1);
    let detection = share(found as f64 - 0.5 * wrong as f64, victims);
    0.5 * exploration + 0.5 * detection
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    fn line(offset: f64, yaw: f64) -> Vec<TimedPose> {
        let shift = Isometry3::from_parts(
            Translation3::new(offset, 2.0, 0.1),
            UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
        );
        (0..=10)
            .map(|i| TimedPose {
                time_s: f64::from(i),
                pose: shift * Isometry3::translation(f64::from(i), 0.0, 0.0),
            })
            .collect()
    }

    #[test]
    fn another_frame_is_no_error() {
        let error =
            pose_error(&line(5.0, 0.7), &line(0.0, 0.0), 10.0, &Bystander::default()).unwrap();
        assert!(error.ate_rmse_m < 1e-9 && error.final_m < 1e-9 && error.final_deg < 1e-6);
        assert_eq!(error.odometry_final_m, None);
    }

    #[test]
    fn a_clock_set_back_on_the_way_is_no_error() {
        let mut truth = line(0.0, 0.0);
        let mut own = line(5.0, 0.7);
        truth.iter_mut().chain(&mut own).filter(|p| p.time_s >= 6.0).for_each(|p| p.time_s -= 4.5);
        let error = pose_error(&own, &truth, 10.0, &Bystander::default()).unwrap();
        assert!(error.ate_rmse_m < 1e-9 && error.final_m < 1e-9, "{error:?}");
    }

    #[test]
    fn odometry_alone_is_compared_with_the_true_motion() {
        let mut bystander = Bystander::default();
        bystander.note(b"SEN {Type Odometry} {Name O} {Pose 1.0,1.0,0.0}");
        bystander.note(b"SEN {Type Odometry} {Name O} {Pose 10.0,1.0,0.0}");
        let error = pose_error(&line(0.0, 0.0), &line(0.0, 0.0), 10.0, &bystander).unwrap();
        assert!((error.odometry_final_m.unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_robot_that_drops_onto_the_floor_and_idles_has_no_error() {
        let dropped = |time_s: f64| (0.02 - 4.9 * time_s * time_s).max(0.0);
        let still =
            |time_s: f64, z: f64| TimedPose { time_s, pose: Isometry3::translation(1.0, 2.0, z) };
        let truth: Vec<TimedPose> = (0..50)
            .map(|i| 0.02 * f64::from(i))
            .map(|time_s| still(time_s, dropped(time_s)))
            .collect();
        let own: Vec<TimedPose> = truth.iter().map(|timed| still(timed.time_s, 0.0)).collect();
        let mut bystander = Bystander::default();
        bystander.note(b"SEN {Type Odometry} {Name O} {Pose 0.0,0.0,0.0}");
        let error = pose_error(&own, &truth, 0.0, &bystander).unwrap();
        assert!(error.ate_rmse_m < 1e-9 && error.final_m < 1e-9, "{error:?}");
        assert!(error.odometry_final_m.unwrap() < 1e-9, "{error:?}");
        assert!((0.05..0.2).contains(&settled_s(&truth).unwrap()));
    }

    #[test]
    fn poses_between_samples_are_interpolated() {
        let pose = at(&line(0.0, 0.0), 2.5).unwrap();
        assert!((pose.translation.vector - Vector3::new(2.5, 2.0, 0.1)).norm() < 1e-9);
        assert!(at(&line(0.0, 0.0), -1.0).is_none());
    }
}
