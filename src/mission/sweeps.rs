//! Sweeps: the head is served, and what a finished sweep tells enters the belief.

use super::floor::{Stand, stands_at_m};
use super::pilot::Pilot;
use super::running::{Activity, Desk, Look, Running, explorer, shape_of};
use crate::acquisition::{HeadAction, HeadEvent, Profile, Reach, Scan};

impl Running {
    /// Hands an event to the acquisition and does what it asks.
    pub(super) fn head_event(&mut self, event: &HeadEvent<'_>, desk: &mut Desk<'_>) {
        let Some(acquisition) = &mut self.acquisition else { return };
        let actions = acquisition.handle(event, desk.now);
        self.head_actions(actions, desk);
    }

    pub(super) fn head_actions(&mut self, actions: Vec<HeadAction>, desk: &mut Desk<'_>) {
        for action in actions {
            match action {
                HeadAction::Send(command) => {
                    desk.out.extend(self.rig.head_commands(command.pan, command.tilt));
                }
                HeadAction::Ask => desk.out.extend(self.rig.trigger_command()),
                HeadAction::Query => desk.out.push(self.rig.line_query()),
                HeadAction::Filed { .. } => {}
                HeadAction::Finished(scan) => self.finish_sweep(*scan, desk),
                HeadAction::Reach(reach) => self.take_reach(&reach, desk),
                HeadAction::Calibrated(report) => {
                    desk.info(format!("pan-tilt: {}", report.text));
                    report.warning.into_iter().for_each(|warning| desk.warn(warning));
                    // A server that stalled, or a moment's rubbish, must not slow every later sweep.
                    if report.fit.is_none() && !self.calibrated_again {
                        self.calibrated_again = true;
                        desk.info("pan-tilt: once more");
                        self.queue.push_front(Look::Calibrate);
                    }
                    match self.queue.is_empty() && !self.first_scan_due {
                        // On the way, where a sweep was due.
                        true => self.look_here(desk),
                        false => self.next_look_or_choose(desk),
                    }
                }
            }
        }
    }

    /// A sweep has ended: everything it told enters the belief.
    pub(super) fn finish_sweep(&mut self, mut scan: Scan, desk: &mut Desk<'_>) {
        self.take_phantom_from(&mut scan.image);
        self.ledger.sweep(&scan);
        for remark in &scan.remarks {
            let text = format!("{} sweep: {remark}", scan.profile);
            // What is as it was at the last sweep is no news.
            match self.remarks.contains(remark) {
                true => desk.info(text),
                false => desk.warn(text),
            }
        }
        self.remarks.clone_from(&scan.remarks);
        if scan.driven_m.is_some() {
            return self.finish_nod(scan, desk);
        }
        if scan.filed > 0 && std::mem::take(&mut self.first_scan_due) {
            self.measure_floor(&scan, desk);
        }
        let (profile, filed, seconds) = (scan.profile.clone(), scan.filed, scan.seconds());
        let budget = scan.budget.to_string();
        let errors = crate::mapping::ScanErrors {
            tilt_offset_sigma_rad: scan.errors.tilt_common_rad,
            mount_sigma_m: self.rig.laser.as_ref().map_or(0.0, |laser| laser.mounted_within_m),
            ..crate::mapping::ScanErrors::default()
        };
        let before = self.belief.world_from_robot();
        let findings = self.belief.take_scan(scan.image, errors);
        let after = self.belief.world_from_robot();
        let counts = [findings.planes, findings.spheres, findings.cylinders];
        for (sum, count) in self.ledger.surfaces.iter_mut().zip(counts) {
            *sum += count;
        }
        self.ledger.associations +=
            findings.update.associations.len() + findings.update.curves_known;
        self.ledger.fixes.book(&findings.update);
        let moved = (before.inverse() * after).translation.vector;
        let turned = before.rotation.angle_to(&after.rotation).to_degrees();
        desk.info(format!(
            "{profile} sweep: {filed} rows in {seconds:.1} s ({budget}), {} planes ({} known, {} new), \
             {} curved ({} known, {} new), pose corrected by {:.3} m ({:.2} ahead, {:.2} left, {:.2} up) \
             and {turned:.2}°",
            findings.planes,
            findings.update.associations.len(),
            findings.update.added.len(),
            findings.spheres + findings.cylinders,
            findings.update.curves_known,
            findings.update.curves_new,
            moved.norm(),
            moved.x,
            moved.y,
            moved.z,
        ));
        self.pilot.corrected(&before, &after);
        if findings.update.loop_closed {
            desk.info(format!(
                "loop closed, {} earlier poses corrected",
                findings.update.moved.len()
            ));
        }
        if findings.redrawn {
            desk.info("earlier sweeps lie elsewhere by now: the map was drawn anew");
        }
        self.map_sweep(desk.now);
        let pose = self.pose2();
        // The far rows of a sweep lie too far apart to show everything.
        self.explorer.swept(&self.grid, &pose, std::f64::consts::PI, 0.8);
        self.next_look_or_choose(desk);
    }

    /// Measures how high the robot's origin stands above the floor; no message tells it. The belief
    /// is still empty then and is begun anew with the measured height.
    fn measure_floor(&mut self, scan: &Scan, desk: &mut Desk<'_>) {
        let guess_m = self.shape.base_above_floor_m;
        let up = self.belief.up_as_seen(&scan.image);
        let contacts = self.shape.contacts();
        let stand = Stand { up, supposed_m: guess_m, contacts: &contacts };
        let measured_m = stands_at_m(&scan.image, &stand);
        if let Some(height_m) = measured_m.filter(|height_m| (height_m - guess_m).abs() >= 0.01) {
            self.stand_at(height_m, desk);
        }
        self.warn_of_sight(desk);
    }

    /// Begins anew for an origin that stands `height_m` above the floor.
    fn stand_at(&mut self, height_m: f64, desk: &mut Desk<'_>) {
        let guess_m = self.shape.base_above_floor_m;
        desk.info(format!(
            "the floor lies {height_m:.3} m below the robot's origin, not {guess_m:.3} m as supposed"
        ));
        self.rig.body.origin_height_m = height_m;
        self.shape = shape_of(&self.rig);
        self.belief.restart(self.shape.clone());
        self.pilot = Pilot::new(desk.config, &self.rig, &self.shape);
        if let Some(acquisition) = &mut self.acquisition {
            acquisition.stands_at(height_m);
        }
        self.explorer = explorer(desk.config, &self.rig, self.acquisition.as_ref());
    }

    /// The tilt reaches something else than was known: what is planned goes by it from now on.
    fn take_reach(&mut self, reach: &Reach, desk: &mut Desk<'_>) {
        if let Some(laser) = &mut self.rig.laser {
            laser.head.limit_tilt(reach.limits());
        }
        self.pilot.refit(desk.config, &self.rig, self.pilot.late_s());
        let explore = explorer(desk.config, &self.rig, self.acquisition.as_ref());
        self.explorer.sees(explore.config().blind_m, explore.config().scan_s);
        if !self.may_explore(desk.config) {
            desk.warn(format!(
                "{reach}: no ground ahead can be looked at, the robot stays where it is"
            ));
            self.queue.clear();
            if matches!(self.activity, Activity::Drive(_)) {
                self.stop(desk);
                self.activity = Activity::Stand;
            }
            return;
        }
        desk.warn(reach.to_string());
        // Before the first scan has measured how high the laser stands, this would be said again soon.
        if reach.is_narrowed() && !self.first_scan_due {
            self.warn_of_sight(desk);
        }
        if matches!(self.activity, Activity::Drive(_)) {
            self.park(desk);
        }
    }

    /// Says what ground the rig cannot see, and why.
    fn warn_of_sight(&self, desk: &mut Desk<'_>) {
        let (Some(acquisition), Some(view)) = (&self.acquisition, self.rig.ground_view()) else {
            return;
        };
        // Of a stuck tilt it was said already that it shows no ground.
        if acquisition.is_stuck() {
            return;
        }
        if let Some(nearest_m) = view.visibility().nearest_from_centre_m {
            desk.warn(format!("ground nearer than {nearest_m:.2} m ahead cannot be seen"));
        }
        let limits = acquisition.control().head().tilt().and_then(|axis| axis.limits);
        if let Some(lost) = Profile::paper_full().clipped(limits).1 {
            desk.warn(lost.explain(&view));
        }
    }
}
