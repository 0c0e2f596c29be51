//! Prediction, and which landmarks a scan may show.

use super::{Arrival, Estimate, Prepared};
use crate::mapping::anchor::beside;
use crate::mapping::association::{Assignment, AssociationConfig, Question};
use crate::mapping::attitude::attitude_rows;
use crate::mapping::belief::Belief;
use crate::mapping::graph::scaled_errors;
use crate::mapping::index::Bounds;
use crate::mapping::landmark::{Landmark, LandmarkId};
use crate::mapping::odometry::predicted_covariance;
use crate::mapping::perturbation::{first_jacobian, second_jacobian};
use crate::mapping::scan_errors::{ScanObservations, common_error_jacobian};
use nalgebra::{DMatrix, Isometry3, Matrix3, Matrix3x4, Matrix6, Vector3, Vector6};

/// Most landmarks that one scan is compared with; those seen last come first.
const MOST_CANDIDATES: usize = 120;
/// Standard deviations within which a candidate is looked for.
const REACH_SIGMAS: f64 = 3.5;
/// Part of the widening of a motion over the ground that its height, roll and pitch are widened by:
/// stuck wheels and pushes move a robot over the ground, they do not lift it off.
const WIDENED_OFF_GROUND: f64 = 0.25;
/// Limits of what an uncertain pose may open: beyond them nearly everything would be a candidate.
const MOST_OPEN_M: f64 = 20.0;
const MOST_OPEN_RAD: f64 = 0.6;

impl Prepared {
    /// The place of a landmark among the planes of the belief, if it is one of them.
    pub(in crate::mapping) fn plane_of(&self, landmark: LandmarkId) -> Option<usize> {
        self.planes.binary_search(&landmark).ok()
    }

    /// Covariance of the gap between an observation and a plane of the belief and of their tilts, under an
    /// assignment.
    pub(in crate::mapping) fn gap(
        &self,
        scan: &ScanObservations,
        assignment: &Assignment,
        observation: usize,
        plane: usize,
    ) -> Matrix3<f64> {
        let common = self.common[observation].as_ref();
        assignment.belief.pair(&scan.observations[observation], common, plane).s
    }

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
            samples: &self.samples,
            landmarks,
        }
    }
}

impl Estimate {
    /// Predicts the pose, gathers the landmarks that the scan may show, and searches for jointly
    /// compatible pairs. `widening`, at least 1, scales the standard deviations of the motion over the
    /// ground; those off it grow by a quarter of that, if at all.
    pub(in crate::mapping) fn prepare(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        widening: f64,
    ) -> Prepared {
        let scan = arrival.scan;
        let off = (WIDENED_OFF_GROUND * widening).max(1.0);
        let widened =
            Matrix6::from_diagonal(&Vector6::new(widening, widening, off, off, off, widening));
        let motion_covariance = widened * arrival.motion_covariance * widened;
        let before = self.last_pose();
        let predicted = before * arrival.motion;
        let pose_covariance = predicted_covariance(
            &before,
            &self.last_covariance(),
            &arrival.motion,
            &motion_covariance,
        );
        let (planes, candidates) = self.candidates(scan, &predicted, &pose_covariance, config);
        let mut belief = self.belief(&planes, arrival, &predicted, &motion_covariance);
        if let Some(attitude) = arrival.attitude {
            let (residual, rows) =
                attitude_rows(&belief.world_from_robot, attitude.roll_rad, attitude.pitch_rad);
            belief.absorb_attitude(&residual, &rows, attitude.sigma_rad);
        }
        let common = common_columns(scan);
        let assignments = Vec::new();
        let samples = scan.observations.iter().map(|seen| seen.mask.samples()).collect();
        let mut prepared = Prepared {
            belief,
            assignments,
            candidates,
            planes,
            common,
            samples,
            motion_covariance,
        };
        self.associate(arrival, config, &mut prepared, 0);
        prepared
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

    /// See [`Question::pieces`].
    pub(in crate::mapping) fn pieces(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &Prepared,
        assignment: &Assignment,
    ) -> f64 {
        let landmarks = self.named(&prepared.planes);
        prepared.question(arrival, &landmarks).pieces(assignment, config)
    }

    pub(super) fn named(&self, planes: &[LandmarkId]) -> Vec<&Landmark> {
        planes.iter().map(|&id| self.landmark(id).expect("candidates come from the map")).collect()
    }

    /// For each observation the landmarks that its box reaches and that face it, as positions in the
    /// list of all candidates.
    fn candidates(
        &self,
        scan: &ScanObservations,
        predicted: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
        config: &AssociationConfig,
    ) -> (Vec<LandmarkId>, Vec<Vec<usize>>) {
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
        (all, positions)
    }

    /// Joint belief over the predicted pose and the candidates, beside the last keyframe.
    fn belief(
        &self,
        planes: &[LandmarkId],
        arrival: &Arrival<'_>,
        predicted: &Isometry3<f64>,
        motion_covariance: &Matrix6<f64>,
    ) -> Belief {
        let before = self.last_pose();
        let frames: Vec<Isometry3<f64>> =
            self.named(planes).iter().map(|landmark| landmark.world_from_plane).collect();
        let Some(last) = self.keyframes.last() else {
            let (start, motion) = (&self.start_covariance, &arrival.motion);
            let pose = predicted_covariance(&before, start, motion, motion_covariance);
            let pose = DMatrix::from_column_slice(6, 6, pose.as_slice());
            return Belief::new(*predicted, frames, &pose, arrival.scan.errors.any());
        };
        // The last keyframe twice: as the anchor, and as the pose that the motion leads on from.
        let mut keys = vec![last.pose, last.pose];
        keys.extend(planes.iter().map(|id| self.roots[id].key));
        let mut joint = self.graph.covariance(&keys);
        let f_x = first_jacobian(&before, predicted);
        let f_u = second_jacobian(&before);
        let rows = f_x * joint.fixed_rows::<6>(6);
        joint.fixed_rows_mut::<6>(6).copy_from(&rows);
        let columns = joint.fixed_columns::<6>(6) * f_x.transpose();
        joint.fixed_columns_mut::<6>(6).copy_from(&columns);
        let mut on_pose = joint.fixed_view_mut::<6, 6>(6, 6);
        on_pose += f_u * motion_covariance * f_u.transpose();
        let joint = beside(&before, predicted, &frames, &joint);
        Belief::new(*predicted, frames, &joint, arrival.scan.errors.any())
    }
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
