//! The last look: the place that a mission reports is one that a sweep has corrected.

use super::operator::Mode;
use super::running::{Activity, Desk, Look, Running};
use crate::acquisition::Profile;
use crate::time::Span;

/// Rows of the last look, in degrees: walls, floor and ceiling fix all directions, and small planes
/// show too where only one wall is near.
const ROWS_DEG: f64 = 1.0;
/// Time beyond what the sweep is thought to take, in seconds: the head may have to come from far.
const SPARE_S: f64 = 4.0;
/// Way since the last sweep in metres from which another corrects anything.
const MOVED_M: f64 = 0.02;
/// Spread of the place believed, in metres, from which another look is worth its time.
const VAGUE_M: f64 = 0.05;
/// The same for the heading, in radians.
const VAGUE_RAD: f64 = 0.01;

impl Running {
    /// In the last seconds of its time the robot stops, looks once more and stays. Returns whether this
    /// cycle was used for that.
    pub(super) fn close(&mut self, desk: &mut Desk<'_>) -> bool {
        let Some(end) = desk.end.filter(|_| self.mode != Mode::Teleop && !self.closed) else {
            return false;
        };
        let looking = matches!(
            self.activity,
            Activity::Settle { .. } | Activity::Sweep | Activity::SignTest(_)
        );
        let Some(acquisition) = self.acquisition.as_ref().filter(|_| !looking) else {
            return false;
        };
        let profile = Profile::coarse(ROWS_DEG);
        let sweep_s = acquisition.seconds_for(&profile, desk.config.mission.flowing_sweeps);
        let needed_s = desk.config.mission.settle_s + sweep_s + SPARE_S;
        if end - desk.now > Span::from_seconds(needed_s) {
            return false;
        }
        let Some(request) = self.taken(profile, desk.config) else { return false };
        self.closed = true;
        self.end_nod("the time is nearly up", desk);
        if self.belief.leg_m() > MOVED_M || self.is_vague() {
            desk.info(
                "the time is nearly up: a last look, so that the place told is a corrected one",
            );
            self.settle(Look::Sweep(request), desk);
        } else {
            self.stop(desk);
            self.activity = Activity::Rest { until: end };
        }
        true
    }

    /// Whether the sweeps so far leave the place or the heading badly known.
    fn is_vague(&self) -> bool {
        let covariance = self.belief.mapper().covariance();
        let sigma = |axis: usize| covariance[(axis, axis)].sqrt();
        sigma(0).hypot(sigma(1)).hypot(sigma(2)) > VAGUE_M || sigma(5) > VAGUE_RAD
    }
}
