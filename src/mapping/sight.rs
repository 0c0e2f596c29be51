//! Whether a scan could have been made from where it is said to have been made: a robot does not see
//! through walls, a wall does not stand close before another that was seen, and no floor lies between
//! the sensor and the wheels.

use super::estimate::Estimate;
use super::landmark::Landmark;
use super::observation::Observation;
use super::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Point3, Vector3};

/// Most points of one observation that are looked at.
const SAMPLES_PER_PLANE: usize = 40;
/// A point this far behind a landmark, and this much more per metre of range, was seen through it:
/// what a pose is wrong by must not count. The first is for a pose that is known, to which its
/// standard deviations add; the second is the most that they may make of it.
const KNOWN_BEHIND_M: f64 = 0.05;
const SIGMAS: f64 = 3.0;
const BEHIND_M: f64 = 0.15;
const BEHIND_PER_M: f64 = 0.015;
/// A surface up to this far before a parallel one cannot be: that one was seen, square on, where it
/// would be hidden.
const DOUBLED_M: f64 = 0.6;
const PARALLEL_COSINE: f64 = 0.99;
/// Cells around the crossing in each axis that must all have been hit: edges of doorways shift with
/// the pose.
const SOLID_CELLS: i32 = 2;
/// Sine of the angle to the surface below which a ray grazes it and says nothing.
const GRAZING_SINE: f64 = 0.15;

/// How a scan and the map contradict each other under a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Contradiction {
    /// Points of the scan that were looked at.
    pub(super) samples: usize,
    /// Those that lie behind a surface of the map, seen from the sensor, or close before one.
    pub(super) refuted: usize,
    /// Points where the wheels touch the ground that were looked at, and those behind a surface.
    pub(super) contacts: usize,
    pub(super) sunk: usize,
}

impl Contradiction {
    /// Share of the points that contradict.
    pub(super) fn share(&self) -> f64 {
        self.refuted as f64 / self.samples.max(1) as f64
    }

    /// Share of the wheels that a surface of the map cuts off from the sensor.
    pub(super) fn sunk_share(&self) -> f64 {
        self.sunk as f64 / self.contacts.max(1) as f64
    }
}

impl Estimate {
    /// How many points of the scan lie behind landmarks when the robot stands at `world_from_robot`,
    /// which is known to `sigma_m` in each direction: a pose that pairs have fixed is held to
    /// centimetres, or a robot beside a stair could be a step of 0.18 m higher.
    ///
    /// Costs samples × landmarks about the scan; asked only where an association is in doubt.
    pub(super) fn contradiction(
        &self,
        world_from_robot: &Isometry3<f64>,
        sigma_m: f64,
        scan: &ScanObservations,
    ) -> Contradiction {
        let behind_m = (KNOWN_BEHIND_M + SIGMAS * sigma_m).min(BEHIND_M);
        let world_from_scan = world_from_robot * scan.robot_from_scan;
        let eye = Point3::from(world_from_scan.translation.vector);
        let hulls = scan.observations.iter().flat_map(Observation::hull_points);
        let around = hulls.chain(scan.contacts.iter().copied());
        let around = around.map(|p| world_from_robot * p).chain([eye]);
        let walls: Vec<Wall<'_>> =
            self.landmarks_about(around).filter_map(|l| Wall::facing(l, &eye, behind_m)).collect();
        let contacts = scan.contacts.iter().map(|contact| world_from_robot * contact);
        let sunk = contacts.filter(|p| walls.iter().any(|wall| wall.hides(p))).count();
        let mut found =
            Contradiction { contacts: scan.contacts.len(), sunk, ..Contradiction::default() };
        for observation in &scan.observations {
            let world_from_plane = world_from_robot * observation.robot_from_plane;
            let normal = world_from_plane.rotation * Vector3::z();
            let stride = (observation.mask.count() / SAMPLES_PER_PLANE).max(1);
            for cell in observation.mask.cells().step_by(stride) {
                let point = world_from_plane * Point3::new(cell.x, cell.y, 0.0);
                found.samples += 1;
                if walls.iter().any(|wall| wall.refutes(&point, &normal)) {
                    found.refuted += 1;
                }
            }
        }
        found
    }
}

/// A landmark as seen from a point in front of it.
struct Wall<'a> {
    landmark: &'a Landmark,
    plane_from_world: Isometry3<f64>,
    eye: Point3<f64>,
    behind_m: f64,
}

impl<'a> Wall<'a> {
    fn facing(landmark: &'a Landmark, eye: &Point3<f64>, behind_m: f64) -> Option<Self> {
        let plane_from_world = landmark.world_from_plane.inverse();
        let eye = plane_from_world * eye;
        (eye.z > BEHIND_M && !landmark.mask.is_empty()).then_some(Self {
            landmark,
            plane_from_world,
            eye,
            behind_m,
        })
    }

    /// Whether a point of the world on a surface with that normal cannot have been seen.
    fn refutes(&self, point: &Point3<f64>, normal: &Vector3<f64>) -> bool {
        let target = self.plane_from_world * point;
        let range = (target - self.eye).norm();
        if target.z > self.margin_m(range) && target.z < DOUBLED_M {
            let parallel = self.landmark.normal().dot(normal) > PARALLEL_COSINE;
            return parallel && self.solid_at(&target);
        }
        self.hides(point)
    }

    /// Whether a point of the world lies behind the surface, seen from the eye.
    fn hides(&self, point: &Point3<f64>) -> bool {
        let target = self.plane_from_world * point;
        let ray = target - self.eye;
        let range = ray.norm();
        if target.z > -self.margin_m(range) || -ray.z < GRAZING_SINE * range {
            return false;
        }
        self.solid_at(&(self.eye + ray * (self.eye.z / -ray.z)))
    }

    fn margin_m(&self, range_m: f64) -> f64 {
        self.behind_m + BEHIND_PER_M * range_m
    }

    fn solid_at(&self, point: &Point3<f64>) -> bool {
        self.landmark.mask.solid_about(&point.xy(), SOLID_CELLS)
    }
}
