//! Joint compatibility by branch and bound.
//!
//! A set of pairs is compatible when each fits after the others have corrected the pose (Neira and
//! Tardós, "Data association in stochastic mapping using the joint compatibility test", 2001). The set
//! with most pairs wins; sets of equal size that put the robot elsewhere are handed back beside it.
//!
//! Once the pose is settled further pairs leave the belief alone, so that all branches below share it:
//! what was asked of a belief is kept with it, and asked once.

use super::association::{
    APART_M, Assignment, AssociationConfig, LIES_ON, Question, log_ratio, settled, tempered_ratio,
};
use super::belief::Belief;
use super::landmark::Landmark;
use super::observation::Observation;
use super::shift::Shift;
use nalgebra::Matrix3;
use std::cell::RefCell;
use std::rc::Rc;

/// Beside [`APART_M`]: two assignments differ when they turn the robot this far apart.
const APART_RAD: f64 = 0.03;
/// The same for the height: a kerb is this much higher than the floor beside it.
const APART_UP_M: f64 = 0.03;
/// Standard deviations to either side that a belief leaves.
const ONE_PLACE_SIGMAS: f64 = 3.0;
/// Surfaces so near to being in one plane are told apart by which of them a patch lies on: the height, which a motion
/// leaves open by centimetres, does not tell.
const NEAR_M: f64 = 0.1;
/// Most assignments that are handed back.
const MOST_ASSIGNMENTS: usize = 4;
/// Area beside which others facing the same way add little, in m².
const TELLING_M2: f64 = 1.0;

impl Question<'_> {
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
        // First those with fewest choices. What lies beside all of them comes last: when the place within
        // the plane is known it may be something else.
        anchors.sort_by_cached_key(|(observation, fitting)| {
            let lies_on =
                |&plane: &usize| self.patches_overlap_within(belief, *observation, plane, 0.0);
            (!fitting.iter().any(lies_on), fitting.len())
        });
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
            most_here: None,
            found: Vec::new(),
        };
        search.descend(0, Set::none(Node::new(belief.among(&planes), &anchors)));
        let named = |set: Set| {
            let name = |(observation, plane): (usize, usize)| (observation, planes[plane]);
            let pairs = set.pairs.into_iter().map(name).collect();
            (set.score, self.assignment(belief, pairs, set.support, config))
        };
        let mut found: Vec<(f64, Assignment)> = search.found.into_iter().map(named).collect();
        // Not `search.most`: the set with most pairs may have lost its place to a likelier one.
        let most = found.iter().map(|(_, set)| set.pairs.len()).max().unwrap_or(0);
        found.retain(|(_, set)| set.pairs.len() + slack >= most);
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        found.into_iter().map(|(_, set)| set).take(MOST_ASSIGNMENTS).collect()
    }

    /// The belief after a set of pairs, without those that lie beside their landmarks unless the others tell
    /// that the surface goes on there: the search may have come to them before the place within the plane was
    /// known.
    fn assignment(
        &self,
        belief: &Belief,
        pairs: Vec<(usize, usize)>,
        support: f64,
        config: &AssociationConfig,
    ) -> Assignment {
        let after = self.after(belief, &pairs);
        let lies_on = |&(observation, plane): &(usize, usize)| {
            self.patches_overlap(&after, observation, plane)
        };
        let (mut kept, beside): (Vec<_>, Vec<_>) = pairs.into_iter().partition(lies_on);
        if beside.is_empty() {
            return Assignment { pairs: kept, support, belief: after, pairing: true };
        }
        let (mut belief, mut support) = (self.after(belief, &kept), support);
        for (observation, plane) in beside {
            let rows = self.rows(&belief, observation, plane);
            if self.comparable(&belief, &rows, observation, plane, config) {
                self.absorb(&mut belief, observation, plane);
                kept.push((observation, plane));
            } else {
                support -= tempered_ratio(rows.distance_squared(), rows.s[(0, 0)], config);
            }
        }
        Assignment { pairs: kept, support, belief, pairing: true }
    }

    /// [`search`](Self::search) among pairs of which none lies farther apart than `most_m` along its normal
    /// where the belief has the robot. Sets far off may have so many more pairs that it would not come to
    /// the one that fits where the robot is believed to be.
    pub(super) fn search_near(
        &self,
        belief: &Belief,
        config: &AssociationConfig,
        most_m: f64,
    ) -> Vec<Assignment> {
        let is_near = |observation: usize, plane: usize| {
            self.rows(belief, observation, plane).h.x.abs() <= most_m
        };
        let candidates = self.candidates.iter().enumerate().map(|(observation, planes)| {
            planes.iter().copied().filter(|&plane| is_near(observation, plane)).collect()
        });
        let candidates: Vec<Vec<usize>> = candidates.collect();
        Question { candidates: &candidates, ..*self }.search(belief, config, 0)
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
}

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

/// Whether all places that a belief leaves are nearer to each other than those that are told apart. A place lies
/// beside planes: where a loop closes the robot may be known beside its last pose, and they are not.
fn is_one_place(belief: &Belief) -> bool {
    let within =
        |variance: f64, apart: f64| 2.0 * ONE_PLACE_SIGMAS * variance.max(0.0).sqrt() < apart;
    let variance = |components: std::ops::Range<usize>| {
        components.map(|component| belief.pose_variance(component)).sum::<f64>()
    };
    within(variance(0..2), APART_M)
        && within(variance(2..3), APART_UP_M)
        && within(variance(3..6), APART_RAD)
        && (0..belief.planes.len()).all(|plane| {
            let apart_m = if belief.lies(plane) { APART_UP_M } else { APART_M };
            within(belief.offset_variance(plane), apart_m)
        })
}

/// How a pair fits: what it adds to a set's score and support beside its squared distance.
#[derive(Clone, Copy, Debug)]
struct Fit {
    distance_squared: f64,
    score: f64,
    support: f64,
}

/// A belief of the search, with what was asked of it.
struct Node {
    belief: Belief,
    settled: bool,
    /// Whether further pairs cannot put the robot apart from where others would.
    one_place: bool,
    /// By anchor and by its planes: whether that pair fits, once it was asked.
    known: RefCell<Vec<Vec<Option<Option<Fit>>>>>,
    /// The same: the share of the anchor that lies on the plane.
    on: RefCell<Vec<Vec<Option<f64>>>>,
}

impl Node {
    fn new(belief: Belief, anchors: &[(usize, Vec<usize>)]) -> Rc<Self> {
        let known = anchors.iter().map(|(_, planes)| vec![None; planes.len()]).collect();
        let on = anchors.iter().map(|(_, planes)| vec![None; planes.len()]).collect();
        Rc::new(Self {
            settled: settled(&belief),
            one_place: is_one_place(&belief),
            belief,
            known: RefCell::new(known),
            on: RefCell::new(on),
        })
    }
}

/// A jointly compatible set of pairs in the making.
#[derive(Clone)]
struct Set {
    pairs: Vec<(usize, usize)>,
    /// How each of them fits.
    fits: Vec<Fit>,
    /// Logarithm of how much better the pairs explain the observations than new planes would.
    score: f64,
    /// See [`Assignment::support`].
    support: f64,
    /// The belief after the pairs.
    node: Rc<Node>,
}

impl Set {
    fn none(node: Rc<Node>) -> Self {
        Self { pairs: Vec::new(), fits: Vec::new(), score: 0.0, support: 0.0, node }
    }

    /// Whether it puts the robot well away from where another does, beside the planes that either takes
    /// for seen.
    fn apart_from(&self, other: &Self) -> bool {
        // One belief has one pose.
        if Rc::ptr_eq(&self.node, &other.node) {
            return false;
        }
        let planes = self.pairs.iter().chain(&other.pairs).map(|pair| pair.1);
        let shift = Shift::between(&self.node.belief, &other.node.belief, planes);
        shift.exceeds(APART_M, APART_UP_M, APART_RAD)
    }
}

struct Search<'a> {
    question: &'a Question<'a>,
    anchors: &'a [(usize, Vec<usize>)],
    config: &'a AssociationConfig,
    slack: usize,
    trials: usize,
    /// Pairs of the largest set so far.
    most: usize,
    /// The same among the sets below a belief that leaves one place only.
    most_here: Option<usize>,
    /// The best set of each place.
    found: Vec<Set>,
}

impl Search<'_> {
    fn descend(&mut self, depth: usize, so_far: Set) {
        let reachable = so_far.pairs.len() + self.anchors.len() - depth;
        // The first descent always ends: only alternatives to it are given up.
        let given_up = self.trials > self.config.max_trials && !self.found.is_empty();
        let lags = self.most_here.is_some_and(|most| reachable < most);
        if reachable + self.slack < self.most || lags || given_up {
            return;
        }
        if self.most_here.is_none() && so_far.node.one_place {
            // All sets below put the robot there: those with fewer pairs than others there say nothing else.
            let is_known =
                |known: &Set| known.pairs.len() >= reachable && !known.apart_from(&so_far);
            if !self.found.iter().any(is_known) {
                self.most_here = Some(0);
                self.descend(depth, so_far);
                self.most_here = None;
            }
            return;
        }
        let Some((observation, planes)) = self.anchors.get(depth) else {
            self.file(so_far);
            return;
        };
        let mut fitting: Vec<(Fit, usize, usize)> = Vec::new();
        for (at, &plane) in planes.iter().enumerate() {
            if so_far.pairs.iter().any(|pair| pair.1 == plane) {
                continue;
            }
            self.trials += 1;
            let fit = self.fit(&so_far.node, depth, at);
            fitting.extend(fit.map(|fit| (fit, plane, at)));
        }
        fitting.sort_by(|(a, a_plane, _), (b, b_plane, _)| {
            a.distance_squared.total_cmp(&b.distance_squared).then(a_plane.cmp(b_plane))
        });
        let belief = &so_far.node.belief;
        // Not of one surface is a plank on the floor, which is as near while the height is open.
        let is_near =
            |a: usize, b: usize| a != b && self.question.nearly_coplanar(belief, a, b, NEAR_M);
        let on = |at: usize| self.share_on(&so_far.node, depth, at);
        let lies_on = |&(_, plane, at): &(Fit, usize, usize)| {
            let mut rivals = fitting.iter().filter(|rival| is_near(rival.1, plane));
            !rivals.any(|rival| on(rival.2) > LIES_ON * on(at))
        };
        let fitting: Vec<(Fit, usize)> =
            fitting.iter().filter(|it| lies_on(it)).map(|it| (it.0, it.1)).collect();
        for (i, &(fit, plane)) in fitting.iter().enumerate() {
            // Pieces of one surface put the robot in one place: trying one of them is enough.
            if fitting[..i].iter().any(|known| self.question.same_surface(belief, known.1, plane)) {
                continue;
            }
            let mut next = so_far.clone();
            next.pairs.push((*observation, plane));
            next.fits.push(fit);
            next.score += fit.score;
            next.support += fit.support;
            if !next.node.settled {
                let mut belief = belief.clone();
                self.question.absorb(&mut belief, *observation, plane);
                next.node = Node::new(belief, self.anchors);
            }
            self.descend(depth + 1, next);
        }
        self.descend(depth + 1, so_far);
    }

    /// Share of an anchor that lies on its `at`-th plane under a belief.
    fn share_on(&self, node: &Node, anchor: usize, at: usize) -> f64 {
        let (observation, planes) = &self.anchors[anchor];
        *node.on.borrow_mut()[anchor][at]
            .get_or_insert_with(|| self.question.share_on(&node.belief, *observation, planes[at]))
    }

    /// Whether and how an anchor fits its `at`-th plane under a belief.
    fn fit(&self, node: &Node, anchor: usize, at: usize) -> Option<Fit> {
        if let Some(known) = node.known.borrow()[anchor][at] {
            return known;
        }
        let (observation, planes) = &self.anchors[anchor];
        let rows = self.question.rows(&node.belief, *observation, planes[at]);
        let distance_squared = rows.distance_squared();
        let fits = distance_squared < self.config.gate
            && self.question.comparable(&node.belief, &rows, *observation, planes[at], self.config);
        let fit = fits.then(|| Fit {
            distance_squared,
            score: log_ratio(distance_squared, rows.log_determinant(), self.config),
            support: tempered_ratio(distance_squared, rows.s[(0, 0)], self.config),
        });
        node.known.borrow_mut()[anchor][at] = Some(fit);
        fit
    }

    /// Whether a pair of a set still holds where all of them together put the robot.
    fn holds(&self, set: &Set, (observation, plane): (usize, usize)) -> bool {
        let belief = &set.node.belief;
        self.question.patches_overlap(belief, observation, plane) || {
            let rows = self.question.rows(belief, observation, plane);
            self.question.comparable(belief, &rows, observation, plane, self.config)
        }
    }

    /// Keeps a set when it is the best of its place. Where the place was open at first, surfaces beside each
    /// other were pairs that are none any more: they must not make it a larger set than one of which all hold.
    fn file(&mut self, mut set: Set) {
        for at in (0..set.pairs.len()).rev() {
            if !self.holds(&set, set.pairs[at]) {
                set.pairs.remove(at);
                let lost = set.fits.remove(at);
                set.score -= lost.score;
                set.support -= lost.support;
            }
        }
        self.most = self.most.max(set.pairs.len());
        self.most_here = self.most_here.map(|most| most.max(set.pairs.len()));
        match self.found.iter_mut().find(|known| !known.apart_from(&set)) {
            Some(known) if known.score >= set.score => {}
            Some(known) => *known = set,
            None => self.found.push(set),
        }
    }
}
