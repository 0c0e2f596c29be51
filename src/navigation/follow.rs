use super::footprint::{Conflict, Footprint};
use super::path::Path;
use super::speed::{
    speed_for_curvature, speed_for_room, speed_for_slope, speed_to_stop_within, stopping_distance_m,
};
use super::{DriveCommand, Pose2};
use crate::geometry::wrap_pi;
use crate::terrain::{Grid, RobotShape};
use serde::{Deserialize, Serialize};

/// Speed past an obstacle that is closer than the margin, in m/s.
const SQUEEZE_MPS: f64 = 0.08;
/// Turn rate beside one, in rad/s.
const SQUEEZE_RPS: f64 = 0.25;

/// How a path is driven.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FollowConfig {
    /// Highest speed in m/s. (0, 3]
    pub full_mps: f64,
    /// Speed in m/s where the robot barely fits, and on the steepest slope. (0, 1]
    pub slow_mps: f64,
    /// Highest turn rate in rad/s. (0, 3]
    pub turn_rps: f64,
    /// Deceleration that can be relied on, in m/s². (0, 10]
    pub deceleration_mps2: f64,
    /// Acceleration that keeps the wheels from slipping, in m/s². (0, 10]
    pub acceleration_mps2: f64,
    /// Time from a measurement to its command's effect, in seconds. [0, 2]
    pub latency_s: f64,
    /// Time between two steps, in seconds. (0, 1]
    pub cycle_s: f64,
    /// Ground that must remain ahead of the hull when the robot stands, in metres. [0, 1]
    pub stop_margin_m: f64,
    /// How far ahead along the path the robot aims, in metres. [0.1, 2]
    pub lookahead_m: f64,
    /// Heading error from which on the robot turns in place, in radians. [0.1, 3]
    pub turn_from_rad: f64,
    /// Heading error at which it drives on, in radians. [0.02, 1]
    pub turn_until_rad: f64,
    /// Distance from the goal that counts as there, in metres. [0.02, 1]
    pub goal_tolerance_m: f64,
    /// Heading error that counts as turned to the goal's heading, in radians. [0.02, 1]
    pub goal_yaw_tolerance_rad: f64,
    /// Distance from the path beyond which a new one must be planned, in metres. [0.05, 1]
    pub off_path_m: f64,
}

impl Default for FollowConfig {
    fn default() -> Self {
        Self {
            full_mps: 0.6,
            slow_mps: 0.15,
            turn_rps: 0.7,
            deceleration_mps2: 0.6,
            acceleration_mps2: 0.5,
            latency_s: 0.35,
            cycle_s: 0.2,
            stop_margin_m: 0.05,
            lookahead_m: 0.35,
            turn_from_rad: 0.6,
            turn_until_rad: 0.12,
            goal_tolerance_m: 0.08,
            goal_yaw_tolerance_rad: 0.08,
            off_path_m: 0.30,
        }
    }
}

/// Why a follower stands still though it is not there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Blocked {
    /// The path ahead is no longer safe.
    Ahead(Conflict),
    /// There is no room to turn towards the path.
    Turning(Conflict),
    /// The robot is too far from the path, by this many metres.
    OffPath(f64),
    /// There is no path.
    NoPath,
}

impl Blocked {
    /// What the hull would have met.
    pub fn conflict(&self) -> Option<Conflict> {
        match self {
            Self::Ahead(conflict) | Self::Turning(conflict) => Some(*conflict),
            Self::OffPath(_) | Self::NoPath => None,
        }
    }
}

impl std::fmt::Display for Blocked {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Ahead(conflict) => write!(f, "the path ahead runs into {conflict}"),
            Self::Turning(conflict) => write!(f, "turning would touch {conflict}"),
            Self::OffPath(away_m) => write!(f, "the robot is {away_m:.2} m off its path"),
            Self::NoPath => f.write_str("there is no path"),
        }
    }
}

/// Change of slope between the ground here and ahead that is a step: one of 0.03 m in a cell of 0.05 m.
const STEP_SLOPE: f64 = 0.18;

/// How far ahead of the hull a step is looked for, in tenths of a metre: the way it takes to slow down.
/// Nothing is missed between them, as a slope is that of 0.25 m of ground.
const STEP_AHEAD: u32 = 4;

/// What a step of the follower came to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FollowStatus {
    /// On the way.
    Following {
        /// Path that remains, metres.
        remaining_m: f64,
    },
    /// At the goal, with its heading if it has one; the command is to stop.
    Reached,
    /// Cannot go on; the command is to stop.
    Blocked(Blocked),
}

/// Follows a path: turns in place while the heading is far off, else steers for a point ahead on the
/// path (pure pursuit), never faster than it can stop on ground that is known to be safe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Follower {
    config: FollowConfig,
    footprint: Footprint,
    squeezed: Footprint,
    steepest: f64,
    inscribed_m: f64,
    half_length_m: f64,
    path: Path,
    along_m: f64,
    turning: bool,
    arrived: bool,
    speed_mps: f64,
}

impl Follower {
    /// A follower without a path, for a robot on grids of the given edge margin.
    pub fn new(config: FollowConfig, shape: &RobotShape, edge_margin_m: f64) -> Self {
        let footprint = Footprint::new(shape, edge_margin_m);
        Self {
            squeezed: footprint.squeezed(),
            footprint,
            steepest: shape.max_slope_rad.tan(),
            inscribed_m: shape.inscribed_radius_m(),
            half_length_m: 0.5 * shape.length_m,
            config,
            path: Path::default(),
            along_m: 0.0,
            turning: false,
            arrived: false,
            speed_mps: 0.0,
        }
    }

    /// The configuration in force.
    pub fn config(&self) -> &FollowConfig {
        &self.config
    }

    /// Goes by another configuration from now on; path and speed are kept.
    pub fn reconfigure(&mut self, config: FollowConfig) {
        self.config = config;
    }

    /// Takes a new path; the speed the robot has is kept.
    pub fn set_path(&mut self, path: Path) {
        self.path = path;
        self.along_m = 0.0;
        self.turning = false;
        self.arrived = false;
    }

    /// The path that is followed.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The next command, for a robot at `pose` over `grid`.
    ///
    /// Any status but `Following` comes with the command to stop.
    pub fn step(&mut self, pose: &Pose2, grid: &Grid) -> (DriveCommand, FollowStatus) {
        let (command, status) = self.decide(pose, grid);
        self.speed_mps = command.linear_mps;
        (command, status)
    }

    fn decide(&mut self, pose: &Pose2, grid: &Grid) -> (DriveCommand, FollowStatus) {
        let halt = |reason| (DriveCommand::STOP, FollowStatus::Blocked(reason));
        let ahead_m = self.along_m + 2.0 * self.config.lookahead_m + 0.3;
        let Some((along_m, away_m)) =
            self.path.nearest(&pose.point(), self.along_m, ahead_m.min(self.path.length_m()))
        else {
            return halt(Blocked::NoPath);
        };
        if away_m > self.config.off_path_m {
            return halt(Blocked::OffPath(away_m));
        }
        self.along_m = along_m;
        let remaining_m = self.path.length_m() - along_m;
        let goal = self.path.pose_at(self.path.length_m());
        self.arrived |= pose.distance_m(&goal.point()) <= self.config.goal_tolerance_m
            || (remaining_m <= 0.5 * self.config.goal_tolerance_m
                && away_m <= 2.0 * self.config.goal_tolerance_m);
        if self.arrived {
            return self.face_goal(pose, grid);
        }
        let target = self.path.pose_at(along_m + self.config.lookahead_m);
        let bearing_rad = pose.bearing_rad(&target.point());
        let limit_rad =
            if self.turning { self.config.turn_until_rad } else { self.config.turn_from_rad };
        self.turning = bearing_rad.abs() > limit_rad;
        let following = FollowStatus::Following { remaining_m };
        if self.turning {
            return match self.turn_towards(pose, grid, bearing_rad) {
                Err(conflict) => halt(Blocked::Turning(conflict)),
                Ok(command) => (command, following),
            };
        }
        let reach_m = pose.distance_m(&target.point()).max(0.1);
        let curvature = 2.0 * bearing_rad.sin() / reach_m;
        let speed_mps = self.speed(pose, grid, curvature, remaining_m);
        match speed_mps {
            Ok(linear_mps) => {
                let command = DriveCommand { linear_mps, angular_rps: linear_mps * curvature };
                (command, following)
            }
            Err(conflict) => halt(Blocked::Ahead(conflict)),
        }
    }

    fn face_goal(&self, pose: &Pose2, grid: &Grid) -> (DriveCommand, FollowStatus) {
        let error_rad =
            self.path.goal_yaw_rad.map_or(0.0, |yaw_rad| wrap_pi(yaw_rad - pose.yaw_rad));
        if error_rad.abs() <= self.config.goal_yaw_tolerance_rad {
            return (DriveCommand::STOP, FollowStatus::Reached);
        }
        match self.turn_towards(pose, grid, error_rad) {
            Err(conflict) => {
                (DriveCommand::STOP, FollowStatus::Blocked(Blocked::Turning(conflict)))
            }
            Ok(command) => (command, FollowStatus::Following { remaining_m: 0.0 }),
        }
    }

    /// The turn in place that brings the heading round by `error_rad`; at a creep where an obstacle is
    /// closer than the margin.
    fn turn_towards(
        &self,
        pose: &Pose2,
        grid: &Grid,
        error_rad: f64,
    ) -> Result<DriveCommand, Conflict> {
        match self.footprint.free_turn_rad(grid, pose, error_rad) {
            Ok(turn_rad) => Ok(self.turn(turn_rad)),
            Err(conflict) if conflict.is_solid() => self
                .squeezed
                .free_turn_rad(grid, pose, error_rad)
                .map(|turn_rad| self.turn(turn_rad).limited(0.0, SQUEEZE_RPS))
                .map_err(|_| conflict),
            Err(conflict) => Err(conflict),
        }
    }

    /// A turn in place, slower towards its end so that latency does not overshoot it.
    fn turn(&self, error_rad: f64) -> DriveCommand {
        let settle_s = 2.0 * (self.config.latency_s + self.config.cycle_s);
        let rate_rps = (error_rad.abs() / settle_s).clamp(0.1, self.config.turn_rps);
        DriveCommand { linear_mps: 0.0, angular_rps: rate_rps.copysign(error_rad) }
    }

    /// The highest speed that all rules allow, or what is in the way of any.
    fn speed(
        &self,
        pose: &Pose2,
        grid: &Grid,
        curvature: f64,
        remaining_m: f64,
    ) -> Result<f64, Conflict> {
        let config = &self.config;
        let here = grid.get(grid.cell_of(pose.x_m, pose.y_m));
        let full_mps = config.full_mps;
        let mut speed_mps = full_mps
            .min(speed_for_curvature(curvature, config.turn_rps, full_mps))
            .min(speed_for_slope(f64::from(here.slope), self.steepest, config.slow_mps, full_mps))
            .min(self.speed_mps.max(0.0) + config.acceleration_mps2 * config.cycle_s);
        if self.meets_a_step(pose, grid, f64::from(here.slope)) {
            speed_mps = speed_mps.min(config.slow_mps);
        }
        let ahead_m = 0.5;
        let next = self.path.pose_at(self.along_m + ahead_m);
        for point in [pose.point(), next.point()] {
            speed_mps = speed_mps.min(speed_for_room(
                grid.room_at(point.x, point.y),
                self.inscribed_m,
                2.0 * self.inscribed_m,
                config.slow_mps,
                full_mps,
            ));
        }
        // Come to rest at the goal, not beyond it.
        let until_goal_m = remaining_m + 0.5 * config.goal_tolerance_m;
        speed_mps = speed_mps
            .min(speed_to_stop_within(until_goal_m, config.latency_s, config.deceleration_mps2))
            .max(0.05);
        let (safe_m, conflict) = self.safe_ahead(&self.footprint, pose, grid, curvature, speed_mps);
        let stop_mps = speed_to_stop_within(
            safe_m - config.stop_margin_m,
            config.latency_s,
            config.deceleration_mps2,
        );
        match conflict {
            Some(conflict) if stop_mps < 0.02 => {
                let beside = conflict.is_solid()
                    && self
                        .safe_ahead(&self.squeezed, pose, grid, curvature, SQUEEZE_MPS)
                        .1
                        .is_none();
                if beside { Ok(speed_mps.min(SQUEEZE_MPS)) } else { Err(conflict) }
            }
            _ => Ok(speed_mps.min(stop_mps)),
        }
    }

    /// Whether the ground that the hull comes over next breaks: a kerb or debris that the wheels climb,
    /// the foot or the crest of a ramp. The hull strikes it at the speed the robot has.
    fn meets_a_step(&self, pose: &Pose2, grid: &Grid, slope: f64) -> bool {
        let (from_m, step_m) = (self.half_length_m, 0.1);
        (0..=STEP_AHEAD).any(|step| {
            let ahead = pose.driven(from_m + step_m * f64::from(step), 0.0);
            let (sin, cos) = ahead.yaw_rad.sin_cos();
            [-1.0, -0.5, 0.0, 0.5, 1.0].into_iter().any(|share| {
                let aside_m = share * self.inscribed_m;
                let (x_m, y_m) = (ahead.x_m - sin * aside_m, ahead.y_m + cos * aside_m);
                let there = grid.get(grid.cell_of(x_m, y_m));
                there.class.is_drivable() && (f64::from(there.slope) - slope).abs() > STEP_SLOPE
            })
        })
    }

    /// How far the robot can go from `pose` before its hull meets anything unsafe, and what that is:
    /// the lesser of the arc it is about to drive and of the path beyond. Looks no farther than it
    /// takes to stop from `speed_mps`, one cycle later.
    fn safe_ahead(
        &self,
        footprint: &Footprint,
        pose: &Pose2,
        grid: &Grid,
        curvature: f64,
        speed_mps: f64,
    ) -> (f64, Option<Conflict>) {
        let config = &self.config;
        let latency_s = config.latency_s + config.cycle_s;
        let horizon_m = stopping_distance_m(speed_mps, latency_s, config.deceleration_mps2)
            + config.stop_margin_m
            + 0.1;
        let step_m = 0.5 * grid.cell_m();
        let steps = (horizon_m / step_m).ceil() as u32;
        for step in 1..=steps {
            let ahead_m = f64::from(step) * step_m;
            let on_arc = pose.driven(ahead_m, ahead_m * curvature);
            let on_path = self.path.pose_at(self.along_m + ahead_m);
            // The path's heading jumps at its corners, where the robot turns gradually or in place.
            let on_path = Pose2 { yaw_rad: on_arc.yaw_rad, ..on_path };
            let conflict =
                footprint.conflict(grid, &on_arc).or_else(|| footprint.conflict(grid, &on_path));
            if let Some(conflict) = conflict {
                return (ahead_m - step_m, Some(conflict));
            }
        }
        (horizon_m, None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{CellClass, CellIndex, GridCell};
    use nalgebra::Point2;

    /// Speed of a robot that drives along x, one second after it set out, with ground that breaks
    /// at `x_m`.
    fn speed_before(x_m: Option<f64>) -> f64 {
        let free = GridCell {
            class: CellClass::Free,
            height_m: 0.0,
            room_m: 1.5,
            sure: true,
            reachable: true,
            ..GridCell::default()
        };
        let mut cells = vec![free; 40_000];
        for y in 0..200 {
            if let Some(x_m) = x_m {
                // A slope is that of 5 × 5 cells: a break shows in five in a row.
                let first = y * 200 + 98 + (x_m / 0.05) as usize;
                cells[first..first + 5].iter_mut().for_each(|cell| cell.slope = 0.3);
            }
        }
        let grid = Grid::from_cells(0.05, CellIndex { x: -100, y: -100 }, 200, cells);
        let mut follower = Follower::new(FollowConfig::default(), &RobotShape::default(), 0.15);
        follower.set_path(Path::new(vec![Point2::new(0.0, 0.0), Point2::new(4.0, 0.0)]));
        let pose = Pose2 { x_m: 1.0, y_m: 0.0, yaw_rad: 0.0 };
        (0..10).map(|_| follower.step(&pose, &grid).0.linear_mps).fold(0.0, f64::max)
    }

    #[test]
    fn ground_that_breaks_is_driven_over_slowly() {
        let slow_mps = FollowConfig::default().slow_mps;
        assert!(speed_before(None) > 2.0 * slow_mps, "{}", speed_before(None));
        assert!(speed_before(Some(1.5)) <= slow_mps, "{}", speed_before(Some(1.5)));
        assert!(speed_before(Some(3.0)) > 2.0 * slow_mps, "{}", speed_before(Some(3.0)));
    }
}
