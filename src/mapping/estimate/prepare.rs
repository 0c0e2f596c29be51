//! Prediction, and which landmarks a scan may show.

use super::candidates::{Led, Window};
use super::{Arrival, Estimate, Prepared};
use crate::mapping::anchor::beside;
use crate::mapping::association::{Assignment, AssociationConfig, Question, Verdict};
use crate::mapping::attitude::attitude_rows;
use crate::mapping::belief::Belief;
use crate::mapping::graph::{Key, scaled_errors};
use crate::mapping::landmark::{Landmark, LandmarkId};
use crate::mapping::observation::Observation;
use crate::mapping::odometry::predicted_covariance;
use crate::mapping::perturbation::{first_jacobian, second_jacobian};
use crate::mapping::recognise::recognise;
use crate::mapping::scan_errors::{CommonColumns, ScanObservations, common_error_jacobian};
use nalgebra::{DMatrix, Isometry3, Matrix3, Matrix6, Point3, Rotation2, Vector2, Vector6};

/// Part of the widening of a motion over the ground that its height, roll and pitch are widened by:
/// stuck wheels and pushes move a robot over the ground, they do not lift it off.
const WIDENED_OFF_GROUND: f64 = 0.25;

/// Standard deviations about a place where a scan was recognised, within which pairs are sought, and those
/// with which the motion that led there is known: not at all.
const ABOUT_M: f64 = 0.15;
const ABOUT_RAD: f64 = 0.03;
const UP_M: f64 = 0.03;
const ANYWHERE_M: f64 = 10.0;
const ANYWHERE_RAD: f64 = 1.0;
/// The same of the height, roll and pitch of a robot that has driven onto a slope or off it.
const LEANT_M: f64 = 0.1;
const LEANT_RAD: f64 = 0.15;
/// Squared Mahalanobis distance within which a motion may have gone: 99.9 % of χ² with three degrees of
/// freedom.
const REACH: f64 = 16.266;
/// Pairs that a set beside the prediction may lack of the most.
const NEAR_SLACK: usize = 1;
/// A place this near to another is the same.
const APART_M: f64 = 0.3;
const APART_RAD: f64 = 0.1;

fn moves_apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
    let gap = a.inverse() * b;
    gap.translation.vector.norm() > APART_M || gap.rotation.angle() > APART_RAD
}

impl Prepared {
    /// The place of a landmark among the planes of the belief, if it is one of them.
    pub(in crate::mapping) fn plane_of(&self, landmark: LandmarkId) -> Option<usize> {
        self.planes.binary_search(&landmark).ok()
    }

    /// The landmark behind a plane of the belief.
    pub(in crate::mapping) fn landmark_of(&self, plane: usize) -> LandmarkId {
        self.planes[plane]
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
        let off = (WIDENED_OFF_GROUND * widening).max(1.0);
        let widened =
            Matrix6::from_diagonal(&Vector6::new(widening, widening, off, off, off, widening));
        let motion_covariance = widened * arrival.motion_covariance * widened;
        let predicted = self.last_pose() * arrival.motion;
        self.prepare_after(arrival, config, arrival.motion, motion_covariance, predicted)
    }

    /// [`prepare`](Self::prepare) for a motion that wheels tell, which count on level ground whatever it is: of
    /// roll and pitch, and of the height, nothing is believed but that a robot can drive there.
    pub(in crate::mapping) fn prepare_leant(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
    ) -> Prepared {
        let mut covariance = arrival.motion_covariance;
        for (component, sigma) in [(2, LEANT_M), (3, LEANT_RAD), (4, LEANT_RAD)] {
            covariance[(component, component)] += sigma * sigma;
        }
        let predicted = self.last_pose() * arrival.motion;
        self.prepare_after(arrival, config, arrival.motion, covariance, predicted)
    }

    /// The landmarks that are still there.
    fn there(&self) -> impl Iterator<Item = &Landmark> {
        self.landmarks.iter().filter(|landmark| !landmark.gone)
    }

    /// The places other than `world_from_robot` where the scan fits the map.
    pub(in crate::mapping) fn elsewhere(
        &self,
        arrival: &Arrival<'_>,
        world_from_robot: &Isometry3<f64>,
    ) -> Vec<Isometry3<f64>> {
        let found =
            recognise(&arrival.scan.observations, self.there(), world_from_robot, |_, _| true);
        let places = found.into_iter().map(|found| found.world_from_robot);
        places.filter(|place| moves_apart(place, world_from_robot)).collect()
    }

    /// The places where the scan fits the map within what a motion's covariance `spread` leaves open, with how
    /// seldom it goes so far: the logarithm beside where it most likely went.
    pub(in crate::mapping) fn within_reach(
        &self,
        arrival: &Arrival<'_>,
        spread: &Matrix6<f64>,
    ) -> Vec<(Isometry3<f64>, f64)> {
        let before = self.last_pose();
        let predicted = before * arrival.motion;
        let level_m2 = spread[(0, 0)].max(spread[(1, 1)]);
        // Roll and pitch leave hardly anything of the motion's frame: over the ground it is a circle.
        let distance = |at: &Vector2<f64>, turn_rad: f64| {
            let gap = at - predicted.translation.vector.xy();
            gap.norm_squared() / level_m2 + turn_rad * turn_rad / spread[(5, 5)]
        };
        let (within_m, within_rad) = ((REACH * level_m2).sqrt(), (REACH * spread[(5, 5)]).sqrt());
        let landmarks = self.landmarks_within(arrival, &predicted, within_m, within_rad);
        let found = recognise(&arrival.scan.observations, landmarks, &predicted, |at, turn_rad| {
            distance(at, turn_rad) < REACH
        });
        let log_prior = |place: &Isometry3<f64>| {
            let turn = place.rotation * predicted.rotation.inverse();
            -0.5 * distance(&place.translation.vector.xy(), turn.angle())
        };
        let places = found.into_iter().map(|found| found.world_from_robot);
        places.map(|place| (place, log_prior(&place))).collect()
    }

    /// The places within so many metres and radians of where the motion led, all alike, where the scan fits the
    /// map.
    pub(in crate::mapping) fn beside(
        &self,
        arrival: &Arrival<'_>,
        within_m: f64,
        within_rad: f64,
    ) -> Vec<Isometry3<f64>> {
        let predicted = self.last_pose() * arrival.motion;
        let landmarks = self.landmarks_within(arrival, &predicted, within_m, within_rad);
        let found = recognise(&arrival.scan.observations, landmarks, &predicted, |at, turn_rad| {
            let gap = at - predicted.translation.vector.xy();
            gap.norm() < within_m && turn_rad.abs() < within_rad
        });
        found.into_iter().map(|found| found.world_from_robot).collect()
    }

    /// The places where the scan fits the map if the heading alone slipped, by whatever angle, before the way that
    /// odometry tells of or after it: within `within_m` of where that led.
    pub(in crate::mapping) fn turned(
        &self,
        arrival: &Arrival<'_>,
        within_m: f64,
    ) -> Vec<Isometry3<f64>> {
        let before = self.last_pose();
        let predicted = before * arrival.motion;
        let (from, after) = (before.translation.vector.xy(), predicted.translation.vector.xy());
        let margin_m = 2.0 * (after - from).norm() + within_m;
        let landmarks = self.landmarks_within(arrival, &predicted, margin_m, std::f64::consts::PI);
        let found = recognise(&arrival.scan.observations, landmarks, &predicted, |at, turn_rad| {
            let turned_first = from + Rotation2::new(turn_rad) * (after - from);
            (at - after).norm() < within_m || (at - turned_first).norm() < within_m
        });
        found.into_iter().map(|found| found.world_from_robot).collect()
    }

    /// The landmarks still there that the scan may show from within so many metres and radians of a place.
    fn landmarks_within(
        &self,
        arrival: &Arrival<'_>,
        world_from_robot: &Isometry3<f64>,
        within_m: f64,
        within_rad: f64,
    ) -> impl Iterator<Item = &Landmark> {
        let hulls = || arrival.scan.observations.iter().flat_map(Observation::hull_points);
        let reach_m = hulls().map(|p| p.coords.norm()).fold(0.0, f64::max);
        // No turn puts a thing farther from where it is than the diameter of its circle.
        let margin_m = within_m + reach_m * within_rad.min(2.0);
        let corners: Vec<Point3<f64>> = hulls().map(|p| world_from_robot * p).collect();
        self.landmarks_about(corners, margin_m)
            .map(|(landmark, _)| landmark)
            .filter(|landmark| !landmark.gone)
    }

    /// [`prepare`](Self::prepare) for a scan that was recognised at a place: what odometry says of the way
    /// there is not believed, but for roll, pitch and height.
    pub(in crate::mapping) fn prepare_at(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        world_from_robot: &Isometry3<f64>,
    ) -> Prepared {
        let motion = self.last_pose().inverse() * world_from_robot;
        let spread = |level_m: f64, turn_rad: f64| {
            let mut covariance = arrival.motion_covariance;
            for (component, sigma) in [(0, level_m), (1, level_m), (2, UP_M), (5, turn_rad)] {
                covariance[(component, component)] += sigma * sigma;
            }
            covariance
        };
        let about = spread(ABOUT_M, ABOUT_RAD);
        let prepared = self.prepare_after(arrival, config, motion, about, *world_from_robot);
        // The search looks about the place; that the robot is there only the pairs may tell the graph.
        Prepared { motion_covariance: spread(ANYWHERE_M, ANYWHERE_RAD), ..prepared }
    }

    /// [`prepare`](Self::prepare) after a motion that led to `predicted`.
    fn prepare_after(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        motion: Isometry3<f64>,
        motion_covariance: Matrix6<f64>,
        predicted: Isometry3<f64>,
    ) -> Prepared {
        let scan = arrival.scan;
        let before = self.last_pose();
        let pose_covariance =
            predicted_covariance(&before, &self.last_covariance(), &motion, &motion_covariance);
        let led = Led::by(&motion_covariance);
        let window = Window::new(&predicted, &pose_covariance, led, &self.keyframes);
        let (planes, candidates, cut) = self.candidates(scan, &predicted, &window, config);
        let mut belief = self.belief(&planes, arrival, &motion, &predicted, &motion_covariance);
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
            cut,
            planes,
            common,
            samples,
            motion,
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

    /// Adds the sets of pairs that fit where the robot is predicted, see [`Question::search_near`], if they
    /// have nearly as many pairs as those there are: where odometry errs some few fit beside it by chance.
    pub(in crate::mapping) fn associate_near(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &mut Prepared,
        most_m: f64,
    ) {
        let landmarks = self.named(&prepared.planes);
        let question = prepared.question(arrival, &landmarks);
        let near = question.search_near(&prepared.belief, config, most_m);
        let most = prepared.assignments.iter().map(|found| found.pairs.len()).max().unwrap_or(0);
        let near = near.into_iter().filter(|near| near.pairs.len() + NEAR_SLACK >= most);
        prepared.assignments.extend(near);
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

    /// See [`Question::may_be_displaced`].
    pub(in crate::mapping) fn may_be_displaced(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &Prepared,
        assignment: &Assignment,
        verdicts: &[Verdict],
    ) -> bool {
        let landmarks = self.named(&prepared.planes);
        let question = prepared.question(arrival, &landmarks);
        question.may_be_displaced(&assignment.belief, verdicts, config)
    }

    /// See [`Question::beside_pairs`].
    pub(in crate::mapping) fn beside_pairs(
        &self,
        arrival: &Arrival<'_>,
        config: &AssociationConfig,
        prepared: &Prepared,
        assignment: &Assignment,
    ) -> f64 {
        let landmarks = self.named(&prepared.planes);
        prepared.question(arrival, &landmarks).beside_pairs(assignment, config)
    }

    pub(super) fn named(&self, planes: &[LandmarkId]) -> Vec<&Landmark> {
        planes.iter().map(|&id| self.landmark(id).expect("candidates come from the map")).collect()
    }

    /// Joint belief over the predicted pose and the candidates, beside the last keyframe.
    fn belief(
        &self,
        planes: &[LandmarkId],
        arrival: &Arrival<'_>,
        motion: &Isometry3<f64>,
        predicted: &Isometry3<f64>,
        motion_covariance: &Matrix6<f64>,
    ) -> Belief {
        let before = self.last_pose();
        let keys: Vec<Key> = planes.iter().map(|id| self.roots[id].key).collect();
        let frames: Vec<Isometry3<f64>> =
            self.graph.values_now(&keys).iter().map(|value| *value.plane()).collect();
        let Some(last) = self.keyframes.last() else {
            let start = &self.start_covariance;
            let pose = predicted_covariance(&before, start, motion, motion_covariance);
            let pose = DMatrix::from_column_slice(6, 6, pose.as_slice());
            return Belief::new(*predicted, frames, &pose, arrival.scan.errors.any());
        };
        // The last keyframe twice: as the anchor, and as the pose that the motion leads on from.
        let keys: Vec<Key> = [last.pose, last.pose].into_iter().chain(keys).collect();
        let mut joint = self.graph.covariance(&keys);
        let f_x = first_jacobian(&before, predicted);
        let f_u = second_jacobian(&before);
        let rows = f_x * joint.fixed_rows::<6>(6);
        joint.fixed_rows_mut::<6>(6).copy_from(&rows);
        let columns = joint.fixed_columns::<6>(6) * f_x.transpose();
        joint.fixed_columns_mut::<6>(6).copy_from(&columns);
        let mut on_pose = joint.fixed_view_mut::<6, 6>(6, 6);
        on_pose += f_u * motion_covariance * f_u.transpose();
        let joint = beside(&before, predicted, &frames, &joint, arrival.attitude.is_some());
        Belief::new(*predicted, frames, &joint, arrival.scan.errors.any())
    }
}

/// Each observation's columns for the scan's common errors, in units of their standard deviations.
fn common_columns(scan: &ScanObservations) -> Vec<Option<CommonColumns<3>>> {
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
