//! A landmark as seen from a point in front of it: what it would hide, and what would have hidden it.

use super::estimate::Estimate;
use super::landmark::{Landmark, Opening};
use super::vantage::Vantage;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};
use std::cell::OnceCell;

/// A point this far behind a landmark, and this much more per metre of range, was seen through it:
/// what a pose is wrong by must not count. The first is for a pose that is known, to which its
/// standard deviations add; the second is the most that they may make of it.
const KNOWN_BEHIND_M: f64 = 0.05;
pub(super) const SIGMAS: f64 = 3.0;
const BEHIND_M: f64 = 0.15;
const BEHIND_PER_M: f64 = 0.015;
/// A surface up to this far before a parallel one cannot be where it would have hidden that one; a large one,
/// which is more likely a wall than a thing, up to the second.
pub(super) const DOUBLED_M: f64 = 0.6;
pub(super) const LARGE_DOUBLED_M: f64 = 1.5;
const PARALLEL_COSINE: f64 = 0.99;
/// Cells around the crossing in each axis that must all have been hit: edges of doorways shift with
/// the pose.
const SOLID_CELLS: i32 = 2;
/// Sine of the angle to the surface below which a ray grazes it and says nothing.
const GRAZING_SINE: f64 = 0.15;

/// A landmark as seen from a point in front of it.
pub(super) struct Wall<'a> {
    pub(super) landmark: &'a Landmark,
    /// Its place among the planes of the belief, where it is one of them.
    pub(super) plane: Option<usize>,
    pub(super) normal: Vector3<f64>,
    pub(super) plane_from_world: Isometry3<f64>,
    eye: Point3<f64>,
    /// Standard deviation of the robot's position along the normal.
    sigma_m: f64,
    /// Where it is said to have been opened since.
    pub(super) openings: Vec<Opening>,
    estimate: &'a Estimate,
    /// From where it was seen, once that was asked.
    pub(super) vantages: OnceCell<Vec<Vantage<'a>>>,
}

impl<'a> Wall<'a> {
    pub(super) fn facing(
        estimate: &'a Estimate,
        landmark: &'a Landmark,
        plane: Option<usize>,
        world_from_plane: Isometry3<f64>,
        eye: &Point3<f64>,
        position_covariance: &Matrix3<f64>,
    ) -> Option<Self> {
        let normal = world_from_plane.rotation * Vector3::z();
        let sigma_m = normal.dot(&(position_covariance * normal)).max(0.0).sqrt();
        let plane_from_world = world_from_plane.inverse();
        let eye = plane_from_world * eye;
        (eye.z > BEHIND_M && !landmark.mask.is_empty()).then_some(Self {
            landmark,
            plane,
            normal,
            plane_from_world,
            eye,
            sigma_m,
            openings: Vec::new(),
            estimate,
            vantages: OnceCell::new(),
        })
    }

    /// Whether a surface with that normal, in the world, is parallel and faces the same way.
    pub(super) fn is_parallel(&self, normal: &Vector3<f64>) -> bool {
        self.normal.dot(normal) > PARALLEL_COSINE
    }

    /// Where in the landmark's plane it refutes a point, in its frame, of a surface that is more than the margin
    /// behind the landmark, seen from the eye, or up to so many metres before it where that `would_hide` it.
    pub(super) fn refuted_at(
        &self,
        target: &Point3<f64>,
        margin_m: f64,
        before_m: f64,
        would_hide: impl Fn(&Point2<f64>, f64) -> bool,
    ) -> Option<Point2<f64>> {
        if target.z > margin_m && target.z < before_m {
            let at = target.xy();
            return (self.hit_at(target) && would_hide(&at, target.z)).then_some(at);
        }
        let ray = target - self.eye;
        if target.z > -margin_m || -ray.z < GRAZING_SINE * ray.norm() {
            return None;
        }
        let crossing = self.eye + ray * (self.eye.z / -ray.z);
        self.solid_at(&crossing).then(|| crossing.xy())
    }

    /// Whether the landmark was hit at a point in its frame. What stands before that was seen from where it would
    /// have hidden it or not: unlike what is seen through it, that does not hang on where its edges are.
    fn hit_at(&self, point: &Point3<f64>) -> bool {
        let at = point.xy();
        self.landmark.is_solid_about(&at, 0) && !self.openings.iter().any(|part| part.holds(&at))
    }

    /// Whether a surface so many metres before a point of the landmark would have hidden it from where it was
    /// seen: shelves, benches and tables do not hide all that is behind them.
    pub(super) fn was_seen_past(
        &self,
        at: &Point2<f64>,
        before_m: f64,
        is_there: impl Fn(&Point3<f64>) -> bool,
    ) -> bool {
        let vantages = self.vantages.get_or_init(|| self.estimate.vantages(self.landmark.id));
        vantages.iter().any(|vantage| vantage.is_denied(at, before_m, &is_there))
    }

    /// How far a point in the landmark's frame may lie behind the landmark and yet be on it.
    pub(super) fn ray_margin_m(&self, target: &Point3<f64>) -> f64 {
        let range_m = (target - self.eye).norm();
        (KNOWN_BEHIND_M + SIGMAS * self.sigma_m).min(BEHIND_M) + BEHIND_PER_M * range_m
    }

    /// Height of a point above the landmark where that is a floor to a robot whose z is `up`, with the
    /// landmark itself; below it, the floor is where the sensor would see the point through it.
    pub(super) fn height_of(&self, point: &Point3<f64>, up: &Vector3<f64>) -> Option<(f64, &Self)> {
        let target = self.plane_from_world * point;
        if target.z.abs() > DOUBLED_M || !self.is_parallel(up) {
            return None;
        }
        let ray = target - self.eye;
        let at = if target.z < 0.0 { self.eye + ray * (self.eye.z / -ray.z) } else { target };
        self.solid_at(&at).then_some((target.z, self))
    }

    pub(super) fn solid_at(&self, point: &Point3<f64>) -> bool {
        self.landmark.is_solid_about(&point.xy(), SOLID_CELLS)
            && !self.openings.iter().any(|part| part.holds(&point.xy()))
    }
}
