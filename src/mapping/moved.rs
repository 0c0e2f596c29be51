//! Whether a thing that a scan shows elsewhere has moved: another robot, a cart, a box that was pushed.
//!
//! Seen beside walls that say nothing of the way along them, a thing that moves looks as the robot does that
//! slips the other way. Faces of one thing agree with one another either way, so they are no reason to believe
//! the slip; what is left is how seldom each of the two is.

use super::association::{Assignment, MOST_PER_PAIR};
use super::estimate::{Estimate, Prepared};
use super::landmark::{Landmark, LandmarkId, Opening};
use super::observation::Observation;
use super::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use std::collections::BTreeMap;

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

/// Greatest extent of a face of a thing that was taken or swung away, and between the middles of its faces, in
/// metres: a door's leaf. And most things that vanish from one scan to the next.
const DOOR_M: f64 = 2.6;
pub(super) const MOST_VANISHED: usize = 2;
/// Logarithm of how seldom one does, or comes: as seldom as wheels slip.
pub(super) const LOG_VANISHED: f64 = -9.0;
/// Greatest extent, from corner to corner, of a face of a thing that came: a cupboard's, a board's.
const THING_M: f64 = 3.6;
/// Rise of a normal above which a surface is level: floors do not open.
const UPRIGHT: f64 = 0.8;
/// How far an opening goes on beyond what was seen through it, in metres.
const RIM_M: f64 = 0.1;

/// Points looked at of each observation, and how many of them behind a face, by so much and that much more per
/// metre, that it is not there any more.
const SAMPLES: usize = 40;
const POINTS_BEHIND: usize = 3;
const BEHIND_M: f64 = 0.08;
const BEHIND_PER_M: f64 = 0.015;
/// Logarithm of how seldom that many are when it still is.
const LOG_SEEN_THROUGH: f64 = -4.5;

/// Landmarks that refute points of a scan, and where in their own planes.
pub(super) type Places = BTreeMap<LandmarkId, Vec<Point2<f64>>>;

/// What is not there any more, and what has come.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Gone {
    /// Surfaces as a whole.
    pub(super) landmarks: Vec<LandmarkId>,
    /// Parts of others.
    pub(super) openings: Vec<(LandmarkId, Opening)>,
    /// Observations of what has come: a cupboard before a wall.
    pub(super) came: Vec<usize>,
}

impl Gone {
    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    pub(super) fn len(&self) -> usize {
        self.landmarks.len() + self.openings.len() + self.came.len()
    }

    /// Both.
    pub(super) fn and(&self, other: &Self) -> Self {
        let mut all = self.clone();
        all.landmarks.extend(&other.landmarks);
        all.openings.extend(&other.openings);
        all.came.extend(&other.came);
        all
    }

    /// Those of one surface.
    pub(super) fn openings_of(&self, landmark: LandmarkId) -> impl Iterator<Item = Opening> + '_ {
        let of_it = self.openings.iter().filter(move |(of, _)| *of == landmark);
        of_it.map(|&(_, opening)| opening)
    }
}

/// Where places in a plane lie, but for some that may be the edge of another opening.
fn opening(places: &[Point2<f64>], widest_m: f64) -> Opening {
    let middle = |axis: usize| {
        let mut along: Vec<f64> = places.iter().map(|at| at[axis]).collect();
        along.sort_unstable_by(f64::total_cmp);
        along[along.len() / 2]
    };
    let centre = Point2::new(middle(0), middle(1));
    let away_m = places.iter().map(|at| (at - centre).norm()).filter(|&m| m < 0.5 * widest_m);
    Opening { centre, radius_m: away_m.fold(0.0, f64::max) + RIM_M }
}

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
        refute: &Places,
    ) -> Option<Moved> {
        let world_from_robot = assignment.belief.world_from_robot;
        let is_free = |&index: &usize| assignment.plane_of(index).is_none();
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
        let before: Vec<LandmarkId> = refute.keys().copied().filter(was_it).collect();
        landmarks.extend(before);
        Some(Moved { landmarks, log_there, support })
    }

    /// One thing that was swung or taken away if an assignment is right: what `refute`s most of what is seen, if
    /// it is no larger than a door, with what is beside it, or that part of a wall.
    pub(super) fn vanished(
        &self,
        prepared: &Prepared,
        assignment: &Assignment,
        refute: &Places,
    ) -> Gone {
        let seen_through = refute.iter().filter(|(_, places)| !places.is_empty());
        let most = seen_through.max_by(|a, b| a.1.len().cmp(&b.1.len()).then(b.0.cmp(a.0)));
        let Some((&id, places)) = most else { return Gone::default() };
        let Some(landmark) = self.landmark(id) else { return Gone::default() };
        let is_seen = |id: LandmarkId| {
            assignment.pairs.iter().any(|&(_, plane)| prepared.landmark_of(plane) == id)
        };
        let is_small =
            |face: &Landmark| face.area_m2() < LARGEST_M2 && extent_m(&face.hull) < DOOR_M;
        if is_small(landmark) && !is_seen(id) {
            let at = landmark.origin();
            let is_of_it = |face: &&Landmark| {
                is_small(face) && !is_seen(face.id) && (face.origin() - at).norm() < DOOR_M
            };
            let faces = refute.keys().filter_map(|&id| self.landmark(id)).filter(is_of_it);
            let landmarks = faces.map(|face| face.id).collect();
            return Gone { landmarks, ..Gone::default() };
        }
        if landmark.normal().z.abs() > UPRIGHT {
            return Gone::default();
        }
        Gone { openings: vec![(id, opening(places, DOOR_M))], ..Gone::default() }
    }

    /// One thing that has come, of observations that lie `before` what is mapped: the largest that is no larger than
    /// a thing. What is behind it says nothing against it from now on.
    pub(super) fn came(scan: &ScanObservations, before: &[(usize, Places)]) -> Gone {
        let area_m2 = |index: usize| scan.observations[index].area_m2();
        let small = before.iter().filter(|it| extent_m(&scan.observations[it.0].hull) < THING_M);
        let largest = small.max_by(|a, b| area_m2(a.0).total_cmp(&area_m2(b.0)));
        let Some((index, hides)) = largest else { return Gone::default() };
        let openings = hides.iter().map(|(&id, places)| (id, opening(places, THING_M))).collect();
        Gone { openings, came: vec![*index], ..Gone::default() }
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
