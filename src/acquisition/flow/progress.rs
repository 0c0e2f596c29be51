//! Whether the tilt comes on, and what is left of a sweep when it does not.

use super::Flow;
use crate::acquisition::HeadAction;
use crate::acquisition::control::HeadControl;
use crate::acquisition::profile::QuarterDegrees;
use crate::acquisition::stillness::Unmoved;
use crate::robot::Demand;
use crate::scan::LaserLine;
use crate::time::{Arrival, Span};

/// Time without progress, by the stamps of lines, after which the tilt is taken to be stuck.
const IDLE: Span = Span::from_millis(2_900);
/// Lines that come later than this were held up. No set-point could follow them, so that a tilt that
/// rested meanwhile rested where it was told to.
const HELD_UP: Span = Span::from_millis(1_000);

impl Flow {
    /// Told to stay, so that the law does not carry it on towards what it cannot reach.
    pub(super) fn stay_at(
        &mut self,
        tilt_rad: f64,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        self.demanded = QuarterDegrees::nearest(tilt_rad);
        let stay = Demand::Angle(self.demanded.radians());
        actions.push(HeadAction::Send(control.command_tilt(stay, now)));
    }

    /// The laser shows that the tilt stopped turning some lines ago. What was taken before is kept; where
    /// the tilt is by now has to be found out first, so that nothing else is taken.
    pub(super) fn on_unmoved(
        &mut self,
        unmoved: &Unmoved,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) {
        let before = self.taken.len();
        self.taken.retain(|taken| control.cast_time(&taken.line) < unmoved.slows_from);
        self.remarks.push(unmoved.remark(before - self.taken.len()));
        // Dated before what is known of the tilt changes.
        self.finish(control, now, actions);
        control.rests_at(unmoved.rest_rad, unmoved.towards);
    }

    pub(super) fn note_progress(
        &mut self,
        came_on: bool,
        tilt_rad: f64,
        line: &LaserLine,
        control: &HeadControl,
        now: Arrival,
    ) {
        let cast = control.cast_time(line);
        let held_up = control.clock().earliest(now).is_some_and(|server| server - cast > HELD_UP);
        if came_on {
            self.furthest_rad = tilt_rad;
        }
        if came_on || held_up {
            self.idle_since = None;
        } else {
            // Lines that a stall held up until now may be older than the command.
            let since = self.sent_off.map_or(cast, |sent_off| cast.max(sent_off));
            self.idle_since = self.idle_since.or(Some(since));
        }
    }

    /// Whether the tilt has not come on for so long that it must be at rest.
    pub(super) fn rests(&self, line: &LaserLine, control: &HeadControl) -> bool {
        // A slow approach moves by little between lines; only readings can tell it from a stop.
        let idle = self.idle_since.map(|since| control.cast_time(line) - since);
        let late = self.readings_late + control.command_delay();
        idle.is_some_and(|idle| idle >= IDLE + late)
            && !control.tilt.moves(control.clock().latest())
    }

    /// Where a tilt rests that is not where it should be: as it reads itself, where it does.
    pub(super) fn rests_at_rad(&self, control: &HeadControl) -> f64 {
        control.tilt.last_reading().map_or(self.furthest_rad, |reading| reading.angle_rad)
    }

    pub(super) fn end_if_stuck(
        &mut self,
        line: &LaserLine,
        control: &mut HeadControl,
        now: Arrival,
        actions: &mut Vec<HeadAction>,
    ) -> bool {
        if !self.rests(line, control) {
            return false;
        }
        self.remarks.push(format!(
            "the tilt rests at {:.2}° though {} was demanded: the sweep ends there",
            self.rests_at_rad(control).to_degrees(),
            self.demanded
        ));
        self.finish(control, now, actions);
        let rest_rad = self.rests_at_rad(control);
        control.rests_at(rest_rad, self.demanded.radians() - rest_rad);
        true
    }
}
