//! Sweeps in which the tilt never stops: motion and laser overlap, and each line is filed under the
//! tilt it was taken at.

use super::config::AcquisitionConfig;
use super::control::HeadControl;
use super::profile::{Profile, QuarterDegrees};
use super::scan::{FiledRow, Scan, ScanErrors, TimeBudget, image_of};
use super::{HeadAction, HeadEvent};
use crate::robot::{Demand, HeadPose};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};

/// How the tilt is driven along.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FlowDrive {
    /// By set-points on the grid of quarter degrees, one for each line, so far ahead of the tilt that
    /// the servo carries it one row on: the profile's next, or `step_rad` on.
    SetPoints {
        /// Distance between rows in radians; `None` for the profile's own.
        step_rad: Option<f64>,
    },
    /// At a constant rate in radians per second (paper, section VI: 0.05). Once in `cycle_s` seconds
    /// the next line is kept; with 0 every line is.
    Rate {
        /// Radians per second, above 0.
        rate_rad_s: f64,
        /// Seconds between rows.
        cycle_s: f64,
    },
}

/// A sweep in one continuous motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flow {
    profile: Profile,
    drive: FlowDrive,
    pan_rad: f64,
    stage: Stage,
    taken: Vec<Taken>,
    demanded: QuarterDegrees,
    started: Arrival,
    deadline: Arrival,
    repeats: usize,
    /// Lines since the tilt last came on by half a row.
    idle_lines: u32,
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

/// A line, and what was demanded when it came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Taken {
    line: LaserLine,
    demanded: QuarterDegrees,
}

/// Lines without progress after which the tilt is taken to be stuck.
const IDLE_LINES: u32 = 15;
/// Time given to a last reading, beyond what readings are late anyway.
const CLOSING: Span = Span::from_millis(450);
/// Readings later than this are not waited for.
const LATEST: Span = Span::from_millis(3_000);
/// Readings later than this are remarkable.
const LATE: Span = Span::from_millis(500);
/// A row may be this share of the spacing off, where that is more than the configured error: rows lie
/// far apart where the ground is near, and there an angle moves a point by little.
const TOLERATED_SHARE: f64 = 0.1;
/// A row nearer than this share of the spacing to the row before tells nothing new.
const CLOSEST: f64 = 0.4;
/// Rows farther apart than this are thin for fitting surfaces: lines between them that come for
/// nothing are kept.
const DENSE_RAD: f64 = 0.0175;

impl Flow {
    /// A sweep over `profile`, already clipped and turned the way it is to run; its first actions.
    pub fn start(
        profile: Profile,
        drive: FlowDrive,
        pan_rad: f64,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> (Self, Vec<HeadAction>) {
        let first = profile.tilts.first().copied().unwrap_or_default();
        let mut flow = Self {
            demanded: first,
            furthest_rad: first.radians(),
            profile,
            drive,
            pan_rad,
            stage: Stage::NeedsClock,
            taken: Vec::new(),
            started: now,
            deadline: now + config.row_timeout(),
            repeats: 0,
            idle_lines: 0,
            budget: TimeBudget::default(),
            last_event: now,
            remarks: Vec::new(),
        };
        let mut actions = Vec::new();
        if flow.profile.is_empty() {
            flow.remarks.push("no row of the profile can be reached".to_owned());
            flow.finish(control, now, &mut actions);
        } else if control.clock().latest().is_some() {
            flow.approach(control, config, now, &mut actions);
        }
        (flow, actions)
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
        (self.taken.len(), self.profile.len().max(self.taken.len()))
    }

    /// When the sweep must be called again even if nothing arrives.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        (!self.is_finished()).then_some(self.deadline)
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
            (Stage::Approaching | Stage::Flowing, HeadEvent::Line(line)) => {
                self.on_line(line, control, config, now, &mut actions);
            }
            (Stage::Closing, HeadEvent::Joints(_)) if self.is_dated(control) => {
                self.finish(control, now, &mut actions);
            }
            _ => {}
        }
        if now >= self.deadline && !self.is_finished() {
            self.on_deadline(control, config, now, &mut actions);
        }
        actions
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

    fn direction(&self) -> f64 {
        let (first, last) = self.ends();
        if last < first { -1.0 } else { 1.0 }
    }

    fn ends(&self) -> (f64, f64) {
        let tilts = &self.profile.tilts;
        (tilts[0].radians(), tilts[tilts.len() - 1].radians())
    }

    /// Distance between rows around a tilt, in radians.
    fn spacing_at(&self, tilt_rad: f64) -> f64 {
        if let FlowDrive::SetPoints { step_rad: Some(step) } = self.drive {
            return step;
        }
        let tilts = &self.profile.tilts;
        let direction = self.direction();
        let ahead = tilts.partition_point(|t| (t.radians() - tilt_rad) * direction <= 0.0);
        let at = ahead.clamp(1, tilts.len().max(2) - 1);
        match (tilts.get(at - 1), tilts.get(at)) {
            (Some(a), Some(b)) => (b.radians() - a.radians()).abs(),
            _ => super::QUARTER_DEGREE_RAD,
        }
    }

    /// The spacing that the times are known well enough for.
    fn step_at(&self, tilt_rad: f64, control: &HeadControl, config: &AcquisitionConfig) -> f64 {
        let sigma_s = control.timing.sigma.seconds().max(1e-4);
        let spacing = self.spacing_at(tilt_rad);
        // Without readings a fast tilt is dead reckoning: an error of its speed adds up over the sweep.
        let share = control.tilt.last_reading().map_or(0.0, |_| TOLERATED_SHARE);
        let tolerated = config.flow_sigma_deg.to_radians().max(share * spacing);
        let most = tolerated / sigma_s * control.rhythm.interval().seconds();
        spacing.min(most.max(super::QUARTER_DEGREE_RAD))
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
        let (first, last) = self.ends();
        let direction = self.direction();
        let step = self.step_at(here.angle_rad, control, config);
        if self.stage == Stage::Approaching {
            let off = (here.angle_rad - first).abs();
            if off > 0.5 * step && (here.angle_rad - first) * direction < 0.0 || off > 1.5 * step {
                self.note_progress(
                    (here.angle_rad - self.furthest_rad).abs() > 1e-3,
                    here.angle_rad,
                );
                self.end_if_stuck(control, now, actions);
                return;
            }
            self.stage = Stage::Flowing;
            self.furthest_rad = here.angle_rad;
            self.idle_lines = 0;
            if let FlowDrive::Rate { rate_rad_s, .. } = self.drive {
                let rate = Demand::Rate(direction * rate_rad_s);
                actions.push(HeadAction::Send(control.command_tilt(rate, now)));
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
            && matches!(self.drive, FlowDrive::SetPoints { .. })
        {
            self.lead_on(line, control, config, now, actions);
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

    fn end_if_stuck(
        &mut self,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) -> bool {
        // A slow approach moves by little between lines; only readings can tell it from a stop.
        let told = control.tilt.moves(control.clock().latest());
        if self.idle_lines < IDLE_LINES || told {
            return false;
        }
        self.remarks.push(format!(
            "the tilt rests at {:.2}° though {} was demanded: the sweep ends there",
            self.furthest_rad.to_degrees(),
            self.demanded
        ));
        self.finish(control, now, actions);
        true
    }

    /// Sets the point ahead so that the tilt comes on by one row between the next two castings that a
    /// command sent now can still influence.
    fn lead_on(
        &mut self,
        line: &LaserLine,
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Some(sent) = control.clock().earliest(now) else { return };
        let in_force = sent + control.timing.command_delay;
        let interval = control.rhythm.interval();
        let mut cast = control.cast_time(line) + interval;
        let half = Span::from_seconds(0.5 * interval.seconds());
        // A line lost or late leaves `cast` in the past; the bound keeps a broken clock from spinning.
        for _ in 0..64 {
            if cast >= in_force + half {
                break;
            }
            cast = cast + interval;
        }
        let (Some(before), Some(start)) =
            (control.tilt.estimate(cast - interval), control.tilt.estimate(in_force))
        else {
            return;
        };
        let direction = self.direction();
        let step = self.step_at(before.angle_rad, control, config);
        let wanted = before.angle_rad + direction * step;
        let set_point = match control.tilt.law() {
            Some(law) => {
                let state =
                    super::ServoState { angle_rad: start.angle_rad, rate_rad_s: start.rate_rad_s };
                law.set_point_for(state, wanted, (cast - in_force).seconds())
            }
            None => wanted,
        };
        // Beyond the last row no more than one proportional gap, which keeps the speed up to the end.
        let (_, last) = self.ends();
        let beyond = last + direction * super::HINGE_GAP_RAD;
        let far = start.angle_rad + direction * LONGEST_LEAD_RAD;
        let nearest = |a: f64, b: f64| if direction > 0.0 { a.min(b) } else { a.max(b) };
        let reachable = control.head().tilt().map_or(0.0, |axis| axis.clamp(nearest(beyond, far)));
        let limited = if set_point.is_finite() { nearest(set_point, reachable) } else { reachable };
        let next = QuarterDegrees::nearest(limited);
        let onwards = f64::from(next.0 - self.demanded.0) * direction > 0.0;
        if onwards {
            self.demanded = next;
            let demand = Demand::Angle(next.radians());
            actions.push(HeadAction::Send(control.command_tilt(demand, now)));
        }
    }

    fn close(&mut self, control: &mut HeadControl, now: Arrival, actions: &mut Vec<HeadAction>) {
        self.stage = Stage::Closing;
        let rest = match self.drive {
            FlowDrive::Rate { .. } => Some(Demand::Rate(0.0)),
            FlowDrive::SetPoints { .. } => None,
        };
        if let Some(rest) = rest {
            actions.push(HeadAction::Send(control.command_tilt(rest, now)));
        }
        // Without readings there is nothing to wait for.
        let reads = control.tilt.last_reading().is_some();
        if !reads || self.is_dated(control) {
            self.finish(control, now, actions);
        } else {
            let late = control.readings_late().min(LATEST);
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
                let demand = match (self.stage, self.drive) {
                    (Stage::Flowing, FlowDrive::Rate { rate_rad_s, .. }) => {
                        Demand::Rate(self.direction() * rate_rad_s)
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

    fn finish(&mut self, control: &HeadControl, now: Arrival, actions: &mut Vec<HeadAction>) {
        let reached_end = self.stage == Stage::Closing;
        self.stage = Stage::Finished;
        let rows = self.rows(control);
        let unsupported = rows.iter().filter(|(_, supported)| !supported).count();
        let reads = control.tilt.last_reading().is_some();
        let late = control.readings_late();
        if reads && late > LATE {
            let seconds = late.seconds();
            self.remarks.push(format!("the tilt's readings come {seconds:.1} s late"));
        }
        if reads && unsupported > 0 {
            self.remarks
                .push(format!("{unsupported} rows are filed by the servo law: no reading near"));
        }
        let filed: Vec<FiledRow> = rows.into_iter().map(|(row, _)| row).collect();
        let mean_square = |value: fn(&FiledRow) -> f64| {
            let sum: f64 = filed.iter().map(|row| value(row) * value(row)).sum();
            (sum / filed.len().max(1) as f64).sqrt()
        };
        let tilt_row_rad = mean_square(|row| row.tilt_sigma_rad);
        let image =
            image_of(&filed, &control.robot_from_scan(), |pose| control.scan_from_sensor(pose));
        actions.push(HeadAction::Finished(Box::new(Scan {
            image,
            profile: self.profile.name.clone(),
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
            started: self.started,
            ended: now,
            remarks: self.remarks.clone(),
        })));
        self.taken.clear();
    }

    /// The rows under the tilts that all readings, the later ones included, give them; and whether a
    /// reading supports each.
    fn rows(&self, control: &HeadControl) -> Vec<(FiledRow, bool)> {
        const SUPPORT: Span = Span::from_millis(400);
        const READING_SIGMA_RAD: f64 = 1e-4;
        let cycle = match self.drive {
            FlowDrive::Rate { cycle_s, .. } => Span::from_seconds(cycle_s),
            FlowDrive::SetPoints { .. } => Span::ZERO,
        };
        let mut rows: Vec<(FiledRow, bool)> = Vec::new();
        let mut kept: Option<f64> = None;
        let mut due: Option<Stamp> = None;
        for taken in &self.taken {
            let cast = control.cast_time(&taken.line);
            let Some(estimate) = control.tilt.estimate(cast) else { continue };
            let closest = match self.drive {
                FlowDrive::SetPoints { .. } => {
                    CLOSEST * self.spacing_at(estimate.angle_rad).min(DENSE_RAD)
                }
                FlowDrive::Rate { .. } => 0.0,
            };
            let nothing_new = kept.is_some_and(|tilt| (estimate.angle_rad - tilt).abs() < closest);
            if nothing_new || due.is_some_and(|due| cast < due) {
                continue;
            }
            kept = Some(estimate.angle_rad);
            // Counted from the first row, so that waiting for lines does not stretch the cycle.
            due = Some(due.unwrap_or(cast) + cycle);
            let supported = estimate.support.is_some_and(|span| span <= SUPPORT);
            let still = if supported {
                READING_SIGMA_RAD
            } else {
                let moved = control
                    .tilt
                    .estimate(cast - control.rhythm.interval())
                    .map_or(0.0, |before| before.angle_rad - estimate.angle_rad);
                control.timing.model_sigma_rad.hypot(LAW_ERROR * moved)
            };
            let moving = estimate.rate_rad_s * control.timing.sigma.seconds();
            rows.push((
                FiledRow {
                    demanded: taken.demanded,
                    pose: HeadPose { pan_rad: self.pan_rad, tilt_rad: estimate.angle_rad },
                    tilt_sigma_rad: still.hypot(moving),
                    reference_from_robot: nalgebra::Isometry3::identity(),
                    line: Some(taken.line.clone()),
                },
                supported,
            ));
        }
        rows
    }
}

/// A law found to a few percent predicts a move to a few percent.
const LAW_ERROR: f64 = 0.03;

/// A set-point farther ahead than this makes no joint faster, and takes longer to call back.
const LONGEST_LEAD_RAD: f64 = 0.1;
