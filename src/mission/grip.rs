//! How much of a turn by the wheels the robot makes: skid-steered wheels count turns that the ground gives
//! them only in part.

use crate::geometry::wrap_pi;
use serde::{Deserialize, Serialize};

/// How much of the turns that the wheels count the robot makes, as an inertial unit tells, or sweeps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Grip {
    by_wheels_rad: f64,
    told_rad: f64,
}

impl Grip {
    /// Turns by the wheels that must have been seen, and those of which half is forgotten, in radians.
    const PROOF_RAD: f64 = 1.5;
    const LONG_RAD: f64 = 20.0;
    /// Least turn of one increment that says anything, in radians.
    const TURNING_RAD: f64 = 0.01;
    /// Shares that are believed.
    const LEAST: f64 = 0.2;
    const MOST: f64 = 1.5;

    /// Takes in a turn as the wheels count it and as the unit tells it.
    pub(super) fn learn(&mut self, by_wheels_rad: f64, told_rad: f64) {
        if by_wheels_rad.abs() < Self::TURNING_RAD {
            return;
        }
        if self.by_wheels_rad > Self::LONG_RAD {
            self.by_wheels_rad *= 0.5;
            self.told_rad *= 0.5;
        }
        self.by_wheels_rad += by_wheels_rad.abs();
        self.told_rad += told_rad * by_wheels_rad.signum();
    }

    /// Whether enough was seen.
    pub(super) fn is_proven(&self) -> bool {
        self.by_wheels_rad >= Self::PROOF_RAD
    }

    /// The share that the robot makes of a turn by the wheels; all of it while that is not known.
    pub(super) fn share(&self) -> f64 {
        if !self.is_proven() {
            return 1.0;
        }
        (self.told_rad / self.by_wheels_rad).clamp(Self::LEAST, Self::MOST)
    }
}

/// The heading as a sweep told it, and what the wheels alone have turned since.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct SweptTurn {
    known_rad: Option<f64>,
    by_wheels_rad: f64,
    to_and_fro_rad: f64,
}

impl SweptTurn {
    /// Least turn between two sweeps that says anything, in radians, and the share of it that may be turned back.
    const TURNED_RAD: f64 = 0.4;
    const TURNED_BACK: f64 = 0.2;
    /// A heading that few surfaces tell is off by no more than this, in radians: a quarter of a turn beside it, by
    /// which rooms repeat, would be farther off.
    const FEW_TELL_RAD: f64 = 0.6;

    /// Takes in a turn as the wheels count it.
    pub(super) fn add(&mut self, by_wheels_rad: f64) {
        self.by_wheels_rad += by_wheels_rad;
        self.to_and_fro_rad += by_wheels_rad.abs();
    }

    /// Whether the wheels have turned far enough since a heading was told for the next to teach something.
    pub(super) fn is_telling(&self) -> bool {
        self.by_wheels_rad.abs() >= Self::TURNED_RAD
    }

    /// Turns that something else has told say nothing of the wheels.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Takes in the heading that a sweep tells, `None` if it tells none, and whether many surfaces do; teaches
    /// `grip` what the turn since the sweep before was. Of headings that are whole turns apart the one nearest to
    /// what `grip` expects is meant.
    pub(super) fn settle(&mut self, told_rad: Option<f64>, many_tell: bool, grip: &mut Grip) {
        let before = std::mem::take(self);
        let Some(known_rad) = told_rad else { return };
        self.known_rad = many_tell.then_some(known_rad);
        let Some(before_rad) = before.known_rad else { return };
        let expected_rad = grip.share() * before.by_wheels_rad;
        let apart_rad = wrap_pi(known_rad - before_rad - expected_rad);
        if !many_tell && apart_rad.abs() > Self::FEW_TELL_RAD {
            return;
        }
        self.known_rad = told_rad;
        let turned_back_rad = before.to_and_fro_rad - before.by_wheels_rad.abs();
        if before.by_wheels_rad.abs() < Self::TURNED_RAD
            || turned_back_rad > Self::TURNED_BACK * before.to_and_fro_rad
        {
            return;
        }
        grip.learn(before.by_wheels_rad, expected_rad + apart_rad);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sweeps_tell_how_much_of_the_turns_of_its_wheels_a_robot_makes() {
        let (mut grip, mut swept) = (Grip::default(), SweptTurn::default());
        let (mut heading_rad, mut turned_rad) = (0.0, 0.0);
        swept.settle(Some(heading_rad), true, &mut grip);
        for turn_rad in [2.0, -1.4, 3.5] {
            (0..100).for_each(|_| swept.add(0.01 * turn_rad));
            heading_rad = wrap_pi(heading_rad + 0.6 * turn_rad);
            swept.settle(Some(heading_rad), true, &mut grip);
            turned_rad += f64::abs(turn_rad);
            assert!(turned_rad < 1.5 || (grip.share() - 0.6).abs() < 1e-9, "{}", grip.share());
        }
        assert!(grip.is_proven());
    }

    #[test]
    fn turns_to_and_fro_and_headings_that_are_not_sure_teach_nothing() {
        let (mut grip, mut swept) = (Grip::default(), SweptTurn::default());
        swept.settle(Some(0.0), true, &mut grip);
        (0..4).for_each(|at| swept.add(if at % 2 == 0 { 1.0 } else { -0.7 }));
        swept.settle(Some(1.0), true, &mut grip);
        swept.add(2.0);
        swept.settle(None, false, &mut grip);
        swept.add(2.0);
        swept.settle(Some(1.0), true, &mut grip);
        swept.add(2.0);
        swept.settle(Some(1.5), false, &mut grip);
        assert!(!grip.is_proven());
        assert_eq!(grip.share(), 1.0);
    }
}
