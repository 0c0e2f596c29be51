//! Lines that are the same from side to side while the law says that the tilt turns.
//!
//! What lies straight ahead may be upright, or nothing at all; of a whole line some beam or other falls on
//! an edge, a foot of a wall, a pillar, and changes. A tilt that sticks for a moment and comes free shows
//! in that none does.
//!
//! If something is hit ahead, an upright wall is what changes least: the logarithm of its range by
//! `ln cos` of the tilt against level, so that nothing is told near that. Where nothing is ahead, only a
//! long way without a change tells, or a shorter one between two changes of much of the line.

use super::agreement::{Agreement, Changes, FEW, FEWEST, Seen, agreement, telling};
use super::{Doubt, Expected};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Share of the beams that change from one line to the next where much does.
const MUCH: f64 = 0.06;
/// The farthest step of the tilt, in radians, of which that says what the next ones will show, and how
/// many steps as long they are.
const STEP_RAD: f64 = 0.04;
const NEXT_STEPS: f64 = 4.0;
/// Of this many beams that tell, one may fall on an edge, where the noise changes it.
const EDGES: usize = 10;
/// Lines, and travel by the law in radians, that should have shown a change: ahead or where much changed
/// before and after, and where nothing is ahead.
const LINES: u32 = 3;
const TRAVEL_RAD: f64 = 0.006;
const AMID_CHANGE_RAD: f64 = 0.015;
const BLIND_RAD: f64 = 0.055;
/// How far from upright a wall may stand, in radians, and by how many times what a beam tells its range
/// changes where several are sure to show it.
const LEAN_RAD: f64 = 0.05;
const CERTAIN: f64 = 2.0;

/// Lines alike in all their beams.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Whole {
    pub first: Seen,
    last: Seen,
    lines: u32,
    /// Least and greatest tilt by the law of all lines but the first, as far as it is sure.
    others_rad: Option<(f64, f64)>,
    level_rad: f64,
    /// Beams that changed with the tilt just before: they would again.
    telling: Vec<usize>,
    /// What the logarithm of a range may differ by, or that of theirs on average.
    tolerance: f64,
    /// By how much the tilt turned when much changed before the first of them, in radians.
    amid_change: Option<f64>,
    /// Whether none hits anything ahead, but something to the sides.
    is_blind: bool,
}

impl Whole {
    pub fn begin(first: Seen, telling: Vec<usize>) -> Self {
        let last = first.clone();
        Self {
            first,
            telling,
            last,
            lines: 1,
            others_rad: None,
            level_rad: 0.0,
            tolerance: 0.0,
            amid_change: None,
            is_blind: true,
        }
    }

    /// Takes in a line that came after those of `before`, the newest last; where it differs, the lines that
    /// begin with it, and what is doubted of those before.
    pub fn extend(
        &mut self,
        seen: &Seen,
        before: &VecDeque<Seen>,
        expected: &Expected,
    ) -> Option<Doubt> {
        // The line before may tell what the first does not: past the corner where a floor ends at a wall the
        // ranges come down again to where they were.
        let (first, last) =
            (self.change_from(&self.first, seen), self.change_from(&self.last, seen));
        let (Some(tolerance), Some(_)) = (first, last) else {
            return self.begin_anew(seen, before);
        };
        self.lines += 1;
        self.is_blind &= self.telling.is_empty()
            && matches!(
                agreement(&self.first.line, &seen.line),
                Agreement::Blind { hits } if hits >= FEWEST
            );
        self.tolerance = self.tolerance.max(tolerance);
        self.level_rad = expected.level_rad;
        self.last = seen.clone();
        // Of the way between two lines that much is sure which their uncertain parts leave.
        let (least, most) = self.others_rad.unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
        self.others_rad = Some((least.min(seen.span_rad.1), most.max(seen.span_rad.0)));
        None
    }

    /// What the logarithm of a range may differ by where a line is the same as an earlier one; `None` where it
    /// is not.
    fn change_from(&self, earlier: &Seen, seen: &Seen) -> Option<f64> {
        let changes = Changes::between(&earlier.line, &seen.line);
        let (crept, tolerance) = match self.telling.is_empty() {
            true => (false, changes.tolerance()),
            false => Changes::of_beams(&earlier.line, &seen.line, &self.telling),
        };
        // Where many beams should have changed, and on average did not, some at edges are no change.
        let few = FEW.max(self.telling.len() / EDGES);
        (!crept && changes.changed <= few).then_some(tolerance)
    }

    fn begin_anew(&mut self, seen: &Seen, before: &VecDeque<Seen>) -> Option<Doubt> {
        let changes = Changes::between(&self.last.line, &seen.line);
        let much = self.much(seen, &changes);
        // Of a change over some lines the last may show little.
        let amid_before = self.amid_change.filter(|_| self.lines <= LINES);
        // What a tilt that stood for long sees when it comes free lies in the middle of its view.
        let from_afar = self.is_blind && changes.comes_from_afar();
        let doubt = self.doubt(much.is_some()).filter(|_| !from_afar);
        let anew = Self::begin(seen.clone(), telling(before.iter(), seen));
        *self = Self { amid_change: much.or(amid_before), ..anew };
        doubt
    }

    /// How far the tilt turned since the last line, in radians, if the line differs from that as a whole
    /// though it was no great way.
    fn much(&self, seen: &Seen, changes: &Changes) -> Option<f64> {
        let step_rad = (seen.tilt_rad - self.last.tilt_rad).abs();
        let changed = changes.changed;
        let is_much = changed > FEW && changed as f64 >= MUCH * changes.told as f64;
        (is_much && step_rad <= STEP_RAD).then_some(step_rad)
    }

    /// Least and greatest tilt by the law that are sure, in radians.
    fn ends_rad(&self) -> (f64, f64) {
        let (least, most) = self.others_rad.unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
        let (first_least, first_most) = self.first.span_rad;
        (least.min(first_most), most.max(first_least))
    }

    fn travel_rad(&self) -> f64 {
        let (least, most) = self.ends_rad();
        (most - least).max(0.0)
    }

    /// Whether an upright wall ahead would have changed, as it hardly does about level: in an empty room
    /// nothing else is in sight there. One that leans so that the tilt passes its perpendicular half way, or
    /// looks so because the laser sits above the tilt's axle, changes least.
    fn would_change_upright(&self) -> bool {
        let (least, most) = self.ends_rad();
        if least >= most {
            return false;
        }
        let (leans_back, leans_over) = (self.level_rad - LEAN_RAD, self.level_rad + LEAN_RAD);
        let facing_rad = (0.5 * (least + most)).clamp(leans_back, leans_over);
        let log_range = |tilt_rad: f64| -(tilt_rad - facing_rad).cos().max(0.05).ln();
        let nearest = log_range(facing_rad.clamp(least, most));
        log_range(least).max(log_range(most)) - nearest >= CERTAIN * self.tolerance
    }

    /// What is doubted if these lines end here, with much of a change or without.
    fn doubt(&self, much: bool) -> Option<Doubt> {
        let travel_rad = self.travel_rad();
        let several = self.lines >= LINES;
        let doubted = match (self.is_blind, self.amid_change.filter(|_| much)) {
            (false, _) => several && travel_rad >= TRAVEL_RAD && self.would_change_upright(),
            (true, Some(step_rad)) if several => {
                travel_rad >= AMID_CHANGE_RAD.max(NEXT_STEPS * step_rad)
            }
            (true, _) => travel_rad >= BLIND_RAD,
        };
        let (first, last) = (self.first.cast, self.last.cast);
        doubted.then_some(Doubt { first, last, travel_rad })
    }

    /// Whether they are alike though the tilt should have turned, as soon as it is sure that it should.
    pub fn is_undecided(&self) -> bool {
        let turned = (self.last.tilt_rad - self.first.tilt_rad).abs() >= TRAVEL_RAD;
        !self.telling.is_empty() && self.lines > 1 && turned && self.open_doubt().is_none()
    }

    /// What is doubted as far as these lines go by now.
    pub fn open_doubt(&self) -> Option<Doubt> {
        self.doubt(false)
    }
}
