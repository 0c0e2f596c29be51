//! Lines that are the same from side to side while the law says that the tilt turns.
//!
//! What lies straight ahead may be upright, or nothing at all; of a whole line some beam or other falls on
//! an edge, a foot of a wall, a pillar, and changes. A tilt that sticks for a moment and comes free shows
//! in that none does, and in a jump at the end.

use super::agreement::{Agreement, FEWEST, Seen, agreement, changed_beams};
use super::{Doubt, Expected};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// Beams that change and are no change yet: something that passes by, far away.
const FEW: usize = 1;
/// Share of the beams that change from one line to the next where much does.
const MUCH: f64 = 0.06;
/// The farthest step of the tilt, in radians, of which that says what the next ones will show, and how
/// many steps as long they are.
const STEP_RAD: f64 = 0.04;
const NEXT_STEPS: f64 = 2.0;
/// Lines, and travel by the law in radians, that should have shown a change: where much changed before
/// and after, and where nothing is ahead.
const LINES: u32 = 3;
const AMID_CHANGE_RAD: f64 = 0.006;
const BLIND_RAD: f64 = 0.055;
/// How far from upright a wall may stand to the robot, in radians, and by how much the logarithm of its
/// range changes where that is seen.
const LEAN_RAD: f64 = 0.05;
const SEEN: f64 = 0.008;

/// Lines alike in all their beams.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Whole {
    first: Seen,
    last: Seen,
    lines: u32,
    /// Lines too new to be held against the tilt, and the tilts that the law gives them.
    fresh: Vec<(Stamp, f64)>,
    /// Least and greatest tilt by the law of the others.
    span_rad: Option<(f64, f64)>,
    /// By how much the tilt turned when much changed before the first of them, in radians.
    amid_change: Option<f64>,
    /// What would have been doubted of lines just before, had much changed after them: a tilt comes free of
    /// its limit slowly.
    pending: Option<Doubt>,
    /// Whether none hits anything ahead, but something to the sides.
    is_blind: bool,
}

impl Whole {
    pub fn begin(first: Seen, amid_change: Option<f64>) -> Self {
        let last = first.clone();
        Self {
            first,
            last,
            lines: 1,
            fresh: Vec::new(),
            span_rad: None,
            amid_change,
            pending: None,
            is_blind: true,
        }
    }

    /// Takes in a line; where it differs, the lines that begin with it, and what is doubted of those
    /// before.
    pub fn extend(&mut self, seen: &Seen, expected: &Expected) -> Option<Doubt> {
        let (changed, _) = changed_beams(&self.first.line, &seen.line);
        if changed > FEW {
            let much = self.much(seen);
            // Of a change over some lines the last may show little.
            let is_short = self.lines <= LINES;
            let pending = self.pending.take().filter(|_| is_short);
            let amid_change = much.or(self.amid_change.filter(|_| is_short));
            let (doubt, pending) = match (self.doubt(much.is_some()), much) {
                (None, Some(_)) => (pending, None),
                (None, None) => (None, self.doubt(true).or(pending)),
                (doubt, _) => (doubt, None),
            };
            *self = Self { pending, ..Self::begin(seen.clone(), amid_change) };
            return doubt;
        }
        self.lines += 1;
        self.is_blind &= matches!(
            agreement(&self.first.line, &seen.line),
            Agreement::Blind { hits } if hits >= FEWEST
        );
        self.last = seen.clone();
        if seen.cast >= self.first.cast + expected.unsure {
            self.fresh.push((seen.cast, seen.tilt_rad));
        }
        let held = self.fresh.partition_point(|&(cast, _)| cast + expected.unsure <= seen.cast);
        for (_, tilt_rad) in self.fresh.drain(..held) {
            let (least, most) = self.span_rad.unwrap_or((tilt_rad, tilt_rad));
            self.span_rad = Some((least.min(tilt_rad), most.max(tilt_rad)));
        }
        None
    }

    /// How far the tilt turned since the last line, in radians, if the line differs from that as a whole
    /// though it was no great way.
    fn much(&self, seen: &Seen) -> Option<f64> {
        let (changed, told) = changed_beams(&self.last.line, &seen.line);
        let step_rad = (seen.tilt_rad - self.last.tilt_rad).abs();
        let is_much = changed > FEW && changed as f64 >= MUCH * told as f64;
        (is_much && step_rad <= STEP_RAD).then_some(step_rad)
    }

    fn travel_rad(&self) -> f64 {
        self.span_rad.map_or(0.0, |(least, most)| most - least)
    }

    /// Whether an upright wall ahead would have changed, as it hardly does about level: in an empty room
    /// nothing else is in sight there.
    fn would_change_upright(&self) -> bool {
        let Some((least, most)) = self.span_rad else { return false };
        [-LEAN_RAD, 0.0, LEAN_RAD].into_iter().all(|lean_rad| {
            let log_range = |tilt_rad: f64| -(tilt_rad - lean_rad).cos().ln();
            let ends = (log_range(least), log_range(most));
            let nearest = log_range(lean_rad.clamp(least, most));
            ends.0.max(ends.1) - nearest >= SEEN
        })
    }

    /// What is doubted if these lines end here, with much of a change or without.
    fn doubt(&self, much: bool) -> Option<Doubt> {
        let least_rad = match (self.is_blind, self.amid_change.filter(|_| much)) {
            (_, Some(step_rad)) => AMID_CHANGE_RAD.max(NEXT_STEPS * step_rad),
            (true, None) => BLIND_RAD,
            (false, None) => return None,
        };
        let tells = self.is_blind || self.would_change_upright();
        let doubted = tells && self.lines >= LINES && self.travel_rad() >= least_rad;
        doubted.then(|| Doubt {
            first: self.first.cast,
            last: self.last.cast,
            travel_rad: self.travel_rad(),
        })
    }

    /// What is doubted as far as these lines go by now.
    pub fn open_doubt(&self) -> Option<Doubt> {
        self.doubt(false)
    }
}
