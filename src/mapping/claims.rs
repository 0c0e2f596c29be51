//! Explanations of one scan, and what the map says for and against each.

use super::association::Assignment;
use super::estimate::{Estimate, Prepared};
use super::landmark::LandmarkId;
use super::moved::{Gone, LOG_VANISHED, MOST_VANISHED};
use super::observation::Observation;
use super::perturbation::pose_error;
use super::scan_errors::ScanObservations;
use super::sight::Contradiction;
use nalgebra::{Isometry3, Matrix3};

/// Two explanations that put the robot this near to each other are one.
pub(super) const SAME_M: f64 = 0.05;
pub(super) const SAME_RAD: f64 = 0.01;
/// Rise of a normal, seen by the robot, above which a plane is level.
const LEVEL: f64 = 0.8;
/// What one explanation must be behind by while nothing proves it: three scans' worth of a pair that
/// fits by chance.
pub(super) const UNPROVEN: f64 = 9.0;
/// Logarithm of how much one contradicting point in a hundred speaks against a pose, beyond the few
/// that doors, people and masks account for, and the most that contradictions may say.
const AGAINST_PER_CENT: f64 = 3.0;
pub(super) const TOLERATED_SHARE: f64 = 0.02;
const MOST_AGAINST: f64 = 100.0;
/// Share of a scan's points that contradict the map beyond which no explanation stands.
const REFUTED_SHARE: f64 = 0.1;
/// Share of a scan's area that must be recognised before it may move the robot beyond what odometry
/// allows.
const PROVEN_AREA_SHARE: f64 = 0.6;
/// Least eigenvalue of the sum of `n nᵀ` over the recognised normals that fixes a place.
const PROVEN_SPREAD: f64 = 0.4;

/// Logarithm of how seldom a motion is worse than told by some of its deviations: stuck wheels, a push.
pub(super) const LOG_SELDOM: f64 = -7.0;
/// Pairs that explain a scan, not by chance.
const EXPLAINING_PAIRS: usize = 4;
/// Logarithm of how much seldomer a scan shows nothing of the map where one place explains most of it.
const LOG_EXPLAINED: f64 = -10.0;

/// Logarithm of how much a share of contradicting points speaks against a pose.
fn weight_of(contradicting_share: f64) -> f64 {
    let excess = (contradicting_share - TOLERATED_SHARE).max(0.0);
    (100.0 * AGAINST_PER_CENT * excess).min(MOST_AGAINST)
}

/// An explanation of a scan before it is judged.
pub(super) struct Claim {
    /// Position of what was prepared.
    pub(super) prepared: usize,
    pub(super) assignment: Assignment,
    /// Logarithm of its prior.
    pub(super) log_prior: f64,
    /// Whether it moves the robot far beside what it takes for seen.
    pub(super) far: bool,
    /// Whether it has the robot carried there, against all odometry.
    pub(super) carried: bool,
    /// Whether it has the robot where odometry led, but turned.
    pub(super) turned: bool,
    /// See [`Estimate::left_out`].
    pub(super) left_out: Vec<(usize, LandmarkId)>,
    /// See [`Estimate::beside_pairs`].
    pub(super) beside_pairs: f64,
}

/// An explanation with what the map says of it.
#[derive(Clone)]
pub(super) struct Judged {
    pub(super) prepared: usize,
    pub(super) assignment: Assignment,
    pub(super) score: f64,
    /// Share of the scan's points that contradict the map, and what it was with all that is said to be gone.
    pub(super) refuted: f64,
    pub(super) denied: f64,
    /// See [`Contradiction::misplaced`](super::sight::Contradiction::misplaced).
    pub(super) misplaced: usize,
    pub(super) far: bool,
    pub(super) carried: bool,
    pub(super) turned: bool,
    /// Landmarks that it recognises, those of a thing that it says has moved and shows elsewhere, and all that it
    /// says are not there any more.
    pub(super) known: Vec<LandmarkId>,
    pub(super) moved: Vec<LandmarkId>,
    pub(super) gone: Gone,
}

impl Judged {
    /// Whether nothing in the scan makes the motion appear worse than it was taken to be, nor is explained by a
    /// thing that has vanished and is not seen elsewhere.
    pub(super) fn stands(&self) -> bool {
        let is_excused = self.gone.len() > self.moved.len();
        self.score >= 0.0 && self.refuted <= REFUTED_SHARE && self.misplaced == 0 && !is_excused
    }

    /// Whether it stands and nothing but what is tolerated speaks against it.
    pub(super) fn convinces(&self) -> bool {
        self.stands() && self.refuted <= TOLERATED_SHARE
    }

    /// Whether the map speaks against it, but for what is said to be gone.
    pub(super) fn is_denied(&self) -> bool {
        self.denied > REFUTED_SHARE
    }

    /// Whether it is a place near the prediction that explains most of the scan.
    fn explains(&self, scan: &ScanObservations) -> bool {
        !self.far
            && self.stands()
            && self.assignment.pairs.len() >= EXPLAINING_PAIRS
            && recognised_share(&self.assignment, scan) > PROVEN_AREA_SHARE
    }
}

/// Scores of explanations, each for itself, with what the map says against them. Where the motion was
/// `measured`, something may have moved.
pub(super) fn weigh(
    claims: Vec<Claim>,
    estimate: &Estimate,
    options: &[Prepared],
    scan: &ScanObservations,
    measured: bool,
) -> Vec<Judged> {
    let weigh = |claim: Claim| {
        let option = &options[claim.prepared];
        let held_against = |gone: &Gone| {
            let Claim { assignment, left_out, .. } = &claim;
            estimate.contradiction(scan, option, assignment, left_out, gone)
        };
        let score = |against: &Contradiction| {
            let Claim { assignment, log_prior, beside_pairs, .. } = &claim;
            assignment.support + beside_pairs + log_prior + against.footing + against.doubled
                - weight_of(against.share())
        };
        let mut gone = Gone::default();
        let mut against = held_against(&gone);
        let denied = against.share();
        let (mut best, mut support, mut moved) = (score(&against), 0.0, Vec::new());
        // Only where odometry is believed, if not to the letter: elsewhere whatever does not fit would have moved.
        let may_have_moved = measured && claim.log_prior >= LOG_SELDOM;
        let found =
            may_have_moved.then(|| estimate.moved(scan, option, &claim.assignment, &against.by));
        if let Some(found) = found.flatten() {
            best += found.log_there;
            let all = Gone { landmarks: found.landmarks.clone(), ..Gone::default() };
            let without = held_against(&all);
            let other = score(&without) + found.support;
            if other > best {
                (against, best, support, gone) = (without, other, found.support, all);
                moved = found.landmarks;
            }
        }
        let most_vanished = if may_have_moved { MOST_VANISHED } else { 0 };
        for _ in 0..most_vanished {
            let vanished = estimate.vanished(option, &claim.assignment, &against.by);
            let came = Estimate::came(scan, &against.before);
            let things = [vanished, came].into_iter().filter(|thing| !thing.is_empty());
            let without = things.map(|thing| {
                let all = gone.and(&thing);
                let without = held_against(&all);
                (score(&without) + support + LOG_VANISHED, without, all)
            });
            let likelier = without.max_by(|a, b| a.0.total_cmp(&b.0)).filter(|it| it.0 > best);
            let Some((other, without, all)) = likelier else { break };
            (against, best, support, gone) = (without, other, support + LOG_VANISHED, all);
        }
        let Claim { prepared, assignment, far, carried, turned, .. } = claim;
        Judged {
            prepared,
            score: best,
            refuted: against.share(),
            denied,
            misplaced: against.misplaced,
            far,
            carried,
            turned,
            known: assignment.pairs.iter().map(|pair| option.landmark_of(pair.1)).collect(),
            moved,
            gone,
            assignment,
        }
    };
    claims.into_iter().map(weigh).collect()
}

/// The same held against one another: without a lead for what is far from the prediction and unproven.
pub(super) fn judge(mut judged: Vec<Judged>, scan: &ScanObservations) -> Vec<Judged> {
    if judged.iter().any(|option| option.explains(scan)) {
        for nothing in judged.iter_mut().filter(|option| option.assignment.pairs.is_empty()) {
            nothing.score += LOG_EXPLAINED;
        }
    }
    discount_things(&mut judged);
    let near = judged.iter().filter(|option| !option.far);
    let near = near.max_by(|a, b| a.score.total_cmp(&b.score));
    let near = near.expect("the prediction itself is among the explanations");
    let (near_score, near_denied) = (near.score, near.denied);
    let near_fails = near.refuted > REFUTED_SHARE;
    let near_is_wrong = |refuted: f64| near_denied > refuted + TOLERATED_SHARE;
    // A room like another proves nothing: odometry must be wrong before a robot was carried, and nothing near
    // may have more for it than against it. Along like rooms a map that is decimetres off speaks a little against
    // every place near, and for a room like this one farther back not at all.
    judged.retain(|option| !option.carried || near_score < 0.0 && near_is_wrong(option.refuted));
    let place = |option: &Judged| option.assignment.belief.world_from_robot;
    let far_scores = judged.iter().filter(|option| option.far).map(|option| option.score);
    let best_far = far_scores.fold(f64::NEG_INFINITY, f64::max);
    // Places that nothing tells apart.
    let mut far_places: Vec<Isometry3<f64>> = Vec::new();
    let alike = judged.iter().filter(|option| option.far && option.score > best_far - UNPROVEN);
    for there in alike.map(place) {
        if far_places.iter().all(|other| moves_far(other, &there, SAME_M, SAME_RAD)) {
            far_places.push(there);
        }
    }
    for option in &mut judged {
        // What lies far from the prediction needs more than a good fit: worlds repeat themselves. Which of
        // several it is, its score tells, and the scans to come, once nothing near is left to keep to. That the
        // same scan is seen from the same spot by chance, all turned, takes a world that looks alike from there.
        let proven = !option.far
            || ((far_places.len() == 1 || near_fails)
                && option.refuted < TOLERATED_SHARE
                && (option.turned || near_is_wrong(option.refuted))
                && proven(&option.assignment, scan));
        if !proven {
            // Behind what is near, and behind one another as far as they were.
            let behind = best_far - option.score;
            option.score = option.score.min(near_score - UNPROVEN - behind);
        }
        let at = place(option);
        tracing::debug!(
            x = at.translation.x,
            y = at.translation.y,
            pairs = option.assignment.pairs.len(),
            score = option.score,
            refuted = option.refuted,
            misplaced = option.misplaced,
            far = option.far,
            carried = option.carried,
            turned = option.turned,
            proven,
            gone = option.gone.len(),
            "explanation of a scan"
        );
    }
    judged
}

/// Takes its lead from a slip that nothing speaks for but a thing that may as well have moved.
fn discount_things(judged: &mut [Judged]) {
    let by_odometry = judged.iter().filter(|option| !option.moved.is_empty());
    let Some(best) = by_odometry.max_by(|a, b| a.score.total_cmp(&b.score)) else { return };
    let (known, moved, score) = (best.known.clone(), best.moved.clone(), best.score);
    for option in judged.iter_mut().filter(|option| option.moved.is_empty()) {
        let mut more = option.known.iter().filter(|landmark| !known.contains(landmark)).peekable();
        if more.peek().is_some() && more.all(|landmark| moved.contains(landmark)) {
            option.score = option.score.min(score - UNPROVEN);
        }
    }
}

/// Whether one pose is farther from another than so much.
pub(super) fn moves_far(a: &Isometry3<f64>, b: &Isometry3<f64>, far_m: f64, far_rad: f64) -> bool {
    let gap = pose_error(a, b);
    gap.fixed_rows::<3>(0).norm() > far_m || gap.fixed_rows::<3>(3).norm() > far_rad
}

/// Whether a plane rises, seen by the robot.
pub(super) fn is_upright(seen: &Observation) -> bool {
    seen.normal().z.abs() < LEVEL
}

/// Share of a scan's upright area that an assignment recognises: floors and ceilings look alike anywhere.
pub(super) fn upright_share(assignment: &Assignment, scan: &ScanObservations) -> f64 {
    let upright_m2 = |observation: usize| {
        let seen = &scan.observations[observation];
        if is_upright(seen) { seen.area_m2() } else { 0.0 }
    };
    let recognised: f64 = assignment.pairs.iter().map(|pair| upright_m2(pair.0)).sum();
    let whole: f64 = (0..scan.observations.len()).map(upright_m2).sum();
    if whole > 0.0 { recognised / whole } else { 1.0 }
}

/// Share of a scan's area that an assignment recognises.
pub(super) fn recognised_share(assignment: &Assignment, scan: &ScanObservations) -> f64 {
    let area = |observation: usize| scan.observations[observation].area_m2();
    let whole: f64 = (0..scan.observations.len()).map(area).sum();
    let recognised: f64 = assignment.pairs.iter().map(|pair| area(pair.0)).sum();
    if whole > 0.0 { recognised / whole } else { 1.0 }
}

/// Whether an assignment recognises most of what a scan shows, in planes that fix all directions.
fn proven(assignment: &Assignment, scan: &ScanObservations) -> bool {
    let spread: Matrix3<f64> = assignment
        .pairs
        .iter()
        .map(|pair| scan.observations[pair.0].normal())
        .map(|normal| normal * normal.transpose())
        .sum();
    recognised_share(assignment, scan) > PROVEN_AREA_SHARE
        && spread.symmetric_eigenvalues().min() > PROVEN_SPREAD
}
