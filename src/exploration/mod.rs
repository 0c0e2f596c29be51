//! Where to look next.
//!
//! [`Explorer::choose`] weighs view poses on reachable ground: what a sweep from there would newly
//! see, against the time to get there and take it. It remembers where looking did not help and which
//! goals failed, and says in plain words why it chose what it chose, or why nothing is left.

mod choose;
mod frontier;
mod memory;
mod places;
mod view;

pub use frontier::Frontier;
pub use memory::FailedGoal;
pub use places::{Doorway, Places, Room, Walls};

use crate::navigation::Pose2;
use crate::terrain::{CellIndex, Grid};
use crate::time::Arrival;
use memory::{FailedGoals, Looks, Shortfalls};
use serde::{Deserialize, Serialize};
use view::ViewMap;

/// What exploration values and what it costs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExploreConfig {
    /// Distance to which a sweep sees ground, in metres. [2, 20]
    pub view_range_m: f64,
    /// Distance to which a sweep sees ground closely enough to drive on it, in metres. [1, 20]
    pub close_range_m: f64,
    /// Distance within which a sweep cannot see the ground, in metres. [0, 5]
    pub blind_m: f64,
    /// Angle that a sweep covers about the robot's heading, in radians: π for a tilting laser that
    /// sees 180°, 2π where the pan looks round. (0, 2π]
    pub field_of_view_rad: f64,
    /// Time that a sweep takes, in seconds. [0, 600]
    pub scan_s: f64,
    /// Speed that driving averages, in m/s. (0, 3]
    pub speed_mps: f64,
    /// Turn rate that turning averages, in rad/s. (0, 3]
    pub turn_rps: f64,
    /// Gain below which a sweep is not worth its time, in square metres. [0.01, 10]
    pub least_gain_m2: f64,
    /// How many times better another goal must be to replace the current one. [1, 5]
    pub hysteresis: f64,
    /// Distance between candidate view poses, in metres. [0.1, 2]
    pub candidate_spacing_m: f64,
    /// Radius about a failed goal that stays closed for a time, in metres. [0.1, 3]
    pub failure_radius_m: f64,
    /// How long a goal that failed once stays closed, in seconds; doubled by each failure, at most
    /// eightfold. [1, 600]
    pub failure_s: f64,
    /// Frontiers shorter than this many cells are not reported. [1, 100]
    pub least_frontier_cells: usize,
}

impl Default for ExploreConfig {
    fn default() -> Self {
        Self {
            view_range_m: 7.0,
            close_range_m: 5.0,
            blind_m: 1.05,
            field_of_view_rad: std::f64::consts::PI,
            scan_s: 15.0,
            speed_mps: 0.35,
            turn_rps: 0.35,
            least_gain_m2: 0.3,
            hysteresis: 1.3,
            candidate_spacing_m: 0.4,
            failure_radius_m: 0.5,
            failure_s: 60.0,
            least_frontier_cells: 6,
        }
    }
}

/// A goal to drive to and sweep from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Choice {
    /// Where to stand and which way to face.
    pub goal: Pose2,
    /// The goal's cell, for the planner.
    pub cell: CellIndex,
    /// What a sweep there is expected to show newly, square metres.
    pub gain_m2: f64,
    /// Cost of the way in metres of good ground.
    pub way_m: f64,
    /// Time to get there and sweep, seconds.
    pub seconds: f64,
    /// The frontier that the goal faces, if one is near.
    pub frontier: Option<Frontier>,
    /// Whether this is the goal chosen before.
    pub kept: bool,
    /// Why this one, in plain words.
    pub reasons: Vec<String>,
}

/// A frontier that stays, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrontierLeft {
    /// Metres along map x.
    pub x: f64,
    /// Metres along map y.
    pub y: f64,
    /// Its cells.
    pub cells: usize,
    /// Why it is not explored, in plain words.
    pub reason: String,
}

/// What to do next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Decision {
    /// Drive there and sweep.
    Go(Choice),
    /// No reachable place is worth a sweep now.
    NothingLeft {
        /// The frontiers that remain, each with its reason.
        frontiers_left: Vec<FrontierLeft>,
        /// When a goal that failed may be tried again, if any waits.
        retry_at: Option<Arrival>,
    },
}

/// Chooses goals and remembers how they went.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Explorer {
    config: ExploreConfig,
    current: Option<Choice>,
    /// Time in which a sweep elsewhere must be over, in seconds; `None` for all the time there is.
    time_left_s: Option<f64>,
    failed: FailedGoals,
    looks: Looks,
    vain: Shortfalls,
}

impl Explorer {
    /// An explorer that knows nothing yet.
    pub fn new(config: ExploreConfig) -> Self {
        Self {
            config,
            current: None,
            time_left_s: None,
            failed: FailedGoals::default(),
            looks: Looks::default(),
            vain: Shortfalls::default(),
        }
    }

    /// The rig sees ground from `blind_m` on, and a sweep takes `scan_s`, where that has changed.
    pub fn sees(&mut self, blind_m: f64, scan_s: f64) {
        (self.config.blind_m, self.config.scan_s) = (blind_m, scan_s);
    }

    /// The configuration in force.
    pub fn config(&self) -> &ExploreConfig {
        &self.config
    }

    /// The goal that is being driven to, if any.
    pub fn current(&self) -> Option<&Choice> {
        self.current.as_ref()
    }

    /// Goals that failed so far.
    pub fn failed_goals(&self) -> &[FailedGoal] {
        self.failed.goals()
    }

    /// Tells that a sweep was taken at `pose` over `field_of_view_rad` about its heading and that
    /// `grid` holds what it showed. What is still unknown where the sweep looked is worth less from
    /// now on: glass, black floors and cracks would otherwise draw the robot back for ever.
    ///
    /// `range_share` is the share of the range within which it should have shown all there is.
    ///
    /// What a place still seems to promise after a second look from there is taken off its worth, so
    /// that no place is chosen for ever that shows nothing new.
    ///
    /// Also acknowledges the current goal where the sweep was taken close to it.
    pub fn swept(&mut self, grid: &Grid, pose: &Pose2, field_of_view_rad: f64, range_share: f64) {
        let looked = ViewMap::new(grid, &self.looks).looked_at(
            pose,
            field_of_view_rad,
            self.config.blind_m,
            self.config.close_range_m,
            range_share * self.config.view_range_m,
        );
        self.looks.note(&looked);
        let left = ViewMap::new(grid, &self.looks).gain(
            pose.x_m,
            pose.y_m,
            self.config.blind_m,
            self.config.close_range_m,
            self.config.view_range_m,
        );
        self.vain.note(pose, field_of_view_rad, &left);
        let close = |goal: &Choice| goal.goal.distance_m(&pose.point()) <= 0.5;
        if self.current.as_ref().is_some_and(close) {
            self.current = None;
        }
    }

    /// Tells that the current goal was reached; a sweep there is still to come.
    pub fn reached(&mut self) {
        self.current = None;
    }

    /// Tells that the current goal could not be reached, and why. It is left alone for a time.
    pub fn give_up(&mut self, reason: &str, now: Arrival) {
        if let Some(goal) = self.current.take() {
            self.close(&goal.goal, reason, now);
        }
    }

    /// Leaves the surroundings of a place alone for a time.
    pub fn close(&mut self, at: &Pose2, reason: &str, now: Arrival) {
        let (base_s, radius_m) = (self.config.failure_s, self.config.failure_radius_m);
        self.failed.note(at.point(), reason.to_owned(), now, base_s, radius_m);
    }
}
