//! Whether the tilt comes on.

use super::Flow;
use crate::acquisition::HeadAction;
use crate::acquisition::control::HeadControl;
use crate::time::Arrival;

/// Lines without progress after which the tilt is taken to be stuck.
const IDLE_LINES: u32 = 15;

impl Flow {
    pub(super) fn note_progress(&mut self, came_on: bool, tilt_rad: f64) {
        if came_on {
            self.furthest_rad = tilt_rad;
            self.idle_lines = 0;
        } else {
            self.idle_lines += 1;
        }
    }

    /// Whether the tilt has not come on for so many lines that it must be at rest.
    pub(super) fn rests(&self, control: &HeadControl) -> bool {
        // A slow approach moves by little between lines; only readings can tell it from a stop.
        self.idle_lines >= IDLE_LINES && !control.tilt.moves(control.clock().latest())
    }

    /// Where a tilt rests that is not where it should be: as it reads itself, where it does.
    pub(super) fn rests_at_rad(&self, control: &HeadControl) -> f64 {
        control.tilt.last_reading().map_or(self.furthest_rad, |reading| reading.angle_rad)
    }

    pub(super) fn end_if_stuck(
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
}
