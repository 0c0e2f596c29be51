//! Whether a thing that a scan shows elsewhere has moved: another robot, a cart, a box that was pushed.
//!
//! Seen beside walls that say nothing of the way along them, a thing that moves looks as the robot does that
//! slips the other way. Faces of one thing agree with one another either way, so they are no reason to believe
//! the slip; what is left is how seldom each of the two is.

use super::association::{Assignment, MOST_PER_PAIR};
use super::estimate::{Estimate, Prepared};
use super::landmark::{Landmark, LandmarkId};
use super::observation::Observation;
use super::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use std::collections::BTreeSet;

/// Greatest extent of a face, and of a thing, that moves, in metres.
const LARGEST_M: f64 = 1.6;
/// Greatest area that the top of one has swept while it was taken for one surface, in square metres.
const LARGEST_M2: f64 = 2.5;
/// Farthest that it moves from one scan to the next, and by how much its faces may differ in that, in metres:
/// they are seen from elsewhere.
const FARTHEST_M: f64 = 1.2;
const ALIKE_M: f64 = 0.3;
/// Least of a face's way along its normal, in metres: a face that is where it was has not moved.
const LEAST_M: f64 = 0.03;
/// Cosine of the most that a face turns by meanwhile: 10°.
const TURN_COSINE: f64 = 0.985;
/// How many times as large one of two sights of a face may be.
const AREA_RATIO: f64 = 3.0;
/// Logarithm of how seldom something has moved since it was last seen: oftener than wheels slip by as much.
const LOG_MOVED: f64 = -6.0;

/// Points looked at of each observation, and how many of them behind a face, by so much and that much more per
/// metre, that it is not there any more.
const SAMPLES: usize = 40;
const POINTS_BEHIND: usize = 3;
const BEHIND_M: f64 = 0.08;
const BEHIND_PER_M: f64 = 0.015;
/// Logarithm of how seldom that many are when it still is.
const LOG_SEEN_THROUGH: f64 = -4.5;

/// A thing that has moved.
pub(super) struct Moved {
    /// Its faces where they were.
    pub(super) landmarks: Vec<LandmarkId>,
    /// What speaks against their being there still.
    pub(super) log_there: f64,
    /// What that explains, in the measure of [`Assignment::support`].
    pub(super) support: f64,
}

impl Estimate {
    /// The thing that must have moved if the robot is where an assignment puts it, if one did. Of landmarks
    /// that `refute` what is seen there those are gone, too, that look like it, where it was before, or are on it,
    /// as its top is, which goes on in its own plane.
    pub(super) fn moved(
        &self,
        scan: &ScanObservations,
        prepared: &Prepared,
        assignment: &Assignment,
        refute: &BTreeSet<LandmarkId>,
    ) -> Option<Moved> {
        let world_from_robot = assignment.belief.world_from_robot;
        let is_free = |index: &usize| assignment.pairs.iter().all(|(paired, _)| paired != index);
        let small = (0..scan.observations.len()).filter(is_free).filter_map(|index| {
            let seen = &scan.observations[index];
            (extent_m(&seen.hull) < LARGEST_M).then_some(seen)
        });
        let taken: Vec<LandmarkId> =
            assignment.pairs.iter().map(|&(_, plane)| prepared.landmark_of(plane)).collect();
        let mut moves: Vec<Move<'_>> =
            small.filter_map(|seen| self.nearest_move(seen, &world_from_robot, &taken)).collect();
        // The thing whose faces explain most leads, which is the one with the largest of them.
        let area_m2 = |face: &Move<'_>| face.seen.area_m2();
        moves.sort_by(|a, b| area_m2(b).total_cmp(&area_m2(a)).then(a.landmark.cmp(&b.landmark)));
        let lead = moves.first()?;
        let of_one = |other: &&Move<'_>| {
            (other.at - lead.at).norm() < LARGEST_M && (other.by - lead.by).norm() < ALIKE_M
        };
        let faces: Vec<&Move<'_>> = moves.iter().filter(of_one).collect();
        let mut landmarks: Vec<LandmarkId> = faces.iter().map(|face| face.landmark).collect();
        landmarks.sort_unstable();
        landmarks.dedup();
        let support = MOST_PER_PAIR * landmarks.len() as f64 + LOG_MOVED;
        let eye = Point3::from((world_from_robot * scan.robot_from_scan).translation.vector);
        let is_seen_through = |id: &LandmarkId| {
            let landmark = self.landmark(*id);
            landmark
                .is_some_and(|landmark| is_seen_through(landmark, scan, &world_from_robot, &eye))
        };
        let seen_through = landmarks.iter().filter(|id| is_seen_through(id)).count();
        let log_there = LOG_SEEN_THROUGH * seen_through as f64;
        let was_it = |id: &LandmarkId| {
            let of_thing = |landmark: &Landmark| {
                let looks_like_it = faces.iter().any(|face| face.is_like(landmark));
                let is_on_it = landmark.area_m2() < LARGEST_M2
                    && landmark.hull_points().any(|p| (p - lead.at).norm() < LARGEST_M);
                looks_like_it || is_on_it
            };
            !landmarks.contains(id) && self.landmark(*id).is_some_and(of_thing)
        };
        let before: Vec<LandmarkId> = refute.iter().copied().filter(was_it).collect();
        landmarks.extend(before);
        Some(Moved { landmarks, log_there, support })
    }

    /// The shortest way that a face of the map may have gone to be the one that was seen.
    fn nearest_move<'a>(
        &self,
        seen: &'a Observation,
        world_from_robot: &Isometry3<f64>,
        taken: &[LandmarkId],
    ) -> Option<Move<'a>> {
        let (at, normal) = (world_from_robot * seen.centroid(), world_from_robot * seen.normal());
        let hull = seen.hull_points().map(|p| world_from_robot * p);
        let moves = self.landmarks_about(hull, FARTHEST_M).filter_map(|(landmark, _)| {
            let by = at - landmark.origin();
            let is_it = !taken.contains(&landmark.id)
                && by.norm() < FARTHEST_M
                && by.dot(&normal).abs() > LEAST_M;
            let face = Move { landmark: landmark.id, seen, normal, at, by };
            (is_it && face.is_like(landmark)).then_some(face)
        });
        moves.min_by(|a, b| a.by.norm().total_cmp(&b.by.norm()))
    }
}

/// Whether points of a scan lie behind cells of a landmark that were hit once.
fn is_seen_through(
    landmark: &Landmark,
    scan: &ScanObservations,
    world_from_robot: &Isometry3<f64>,
    eye: &Point3<f64>,
) -> bool {
    let plane_from_world = landmark.world_from_plane.inverse();
    let eye = plane_from_world * eye;
    let points = scan.observations.iter().flat_map(|seen| {
        let plane_from_seen = plane_from_world * world_from_robot * seen.robot_from_plane;
        let cells = seen.mask.thinned(SAMPLES);
        cells.into_iter().map(move |cell| plane_from_seen * Point3::new(cell.x, cell.y, 0.0))
    });
    let behind = points.filter(|point| {
        let ray = point - eye;
        let margin_m = BEHIND_M + BEHIND_PER_M * ray.norm();
        eye.z > margin_m
            && point.z < -margin_m
            && landmark.mask.solid_about(&(eye + ray * (eye.z / -ray.z)).xy(), 0)
    });
    behind.take(POINTS_BEHIND).count() == POINTS_BEHIND
}

/// A face that has moved.
struct Move<'a> {
    landmark: LandmarkId,
    seen: &'a Observation,
    /// How it lies in the world, where, and how far from where it was.
    normal: Vector3<f64>,
    at: Point3<f64>,
    by: Vector3<f64>,
}

impl Move<'_> {
    /// Whether a landmark may be the face, but for its place.
    fn is_like(&self, landmark: &Landmark) -> bool {
        let (own, other) = (landmark.area_m2(), self.seen.area_m2());
        landmark.normal().dot(&self.normal) > TURN_COSINE
            && extent_m(&landmark.hull) < LARGEST_M
            && own < AREA_RATIO * other
            && other < AREA_RATIO * own
    }
}

/// Greatest distance between two vertices of a hull.
fn extent_m(hull: &[Point2<f64>]) -> f64 {
    let pairs = hull.iter().flat_map(|a| hull.iter().map(move |b| (a - b).norm()));
    pairs.fold(0.0, f64::max)
}
