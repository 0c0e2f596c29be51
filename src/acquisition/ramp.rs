//! A constant rate on a server that knows only angles.

use super::control::HeadControl;
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};

/// A set-point that runs from one end of a sweep past the other at a constant rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Ramp {
    from_rad: f64,
    from: Stamp,
    /// Radians per second, with the sign of the way.
    rate_rad_s: f64,
    end_rad: f64,
    next_at: Arrival,
}

/// Time between set-points. UDK refreshes its joints as often (protocol 6.1); a spring smooths what is
/// left of the steps.
const EVERY: Span = Span::from_millis(50);

impl Ramp {
    /// A set-point that leaves the first of `ends` now. It runs a little beyond the last, as the joint
    /// lags behind it, but not beyond the link's limits. `None` while the server's clock is unknown.
    pub(super) fn start(
        ends: (f64, f64),
        rate_rad_s: f64,
        control: &HeadControl,
        now: Arrival,
    ) -> Option<Self> {
        let (first, last) = ends;
        let direction = if last < first { -1.0 } else { 1.0 };
        let beyond = last + direction * super::HINGE_GAP_RAD;
        let end_rad = control.head().tilt().map_or(last, |axis| axis.clamp(beyond));
        let from = control.clock().earliest(now)?;
        Some(Self {
            from_rad: first,
            from,
            rate_rad_s: direction * rate_rad_s,
            end_rad,
            next_at: now,
        })
    }

    /// When the set-point is to be moved on.
    pub(super) fn next_at(&self) -> Arrival {
        self.next_at
    }

    /// Where the set-point belongs, if it is to be moved on now.
    pub(super) fn due(&mut self, control: &HeadControl, now: Arrival) -> Option<f64> {
        if now < self.next_at {
            return None;
        }
        self.next_at = now + control.clock().arrival_span(EVERY);
        // By the server's clock, so that the rate is right however fast its time runs.
        let seconds = (control.clock().earliest(now)? + EVERY - self.from).seconds();
        let angle_rad = self.from_rad + self.rate_rad_s * seconds.max(0.0);
        let nearest = |a: f64, b: f64| if self.rate_rad_s > 0.0 { a.min(b) } else { a.max(b) };
        Some(nearest(angle_rad, self.end_rad))
    }
}
