//! The end of a sweep in motion: the last reading is waited for, then the rows are dated.

use super::{Flow, FlowDrive, Stage};
use crate::acquisition::HeadAction;
use crate::acquisition::control::HeadControl;
use crate::acquisition::dated::dated_rows;
use crate::acquisition::scan::{FiledRow, Scan, ScanErrors, image_of};
use crate::acquisition::stillness::doubt_remark;
use crate::robot::Demand;
use crate::time::{Arrival, Span};

/// Time given to a last reading, beyond what readings are late anyway.
const CLOSING: Span = Span::from_millis(450);
/// Readings later than this are not waited for.
const LATEST: Span = Span::from_millis(3_000);
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
    pub(super) fn is_dated(&self, control: &HeadControl) -> bool {
        let Some(last) = self.taken.last() else { return true };
        let cast = control.cast_time(&last.line);
        control.tilt.last_reading().is_some_and(|reading| reading.stamp >= cast)
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
        self.stage = Stage::Finished;
        let before = self.taken.len();
        self.taken.retain(|taken| !control.doubts(control.cast_time(&taken.line)));
        let doubted = before - self.taken.len();
        self.remarks.extend(doubt_remark(doubted));
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
            complete: reached_end && doubted == 0 && !filed.is_empty(),
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
