//! What a line to the server that became slower asks of the robot.

use super::running::{Desk, Look, Running};
use crate::acquisition::Acquisition;

impl Running {
    /// Stands still, then looks; but if commands are obeyed later than they were, it is found out anew how
    /// first, and then chosen again what to look at.
    pub(super) fn settle_calibrated(&mut self, look: Look, desk: &mut Desk<'_>) {
        if !self.acquisition.as_ref().is_some_and(Acquisition::wants_calibration) {
            return self.settle(look, desk);
        }
        desk.info("messages come later than they did: finding out anew how the tilt moves");
        self.settle(Look::Calibrate, desk);
    }

    /// Drives no faster than a line to the server that became slower allows.
    pub(super) fn heed_latency(&mut self, desk: &mut Desk<'_>) {
        const MATTERS_S: f64 = 0.2;
        let late_s = self.acquisition.as_ref().map_or(0.0, Acquisition::obeyed_late_s);
        if (late_s - self.pilot.late_s()).abs() > MATTERS_S {
            self.pilot.refit(desk.config, &self.rig, late_s);
            self.park(desk);
        }
    }
}
