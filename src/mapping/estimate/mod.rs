//! One consistent explanation of everything seen so far: the graph, and the map that hangs on it.
//!
//! A scan is first compared with the map ([`prepare`](Estimate::prepare)), which decides nothing, and
//! then taken in under one of the assignments found ([`apply`](Estimate::apply)).

mod apply;
mod candidates;
mod constellation;
mod curves;
mod prepare;
mod unite;
mod upkeep;

use super::association::Assignment;
use super::belief::Belief;
use super::curved::CurvedLandmark;
use super::graph::{FactorId, Graph, GraphConfig, Key, positive};
use super::index::SpatialIndex;
use super::landmark::{Landmark, LandmarkId};
use super::observation::Observation;
use super::odometry::is_nothing;
use super::perturbation::{first_jacobian, second_jacobian, symmetric};
use super::scan_errors::{CommonColumns, ScanObservations};
use candidates::Led;
use nalgebra::{Isometry3, Matrix3, Matrix6, Point2, Point3, Vector6};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Standard deviations with which an exact first pose enters: small beside any measurement, large
/// beside rounding.
const EXACT_M: f64 = 1e-5;
const EXACT_RAD: f64 = 1e-6;

/// Attitude measured at a scan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Attitude {
    pub(super) roll_rad: f64,
    pub(super) pitch_rad: f64,
    pub(super) sigma_rad: f64,
}

/// Everything that comes with a scan.
pub(super) struct Arrival<'a> {
    /// Motion since the last scan and its covariance in the frame at its beginning.
    pub(super) motion: Isometry3<f64>,
    pub(super) motion_covariance: Matrix6<f64>,
    pub(super) attitude: Option<Attitude>,
    pub(super) scan: &'a ScanObservations,
}

impl Arrival<'_> {
    /// Whether the robot is said to have stood still.
    pub(super) fn is_at_rest(&self) -> bool {
        is_nothing(&self.motion)
    }
}

/// A scan compared with the map, before anything is decided for good.
pub(super) struct Prepared {
    /// What was believed before the scan.
    pub(super) belief: Belief,
    /// Ways to associate it, best first; at least one, which may have no pair.
    pub(super) assignments: Vec<Assignment>,
    /// For each observation its candidates, as positions in `planes`.
    candidates: Vec<Vec<usize>>,
    /// Whether an observation has candidates that it was not compared with.
    cut: Vec<bool>,
    /// The landmark behind each plane of the belief, in order.
    planes: Vec<LandmarkId>,
    common: Vec<Option<CommonColumns<3>>>,
    /// Of each observation's mask the cells that are compared with a landmark's.
    samples: Vec<Vec<Point2<f64>>>,
    /// The motion that led there, and what the graph is told that it may be off by.
    motion: Isometry3<f64>,
    motion_covariance: Matrix6<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Sighting {
    /// Index of the observation within its scan.
    index: usize,
    landmark: LandmarkId,
    factor: FactorId,
    /// Shared by all explanations that know it.
    observation: Arc<Observation>,
    /// Where the patch lay in the landmark's frame when it was drawn into its extent; `None` before.
    drawn: Option<Isometry3<f64>>,
}

/// A sighting as it lies in its landmark.
pub(super) struct Drawn<'a> {
    pub(super) observation: &'a Observation,
    pub(super) plane_from_observed: Isometry3<f64>,
    /// Where the sensor was on the robot.
    pub(super) robot_from_eye: Point3<f64>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Keyframe {
    pose: Key,
    /// Common errors of its scan, if they were modelled.
    errors: Option<Key>,
    /// Pose as it was last told to the outside.
    told: Isometry3<f64>,
    sightings: Vec<Sighting>,
    /// Cylinders and spheres that its scan shows.
    curves: Vec<CurveSighting>,
    /// Where the sensor was on the robot.
    robot_from_eye: Point3<f64>,
    /// What the motion to it may be off by.
    led: Led,
}

/// A cylinder or sphere of a scan that is in the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct CurveSighting {
    /// Index of the observation within its scan.
    index: usize,
    /// Place of the landmark in the list.
    curve: usize,
    factor: FactorId,
}

/// What the estimate keeps of a landmark beside the landmark itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Roots {
    key: Key,
    /// Keyframe and index of the observation within its scan, in order.
    sightings: Vec<(usize, usize)>,
}

/// Graph, keyframes and landmarks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Estimate {
    graph: Graph,
    keyframes: Vec<Keyframe>,
    /// Sorted by identity.
    landmarks: Vec<Landmark>,
    roots: BTreeMap<LandmarkId, Roots>,
    landmark_of: BTreeMap<Key, LandmarkId>,
    keyframe_of: BTreeMap<Key, usize>,
    curves: Vec<CurvedLandmark>,
    curve_of: BTreeMap<Key, usize>,
    index: SpatialIndex,
    next_landmark: u32,
    start: Isometry3<f64>,
    start_covariance: Matrix6<f64>,
}

impl Estimate {
    pub(super) fn new(
        graph: GraphConfig,
        world_from_robot: Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) -> Self {
        let floor = Vector6::new(EXACT_M, EXACT_M, EXACT_M, EXACT_RAD, EXACT_RAD, EXACT_RAD)
            .map(|sigma| sigma * sigma);
        Self {
            graph: Graph::new(graph),
            keyframes: Vec::new(),
            landmarks: Vec::new(),
            roots: BTreeMap::new(),
            landmark_of: BTreeMap::new(),
            keyframe_of: BTreeMap::new(),
            curves: Vec::new(),
            curve_of: BTreeMap::new(),
            index: SpatialIndex::default(),
            next_landmark: 0,
            start: world_from_robot,
            start_covariance: positive(covariance, &floor),
        }
    }

    /// The number that the next landmark will get.
    pub(super) fn next_landmark(&self) -> u32 {
        self.next_landmark
    }

    /// Numbers new landmarks from `next` on: explanations of one session never give one number to two
    /// landmarks.
    pub(super) fn number_from(&mut self, next: u32) {
        self.next_landmark = self.next_landmark.max(next);
    }

    /// Whether no scan was taken in yet.
    pub(super) fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
    }

    /// The landmarks, by identity.
    pub(super) fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// Cylinders and spheres, in the order in which they were first seen.
    pub(super) fn curves(&self) -> &[CurvedLandmark] {
        &self.curves
    }

    pub(super) fn landmark(&self, id: LandmarkId) -> Option<&Landmark> {
        self.slot(id).map(|slot| &self.landmarks[slot])
    }

    fn slot(&self, id: LandmarkId) -> Option<usize> {
        self.landmarks.binary_search_by_key(&id, |landmark| landmark.id).ok()
    }

    /// Covariance of a landmark's frame now.
    pub(super) fn landmark_covariance(&self, id: LandmarkId) -> Option<Matrix3<f64>> {
        let roots = self.roots.get(&id)?;
        Some(Matrix3::from_column_slice(self.graph.covariance(&[roots.key]).as_slice()))
    }

    /// Pose at the last scan, or the start.
    pub(super) fn last_pose(&self) -> Isometry3<f64> {
        self.keyframes.last().map_or(self.start, |keyframe| self.graph.pose(keyframe.pose))
    }

    /// Covariance of the pose at the last scan.
    pub(super) fn last_covariance(&self) -> Matrix6<f64> {
        self.keyframes.last().map_or(self.start_covariance, |keyframe| {
            Matrix6::from_column_slice(self.graph.covariance(&[keyframe.pose]).as_slice())
        })
    }

    /// Covariance of the motion between two scans, in the frame of the first.
    pub(super) fn motion_covariance(&self, first: usize, second: usize) -> Option<Matrix6<f64>> {
        let (first, second) = (self.keyframes.get(first)?.pose, self.keyframes.get(second)?.pose);
        let joint = self.graph.covariance(&[first, second]);
        let (before, after) = (self.graph.pose(first), self.graph.pose(second));
        // The error of the motion: J2 of its inverse, applied to what the first error does not carry
        // along rigidly.
        let carried = first_jacobian(&before, &after);
        let into_first = second_jacobian(&before).transpose();
        let mut rows = nalgebra::SMatrix::<f64, 6, 12>::zeros();
        rows.fixed_view_mut::<6, 6>(0, 0).copy_from(&(-into_first * carried));
        rows.fixed_view_mut::<6, 6>(0, 6).copy_from(&into_first);
        let joint = nalgebra::SMatrix::<f64, 12, 12>::from_column_slice(joint.as_slice());
        Some(symmetric(&(rows * joint * rows.transpose())))
    }

    /// The sightings of a landmark that are drawn into it, newest first.
    pub(super) fn sightings_of(&self, landmark: LandmarkId) -> impl Iterator<Item = Drawn<'_>> {
        let found = self.roots.get(&landmark).map(|roots| &roots.sightings);
        found.into_iter().flatten().rev().filter_map(|&(number, index)| {
            let keyframe = &self.keyframes[number];
            let sighting = keyframe.sightings.iter().find(|s| s.index == index)?;
            Some(Drawn {
                observation: &sighting.observation,
                plane_from_observed: sighting.drawn?,
                robot_from_eye: keyframe.robot_from_eye,
            })
        })
    }

    /// What the planes of a scan were taken for: landmark and observation of each.
    pub(super) fn sightings(
        &self,
        keyframe: usize,
    ) -> impl Iterator<Item = (LandmarkId, &Observation)> {
        let found = self.keyframes.get(keyframe).map(|keyframe| &keyframe.sightings);
        found.into_iter().flatten().map(|sighting| (sighting.landmark, &*sighting.observation))
    }

    /// Pose at a scan, by its number.
    pub(super) fn pose(&self, number: usize) -> Option<Isometry3<f64>> {
        self.keyframes.get(number).map(|keyframe| self.graph.pose(keyframe.pose))
    }

    /// Poses at all scans.
    pub(super) fn poses(&self) -> Vec<Isometry3<f64>> {
        let keys: Vec<Key> = self.keyframes.iter().map(|keyframe| keyframe.pose).collect();
        self.graph.values_now(&keys).iter().map(|value| *value.pose()).collect()
    }
}
