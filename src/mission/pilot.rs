//! Moving the robot: the path follower under the watch of the guard line, and the way out of
//! trouble. Every speed that leaves here has passed both.

mod operated;

pub use operated::{Hold, Way};

use super::config::AgentConfig;
use crate::acquisition::{GuardConfig, GuardTilt, ParkState, guard_tilt};
use crate::navigation::{
    Blocked, DriveCommand, FollowConfig, FollowStatus, Follower, Footprint, Guard, GuardVerdict,
    Motion, Path, Pose2, Recovery, RecoveryStep, Rung, StuckDetector, Swath, Trail, Trouble,
};
use crate::robot::Rig;
use crate::scan::LaserLine;
use crate::terrain::{CellClass, Grid, RobotShape};
use crate::time::{Arrival, Span};
use nalgebra::{Isometry3, Point2, Point3};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// Lines in a row that must contradict the map before the robot turns back: one may be noise.
const CONVINCING_LINES: u32 = 2;

/// A place within this distance of something known counts as known.
const KNOWN_WITHIN_M: f64 = 0.25;

/// What an assumed way is wider than the circle that the hull turns in, on each side, in metres.
const TURNING_M: f64 = 0.06;

/// Steps in which a line across the way is looked at, in metres.
const LINE_STEP_M: f64 = 0.04;

/// What a cycle of following came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// On the way.
    Going,
    /// At the goal.
    Reached,
    /// The path is no longer good: plan again.
    Blocked(Blocked),
    /// The guard line saw what the map does not hold: look again.
    Surprised(GuardVerdict),
}

/// Drives paths.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Pilot {
    shape: RobotShape,
    follower: Follower,
    footprint: Footprint,
    guard: Guard,
    guard_tilt: Option<GuardTilt>,
    watch: Watch,
    trail: Trail,
    swath: Swath,
    stuck: StuckDetector,
    /// Where the robot last got out of trouble, and how.
    got_out: Option<(Pose2, Rung)>,
    slow_mps: f64,
    guard_age: Span,
    late_s: f64,
}

/// A robot in trouble so near to where it got out of some is in the same, in metres.
const BACK_AGAIN_M: f64 = 0.5;

/// What the guard line last said.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Watch {
    /// When the way was last seen clear.
    clear: Option<Arrival>,
    /// Nearest ground that was confirmed then, in metres ahead of the robot's centre.
    ahead_m: Option<f64>,
    /// When any verdict last came.
    heard: Option<Arrival>,
    /// Contradictions in a row, and the last of them.
    surprises: u32,
    surprise: Option<GuardVerdict>,
}

impl Pilot {
    /// A pilot for a rig of this shape.
    pub fn new(config: &AgentConfig, rig: &Rig, shape: &RobotShape) -> Self {
        let edge_margin_m = config.belief.terrain.edge_margin_m;
        let (follow, guard_tilt) = guarded(config, rig, 0.0);
        Self {
            footprint: Footprint::new(shape, edge_margin_m),
            guard: Guard::new(config.guard.clone(), shape),
            guard_tilt,
            watch: Watch::default(),
            trail: Trail::default(),
            got_out: None,
            swath: Swath::default(),
            stuck: StuckDetector::new(config.stuck.clone()),
            slow_mps: follow.slow_mps,
            guard_age: Span::from_seconds(config.mission.guard_age_s),
            follower: Follower::new(follow, shape, edge_margin_m),
            shape: shape.clone(),
            late_s: 0.0,
        }
    }

    /// Goes by what the rig's tilt reaches now, and by commands that are obeyed `late_s` seconds later
    /// than the configuration supposes; the path and the way back stay.
    pub fn refit(&mut self, config: &AgentConfig, rig: &Rig, late_s: f64) {
        let (follow, guard_tilt) = guarded(config, rig, late_s);
        self.late_s = late_s;
        self.guard_tilt = guard_tilt;
        self.slow_mps = follow.slow_mps;
        self.watch = Watch::default();
        self.follower.reconfigure(follow);
    }

    /// Seconds by which commands are taken to be obeyed later than the configuration supposes.
    pub fn late_s(&self) -> f64 {
        self.late_s
    }

    /// Where the tilt is parked while driving; `None` for a laser that cannot guard.
    pub fn guard_tilt(&self) -> Option<GuardTilt> {
        self.guard_tilt
    }

    /// Greatest speed with and without a guard line, in m/s.
    pub fn speeds_mps(&self) -> (f64, f64) {
        (self.follower.config().full_mps, self.slow_mps)
    }

    /// The way that is left of the path from `pose` on, up to `within_m`, as points a cell of `step_m`
    /// apart.
    pub fn way_ahead(&self, pose: &Pose2, within_m: f64, step_m: f64) -> Vec<Point2<f64>> {
        let path = self.follower.path();
        let length_m = path.length_m();
        let Some((from_m, _)) = path.nearest(&pose.point(), 0.0, length_m) else {
            return Vec::new();
        };
        let steps = ((length_m - from_m).min(within_m) / step_m).max(0.0) as u32;
        (1..=steps).map(|step| path.pose_at(from_m + step_m * f64::from(step)).point()).collect()
    }

    /// How far the path leads on from `pose` over ground that was seen well, up to `within_m`.
    pub fn sure_ahead_m(&self, pose: &Pose2, grid: &Grid, within_m: f64) -> f64 {
        let path = self.follower.path();
        let length_m = path.length_m();
        let Some((from_m, _)) = path.nearest(&pose.point(), 0.0, length_m) else { return 0.0 };
        let step_m = grid.cell_m().max(0.01);
        let steps = ((length_m - from_m).min(within_m) / step_m).max(0.0) as u32;
        let sure = (1..=steps).take_while(|&step| {
            let at = path.pose_at(from_m + step_m * f64::from(step));
            let seen = grid.get(grid.cell_of(at.x_m, at.y_m));
            seen.class.is_drivable() && seen.sure
        });
        step_m * sure.count() as f64
    }

    /// Takes a path to follow.
    pub fn set_path(&mut self, path: Path) {
        self.follower.set_path(path);
        self.stuck.reset();
        self.watch = Watch::default();
    }

    /// The robot's own track, oldest first.
    pub fn track(&self) -> &[Pose2] {
        self.trail.crumbs()
    }

    /// Takes the hull's way from `pose` to `ahead_m` before it, wide enough to turn in, for ground, if
    /// the line that crosses it there has met ground all along.
    pub fn assume_way(&mut self, pose: &Pose2, ahead_m: f64) -> bool {
        let half_m = self.shape.circumscribed_radius_m() + TURNING_M;
        let steps = (half_m / LINE_STEP_M).ceil();
        let across = |step: i32| {
            let side = Pose2 { yaw_rad: pose.yaw_rad + FRAC_PI_2, ..pose.driven(ahead_m, 0.0) };
            side.driven(half_m * f64::from(step) / steps, 0.0).point()
        };
        let is_whole =
            (-(steps as i32)..=steps as i32).all(|step| self.swath.covers(&across(step)));
        if is_whole {
            self.swath.stood(&pose.driven(0.5 * ahead_m, 0.0), ahead_m, 2.0 * half_m);
        }
        is_whole
    }

    /// Notes where the robot is: the way back, and ground that bears.
    pub fn passed(&mut self, pose: &Pose2) {
        self.trail.note(pose);
        self.swath.stood(pose, self.shape.length_m, self.shape.width_m);
    }

    /// Carries the way back along when the robot's pose was corrected.
    pub fn corrected(&mut self, before: &Isometry3<f64>, after: &Isometry3<f64>) {
        self.trail.correct(before, after);
        self.swath.correct(before, after);
    }

    /// Judges a line taken with the head parked; whether it shows the way as it should be.
    pub fn watch(
        &mut self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        world_from_robot: &Isometry3<f64>,
        grid: &Grid,
        now: Arrival,
    ) -> bool {
        for p in self.guard.level_ground(line, robot_from_sensor) {
            self.swath.met(&(world_from_robot * p).xy());
        }
        let verdict = self.guard.judge(line, robot_from_sensor, Some((world_from_robot, grid)));
        self.watch.heard = Some(now);
        if let GuardVerdict::Clear { ahead_m } = verdict {
            self.watch = Watch { clear: Some(now), heard: Some(now), ahead_m, ..Watch::default() };
        } else if self.is_surprise(&verdict, world_from_robot, grid) {
            self.watch.surprises += 1;
            self.watch.surprise = Some(verdict);
        } else {
            self.watch.surprises = 0;
        }
        verdict.is_clear()
    }

    /// Whether a verdict contradicts what the grid holds on the robot's own way. What the grid knows
    /// is the follower's business, and what the path does not pass does not matter. Without a path an
    /// operator drives, and all that is ahead matters.
    fn is_surprise(
        &self,
        verdict: &GuardVerdict,
        world_from_robot: &Isometry3<f64>,
        grid: &Grid,
    ) -> bool {
        let (ahead_m, left_m) = match *verdict {
            GuardVerdict::Obstacle { ahead_m, left_m, .. }
            | GuardVerdict::DropOff { ahead_m, left_m, .. } => (ahead_m, left_m),
            GuardVerdict::Clear { .. } | GuardVerdict::Blind { .. } => return false,
        };
        let place = (world_from_robot * Point3::new(ahead_m, left_m, 0.0)).xy();
        let corridor_m = 0.5 * self.shape.width_m + 0.15;
        let path = self.follower.path();
        let near_path = path.points().is_empty()
            || path
                .nearest(&place, 0.0, path.length_m())
                .is_some_and(|(_, away)| away <= corridor_m);
        near_path && !is_known_barrier(grid, &place)
    }

    /// What a line said lately that should end any forward motion at once.
    pub fn surprise(&self) -> Option<GuardVerdict> {
        self.watch.surprise.filter(|_| self.watch.surprises >= CONVINCING_LINES)
    }

    /// Nearest ground ahead that the guard line confirms now, in metres from the robot's centre; `None`
    /// where it does not find the way clear.
    pub fn confirmed_ahead_m(&self, now: Arrival) -> Option<f64> {
        let recent = self.watch.clear.is_some_and(|at| now - at <= self.guard_age);
        self.watch.ahead_m.filter(|_| recent && self.watch.surprises == 0)
    }

    /// The greatest forward speed that the guard line allows now.
    fn allowed_mps(&self, parked: ParkState, now: Arrival) -> f64 {
        let recent = |at: Option<Arrival>| at.is_some_and(|at| now - at <= self.guard_age);
        match parked {
            // A head that cannot be parked guards nothing: creep, over ground that was seen.
            ParkState::Elsewhere { .. } | ParkState::Nodding => self.slow_mps,
            _ if self.guard_tilt.is_none() => self.slow_mps,
            ParkState::NotParked | ParkState::Moving => 0.0,
            ParkState::Computed { .. } | ParkState::Verified { .. } => {
                if self.watch.surprises > 0 || !recent(self.watch.heard) {
                    0.0
                } else if recent(self.watch.clear) {
                    f64::INFINITY
                } else {
                    self.slow_mps
                }
            }
        }
    }

    /// One cycle of following the path.
    pub fn follow(
        &mut self,
        pose: &Pose2,
        grid: &Grid,
        parked: ParkState,
        now: Arrival,
    ) -> (DriveCommand, Progress) {
        self.passed(pose);
        if let Some(verdict) = self.surprise() {
            return (DriveCommand::STOP, Progress::Surprised(verdict));
        }
        let (command, status) = self.follower.step(pose, grid);
        let allowed_mps = self.allowed_mps(parked, now);
        let command = if command.linear_mps > allowed_mps {
            if allowed_mps == 0.0 {
                DriveCommand::STOP
            } else {
                command.limited(allowed_mps, f64::INFINITY)
            }
        } else {
            command
        };
        match status {
            FollowStatus::Following { .. } => (command, Progress::Going),
            FollowStatus::Reached => (DriveCommand::STOP, Progress::Reached),
            FollowStatus::Blocked(reason) => (DriveCommand::STOP, Progress::Blocked(reason)),
        }
    }

    /// Compares what was commanded with what came of it.
    pub fn check(&mut self, motion: Motion) -> Option<Trouble> {
        self.stuck.note(motion)
    }

    /// Begins to get out of trouble.
    pub fn recover(
        &mut self,
        config: &AgentConfig,
        trouble: &Trouble,
        pose: &Pose2,
        now: Arrival,
    ) -> Recovery {
        self.stuck.reset();
        let edge_margin_m = config.belief.terrain.edge_margin_m;
        let (ladder, shape) = (config.recovery.clone(), &self.shape);
        let recovery = Recovery::new(ladder, shape, edge_margin_m, trouble, now, pose);
        match self.got_out.take() {
            Some((at, rung)) if at.distance_m(&pose.point()) < BACK_AGAIN_M => recovery.after(rung),
            _ => recovery,
        }
    }

    /// One cycle of getting out of trouble.
    pub fn recovery_step(
        &mut self,
        recovery: &mut Recovery,
        pose: &Pose2,
        lean_rad: f64,
        grid: &Grid,
        now: Arrival,
    ) -> RecoveryStep {
        let step = recovery.step(now, pose, lean_rad, &self.trail, grid);
        if step == RecoveryStep::Recovered {
            self.got_out = Some((*pose, recovery.rung()));
        }
        step
    }
}

/// How fast a rig may follow a path, and where its laser guards the way.
fn guarded(config: &AgentConfig, rig: &Rig, late_s: f64) -> (FollowConfig, Option<GuardTilt>) {
    let mut follow = config.follow.clone();
    let guard = &config.acquisition.guard;
    let guard = GuardConfig { reaction_s: guard.reaction_s + late_s, ..guard.clone() };
    // Without a guard line no more ground is passed before a stop is obeyed than without the delay.
    follow.slow_mps *= follow.latency_s / (follow.latency_s + late_s).max(1e-3);
    follow.latency_s += late_s;
    // A robot that cannot turn its wheels faster is not asked to.
    follow.full_mps = follow.full_mps.min(0.95 * rig.drive.max_linear_mps());
    follow.slow_mps = follow.slow_mps.min(follow.full_mps);
    follow.turn_rps = follow.turn_rps.min(0.95 * rig.drive.max_angular_rps());
    let guard_tilt = rig.ground_view().and_then(|view| guard_tilt(follow.full_mps, &view, &guard));
    if let Some(tilt) = guard_tilt {
        follow.full_mps = follow.full_mps.min(tilt.max_speed_mps);
    }
    (follow, guard_tilt)
}

fn is_barrier(class: CellClass) -> bool {
    matches!(
        class,
        CellClass::Occupied | CellClass::TooSteep | CellClass::DropOff | CellClass::Suspect
    )
}

/// Whether the grid holds a barrier of any kind close to a place.
fn is_known_barrier(grid: &Grid, place: &Point2<f64>) -> bool {
    let reach = (KNOWN_WITHIN_M / grid.cell_m().max(0.01)).ceil() as i32;
    let centre = grid.cell_of(place.x, place.y);
    (-reach..=reach).any(|dy| {
        (-reach..=reach).any(|dx| {
            let cell = crate::terrain::CellIndex { x: centre.x + dx, y: centre.y + dy };
            (grid.centre(cell) - place).norm() <= KNOWN_WITHIN_M && is_barrier(grid.get(cell).class)
        })
    })
}
