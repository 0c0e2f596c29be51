//! A robot that its own wheels tip over: where an edge blocks them they turn the body about themselves.
//!
//! Braked wheels hold a tipped body up, and whatever is tried next tips it farther: the wheels have to turn back
//! until it is down.

use super::DriveCommand;
use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};

/// How far a body may lean in radians, and by how much more than when it was told to move.
const MOST_LEAN_RAD: f64 = 0.3;
const MORE_LEAN_RAD: f64 = 0.1;
/// A body that leans by no more than this beyond where it began is down again.
const DOWN_AGAIN_RAD: f64 = 0.03;
/// How the wheels turn back: at most so fast, in m/s, and for so long, in seconds: by less than the margin
/// that is kept to edges.
const BACK_MPS: f64 = 0.08;
const BACK_S: f64 = 1.25;

/// Watches how far a robot leans while it does what it is told.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TipGuard {
    /// How far the body leant when it began to move.
    began_rad: f64,
    /// The command in force.
    command: DriveCommand,
    let_down: Option<LetDown>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct LetDown {
    command: DriveCommand,
    until: Arrival,
}

/// What becomes of the command in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tipping {
    /// The body does not tip.
    No,
    /// It does: this instead.
    Back(DriveCommand),
    /// It is down again, or as far down as wheels bring it; what tipped it must not be tried again from here.
    Over,
}

impl Default for TipGuard {
    fn default() -> Self {
        Self { began_rad: 0.0, command: DriveCommand::STOP, let_down: None }
    }
}

impl TipGuard {
    /// Takes in that the body leans by `lean_rad`, the greater of its roll and pitch.
    pub fn watch(&mut self, now: Arrival, lean_rad: f64) -> Tipping {
        if self.let_down.is_none() {
            if self.command.is_stop() {
                self.began_rad = lean_rad;
            }
            if lean_rad <= (self.began_rad + MORE_LEAN_RAD).max(MOST_LEAN_RAD) {
                return Tipping::No;
            }
        }
        let DriveCommand { linear_mps, angular_rps } = self.command;
        let LetDown { command, until } = *self.let_down.get_or_insert(LetDown {
            command: DriveCommand {
                linear_mps: -linear_mps.clamp(-BACK_MPS, BACK_MPS),
                angular_rps: -angular_rps,
            },
            until: now + Span::from_seconds(BACK_S),
        });
        if now < until && lean_rad > self.began_rad + DOWN_AGAIN_RAD {
            return Tipping::Back(command);
        }
        *self = Self::default();
        Tipping::Over
    }

    /// Notes what the robot is told to do next.
    pub fn told(&mut self, command: DriveCommand) {
        self.command = command;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BACK: DriveCommand = DriveCommand { linear_mps: -0.15, angular_rps: 0.0 };

    /// What becomes of a command while the body leans like this, ten times a second.
    fn outcome(leans_rad: &[f64]) -> Vec<Tipping> {
        let mut guard = TipGuard::default();
        let watched = leans_rad.iter().enumerate().map(|(tick, &lean_rad)| {
            let tipping = guard.watch(Arrival::from_seconds(0.1 * tick as f64), lean_rad);
            if tipping == Tipping::No {
                guard.told(BACK);
            }
            tipping
        });
        watched.collect()
    }

    #[test]
    fn wheels_that_tip_the_body_turn_back_until_it_is_down() {
        let ahead = Tipping::Back(DriveCommand { linear_mps: 0.08, angular_rps: 0.0 });
        let tipped = outcome(&[0.2, 0.2, 0.28, 0.38, 0.45, 0.3, 0.22, 0.2]);
        let no = Tipping::No;
        assert_eq!(tipped, [no, no, no, ahead, ahead, ahead, Tipping::Over, no]);
    }

    #[test]
    fn a_body_that_does_not_come_down_is_left_as_it_is() {
        let tipped = outcome(&[&[0.2], &[0.5; 20][..]].concat());
        let over = tipped.iter().position(|it| *it == Tipping::Over);
        assert_eq!(over, Some(14), "{tipped:?}");
        assert_eq!(tipped[15], Tipping::No);
    }

    #[test]
    fn ramps_and_sills_tip_nothing() {
        // Down a ramp; onto a sill and off it; a slope that ends on a steeper one.
        for leans_rad in [&[0.36, 0.36, 0.4, 0.2, 0.0][..], &[0.0, 0.25, 0.29], &[0.3, 0.38]] {
            assert!(outcome(leans_rad).iter().all(|it| *it == Tipping::No), "{leans_rad:?}");
        }
    }
}
