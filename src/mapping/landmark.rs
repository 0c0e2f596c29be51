use super::mask::PlaneMask;
use super::observation::Observation;
use crate::geometry::{Plane, clip_convex, convex_gap_m, convex_hull, polygon_area};
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Identity of a landmark, unique within one map and never used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct LandmarkId(pub u32);

/// A part of a surface that something was seen through later: a door that was shut.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opening {
    /// Its middle in the surface's own frame.
    pub centre: Point2<f64>,
    /// How far it reaches, in metres.
    pub radius_m: f64,
}

impl Opening {
    /// Whether it holds a point of the plane.
    pub fn holds(&self, point: &Point2<f64>) -> bool {
        (point - self.centre).norm() < self.radius_m
    }
}

/// A planar patch of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Landmark {
    /// Identity.
    pub id: LandmarkId,
    /// Local frame in the world: z is the normal, on the side from which the patch was seen.
    pub world_from_plane: Isometry3<f64>,
    /// Covariance of a perturbation of that frame: offset along z in m², rotations about y and x in
    /// rad². Zero in the paper's mode, which takes its map as exact.
    pub covariance: Matrix3<f64>,
    /// Convex hull in the frame's x-y plane, counter-clockwise, in metres.
    pub hull: Vec<Point2<f64>>,
    /// Cells of the plane that were hit.
    pub mask: PlaneMask,
    /// Points of all patches that were taken for it.
    pub points: usize,
    /// Root mean square of their distances from the patches' own planes, in metres.
    pub rms_m: f64,
    /// Number of scans in which it was seen, the first included.
    pub sightings: u32,
    /// Keyframe that saw it first.
    pub first_keyframe: usize,
    /// Keyframe that saw it last.
    pub last_keyframe: usize,
    /// Whether it was of a thing that has moved since: nothing is there any more.
    pub gone: bool,
    /// Where it is none any more at times: what is seen there or through there says nothing of it.
    pub openings: Vec<Opening>,
}

impl Landmark {
    /// A landmark as first observed from `world_from_robot`.
    pub fn first_seen(
        id: LandmarkId,
        observation: &Observation,
        world_from_robot: &Isometry3<f64>,
        keyframe: usize,
    ) -> Self {
        Self {
            id,
            world_from_plane: world_from_robot * observation.robot_from_plane,
            covariance: Matrix3::zeros(),
            hull: observation.hull.clone(),
            mask: observation.mask.clone(),
            points: observation.points,
            rms_m: observation.rms_m,
            sightings: 1,
            first_keyframe: keyframe,
            last_keyframe: keyframe,
            gone: false,
            openings: Vec::new(),
        }
    }

    /// The infinite plane in the world, facing the side from which it was seen.
    pub fn plane(&self) -> Plane {
        let normal = self.normal();
        Plane { normal, offset_m: normal.dot(&self.world_from_plane.translation.vector) }
    }

    /// Unit normal in the world.
    pub fn normal(&self) -> Vector3<f64> {
        self.world_from_plane.rotation * Vector3::z()
    }

    /// Origin of the local frame in the world.
    pub fn origin(&self) -> Point3<f64> {
        Point3::from(self.world_from_plane.translation.vector)
    }

    /// Whether cells around a point of its plane were all hit, and none of them has been seen open since.
    pub fn is_solid_about(&self, point: &Point2<f64>, reach: i32) -> bool {
        self.mask.solid_about(point, reach) && !self.openings.iter().any(|part| part.holds(point))
    }

    /// Area of the hull in m².
    pub fn area_m2(&self) -> f64 {
        polygon_area(&self.hull)
    }

    /// The hull's vertices in the world.
    pub fn hull_points(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        self.hull.iter().map(|p| self.world_from_plane * Point3::new(p.x, p.y, 0.0))
    }

    /// Unites hull and mask with those of an observation: its vertices are projected onto the
    /// landmark's plane and the hull of both is taken again, as the paper does. Returns where the
    /// observation lies in the landmark's frame.
    pub fn extend(
        &mut self,
        observation: &Observation,
        world_from_robot: &Isometry3<f64>,
    ) -> Isometry3<f64> {
        let plane_from_observed =
            self.world_from_plane.inverse() * world_from_robot * observation.robot_from_plane;
        self.unite(&observation.hull, &observation.mask, &plane_from_observed);
        let squares = |points: usize, rms_m: f64| points as f64 * rms_m * rms_m;
        let sum = squares(self.points, self.rms_m) + squares(observation.points, observation.rms_m);
        self.points += observation.points;
        self.rms_m = (sum / self.points.max(1) as f64).sqrt();
        plane_from_observed
    }

    /// Unites hull and mask with those of another frame.
    pub fn unite(
        &mut self,
        hull: &[Point2<f64>],
        mask: &PlaneMask,
        plane_from_other: &Isometry3<f64>,
    ) {
        let mut corners = self.hull.clone();
        corners.extend(carried_hull(hull, plane_from_other));
        let united = convex_hull(&corners);
        if !united.is_empty() {
            self.hull = united;
        }
        self.mask.merge(mask, plane_from_other);
    }
}

/// Hull vertices carried into another plane's frame and projected onto it.
pub fn carried_hull(hull: &[Point2<f64>], plane_from_other: &Isometry3<f64>) -> Vec<Point2<f64>> {
    hull.iter().map(|p| (plane_from_other * Point3::new(p.x, p.y, 0.0)).xy()).collect()
}

/// Whether a carried hull lies on a landmark's hull: their overlap exceeds `share` of the smaller
/// one, or the gap between them is at most `gap_m`.
pub fn hulls_meet(hull: &[Point2<f64>], carried: &[Point2<f64>], share: f64, gap_m: f64) -> bool {
    let (ours, theirs) = (extent(hull), extent(carried));
    let apart = |k: usize| ours.0[k] > theirs.1[k] + gap_m || theirs.0[k] > ours.1[k] + gap_m;
    if apart(0) || apart(1) {
        return false;
    }
    // Carried hulls keep their sense of rotation as long as both normals agree, which the test of
    // facing has settled before. The gap goes first: hulls that overlap mostly hold a corner of one
    // another, which is seen without cutting either.
    let overlaps = || {
        let smaller = polygon_area(hull).min(polygon_area(carried));
        polygon_area(&clip_convex(carried, hull)) > share * smaller
    };
    convex_gap_m(hull, carried) <= gap_m || overlaps()
}

/// Lowest and highest coordinates of a polygon.
fn extent(polygon: &[Point2<f64>]) -> (Point2<f64>, Point2<f64>) {
    let start = (Point2::new(f64::MAX, f64::MAX), Point2::new(f64::MIN, f64::MIN));
    polygon.iter().fold(start, |(low, high), p| (low.inf(p), high.sup(p)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: f64, side: f64) -> Vec<Point2<f64>> {
        [(x, 0.0), (x + side, 0.0), (x + side, side), (x, side)]
            .map(|(x, y)| Point2::new(x, y))
            .to_vec()
    }

    fn seen(x: f64) -> Observation {
        Observation {
            robot_from_plane: Isometry3::identity(),
            covariance: Matrix3::identity(),
            hull: square(x, 1.0),
            mask: PlaneMask::default(),
            points: 100,
            rms_m: 0.003,
        }
    }

    #[test]
    fn a_second_sighting_widens_the_hull_to_both() {
        let mut landmark =
            Landmark::first_seen(LandmarkId(0), &seen(0.0), &Isometry3::identity(), 0);
        landmark.extend(&seen(2.0), &Isometry3::translation(0.5, 0.0, 0.02));
        assert_eq!(landmark.hull.len(), 4);
        assert!((landmark.area_m2() - 3.5).abs() < 1e-12);
    }

    #[test]
    fn hulls_meet_by_overlap_or_near_gap() {
        assert!(hulls_meet(&square(0.0, 2.0), &square(1.0, 2.0), 0.1, 0.0));
        assert!(hulls_meet(&square(0.0, 1.0), &square(1.3, 1.0), 0.1, 0.4));
        assert!(!hulls_meet(&square(0.0, 1.0), &square(1.9, 1.0), 0.1, 0.4));
    }
}
