//! The full mode: landmarks with covariance and correlations, loops, and several explanations where
//! the data allow several.

use super::association::{Assignment, AssociationConfig};
use super::claims::{
    Claim, TOLERATED_SHARE, UNPROVEN, judge, recognised_share, upright_share, weigh,
};
use super::curved::CurvedLandmark;
use super::estimate::{Arrival, Attitude, Estimate, Prepared};
use super::graph::GraphConfig;
use super::landmark::{Landmark, LandmarkId};
use super::observation::Observation;
use super::perturbation::pose_error;
use super::report::{MovedKeyframe, UpdateReport};
use super::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Matrix3, Matrix6};
use serde::{Deserialize, Serialize};

/// Settings of the full mode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FullConfig {
    /// Data association.
    pub association: AssociationConfig,
    /// The graph.
    pub graph: GraphConfig,
}

/// How much worse than told odometry may be before the scan is no longer believed: the motion's
/// standard deviations are widened by this when a scan does not fit the map.
const WIDENING: f64 = 6.5;
/// The same where that finds nothing either: wheels that slip or stick for a moment put the robot beside
/// itself, and what it sees there may be new for the most part. Another place that fits better is no proof.
const SLIPPED: f64 = 20.0;
/// Pairs below which a scan is tried again with a widened motion.
const FEW_PAIRS: usize = 3;
/// Logarithm of how seldom a motion is that much worse than told: stuck wheels, a push.
const LOG_SELDOM: f64 = -7.0;
/// The same for wheels that slip or stick for a moment.
const LOG_SLIPPED: f64 = -9.0;
/// The same for a motion that tells nothing: a robot lifted and set down elsewhere, wheels that ran free.
const LOG_LOST: f64 = -14.0;
/// Share of a scan's upright area below which it may have been made elsewhere altogether.
const LOST_SHARE: f64 = 0.25;
/// Logarithm of how seldom a scan in the midst of a map shows nothing of it. Without it the pairs of a
/// scan that shows three planes would be left out as often as noise makes all of them miss widely.
const LOG_UNRECOGNISED: f64 = -5.0;
/// Share of a scan's planes and of their area that is recognised from which on one explanation is taken as it
/// comes, and share of its points that contradict the map beyond which none is: the motion may be worse than
/// told.
const KNOWN_SHARE: f64 = 0.6;
const REFUTED_SHARE: f64 = 0.1;
/// Standard deviation of a motion over the ground from which on nobody has measured it.
const OPEN_M: f64 = 0.25;
/// Corrections that are looked at twice, whatever the odometry's noise allows, and how many pairs
/// fewer another explanation may then have.
const LARGE_M: f64 = 0.1;
const LARGE_RAD: f64 = 0.03;
/// The same for the height: a kerb beside the floor is another surface for the same wheels.
const LARGE_UP_M: f64 = 0.03;
const SLACK: usize = 2;
/// Corrections that need proof.
const FAR_M: f64 = 0.8;
const FAR_RAD: f64 = 0.35;
/// An explanation behind the best by this much is dropped.
const DEAD: f64 = 15.0;
/// Most explanations that are carried, and scans that one may be carried without becoming the best.
const MOST_HYPOTHESES: usize = 3;
const LONGEST_BEHIND: usize = 12;

/// One explanation of everything seen so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Hypothesis {
    estimate: Estimate,
    /// Logarithm of its weight beside the best, which has 0.
    log_weight: f64,
    /// Scans since it was the best or began.
    behind: usize,
    /// Whether it has the robot carried elsewhere and was never the best.
    carried: bool,
}

/// The full mode's state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Full {
    config: FullConfig,
    /// Best first; never empty.
    hypotheses: Vec<Hypothesis>,
    /// Poses of the keyframes as they were told to the outside, by whatever explanation led then.
    told: Vec<Isometry3<f64>>,
    /// The number of the next landmark, whatever explanation it will belong to.
    next_landmark: u32,
}

/// One way to go on from a hypothesis.
struct Branch {
    parent: usize,
    prepared: usize,
    assignment: Assignment,
    log_weight: f64,
    /// Share of the scan that contradicts it; 0 where nobody asked.
    refuted: f64,
    carried: bool,
}

impl Full {
    /// An empty map at a pose.
    pub fn new(
        config: FullConfig,
        world_from_robot: Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) -> Self {
        let estimate = Estimate::new(config.graph, world_from_robot, covariance);
        let first = Hypothesis { estimate, log_weight: 0.0, behind: 0, carried: false };
        Self { config, hypotheses: vec![first], told: Vec::new(), next_landmark: 0 }
    }

    /// Takes in a scan made after `motion`, whose covariance is a perturbation in the frame at its
    /// beginning, and the attitude (roll, pitch, standard deviation) measured with it.
    ///
    /// Where the scan can be explained in several ways that put the robot elsewhere, all of them are
    /// carried until what is seen later leaves one; the report is that of the best.
    pub fn observe(
        &mut self,
        motion: &Isometry3<f64>,
        motion_covariance: &Matrix6<f64>,
        attitude: Option<(f64, f64, f64)>,
        scan: &ScanObservations,
    ) -> UpdateReport {
        let arrival = Arrival {
            motion: *motion,
            motion_covariance: *motion_covariance,
            attitude: attitude.map(|(roll_rad, pitch_rad, sigma_rad)| Attitude {
                roll_rad,
                pitch_rad,
                sigma_rad,
            }),
            scan,
        };
        let mut prepared = Vec::new();
        let mut branches: Vec<Branch> = Vec::new();
        for parent in 0..self.hypotheses.len() {
            self.branch(parent, &arrival, &mut prepared, &mut branches);
        }
        hold_back(&mut branches);
        branches.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
        let best = branches[0].log_weight;
        branches.retain(|branch| branch.log_weight > best - DEAD);
        keep_one_per_place(&mut branches);
        branches.truncate(MOST_HYPOTHESES);
        self.follow(&arrival, &prepared, &branches)
    }

    /// The ways to go on from one hypothesis.
    fn branch(
        &self,
        parent: usize,
        arrival: &Arrival<'_>,
        prepared: &mut Vec<Prepared>,
        branches: &mut Vec<Branch>,
    ) {
        let config = &self.config.association;
        let Hypothesis { estimate, log_weight, carried, .. } = &self.hypotheses[parent];
        let mut plain = estimate.prepare(arrival, config, 1.0);
        let found = &plain.assignments[0];
        let pairs = found.pairs.len();
        let most = arrival.scan.observations.len().min(config.anchors);
        let few = !estimate.landmarks().is_empty() && pairs < (most / 3).max(FEW_PAIRS);
        let large = found.shift_from(&plain.belief).exceeds(LARGE_M, LARGE_UP_M, LARGE_RAD);
        let place = prepared.len();
        let doubled = (2 * pairs).max(FEW_PAIRS + 1);
        let (predicted, guess) = (plain.belief.world_from_robot, found.belief.world_from_robot);
        let carried_to = |least: usize| -> Vec<Prepared> {
            let places = estimate.elsewhere(arrival, &guess);
            let there = places.iter().map(|place| estimate.prepare_at(arrival, config, place));
            there.filter(|there| there.assignments.iter().any(|a| a.pairs.len() >= least)).collect()
        };
        let lost = few || upright_share(found, arrival.scan) < LOST_SHARE;
        let mut elsewhere = if lost { carried_to(doubled) } else { Vec::new() };
        let plainly = !few
            && !large
            && elsewhere.is_empty()
            && plain.assignments.len() == 1
            && self.hypotheses.len() == 1
            && pairs as f64 >= KNOWN_SHARE * most as f64
            && recognised_share(found, arrival.scan) >= KNOWN_SHARE
            && !estimate.misplaces(arrival.scan, &plain, found);
        if plainly {
            let assignment = found.clone();
            branches.push(Branch {
                parent,
                prepared: place,
                assignment,
                log_weight: 0.0,
                refuted: 0.0,
                carried: false,
            });
            prepared.push(plain);
            return;
        }
        if large {
            estimate.associate(arrival, config, &mut plain, SLACK);
            let is_large = |found: &Assignment| {
                found.shift_from(&plain.belief).exceeds(LARGE_M, LARGE_UP_M, LARGE_RAD)
            };
            if plain.assignments.iter().all(is_large) {
                estimate.associate_near(arrival, config, &mut plain, LARGE_M);
            }
        }
        let options = |prepared: &Prepared, place: usize, log_prior: f64| -> Vec<Claim> {
            let claim = |found: &Assignment| Claim {
                prepared: place,
                assignment: found.clone(),
                log_prior,
                far: found.shift_from(&prepared.belief).exceeds(FAR_M, FAR_M, FAR_RAD),
                carried: false,
                left_out: estimate.left_out(arrival, config, prepared, found),
                pieces: estimate.pieces(arrival, config, prepared, found),
            };
            prepared.assignments.iter().map(claim).collect()
        };
        let mut claims = options(&plain, place, 0.0);
        // That nothing was recognised is an explanation too.
        claims.push(Claim {
            prepared: place,
            assignment: Assignment::none(&plain.belief),
            log_prior: LOG_UNRECOGNISED,
            far: false,
            carried: false,
            left_out: Vec::new(),
            pieces: 0.0,
        });
        prepared.push(plain);
        let mut weighed = weigh(claims, estimate, prepared, arrival.scan);
        let mut judged = judge(weighed.clone(), arrival.scan);
        let best = judged.iter().max_by(|a, b| a.score.total_cmp(&b.score));
        let stands = best.is_some_and(|best| {
            best.score >= 0.0 && best.refuted <= REFUTED_SHARE && best.misplaced == 0
        });
        // Pairs that the map speaks against are no measure of what another place must show.
        let least = if few || stands { doubled } else { FEW_PAIRS + 1 };
        let more = |claim: &Claim| claim.assignment.pairs.len() >= least;
        let mut farther: Vec<Claim> = Vec::new();
        if few || !stands {
            // A pair or two fit somewhere within so wide a reach whatever was seen.
            let least_slipped = (pairs + 1).max(FEW_PAIRS);
            for (widening, log_prior, least) in
                [(WIDENING, LOG_SELDOM, least), (SLIPPED, LOG_SLIPPED, least_slipped)]
            {
                let wide = estimate.prepare(arrival, config, widening);
                let options = options(&wide, prepared.len(), log_prior).into_iter();
                farther.extend(options.filter(|claim| claim.assignment.pairs.len() >= least));
                prepared.push(wide);
                if !farther.is_empty() {
                    break;
                }
            }
        }
        // A motion that nobody measured is looked for by geometry, too: so far off too much fits by chance.
        let is_open = (0..2).any(|i| arrival.motion_covariance[(i, i)] > OPEN_M * OPEN_M);
        if is_open {
            for (world_from_robot, log_prior) in estimate.within_reach(arrival) {
                let there = estimate.prepare_at(arrival, config, &world_from_robot);
                let far = moves_far(&predicted, &world_from_robot, FAR_M, FAR_RAD);
                let options = options(&there, prepared.len(), log_prior).into_iter();
                farther.extend(options.map(|claim| Claim { far: claim.far || far, ..claim }));
                prepared.push(there);
            }
        }
        if farther.is_empty() {
            if !stands && !lost {
                elsewhere = carried_to(least);
            }
            for there in elsewhere {
                let options = options(&there, prepared.len(), LOG_LOST).into_iter().filter(more);
                farther.extend(options.map(|claim| Claim { far: true, carried: true, ..claim }));
                prepared.push(there);
            }
        }
        if !farther.is_empty() {
            weighed.extend(weigh(farther, estimate, prepared, arrival.scan));
            judged = judge(weighed, arrival.scan);
        }
        branches.extend(judged.into_iter().map(|judged| Branch {
            parent,
            prepared: judged.prepared,
            assignment: judged.assignment,
            log_weight: log_weight + judged.score,
            refuted: judged.refuted,
            carried: *carried || judged.carried,
        }));
    }

    /// Goes on along the branches, best first, and reports the first.
    fn follow(
        &mut self,
        arrival: &Arrival<'_>,
        prepared: &[Prepared],
        branches: &[Branch],
    ) -> UpdateReport {
        let config = &self.config.association;
        let switched = branches[0].parent != 0;
        let mut parents: Vec<Option<Hypothesis>> =
            std::mem::take(&mut self.hypotheses).into_iter().map(Some).collect();
        let mut first_report = None;
        for (at, branch) in branches.iter().enumerate() {
            let needed_again = branches[at + 1..].iter().any(|other| other.parent == branch.parent);
            let parent = &mut parents[branch.parent];
            let from = if needed_again { parent.clone() } else { parent.take() };
            let mut from = from.expect("a parent is taken by its last branch");
            from.estimate.number_from(self.next_landmark);
            let report = from.estimate.apply(
                arrival,
                &prepared[branch.prepared],
                &branch.assignment,
                config,
            );
            self.next_landmark = from.estimate.next_landmark();
            let pose = from.estimate.last_pose();
            from.behind = if at == 0 { 0 } else { from.behind + 1 };
            from.carried = branch.carried && at > 0;
            from.log_weight = branch.log_weight - branches[0].log_weight;
            let known = self
                .hypotheses
                .iter()
                .any(|other| !moves_far(&other.estimate.last_pose(), &pose, SAME_M, SAME_RAD));
            if first_report.is_none() {
                first_report = Some(report);
                self.hypotheses.push(from);
            } else if !known && from.behind <= LONGEST_BEHIND {
                self.hypotheses.push(from);
            }
        }
        let mut report = first_report.expect("there is always a branch");
        report.hypotheses = self.hypotheses.len();
        self.tell(&mut report, switched);
        report
    }

    /// Notes the poses that a report tells, and adds to it those that another explanation moves.
    fn tell(&mut self, report: &mut UpdateReport, switched: bool) {
        if switched {
            report.loop_undone = true;
            report.moved.clear();
            let poses = self.hypotheses[0].estimate.poses();
            for (keyframe, (told, pose)) in self.told.iter_mut().zip(poses).enumerate() {
                if moves_far(told, &pose, TOLD_M, TOLD_RAD) {
                    report.moved.push(MovedKeyframe {
                        keyframe,
                        before: *told,
                        world_from_robot: pose,
                    });
                    *told = pose;
                }
            }
        } else {
            for moved in &report.moved {
                self.told[moved.keyframe] = moved.world_from_robot;
            }
        }
        self.told.push(report.world_from_robot);
    }

    fn best(&self) -> &Estimate {
        &self.hypotheses[0].estimate
    }

    /// Whether nothing was observed yet.
    pub fn is_empty(&self) -> bool {
        self.best().is_empty()
    }

    /// Pose at the last scan.
    pub fn world_from_robot(&self) -> Isometry3<f64> {
        self.best().last_pose()
    }

    /// Covariance of that pose as a perturbation `[δt; δr]` in the world frame.
    pub fn covariance(&self) -> Matrix6<f64> {
        self.best().last_covariance()
    }

    /// The landmarks, by identity.
    pub fn landmarks(&self) -> &[Landmark] {
        self.best().landmarks()
    }

    /// Cylinders and spheres.
    pub fn curves(&self) -> &[CurvedLandmark] {
        self.best().curves()
    }

    /// Covariance of a landmark now; the one in the landmark is that of when it was last seen.
    pub fn landmark_covariance(&self, id: LandmarkId) -> Option<Matrix3<f64>> {
        self.best().landmark_covariance(id)
    }

    /// Covariance of the motion between two scans, as a perturbation in the frame of the first.
    pub fn motion_covariance(&self, first: usize, second: usize) -> Option<Matrix6<f64>> {
        self.best().motion_covariance(first, second)
    }

    /// What the planes of a scan were taken for: landmark and observation of each.
    pub fn sightings(&self, keyframe: usize) -> impl Iterator<Item = (LandmarkId, &Observation)> {
        self.best().sightings(keyframe)
    }

    /// Poses at all scans.
    pub fn keyframes(&self) -> Vec<Isometry3<f64>> {
        self.best().poses()
    }
}

/// Two explanations that put the robot this near to each other are one.
const SAME_M: f64 = 0.05;
const SAME_RAD: f64 = 0.01;
/// A change of an old pose that is told when another explanation becomes the best.
const TOLD_M: f64 = 0.02;
const TOLD_RAD: f64 = 0.005;

fn moves_far(a: &Isometry3<f64>, b: &Isometry3<f64>, far_m: f64, far_rad: f64) -> bool {
    let gap = pose_error(a, b);
    gap.fixed_rows::<3>(0).norm() > far_m || gap.fixed_rows::<3>(3).norm() > far_rad
}

/// Of the ways to go on from one explanation that put the robot in one place the first: to take in all of
/// them would copy the map to find out that they are one.
fn keep_one_per_place(branches: &mut Vec<Branch>) {
    let mut places: Vec<(usize, Isometry3<f64>)> = Vec::new();
    branches.retain(|branch| {
        let place = branch.assignment.belief.world_from_robot;
        let known = places.iter().any(|(parent, other)| {
            *parent == branch.parent && !moves_far(other, &place, SAME_M, SAME_RAD)
        });
        places.extend((!known).then_some((branch.parent, place)));
        !known
    });
}

/// Explanations that have the robot carried elsewhere stay behind those that follow odometry until what
/// is seen contradicts them: in a row of like rooms the old ones are recognised scan after scan.
fn hold_back(branches: &mut [Branch]) {
    let led = branches.iter().filter(|branch| !branch.carried);
    let Some(led) = led.max_by(|a, b| a.log_weight.total_cmp(&b.log_weight)) else { return };
    let (log_weight, refuted) = (led.log_weight, led.refuted);
    for branch in branches.iter_mut().filter(|branch| branch.carried) {
        if refuted <= branch.refuted + TOLERATED_SHARE {
            branch.log_weight = branch.log_weight.min(log_weight - UNPROVEN);
        }
    }
}
