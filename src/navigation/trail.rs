use super::{DriveCommand, Pose2};
use crate::geometry::wrap_pi;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Distance between two crumbs in metres.
const SPACING_M: f64 = 0.05;
/// Heading change that drops a crumb on the spot, in radians.
const TURN_RAD: f64 = 0.2;
/// Crumbs kept: 100 m of track, of which only the last metres are ever driven back.
const KEPT: usize = 2000;

/// The robot's own track: the way it drives backwards, because there it knows the ground behind it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Trail {
    crumbs: Vec<Pose2>,
}

impl Trail {
    /// Notes where the robot is. Driving back over the track takes its end up again, so that the
    /// next step back leads on.
    pub fn note(&mut self, pose: &Pose2) {
        // A crumb that lies ahead of the robot was passed backwards.
        while self.crumbs.len() >= 2 {
            let last = &self.crumbs[self.crumbs.len() - 1];
            let before = &self.crumbs[self.crumbs.len() - 2];
            if pose.distance_m(&before.point()) >= pose.distance_m(&last.point())
                || before.distance_m(&last.point()) < 1e-3
            {
                break;
            }
            self.crumbs.pop();
        }
        let far = self.crumbs.last().is_none_or(|last| {
            last.distance_m(&pose.point()) >= SPACING_M
                || wrap_pi(last.yaw_rad - pose.yaw_rad).abs() >= TURN_RAD
        });
        if far {
            if self.crumbs.len() == KEPT {
                self.crumbs.drain(..KEPT / 4);
            }
            self.crumbs.push(*pose);
        }
    }

    /// Carries the track along when the robot's pose is corrected: it was driven in the robot's own
    /// measure, so it keeps its place relative to the robot.
    pub fn correct(&mut self, before: &Isometry3<f64>, after: &Isometry3<f64>) {
        let (before, after) = (Pose2::from_isometry(before), Pose2::from_isometry(after));
        let turn_rad = wrap_pi(after.yaw_rad - before.yaw_rad);
        let (sin, cos) = turn_rad.sin_cos();
        for crumb in &mut self.crumbs {
            let (dx, dy) = (crumb.x_m - before.x_m, crumb.y_m - before.y_m);
            *crumb = Pose2 {
                x_m: after.x_m + cos * dx - sin * dy,
                y_m: after.y_m + sin * dx + cos * dy,
                yaw_rad: wrap_pi(crumb.yaw_rad + turn_rad),
            };
        }
    }

    /// Forgets the track: after a loop closure moved the map, or when the robot was pushed.
    pub fn clear(&mut self) {
        self.crumbs.clear();
    }

    /// The track, oldest first.
    pub fn crumbs(&self) -> &[Pose2] {
        &self.crumbs
    }

    /// How far back the robot could drive from `pose` along its track without turning by more than
    /// `turn_rad` in all, metres.
    pub fn length_back_m(&self, pose: &Pose2, turn_rad: f64) -> f64 {
        let mut length_m = 0.0;
        let mut from = *pose;
        for crumb in self.crumbs.iter().rev() {
            if wrap_pi(crumb.yaw_rad - pose.yaw_rad).abs() > turn_rad {
                break;
            }
            length_m += from.distance_m(&crumb.point());
            from = *crumb;
        }
        length_m
    }

    /// The command that drives backwards along the track at `speed_mps`; `None` when there is no
    /// track left to go back on, or the track lies more than 60° off the robot's stern.
    pub fn back_out(&self, pose: &Pose2, speed_mps: f64, turn_rps: f64) -> Option<DriveCommand> {
        let lookahead_m = 0.25;
        let target = self
            .crumbs
            .iter()
            .rev()
            .take_while(|crumb| wrap_pi(crumb.yaw_rad - pose.yaw_rad).abs() < PI / 3.0)
            .find(|crumb| crumb.distance_m(&pose.point()) >= lookahead_m)
            .or_else(|| {
                self.crumbs.first().filter(|crumb| crumb.distance_m(&pose.point()) > 0.05)
            })?;
        // Pure pursuit with the stern as the bow.
        let stern_rad = wrap_pi(pose.bearing_rad(&target.point()) - PI);
        if stern_rad.abs() > PI / 3.0 {
            return None;
        }
        let reach_m = pose.distance_m(&target.point());
        let curvature = -2.0 * stern_rad.sin() / reach_m;
        let command = DriveCommand { linear_mps: -speed_mps, angular_rps: -speed_mps * curvature };
        Some(command.limited(speed_mps, turn_rps))
    }

    /// The command that drives back along the track with the bow ahead, for a robot that has turned
    /// round since; `None` where the track does not lie within 60° of its bow.
    pub fn head_back(&self, pose: &Pose2, speed_mps: f64, turn_rps: f64) -> Option<DriveCommand> {
        const LOOKAHEAD_M: f64 = 0.25;
        // The way back becomes track as well, behind the robot; what lies ahead is the old one.
        let target = self.crumbs.iter().rev().find(|crumb| {
            (LOOKAHEAD_M..2.0 * LOOKAHEAD_M).contains(&crumb.distance_m(&pose.point()))
                && pose.bearing_rad(&crumb.point()).abs() <= PI / 3.0
        })?;
        let bow_rad = pose.bearing_rad(&target.point());
        let curvature = 2.0 * bow_rad.sin() / pose.distance_m(&target.point());
        let command = DriveCommand { linear_mps: speed_mps, angular_rps: speed_mps * curvature };
        Some(command.limited(speed_mps, turn_rps))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> (Trail, Vec<Pose2>) {
        let mut trail = Trail::default();
        let mut pose = Pose2::default();
        let mut poses = vec![pose];
        for step in 0..60 {
            pose = pose.driven(0.05, if step > 30 { 0.03 } else { 0.0 });
            trail.note(&pose);
            poses.push(pose);
        }
        (trail, poses)
    }

    #[test]
    fn a_robot_that_turned_round_heads_back_over_its_track() {
        let (mut trail, poses) = curve();
        let mut pose = poses[poses.len() - 1].driven(0.0, PI);
        assert_eq!(trail.back_out(&pose, 0.2, 0.8), None);
        for _ in 0..90 {
            let command = trail.head_back(&pose, 0.2, 0.8).expect("there is track left");
            assert!(command.linear_mps > 0.0);
            pose = pose.driven(command.linear_mps * 0.1, command.angular_rps * 0.1);
            trail.note(&pose);
            let away_m = poses.iter().map(|p| p.distance_m(&pose.point())).fold(9.0, f64::min);
            assert!(away_m < 0.06, "{away_m} m off the track");
        }
        // Across the track there is no way to head.
        assert_eq!(trail.head_back(&pose.driven(0.0, 1.6), 0.2, 0.8), None);
    }

    #[test]
    fn backing_out_stays_on_the_track() {
        let (mut trail, poses) = curve();
        let mut pose = poses[poses.len() - 1];
        let mut driven_m = 0.0;
        while driven_m < 1.8 {
            let command = trail.back_out(&pose, 0.2, 0.8).expect("there is track left");
            assert!(command.linear_mps < 0.0);
            pose = pose.driven(command.linear_mps * 0.1, command.angular_rps * 0.1);
            driven_m += 0.02;
            trail.note(&pose);
            let away_m = poses
                .iter()
                .map(|crumb| crumb.distance_m(&pose.point()))
                .fold(f64::INFINITY, f64::min);
            assert!(away_m < 0.06, "{away_m} m off the track");
        }
        assert!(pose.distance_m(&poses[0].point()) < 1.4);
    }

    #[test]
    fn a_robot_without_a_track_does_not_drive_backwards() {
        let mut trail = Trail::default();
        assert_eq!(trail.back_out(&Pose2::default(), 0.2, 0.8), None);
        trail.note(&Pose2::default());
        assert_eq!(trail.back_out(&Pose2::default(), 0.2, 0.8), None);
        // A track that leads off to the side is no way back.
        trail.note(&Pose2 { x_m: 0.0, y_m: 0.5, yaw_rad: 0.0 });
        let aside = Pose2 { x_m: 0.0, y_m: 0.5, yaw_rad: 0.0 };
        assert_eq!(trail.back_out(&aside, 0.2, 0.8), None);
    }
}
