//! Stop-scan-go: one sweep over a list of tilts, as a state machine.

mod readiness;
mod unreachable;

use super::config::AcquisitionConfig;
use super::control::{Disorder, HeadControl, Settle};
use super::profile::Profile;
use super::scan::{FiledRow, Scan, ScanErrors, TimeBudget, image_of};
use super::stillness::doubt_remark;
use super::{HeadAction, HeadEvent};
use crate::robot::{Demand, HeadPose};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use nalgebra::Isometry3;
use readiness::{Readiness, readiness};
use serde::{Deserialize, Serialize};

/// A sweep in which every line is taken with the tilt at rest at the demanded angle (paper, section
/// II): command, wait until the tilt is provably there, file the first line stamped after that.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    profile: Profile,
    pan_rad: f64,
    tolerance_rad: f64,
    step: Step,
    rows: Vec<FiledRow>,
    budget: TimeBudget,
    started: Arrival,
    /// When the row under way began; what came before is in the budget.
    row_began: Arrival,
    repeats: usize,
    unverified: usize,
    lost_in_a_row: u32,
    disorder_before: Disorder,
    remarks: Vec<String>,
}

/// Where a sweep stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Step {
    /// Nothing can be timed before the server's clock is known.
    NeedsClock { deadline: Arrival },
    /// A tilt was commanded and its line is waited for.
    Waiting(Waiting),
    /// All is done.
    Finished,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Waiting {
    row: usize,
    sent: Arrival,
    /// From this stamp on the command is in force.
    in_force: Stamp,
    /// From this stamp on the joint is at rest by computation; `None` where its law is unknown.
    settled: Option<Stamp>,
    slew_s: f64,
    deadline: Arrival,
    /// When a scanner that speaks only when asked is to be asked.
    ask_at: Option<Arrival>,
    asked: bool,
    repeated: bool,
    /// The last reading that contradicted the demand, if the newest one did.
    elsewhere: Option<f64>,
}

/// A joint slower than told is waited for while its readings show it moving, but no longer than this.
const LONGEST_MOVE: Span = Span::from_millis(60_000);

/// Stamps have two decimals, rounded (protocol 1.7): rays may be this much older than the stamp.
const STAMP_ROUNDING: Span = Span::from_millis(5);

/// A set-point is rounded to a whole Unreal unit by the server: one 65536th of a turn, evenly spread.
const SETPOINT_SIGMA_RAD: f64 = std::f64::consts::TAU / 65536.0 / 3.464_101_615_137_754_6;

impl Sweep {
    /// A sweep over `profile`, which is clipped to the link's limits and begun at the nearer end,
    /// with the pan at `pan_rad`; its first actions.
    pub fn start(
        profile: Profile,
        pan_rad: f64,
        tolerance_rad: f64,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> (Self, Vec<HeadAction>) {
        let mut sweep = Self {
            profile,
            pan_rad,
            tolerance_rad,
            step: Step::NeedsClock { deadline: now + config.row_timeout() },
            rows: Vec::new(),
            budget: TimeBudget::default(),
            started: now,
            row_began: now,
            repeats: 0,
            unverified: 0,
            lost_in_a_row: 0,
            disorder_before: control.disorder(),
            remarks: Vec::new(),
        };
        let mut actions = Vec::new();
        if sweep.profile.is_empty() {
            sweep.remarks.push("no row of the profile can be reached".to_owned());
            sweep.finish(control, now, &mut actions);
        } else if control.clock().latest().is_some() {
            sweep.command(0, false, control, config, now, &mut actions);
        }
        (sweep, actions)
    }

    /// Adds a line for the operator to the scan's remarks.
    pub(super) fn remark(&mut self, text: String) {
        self.remarks.push(text);
    }

    /// Takes an event that `control` has already noted; `jumped` if the server's clock did.
    pub fn handle(
        &mut self,
        event: &HeadEvent<'_>,
        jumped: bool,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> Vec<HeadAction> {
        let mut actions = Vec::new();
        if jumped {
            self.restart_row(control, config, now, &mut actions);
        }
        match &self.step {
            Step::NeedsClock { .. } if control.awaits_answer(now) => {}
            Step::NeedsClock { .. } if control.clock().latest().is_some() => {
                self.command(0, false, control, config, now, &mut actions);
            }
            Step::NeedsClock { deadline } if now >= *deadline => {
                self.remarks.push("no stamped message: the server's clock is unknown".to_owned());
                self.finish(control, now, &mut actions);
            }
            Step::Waiting(_) => {
                if let HeadEvent::Line(line) = event {
                    self.on_line(line, control, config, now, &mut actions);
                }
                self.on_time(control, config, now, &mut actions);
                self.ask(control, config, now, &mut actions);
            }
            Step::NeedsClock { .. } | Step::Finished => {}
        }
        actions
    }

    /// When the sweep must be called again even if nothing arrives.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        match &self.step {
            Step::NeedsClock { deadline } => Some(*deadline),
            Step::Waiting(waiting) => {
                Some(waiting.ask_at.map_or(waiting.deadline, |at| at.min(waiting.deadline)))
            }
            Step::Finished => None,
        }
    }

    /// Whether all is done.
    pub fn is_finished(&self) -> bool {
        self.step == Step::Finished
    }

    /// Rows dealt with, and rows in all.
    pub fn progress(&self) -> (usize, usize) {
        (self.rows.len(), self.profile.len())
    }

    /// Ends the sweep where it stands and hands over what there is.
    pub fn stop(&mut self, why: &str, control: &HeadControl, now: Arrival) -> Option<Scan> {
        if self.is_finished() {
            return None;
        }
        self.remarks.push(why.to_owned());
        let mut actions = Vec::new();
        self.finish(control, now, &mut actions);
        actions.into_iter().find_map(|action| match action {
            HeadAction::Finished(scan) => Some(*scan),
            _ => None,
        })
    }

    fn command(
        &mut self,
        row: usize,
        repeated: bool,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Some(in_force) = control.in_force(now) else {
            self.step = Step::NeedsClock { deadline: now + config.row_timeout() };
            return;
        };
        let target = self.profile.tilts[row].radians();
        if !repeated {
            self.book_idle(now);
        }
        let mut settle = control.tilt_settles(target, self.tolerance_rad, in_force);
        let pan_waits = control.pan.target_rad() != Some(self.pan_rad) || row == 0 || repeated;
        if control.head().pan().is_some() && pan_waits {
            let pan = control.pan_settles(self.pan_rad, self.tolerance_rad, in_force);
            settle = settle.zip(pan).map(|(a, b)| if a.total_s >= b.total_s { a } else { b });
            actions.push(HeadAction::Send(control.command_pan(Demand::Angle(self.pan_rad), now)));
        }
        let command = control.command_tilt(Demand::Angle(target), now);
        actions.push(HeadAction::Send(command));
        let unknown = Settle { slew_s: 0.0, total_s: config.unknown_settle_s };
        let expected = Span::from_seconds(settle.unwrap_or(unknown).total_s);
        let lines =
            Span::from_seconds(4.0 * control.rhythm.interval().seconds()) + control.slower_by();
        let on_its_way = control.clock().earliest(now).map_or(Span::ZERO, |sent| in_force - sent);
        self.step = Step::Waiting(Waiting {
            row,
            sent: now,
            in_force,
            settled: settle.map(|_| in_force + expected),
            slew_s: settle.unwrap_or(unknown).slew_s,
            deadline: now
                + control.clock().arrival_span(on_its_way + expected + lines)
                + config.row_timeout(),
            ask_at: control.must_ask().then(|| now + control.clock().arrival_span(expected)),
            asked: false,
            repeated,
            elsewhere: None,
        });
    }

    fn restart_row(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        if let Step::Waiting(waiting) = &self.step {
            let row = waiting.row;
            self.remarks.push("the server's clock jumped: the row was begun anew".to_owned());
            self.command(row, true, control, config, now, actions);
        }
    }

    fn on_line(
        &mut self,
        line: &LaserLine,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Step::Waiting(waiting) = &mut self.step else { return };
        if !control.rhythm.is_whole(line) {
            return;
        }
        if let Some(unmoved) = control.unmoved() {
            return self.on_unmoved(&unmoved, control, now, actions);
        }
        let target = self.profile.tilts[waiting.row].radians();
        let cast = line.stamp - STAMP_ROUNDING;
        let ready = readiness(waiting, target, self.tolerance_rad, cast, control, config);
        waiting.elsewhere = match ready {
            Readiness::Elsewhere(angle_rad) => Some(angle_rad),
            Readiness::Verified | Readiness::Computed | Readiness::NotYet => None,
        };
        match ready {
            Readiness::NotYet | Readiness::Elsewhere(_) => return,
            Readiness::Verified => {}
            Readiness::Computed => {
                // Only a rig that does report is remarkable for not having reported this row.
                self.unverified += usize::from(control.tilt.last_reading().is_some());
            }
        }
        let (row, slew_s) = (waiting.row, waiting.slew_s);
        let in_force = waiting.in_force;
        let settle_s =
            waiting.settled.map_or(config.unknown_settle_s, |s| (s - in_force).seconds());
        let sent = waiting.sent;
        self.budget.idle_s += (sent - self.row_began).seconds();
        let scale = 1.0 / control.clock().rate();
        self.budget.add_row((now - sent).seconds(), slew_s * scale, settle_s * scale);
        self.row_began = now;
        self.lost_in_a_row = 0;
        self.file(row, Some(line.clone()));
        actions.push(HeadAction::Filed { row, tilt: self.profile.tilts[row] });
        self.next_row(row, control, config, now, actions);
    }

    fn on_time(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Step::Waiting(waiting) = &self.step else { return };
        if now < waiting.deadline {
            return;
        }
        let row = waiting.row;
        let patient = now - self.row_began < control.clock().arrival_span(LONGEST_MOVE);
        if waiting.elsewhere.is_some() && patient && control.tilt.moves(control.clock().latest()) {
            self.extend_deadline(now + config.row_timeout());
            return;
        }
        if !waiting.repeated {
            self.repeats += 1;
            self.command(row, true, control, config, now, actions);
            return;
        }
        let elsewhere = waiting.elsewhere;
        self.book_idle(now);
        self.file(row, None);
        self.lost_in_a_row += 1;
        let silent = control.rhythm.last_arrival().is_none_or(|at| {
            now - at
                > control.clock().arrival_span(control.rhythm.interval()) + config.row_timeout()
        });
        match elsewhere {
            Some(stuck_rad) => {
                self.skip_unreachable(row, stuck_rad);
                let demanded = self.profile.tilts[row].radians();
                control.rests_at(stuck_rad, demanded - stuck_rad);
            }
            None if silent && self.lost_in_a_row >= config.give_up_rows => {
                let last = control.rhythm.last_arrival().unwrap_or(self.started);
                self.remarks.push(format!(
                    "the laser has been silent for {:.1} s: {} of {} rows taken",
                    (now - last).seconds(),
                    self.filed(),
                    self.profile.len()
                ));
                self.finish(control, now, actions);
                return;
            }
            None if self.lost_in_a_row >= config.give_up_rows => {
                self.remarks.push(format!(
                    "{} rows in a row had no usable line: {} of {} rows taken",
                    self.lost_in_a_row,
                    self.filed(),
                    self.profile.len()
                ));
                self.finish(control, now, actions);
                return;
            }
            None => {}
        }
        self.next_row(row, control, config, now, actions);
    }

    /// Asks a scanner that speaks only when asked for a line, once the tilt rests: the server is at
    /// least as late as its clock's lower bound, so that the rays are cast after that.
    fn ask(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Step::Waiting(waiting) = &mut self.step else { return };
        if waiting.ask_at.is_none_or(|at| now < at) {
            return;
        }
        let patience = Span::from_seconds(config.unknown_settle_s);
        let rests = waiting.settled.unwrap_or(waiting.in_force + patience) + STAMP_ROUNDING;
        let wait = control.clock().earliest(now).map_or(Span::ZERO, |server| rests - server);
        waiting.ask_at = Some(if wait > Span::ZERO {
            now + control.clock().arrival_span(wait).max(Span::from_millis(2))
        } else if let Some(at) = control.may_ask_at().filter(|&at| at > now && waiting.asked) {
            at
        } else {
            waiting.asked = true;
            control.ask(now);
            actions.push(HeadAction::Ask);
            control.may_ask_at().unwrap_or(waiting.deadline)
        });
    }

    fn extend_deadline(&mut self, deadline: Arrival) {
        if let Step::Waiting(waiting) = &mut self.step {
            waiting.deadline = deadline;
        }
    }

    fn next_row(
        &mut self,
        row: usize,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        if row + 1 < self.profile.len() {
            self.command(row + 1, false, control, config, now, actions);
        } else {
            self.finish(control, now, actions);
        }
    }

    fn file(&mut self, row: usize, line: Option<LaserLine>) {
        let demanded = self.profile.tilts[row];
        self.rows.push(FiledRow {
            demanded,
            pose: HeadPose { pan_rad: self.pan_rad, tilt_rad: demanded.radians() },
            tilt_sigma_rad: (0.5 * self.tolerance_rad).hypot(SETPOINT_SIGMA_RAD),
            reference_from_robot: Isometry3::identity(),
            line,
        });
    }

    /// Books the time since the last row, which no row came of.
    fn book_idle(&mut self, now: Arrival) {
        self.budget.idle_s += (now - self.row_began).seconds();
        self.row_began = now;
    }

    fn filed(&self) -> usize {
        self.rows.iter().filter(|row| row.line.is_some()).count()
    }

    fn finish(&mut self, control: &HeadControl, now: Arrival, actions: &mut Vec<HeadAction>) {
        self.step = Step::Finished;
        self.book_idle(now);
        let mut doubted = 0;
        for row in &mut self.rows {
            let cast = row.line.as_ref().map(|line| control.cast_time(line));
            if cast.is_some_and(|cast| control.doubts(cast)) {
                row.line = None;
                doubted += 1;
            }
        }
        self.remarks.extend(doubt_remark(doubted));
        let filed = self.filed();
        self.remarks.extend(control.disorder().remark_since(&self.disorder_before));
        self.remarks.extend(control.slowness_remark());
        if self.unverified > 0 {
            self.remarks.push(format!(
                "{} rows were filed on the computed waiting time: no reading of that time came",
                self.unverified
            ));
        }
        let gaps = self.rows.len() - filed;
        if gaps > 0 {
            self.remarks.push(format!("{gaps} rows are gaps"));
        }
        let image =
            image_of(&self.rows, &control.robot_from_scan(), |pose| control.scan_from_sensor(pose));
        actions.push(HeadAction::Finished(Box::new(Scan {
            image,
            profile: self.profile.name.clone(),
            complete: filed == self.rows.len() && filed == self.profile.len() && filed > 0,
            filed,
            gaps,
            repeats: self.repeats,
            unverified: self.unverified,
            errors: ScanErrors {
                tilt_common_rad: 0.5 * self.tolerance_rad,
                tilt_row_rad: SETPOINT_SIGMA_RAD,
                time_s: 0.0,
            },
            budget: self.budget,
            driven_m: None,
            started: self.started,
            ended: now,
            remarks: self.remarks.clone(),
        })));
        self.rows.clear();
    }
}
