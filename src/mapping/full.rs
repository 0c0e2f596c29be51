//! The full mode: landmarks with covariance and correlations, loops, and several explanations where
//! the data allow several.

use super::association::AssociationConfig;
use super::claims::{SAME_M, SAME_RAD, TOLERATED_SHARE, UNPROVEN, moves_far};
use super::curved::CurvedLandmark;
use super::estimate::{Arrival, Attitude, Estimate, Prepared};
use super::fork::{Fork, Way};
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

/// An explanation behind the best by this much is dropped.
const DEAD: f64 = 15.0;
/// Most explanations that are carried, and scans that one may be carried without becoming the best.
const MOST_HYPOTHESES: usize = 3;
const LONGEST_BEHIND: usize = 12;

/// An explanation behind the best by less than this counts in what is told of the robot's place.
const HARDLY_LESS: f64 = 4.0;

/// A scan is not explained at all where its best explanation's logarithm is less.
const UNEXPLAINED: f64 = -25.0;

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
    log_weight: f64,
    carried: bool,
    way: Way,
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
        leave_undecided(&mut branches);
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
        let Hypothesis { estimate, log_weight, carried, .. } = &self.hypotheses[parent];
        let alone = self.hypotheses.len() == 1;
        let ways = Fork::new(estimate, arrival, &self.config.association, prepared).ways(alone);
        branches.extend(ways.into_iter().map(|way| Branch {
            parent,
            log_weight: log_weight + way.explanation.score,
            carried: *carried || way.explanation.carried,
            way,
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
            let (prepared, assignment) =
                (&prepared[branch.way.explanation.prepared], &branch.way.explanation.assignment);
            let ask = || from.estimate.verdicts(arrival, prepared, assignment, config);
            let verdicts = branch.way.verdicts.clone().unwrap_or_else(ask);
            let report = from.estimate.apply(arrival, prepared, assignment, &verdicts, config);
            from.estimate.let_go(&branch.way.explanation.gone);
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
        report.covariance += self.spread(|estimate| Some(estimate.last_pose()));
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

    /// Covariance of that pose as a perturbation `[δt; δr]` in the world frame. What other explanations that are
    /// hardly less likely say of it counts.
    pub fn covariance(&self) -> Matrix6<f64> {
        self.best().last_covariance() + self.spread(|estimate| Some(estimate.last_pose()))
    }

    /// What is added to the covariance of a pose of the best explanation because others have it elsewhere:
    /// `Σ wᵢ δᵢ δᵢᵀ`, the mixture's spread about the best.
    fn spread(&self, pose_in: impl Fn(&Estimate) -> Option<Isometry3<f64>>) -> Matrix6<f64> {
        let Some(best) = pose_in(self.best()) else { return Matrix6::zeros() };
        let likely = self.hypotheses.iter().filter(|other| other.log_weight > -HARDLY_LESS);
        let (mut sum, mut spread) = (0.0, Matrix6::zeros());
        for other in likely {
            let weight = other.log_weight.exp();
            sum += weight;
            if let Some(pose) = pose_in(&other.estimate) {
                let off = pose_error(&best, &pose);
                spread += weight * off * off.transpose();
            }
        }
        spread / sum.max(1.0)
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
        let motion_in =
            |estimate: &Estimate| Some(estimate.pose(first)?.inverse() * estimate.pose(second)?);
        Some(self.best().motion_covariance(first, second)? + self.spread(motion_in))
    }

    /// What the planes of a scan were taken for: landmark and observation of each.
    pub fn sightings(&self, keyframe: usize) -> impl Iterator<Item = (LandmarkId, &Observation)> {
        self.best().sightings(keyframe)
    }

    /// Pose at a scan, by its number; `None` for an unknown one.
    pub fn keyframe(&self, number: usize) -> Option<Isometry3<f64>> {
        self.best().pose(number)
    }

    /// Poses at all scans.
    pub fn keyframes(&self) -> Vec<Isometry3<f64>> {
        self.best().poses()
    }
}

/// A change of an old pose that is told when another explanation becomes the best.
const TOLD_M: f64 = 0.02;
const TOLD_RAD: f64 = 0.005;

/// Of the ways to go on from one explanation that put the robot in one place the first: to take in all of
/// them would copy the map to find out that they are one.
fn keep_one_per_place(branches: &mut Vec<Branch>) {
    let mut places: Vec<(usize, Isometry3<f64>)> = Vec::new();
    branches.retain(|branch| {
        let place = branch.way.explanation.assignment.belief.world_from_robot;
        let known = places.iter().any(|(parent, other)| {
            *parent == branch.parent && !moves_far(other, &place, SAME_M, SAME_RAD)
        });
        places.extend((!known).then_some((branch.parent, place)));
        !known
    });
}

/// What no explanation explains speaks for none of them: by how much each of them misses it is chance.
fn leave_undecided(branches: &mut [Branch]) {
    let parents = branches.iter().map(|branch| branch.parent).max().map_or(0, |last| last + 1);
    for parent in 0..parents {
        let own = |branch: &Branch| branch.parent == parent;
        let scores = branches.iter().filter(|branch| own(branch));
        let best =
            scores.map(|branch| branch.way.explanation.score).fold(f64::NEG_INFINITY, f64::max);
        for branch in branches.iter_mut().filter(|branch| own(branch)) {
            branch.log_weight += (UNEXPLAINED - best).max(0.0);
        }
    }
}

/// Explanations that have the robot carried elsewhere stay behind those that follow odometry until what
/// is seen contradicts them: in a row of like rooms the old ones are recognised scan after scan.
fn hold_back(branches: &mut [Branch]) {
    let led = branches.iter().filter(|branch| !branch.carried);
    let Some(led) = led.max_by(|a, b| a.log_weight.total_cmp(&b.log_weight)) else { return };
    let (log_weight, refuted) = (led.log_weight, led.way.explanation.refuted);
    for branch in branches.iter_mut().filter(|branch| branch.carried) {
        if refuted <= branch.way.explanation.refuted + TOLERATED_SHARE {
            branch.log_weight = branch.log_weight.min(log_weight - UNPROVEN);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two explanations half a metre apart, the second behind by so much.
    fn torn(behind: f64) -> Full {
        let covariance = Matrix6::identity() * 1e-4;
        let mut full = Full::new(FullConfig::default(), Isometry3::identity(), &covariance);
        let there = Isometry3::translation(0.5, 0.0, 0.0);
        full.hypotheses.push(Hypothesis {
            estimate: Estimate::new(GraphConfig::default(), there, &covariance),
            log_weight: -behind,
            behind: 1,
            carried: false,
        });
        full
    }

    #[test]
    fn an_explanation_that_is_as_likely_counts_in_what_is_told() {
        // Of two alike each has half of the weight.
        let told = torn(0.0).covariance();
        assert!((told[(0, 0)] - (1e-4 + 0.5 * 0.25)).abs() < 1e-6, "{told}");
        assert!((told[(1, 1)] - 1e-4).abs() < 1e-6, "{told}");
        // The less likely it is the less it says, and an unlikely one nothing.
        let share = (-2.0_f64).exp() / (1.0 + (-2.0_f64).exp());
        assert!((torn(2.0).covariance()[(0, 0)] - (1e-4 + share * 0.25)).abs() < 1e-6);
        assert!((torn(5.0).covariance()[(0, 0)] - 1e-4).abs() < 1e-6);
    }
}
