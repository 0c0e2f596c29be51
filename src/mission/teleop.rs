//! What the robot does at an operator's hand.

use super::operator::{Mode, OperatorEvent};
use super::running::{Activity, Desk, Look, Running};
use crate::acquisition::ParkState;
use crate::navigation::DriveCommand;
use crate::robot::HeadPose;

impl Running {
    /// Takes in an operator event.
    pub(super) fn operator(&mut self, event: &OperatorEvent, desk: &mut Desk<'_>) {
        match event {
            OperatorEvent::Drive { linear_mps, angular_rps } => {
                if self.mode == Mode::Auto {
                    desk.warn("drive command refused: the robot is in mode auto");
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
                self.lease.release();
                self.stop(desk);
                if *mode == Mode::Teleop {
                    self.take_over(desk);
                }
            }
            OperatorEvent::ScanNow => {
                if let Some(request) = self.fan(desk.config) {
                    self.lease.release();
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
        if let Some(acquisition) = &mut self.acquisition {
            acquisition.stop_sweep("the operator took over", desk.now);
        }
        self.explorer.give_up("the operator took over", desk.now);
        self.queue.clear();
        self.activity = Activity::Stand;
    }

    /// One control cycle at the operator's hand; false where the robot is on its own.
    pub(super) fn operator_cycle(&mut self, desk: &mut Desk<'_>) -> bool {
        if self.mode == Mode::Auto {
            return false;
        }
        let Some((linear_mps, angular_rps)) = self.lease.command(desk.now) else {
            if self.mode == Mode::Teleop && matches!(self.activity, Activity::Stand) {
                self.stop(desk);
                return true;
            }
            return false;
        };
        let parked = self.parked(desk.now);
        if parked == ParkState::NotParked
            && let (Some(guard), Some(acquisition)) =
                (self.pilot.guard_tilt(), &mut self.acquisition)
        {
            let actions = acquisition.park(HeadPose::tilted(guard.tilt.radians()), desk.now);
            self.head_actions(actions, desk);
        }
        self.renew_grid(desk);
        let pose = self.pose2();
        let wanted = DriveCommand { linear_mps, angular_rps };
        let command = self.pilot.filter(wanted, &pose, &self.grid, parked, desk.now);
        self.drive(command, desk);
        true
    }
}
