//! After a sweep that ended because the tilt no longer turned: does it still turn the other way?

use super::config::AcquisitionConfig;
use super::control::HeadControl;
use super::scan::Scan;
use super::servo::ServoLaw;
use super::{Acquisition, Activity, HeadAction};
use crate::geometry::AngleSpan;
use crate::robot::Demand;
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};

/// A turn back from where the tilt rests, in steps: two tilts may show one surface at one distance,
/// four do not. The scan is handed over when it is known whether a limit or a stuck joint ended it, so
/// that nobody drives in between.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Probe {
    scan: Box<Scan>,
    /// Which side the end lies on, as a sign, and what the tilt was found to reach.
    towards: f64,
    limits: Option<AngleSpan>,
    /// Whether it is turned back all the way, having shown nothing near the end.
    goes_far: bool,
    began: Stamp,
    /// Tilts still to be demanded, in radians, the last one first.
    to_come: Vec<f64>,
    /// Time that each is given.
    step: Span,
    /// When the next one is due, or the last one's time is over.
    next_at: Arrival,
}

/// How far it is turned back, in radians, and in how many steps: over so much any surface changes its
/// range visibly.
const BACK_RAD: f64 = 0.35;
const STEPS: u32 = 4;
/// Less is no probe, in radians.
const LEAST_RAD: f64 = 0.05;
/// Time for a step beyond the settling of the tilt, and for the last one.
const STEP_TIME: Span = Span::from_millis(900);
/// The same on the way to the other end, and what counts as settled there, in radians.
const FAR_STEP_TIME: Span = Span::from_millis(300);
const SETTLED_RAD: f64 = 0.01;
const PATIENCE: Span = Span::from_millis(3_000);

impl Probe {
    /// Turns the tilt back from the end of its reach that was just found on the side of the sign
    /// `towards`; what is done at once is in the actions. `None` when nothing is left to be found out.
    pub(super) fn start(
        mut scan: Box<Scan>,
        (rest_rad, towards): (f64, f64),
        control: &mut HeadControl,
        config: &AcquisitionConfig,
        now: Arrival,
    ) -> (Option<Self>, Vec<HeadAction>) {
        let back_rad = rest_rad - towards.signum() * BACK_RAD;
        let target_rad = control.reach().limits().map_or(back_rad, |limits| limits.clamp(back_rad));
        let (Some(began), Some(in_force)) = (control.still().newest(), control.in_force(now))
        else {
            return (None, vec![HeadAction::Finished(scan)]);
        };
        if (target_rad - rest_rad).abs() < LEAST_RAD {
            control.rests_at(rest_rad, -towards);
            scan.remarks.push("no way back is left to it either: it is stuck".to_owned());
            return (None, vec![HeadAction::Finished(scan)]);
        }
        let step_rad = (target_rad - rest_rad) / f64::from(STEPS);
        let tolerance = config.coarse_tolerance_deg.to_radians();
        let settle_s = control
            .tilt_settles(rest_rad + step_rad, tolerance, in_force)
            .map_or(config.unknown_settle_s, |settle| settle.total_s);
        let step = control.clock().arrival_span(Span::from_seconds(settle_s) + STEP_TIME);
        let to_come = (1..=STEPS).rev().map(|i| rest_rad + step_rad * f64::from(i)).collect();
        let limits = control.reach().limits();
        let goes_far = false;
        let mut probe =
            Self { scan, towards, limits, goes_far, began, to_come, step, next_at: now };
        let actions = probe.next_step(control, now).into_iter().collect();
        (Some(probe), actions)
    }

    /// The next step's command, if it is due.
    pub(super) fn next_step(
        &mut self,
        control: &mut HeadControl,
        now: Arrival,
    ) -> Option<HeadAction> {
        if now < self.next_at {
            return None;
        }
        let target_rad = self.to_come.pop()?;
        let last = self.to_come.is_empty();
        let patience = if last { control.clock().arrival_span(PATIENCE) } else { Span::ZERO };
        self.next_at = now + self.step + patience;
        Some(HeadAction::Send(control.command_tilt(Demand::Angle(target_rad), now)))
    }

    /// Looks at what is seen; the scan once it is known how the tilt is.
    pub(super) fn handle(&mut self, control: &mut HeadControl, now: Arrival) -> Option<Box<Scan>> {
        let is_over = now >= self.next_at && self.to_come.is_empty();
        let found = if control.reach().limits() != self.limits {
            // It was not where the sweep left it, but it turns.
            "it does turn back: that is the limit of the tilt"
        } else if let Some(unmoved) = control.unmoved() {
            if self.goes_farther(control, now) || (self.goes_far && !is_over) {
                return None;
            }
            control.rests_at(unmoved.rest_rad, unmoved.towards);
            match control.reach().stuck_rad() {
                Some(_) => "it does not turn back either: it is stuck",
                None => "it does not turn back either",
            }
        } else if control.still().changed_since(self.began) {
            "it does turn back: that is the limit of the tilt"
        } else if is_over {
            "whether it turns back cannot be seen"
        } else {
            return None;
        };
        self.end(found, now);
        Some(self.scan.clone())
    }

    /// Turns on to the other end of the reach; false if that was tried already. A limit that came to be
    /// while the tilt was beyond it holds it far from where it was last seen to turn.
    fn goes_farther(&mut self, control: &HeadControl, now: Arrival) -> bool {
        let Some(limits) = self.limits.filter(|_| !self.goes_far) else { return false };
        self.goes_far = true;
        let end_rad = if self.towards > 0.0 { limits.min_rad } else { limits.max_rad };
        let Some(from_rad) = control.tilt.target_rad() else { return false };
        // A hinge shows on its way where it comes free; a spring is there before the next line.
        let way_rad = (end_rad - from_rad).abs();
        let law = control.tilt.law();
        let step_rad = match law {
            Some(ServoLaw::Hinge { .. }) => way_rad,
            Some(ServoLaw::Spring { .. }) | None => BACK_RAD / f64::from(STEPS),
        };
        let steps = if way_rad < LEAST_RAD { 0 } else { (way_rad / step_rad).round() as u32 };
        let settle_s = law.map_or(1.0, |law| law.settle_s(step_rad, SETTLED_RAD));
        self.step = control.clock().arrival_span(Span::from_seconds(settle_s) + FAR_STEP_TIME);
        let at = |i: u32| from_rad - self.towards.signum() * step_rad * f64::from(i);
        self.to_come = (1..=steps).rev().map(at).collect();
        self.next_at = now;
        steps > 0
    }

    /// The turn back was none that rows were taken in.
    fn end(&mut self, why: &str, now: Arrival) {
        self.scan.remarks.push(why.to_owned());
        self.scan.budget.idle_s += (now - self.scan.ended).seconds();
        self.scan.ended = now;
    }

    /// When it must be called again even if nothing arrives.
    pub(super) fn next_wakeup(&self) -> Arrival {
        self.next_at
    }

    /// The scan, whatever is known.
    pub(super) fn stop(mut self, why: &str, now: Arrival) -> Scan {
        self.end(why, now);
        *self.scan
    }
}

impl Acquisition {
    /// A sweep that ended because the laser saw the tilt turn no farther is handed over after a turn
    /// back, which tells a limit from a stuck joint.
    pub(super) fn probe_new_end(
        &mut self,
        before: Option<AngleSpan>,
        actions: &mut Vec<HeadAction>,
        now: Arrival,
    ) {
        let reach = *self.control.reach();
        let latest = self.control.clock().latest();
        if reach.limits() == before
            || reach.stuck_rad().is_some()
            || latest.is_none_or(|latest| self.control.reads_at(latest))
        {
            return;
        }
        let Some(end) = reach.new_end(before) else { return };
        let finished = actions.iter().position(|a| matches!(a, HeadAction::Finished(_)));
        let Some(HeadAction::Finished(scan)) = finished.map(|at| actions.remove(at)) else {
            return;
        };
        let (probe, more) = Probe::start(scan, end, &mut self.control, &self.config, now);
        actions.extend(more);
        if let Some(probe) = probe {
            self.activity = Activity::Probing(Box::new(probe));
        }
    }
}
