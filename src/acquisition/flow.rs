//! Sweeps in which the tilt never stops: motion and laser overlap, and each line is filed under the
//! tilt it was taken at.

use super::config::AcquisitionConfig;
use super::control::{Disorder, HeadControl};
use super::dated::{Taken, dated_rows};
use super::profile::QuarterDegrees;
use super::ramp::Ramp;
use super::scan::{FiledRow, Scan, ScanErrors, TimeBudget, image_of};
use super::way::Way;
use super::{HeadAction, HeadEvent};
use crate::robot::Demand;
use crate::scan::LaserLine;
use crate::time::{Arrival, Span};
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
    /// Lines since the tilt last came on by half a row.
    idle_lines: u32,
    /// How late the latest of the readings came.
    readings_late: Span,
    disorder_before: Disorder,
    furthest_rad: f64,
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

/// Lines without progress after which the tilt is taken to be stuck.
const IDLE_LINES: u32 = 15;
/// Time given to a last reading, beyond what readings are late anyway.
const CLOSING: Span = Span::from_millis(450);
/// Readings later than this are not waited for.
const LATEST: Span = Span::from_millis(3_000);
/// Readings later than this are remarkable.
const LATE: Span = Span::from_millis(500);

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
            way,
            pan_rad,
            driving,
            stage: Stage::NeedsClock,
            taken: Vec::new(),
            ramp: None,
            started: now,
            deadline: now + config.row_timeout(),
            repeats: 0,
            idle_lines: 0,
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
            // Lines before the jump can no longer be dated against what the tilt does now.
            self.remarks.push("the server's clock jumped: the sweep ends there".to_owned());
            self.finish(control, now, &mut actions);
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
            (Stage::Closing, HeadEvent::Joints(_))
                if self.is_dated(control) && !self.awaits_stragglers(control) =>
            {
                self.finish(control, now, &mut actions);
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
            self.taken.insert(at, Taken { line: line.clone(), demanded });
        }
        true
    }

    /// Whether lines or readings have come out of order, so that some may still be under way.
    fn awaits_stragglers(&self, control: &HeadControl) -> bool {
        control.disorder().grew_since(&self.disorder_before)
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
        let Some(here) = control.tilt.estimate(control.cast_time(line)) else {
            self.remarks.push("the tilt's law is unknown and it sends no readings".to_owned());
            self.finish(control, now, actions);
            return;
        };
        self.deadline = now + self.patience(control, config);
        let (first, last) = self.way.ends();
        let direction = self.way.direction();
        let step = self.way.step_at(here.angle_rad, control, config);
        if self.stage == Stage::Approaching {
            let off = (here.angle_rad - first).abs();
            if off > 0.5 * step && (here.angle_rad - first) * direction < 0.0 || off > 1.5 * step {
                self.note_progress(
                    (here.angle_rad - self.furthest_rad).abs() > 1e-3,
                    here.angle_rad,
                );
                let rests = self.rests(control);
                if !rests || (last - here.angle_rad) * direction <= 1.5 * step {
                    self.end_if_stuck(control, now, actions);
                    return;
                }
                // Limits narrower than told, or a joint that sticks at this end: what lies between
                // here and the other end can still be taken.
                self.remarks.push(format!(
                    "the tilt rests at {:.2}° though {} was demanded: the sweep begins there",
                    self.rests_at_rad(control).to_degrees(),
                    self.demanded
                ));
                // Told to stay, so that the law does not carry it on towards what it cannot reach.
                self.demanded = QuarterDegrees::nearest(here.angle_rad);
                let stay = Demand::Angle(self.demanded.radians());
                actions.push(HeadAction::Send(control.command_tilt(stay, now)));
            }
            self.stage = Stage::Flowing;
            self.furthest_rad = here.angle_rad;
            self.idle_lines = 0;
            match self.way.drive {
                FlowDrive::SetPoints => {}
                FlowDrive::Rate { rate_rad_s, .. } => {
                    let rate = Demand::Rate(direction * rate_rad_s);
                    actions.push(HeadAction::Send(control.command_tilt(rate, now)));
                }
                FlowDrive::Ramp { rate_rad_s, .. } => {
                    self.ramp = Ramp::start((first, last), rate_rad_s, control, now);
                }
            }
        }
        self.taken.push(Taken { line: line.clone(), demanded: self.demanded });
        let row = self.taken.len() - 1;
        actions.push(HeadAction::Filed { row, tilt: self.demanded });
        let came_on = (here.angle_rad - self.furthest_rad) * direction;
        self.note_progress(came_on > 0.4 * step, here.angle_rad);
        if (last - here.angle_rad) * direction <= 0.5 * step {
            self.close(control, now, actions);
        } else if !self.end_if_stuck(control, now, actions)
            && self.way.drive == FlowDrive::SetPoints
            && let Some(next) = self.way.next_set_point(line, self.demanded, control, config, now)
        {
            self.demanded = next;
            let demand = Demand::Angle(next.radians());
            actions.push(HeadAction::Send(control.command_tilt(demand, now)));
        }
    }

    fn note_progress(&mut self, came_on: bool, tilt_rad: f64) {
        if came_on {
            self.furthest_rad = tilt_rad;
            self.idle_lines = 0;
        } else {
            self.idle_lines += 1;
        }
    }

    /// Whether the tilt has not come on for so many lines that it must be at rest.
    fn rests(&self, control: &HeadControl) -> bool {
        // A slow approach moves by little between lines; only readings can tell it from a stop.
        self.idle_lines >= IDLE_LINES && !control.tilt.moves(control.clock().latest())
    }

    /// Where a tilt rests that is not where it should be: as it reads itself, where it does.
    fn rests_at_rad(&self, control: &HeadControl) -> f64 {
        control.tilt.last_reading().map_or(self.furthest_rad, |reading| reading.angle_rad)
    }

    fn end_if_stuck(
        &mut self,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) -> bool {
        if !self.rests(control) {
            return false;
        }
        self.remarks.push(format!(
            "the tilt rests at {:.2}° though {} was demanded: the sweep ends there",
            self.rests_at_rad(control).to_degrees(),
            self.demanded
        ));
        self.finish(control, now, actions);
        true
    }

    fn close(&mut self, control: &mut HeadControl, now: Arrival, actions: &mut Vec<HeadAction>) {
        self.stage = Stage::Closing;
        self.ramp = None;
        if let FlowDrive::Rate { .. } = self.way.drive {
            actions.push(HeadAction::Send(control.command_tilt(Demand::Rate(0.0), now)));
        }
        // Without readings there is nothing to wait for.
        let reads = control.tilt.last_reading().is_some();
        let awaits = self.awaits_stragglers(control);
        if !awaits && (!reads || self.is_dated(control)) {
            self.finish(control, now, actions);
        } else {
            let lines_late = if awaits { control.disorder().lines_late } else { Span::ZERO };
            let late = self.readings_late.max(lines_late).min(LATEST);
            self.deadline = now + control.clock().arrival_span(CLOSING + late);
        }
    }

    /// Whether a reading later than the last line's casting has come.
    fn is_dated(&self, control: &HeadControl) -> bool {
        let Some(last) = self.taken.last() else { return true };
        let cast = control.cast_time(&last.line);
        control.tilt.last_reading().is_some_and(|reading| reading.stamp >= cast)
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
                self.remarks.push(format!(
                    "the laser has been silent for {silent:.1} s: {} lines taken",
                    self.taken.len()
                ));
                self.finish(control, now, actions);
            }
            Stage::Closing => self.finish(control, now, actions),
            Stage::Finished => {}
        }
    }

    /// Books the time since the last event: slewing, creeping, or waiting for the laser.
    fn spend(&mut self, control: &HeadControl, now: Arrival) {
        let seconds = (now - self.last_event).seconds();
        self.last_event = now;
        if self.is_finished() || seconds <= 0.0 {
            return;
        }
        let rate = control
            .clock()
            .earliest(now)
            .and_then(|stamp| control.tilt.estimate(stamp))
            .map(|estimate| estimate.rate_rad_s.abs());
        const SLEWING_RAD_S: f64 = 0.1;
        const CREEPING_RAD_S: f64 = 0.004;
        match (self.stage, rate) {
            (Stage::NeedsClock | Stage::Closing | Stage::Finished, _) | (_, None) => {
                self.budget.idle_s += seconds;
            }
            (Stage::Approaching, Some(rate)) if rate > SLEWING_RAD_S => {
                self.budget.moving_s += seconds;
            }
            (Stage::Approaching, Some(_)) => self.budget.servo_s += seconds,
            (Stage::Flowing, Some(rate)) if rate > CREEPING_RAD_S => {
                self.budget.moving_s += seconds;
            }
            (Stage::Flowing, Some(_)) => self.budget.laser_s += seconds,
        }
    }

    /// Metres that the body drove since the first line.
    fn driven_m(&self, control: &HeadControl) -> f64 {
        let first = self.taken.first().map(|taken| control.cast_time(&taken.line));
        first.map_or(0.0, |first| control.body.driven_m(first))
    }

    fn finish(&mut self, control: &HeadControl, now: Arrival, actions: &mut Vec<HeadAction>) {
        let reached_end = self.stage == Stage::Closing;
        self.stage = Stage::Finished;
        let rows = dated_rows(&self.taken, &self.way, self.pan_rad, self.driving, control);
        let unsupported = rows.iter().filter(|row| !row.supported).count();
        let reads = control.tilt.last_reading().is_some();
        self.ramp = None;
        self.remarks.extend(control.disorder().remark_since(&self.disorder_before));
        if reads && self.readings_late > LATE {
            let seconds = self.readings_late.seconds();
            self.remarks.push(format!("the tilt's readings came late, by {seconds:.1} s or more"));
        }
        if reads && unsupported > 0 {
            self.remarks
                .push(format!("{unsupported} rows are filed by the servo law: no reading near"));
        }
        let filed: Vec<FiledRow> = rows.into_iter().map(|dated| dated.row).collect();
        let mean_square = |value: fn(&FiledRow) -> f64| {
            let sum: f64 = filed.iter().map(|row| value(row) * value(row)).sum();
            (sum / filed.len().max(1) as f64).sqrt()
        };
        let tilt_row_rad = mean_square(|row| row.tilt_sigma_rad);
        let image =
            image_of(&filed, &control.robot_from_scan(), |pose| control.scan_from_sensor(pose));
        actions.push(HeadAction::Finished(Box::new(Scan {
            image,
            profile: self.way.profile.name.clone(),
            complete: reached_end && !filed.is_empty(),
            filed: filed.len(),
            gaps: 0,
            repeats: self.repeats,
            unverified: if reads { unsupported } else { 0 },
            errors: ScanErrors {
                // Lag and delay are found once, so their error goes through all rows alike.
                tilt_common_rad: 0.5 * tilt_row_rad,
                tilt_row_rad,
                time_s: control.timing.sigma.seconds(),
            },
            budget: self.budget,
            driven_m: self.driving.then(|| self.driven_m(control)),
            started: self.started,
            ended: now,
            remarks: self.remarks.clone(),
        })));
        self.taken.clear();
    }
}
