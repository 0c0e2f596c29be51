//! Nodding on the way: a sweep taken while the robot drives on slowly over ground it knows.

use super::running::{Desk, Running};
use crate::acquisition::{NodTerms, ParkState, Scan};

/// Way between two thoughts of a nod, in metres: about what a nod is driven over.
const ASK_EVERY_M: f64 = 1.0;
/// Braking, coming to rest, parking the head again and gathering speed, in seconds, besides the time
/// the body is given to settle.
const STOP_OVERHEAD_S: f64 = 3.0;
/// Path looked over for known ground, in metres.
const SURE_WITHIN_M: f64 = 4.0;

impl Running {
    /// Begins a nod if one is worth more here than the next stop: only with the guard line in place,
    /// so that the ground right ahead has been seen.
    pub(super) fn consider_nod(&mut self, parked: ParkState, desk: &mut Desk<'_>) {
        let guarded = matches!(parked, ParkState::Verified { .. } | ParkState::Computed { .. });
        if !desk.config.mission.nodding
            || !guarded
            || self.belief.path_m() - self.nod_asked_m < ASK_EVERY_M
        {
            return;
        }
        self.nod_asked_m = self.belief.path_m();
        let (Some(view), Some(guard)) = (self.rig.ground_view(), self.pilot.guard_tilt()) else {
            return;
        };
        let (full_mps, slow_mps) = self.pilot.speeds_mps();
        let terms = NodTerms {
            full_mps,
            slow_mps,
            sure_m: self.pilot.sure_ahead_m(&self.pose2(), &self.grid, SURE_WITHIN_M),
            guard_m: guard.line_ahead_m,
            stop_s: desk.config.mission.settle_s + STOP_OVERHEAD_S,
        };
        let interest = self.interest();
        let Some(acquisition) = &mut self.acquisition else { return };
        let offer = match acquisition.choose_nod(&view, &interest, &terms) {
            Ok(offer) => offer,
            Err(why) => return desk.info(format!("not nodding: {why}")),
        };
        desk.info(format!("nodding: {}", offer.reason));
        let actions = acquisition.start(offer.request, desk.now);
        self.head_actions(actions, desk);
    }

    /// Ends a nod that is under way and keeps what it saw.
    pub(super) fn end_nod(&mut self, why: &str, desk: &mut Desk<'_>) {
        if self.parked(desk.now) != ParkState::Nodding {
            return;
        }
        let scan = self.acquisition.as_mut().and_then(|a| a.stop_sweep(why, desk.now));
        if let Some(mut scan) = scan {
            self.take_phantom_from(&mut scan.image);
            self.ledger.sweep(&scan);
            self.finish_nod(scan, desk);
        }
    }

    /// What a nod saw enters the terrain where dead reckoning puts it; the next standing sweep corrects
    /// it together with the way. It is not registered: its rows are as far off as the odometry.
    pub(super) fn finish_nod(&mut self, scan: Scan, desk: &mut Desk<'_>) {
        desk.info(format!(
            "nod: {} rows in {:.1} s over {:.2} m driven ({})",
            scan.filed,
            scan.seconds(),
            scan.driven_m.unwrap_or(0.0),
            scan.budget
        ));
        self.belief.take_way_image(scan.image);
        self.refresh_grid(desk.now);
    }
}
