//! What exploration remembers: looks in vain, and goals that failed.

use super::view::{Gain, SECTORS};
use crate::geometry::wrap_pi;
use crate::navigation::Pose2;
use crate::terrain::CellIndex;
use crate::time::{Arrival, Span};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

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

/// What sweeps from one place left unseen of what they seemed to promise, by sector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Shortfall {
    at: Point2<f64>,
    left_m2: [f64; SECTORS],
    looks: [u8; SECTORS],
}

/// Promises that looks did not keep. What a place still seems to show after it was looked at from there
/// more than once is no reason to look from there again: rays over a grid know nothing of rows that are
/// too far apart, of glass, or of a tilt that does not get there.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Shortfalls {
    places: Vec<Shortfall>,
}

/// Looks from within this of one another are looks from one place, in metres.
const SAME_PLACE_M: f64 = 0.3;

impl Shortfalls {
    /// Notes what a place still seems to promise after a sweep there over `field_of_view_rad`.
    pub fn note(&mut self, pose: &Pose2, field_of_view_rad: f64, left: &Gain) {
        let at = pose.point();
        let known = self.places.iter_mut().find(|place| (place.at - at).norm() <= SAME_PLACE_M);
        let place = match known {
            Some(place) => place,
            None => {
                let (left_m2, looks) = ([0.0; SECTORS], [0; SECTORS]);
                self.places.push(Shortfall { at, left_m2, looks });
                let last = self.places.len() - 1;
                &mut self.places[last]
            }
        };
        let sector_rad = TAU / SECTORS as f64;
        let noted = place.left_m2.iter_mut().zip(&mut place.looks).zip(&left.sectors);
        for (sector, ((left_m2, looks), still_m2)) in noted.enumerate() {
            let off_rad = wrap_pi(sector_rad * (sector as f64 + 0.5) - pose.yaw_rad);
            if off_rad.abs() <= 0.5 * (field_of_view_rad + sector_rad) {
                *looks = looks.saturating_add(1);
                *left_m2 = *still_m2;
            }
        }
    }

    /// Takes from `gain` what looks from there did not show: once what was left after the second look,
    /// twice after the third, and so on, for no two rays over the grid are the same.
    pub fn discount(&self, at: &Point2<f64>, gain: &mut Gain) {
        for place in self.places.iter().filter(|place| (place.at - at).norm() <= SAME_PLACE_M) {
            for ((gain_m2, left_m2), looks) in
                gain.sectors.iter_mut().zip(&place.left_m2).zip(&place.looks)
            {
                let times = f64::from(looks.saturating_sub(1));
                *gain_m2 = (*gain_m2 - times * left_m2).max(0.0);
            }
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
    fn what_looks_from_a_place_did_not_show_is_no_reason_to_look_from_there_again() {
        let mut vain = Shortfalls::default();
        let promise = || Gain { sectors: [1.0; SECTORS] };
        let pose = Pose2 { x_m: 1.0, y_m: 2.0, yaw_rad: 0.0 };
        let worth = |vain: &Shortfalls, away_m: f64, towards_rad: f64| {
            let mut gain = promise();
            vain.discount(&Point2::new(1.0 + away_m, 2.0), &mut gain);
            let half = 0.25 * TAU;
            let ahead = |sector: &usize| {
                let bearing_rad = TAU * (*sector as f64 + 0.5) / SECTORS as f64;
                wrap_pi(bearing_rad - towards_rad).abs() <= half
            };
            (0..SECTORS).filter(ahead).map(|sector| gain.sectors[sector]).sum::<f64>()
        };
        assert_eq!(worth(&vain, 0.0, 0.0), 12.0);
        vain.note(&pose, 0.5 * TAU, &promise());
        assert_eq!(worth(&vain, 0.0, 0.0), 12.0, "rows may have been lost: it is looked at again");
        vain.note(&pose, 0.5 * TAU, &promise());
        assert_eq!(worth(&vain, 0.1, 0.0), 0.0);
        assert!(worth(&vain, 0.1, 0.5 * TAU) >= 10.0, "the other side was not looked at");
        assert_eq!(worth(&vain, 0.5, 0.0), 12.0, "nor from another place");
    }

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
