//! Getting there: paths over seen ground, following them, and knowing when to stop.
//!
//! [`Planner`] finds the cheapest path over a [`Grid`](crate::terrain::Grid), [`Follower`] turns a
//! [`Path`] into [`DriveCommand`]s one step at a time, and the functions in [`speed`] bound how fast.
//! [`Guard`] watches the line on the ground ahead while the robot drives, [`StuckDetector`] and
//! [`Recovery`] deal with what goes wrong, [`Trail`] remembers the way back and [`Swath`] the ground
//! that the line has swept.
//!
//! All of it drives on seen or assumed ground only, and backwards only along the robot's own track, or, to get
//! free, a little way over ground that was seen closely.

mod cost_map;
mod follow;
mod footprint;
mod guard;
mod path;
mod plan;
mod plan_error;
mod recover;
pub mod speed;
mod stuck;
mod swath;
mod tipping;
mod trail;

pub use cost_map::{CostMap, PlanConfig};
pub use follow::{Blocked, FollowConfig, FollowStatus, Follower};
pub use footprint::{Conflict, Footprint};
pub use guard::{Guard, GuardConfig, GuardVerdict};
pub use path::Path;
pub use plan::{CostField, Planner};
pub use plan_error::{Barriers, PlanError};
pub use recover::{Recovery, RecoveryConfig, RecoveryStep, Rung};
pub use stuck::{Motion, StuckConfig, StuckDetector, Trouble};
pub use swath::Swath;
pub use trail::Trail;

use crate::geometry::wrap_pi;
use nalgebra::{Isometry3, Point2, Vector3};
use serde::{Deserialize, Serialize};

/// A place and heading in the map's horizontal plane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    /// Metres along map x.
    pub x_m: f64,
    /// Metres along map y.
    pub y_m: f64,
    /// Heading in radians, counter-clockwise from map x, in (-π, π].
    pub yaw_rad: f64,
}

impl Pose2 {
    /// The horizontal part of a pose.
    pub fn from_isometry(world_from_robot: &Isometry3<f64>) -> Self {
        let forward = world_from_robot * Vector3::x();
        Self {
            x_m: world_from_robot.translation.x,
            y_m: world_from_robot.translation.y,
            yaw_rad: forward.y.atan2(forward.x),
        }
    }

    /// The place without the heading.
    pub fn point(&self) -> Point2<f64> {
        Point2::new(self.x_m, self.y_m)
    }

    /// Distance to a point in metres.
    pub fn distance_m(&self, to: &Point2<f64>) -> f64 {
        (to - self.point()).norm()
    }

    /// Angle by which the robot must turn to face a point, in (-π, π].
    pub fn bearing_rad(&self, to: &Point2<f64>) -> f64 {
        wrap_pi((to.y - self.y_m).atan2(to.x - self.x_m) - self.yaw_rad)
    }

    /// The pose after driving an arc: `distance_m` forward (negative: back) while turning by
    /// `turn_rad`.
    #[must_use]
    pub fn driven(&self, distance_m: f64, turn_rad: f64) -> Self {
        // The chord of the arc points half the turn to the side; exact in the limit of no turn.
        let half = 0.5 * turn_rad;
        let chord_m = if half.abs() < 1e-9 { distance_m } else { distance_m * half.sin() / half };
        let along = self.yaw_rad + half;
        Self {
            x_m: self.x_m + chord_m * along.cos(),
            y_m: self.y_m + chord_m * along.sin(),
            yaw_rad: wrap_pi(self.yaw_rad + turn_rad),
        }
    }
}

/// What the wheels are asked to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DriveCommand {
    /// Forward speed in metres per second, negative backwards.
    pub linear_mps: f64,
    /// Turn rate in radians per second, positive to the left.
    pub angular_rps: f64,
}

impl DriveCommand {
    /// Wheels at rest.
    pub const STOP: Self = Self { linear_mps: 0.0, angular_rps: 0.0 };

    /// Whether the wheels are asked to rest.
    pub fn is_stop(&self) -> bool {
        *self == Self::STOP
    }

    /// The command slowed so that neither limit is exceeded, with its curvature kept.
    #[must_use]
    pub fn limited(&self, linear_mps: f64, angular_rps: f64) -> Self {
        let over = (self.linear_mps.abs() / linear_mps.max(1e-9))
            .max(self.angular_rps.abs() / angular_rps.max(1e-9))
            .max(1.0);
        Self { linear_mps: self.linear_mps / over, angular_rps: self.angular_rps / over }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arc_ends_where_many_small_steps_end() {
        let start = Pose2 { x_m: 1.0, y_m: -2.0, yaw_rad: 0.4 };
        let mut walked = start;
        for _ in 0..10_000 {
            walked = walked.driven(2.0 / 10_000.0, -1.3 / 10_000.0);
        }
        let arc = start.driven(2.0, -1.3);
        assert!((walked.point() - arc.point()).norm() < 1e-6);
        assert!(wrap_pi(walked.yaw_rad - arc.yaw_rad).abs() < 1e-9);
    }

    #[test]
    fn limits_keep_the_curvature() {
        let command = DriveCommand { linear_mps: 1.0, angular_rps: 2.0 }.limited(0.7, 0.8);
        assert!((command.angular_rps - 0.8).abs() < 1e-12);
        assert!((command.linear_mps / command.angular_rps - 0.5).abs() < 1e-12);
    }
}
