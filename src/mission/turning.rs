//! Turns of a robot whose turns no inertial unit tells: its laser is held level meanwhile.
//!
//! The guard line of a robot that stands meets the floor all round, and a floor looks the same from every heading. A
//! robot that turns on the spot needs no guard, and level the same lines show the walls.

use super::running::{Desk, Running};
use crate::acquisition::ParkState;
use crate::navigation::DriveCommand;
use crate::robot::HeadPose;
use crate::time::Arrival;

/// Turns slower than this are too small to be worth it, in rad/s.
const WORTH_RPS: f64 = 0.35;

impl Running {
    /// What is to be driven instead of `command`: nothing until the laser is level for a turn on the spot, and no way
    /// ahead before it guards again.
    pub(super) fn held_level_for(
        &mut self,
        command: DriveCommand,
        desk: &mut Desk<'_>,
    ) -> DriveCommand {
        let turns = command.linear_mps == 0.0 && command.angular_rps != 0.0;
        if !self.looks_level {
            let is_worth = turns && command.angular_rps.abs() > WORTH_RPS;
            let guards = self.pilot.guard_tilt().is_some();
            if is_worth && guards && self.belief.attitude().is_none() {
                self.looks_level = true;
                self.park_at(HeadPose::default(), desk);
                return DriveCommand::STOP;
            }
            return command;
        }
        if !turns {
            self.park(desk);
            return DriveCommand::STOP;
        }
        match self.parked(desk.now) {
            ParkState::Moving => DriveCommand::STOP,
            _ => command,
        }
    }

    /// Parks the head where its line guards the way ahead: whoever drives on, an operator or a robot that gets out of
    /// trouble, does not drive by a laser that looks over the edges.
    pub(super) fn park(&mut self, desk: &mut Desk<'_>) {
        let Some(guard) = self.pilot.guard_tilt() else { return };
        self.looks_level = false;
        self.park_at(HeadPose::tilted(guard.tilt.radians()), desk);
    }

    fn park_at(&mut self, pose: HeadPose, desk: &mut Desk<'_>) {
        let Some(acquisition) = &mut self.acquisition else { return };
        let actions = acquisition.park(pose, desk.now);
        self.head_actions(actions, desk);
    }

    /// Where the head is parked now.
    pub(super) fn parked(&self, now: Arrival) -> ParkState {
        self.acquisition.as_ref().map_or(ParkState::NotParked, |a| a.parked(now))
    }
}
