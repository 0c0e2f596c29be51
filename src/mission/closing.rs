//! The last look: the place that a mission reports is one that a sweep has corrected.

use super::config::AgentConfig;
use super::fixing::best_heading;
use super::operator::Mode;
use super::pilot::Progress;
use super::running::{Activity, Desk, Look, Running};
use crate::acquisition::Profile;
use crate::geometry::wrap_pi;
use crate::time::Arrival;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// Rows of the last look, in degrees: walls, floor and ceiling fix all directions, and small planes
/// show too where only one wall is near.
const ROWS_DEG: f64 = 1.0;
/// Time beyond what the sweep is thought to take, in seconds: the head may have to come from far.
const SPARE_S: f64 = 4.0;
/// Time before the end at which a sweep is handed over as far as it has come, in seconds: how long one takes is
/// an estimate, and half a sweep tells the place nearly as well as a whole one.
const HAND_OVER_S: f64 = 1.0;
/// Way since the last sweep in metres from which another corrects anything.
const MOVED_M: f64 = 0.02;
/// Spread of the place believed, in metres, from which another look is worth its time.
const VAGUE_M: f64 = 0.03;
/// The same for the heading, in radians.
const VAGUE_RAD: f64 = 0.004;

/// How long a turn may take before the look, for each radian and besides, in seconds.
const TURN_S_PER_RAD: f64 = 2.5;
const TURN_SPARE_S: f64 = 3.0;

/// How far the end of the mission's time has come.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) enum Closing {
    /// There is time for other things.
    #[default]
    NotYet,
    /// The robot turns to what fixes its place.
    Turning,
    /// The last look is under way or over.
    Over,
}

impl Running {
    /// In the last seconds of its time the robot stops, turns to where the map says that its place will show,
    /// looks once more and stays. Returns whether this cycle was used for that.
    pub(super) fn close(&mut self, desk: &mut Desk<'_>) -> bool {
        if desk.end.is_some_and(|end| (end - desk.now).seconds() <= HAND_OVER_S) {
            self.hand_over(desk);
        }
        let is_over = self.mode == Mode::Teleop || self.closing == Closing::Over;
        let Some(end) = desk.end.filter(|_| !is_over) else { return false };
        let looking = matches!(
            self.activity,
            Activity::Settle { .. } | Activity::Sweep | Activity::SignTest(_)
        );
        let Some(needed_s) = self.last_look_s(desk.config).filter(|_| !looking) else {
            return false;
        };
        let left_s = (end - desk.now).seconds();
        if left_s > needed_s {
            if self.closing == Closing::Turning {
                return self.turn_on(end, desk);
            }
            return left_s <= needed_s + longest_turn_s()
                && self.begin_turn(left_s - needed_s, end, desk);
        }
        self.look_last(end, desk)
    }

    /// Before a look of so many seconds: begins the last turn in its stead where no time would be left for that
    /// after it.
    pub(super) fn closes_before(&mut self, look_s: f64, desk: &mut Desk<'_>) -> bool {
        let Some(end) = desk.end.filter(|_| self.closing == Closing::NotYet) else { return false };
        let Some(needed_s) = self.last_look_s(desk.config) else { return false };
        let left_s = (end - desk.now).seconds() - look_s;
        self.mode != Mode::Teleop
            && left_s <= needed_s + longest_turn_s()
            && self.begin_turn(0.0, end, desk)
    }

    /// How long the last look is thought to take, in seconds; `None` of a laser that takes none.
    fn last_look_s(&self, config: &AgentConfig) -> Option<f64> {
        let flowing = config.mission.flowing_sweeps;
        let sweep_s = self.acquisition.as_ref()?.seconds_for(&Profile::coarse(ROWS_DEG), flowing);
        Some(config.mission.settle_s + sweep_s + SPARE_S)
    }

    /// Takes in a sweep that will not be over in time. It is the last one, whatever was to come after it.
    fn hand_over(&mut self, desk: &mut Desk<'_>) {
        if !matches!(self.activity, Activity::Sweep) {
            return;
        }
        let acquisition = self.acquisition.as_mut();
        let scan = acquisition.and_then(|it| it.stop_sweep("the time is up", desk.now));
        self.closing = Closing::Over;
        self.queue.clear();
        if let Some(scan) = scan.filter(|scan| scan.filed > 0) {
            self.finish_sweep(scan, desk);
        }
    }

    fn look_last(&mut self, end: Arrival, desk: &mut Desk<'_>) -> bool {
        let Some(request) = self.taken(Profile::coarse(ROWS_DEG), desk.config) else {
            return false;
        };
        let has_turned = std::mem::replace(&mut self.closing, Closing::Over) == Closing::Turning;
        self.end_nod("the time is nearly up", desk);
        if has_turned || self.belief.leg_m() > MOVED_M || self.is_vague() {
            desk.info(
                "the time is nearly up: a last look, so that the place told is a corrected one",
            );
            self.settle(Look::Sweep(request), desk);
        } else {
            self.stop(desk);
            self.activity = Activity::Rest { until: end };
        }
        true
    }

    /// Begins to turn to where a look fixes the place, if one ahead does not and the time left is as long as
    /// the turn.
    fn begin_turn(&mut self, left_s: f64, end: Arrival, desk: &mut Desk<'_>) -> bool {
        if !self.is_vague() || !self.may_explore(desk.config) {
            return false;
        }
        let covariance = self.belief.mapper().covariance();
        let axes = [0, 1, 5];
        let covariance = Matrix3::from_fn(|i, j| covariance[(axes[i], axes[j])]);
        let pose = self.pose2();
        let landmarks = self.belief.mapper().landmarks().iter();
        let Some(yaw_rad) = best_heading(landmarks, &pose, &covariance, &self.grid) else {
            return false;
        };
        let turn_rad = wrap_pi(yaw_rad - pose.yaw_rad).abs();
        if left_s > turn_s(turn_rad) {
            return false;
        }
        let costs = self.costs(desk);
        let cell = self.grid.cell_of(pose.x_m, pose.y_m);
        let Ok(path) = self.planner.plan(&self.grid, &costs, &pose, cell) else { return false };
        desk.info(format!(
            "the time is nearly up: turning by {:.0}° to what fixes the place",
            turn_rad.to_degrees()
        ));
        self.end_nod("the time is nearly up", desk);
        self.pilot.set_path(path.with_goal_yaw(yaw_rad));
        self.park(desk);
        self.activity = Activity::Rest { until: end };
        self.closing = Closing::Turning;
        true
    }

    /// One cycle of that turn. Trouble on the way ends it: there is no time for getting out.
    fn turn_on(&mut self, end: Arrival, desk: &mut Desk<'_>) -> bool {
        if !matches!(self.activity, Activity::Rest { .. }) {
            return self.look_last(end, desk);
        }
        self.renew_grid(desk);
        let pose = self.pose2();
        let parked = self.parked(desk.now);
        let (command, progress) = self.pilot.follow(&pose, &self.grid, parked, desk.now);
        if progress == Progress::Going {
            self.drive(command, desk);
            return true;
        }
        self.look_last(end, desk)
    }

    /// Whether the sweeps so far leave the place or the heading badly known.
    fn is_vague(&self) -> bool {
        let covariance = self.belief.mapper().covariance();
        let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
        sigma(0).hypot(sigma(1)).hypot(sigma(2)) > VAGUE_M || sigma(5) > VAGUE_RAD
    }
}

fn turn_s(turn_rad: f64) -> f64 {
    TURN_SPARE_S + TURN_S_PER_RAD * turn_rad
}

fn longest_turn_s() -> f64 {
    turn_s(std::f64::consts::PI)
}
