//! What the time of a sweep in motion is spent on.

use super::{Flow, FlowDrive, Stage};
use crate::acquisition::ServoLaw;
use crate::acquisition::control::HeadControl;
use crate::time::Arrival;

impl Flow {
    /// Books the time since the last event. What the travel would have taken at the joint's top speed
    /// is moving; the rest of it is the servo's on the way to the first row, and later the laser's,
    /// which the tilt is held back for. A rate that was asked for is moving altogether.
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
        let flowing = match self.stage {
            Stage::NeedsClock | Stage::Closing | Stage::Finished => None,
            Stage::Approaching => Some(false),
            Stage::Flowing => Some(true),
        };
        let (Some(rate), Some(flowing)) = (rate, flowing) else {
            self.budget.idle_s += seconds;
            return;
        };
        // A line that is overdue is no pace of the laser's.
        let interval = control.clock().arrival_span(control.rhythm.interval());
        let due = control.rhythm.last_arrival().map(|at| at + interval + interval);
        let overdue_s = due.map_or(0.0, |due| (now - due).seconds().clamp(0.0, seconds));
        self.budget.idle_s += overdue_s;
        let seconds = seconds - overdue_s;
        let share = match (self.way.drive, control.tilt.law()) {
            (FlowDrive::Rate { .. } | FlowDrive::Ramp { .. }, _) if flowing => 1.0,
            (_, Some(ServoLaw::Hinge { speed_rad_s, .. })) => (rate / speed_rad_s).min(1.0),
            // A spring has no top speed that could limit it.
            (_, Some(ServoLaw::Spring { .. }) | None) => 0.0,
        };
        self.budget.moving_s += share * seconds;
        let rest_s = (1.0 - share) * seconds;
        match flowing {
            true => self.budget.laser_s += rest_s,
            false => self.budget.servo_s += rest_s,
        }
    }
}
