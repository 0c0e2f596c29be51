//! The ways to go on from one explanation of all that was seen when a scan arrives.
//!
//! Most scans leave one: odometry leads where nearly all that is seen is known. Where little is, or what is
//! new cannot be where it would have to be, or the correction is large, the motion may be worse than told, and
//! what else fits is looked for in ever wider circles.

use super::association::{Assignment, AssociationConfig, Verdict};
use super::claims::{
    Claim, Judged, LOG_SELDOM, SAME_M, SAME_RAD, is_upright, judge, moves_far, recognised_share,
    upright_share, weigh,
};
use super::estimate::{Arrival, Estimate, Prepared};
use super::moved::Gone;
use super::observation::Observation;
use super::odometry::unmeasured_motion;
use crate::geometry::wrap_pi;
use nalgebra::{Isometry3, Matrix6};

/// How much worse than told odometry may be before the scan is no longer believed: the motion's
/// standard deviations are widened by this when a scan does not fit the map.
const WIDENING: f64 = 6.5;
/// The same where that finds nothing either: wheels that slip or stick for a moment put the robot beside
/// itself, and what it sees there may be new for the most part. Another place that fits better is no proof.
const SLIPPED: f64 = 20.0;
/// Most that the standard deviation of a motion over the ground is widened to, in metres.
const WIDEST_M: f64 = 0.5;
/// A motion that is told to be less is none on which wheels slip along a row of like things.
const STILL_M: f64 = 0.1;
/// Pairs below which a scan is tried again with a widened motion.
const FEW_PAIRS: usize = 3;
/// Logarithm of how seldom wheels slip or stick for a moment.
const LOG_SLIPPED: f64 = -9.0;
/// The same for encoders that are dead: they tell of rest whatever the robot does.
const LOG_DEAD: f64 = -9.0;
/// The same for a motion that tells nothing: a robot lifted and set down elsewhere, wheels that ran free.
const LOG_LOST: f64 = -14.0;
/// Share of a scan's upright area below which it may have been made elsewhere altogether.
const LOST_SHARE: f64 = 0.25;
/// Logarithm of how seldom a scan in the midst of a map shows nothing of it. Without it the pairs of a
/// scan that shows three planes would be left out as often as noise makes all of them miss widely.
const LOG_UNRECOGNISED: f64 = -5.0;
/// Share of a scan's planes and of their area that is recognised from which on one explanation is taken as it
/// comes.
const KNOWN_SHARE: f64 = 0.6;
/// Standard deviation of a motion over the ground from which on nobody has measured it, and up to which it was
/// measured so well that a thing which is elsewhere may have moved.
const OPEN_M: f64 = 0.25;
const MEASURED_M: f64 = 0.15;
/// Corrections that are looked at twice, whatever the odometry's noise allows, and how many pairs
/// fewer another explanation may then have.
const LARGE_M: f64 = 0.1;
const LARGE_RAD: f64 = 0.03;
/// The same for the height: a kerb beside the floor is another surface for the same wheels.
const LARGE_UP_M: f64 = 0.03;
const SLACK: usize = 2;
/// Corrections that need proof; where the motion was hardly measured it is so many standard deviations of it,
/// up to the second of each: worlds repeat themselves.
const FAR_M: (f64, f64) = (0.8, 1.25);
const FAR_RAD: (f64, f64) = (0.35, 0.6);
const FAR_SIGMAS: f64 = 3.5;

/// Directions of walls that differ by less may be those of one building.
const ALIKE_RAD: f64 = 0.1;

/// One way to go on.
pub(super) struct Way {
    pub(super) explanation: Judged,
    /// What each observation is, if that was asked.
    pub(super) verdicts: Option<Vec<Verdict>>,
}

/// One explanation and the scan that it is to go on with.
pub(super) struct Fork<'a> {
    estimate: &'a Estimate,
    arrival: &'a Arrival<'a>,
    config: &'a AssociationConfig,
    /// All that was prepared so far, for other explanations too.
    prepared: &'a mut Vec<Prepared>,
}

/// What makes the best explanation that odometry leads to worth a second look.
#[derive(Clone, Copy, Debug)]
struct Doubts {
    /// Its pairs, and the most that there could be.
    pairs: usize,
    most: usize,
    /// It recognises hardly anything.
    few: bool,
    /// It moves the robot by much.
    large: bool,
    /// What it does not recognise could be what it does not see, or cannot be where it is.
    displaced: bool,
    /// It recognises hardly anything that stands upright.
    lost: bool,
    /// It leaves open what much of the scan is.
    partial: bool,
}

impl Doubts {
    fn any(self) -> bool {
        self.large || self.displaced || self.of_place()
    }

    /// Whether it may be another place altogether: a thing that moves does not change most of what is seen.
    fn of_place(self) -> bool {
        self.few || self.lost || self.partial
    }

    /// Pairs that another place must show; those that the map speaks against are no measure of it.
    fn least(self, convinces: bool) -> usize {
        if self.few || convinces { self.doubled() } else { FEW_PAIRS + 1 }
    }

    fn doubled(self) -> usize {
        (2 * self.pairs).max(FEW_PAIRS + 1)
    }
}

impl<'a> Fork<'a> {
    pub(super) fn new(
        estimate: &'a Estimate,
        arrival: &'a Arrival<'a>,
        config: &'a AssociationConfig,
        prepared: &'a mut Vec<Prepared>,
    ) -> Self {
        Self { estimate, arrival, config, prepared }
    }

    /// The ways, at least one; `alone` tells that no other explanation is alive.
    pub(super) fn ways(mut self, alone: bool) -> Vec<Way> {
        let (estimate, arrival, config) = (self.estimate, self.arrival, self.config);
        let mut plain = estimate.prepare(arrival, config, 1.0);
        let found = &plain.assignments[0];
        let (predicted, guess) = (plain.belief.world_from_robot, found.belief.world_from_robot);
        let verdicts = estimate.verdicts(arrival, &plain, found, config);
        let doubts = self.doubts(&plain, &verdicts);
        if alone && !doubts.any() && plain.assignments.len() == 1 {
            return vec![self.as_it_comes(plain, verdicts)];
        }
        tracing::debug!(?doubts, "a scan that is looked at twice");
        if doubts.large {
            estimate.associate(arrival, config, &mut plain, SLACK);
            if plain.assignments.iter().all(|found| is_large(found, &plain)) {
                estimate.associate_near(arrival, config, &mut plain, LARGE_M);
            }
        }
        // That nothing was recognised is an explanation too.
        let unrecognised = Claim {
            prepared: self.prepared.len(),
            assignment: Assignment::none(&plain.belief),
            log_prior: LOG_UNRECOGNISED,
            far: false,
            carried: false,
            turned: false,
            left_out: Vec::new(),
            beside_pairs: 0.0,
        };
        let mut claims = self.claims(plain, 0.0);
        claims.push(unrecognised);
        let mut weighed = self.weigh(claims);
        let judged = judge(weighed.clone(), arrival.scan);
        let best = judged.iter().max_by(|a, b| a.score.total_cmp(&b.score));
        let stands = best.is_some_and(Judged::stands);
        let convinces = best.is_some_and(Judged::convinces);
        let is_denied = best.is_some_and(Judged::is_denied);
        let mut elsewhere = false;
        if !convinces || doubts.few || doubts.lost || doubts.displaced {
            let wider = self.wider(doubts, convinces, &guess);
            elsewhere = wider.iter().any(|found| stands_elsewhere(found, &guess));
            weighed.extend(wider);
        }
        // A motion that nobody measured is looked for by geometry, too: so far off too much fits by chance.
        if self.level_m() > OPEN_M {
            let within_reach = self.within_reach(&predicted, &arrival.motion_covariance, 0.0);
            elsewhere |= !within_reach.is_empty();
            weighed.extend(within_reach);
        } else if arrival.is_at_rest() && doubts.of_place() {
            let mut moved = self.moved_unmeasured();
            moved.extend(self.within_reach(&predicted, &unmeasured_motion(), LOG_DEAD));
            elsewhere |= moved.iter().any(|found| stands_elsewhere(found, &guess));
            weighed.extend(moved);
        }
        let may_lean = doubts.few || doubts.lost || doubts.partial && doubts.displaced;
        if may_lean && arrival.attitude.is_none() {
            let leant = self.leant(doubts.doubled());
            elsewhere |= leant.iter().any(|found| stands_elsewhere(found, &guess));
            weighed.extend(leant);
        }
        if doubts.of_place() && self.level_m() < MEASURED_M {
            weighed.extend(self.turned(doubts.doubled(), &predicted));
        }
        if !elsewhere && (doubts.lost || !stands) {
            let more = doubts.pairs + SLACK;
            let least = if is_denied { more.max(FEW_PAIRS + 1) } else { doubts.doubled() };
            weighed.extend(self.carried(least, &guess));
        }
        let way = |explanation| Way { explanation, verdicts: None };
        judge(weighed, arrival.scan).into_iter().map(way).collect()
    }

    /// The one way where nothing is in doubt.
    fn as_it_comes(&mut self, plain: Prepared, verdicts: Vec<Verdict>) -> Way {
        let explanation = Judged {
            prepared: self.prepared.len(),
            assignment: plain.assignments[0].clone(),
            score: 0.0,
            refuted: 0.0,
            denied: 0.0,
            misplaced: 0,
            far: false,
            carried: false,
            turned: false,
            known: Vec::new(),
            moved: Vec::new(),
            gone: Gone::default(),
        };
        self.prepared.push(plain);
        Way { explanation, verdicts: Some(verdicts) }
    }

    fn doubts(&self, plain: &Prepared, verdicts: &[Verdict]) -> Doubts {
        let (estimate, arrival, config) = (self.estimate, self.arrival, self.config);
        let scan = arrival.scan;
        let found = &plain.assignments[0];
        let pairs = found.pairs.len();
        let most = scan.observations.len().min(config.anchors);
        let few = !estimate.landmarks().is_empty() && pairs < (most / 3).max(FEW_PAIRS);
        let is_unknown = |index: usize| !matches!(verdicts[index], Verdict::Seen(..));
        Doubts {
            pairs,
            most,
            few,
            large: is_large(found, plain),
            displaced: estimate.may_be_displaced(arrival, config, plain, found, verdicts)
                || estimate.misplaces(scan, plain, found, is_unknown),
            lost: few || upright_share(found, scan) < LOST_SHARE,
            partial: (pairs as f64) < KNOWN_SHARE * most as f64
                || recognised_share(found, scan) < KNOWN_SHARE,
        }
    }

    /// What fits where the motion may have been worse than told, up to the least widening under which something
    /// elsewhere stands. Where the best so far `convinces`, more is asked of anything else.
    fn wider(&mut self, doubts: Doubts, convinces: bool, guess: &Isometry3<f64>) -> Vec<Judged> {
        let Doubts { pairs, most, .. } = doubts;
        let least = doubts.least(convinces);
        // What a scan shows beside its most telling planes may be all that differs.
        let nearly = pairs.saturating_sub(SLACK).max(FEW_PAIRS + 1);
        let least_wide = if doubts.displaced { least.min(nearly) } else { least };
        // A pair or two fit somewhere within so wide a reach whatever was seen.
        let least_slipped = (pairs + 1).min(most).max(FEW_PAIRS);
        let widest = WIDEST_M / self.level_m();
        let (mut found, mut so_far) = (Vec::new(), 1.0);
        for (widening, log_prior, least) in
            [(WIDENING, LOG_SELDOM, least_wide), (SLIPPED, LOG_SLIPPED, least_slipped)]
        {
            let widening = f64::min(widening, widest);
            // A motion that is as open already was looked at as it is.
            if widening <= so_far {
                break;
            }
            so_far = widening;
            let wide = self.estimate.prepare(self.arrival, self.config, widening);
            let mut claims = self.claims(wide, log_prior);
            // Where the first circle is as wide as any, slips lie within it.
            let holds_slips = f64::min(SLIPPED, widest) <= widening;
            claims.retain_mut(|claim| {
                let pairs = claim.assignment.pairs.len();
                if pairs < least && holds_slips {
                    claim.log_prior = LOG_SLIPPED;
                    return pairs >= least_slipped;
                }
                pairs >= least
            });
            let weighed = self.weigh(claims);
            let ends = weighed.iter().any(|found| stands_elsewhere(found, guess));
            found.extend(weighed);
            if ends {
                return found;
            }
        }
        // Along a row of like things as many fit a place beside the true one, against which the map speaks.
        // Wheels that hardly turned do not slip by much: what is elsewhere has moved itself.
        let is_still = self.arrival.motion.translation.vector.norm() < STILL_M;
        let may_slip = !is_still && (doubts.displaced || !convinces);
        let least_beside = if may_slip { least_slipped.min(nearly) } else { least_slipped };
        // Among many like surfaces so much fits within a wide circle that the search does not come to all of it.
        let mut claims = Vec::new();
        for world_from_robot in self.estimate.beside(self.arrival, FAR_M.0, FAR_RAD.0) {
            let there = self.estimate.prepare_at(self.arrival, self.config, &world_from_robot);
            claims.extend(self.claims(there, LOG_SLIPPED));
        }
        claims.retain(|claim| claim.assignment.pairs.len() >= least_beside);
        found.extend(self.weigh(claims));
        found
    }

    /// What odometry leads to where it tells of rest and is dead.
    fn moved_unmeasured(&mut self) -> Vec<Judged> {
        let arrival = Arrival { motion_covariance: unmeasured_motion(), ..*self.arrival };
        let open = self.estimate.prepare(&arrival, self.config, 1.0);
        let claims = self.claims(open, LOG_DEAD);
        self.weigh(claims)
    }

    /// What fits within a motion that nobody measured, with the logarithm of how seldom that is.
    fn within_reach(
        &mut self,
        predicted: &Isometry3<f64>,
        spread: &Matrix6<f64>,
        log_seldom: f64,
    ) -> Vec<Judged> {
        let mut claims = Vec::new();
        for (world_from_robot, log_prior) in self.estimate.within_reach(self.arrival, spread) {
            let log_prior = log_prior + log_seldom;
            let there = self.estimate.prepare_at(self.arrival, self.config, &world_from_robot);
            let (far_m, far_rad) = self.far();
            let far = moves_far(predicted, &world_from_robot, far_m, far_rad);
            let there = self.claims(there, log_prior).into_iter();
            claims.extend(there.map(|claim| Claim { far: claim.far || far, ..claim }));
        }
        self.weigh(claims)
    }

    /// What fits where odometry led if it knows nothing of how the ground slopes, with so many pairs.
    fn leant(&mut self, least: usize) -> Vec<Judged> {
        let leant = self.estimate.prepare_leant(self.arrival, self.config);
        let mut claims = self.claims(leant, LOG_SLIPPED);
        claims.retain(|claim| claim.assignment.pairs.len() >= least);
        self.weigh(claims)
    }

    /// What fits where odometry led if the heading slipped, with so many pairs.
    fn turned(&mut self, least: usize, predicted: &Isometry3<f64>) -> Vec<Judged> {
        let mut claims = Vec::new();
        for world_from_robot in self.estimate.turned(self.arrival, OPEN_M) {
            if !moves_far(predicted, &world_from_robot, FAR_M.1, FAR_RAD.1) {
                continue;
            }
            let there = self.estimate.prepare_at(self.arrival, self.config, &world_from_robot);
            let there = self.claims(there, LOG_SLIPPED).into_iter();
            let there = there.filter(|claim| claim.assignment.pairs.len() >= least);
            let turned =
                !may_turn_to_alike(&self.arrival.scan.observations, predicted, &world_from_robot);
            claims.extend(there.map(|claim| Claim { far: true, turned, ..claim }));
        }
        self.weigh(claims)
    }

    /// What fits in places that the robot must have been carried to, with so many pairs.
    fn carried(&mut self, least: usize, guess: &Isometry3<f64>) -> Vec<Judged> {
        let mut claims = Vec::new();
        for world_from_robot in self.estimate.elsewhere(self.arrival, guess) {
            let there = self.estimate.prepare_at(self.arrival, self.config, &world_from_robot);
            let there = self.claims(there, LOG_LOST).into_iter();
            let there = there.filter(|claim| claim.assignment.pairs.len() >= least);
            claims.extend(there.map(|claim| Claim { far: true, carried: true, ..claim }));
        }
        self.weigh(claims)
    }

    /// The explanations of what was prepared, which is kept.
    fn claims(&mut self, prepared: Prepared, log_prior: f64) -> Vec<Claim> {
        let (estimate, arrival, config) = (self.estimate, self.arrival, self.config);
        let (far_m, far_rad) = self.far();
        let claim = |found: &Assignment| Claim {
            prepared: self.prepared.len(),
            assignment: found.clone(),
            log_prior,
            far: found.shift_from(&prepared.belief).exceeds(far_m, far_m, far_rad),
            carried: false,
            turned: false,
            left_out: estimate.left_out(arrival, config, &prepared, found),
            beside_pairs: estimate.beside_pairs(arrival, config, &prepared, found),
        };
        let claims = prepared.assignments.iter().map(claim).collect();
        self.prepared.push(prepared);
        claims
    }

    /// Standard deviation of the motion over the ground, where it is greatest, in metres.
    fn level_m(&self) -> f64 {
        let covariance = &self.arrival.motion_covariance;
        covariance[(0, 0)].max(covariance[(1, 1)]).sqrt()
    }

    /// Correction, in metres and radians, from which on it needs proof.
    fn far(&self) -> (f64, f64) {
        let (level_m, turn_rad) = (self.level_m(), self.arrival.motion_covariance[(5, 5)].sqrt());
        let within = |x: f64, (least, most): (f64, f64)| x.clamp(least, most);
        (within(FAR_SIGMAS * level_m, FAR_M), within(FAR_SIGMAS * turn_rad, FAR_RAD))
    }

    fn weigh(&self, claims: Vec<Claim>) -> Vec<Judged> {
        let measured = self.level_m() < MEASURED_M;
        weigh(claims, self.estimate, self.prepared, self.arrival.scan, measured)
    }
}

/// Whether the walls of a scan, seen from one pose, run along or across those that it shows from another: one arm
/// of a crossing is like the next, and a room like itself from its other side.
fn may_turn_to_alike(
    scan: &[Observation],
    world_from_robot: &Isometry3<f64>,
    other: &Isometry3<f64>,
) -> bool {
    // Four times its azimuth tells a wall's direction up to right angles.
    let azimuth_rad = |seen: &Observation, pose: &Isometry3<f64>| {
        let normal = pose * seen.normal();
        normal.y.atan2(normal.x)
    };
    let upright = || scan.iter().filter(|seen| is_upright(seen));
    let has_alike = |seen: &&Observation| {
        let here_rad = azimuth_rad(seen, world_from_robot);
        let aside_rad = |it: &Observation| wrap_pi(4.0 * (azimuth_rad(it, other) - here_rad)) / 4.0;
        let alike = upright().filter(|it| aside_rad(it).abs() < ALIKE_RAD);
        alike.map(Observation::area_m2).sum::<f64>() > 0.5 * seen.area_m2()
    };
    let area_m2: f64 = upright().map(Observation::area_m2).sum();
    let alike_m2: f64 = upright().filter(has_alike).map(Observation::area_m2).sum();
    alike_m2 > 0.5 * area_m2
}

fn is_large(found: &Assignment, prepared: &Prepared) -> bool {
    found.shift_from(&prepared.belief).exceeds(LARGE_M, LARGE_UP_M, LARGE_RAD)
}

/// Whether nothing speaks against an explanation, and it is another one than what odometry led to.
fn stands_elsewhere(found: &Judged, guess: &Isometry3<f64>) -> bool {
    found.stands() && moves_far(guess, &found.assignment.belief.world_from_robot, SAME_M, SAME_RAD)
}
