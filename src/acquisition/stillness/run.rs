//! A run of lines that show the same, and what it proves about the tilt.

use super::agreement::{Agreement, FEWEST, Facing, Seen, sees_through_floor};
use super::{Doubt, Expected};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// A change this many times the tolerance would have been seen for certain.
const CERTAIN: f64 = 2.0;
/// Tilts kept of a run, and how far apart at least, in radians.
const KEPT: usize = 96;
const KEPT_APART_RAD: f64 = 0.004;
/// A travel under this proves nothing, in radians.
const PROOF_RAD: f64 = 0.07;
/// Lines and travel that make a doubt.
const DOUBT_LINES: u32 = 3;
const DOUBT_RAD: f64 = 0.0085;
/// Surfaces count as upright within this of it, in radians.
const UPRIGHT_RAD: f64 = 0.14;
/// Slope of the ranges of a surface seen at a slant of a quarter of a right angle.
const STEEPEST: f64 = 2.5;
/// What a perpendicular found from a slope may be off by, in radians.
const FACING_RAD: f64 = 0.05;

/// Lines that agree with the first of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Run {
    pub first: Seen,
    /// Casting of the earliest line, in one row with them, that agrees with it.
    pub since: Stamp,
    /// Tilt of the line before, by the law, where this run began with a change in sight: the last one
    /// that was seen to be reached.
    pub before_rad: Option<f64>,
    /// The last tilt seen to be reached before, where it began without.
    pub reached_rad: Option<f64>,
    facing: Option<Facing>,
    /// Tilts by the law that later lines still agreed with, at least [`KEPT_APART_RAD`] apart, in order.
    pub tilts_rad: Vec<f64>,
    /// Lines too new for that, and the tilts that the law gives them.
    fresh: Vec<(Stamp, f64)>,
    pub last: Stamp,
    pub lines: u32,
    /// Largest tolerance of the mean logarithm of a range in any comparison.
    tolerance: f64,
    /// Whether all of them hit something straight ahead.
    sees_ahead: bool,
    /// Fewest beams that hit the same in any comparison.
    hits: usize,
    /// Least and greatest tilt by the law at which the floor should have been in sight and was not.
    through_rad: Option<(f64, f64)>,
    /// When, and after how many lines, it was more than any surface could explain.
    pub proven: Option<(Stamp, u32)>,
}

impl Run {
    /// Begun by a line without a change in sight, the tilt having last been seen at `reached_rad`.
    pub fn unchanged(first: Seen, reached_rad: Option<f64>) -> Self {
        Self {
            tilts_rad: Vec::new(),
            fresh: Vec::new(),
            last: first.cast,
            since: first.cast,
            first,
            before_rad: None,
            reached_rad,
            facing: None,
            lines: 1,
            tolerance: 0.0,
            sees_ahead: true,
            hits: usize::MAX,
            through_rad: None,
            proven: None,
        }
    }

    /// Begun by a line that differs from the one before it, of a surface that faces the laser so.
    pub fn changed(first: Seen, facing: Option<Facing>) -> Self {
        Self { facing, ..Self::unchanged(first, None) }
    }

    /// Takes in a line that agrees with the first one; false if it does not.
    pub fn extend(&mut self, seen: &Seen, agreement: Agreement, expected: &Expected) -> bool {
        match agreement {
            Agreement::Same { tolerance } => self.tolerance = self.tolerance.max(tolerance),
            Agreement::Blind { hits } => {
                self.sees_ahead = false;
                self.hits = self.hits.min(hits);
            }
            Agreement::Different | Agreement::Unknown => return false,
        }
        let unsure = expected.unsure;
        self.lines += 1;
        self.last = seen.cast;
        if seen.cast >= self.first.cast + unsure {
            self.fresh.push((seen.cast, seen.tilt_rad));
        }
        let held = self.fresh.partition_point(|&(cast, _)| cast + unsure <= seen.cast);
        for (_, tilt_rad) in self.fresh.drain(..held) {
            let apart = |tilt: &f64| (tilt - tilt_rad).abs() >= KEPT_APART_RAD;
            if self.tilts_rad.len() < KEPT && self.tilts_rad.iter().all(apart) {
                self.tilts_rad.push(tilt_rad);
                let through = |height_m| sees_through_floor(&self.first.line, tilt_rad, height_m);
                if expected.height_m.is_some_and(through) {
                    let (least, most) = self.through_rad.unwrap_or((tilt_rad, tilt_rad));
                    self.through_rad = Some((least.min(tilt_rad), most.max(tilt_rad)));
                }
            }
        }
        if held > 0 && self.proven.is_none() && (self.is_unexplained() || self.is_impossible()) {
            self.proven = Some((seen.cast, self.lines));
        }
        true
    }

    /// Whether any surface ahead would have changed visibly.
    fn is_unexplained(&self) -> bool {
        if !self.sees_ahead || self.travel_rad() < PROOF_RAD {
            return false;
        }
        let (least, most) = (tilts_least(&self.tilts_rad), tilts_most(&self.tilts_rad));
        // Farther away the perpendicular makes a steeper slope, never a flatter one.
        self.least_change(least - 0.3, most + 0.3) >= CERTAIN * self.tolerance
    }

    /// Whether there could be no floor if the tilt had turned, though beams hit something else.
    fn is_impossible(&self) -> bool {
        let hits = self.sees_ahead || self.hits >= FEWEST;
        hits && self.through_rad.is_some_and(|(least, most)| most - least >= PROOF_RAD)
    }

    pub fn travel_rad(&self) -> f64 {
        (tilts_most(&self.tilts_rad) - tilts_least(&self.tilts_rad)).max(0.0)
    }

    /// The tilt in radians at which the joint was last seen to be, by the law.
    pub fn rest_rad(&self) -> f64 {
        // A jump to the first line's tilt may have been cut short anywhere; it began for certain.
        self.before_rad.or(self.unverified_rad()).unwrap_or(self.first.tilt_rad)
    }

    /// Where the joint was last seen to be, if nothing was seen of its way to the first line's tilt.
    fn unverified_rad(&self) -> Option<f64> {
        const WAY_RAD: f64 = 0.035;
        self.reached_rad.filter(|reached| (reached - self.first.tilt_rad).abs() >= WAY_RAD)
    }

    /// Which way it was told to turn when it came to rest: the sign of the angle. Where it was told to
    /// turn back later, as a sweep does that begins beyond a limit, that is not what brought it there.
    pub fn towards(&self) -> f64 {
        let rest_rad = self.rest_rad();
        let away = |tilt: &f64| tilt - rest_rad;
        let left = std::iter::once(&self.first.tilt_rad).chain(&self.tilts_rad);
        left.map(away).find(|away| away.abs() >= KEPT_APART_RAD).map_or(0.0, f64::signum)
    }

    /// The least that the ranges could have changed for a surface whose perpendicular lies between two
    /// tilts: the logarithm of their greatest ratio to the first.
    fn least_change(&self, from_rad: f64, to_rad: f64) -> f64 {
        const STEP_RAD: f64 = 0.004;
        let steps = ((to_rad - from_rad) / STEP_RAD).ceil().max(0.0) as u32;
        (0..=steps)
            .map(|i| self.change(from_rad + STEP_RAD * f64::from(i)))
            .fold(f64::INFINITY, f64::min)
    }

    /// The change for a perpendicular at `perpendicular_rad`; surfaces seen edge on change more.
    fn change(&self, perpendicular_rad: f64) -> f64 {
        const EDGE_ON: f64 = 0.05;
        let log_range = |tilt: f64| -(tilt - perpendicular_rad).cos().max(EDGE_ON).ln();
        let first = self.tilts_rad.first().map_or(0.0, |&tilt| log_range(tilt));
        self.tilts_rad.iter().map(|&tilt| (log_range(tilt) - first).abs()).fold(0.0, f64::max)
    }

    /// Whether an upright surface, and the one that was in sight before, would both have changed.
    pub fn is_doubtful(&self) -> bool {
        if self.proven.is_some() {
            return true;
        }
        // Where nothing is ahead, what is seen to the sides is no proof that the tilt turns.
        if !self.sees_ahead {
            return self.lines >= DOUBT_LINES && self.travel_rad() >= PROOF_RAD;
        }
        let enough = self.lines >= DOUBT_LINES && self.travel_rad() >= DOUBT_RAD;
        let seen = CERTAIN * self.tolerance;
        // Steeper than any surface is seen: the tilt did not turn as the law had it, so that the change
        // says nothing of what is in sight.
        let facing = self.facing.filter(|facing| facing.slope.abs() < STEEPEST);
        let was_in_sight = |facing: Facing| {
            let at = facing.perpendicular_rad;
            self.least_change(at - FACING_RAD, at + FACING_RAD) >= seen
        };
        enough
            && self.least_change(-UPRIGHT_RAD, UPRIGHT_RAD) >= seen
            && facing.is_none_or(was_in_sight)
    }

    /// Whether a line at `tilt_rad` that differs ends a run in which nothing ahead was hit, the tilt having
    /// been seen to turn before and being seen to turn on. Should it have stuck meanwhile, what runs along
    /// the sides lies where it lies whatever the tilt.
    pub fn is_harmless(&self, tilt_rad: f64) -> bool {
        let on = self
            .tilts_rad
            .last()
            .map_or(0.0, |last| (tilt_rad - last) * (last - self.before_rad.unwrap_or(*last)));
        !self.sees_ahead && self.proven.is_none() && on > 0.0
    }

    /// Least and greatest tilt by the law.
    pub fn tilts(&self) -> (f64, f64) {
        let first_rad = self.first.tilt_rad;
        (tilts_least(&self.tilts_rad).min(first_rad), tilts_most(&self.tilts_rad).max(first_rad))
    }

    pub fn doubt(&self) -> Doubt {
        Doubt { first: self.since, last: self.last, travel_rad: self.travel_rad() }
    }
}

fn tilts_least(tilts_rad: &[f64]) -> f64 {
    tilts_rad.iter().copied().fold(f64::INFINITY, f64::min)
}

fn tilts_most(tilts_rad: &[f64]) -> f64 {
    tilts_rad.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}
