//! Which observation is which landmark: joint compatibility by branch and bound.
//!
//! The most telling observations are decided together: a set of pairs is compatible when each fits after
//! the others have corrected the pose (Neira and Tardós, "Data association in stochastic mapping using
//! the joint compatibility test", 2001). The set with most pairs wins; sets of equal size that put the
//! robot elsewhere are handed back beside it. With the pose so corrected the rest is decided one by
//! one.

use super::belief::{Belief, PairRows};
use super::landmark::{Landmark, carried_hull, hulls_meet};
use super::observation::Observation;
use super::shift::Shift;
use nalgebra::{Matrix3, Matrix3x4, Vector3};
use serde::{Deserialize, Serialize};

/// Settings of data association.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AssociationConfig {
    /// Gate on the squared Mahalanobis distance of a pair, χ² with 3 degrees of freedom: 11.345 is
    /// 99 %, 16.266 is 99.9 %. Valid: above 0.
    pub gate: f64,
    /// Up to this distance an observation that misses the gate still may not found a landmark of its
    /// own: it is left out. Valid: at least the gate.
    pub doubt_gate: f64,
    /// Greatest angle between normals in radians, beside what the pose leaves open. Valid: 0 to π/4.
    pub max_angle_rad: f64,
    /// Greatest gap along the normal in metres, beside what the pose leaves open. Valid: above 0.
    pub max_offset_m: f64,
    /// Greatest gap in the plane between two patches of one surface, in metres. A doorway is wider.
    /// Valid: 0 to 0.7.
    pub max_gap_m: f64,
    /// Share of the smaller hull that must overlap. Valid: 0 to 1.
    pub min_overlap_share: f64,
    /// Observations that are decided jointly. Valid: at least 3.
    pub anchors: usize,
    /// Most pairs that the joint search tries. Valid: at least 1.
    pub max_trials: usize,
}

impl Default for AssociationConfig {
    fn default() -> Self {
        Self {
            gate: 16.266,
            doubt_gate: 60.0,
            max_angle_rad: 15_f64.to_radians(),
            max_offset_m: 0.3,
            max_gap_m: 0.4,
            min_overlap_share: 0.1,
            anchors: 10,
            max_trials: 600,
        }
    }
}

/// A scan to be associated: observations, their columns for the scan's common errors, and for each
/// the planes of the belief that it may be.
pub(super) struct Question<'a> {
    pub(super) observations: &'a [Observation],
    pub(super) common: &'a [Option<Matrix3x4<f64>>],
    pub(super) candidates: &'a [Vec<usize>],
    /// The landmark behind each plane of the belief.
    pub(super) landmarks: &'a [&'a Landmark],
}

/// A jointly compatible set of pairs.
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    /// Observation and plane of the belief.
    pub(super) pairs: Vec<(usize, usize)>,
    /// Logarithm of how much better the pairs explain the observations than new planes would.
    pub(super) score: f64,
    /// The same with no pair's tightness counting for more than [`MOST_PER_PAIR`]: what speaks for
    /// this place against another. Built worlds repeat and align their surfaces, so that a pair fits
    /// to the millimetre by chance far more often than planes strewn at random would. What a pair
    /// misses by counts in full: it is what the motion says against the place.
    pub(super) support: f64,
    /// The belief after the pairs.
    pub(super) belief: Belief,
    /// Whether what fits under that belief may be paired. Without it nothing that could be a landmark
    /// is used for anything: the pose stays as predicted.
    pub(super) pairing: bool,
}

impl Assignment {
    /// The explanation that nothing was recognised.
    pub(super) fn none(predicted: &Belief) -> Self {
        Self {
            pairs: Vec::new(),
            score: 0.0,
            support: 0.0,
            belief: predicted.clone(),
            pairing: false,
        }
    }

    /// How it moves the robot beside the planes that it takes for seen.
    pub(super) fn shift_from(&self, predicted: &Belief) -> Shift {
        Shift::between(predicted, &self.belief, self.pairs.iter().map(|pair| pair.1))
    }

    /// Whether it puts the robot well away from where another does, beside the planes that either takes
    /// for seen.
    fn apart_from(&self, other: &Self) -> bool {
        let planes = self.pairs.iter().chain(&other.pairs).map(|pair| pair.1);
        let shift = Shift::between(&self.belief, &other.belief, planes);
        shift.exceeds(APART_M, APART_UP_M, APART_RAD)
    }
}

/// What an observation was found to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Verdict {
    /// A landmark: plane of the belief and squared Mahalanobis distance.
    Seen(usize, f64),
    /// Nothing that is mapped.
    New,
    /// One of several landmarks.
    Ambiguous,
    /// One plane too many for one scan.
    Crowded,
    /// Too far from a landmark to be it, too near to be something else.
    Doubtful(f64),
}

/// Standard deviations of the pose below which further pairs would not change what fits.
const SETTLED_M: f64 = 0.002;
const SETTLED_RAD: f64 = 0.0005;
/// Two assignments differ when they put the robot this far apart.
const APART_M: f64 = 0.10;
const APART_RAD: f64 = 0.03;
/// The same for the height: a kerb is this much higher than the floor beside it.
const APART_UP_M: f64 = 0.03;
/// Most that the tightness of one pair may say for a place. The misfit that a true pair has on average
/// takes 3/2 of it; the rest says that a pair fits by chance once in twenty.
const MOST_PER_PAIR: f64 = 4.5;
/// Logarithm of how much more often a surface in the midst of a map is one of it than one of its own.
const LOG_RECOGNISED: f64 = 2.0;
/// Most assignments that are handed back.
const MOST_ASSIGNMENTS: usize = 4;
/// Difference of the distances of two landmarks below which neither is preferred.
const CLOSE_CALL: f64 = 2.0;

impl Question<'_> {
    fn rows(&self, belief: &Belief, observation: usize, plane: usize) -> PairRows {
        let common = self.common[observation].as_ref();
        belief.pair(&self.observations[observation], common, plane)
    }

    fn absorb(&self, belief: &mut Belief, observation: usize, plane: usize) {
        let common = self.common[observation].as_ref();
        belief.absorb(&self.observations[observation], common, plane);
    }

    /// Whether a pair is worth a test: same side, a gap and an angle that the pose's uncertainty
    /// explains, and patches that meet in the plane.
    fn comparable(
        &self,
        belief: &Belief,
        rows: &PairRows,
        observation: usize,
        plane: usize,
        config: &AssociationConfig,
    ) -> bool {
        let open_offset = 3.5 * rows.s[(0, 0)].max(0.0).sqrt();
        let open_angle = 3.5 * (rows.s[(1, 1)] + rows.s[(2, 2)]).max(0.0).sqrt();
        if rows.angle_rad() > (config.max_angle_rad + open_angle).min(0.8)
            || rows.h.x.abs() > config.max_offset_m + open_offset
        {
            return false;
        }
        self.patches_meet(belief, observation, plane, config)
    }

    fn patches_meet(
        &self,
        belief: &Belief,
        observation: usize,
        plane: usize,
        config: &AssociationConfig,
    ) -> bool {
        let seen = &self.observations[observation];
        let map = self.landmarks[plane];
        let plane_from_observed =
            belief.planes[plane].inverse() * belief.world_from_robot * seen.robot_from_plane;
        let carried = carried_hull(&seen.hull, &plane_from_observed);
        let pose = belief.pose_covariance();
        let reach = seen.robot_from_plane.translation.vector.norm();
        let turn = (pose[(3, 3)] + pose[(4, 4)] + pose[(5, 5)]).max(0.0).sqrt();
        let shift = (pose[(0, 0)] + pose[(1, 1)] + pose[(2, 2)]).max(0.0).sqrt();
        let gap = config.max_gap_m + 2.0 * (shift + reach * turn);
        if !hulls_meet(&map.hull, &carried, config.min_overlap_share, gap) {
            return false;
        }
        map.mask.is_empty()
            || seen.mask.is_empty()
            || map.mask.near(&seen.mask, &plane_from_observed, gap)
    }

    /// The jointly compatible sets of pairs among the most telling observations that put the robot apart,
    /// best first; at least one, which may be empty. Sets that have up to `slack` pairs fewer than the
    /// largest count too: a place may owe its additional pairs to chance.
    pub(super) fn search(
        &self,
        belief: &Belief,
        config: &AssociationConfig,
        slack: usize,
    ) -> Vec<Assignment> {
        let mut anchors: Vec<(usize, Vec<usize>)> = Vec::new();
        for (observation, planes) in self.candidates.iter().enumerate() {
            let fitting: Vec<usize> = planes
                .iter()
                .copied()
                .filter(|&plane| {
                    let rows = self.rows(belief, observation, plane);
                    rows.distance_squared() < config.gate
                        && self.comparable(belief, &rows, observation, plane, config)
                })
                .collect();
            if !fitting.is_empty() {
                anchors.push((observation, fitting));
            }
        }
        let chosen = most_telling(self.observations, &anchors, config.anchors);
        anchors.retain(|(observation, _)| chosen.contains(observation));
        // First those with fewest choices.
        anchors.sort_by_key(|(_, fitting)| fitting.len());
        // Every step copies the belief: only the planes in question go along.
        let mut planes: Vec<usize> =
            anchors.iter().flat_map(|anchor| anchor.1.iter().copied()).collect();
        planes.sort_unstable();
        planes.dedup();
        for plane in anchors.iter_mut().flat_map(|anchor| &mut anchor.1) {
            *plane = planes.partition_point(|known| known < plane);
        }
        let landmarks: Vec<&Landmark> = planes.iter().map(|&plane| self.landmarks[plane]).collect();
        let question = Question { candidates: &[], landmarks: &landmarks, ..*self };
        let mut search = Search {
            question: &question,
            anchors: &anchors,
            config,
            slack,
            trials: 0,
            most: 0,
            found: Vec::new(),
        };
        let start = Assignment { pairing: true, ..Assignment::none(&belief.among(&planes)) };
        search.descend(0, start);
        let mut found = search.found;
        // Not `search.most`: the set with most pairs may have lost its place to a likelier one.
        let most = found.iter().map(|assignment| assignment.pairs.len()).max().unwrap_or(0);
        found.retain(|assignment| assignment.pairs.len() + slack >= most);
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        found.truncate(MOST_ASSIGNMENTS);
        for assignment in &mut found {
            for pair in &mut assignment.pairs {
                pair.1 = planes[pair.1];
            }
            assignment.belief = self.after(belief, &assignment.pairs);
        }
        found
    }

    /// The belief after pairs, taken in one by one until the pose is settled.
    fn after(&self, belief: &Belief, pairs: &[(usize, usize)]) -> Belief {
        let mut after = belief.clone();
        for &(observation, plane) in pairs {
            if settled(&after) {
                break;
            }
            self.absorb(&mut after, observation, plane);
        }
        after
    }

    /// Decides every observation, given the belief after the joint search. Several observations may
    /// be pieces of one landmark: with the pose settled, a piece that fits is a piece.
    pub(super) fn decide(
        &self,
        assignment: &Assignment,
        config: &AssociationConfig,
    ) -> Vec<Verdict> {
        let belief = &assignment.belief;
        (0..self.observations.len())
            .map(|observation| {
                let mut fitting: Vec<(f64, f64, usize)> = Vec::new();
                let mut nearest_miss = f64::INFINITY;
                let mut pulls = false;
                for &plane in &self.candidates[observation] {
                    let rows = self.rows(belief, observation, plane);
                    if !self.comparable(belief, &rows, observation, plane, config) {
                        continue;
                    }
                    let distance = rows.distance_squared();
                    if distance < config.gate {
                        fitting.push((distance + rows.log_determinant(), distance, plane));
                        pulls |= rows.h.x.abs() > APART_M;
                    } else {
                        nearest_miss = nearest_miss.min(distance);
                    }
                }
                fitting.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
                match fitting.as_slice() {
                    // A pair that would take the robot elsewhere was not part of the joint search's
                    // answer: alone it says nothing.
                    [_, ..] if pulls || !assignment.pairing => Verdict::Ambiguous,
                    [] if nearest_miss < config.doubt_gate => Verdict::Doubtful(nearest_miss),
                    [] => Verdict::New,
                    [first, second, ..]
                        if second.0 - first.0 < CLOSE_CALL
                            && !self.same_surface(belief, first.2, second.2) =>
                    {
                        Verdict::Ambiguous
                    }
                    [first, ..] => Verdict::Seen(first.2, first.1),
                }
            })
            .collect()
    }

    /// Observations that an assignment does not take for a plane which they fit, with those planes. To
    /// leave one out is to say that it is another surface.
    pub(super) fn left_out(
        &self,
        assignment: &Assignment,
        config: &AssociationConfig,
    ) -> Vec<(usize, usize)> {
        let belief = &assignment.belief;
        let taken: Vec<usize> = assignment.pairs.iter().map(|pair| pair.0).collect();
        let free = (0..self.observations.len()).filter(|observation| !taken.contains(observation));
        free.flat_map(|observation| {
            self.candidates[observation].iter().map(move |&plane| (observation, plane))
        })
        .filter(|&(observation, plane)| {
            let rows = self.rows(belief, observation, plane);
            // A smaller gap would not have made the search leave it out: it is decided later.
            rows.h.x.abs() > APART_M
                && rows.distance_squared() < config.gate
                && self.comparable(belief, &rows, observation, plane, config)
        })
        .collect()
    }

    /// What observations that are pieces of landmarks say for an assignment beside its pairs, in the measure
    /// of [`Assignment::support`]. A map in which one surface became two landmarks pairs both of its pieces;
    /// that is no reason to believe it more than one in which they are pieces of one.
    pub(super) fn pieces(&self, assignment: &Assignment, config: &AssociationConfig) -> f64 {
        let belief = &assignment.belief;
        let is_free =
            |observation: &usize| assignment.pairs.iter().all(|pair| pair.0 != *observation);
        let of_observation = |observation: usize| {
            let fits = |&plane: &usize| {
                let rows = self.rows(belief, observation, plane);
                let distance = rows.distance_squared();
                let is_piece = distance < config.gate
                    && rows.h.x.abs() < APART_M
                    && self.comparable(belief, &rows, observation, plane, config);
                is_piece.then(|| tempered_ratio(distance, rows.s[(0, 0)], config))
            };
            self.candidates[observation].iter().filter_map(fits).fold(0.0, f64::max)
        };
        (0..self.observations.len()).filter(is_free).map(of_observation).sum()
    }

    /// Normalised innovation squared of all observations that were recognised, jointly, under the
    /// belief before any of them; linearised at the pose that they lead to.
    pub(super) fn joint_nis(&self, before: &Belief, after: &Belief, verdicts: &[Verdict]) -> f64 {
        let (belief, from_pose) = before.linearised_at(&after.world_from_robot);
        let pairs: Vec<(PairRows, usize)> = verdicts
            .iter()
            .enumerate()
            .filter_map(|(observation, verdict)| match *verdict {
                Verdict::Seen(plane, _) => Some((self.rows(&belief, observation, plane), plane)),
                _ => None,
            })
            .collect();
        belief.joint_nis(&pairs, &from_pose)
    }

    /// Whether two planes of the belief are pieces of one surface as far as a scan can tell, so that
    /// it does not matter much which of them is seen.
    fn same_surface(&self, belief: &Belief, a: usize, b: usize) -> bool {
        let (first, second) = (&belief.planes[a], &belief.planes[b]);
        let relative = first.inverse() * second;
        let angle = (relative.rotation * Vector3::z()).angle(&Vector3::z());
        angle < 0.02 && relative.translation.vector.z.abs() < 0.02
    }
}

/// Area beside which others facing the same way add little, in m².
const TELLING_M2: f64 = 1.0;

/// The observations that together say most about where the robot is: large ones, and small ones that
/// face where no large one does. Along a corridor a pilaster says more than a third piece of its walls.
fn most_telling(
    observations: &[Observation],
    among: &[(usize, Vec<usize>)],
    count: usize,
) -> Vec<usize> {
    let mut left: Vec<usize> = among.iter().map(|anchor| anchor.0).collect();
    let mut chosen = Vec::new();
    let mut known = Matrix3::identity() * TELLING_M2;
    while chosen.len() < count {
        let Some(spread) = known.try_inverse() else { break };
        let gain = |observation: usize| {
            let normal = observations[observation].normal();
            observations[observation].area_m2() * normal.dot(&(spread * normal))
        };
        // The first of equals.
        let best = (0..left.len()).rev().max_by(|&a, &b| gain(left[a]).total_cmp(&gain(left[b])));
        let Some(best) = best else { break };
        let observation = left.remove(best);
        let normal = observations[observation].normal();
        known += normal * normal.transpose() * observations[observation].area_m2();
        chosen.push(observation);
    }
    chosen
}

struct Search<'a> {
    question: &'a Question<'a>,
    anchors: &'a [(usize, Vec<usize>)],
    config: &'a AssociationConfig,
    slack: usize,
    trials: usize,
    /// Pairs of the largest set so far.
    most: usize,
    /// The best set of each place.
    found: Vec<Assignment>,
}

impl Search<'_> {
    fn descend(&mut self, depth: usize, so_far: Assignment) {
        let reachable = so_far.pairs.len() + self.anchors.len() - depth;
        // The first descent always ends: only alternatives to it are given up.
        let given_up = self.trials > self.config.max_trials && !self.found.is_empty();
        if reachable + self.slack < self.most || given_up {
            return;
        }
        let Some((observation, planes)) = self.anchors.get(depth) else {
            self.file(so_far);
            return;
        };
        let mut fitting: Vec<(f64, usize, PairRows)> = Vec::new();
        for &plane in planes {
            if so_far.pairs.iter().any(|pair| pair.1 == plane) {
                continue;
            }
            self.trials += 1;
            let rows = self.question.rows(&so_far.belief, *observation, plane);
            let distance = rows.distance_squared();
            if distance < self.config.gate
                && self.question.comparable(&so_far.belief, &rows, *observation, plane, self.config)
            {
                fitting.push((distance, plane, rows));
            }
        }
        fitting.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (i, (distance, plane, rows)) in fitting.iter().enumerate() {
            // Pieces of one surface put the robot in one place: trying one of them is enough.
            let belief = &so_far.belief;
            if fitting[..i].iter().any(|known| self.question.same_surface(belief, known.1, *plane))
            {
                continue;
            }
            let (distance, plane) = (*distance, *plane);
            let mut next = so_far.clone();
            next.pairs.push((*observation, plane));
            let log_determinant = rows.log_determinant();
            next.score += log_ratio(distance, log_determinant, self.config);
            next.support += tempered_ratio(distance, rows.s[(0, 0)], self.config);
            if !settled(&next.belief) {
                self.question.absorb(&mut next.belief, *observation, plane);
            }
            self.descend(depth + 1, next);
        }
        self.descend(depth + 1, so_far);
    }

    /// Keeps a set when it is the best of its place.
    fn file(&mut self, set: Assignment) {
        self.most = self.most.max(set.pairs.len());
        match self.found.iter_mut().find(|known| !known.apart_from(&set)) {
            Some(known) if known.score >= set.score => {}
            Some(known) => *known = set,
            None => self.found.push(set),
        }
    }
}

/// How much better a landmark explains an observation than a plane that was never seen, which might
/// lie anywhere within the limits of a comparison.
fn log_ratio(distance_squared: f64, log_determinant: f64, config: &AssociationConfig) -> f64 {
    let window = 2.0 * config.max_offset_m * (2.0 * config.max_angle_rad).powi(2);
    let normaliser = 3.0 * std::f64::consts::TAU.ln() + log_determinant;
    window.ln() - 0.5 * (distance_squared + normaliser)
}

/// How much better a landmark explains an observation than another plane that faces the same way: built
/// worlds have few directions, so that only the distance tells surfaces apart, whose variance before the
/// pair is `variance_m2`. Its tightness is limited and its misfit counts in full. Limiting the whole
/// would make explanations equal that differ by what odometry has to be wrong by: a robot beside a stair
/// could be a step higher, with the floor for the first tread.
fn tempered_ratio(distance_squared: f64, variance_m2: f64, config: &AssociationConfig) -> f64 {
    let window_m = 2.0 * config.max_offset_m;
    let tightness = (window_m / (std::f64::consts::TAU * variance_m2).sqrt()).ln();
    (LOG_RECOGNISED + tightness).min(MOST_PER_PAIR) - 0.5 * distance_squared
}

fn settled(belief: &Belief) -> bool {
    let p = belief.pose_covariance();
    (0..3).all(|i| p[(i, i)] < SETTLED_M * SETTLED_M)
        && (3..6).all(|i| p[(i, i)] < SETTLED_RAD * SETTLED_RAD)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misfit_speaks_against_a_place_however_tight_the_pair() {
        let config = AssociationConfig::default();
        // An offset to a thousandth: beyond what tightness may say.
        let (fits, misses) =
            (tempered_ratio(0.0, 1e-6, &config), tempered_ratio(9.0, 1e-6, &config));
        assert!((fits - MOST_PER_PAIR).abs() < 1e-12);
        assert!((fits - misses - 4.5).abs() < 1e-12);
    }

    #[test]
    fn a_surface_that_is_parallel_says_little_while_its_distance_is_open() {
        let config = AssociationConfig::default();
        // A stair's tread 0.18 m up, for a robot on a ramp whose height is open by 0.09 m.
        let variance_m2 = 0.09 * 0.09;
        let open = tempered_ratio(0.18 * 0.18 / variance_m2, variance_m2, &config);
        assert!(open < 0.5 * tempered_ratio(3.0, 1e-6, &config), "{open}");
    }
}
