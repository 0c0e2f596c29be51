//! The end of a sweep in motion: the last reading is waited for, then the rows are dated.

use super::{Flow, FlowDrive, Stage};
use crate::acquisition::HeadAction;
use crate::acquisition::control::HeadControl;
use crate::acquisition::dated::dated_rows;
use crate::acquisition::profile::QuarterDegrees;
use crate::acquisition::scan::{FiledRow, Scan, ScanErrors, image_of};
use crate::acquisition::stillness::doubt_remark;
use crate::robot::Demand;
use crate::time::{Arrival, Span, Stamp};

/// Time given to a last reading, beyond what readings are late anyway.
const CLOSING: Span = Span::from_millis(450);
/// Readings later than this are not waited for.
const LATEST: Span = Span::from_millis(3_000);
/// Time given to a message that is in time again.
const IN_TIME_WITHIN: Span = Span::from_millis(1_000);
/// A tilt that ends nearer than this to where it should, in radians, is there.
const SHORT_RAD: f64 = 0.009;
/// One that turns by less than this, in radians, over so many readings and so long, rests.
const RESTING_RAD: f64 = 0.002;
const RESTING_READINGS: usize = 4;
const RESTED: Span = Span::from_millis(700);
/// Readings later than this are remarkable.
const LATE: Span = Span::from_millis(500);

impl Flow {
    pub(super) fn close(
        &mut self,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        self.stage = Stage::Closing;
        self.ramp = None;
        if let FlowDrive::Rate { .. } = self.way.drive {
            actions.push(HeadAction::Send(control.command_tilt(Demand::Rate(0.0), now)));
        }
        if control.tilt.last_reading().is_none() {
            // Its answer tells whether the last commands were obeyed as fast as the others.
            actions.extend(control.query(now));
        }
        if !self.awaits_messages(control) {
            return self.finish_closed(control, now, actions);
        }
        let unsure = control.sure_until().is_some();
        let disorder = control.disorder();
        let stragglers = disorder.grew_since(&self.disorder_before);
        let late = [
            (true, self.readings_late),
            (stragglers, disorder.lines_late),
            (unsure, IN_TIME_WITHIN),
            (control.trips().awaits(), control.trips().bound(now)),
        ];
        let latest = late.into_iter().filter(|&(holds, _)| holds).map(|(_, late)| late).max();
        let late = latest.unwrap_or_default().min(LATEST);
        self.deadline = now + control.clock().arrival_span(CLOSING + late);
    }

    /// Whether something may still come that tells where the tilt was: readings later than the last line,
    /// what was overtaken by others, a message that is in time again, a line that shows whether it turned.
    pub(super) fn awaits_messages(&self, control: &HeadControl) -> bool {
        let reads = control.tilt.last_reading().is_some();
        control.disorder().grew_since(&self.disorder_before)
            || control.sure_until().is_some()
            || control.still().is_undecided()
            || (!reads && control.trips().awaits())
            || (reads && !self.is_dated(control))
    }

    /// Ends a sweep all of whose lines were taken. Lines come before the readings of their time, so that
    /// only now it is seen whether the tilt came to where the law had it.
    pub(super) fn finish_closed(
        &mut self,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let Some((here_rad, rests)) = self.fell_short(control) else {
            return self.finish(control, now, actions);
        };
        let (_, last) = self.way.ends();
        self.stage = Stage::Flowing;
        self.remarks.push(format!(
            "the tilt {} at {:.2}° though {} was demanded: the sweep ends there",
            if rests { "rests" } else { "was" },
            here_rad.to_degrees(),
            QuarterDegrees::nearest(last)
        ));
        self.finish(control, now, actions);
        if rests {
            control.rests_at(here_rad, last - here_rad);
        }
    }

    /// Where the tilt was read to be at the last line, and whether it rested there, if that is short of
    /// the end.
    fn fell_short(&self, control: &HeadControl) -> Option<(f64, bool)> {
        let taken = self.taken.last()?;
        let cast = control.cast_time(&taken.line);
        let after = control.tilt.readings().partition_point(|reading| reading.stamp < cast);
        let here_rad = control.tilt.readings().get(after)?.angle_rad;
        let (_, last) = self.way.ends();
        let short_rad = (last - here_rad) * self.way.direction();
        if short_rad < SHORT_RAD.max(1.5 * self.way.spacing_at(last)) {
            return None;
        }
        let since = (cast - RESTED, Stamp(i64::MAX));
        let rests = control.tilt.rests(here_rad, RESTING_RAD, since, (RESTING_READINGS, RESTED));
        Some((here_rad, rests))
    }

    /// Whether a reading later than the last line's casting has come.
    pub(super) fn is_dated(&self, control: &HeadControl) -> bool {
        let Some(last) = self.taken.last() else { return true };
        let cast = control.cast_time(&last.line);
        control.tilt.last_reading().is_some_and(|reading| reading.stamp >= cast)
    }

    /// Leaves out lines cast when it is not known any more at which stamp commands were obeyed; how many.
    fn leave_out_unsure(&mut self, control: &HeadControl) -> usize {
        let Some(until) = control.sure_until() else { return 0 };
        let before = self.taken.len();
        // A clock that fell back stamps anew what it has stamped before: what seems overtaken is of later.
        self.taken.retain(|taken| !taken.overtaken && control.cast_time(&taken.line) <= until);
        let unsure = before - self.taken.len();
        if unsure > 0 {
            self.remarks.push(format!(
                "{unsure} rows are left out: messages began to come {:.1} s late, and where the tilt was \
                 is not known since",
                control.slower_by().seconds()
            ));
        }
        unsure
    }

    /// Metres that the body drove since the first line.
    pub(super) fn driven_m(&self, control: &HeadControl) -> f64 {
        let first = self.taken.first().map(|taken| control.cast_time(&taken.line));
        first.map_or(0.0, |first| control.body.driven_m(first))
    }

    pub(super) fn finish(
        &mut self,
        control: &HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let reached_end = self.stage == Stage::Closing;
        let is_read = control.tilt.last_reading().filter(|_| control.clock().latest().is_some());
        if let Some(newest) = is_read.filter(|_| !reached_end).map(|reading| reading.stamp) {
            // What ended the sweep may have begun before the next reading would have told of it.
            self.taken.retain(|taken| control.cast_time(&taken.line) <= newest);
        }
        self.stage = Stage::Finished;
        let before = self.taken.len();
        self.taken.retain(|taken| !control.doubts(control.cast_time(&taken.line)));
        let doubted = before - self.taken.len();
        self.remarks.extend(doubt_remark(doubted));
        let unsure = self.leave_out_unsure(control);
        let rows = dated_rows(&self.taken, &self.way, self.pan_rad, self.driving, control);
        let unsupported = rows.iter().filter(|row| !row.supported).count();
        let reads = control.tilt.last_reading().is_some();
        self.ramp = None;
        self.remarks.extend(control.disorder().remark_since(&self.disorder_before));
        self.remarks.extend(control.slowness_remark());
        if reads && self.readings_late > LATE {
            let seconds = self.readings_late.seconds();
            self.remarks.push(format!("the tilt's readings came late, by {seconds:.1} s or more"));
        }
        if reads && unsupported > 0 {
            self.remarks
                .push(format!("{unsupported} rows are filed by the servo law: no reading near"));
        }
        if let Some(silent_s) = self.silent_s {
            self.remarks.push(format!(
                "the laser has been silent for {silent_s:.1} s: {} rows taken",
                rows.len()
            ));
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
            complete: reached_end && doubted + unsure == 0 && !filed.is_empty(),
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
