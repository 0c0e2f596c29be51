//! What the robot does on its own: sweep, choose, drive, recover.

use super::closing::Closing;
use super::config::AgentConfig;
use super::operator::Mode;
use super::pilot::Progress;
use super::running::{Activity, Desk, Drive, Look, Running, Verdict};
use crate::acquisition::{Acquisition, ParkState, Profile, SweepRequest};
use crate::exploration::Decision;
use crate::geometry::wrap_pi;
use crate::navigation::{CostMap, DriveCommand, RecoveryStep, Trouble};
use crate::terrain::CellClass;
use crate::time::{Arrival, Span};

/// Goals tried at one choosing before the robot rests a while.
const TRIES: usize = 6;

/// Times a path may be planned anew before the goal is given up.
const REPLANS: u32 = 4;

/// Goals given up in one place, one after the other, that show the robot wedged in.
const WEDGED: u32 = 2;

/// Way from the last sweep from which on another one shows something new, in metres.
const MOVED_ON_M: f64 = 0.5;

/// Rest after nothing could be planned, so that what moves may move on.
const REST: Span = Span::from_millis(2_000);

/// How long a place that the hull did not get past is avoided.
const SHUNNED: Span = Span::from_millis(120_000);

/// Lines of a fixed laser before the first choice.
const PLANAR_LINES: usize = 5;

/// Time before the end within which nothing new is begun once no sweep elsewhere would be over.
const TOO_LATE: Span = Span::from_millis(90_000);

/// A goal within this way is a turn in place.
pub(super) const STAYS_M: f64 = 0.3;

/// The last resort that backs out over the own track.
const BACK_OUT: u32 = 3;

/// Rest of a robot that is cut off before it tries again.
const CUT_OFF: Span = Span::from_millis(10_000);

/// Track nearer than this says nothing of being cut off, in metres.
const CUT_OFF_FROM_M: f64 = 1.0;

/// Way in metres up to which the robot is at its start, the only place where a gap is assumed.
pub(super) const START_M: f64 = 1.0;

/// Sixths of a turn that are looked at before the first way: with the one ahead, all around.
const LOOKS_AROUND: u32 = 4;

/// Rows of the sweep by which a tilt that showed no ground is tried again, in degrees.
const TRIED_AGAIN_DEG: f64 = 1.0;

/// Roll or pitch from which a robot with nothing left to go to is thought to hang, in radians.
const HANGING_RAD: f64 = 0.12;
/// From one heading to the next when the robot looks around.
const THIRD_OF_A_TURN: f64 = 2.0 * std::f64::consts::PI / 3.0;

impl Running {
    /// One cycle of whatever is being done.
    pub(super) fn activity_cycle(&mut self, desk: &mut Desk<'_>) -> Verdict {
        if self.close(desk) {
            return Verdict::GoOn;
        }
        match &mut self.activity {
            Activity::Settle { until, look } => {
                if desk.now >= *until {
                    let look = look.clone();
                    self.begin_look(look, desk);
                } else {
                    self.stop(desk);
                }
            }
            Activity::Sweep => self.stop(desk),
            Activity::SignTest(_) => self.sign_test_cycle(desk),
            Activity::Drive(drive) => {
                let drive = *drive;
                self.drive_cycle(drive, desk);
            }
            Activity::Recover { .. } => self.recover_cycle(desk),
            Activity::Rest { until } => {
                let over = desk.now >= *until;
                self.stop(desk);
                if over {
                    return self.choose(desk);
                }
            }
            Activity::Stand => {
                self.stop(desk);
                if self.mode != Mode::Teleop {
                    if self.may_explore(desk.config) {
                        return self.choose(desk);
                    }
                    self.try_tilt_again(desk);
                }
            }
        }
        Verdict::GoOn
    }

    /// Whether the robot may drive on its own: it can see edges, for which the tilt must turn, or the
    /// floor was vouched for.
    pub(super) fn may_explore(&self, config: &AgentConfig) -> bool {
        let stuck = self.acquisition.as_ref().is_some_and(Acquisition::is_stuck);
        (self.sees_edges() && !stuck)
            || (config.belief.terrain.flat_floor && self.belief.flat_lines() >= PLANAR_LINES)
    }

    /// A robot that stands because its tilt shows no ground ahead sweeps again now and then: what held the
    /// tilt may be over, and nothing else would find out.
    fn try_tilt_again(&mut self, desk: &mut Desk<'_>) {
        if !self.acquisition.as_ref().is_some_and(Acquisition::tries_again) {
            return;
        }
        if let Some(request) = self.taken(Profile::coarse(TRIED_AGAIN_DEG), desk.config) {
            desk.info("the tilt is tried once more");
            self.settle(Look::Sweep(request), desk);
        }
    }

    /// Stands still, then looks.
    pub(super) fn settle(&mut self, look: Look, desk: &mut Desk<'_>) {
        self.stop(desk);
        let until = desk.now + Span::from_seconds(desk.config.mission.settle_s);
        self.activity = Activity::Settle { until, look };
    }

    fn begin_look(&mut self, look: Look, desk: &mut Desk<'_>) {
        if look == Look::SignTest {
            return self.begin_sign_test(desk);
        }
        let Some(acquisition) = &mut self.acquisition else {
            self.activity = Activity::Stand;
            return;
        };
        self.activity = Activity::Sweep;
        let actions = match look {
            Look::SignTest => return,
            Look::Calibrate => acquisition.calibrate(desk.now),
            Look::Sweep(request) => acquisition.start(request, desk.now),
        };
        self.head_actions(actions, desk);
    }

    /// The ground fan where the robot stands.
    pub(super) fn fan(&self, config: &AgentConfig) -> Option<SweepRequest> {
        let acquisition = self.acquisition.as_ref()?;
        let fan = Profile::ground_fan(&self.rig.ground_view()?, &acquisition.config().fan);
        self.taken(fan, config)
    }

    /// After a look: the next one that is due, else a choice at the next cycle.
    pub(super) fn next_look_or_choose(&mut self, desk: &mut Desk<'_>) {
        match self.queue.pop_front() {
            Some(look) => self.settle(look, desk),
            None if self.mode == Mode::Teleop => self.activity = Activity::Stand,
            None => self.activity = Activity::Rest { until: desk.now },
        }
    }

    /// What driving costs where, places that the hull did not get past lately made dear.
    pub(super) fn costs(&mut self, desk: &Desk<'_>) -> CostMap {
        let mut costs = CostMap::new(&self.grid, &self.shape, &desk.config.plan);
        self.shunned.retain(|(_, until)| *until > desk.now);
        for (cell, _) in &self.shunned {
            costs.shun(*cell, self.shape.circumscribed_radius_m() + 0.1);
        }
        costs
    }

    /// Chooses where to look next and sets out, or says that nothing is left.
    fn choose(&mut self, desk: &mut Desk<'_>) -> Verdict {
        if let Some(until) = desk.end.filter(|_| self.closing == Closing::Over) {
            self.activity = Activity::Rest { until };
            return Verdict::GoOn;
        }
        if !self.may_explore(desk.config) {
            self.stop(desk);
            self.activity = Activity::Stand;
            return Verdict::GoOn;
        }
        self.refresh_grid(desk.now);
        if self.look_around(desk) {
            return Verdict::GoOn;
        }
        let costs = self.costs(desk);
        let pose = self.pose2();
        self.explorer.limit_time(desk.end.map(|end| (end - desk.now).seconds()));
        for _ in 0..TRIES {
            let decision = self.explorer.choose(
                &self.grid,
                &costs,
                &self.shape,
                &mut self.planner,
                &pose,
                desk.now,
            );
            let choice = match decision {
                Decision::Go(choice) => choice,
                Decision::NothingLeft { frontiers_left, retry_at } => {
                    self.frontiers_left = Some(frontiers_left);
                    return self.nothing_left(retry_at, desk);
                }
            };
            self.frontiers_left = None;
            // Kept on its own disc: there may be ground ahead that only the blind gap cuts off.
            let stays = choice.way_m < STAYS_M;
            if stays && self.bridge_blind_ring(desk) {
                self.explorer.reached();
                self.activity = Activity::Rest { until: desk.now };
                return Verdict::GoOn;
            }
            match self.planner.plan(&self.grid, &costs, &pose, choice.cell) {
                Ok(path) => {
                    desk.info(format!(
                        "going to ({:.1}, {:.1}), {:.1} m: {}",
                        choice.goal.x_m,
                        choice.goal.y_m,
                        path.length_m(),
                        choice.reasons.join("; ")
                    ));
                    let path = path.with_goal_yaw(choice.goal.yaw_rad);
                    let path_m = path.length_m();
                    self.pilot.set_path(path);
                    self.park(desk);
                    self.resorts = 0;
                    self.activity = Activity::Drive(Drive { since: desk.now, path_m, replans: 0 });
                    return Verdict::GoOn;
                }
                Err(error) => self.explorer.give_up(&error.to_string(), desk.now),
            }
        }
        self.activity = Activity::Rest { until: desk.now + REST };
        Verdict::GoOn
    }

    /// Nothing is worth a sweep: first the gap about the start, then a finer look, then a second try
    /// of what failed; then the mission is done.
    fn nothing_left(&mut self, retry_at: Option<Arrival>, desk: &mut Desk<'_>) -> Verdict {
        if let Some(until) = desk.end.filter(|end| *end - desk.now < TOO_LATE) {
            desk.info("no place is left at which a sweep would be over in time: staying here");
            self.activity = Activity::Rest { until };
            return Verdict::GoOn;
        }
        if self.bridge_blind_ring(desk) {
            self.activity = Activity::Rest { until: desk.now };
            return Verdict::GoOn;
        }
        if self.acquisition.is_some() && self.last_resort(desk) {
            return Verdict::GoOn;
        }
        if let Some(at) = retry_at {
            desk.info(format!("nothing to go to: waiting until {at} to try again what failed"));
            self.activity = Activity::Rest { until: at };
            return Verdict::GoOn;
        }
        let hangs = self.hangs();
        if hangs || self.is_cut_off() {
            let what = if hangs { "a wheel hangs somewhere" } else { "cut off from where it came" };
            desk.warn(format!("{what}: trying to get back"));
            self.resorts = BACK_OUT;
            self.activity = Activity::Rest { until: desk.now + CUT_OFF };
            return Verdict::GoOn;
        }
        let left = self.frontiers_left.as_ref().map_or(0, Vec::len);
        desk.info(format!("nothing left to explore, {left} frontiers stay"));
        Verdict::Explored
    }

    /// Whether the body leans as no ground that is driven on for long does: a wheel has gone down beside a
    /// plate or up on something, and what looks unreachable from there is not.
    fn hangs(&self) -> bool {
        self.lean_rad() > HANGING_RAD
    }

    /// The greater of roll and pitch, as far as anything tells them.
    fn lean_rad(&self) -> f64 {
        let attitude = self.belief.attitude().unwrap_or_default();
        attitude.roll_rad.abs().max(attitude.pitch_rad.abs())
    }

    /// Whether most of the ground that the robot drove over on its level can no longer be reached: it
    /// came from there, so something in the map or in its own place is wrong, and nothing is explored.
    fn is_cut_off(&self) -> bool {
        let pose = self.pose2();
        let driven: Vec<bool> = self
            .pilot
            .track()
            .iter()
            .filter(|crumb| crumb.distance_m(&pose.point()) > CUT_OFF_FROM_M)
            .map(|crumb| self.grid.get(self.grid.cell_of(crumb.x_m, crumb.y_m)))
            .filter(|cell| cell.class != CellClass::OtherLevel)
            .map(|cell| cell.reachable)
            .collect();
        let lost = driven.iter().filter(|reachable| !**reachable).count();
        2 * lost > driven.len()
    }

    /// Before the first way the robot looks to its other sides. A way ends where other walls are in
    /// sight than ahead of its beginning, and only what was seen from the beginning tells by how much
    /// the wheels were wrong. Returns whether it turns.
    fn look_around(&mut self, desk: &mut Desk<'_>) -> bool {
        if self.acquisition.is_none() || self.looks_around >= LOOKS_AROUND {
            return false;
        }
        self.looks_around += if self.belief.knows_turns() { 2 } else { 1 };
        self.belief.path_m() < START_M && self.turn_to_look("before setting out", desk)
    }

    /// Turns by a third to look there; false where there is no room. By half of that while nobody knows how much of
    /// their turns its wheels make: what is seen then is still known from before, and tells.
    fn turn_to_look(&mut self, why: &str, desk: &mut Desk<'_>) -> bool {
        let costs = self.costs(desk);
        let pose = self.pose2();
        let cell = self.grid.cell_of(pose.x_m, pose.y_m);
        let Ok(path) = self.planner.plan(&self.grid, &costs, &pose, cell) else { return false };
        desk.info(format!("{why}: turning to look the other ways"));
        let turn_rad = if self.belief.knows_turns() { 1.0 } else { 0.5 } * THIRD_OF_A_TURN;
        self.pilot.set_path(path.with_goal_yaw(wrap_pi(pose.yaw_rad + turn_rad)));
        self.park(desk);
        self.activity = Activity::Drive(Drive { since: desk.now, path_m: 0.0, replans: REPLANS });
        true
    }

    /// What is tried before a place is left for explored: another look, looks to both other sides, and a
    /// look from farther back on the own track. False once all was tried.
    fn last_resort(&mut self, desk: &mut Desk<'_>) -> bool {
        let resort = self.resorts;
        self.resorts += 1;
        let pose = self.pose2();
        match resort {
            0 => {
                desk.info("nothing to go to: looking once more from here");
                self.look_here(desk);
            }
            1 | 2 => {
                if !self.turn_to_look("nothing to go to", desk) {
                    return self.last_resort(desk);
                }
            }
            BACK_OUT => {
                desk.info("nothing to go to: backing out to look from farther away");
                let trouble = Trouble::Stuck { commanded: 0.0, moved: 0.0 };
                let recovery = self.pilot.recover(desk.config, &trouble, &pose, desk.now);
                self.activity = Activity::Recover { recovery: Box::new(recovery), gave_up: 0 };
            }
            _ => return false,
        }
        true
    }

    fn drive_cycle(&mut self, drive: Drive, desk: &mut Desk<'_>) {
        if desk.now - drive.since > Span::from_seconds(desk.config.mission.goal_timeout_s) {
            self.explorer.give_up("it took too long", desk.now);
            desk.warn("the goal took too long; choosing another");
            return self.look_here(desk);
        }
        if self.acquisition.is_some() && self.belief.leg_m() > desk.config.mission.leg_m {
            desk.info("far from the last sweep: taking one on the way");
            return self.look_here(desk);
        }
        self.heed_latency(desk);
        self.renew_grid(desk);
        let parked = self.parked(desk.now);
        match parked {
            ParkState::NotParked => self.park(desk),
            _ if self.looks_level => {}
            parked => self.consider_nod(parked, desk),
        }
        let parked = self.parked(desk.now);
        let pose = self.pose2();
        let (command, progress) = self.pilot.follow(&pose, &self.grid, parked, desk.now);
        match progress {
            Progress::Going => {
                let command = self.held_level_for(command, desk);
                self.drive(command, desk);
            }
            Progress::Reached => {
                self.explorer.reached();
                self.give_ups = 0;
                self.look_here(desk);
            }
            Progress::Surprised(verdict) => {
                desk.info(format!("guard line: {verdict}; looking again"));
                self.explorer.give_up("the guard line saw what the map does not hold", desk.now);
                // Looks from one place that do not settle it lead nowhere.
                self.give_ups =
                    if self.belief.leg_m() > MOVED_ON_M { 0 } else { self.give_ups + 1 };
                if self.give_ups > WEDGED {
                    self.get_out(desk);
                } else {
                    self.look_here(desk);
                }
            }
            Progress::Blocked(reason) => {
                self.stop(desk);
                if let Some(conflict) = reason.conflict() {
                    self.shunned.push((conflict.cell, desk.now + SHUNNED));
                }
                self.replan(drive, &reason.to_string(), desk);
            }
        }
    }

    /// Stops and sweeps where the robot stands.
    pub(super) fn look_here(&mut self, desk: &mut Desk<'_>) {
        self.end_nod("the robot stops to look", desk);
        match self.best_look(desk.config) {
            Some(offer) => {
                if self.closes_before(offer.seconds, desk) {
                    return;
                }
                desk.info(format!("looking: {}", offer.reason));
                self.settle_calibrated(Look::Sweep(offer.request), desk);
            }
            None => {
                // A fixed laser looks all the time: what it shows from here is in the grid already.
                self.stop(desk);
                self.refresh_grid(desk.now);
                let pose = self.pose2();
                self.explorer.swept(&self.grid, &pose, std::f64::consts::PI, 1.0);
                self.activity = Activity::Rest { until: desk.now + REST };
            }
        }
    }

    /// The path is blocked: another to the same goal, or another goal.
    fn replan(&mut self, drive: Drive, reason: &str, desk: &mut Desk<'_>) {
        self.refresh_grid(desk.now);
        let costs = self.costs(desk);
        let goal = self.explorer.current().map(|choice| (choice.goal, choice.cell));
        let path = goal.filter(|_| drive.replans < REPLANS).and_then(|(goal, cell)| {
            let path = self.planner.plan(&self.grid, &costs, &self.pose2(), cell).ok()?;
            Some(path.with_goal_yaw(goal.yaw_rad))
        });
        if let Some(path) = path {
            self.pilot.set_path(path);
            self.activity = Activity::Drive(Drive { replans: drive.replans + 1, ..drive });
            return;
        }
        desk.info(format!("goal given up: {reason}"));
        self.explorer.give_up(reason, desk.now);
        self.give_ups += 1;
        if self.belief.leg_m() > MOVED_ON_M {
            // Having moved, a fresh look is worth its time.
            self.give_ups = 0;
            self.look_here(desk);
        } else if self.give_ups >= WEDGED {
            self.get_out(desk);
        } else {
            self.activity = Activity::Rest { until: desk.now };
        }
    }

    /// Nothing leads away from here: the map is drawn anew if that changes it, else the robot backs out.
    fn get_out(&mut self, desk: &mut Desk<'_>) {
        self.give_ups = 0;
        if self.assume_turning_room(desk) {
            self.activity = Activity::Rest { until: desk.now };
            return;
        }
        if self.belief.mend() {
            desk.info("wedged in: the map is drawn anew from where its sweeps are believed now");
            self.activity = Activity::Rest { until: desk.now };
            return;
        }
        desk.warn("wedged in: backing out over the own track");
        let trouble = Trouble::Stuck { commanded: 0.0, moved: 0.0 };
        self.ledger.troubles += 1;
        let pose = self.pose2();
        let recovery = self.pilot.recover(desk.config, &trouble, &pose, desk.now);
        self.activity = Activity::Recover { recovery: Box::new(recovery), gave_up: 0 };
    }

    fn recover_cycle(&mut self, desk: &mut Desk<'_>) {
        if self.looks_level {
            self.park(desk);
        }
        let (pose, lean_rad) = (self.pose2(), self.lean_rad());
        self.renew_grid(desk);
        let Activity::Recover { recovery, gave_up } = &mut self.activity else { return };
        match self.pilot.recovery_step(recovery, &pose, lean_rad, &self.grid, desk.now) {
            RecoveryStep::Try(_, command) => self.drive(command, desk),
            RecoveryStep::Recovered => {
                desk.info("free again");
                self.drive(DriveCommand::STOP, desk);
                self.look_here(desk);
            }
            RecoveryStep::GaveUp => {
                *gave_up += 1;
                desk.warn("could not get free; standing still before the next try");
                self.drive(DriveCommand::STOP, desk);
                self.activity = Activity::Rest { until: desk.now + Span::from_millis(10_000) };
            }
        }
    }
}
