//! What exploration remembers: looks in vain, and goals that failed.

use crate::terrain::CellIndex;
use crate::time::{Arrival, Span};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How often each view cell of the unknown was looked at and nothing came back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Looks {
    // A list, not a map: formats with text keys cannot hold an index as a key.
    #[serde(with = "as_list")]
    counts: BTreeMap<CellIndex, u8>,
}

mod as_list {
    use super::{BTreeMap, CellIndex};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    pub fn serialize<S: Serializer>(
        counts: &BTreeMap<CellIndex, u8>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        counts.iter().collect::<Vec<_>>().serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<BTreeMap<CellIndex, u8>, D::Error> {
        Ok(Vec::<(CellIndex, u8)>::deserialize(deserializer)?.into_iter().collect())
    }
}

impl Looks {
    pub fn note(&mut self, cells: &[CellIndex]) {
        for cell in cells {
            let count = self.counts.entry(*cell).or_default();
            *count = count.saturating_add(1);
        }
    }

    pub fn count(&self, cell: CellIndex) -> u8 {
        self.counts.get(&cell).copied().unwrap_or(0)
    }

    /// What another look is worth, from 1 down: a third for each look in vain.
    pub fn worth(&self, cell: CellIndex) -> f32 {
        match self.count(cell) {
            0 => 1.0,
            count => 0.33_f32.powi(i32::from(count.min(8))),
        }
    }
}

/// A goal that could not be reached, and until when it is left alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedGoal {
    /// Where the goal was.
    pub at: Point2<f64>,
    /// Why it failed.
    pub reason: String,
    /// How often goals here have failed.
    pub times: u32,
    /// When it may be tried again.
    pub until: Arrival,
}

/// Goals that failed. Each keeps only its own surroundings closed, and only for a time: longer after
/// each failure, so that a real frontier is never lost and a hopeless one does not stop the rest.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct FailedGoals {
    goals: Vec<FailedGoal>,
}

impl FailedGoals {
    pub fn note(
        &mut self,
        at: Point2<f64>,
        reason: String,
        now: Arrival,
        base_s: f64,
        radius_m: f64,
    ) {
        let known = self.goals.iter_mut().find(|goal| (goal.at - at).norm() <= radius_m);
        let times = known.as_ref().map_or(1, |goal| goal.times + 1);
        let wait_s = base_s * f64::from(1_u32 << (times - 1).min(3));
        let goal = FailedGoal { at, reason, times, until: now + Span::from_seconds(wait_s) };
        match known {
            Some(known) => *known = goal,
            None => self.goals.push(goal),
        }
    }

    /// The failure that keeps a place closed now, if any.
    pub fn closing(&self, at: &Point2<f64>, now: Arrival, radius_m: f64) -> Option<&FailedGoal> {
        self.goals.iter().find(|goal| now < goal.until && (goal.at - at).norm() <= radius_m)
    }

    pub fn goals(&self) -> &[FailedGoal] {
        &self.goals
    }

    /// When the next closed place opens again.
    pub fn next_opening(&self, now: Arrival) -> Option<Arrival> {
        self.goals.iter().map(|goal| goal.until).filter(|&until| until > now).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failures_expire_and_last_longer_each_time() {
        let mut failed = FailedGoals::default();
        let at = Point2::new(1.0, 2.0);
        let mut now = Arrival(0);
        let mut waits = Vec::new();
        for _ in 0..6 {
            failed.note(at, "no path".into(), now, 60.0, 0.5);
            let opening = failed.next_opening(now).unwrap();
            waits.push((opening - now).seconds());
            assert!(failed.closing(&Point2::new(1.2, 2.0), now, 0.5).is_some());
            assert!(failed.closing(&Point2::new(2.0, 2.0), now, 0.5).is_none());
            assert!(failed.closing(&at, opening, 0.5).is_none(), "it opens again");
            now = opening;
        }
        assert_eq!(waits, [60.0, 120.0, 240.0, 480.0, 480.0, 480.0]);
        assert_eq!(failed.goals().len(), 1);
    }
}
