//! Which observation is which landmark: joint compatibility by branch and bound.
//!
//! The most telling observations are decided together, see [`joint_search`](super::joint_search). With
//! the pose so corrected the rest is decided one by one.

use super::belief::{Belief, PairRows};
use super::innovation::Innovation;
use super::landmark::{Landmark, carried_hull, hulls_meet};
use super::mask::MASK_CELL_M;
use super::observation::Observation;
use super::scan_errors::CommonColumns;
use super::shift::Shift;
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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
    pub(super) common: &'a [Option<CommonColumns<3>>],
    pub(super) candidates: &'a [Vec<usize>],
    /// Of each observation's mask the cells that are looked at.
    pub(super) samples: &'a [Vec<Point2<f64>>],
    /// The landmark behind each plane of the belief.
    pub(super) landmarks: &'a [&'a Landmark],
}

/// A jointly compatible set of pairs.
#[derive(Clone, Debug)]
pub(super) struct Assignment {
    /// Observation and plane of the belief.
    pub(super) pairs: Vec<(usize, usize)>,
    /// Logarithm of how much better the pairs explain the observations than new planes would, with no
    /// pair's tightness counting for more than [`MOST_PER_PAIR`]: what speaks for this place against
    /// another. Built worlds repeat and align their surfaces, so that a pair fits
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
        Self { pairs: Vec::new(), support: 0.0, belief: predicted.clone(), pairing: false }
    }

    /// The plane of the belief that an observation is taken for.
    pub(super) fn plane_of(&self, observation: usize) -> Option<usize> {
        self.pairs.iter().find(|pair| pair.0 == observation).map(|pair| pair.1)
    }

    /// Whether any observation is taken for a plane of the belief.
    pub(super) fn shows(&self, plane: usize) -> bool {
        self.pairs.iter().any(|pair| pair.1 == plane)
    }

    /// How it moves the robot beside the planes that it takes for seen.
    pub(super) fn shift_from(&self, predicted: &Belief) -> Shift {
        Shift::between(predicted, &self.belief, self.pairs.iter().map(|pair| pair.1))
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
/// Standard deviation of an offset up to which a patch beside a landmark may be another piece of it. A panel
/// on a wall is a few centimetres thick.
const BESIDE_M: f64 = 0.006;
/// Gate of a further piece of a plane, χ² with 3 degrees of freedom at 95 %: beside a surface there is as often
/// another one a few millimetres off, and a piece that is left out costs nothing.
const PIECE_GATE: f64 = 7.815;
/// Two assignments differ when they put the robot this far apart.
pub(super) const APART_M: f64 = 0.10;
/// Most that the tightness of one pair may say for a place. The misfit that a true pair has on average
/// takes 3/2 of it; the rest says that a pair fits by chance once in twenty.
pub(super) const MOST_PER_PAIR: f64 = 4.5;
/// Logarithm of how much more often a surface in the midst of a map is one of it than one of its own.
const LOG_RECOGNISED: f64 = 2.0;
/// How many times as much of a patch must lie on one of several landmarks as on any other.
pub(super) const LIES_ON: f64 = 2.0;
/// Difference of the distances of two landmarks below which neither is preferred.
const CLOSE_CALL: f64 = 2.0;

impl Question<'_> {
    pub(super) fn rows(&self, belief: &Belief, observation: usize, plane: usize) -> PairRows {
        let common = self.common[observation].as_ref();
        belief.pair(&self.observations[observation], common, plane)
    }

    pub(super) fn absorb(&self, belief: &mut Belief, observation: usize, plane: usize) {
        let common = self.common[observation].as_ref();
        belief.absorb(&self.observations[observation], common, plane);
    }

    /// Whether a pair is worth a test: same side, a gap and an angle that the pose's uncertainty
    /// explains, and patches that meet in the plane.
    pub(super) fn comparable(
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
        // That a surface goes on beyond a gap is told from its offset alone: it must be known better than
        // panels are thick.
        let goes_on = rows.s[(0, 0)] < BESIDE_M * BESIDE_M;
        self.patches_meet(belief, observation, plane, config)
            && (goes_on || self.patches_overlap(belief, observation, plane))
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
        let plane_from_observed = self.plane_from_observed(belief, observation, plane);
        let carried = carried_hull(&seen.hull, &plane_from_observed);
        let (shift_m2, turn_rad2) = belief.pose_spread();
        let gap = config.max_gap_m + self.open_m(observation, shift_m2, turn_rad2);
        if !hulls_meet(&map.hull, &carried, config.min_overlap_share, gap) {
            return false;
        }
        map.mask.is_empty()
            || seen.mask.is_empty()
            || map.mask.near(&self.samples[observation], &plane_from_observed, gap)
    }

    /// Whether one of two patches lies where the other one is, as far as the place within the plane is known.
    pub(super) fn patches_overlap(
        &self,
        belief: &Belief,
        observation: usize,
        plane: usize,
    ) -> bool {
        let (shift_m2, turn_rad2) = belief.spread_within(plane);
        let open_m = self.open_m(observation, shift_m2, turn_rad2);
        self.patches_overlap_within(belief, observation, plane, open_m)
    }

    /// The same where either may lie up to `open_m` elsewhere: where they are believed to be some part of one
    /// is well within the other one, or half of one can be.
    pub(super) fn patches_overlap_within(
        &self,
        belief: &Belief,
        observation: usize,
        plane: usize,
        open_m: f64,
    ) -> bool {
        let (own, others) = (&self.observations[observation].mask, &self.landmarks[plane].mask);
        let samples = &self.samples[observation];
        let others_from_own = self.plane_from_observed(belief, observation, plane);
        own.is_empty()
            || others.is_empty()
            || others.surrounds(samples, &others_from_own, MASK_CELL_M)
            || others.covers(samples, &others_from_own, open_m)
            || own.covers(&others.samples(), &others_from_own.inverse(), open_m)
    }

    /// Share of a patch that lies on cells of a landmark that were hit.
    pub(super) fn share_on(&self, belief: &Belief, observation: usize, plane: usize) -> f64 {
        let (samples, mask) = (&self.samples[observation], &self.landmarks[plane].mask);
        let plane_from_observed = self.plane_from_observed(belief, observation, plane);
        let is_on = |sample: &&Point2<f64>| {
            mask.contains(&(plane_from_observed * Point3::new(sample.x, sample.y, 0.0)).xy())
        };
        samples.iter().filter(is_on).count() as f64 / samples.len().max(1) as f64
    }

    fn plane_from_observed(
        &self,
        belief: &Belief,
        observation: usize,
        plane: usize,
    ) -> Isometry3<f64> {
        let robot_from_plane = self.observations[observation].robot_from_plane;
        belief.planes[plane].inverse() * belief.world_from_robot * robot_from_plane
    }

    /// How far a patch may lie from where it is believed to be, by the variances of the pose.
    fn open_m(&self, observation: usize, shift_m2: f64, turn_rad2: f64) -> f64 {
        let reach = self.observations[observation].robot_from_plane.translation.vector.norm();
        2.0 * (shift_m2.max(0.0).sqrt() + reach * turn_rad2.max(0.0).sqrt())
    }

    /// Decides every observation, given the belief after the joint search. Several observations may
    /// be pieces of one landmark: with the pose settled, a piece that fits is a piece, if it lies in one
    /// plane with those before it. A landmark that was hardly seen is open enough for pieces of several
    /// surfaces, each by itself; the scan that shows them side by side knows better. The joint search's
    /// own pairs come first, then what has most points.
    pub(super) fn decide(
        &self,
        assignment: &Assignment,
        config: &AssociationConfig,
    ) -> Vec<Verdict> {
        let mut order: Vec<usize> = (0..self.observations.len()).collect();
        let is_paired = |&observation: &usize| assignment.plane_of(observation).is_some();
        order.sort_by_key(|observation| {
            let points = self.observations[*observation].points;
            (!is_paired(observation), std::cmp::Reverse(points), *observation)
        });
        let mut verdicts = vec![Verdict::New; self.observations.len()];
        let mut pieces: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for observation in order {
            let verdict = self.verdict(observation, assignment, &pieces, config);
            if let Verdict::Seen(plane, _) = verdict {
                pieces.entry(plane).or_default().push(observation);
            }
            verdicts[observation] = verdict;
        }
        verdicts
    }

    /// What one observation is; `pieces` are the observations of each plane so far.
    fn verdict(
        &self,
        observation: usize,
        assignment: &Assignment,
        pieces: &BTreeMap<usize, Vec<usize>>,
        config: &AssociationConfig,
    ) -> Verdict {
        let belief = &assignment.belief;
        let mut fitting: Vec<(f64, f64, usize)> = Vec::new();
        let mut nearest_miss = f64::INFINITY;
        let mut pulls = false;
        for &plane in &self.candidates[observation] {
            let rows = self.rows(belief, observation, plane);
            if !self.comparable(belief, &rows, observation, plane, config) {
                continue;
            }
            let distance = rows.distance_squared();
            let beside = pieces.get(&plane).map_or(&[][..], Vec::as_slice);
            let apart = beside.iter().map(|&other| self.apart(observation, other));
            let misfit = apart.fold(distance, f64::max);
            let gate = if beside.is_empty() { config.gate } else { config.gate.min(PIECE_GATE) };
            if misfit < gate {
                fitting.push((distance + rows.log_determinant(), distance, plane));
                pulls |= rows.h.x.abs() > APART_M;
            } else {
                nearest_miss = nearest_miss.min(misfit);
            }
        }
        fitting.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
        match fitting.as_slice() {
            // A pair that would take the robot elsewhere was not part of the joint search's answer:
            // alone it says nothing.
            [_, ..] if pulls || !assignment.pairing => Verdict::Ambiguous,
            [] if nearest_miss < config.doubt_gate => Verdict::Doubtful(nearest_miss),
            [] => Verdict::New,
            [first, second, ..]
                if second.0 - first.0 < CLOSE_CALL
                    && !self.same_surface(belief, first.2, second.2) =>
            {
                // Of pieces of an uneven surface the one that it lies on.
                let mut rivals: Vec<(f64, f64, usize)> = fitting
                    .iter()
                    .take_while(|other| other.0 - first.0 < CLOSE_CALL)
                    .map(|other| (self.share_on(belief, observation, other.2), other.1, other.2))
                    .collect();
                rivals.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.2.cmp(&b.2)));
                match rivals.as_slice() {
                    [(on, distance, plane), (beside, ..), ..] if *on > LIES_ON * beside => {
                        Verdict::Seen(*plane, *distance)
                    }
                    _ => Verdict::Ambiguous,
                }
            }
            [first, ..] => Verdict::Seen(first.2, first.1),
        }
    }

    /// Squared Mahalanobis distance of two observations of one scan, if they were of one plane: it does not
    /// depend on where the robot is.
    fn apart(&self, observation: usize, other: usize) -> f64 {
        let (seen, beside) = (&self.observations[observation], &self.observations[other]);
        let frames = (&beside.robot_from_plane, &seen.robot_from_plane);
        let Innovation { h, h_z, h_f, .. } =
            Innovation::new(frames.0, &Isometry3::identity(), frames.1);
        let mut s =
            h_z * seen.covariance * h_z.transpose() + h_f * beside.covariance * h_f.transpose();
        if let (Some(own), Some(others)) = (self.common[observation], self.common[other]) {
            let common = h_z * own + h_f * others;
            s += common * common.transpose();
        }
        s.cholesky().map_or(f64::INFINITY, |root| h.dot(&root.solve(&h)))
    }

    /// Whether an observation that was not recognised may be a plane that was not seen, if the robot were a
    /// little way off: either faces as the other does and lies where the other can be.
    pub(super) fn may_be_displaced(
        &self,
        belief: &Belief,
        verdicts: &[Verdict],
        config: &AssociationConfig,
    ) -> bool {
        let is_seen = |plane| {
            verdicts
                .iter()
                .any(|verdict| matches!(verdict, Verdict::Seen(seen, _) if *seen == plane))
        };
        let is_unknown = |verdict: &Verdict| matches!(verdict, Verdict::New | Verdict::Doubtful(_));
        let mut unknown = (0..verdicts.len()).filter(|&index| is_unknown(&verdicts[index]));
        unknown.any(|observation| {
            self.candidates[observation].iter().any(|&plane| {
                !is_seen(plane)
                    && self.rows(belief, observation, plane).angle_rad() < config.max_angle_rad
                    && self.patches_meet(belief, observation, plane, config)
            })
        })
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

    /// What observations beside its pairs say for or against an assignment, in the measure of
    /// [`Assignment::support`]. Pieces of landmarks speak for it: a map in which one surface became two
    /// landmarks pairs both of its pieces; that is no reason to believe it more than one in which they are
    /// pieces of one. What is too far from a landmark to be it and too near to be something else speaks
    /// against it: the place beside a wall at which that wall fits is the likelier one.
    pub(super) fn beside_pairs(&self, assignment: &Assignment, config: &AssociationConfig) -> f64 {
        let belief = &assignment.belief;
        let is_free = |&observation: &usize| assignment.plane_of(observation).is_none();
        let of_observation = |observation: usize| {
            let (mut piece, mut is_doubtful) = (None, false);
            for &plane in &self.candidates[observation] {
                let rows = self.rows(belief, observation, plane);
                let distance = rows.distance_squared();
                if distance >= config.doubt_gate
                    || !self.comparable(belief, &rows, observation, plane, config)
                {
                    continue;
                }
                is_doubtful |= distance >= config.gate;
                if distance < config.gate && rows.h.x.abs() < APART_M {
                    let ratio = tempered_ratio(distance, rows.s[(0, 0)], config);
                    piece = Some(ratio.max(piece.unwrap_or(0.0)));
                }
            }
            let doubted =
                if is_doubtful { self.observations[observation].log_swallowed() } else { 0.0 };
            piece.unwrap_or(doubted)
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
    pub(super) fn same_surface(&self, belief: &Belief, a: usize, b: usize) -> bool {
        self.nearly_coplanar(belief, a, b, 0.02)
    }

    /// Whether two planes of the belief are parallel and no farther apart than so much.
    pub(super) fn nearly_coplanar(
        &self,
        belief: &Belief,
        a: usize,
        b: usize,
        within_m: f64,
    ) -> bool {
        let (first, second) = (&belief.planes[a], &belief.planes[b]);
        let relative = first.inverse() * second;
        let angle = (relative.rotation * Vector3::z()).angle(&Vector3::z());
        angle < 0.02 && relative.translation.vector.z.abs() < within_m
    }
}

/// How much better a landmark explains an observation than a plane that was never seen, which might
/// lie anywhere within the limits of a comparison.
pub(super) fn log_ratio(
    distance_squared: f64,
    log_determinant: f64,
    config: &AssociationConfig,
) -> f64 {
    let window = 2.0 * config.max_offset_m * (2.0 * config.max_angle_rad).powi(2);
    let normaliser = 3.0 * std::f64::consts::TAU.ln() + log_determinant;
    window.ln() - 0.5 * (distance_squared + normaliser)
}

/// How much better a landmark explains an observation than another plane that faces the same way: built
/// worlds have few directions, so that only the distance tells surfaces apart, whose variance before the
/// pair is `variance_m2`. Its tightness is limited and its misfit counts in full. Limiting the whole
/// would make explanations equal that differ by what odometry has to be wrong by: a robot beside a stair
/// could be a step higher, with the floor for the first tread.
pub(super) fn tempered_ratio(
    distance_squared: f64,
    variance_m2: f64,
    config: &AssociationConfig,
) -> f64 {
    let window_m = 2.0 * config.max_offset_m;
    let tightness = (window_m / (std::f64::consts::TAU * variance_m2).sqrt()).ln();
    (LOG_RECOGNISED + tightness).min(MOST_PER_PAIR) - 0.5 * distance_squared
}

pub(super) fn settled(belief: &Belief) -> bool {
    (0..3).all(|i| belief.pose_variance(i) < SETTLED_M * SETTLED_M)
        && (3..6).all(|i| belief.pose_variance(i) < SETTLED_RAD * SETTLED_RAD)
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
