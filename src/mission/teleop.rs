//! What the robot does at an operator's hand.

use super::operator::{Mode, OperatorEvent};
use super::pilot::{Hold, Way};
use super::running::{Activity, Desk, Look, Running};
use crate::acquisition::ParkState;
use crate::navigation::{DriveCommand, Path};

impl Running {
    /// Takes in an operator event.
    pub(super) fn operator(&mut self, event: &OperatorEvent, desk: &mut Desk<'_>) {
        match event {
            OperatorEvent::Drive { linear_mps, angular_rps } => {
                if self.mode == Mode::Auto {
                    // A key that is held down repeats twenty times a second.
                    if !self.refusal_told {
                        desk.warn("drive command refused: the robot is in mode auto");
                        self.refusal_told = true;
                    }
                    return;
                }
                self.lease.renew(*linear_mps, *angular_rps, desk.now);
                self.take_over(desk);
                self.operator_cycle(desk);
            }
            OperatorEvent::Stop => {
                self.lease.release();
                if matches!(self.activity, Activity::Stand) {
                    self.stop(desk);
                }
            }
            OperatorEvent::SetMode(mode) => {
                desk.info(format!("mode {mode:?} by the operator"));
                self.mode = *mode;
                self.refusal_told = false;
                self.lease.release();
                self.stop(desk);
                if *mode == Mode::Teleop {
                    self.take_over(desk);
                    // A robot that stood already keeps the path it came by; the operator follows none.
                    self.pilot.set_path(Path::default());
                }
            }
            OperatorEvent::ScanNow => {
                if let Some(request) = self.fan(desk.config) {
                    self.lease.release();
                    desk.info("looking: the whole fan, as the operator asks");
                    self.settle(Look::Sweep(request), desk);
                }
            }
            OperatorEvent::Quit => {}
        }
    }

    /// Drops what the robot was doing on its own and parks the head on guard.
    fn take_over(&mut self, desk: &mut Desk<'_>) {
        if matches!(self.activity, Activity::Stand) {
            return;
        }
        let dropped = self
            .acquisition
            .as_mut()
            .and_then(|acquisition| acquisition.stop_sweep("the operator took over", desk.now));
        if dropped.is_some() {
            desk.info("the sweep is dropped: the operator took over");
        }
        self.explorer.give_up("the operator took over", desk.now);
        self.queue.clear();
        self.pilot.set_path(Path::default());
        self.activity = Activity::Stand;
    }

    /// One control cycle at the operator's hand; false where the robot is on its own.
    pub(super) fn operator_cycle(&mut self, desk: &mut Desk<'_>) -> bool {
        if self.mode == Mode::Auto {
            return false;
        }
        let pose = self.pose2();
        // Also where the robot rolls on after the last key: it is the way back.
        self.pilot.passed(&pose);
        let Some((linear_mps, angular_rps)) = self.lease.command(desk.now) else {
            if self.mode == Mode::Teleop && matches!(self.activity, Activity::Stand) {
                self.stop(desk);
                self.held = None;
                // On guard before the first key, so that the key is obeyed at once.
                self.guard_the_way(desk);
                return true;
            }
            return false;
        };
        let parked = self.guard_the_way(desk);
        self.renew_grid(desk);
        let wanted = DriveCommand { linear_mps, angular_rps };
        let attitude = self.belief.attitude().unwrap_or_default();
        let (command, hold) = match self.pilot.righted(wanted, &attitude, &pose, &self.grid) {
            Some(righted) => righted,
            None => self.pilot.filter(wanted, &pose, &self.grid, parked, desk.now),
        };
        self.tell_hold(hold, desk);
        self.drive(command, desk);
        true
    }

    /// Turns the head to the ground ahead unless it is there or on its way; tells where it is.
    fn guard_the_way(&mut self, desk: &mut Desk<'_>) -> ParkState {
        if self.looks_level || self.parked(desk.now) == ParkState::NotParked {
            self.park(desk);
        }
        self.parked(desk.now)
    }

    /// Tells the operator once why the robot does not move as told, unless that is the gap about the start,
    /// which is assumed then.
    fn tell_hold(&mut self, hold: Option<Hold>, desk: &mut Desk<'_>) {
        let news = hold.filter(|hold| !self.held.is_some_and(|told| told.is_like(hold)));
        self.held = hold;
        let is_gap = matches!(hold, Some(Hold::Unseen { way: Way::Ahead, .. }));
        let is_bridged = is_gap
            && (news.is_some() && self.bridge_blind_ring(desk) || self.bridge_to_guard_line(desk));
        if is_bridged {
            self.held = None;
            return;
        }
        let Some(hold) = news else { return };
        desk.warn(format!("not moving: {hold}"));
    }
}
