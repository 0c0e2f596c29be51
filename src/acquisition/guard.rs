//! The guard line: where the laser looks while the robot drives.

use super::profile::QuarterDegrees;
use crate::robot::GroundView;
use serde::{Deserialize, Serialize};

/// How far ahead the guard line has to lie.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuardConfig {
    /// Deceleration that braking wheels reach for certain, in m/s², above 0.
    pub deceleration_mps2: f64,
    /// Time from the casting of a line to the wheels' obeying a stop, in seconds: a burst of lag, a
    /// burst of waiting, and the command's way, at least 0.
    pub reaction_s: f64,
    /// Distance left between the robot's front and the guard line after a stop, in metres, at
    /// least 0.
    pub margin_m: f64,
    /// Distance from the robot's centre to its front, in metres, at least 0.
    pub front_m: f64,
}

impl Default for GuardConfig {
    fn default() -> Self {
        Self { deceleration_mps2: 1.0, reaction_s: 0.5, margin_m: 0.3, front_m: 0.27 }
    }
}

/// Where to park the tilt so that the line guards the way ahead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GuardTilt {
    /// The tilt to park at.
    pub tilt: QuarterDegrees,
    /// Where the middle of the line meets level ground, from the robot's centre, in metres.
    pub line_ahead_m: f64,
    /// Greatest speed at which the robot still stops the margin short of the line, in m/s.
    pub max_speed_mps: f64,
    /// Whether the tilt's limit put the line farther out than the speed asked for.
    pub limited: bool,
}

impl GuardConfig {
    /// Distance covered from the casting of a line to standstill at `speed_mps`, in metres.
    pub fn stopping_distance_m(&self, speed_mps: f64) -> f64 {
        let v = speed_mps.abs();
        v * self.reaction_s + v * v / (2.0 * self.deceleration_mps2)
    }

    /// Greatest speed from which the robot stops within `distance_m`, in m/s.
    pub fn speed_for_m(&self, distance_m: f64) -> f64 {
        let (a, t) = (self.deceleration_mps2, self.reaction_s);
        let d = distance_m.max(0.0);
        a * ((t * t + 2.0 * d / a).sqrt() - t)
    }

    pub(super) fn problems(&self) -> Vec<String> {
        let mut found = Vec::new();
        if !(self.deceleration_mps2 > 0.0 && self.deceleration_mps2.is_finite()) {
            found.push(format!(
                "guard.deceleration_mps2 = {}: must be above 0",
                self.deceleration_mps2
            ));
        }
        for (key, value) in [
            ("reaction_s", self.reaction_s),
            ("margin_m", self.margin_m),
            ("front_m", self.front_m),
        ] {
            if !(value >= 0.0 && value.is_finite()) {
                found.push(format!("guard.{key} = {value}: must be at least 0"));
            }
        }
        found
    }
}

/// The tilt under which the laser line meets level ground at the stopping distance for `speed_mps`,
/// a margin and the robot's front ahead of its centre.
///
/// The tilt is the steepest of the quarter-degree grid whose line is not nearer than that: a nearer
/// line warns too late, a farther one is blurred by every degree of pitch. A limit that keeps the
/// tilt from it leaves the line farther out (`limited`), which is safe to brake for but blind
/// nearer by. `None` for a laser that cannot tilt or sees no ground at all.
pub fn guard_tilt(
    speed_mps: f64,
    view: &GroundView<'_>,
    config: &GuardConfig,
) -> Option<GuardTilt> {
    let wanted_m = config.front_m + config.stopping_distance_m(speed_mps) + config.margin_m;
    let wanted = view.tilt_for_ground_ahead(wanted_m);
    let limit = view.steepest_tilt_rad()?;
    let tilt_rad = wanted.map_or(limit, |tilt| tilt.min(limit));
    let grid = |tilt_rad: f64| tilt_rad / super::QUARTER_DEGREE_RAD;
    // Rounded to the flatter side, with a hair's breadth for a limit that is itself on the grid; but a
    // joint that was found to go no higher leaves the line nearer, and the robot slower.
    let highest = view
        .head
        .tilt()?
        .limits
        .map_or(i32::MIN, |limits| (grid(limits.min_rad) - 1e-9).ceil() as i32);
    let tilt = QuarterDegrees(((grid(tilt_rad) + 1e-9).floor() as i32).max(highest));
    let line_ahead_m = view.ground_ahead_m(tilt.radians())?;
    let stop_within_m = line_ahead_m - config.front_m - config.margin_m;
    Some(GuardTilt {
        tilt,
        line_ahead_m,
        max_speed_mps: config.speed_for_m(stop_within_m),
        limited: wanted.is_none_or(|tilt| tilt > limit),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::AngleSpan;
    use crate::robot::{Joint, JointKind, Mount, ScanHead};
    use nalgebra::Isometry3;
    use proptest::prelude::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn head(limits_wire: Option<AngleSpan>) -> ScanHead {
        let revolute = JointKind::Revolute;
        let mut tilt = Joint::from_wire("PT", 2, revolute, [0.1, 0.0, 0.4], [FRAC_PI_2, 0.0, 0.0]);
        tilt.limits = limits_wire;
        let pan = Joint::from_wire("PT", 1, revolute, [0.0; 3], [PI, 0.0, 0.0]);
        ScanHead::new(Mount {
            joints: vec![pan, tilt],
            part_from_device: Isometry3::translation(0.04, 0.0, 0.05),
        })
    }

    fn view(head: &ScanHead) -> GroundView<'_> {
        GroundView { head, origin_height_m: 0.15, half_fov_rad: FRAC_PI_2 }
    }

    #[test]
    fn stock_limits_leave_the_line_farther_out_and_say_so() {
        let head = head(Some(AngleSpan::new(-0.16, 0.40)));
        let guard = guard_tilt(0.3, &view(&head), &GuardConfig::default()).unwrap();
        assert!(guard.limited && guard.line_ahead_m > 3.5);
        assert_eq!(guard.tilt.degrees(), 9.0);
    }

    #[test]
    fn a_laser_that_cannot_tilt_guards_nothing() {
        let fixed = ScanHead::new(Mount::on_body([0.1, 0.0, -0.1], [0.0; 3]));
        assert_eq!(guard_tilt(0.3, &view(&fixed), &GuardConfig::default()), None);
    }

    proptest! {
        #[test]
        fn the_robot_stops_a_margin_short_of_the_line(
            speed in 0.0..0.7f64, reaction in 0.0..1.0f64, brake in 0.3..4.0f64, lowest in 0.1..1.2f64
        ) {
            let head = head(Some(AngleSpan::new(-lowest, 0.4)));
            let config = GuardConfig {
                reaction_s: reaction, deceleration_mps2: brake, ..GuardConfig::default()
            };
            let guard = guard_tilt(speed, &view(&head), &config).unwrap();
            prop_assert!(guard.max_speed_mps >= speed - 1e-9);
            let stop = config.front_m + config.stopping_distance_m(guard.max_speed_mps);
            prop_assert!(stop + config.margin_m <= guard.line_ahead_m + 1e-9);
            prop_assert!(guard.tilt.radians() <= lowest + 1e-9);
        }
    }
}
