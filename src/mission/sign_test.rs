//! A small test motion at the start: whether pan and tilt turn the way their axes promise.
//!
//! The direction in which a server turns a joint is not certain (protocol document 5.4: verify signs
//! once per server). A sign that is wrong turns every scan upside down, so that it is worth the eight
//! seconds. What the laser sees decides; where it sees too little, the axes are believed.

use super::running::{Activity, Desk, Running};
use crate::acquisition::{Acquisition, ParkState};
use crate::robot::{HeadPose, ScanHead, SignVerdict, pan_sign, tilt_sign};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};

/// How far either joint is turned, in radians.
const TURN_RAD: f64 = 0.2;

/// A joint that turns less than this tells nothing, in radians.
const LEAST_TURN_RAD: f64 = 0.08;

/// The longest wait for a line at one pose.
const PATIENCE: Span = Span::from_millis(8_000);

/// The test under way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SignTest {
    /// Poses still to come, the next one last; the very last one is zero.
    to_come: Vec<HeadPose>,
    /// The pose that the head goes to or has.
    pose: HeadPose,
    seen: Vec<(HeadPose, LaserLine)>,
    deadline: Arrival,
}

/// The poses of a test: tilt down, tilt up, pan to a side, and back to zero; what a head cannot do is
/// left out.
fn poses(head: &ScanHead) -> Vec<HeadPose> {
    let mut poses = Vec::new();
    if let Some(tilt) = head.tilt() {
        let ends = [TURN_RAD, -TURN_RAD].map(|angle| tilt.clamp(angle));
        if ends.iter().all(|angle| angle.abs() >= LEAST_TURN_RAD) {
            poses.extend(ends.map(HeadPose::tilted));
        }
    }
    if let Some(pan) = head.pan() {
        let reached = [TURN_RAD, -TURN_RAD].map(|angle| pan.clamp(angle));
        let far = reached.into_iter().find(|angle| angle.abs() >= LEAST_TURN_RAD);
        poses.extend(far.map(|pan_rad| HeadPose { pan_rad, tilt_rad: 0.0 }));
    }
    if !poses.is_empty() {
        poses.push(HeadPose::default());
    }
    poses
}

impl Running {
    /// Begins the test; a head without joints to test goes on with the next look.
    pub(super) fn begin_sign_test(&mut self, desk: &mut Desk<'_>) {
        let head = self.acquisition.as_ref().map(|acquisition| acquisition.control().head());
        let mut to_come = head.map(poses).unwrap_or_default();
        to_come.reverse();
        let Some(pose) = to_come.pop() else { return self.next_look_or_choose(desk) };
        let deadline = desk.now + self.sign_test_patience();
        self.activity =
            Activity::SignTest(Box::new(SignTest { to_come, pose, seen: Vec::new(), deadline }));
        self.turn_head(pose, desk);
    }

    /// How long a line at one pose is waited for: on a slow line the command is late, and so is what it
    /// shows.
    fn sign_test_patience(&self) -> Span {
        let late_s = self.acquisition.as_ref().map_or(0.0, Acquisition::obeyed_late_s);
        PATIENCE + Span::from_seconds(2.0 * late_s)
    }

    fn turn_head(&mut self, pose: HeadPose, desk: &mut Desk<'_>) {
        if let Some(acquisition) = &mut self.acquisition {
            let actions = acquisition.park(pose, desk.now);
            self.head_actions(actions, desk);
        }
    }

    /// Takes a line; `parked` says whether the head is where the test wants it.
    pub(super) fn sign_test_line(
        &mut self,
        line: &LaserLine,
        parked: ParkState,
        desk: &mut Desk<'_>,
    ) {
        let deadline = desk.now + self.sign_test_patience();
        let Activity::SignTest(test) = &mut self.activity else { return };
        if !parked.covers(line.stamp) {
            return;
        }
        test.seen.push((test.pose, line.clone()));
        let Some(next) = test.to_come.pop() else { return self.conclude_sign_test(desk) };
        test.pose = next;
        test.deadline = deadline;
        self.turn_head(next, desk);
    }

    /// Ends a test that waits in vain.
    pub(super) fn sign_test_cycle(&mut self, desk: &mut Desk<'_>) {
        self.stop(desk);
        let Activity::SignTest(test) = &self.activity else { return };
        if desk.now >= test.deadline {
            desk.warn("the head does not come to rest: its signs are not verified");
            self.next_look_or_choose(desk);
        }
    }

    /// Judges what was seen, and turns round what turns the other way.
    fn conclude_sign_test(&mut self, desk: &mut Desk<'_>) {
        let Activity::SignTest(test) = &self.activity else { return };
        let seen = test.seen.clone();
        let at = |wanted: fn(&HeadPose) -> bool| {
            seen.iter().find(|(pose, _)| wanted(pose)).map(|(pose, line)| (*pose, line))
        };
        let down = at(|pose| pose.tilt_rad > 0.0);
        let up = at(|pose| pose.tilt_rad < 0.0);
        let aside = at(|pose| pose.pan_rad != 0.0);
        let zero = at(|pose| *pose == HeadPose::default());
        let tilt = match (self.rig.ground_view(), down, up) {
            (Some(view), Some((down, low)), Some((up, high))) => {
                Some(tilt_sign(&view, (down.tilt_rad, low), (up.tilt_rad, high)))
            }
            _ => None,
        };
        let pan = match (zero, aside) {
            (Some((_, first)), Some((pose, second))) => {
                Some(pan_sign((0.0, first), (pose.pan_rad, second)))
            }
            _ => None,
        };
        let mut inverted = false;
        for (name, verdict) in [("tilt", tilt), ("pan", pan)] {
            match verdict {
                Some(SignVerdict::AsBelieved) => desk.info(format!("{name}: turns as believed")),
                Some(SignVerdict::Inverted) => {
                    desk.warn(format!("{name}: turns the other way round, as the laser shows"));
                    inverted = true;
                }
                Some(SignVerdict::Undecided) => {
                    desk.info(format!("{name}: the laser sees too little to tell its sign"));
                }
                None => {}
            }
        }
        if inverted {
            let is = |verdict| verdict == Some(SignVerdict::Inverted);
            self.rig.invert_head(is(pan), is(tilt));
            // The head rests at zero, which is the same under either sign.
            let anew = Acquisition::for_rig(&self.rig, desk.config.acquisition.clone());
            let before = std::mem::replace(&mut self.acquisition, anew);
            if let (Some(acquisition), Some(before)) = (&mut self.acquisition, &before) {
                acquisition.keep_line_of(before);
            }
        }
        self.next_look_or_choose(desk);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::AngleSpan;
    use crate::robot::{Joint, JointKind, Mount};
    use nalgebra::Isometry3;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn head(tilt_limits: Option<AngleSpan>) -> ScanHead {
        let joint = |link, roll| {
            Joint::from_wire("P", link, JointKind::Revolute, [0.0; 3], [roll, 0.0, 0.0])
        };
        let mut tilt = joint(2, FRAC_PI_2);
        tilt.limits = tilt_limits;
        ScanHead::new(Mount {
            joints: vec![joint(1, PI), tilt],
            part_from_device: Isometry3::identity(),
        })
    }

    #[test]
    fn a_test_looks_down_and_up_and_aside_and_ends_at_zero() {
        let poses = poses(&head(None));
        let angles: Vec<_> = poses.iter().map(|pose| (pose.pan_rad, pose.tilt_rad)).collect();
        assert_eq!(angles, [(0.0, 0.2), (0.0, -0.2), (0.2, 0.0), (0.0, 0.0)]);
    }

    #[test]
    fn what_a_head_cannot_do_is_left_out() {
        // Wire limits 0 to 0.3: it never looks down.
        let poses = poses(&head(Some(AngleSpan::new(0.0, 0.3))));
        assert_eq!(poses.len(), 2);
        assert_eq!(poses[0].pan_rad, 0.2);
        assert!(super::poses(&ScanHead::new(Mount::on_body([0.0; 3], [0.0; 3]))).is_empty());
    }
}
