//! Prediction, and which landmarks a scan may show.

use super::{Arrival, Estimate, Prepared};
use crate::mapping::association::{Assignment, AssociationConfig, Question, Verdict};
use crate::mapping::attitude::attitude_rows;
use crate::mapping::belief::{Belief, anchored};
use crate::mapping::graph::{Key, scaled_errors};
use crate::mapping::index::Bounds;
use crate::mapping::landmark::{Landmark, LandmarkId};
use crate::mapping::odometry::predicted_covariance;
use crate::mapping::perturbation::{first_jacobian, second_jacobian};
use crate::mapping::scan_errors::{ScanObservations, common_error_jacobian};
use nalgebra::{DMatrix, Isometry3, Matrix2, Matrix3, Matrix3x4, Matrix6, Vector3};

/// Most landmarks that one scan is compared with; those seen last come first.
const MOST_CANDIDATES: usize = 120;
/// Standard deviations within which a candidate is looked for.
const REACH_SIGMAS: f64 = 3.5;
/// Limits of what an uncertain pose may open: beyond them nearly everything would be a candidate.
const MOST_OPEN_M: f64 = 20.0;
const MOST_OPEN_RAD: f64 = 0.6;
/// Scans within which a landmark was seen lately.
const RECENT: usize = 12;
/// What a common shift and a common turn make of one another, in metres, up to which the world is as
/// good a frame as the anchor's: it stays below what a plane is measured to.
const LINEAR_M: f64 = 5e-4;

/// Landmarks that a scan may show.
struct Candidates {
    /// In ascending order.
    planes: Vec<LandmarkId>,
    /// For each observation those that it may be, as positions in `planes`.
    of_each: Vec<Vec<usize>>,
}

impl Candidates {
    /// Those that are `wanted`.
    fn of(&self, wanted: impl Fn(LandmarkId) -> bool) -> Self {
        let kept: Vec<usize> = (0..self.planes.len()).filter(|&i| wanted(self.planes[i])).collect();
        let positions = |list: &Vec<usize>| -> Vec<usize> {
            list.iter().filter_map(|position| kept.binary_search(position).ok()).collect()
        };
        Self {
            planes: kept.iter().map(|&i| self.planes[i]).collect(),
            of_each: self.of_each.iter().map(positions).collect(),
        }
    }
}

impl Prepared {
    /// The question which observation is which of `landmarks`, those named by the planes.
    pub(super) fn question<'a>(
        &'a self,
        arrival: &Arrival<'a>,
        landmarks: &'a [&'a Landmark],
    ) -> Question<'a> {
        Question {
            observations: &arrival.scan.observations,
            common: &self.common,
            candidates: &self.candidates,
            landmarks,
            recent: &self.recent,
            drift: self.drift,
        }
    }
}

impl Estimate {
    /// Predicts the pose, gathers the landmarks that the scan may show, and searches for jointly
    /// compatible pairs. `widening` scales the standard deviations of the motion.
    pub(in crate::mapping) fn prepare(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        widening: f64,
    ) -> Prepared {
        let scan = arrival.scan;
        let motion_covariance = arrival.motion_covariance * (widening * widening);
        let before = self.last_pose();
        let predicted = before * arrival.motion;
        let pose_covariance = predicted_covariance(
            &before,
            &self.last_covariance(),
            &arrival.motion,
            &motion_covariance,
        );
        let all = self.candidates(scan, &predicted, &pose_covariance, config);
        let compare = |candidates: Candidates| {
            self.compare(arrival, config, &predicted, &motion_covariance, candidates)
        };
        // What was seen lately is tied closely to the last pose and costs little to ask about; what is
        // older has its turn where something remains that it might explain.
        let recent = all.of(|id| self.seen_lately(id));
        if recent.planes.len() < all.planes.len() {
            let prepared = compare(recent);
            if self.leaves_nothing(arrival, config, &prepared, &all) {
                return prepared;
            }
        }
        compare(all)
    }

    /// Joint belief over the predicted pose and candidates, and the search among them.
    fn compare(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        predicted: &Isometry3<f64>,
        motion_covariance: &Matrix6<f64>,
        candidates: Candidates,
    ) -> Prepared {
        let Candidates { planes, of_each: candidates } = candidates;
        let motion_covariance = *motion_covariance;
        let anchor = self.anchor();
        let anchor_covariance = anchor.map_or_else(Matrix6::zeros, |anchor| anchor.1);
        let drift = deviations(&anchor_covariance);
        let anchor = anchor.map(|anchor| anchor.0);
        let mut belief = self.belief(&planes, arrival, predicted, &motion_covariance, anchor);
        let recent: Vec<bool> = planes.iter().map(|&id| self.seen_lately(id)).collect();
        if let Some(attitude) = arrival.attitude {
            let (residual, rows) =
                attitude_rows(&belief.world_from_robot, attitude.roll_rad, attitude.pitch_rad);
            // What the anchor's own attitude is wrong by is not in the belief.
            let noise = Matrix2::identity() * attitude.sigma_rad.powi(2)
                + rows * anchor_covariance * rows.transpose();
            belief.absorb_attitude(&residual, &rows, &noise);
        }
        let common = common_columns(arrival.scan);
        let assignments = Vec::new();
        let mut prepared = Prepared {
            belief,
            assignments,
            candidates,
            planes,
            recent,
            drift,
            common,
            motion_covariance,
        };
        self.associate(arrival, config, &mut prepared, 0);
        prepared
    }

    /// The keyframe beside which a scan is believed to be somewhere, with its covariance in the world:
    /// the oldest of those whose landmarks count as seen lately, so that all that was left open since
    /// is in the belief. None where that is known so well that linearising in the world does no harm.
    fn anchor(&self) -> Option<(Key, Matrix6<f64>)> {
        let key = self.keyframes.get(self.keyframes.len().saturating_sub(RECENT))?.pose;
        let covariance = Matrix6::from_column_slice(self.graph.covariance(&[key]).as_slice());
        let (shift_m, turn_rad) = deviations(&covariance);
        (shift_m * turn_rad > LINEAR_M).then_some((key, covariance))
    }

    /// Covariance of a pose beside a landmark's part of the map, from that beside the anchor: an old
    /// landmark has not drifted with it.
    pub(in crate::mapping) fn position_covariance_beside(
        &self,
        id: LandmarkId,
        beside_anchor: &Matrix3<f64>,
        drift: &Matrix3<f64>,
    ) -> Matrix3<f64> {
        if self.seen_lately(id) { *beside_anchor } else { beside_anchor + drift }
    }

    /// Covariance of the anchor's position in the world.
    pub(in crate::mapping) fn position_drift(&self) -> Matrix3<f64> {
        let covariance = self.anchor().map_or_else(Matrix6::zeros, |anchor| anchor.1);
        covariance.fixed_view::<3, 3>(0, 0).into_owned()
    }

    fn seen_lately(&self, id: LandmarkId) -> bool {
        self.landmark(id).is_some_and(|l| l.last_keyframe + RECENT >= self.keyframes.len())
    }

    /// Whether a comparison recognised every observation that older candidates might explain, and in
    /// one way only.
    fn leaves_nothing(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &Prepared,
        all: &Candidates,
    ) -> bool {
        let [assignment] = prepared.assignments.as_slice() else { return false };
        let landmarks = self.named(&prepared.planes);
        let verdicts = prepared.question(arrival, &landmarks).decide(assignment, config);
        verdicts.iter().zip(&prepared.candidates).zip(&all.of_each).all(
            |((verdict, asked), all)| {
                matches!(verdict, Verdict::Seen(..)) || asked.len() == all.len()
            },
        )
    }

    /// Searches for jointly compatible pairs, see [`Question::search`].
    pub(in crate::mapping) fn associate(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &mut Prepared,
        slack: usize,
    ) {
        let landmarks = self.named(&prepared.planes);
        let question = prepared.question(arrival, &landmarks);
        prepared.assignments = question.search(&prepared.belief, config, slack);
    }

    /// Observations that an assignment leaves out though they fit a landmark, with those landmarks; see
    /// [`Question::left_out`].
    pub(in crate::mapping) fn left_out(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &Prepared,
        assignment: &Assignment,
    ) -> Vec<(usize, LandmarkId)> {
        let landmarks = self.named(&prepared.planes);
        let question = prepared.question(arrival, &landmarks);
        let left_out = question.left_out(assignment, config).into_iter();
        left_out.map(|(observation, plane)| (observation, prepared.planes[plane])).collect()
    }

    pub(super) fn named(&self, planes: &[LandmarkId]) -> Vec<&Landmark> {
        planes.iter().map(|&id| self.landmark(id).expect("candidates come from the map")).collect()
    }

    /// For each observation the landmarks that its box reaches and that face it.
    fn candidates(
        &self,
        scan: &ScanObservations,
        predicted: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
        config: &AssociationConfig,
    ) -> Candidates {
        let spread = |range: std::ops::Range<usize>| {
            REACH_SIGMAS * range.map(|i| covariance[(i, i)].max(0.0)).fold(0.0, f64::max).sqrt()
        };
        let (open_m, open_rad) = (spread(0..3).min(MOST_OPEN_M), spread(3..6).min(MOST_OPEN_RAD));
        let least_facing = (config.max_angle_rad + open_rad).cos();
        let lists: Vec<Vec<LandmarkId>> = scan
            .observations
            .iter()
            .map(|observation| {
                let reach = observation.robot_from_plane.translation.vector.norm();
                let open = open_m + reach * open_rad;
                let world = predicted * observation.robot_from_plane;
                let normal = world.rotation * Vector3::z();
                let points = observation.hull_points().map(|p| predicted * p);
                let Some(bounds) = Bounds::around(points, config.max_gap_m + open) else {
                    return Vec::new();
                };
                let fits = |landmark: &Landmark| {
                    let apart = world.translation.vector - landmark.origin().coords;
                    landmark.normal().dot(&normal) > least_facing
                        && landmark.normal().dot(&apart).abs() < config.max_offset_m + open
                };
                let near = self.index.query(&bounds).into_iter().map(LandmarkId);
                near.filter(|&id| self.landmark(id).is_some_and(fits)).collect()
            })
            .collect();
        let mut all: Vec<LandmarkId> = lists.iter().flatten().copied().collect();
        all.sort_unstable();
        all.dedup();
        if all.len() > MOST_CANDIDATES {
            let last_seen = |id: LandmarkId| self.landmark(id).map_or(0, |l| l.last_keyframe);
            all.sort_by_key(|&id| (std::cmp::Reverse(last_seen(id)), id));
            all.truncate(MOST_CANDIDATES);
            all.sort_unstable();
        }
        let positions = lists
            .iter()
            .map(|list| list.iter().filter_map(|id| all.binary_search(id).ok()).collect())
            .collect();
        Candidates { planes: all, of_each: positions }
    }

    /// Joint belief over the predicted pose and the candidates.
    fn belief(
        &self,
        planes: &[LandmarkId],
        arrival: &Arrival<'_>,
        predicted: &Isometry3<f64>,
        motion_covariance: &Matrix6<f64>,
        anchor: Option<Key>,
    ) -> Belief {
        let before = self.last_pose();
        let frames: Vec<Isometry3<f64>> =
            self.named(planes).iter().map(|landmark| landmark.world_from_plane).collect();
        let mut keys: Vec<Key> = self.keyframes.last().map(|last| last.pose).into_iter().collect();
        keys.extend(planes.iter().map(|id| self.roots[id].key));
        let mut joint = match anchor {
            _ if self.is_empty() => {
                DMatrix::from_column_slice(6, 6, self.start_covariance.as_slice())
            }
            Some(anchor) => {
                keys.insert(0, anchor);
                let joint = self.graph.covariance(&keys);
                anchored(&joint, &self.graph.pose(anchor), &before, &frames)
            }
            None => self.graph.covariance(&keys),
        };
        let f_x = first_jacobian(&before, predicted);
        let f_u = second_jacobian(&before);
        let rows = f_x * joint.fixed_rows::<6>(0);
        joint.fixed_rows_mut::<6>(0).copy_from(&rows);
        let columns = joint.fixed_columns::<6>(0) * f_x.transpose();
        joint.fixed_columns_mut::<6>(0).copy_from(&columns);
        let mut on_pose = joint.fixed_view_mut::<6, 6>(0, 0);
        on_pose += f_u * motion_covariance * f_u.transpose();
        Belief::new(*predicted, frames, &joint, arrival.scan.errors.any())
    }
}

/// Standard deviations over all three axes: metres, radians.
fn deviations(covariance: &Matrix6<f64>) -> (f64, f64) {
    let over = |axes: std::ops::Range<usize>| {
        axes.map(|axis| covariance[(axis, axis)].max(0.0)).sum::<f64>().sqrt()
    };
    (over(0..3), over(3..6))
}

/// Each observation's columns for the scan's common errors, in units of their standard deviations.
fn common_columns(scan: &ScanObservations) -> Vec<Option<Matrix3x4<f64>>> {
    let sigmas = scan.errors.sigmas();
    scan.observations
        .iter()
        .map(|observation| {
            scan.errors.any().then(|| {
                let jacobian = common_error_jacobian(observation, &scan.robot_from_scan);
                scaled_errors(&jacobian, &sigmas)
            })
        })
        .collect()
}
