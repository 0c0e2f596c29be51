//! Columns and balls that are known by how they stand to one another.
//!
//! In a hall that has no walls in sight each column by itself could be one of several, as far as odometry tells;
//! three that stand to one another as three of the map do are those, where no other motion brings nearly as many
//! together.

use super::{Arrival, Estimate};
use crate::geometry::wrap_pi;
use nalgebra::{Matrix3, Rotation2, Vector2, Vector3};

/// Fewest that are a constellation, and so where wheels have slipped.
const FEWEST: usize = 3;
const MANY: usize = 4;
/// How far a curve may lie from its landmark once the motion is found, and how much two distances may differ, in
/// metres.
const APART_M: f64 = 0.1;
/// How exactly the distances of a row are the same, in metres: it need not be built to the centimetre.
const REPEATED_M: f64 = 0.3;
/// Two that stand nearer to each other than this tell no heading, in metres.
const BASE_M: f64 = 0.5;
/// 99.9 % of χ² with three degrees of freedom: what the pose may be off by.
const GATE: f64 = 16.27;
/// The same where wheels have slipped, by three times as much.
const WIDE_GATE: f64 = 9.0 * GATE;
/// Motions within this are one, and so many fewer curves make another one a rival.
const SAME_M: f64 = 0.2;
const SAME_RAD: f64 = 0.05;
const RIVAL_BY: usize = 1;
/// Curves that are looked at, the nearest: pairs of pairs are tried.
const MOST: usize = 10;

/// A motion over the ground about where the robot is held to be: (x, y, turn), in the world.
struct Motion {
    state: Vector3<f64>,
    /// Index of each curve that it brings to a landmark, with that.
    pairs: Vec<(usize, usize)>,
    /// Sum of the squared distances that are left, in m².
    squares_m2: f64,
}

impl Motion {
    fn is_like(&self, other: &Self) -> bool {
        let apart = self.state - other.state;
        apart.xy().norm() < SAME_M && wrap_pi(apart.z).abs() < SAME_RAD
    }
}

/// A curve of the scan, from where the robot is held to be, and the landmarks that it may be.
struct Seen {
    index: usize,
    arm: Vector2<f64>,
    options: Vec<(usize, Vector2<f64>)>,
}

impl Estimate {
    /// The `pending` curves of the newest scan that stand to one another as landmarks do, with these: as near as
    /// odometry has them, or, if there are more of them, where it would have slipped.
    pub(super) fn constellation(
        &self,
        arrival: &Arrival<'_>,
        pending: &[usize],
    ) -> Vec<(usize, usize)> {
        let pose = self.last_pose();
        let covariance = self.last_covariance();
        let level = [0, 1, 5];
        let spread = Matrix3::from_fn(|i, j| covariance[(level[i], level[j])]);
        let Some(information) = spread.try_inverse() else { return Vec::new() };
        let here = pose.translation.vector.xy();
        let mut seen: Vec<Seen> = pending
            .iter()
            .map(|&index| {
                let curve = &arrival.scan.curves[index];
                let arm = (pose * curve.robot_from_curve).translation.vector.xy() - here;
                let at = |slot: usize| self.curves[slot].world_from_curve.translation.vector.xy();
                let options = self.curve_candidates(curve).map(|slot| (slot, at(slot) - here));
                Seen { index, arm, options: options.collect() }
            })
            .collect();
        seen.sort_by(|a, b| a.arm.norm().total_cmp(&b.arm.norm()));
        seen.truncate(MOST);
        let away = |state: &Vector3<f64>| state.dot(&(information * state));
        let motions = motions(&seen, |state| away(state) < WIDE_GATE);
        let told = motions.iter().filter(|motion| away(&motion.state) < GATE).collect();
        let as_told = self.one_of(told, FEWEST, |state| away(state) < GATE);
        as_told
            .or_else(|| {
                self.one_of(motions.iter().collect(), MANY, |state| away(state) < WIDE_GATE)
            })
            .unwrap_or_default()
    }

    /// The pairs of the motion that brings most together, so many at least, if it has no rival among the others nor,
    /// where the robot `may_be`, in the way in which its landmarks stand.
    fn one_of(
        &self,
        motions: Vec<&Motion>,
        fewest: usize,
        may_be: impl Fn(&Vector3<f64>) -> bool,
    ) -> Option<Vec<(usize, usize)>> {
        let better = |a: &&&Motion, b: &&&Motion| {
            let count = a.pairs.len().cmp(&b.pairs.len());
            count.then(b.squares_m2.total_cmp(&a.squares_m2))
        };
        let best = *motions.iter().max_by(better)?;
        let rivals = |other: &&Motion| {
            !other.is_like(best) && other.pairs.len() + RIVAL_BY >= best.pairs.len()
        };
        if best.pairs.len() < fewest || motions.iter().any(rivals) {
            return None;
        }
        let place =
            |pair: &(usize, usize)| self.curves[pair.1].world_from_curve.translation.vector.xy();
        let places: Vec<Vector2<f64>> = best.pairs.iter().map(place).collect();
        let is_open = |way: &Vector2<f64>| may_be(&(best.state + Vector3::new(way.x, way.y, 0.0)));
        (!repeats(&places, is_open)).then(|| best.pairs.clone())
    }
}

/// Whether places look like themselves from where the robot may as well be: of a row or a grid more columns may stand
/// than any scan has shown.
fn repeats(places: &[Vector2<f64>], is_open: impl Fn(&Vector2<f64>) -> bool) -> bool {
    let ways = places.iter().flat_map(|a| places.iter().map(move |b| b - a));
    ways.filter(|way| way.norm() > BASE_M && is_open(way)).any(|way| {
        let lands = |place: &&Vector2<f64>| {
            places.iter().any(|other| (*place + way - other).norm() < REPEATED_M)
        };
        places.iter().filter(lands).count() >= 2
    })
}

/// The motions that bring some two curves to some two landmarks and that the robot `may_be` off by.
fn motions(seen: &[Seen], may_be: impl Fn(&Vector3<f64>) -> bool) -> Vec<Motion> {
    let mut motions = Vec::new();
    for (at, first) in seen.iter().enumerate() {
        for second in &seen[at + 1..] {
            let pairs =
                first.options.iter().flat_map(|a| second.options.iter().map(move |b| (a, b)));
            for ((_, a), (_, b)) in pairs.filter(|(a, b)| a.0 != b.0) {
                let Some((turn, way)) = motion_of([&first.arm, &second.arm], [a, b]) else {
                    continue;
                };
                let state = Vector3::new(way.x, way.y, turn.angle());
                if may_be(&state) {
                    motions.push(brought_together(seen, &turn, &way, state));
                }
            }
        }
    }
    motions
}

/// The turn and the way that bring two places to two others as far from each other.
fn motion_of(
    from: [&Vector2<f64>; 2],
    to: [&Vector2<f64>; 2],
) -> Option<(Rotation2<f64>, Vector2<f64>)> {
    let (base, mapped) = (from[1] - from[0], to[1] - to[0]);
    if base.norm() < BASE_M || (mapped.norm() - base.norm()).abs() > APART_M {
        return None;
    }
    let turn = Rotation2::rotation_between(&base, &mapped);
    Some((turn, 0.5 * ((to[0] + to[1]) - turn * (from[0] + from[1]))))
}

/// Which curves a motion brings to landmarks, each landmark for one of them.
fn brought_together(
    seen: &[Seen],
    turn: &Rotation2<f64>,
    way: &Vector2<f64>,
    state: Vector3<f64>,
) -> Motion {
    let mut gaps: Vec<(f64, usize, usize)> = seen
        .iter()
        .flat_map(|curve| {
            let moved = turn * curve.arm + way;
            let gap =
                move |(slot, at): &(usize, Vector2<f64>)| ((at - moved).norm(), curve.index, *slot);
            curve.options.iter().map(gap)
        })
        .filter(|(gap_m, ..)| *gap_m < APART_M)
        .collect();
    gaps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut motion = Motion { state, pairs: Vec::new(), squares_m2: 0.0 };
    for (gap_m, index, slot) in gaps {
        if motion.pairs.iter().all(|pair| pair.0 != index && pair.1 != slot) {
            motion.pairs.push((index, slot));
            motion.squares_m2 += gap_m * gap_m;
        }
    }
    motion
}
