//! Sweeps in which the tilt never stops: motion and laser overlap, and each line is filed under the
//! tilt it was taken at.

mod closing;
mod progress;
mod spending;

use super::config::AcquisitionConfig;
use super::control::{Disorder, HeadControl};
use super::dated::Taken;
use super::profile::QuarterDegrees;
use super::ramp::Ramp;
use super::scan::{Scan, TimeBudget};
use super::way::Way;
use super::{HeadAction, HeadEvent};
use crate::robot::Demand;
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};

/// How the tilt is driven along.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FlowDrive {
    /// By set-points on the grid of quarter degrees, one for each line, so far ahead of the tilt that
    /// the servo carries it on to the profile's next row.
    SetPoints,
    /// At a constant rate in radians per second (paper, section VI: 0.05). Once in `cycle_s` seconds
    /// the next line is kept; with 0 every line is.
    Rate {
        /// Radians per second, above 0.
        rate_rad_s: f64,
        /// Seconds between rows.
        cycle_s: f64,
    },
    /// The same where the server knows no rates: by a set-point that runs along at that rate.
    Ramp {
        /// Radians per second, above 0.
        rate_rad_s: f64,
        /// Seconds between rows.
        cycle_s: f64,
    },
}

/// A sweep in one continuous motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flow {
    way: Way,
    pan_rad: f64,
    /// Whether the body drives meanwhile, so that rows are displaced as it moved.
    driving: bool,
    stage: Stage,
    taken: Vec<Taken>,
    demanded: QuarterDegrees,
    /// The set-point under way, where the drive is a ramp.
    ramp: Option<Ramp>,
    started: Arrival,
    deadline: Arrival,
    repeats: usize,
    /// Casting of the first line since the tilt last came on by half a row.
    idle_since: Option<Stamp>,
    /// From when on the command is in force that sent the tilt on its way to the first row.
    sent_off: Option<Stamp>,
    /// How late the latest of the readings came.
    readings_late: Span,
    disorder_before: Disorder,
    furthest_rad: f64,
    /// How near the tilt has come to the first row on the way there, in radians.
    nearest_rad: Option<f64>,
    /// How long the laser has been silent, in seconds, where that ended the sweep.
    silent_s: Option<f64>,
    budget: TimeBudget,
    last_event: Arrival,
    remarks: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Stage {
    /// Nothing can be timed before the server's clock is known.
    NeedsClock,
    /// On the way to the first row.
    Approaching,
    /// Rows are taken.
    Flowing,
    /// All rows are taken; the last reading that dates them is waited for.
    Closing,
    Finished,
}

/// Messages that come late for longer than this will not be in time again before the sweep is over.
const LATE_FOR: Span = Span::from_millis(2_000);

impl Flow {
    /// A sweep over `profile`, already clipped and turned the way it is to run; its first actions.
    pub(super) fn start(
        way: Way,
        pan_rad: f64,
        driving: bool,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> (Self, Vec<HeadAction>) {
        let first = way.profile.tilts.first().copied().unwrap_or_default();
        let mut flow = Self {
            demanded: first,
            furthest_rad: first.radians(),
            nearest_rad: None,
            silent_s: None,
            way,
            pan_rad,
            driving,
            stage: Stage::NeedsClock,
            taken: Vec::new(),
            ramp: None,
            started: now,
            deadline: now + config.row_timeout(),
            repeats: 0,
            idle_since: None,
            sent_off: None,
            readings_late: Span::ZERO,
            disorder_before: control.disorder(),
            budget: TimeBudget::default(),
            last_event: now,
            remarks: Vec::new(),
        };
        let mut actions = Vec::new();
        if flow.way.profile.is_empty() {
            flow.remarks.push("no row of the profile can be reached".to_owned());
            flow.finish(control, now, &mut actions);
        } else if control.clock().latest().is_some() {
            flow.approach(control, config, now, &mut actions);
        }
        (flow, actions)
    }

    /// Whether the body drives meanwhile.
    pub(super) fn is_driving(&self) -> bool {
        self.driving
    }

    /// Adds a line for the operator to the scan's remarks.
    pub(super) fn remark(&mut self, text: String) {
        self.remarks.push(text);
    }

    /// Whether all is done.
    pub fn is_finished(&self) -> bool {
        self.stage == Stage::Finished
    }

    /// Rows taken so far, and rows in all as far as they can be told before.
    pub fn progress(&self) -> (usize, usize) {
        (self.taken.len(), self.way.profile.len().max(self.taken.len()))
    }

    /// When the sweep must be called again even if nothing arrives.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        let ramp_at = self.ramp.as_ref().map(Ramp::next_at);
        (!self.is_finished()).then(|| ramp_at.map_or(self.deadline, |at| at.min(self.deadline)))
    }

    /// Ends the sweep where it stands and hands over what there is.
    pub fn stop(&mut self, why: &str, control: &HeadControl, now: Arrival) -> Option<Scan> {
        if self.is_finished() {
            return None;
        }
        self.spend(control, now);
        self.remarks.push(why.to_owned());
        let mut actions = Vec::new();
        self.finish(control, now, &mut actions);
        actions.into_iter().find_map(|action| match action {
            HeadAction::Finished(scan) => Some(*scan),
            _ => None,
        })
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
        self.spend(control, now);
        if matches!(event, HeadEvent::Joints(_)) {
            self.readings_late = self.readings_late.max(control.readings_late());
        }
        if jumped && !self.is_finished() {
            // Lines before the jump are dated by what was known before it, and no others.
            self.remarks.push("the server's clock jumped: the sweep ends there".to_owned());
            let before = control.before_jump();
            self.finish(before.as_ref().unwrap_or(control), now, &mut actions);
            return actions;
        }
        match (self.stage, event) {
            (Stage::NeedsClock, _) if control.clock().latest().is_some() => {
                self.approach(control, config, now, &mut actions);
            }
            (Stage::Approaching | Stage::Flowing | Stage::Closing, HeadEvent::Line(line))
                if self.take_straggler(line, control) => {}
            (Stage::Approaching | Stage::Flowing, HeadEvent::Line(line)) => {
                self.on_line(line, control, config, now, &mut actions);
            }
            (Stage::Closing, _) if !self.awaits_messages(control) => {
                self.finish_closed(control, now, &mut actions);
            }
            _ => {}
        }
        self.run_ramp(control, now, &mut actions);
        if now >= self.deadline && !self.is_finished() {
            self.on_deadline(control, config, now, &mut actions);
        }
        actions
    }

    /// Takes a line older than the newest one taken to its place among them; false for any other.
    /// It says nothing about where the tilt is by now.
    fn take_straggler(&mut self, line: &LaserLine, control: &HeadControl) -> bool {
        let at = self.taken.partition_point(|taken| taken.line.stamp < line.stamp);
        let Some(after) = self.taken.get(at) else { return false };
        // From before the first row, or a second copy.
        let foreign = at == 0 || after.line.stamp == line.stamp;
        if !foreign && control.rhythm.is_whole(line) {
            let demanded = after.demanded;
            self.taken.insert(at, Taken { line: line.clone(), demanded, overtaken: true });
        }
        true
    }

    fn run_ramp(&mut self, control: &mut HeadControl, now: Arrival, actions: &mut Vec<HeadAction>) {
        let due = self.ramp.as_mut().and_then(|ramp| ramp.due(control, now));
        if let Some(angle_rad) = due {
            self.demanded = QuarterDegrees::nearest(angle_rad);
            let command = control.command_tilt(Demand::Angle(angle_rad), now);
            actions.push(HeadAction::Send(command));
        }
    }

    fn approach(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        self.stage = Stage::Approaching;
        if control.head().pan().is_some() {
            let pan = Demand::Angle(self.pan_rad);
            actions.push(HeadAction::Send(control.command_pan(pan, now)));
        }
        let target = Demand::Angle(self.demanded.radians());
        actions.push(HeadAction::Send(control.command_tilt(target, now)));
        self.sent_off = control.tilt.commands().last().map(|&(stamp, _)| stamp);
        self.deadline = now + self.patience(control, config);
    }

    /// Time after which a line is overdue.
    fn patience(&self, control: &HeadControl, config: &AcquisitionConfig) -> Span {
        let lines = Span::from_seconds(3.0 * control.rhythm.interval().seconds());
        control.clock().arrival_span(lines) + config.row_timeout()
    }

    fn on_line(
        &mut self,
        line: &LaserLine,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        if !control.rhythm.is_whole(line) {
            return;
        }
        if let Some(unmoved) = control.unmoved() {
            return self.on_unmoved(&unmoved, control, now, actions);
        }
        let cast = control.cast_time(line);
        if control.sure_until().is_some() && control.clock().late_for(now) > LATE_FOR {
            // When commands are obeyed is no longer known, and nothing else tells the tilt.
            self.remarks
                .push("the line to the server became slower: the sweep ends there".to_owned());
            return self.finish(control, now, actions);
        }
        let Some(here) = control.tilt.estimate(cast) else {
            self.remarks.push("the tilt's law is unknown and it sends no readings".to_owned());
            self.finish(control, now, actions);
            return;
        };
        self.deadline = now + self.patience(control, config);
        let (first, last) = self.way.ends();
        let direction = self.way.direction();
        let step = self.way.step_at(here.angle_rad, control, config);
        if self.stage == Stage::Approaching {
            if control.unsure_until().is_some_and(|until| control.cast_time(line) < until) {
                return;
            }
            let off = (here.angle_rad - first).abs();
            if off > 0.5 * step && (here.angle_rad - first) * direction < 0.0 || off > 1.5 * step {
                // Readings late or out of order make the tilt seem to go to and fro.
                let came_on = self.nearest_rad.is_none_or(|nearest| off < nearest - 1e-3);
                if came_on {
                    self.nearest_rad = Some(off);
                }
                self.note_progress(came_on, here.angle_rad, line, control, now);
                let rests = self.rests(line, control);
                if !rests || (last - here.angle_rad) * direction <= 1.5 * step {
                    self.end_if_stuck(line, control, now, actions);
                    return;
                }
                // Limits narrower than told, or a joint that sticks at this end: what lies between
                // here and the other end can still be taken.
                self.remarks.push(format!(
                    "the tilt rests at {:.2}° though {} was demanded: the sweep begins there",
                    self.rests_at_rad(control).to_degrees(),
                    self.demanded
                ));
                let rest_rad = self.rests_at_rad(control);
                control.rests_at(rest_rad, self.demanded.radians() - rest_rad);
                self.stay_at(here.angle_rad, control, now, actions);
            }
            self.begin_flowing(here.angle_rad, control, now, actions);
        }
        self.taken.push(Taken { line: line.clone(), demanded: self.demanded, overtaken: false });
        let row = self.taken.len() - 1;
        actions.push(HeadAction::Filed { row, tilt: self.demanded });
        // The law runs on from the newest reading and may believe what a later one refutes.
        let read = control.tilt.last_reading().filter(|_| control.reads_at(cast));
        let seen_rad = read.map_or(here.angle_rad, |reading| reading.angle_rad);
        let came_on = (seen_rad - self.furthest_rad) * direction;
        self.note_progress(came_on > 0.4 * step, seen_rad, line, control, now);
        if (last - here.angle_rad) * direction <= 0.5 * step {
            self.close(control, now, actions);
        } else if !self.end_if_stuck(line, control, now, actions)
            && self.way.drive == FlowDrive::SetPoints
            && let Some(next) = self.way.next_set_point(line, self.demanded, control, config, now)
        {
            self.demanded = next;
            let demand = Demand::Angle(next.radians());
            actions.push(HeadAction::Send(control.command_tilt(demand, now)));
        }
    }

    fn begin_flowing(
        &mut self,
        from_rad: f64,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        self.stage = Stage::Flowing;
        self.furthest_rad = from_rad;
        self.idle_since = None;
        match self.way.drive {
            FlowDrive::SetPoints => {}
            FlowDrive::Rate { rate_rad_s, .. } => {
                let rate = Demand::Rate(self.way.direction() * rate_rad_s);
                actions.push(HeadAction::Send(control.command_tilt(rate, now)));
            }
            FlowDrive::Ramp { rate_rad_s, .. } => {
                let (first, last) = self.way.ends();
                // A set-point that began at a row out of reach would have to be waited for.
                let far = (from_rad - first).abs() > super::HINGE_GAP_RAD;
                let from_rad = if far { from_rad } else { first };
                self.ramp = Ramp::start((from_rad, last), rate_rad_s, control, now);
            }
        }
    }

    fn on_deadline(
        &mut self,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        match self.stage {
            Stage::NeedsClock => {
                self.remarks.push("no stamped message: the server's clock is unknown".to_owned());
                self.finish(control, now, actions);
            }
            Stage::Approaching | Stage::Flowing if self.repeats == 0 => {
                self.repeats += 1;
                let demand = match (self.stage, self.way.drive) {
                    (Stage::Flowing, FlowDrive::Rate { rate_rad_s, .. }) => {
                        Demand::Rate(self.way.direction() * rate_rad_s)
                    }
                    _ => Demand::Angle(self.demanded.radians()),
                };
                actions.push(HeadAction::Send(control.command_tilt(demand, now)));
                self.deadline = now + self.patience(control, config);
            }
            Stage::Approaching | Stage::Flowing => {
                let silent = control.rhythm.last_arrival().map_or(0.0, |at| (now - at).seconds());
                self.silent_s = Some(silent);
                self.finish(control, now, actions);
            }
            Stage::Closing => self.finish_closed(control, now, actions),
            Stage::Finished => {}
        }
    }
}
