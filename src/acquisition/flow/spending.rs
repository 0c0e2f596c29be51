//! What the time of a sweep in motion is spent on.

use super::{Flow, Stage};
use crate::acquisition::control::HeadControl;
use crate::time::Arrival;

impl Flow {
    /// Books the time since the last event: slewing, creeping, or waiting for the laser.
    pub(super) fn spend(&mut self, control: &HeadControl, now: Arrival) {
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
}
