//! Whether a scan could have been made from where it is said to have been made: a robot does not see
//! through walls, a wall does not stand close before another that was seen, and no floor lies between
//! the sensor and the wheels.

use super::estimate::Estimate;
use super::landmark::Landmark;
use super::observation::Observation;
use super::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// Most points of one observation that are looked at.
const SAMPLES_PER_PLANE: usize = 40;
/// A point this far behind a landmark, and this much more per metre of range, was seen through it:
/// what a pose is wrong by must not count. The first is for a pose that is known, to which its
/// standard deviations add; the second is the most that they may make of it.
const KNOWN_BEHIND_M: f64 = 0.05;
const SIGMAS: f64 = 3.0;
const BEHIND_M: f64 = 0.15;
const BEHIND_PER_M: f64 = 0.015;
/// The same for where the wheels are: they stand on the ground, whatever the sensor sees of it.
const WHEEL_SIGMAS: f64 = 2.0;
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
    /// Points where the wheels touch the ground, and those of them that lie behind a surface or hang
    /// close above a floor.
    pub(super) contacts: usize,
    pub(super) groundless: usize,
}

impl Contradiction {
    /// Share of the points that contradict.
    pub(super) fn share(&self) -> f64 {
        self.refuted as f64 / self.samples.max(1) as f64
    }

    /// Share of the wheels that cannot be where they are said to be.
    pub(super) fn groundless_share(&self) -> f64 {
        self.groundless as f64 / self.contacts.max(1) as f64
    }
}

impl Estimate {
    /// How many points of the scan lie behind landmarks when the robot stands at `world_from_robot`,
    /// whose position has that covariance: along each landmark's normal a pose that pairs have fixed is
    /// held to centimetres, or a robot beside a stair could be a step of 0.18 m higher.
    ///
    /// Costs samples × landmarks about the scan; asked only where an association is in doubt.
    pub(super) fn contradiction(
        &self,
        world_from_robot: &Isometry3<f64>,
        position_covariance: &Matrix3<f64>,
        scan: &ScanObservations,
    ) -> Contradiction {
        let world_from_scan = world_from_robot * scan.robot_from_scan;
        let eye = Point3::from(world_from_scan.translation.vector);
        let hulls = scan.observations.iter().flat_map(Observation::hull_points);
        let around = hulls.chain(scan.contacts.iter().copied());
        let around = around.map(|p| world_from_robot * p).chain([eye]);
        let walls: Vec<Wall<'_>> = self
            .landmarks_about(around)
            .filter_map(|l| Wall::facing(l, &eye, position_covariance))
            .collect();
        let up = world_from_robot.rotation * Vector3::z();
        let contacts = scan.contacts.iter().map(|contact| world_from_robot * contact);
        let groundless = contacts
            .filter(|p| walls.iter().any(|wall| wall.refutes(p, &up, wall.wheel_margin_m())))
            .count();
        let mut found =
            Contradiction { contacts: scan.contacts.len(), groundless, ..Contradiction::default() };
        for observation in &scan.observations {
            let world_from_plane = world_from_robot * observation.robot_from_plane;
            let normal = world_from_plane.rotation * Vector3::z();
            let stride = (observation.mask.count() / SAMPLES_PER_PLANE).max(1);
            for cell in observation.mask.cells().step_by(stride) {
                let point = world_from_plane * Point3::new(cell.x, cell.y, 0.0);
                found.samples += 1;
                if walls.iter().any(|wall| wall.refutes(&point, &normal, wall.ray_margin_m(&point)))
                {
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
    /// Standard deviation of the robot's position along the normal.
    sigma_m: f64,
}

impl<'a> Wall<'a> {
    fn facing(
        landmark: &'a Landmark,
        eye: &Point3<f64>,
        position_covariance: &Matrix3<f64>,
    ) -> Option<Self> {
        let normal = landmark.normal();
        let sigma_m = normal.dot(&(position_covariance * normal)).max(0.0).sqrt();
        let plane_from_world = landmark.world_from_plane.inverse();
        let eye = plane_from_world * eye;
        (eye.z > BEHIND_M && !landmark.mask.is_empty()).then_some(Self {
            landmark,
            plane_from_world,
            eye,
            sigma_m,
        })
    }

    /// Whether a point of the world on a surface with that normal cannot be there: it is more than the
    /// margin behind the landmark, seen from the eye, or before it.
    fn refutes(&self, point: &Point3<f64>, normal: &Vector3<f64>, margin_m: f64) -> bool {
        let target = self.plane_from_world * point;
        if target.z > margin_m && target.z < DOUBLED_M {
            let parallel = self.landmark.normal().dot(normal) > PARALLEL_COSINE;
            return parallel && self.solid_at(&target);
        }
        let ray = target - self.eye;
        if target.z > -margin_m || -ray.z < GRAZING_SINE * ray.norm() {
            return false;
        }
        self.solid_at(&(self.eye + ray * (self.eye.z / -ray.z)))
    }

    fn ray_margin_m(&self, point: &Point3<f64>) -> f64 {
        let range_m = (self.plane_from_world * point - self.eye).norm();
        (KNOWN_BEHIND_M + SIGMAS * self.sigma_m).min(BEHIND_M) + BEHIND_PER_M * range_m
    }

    fn wheel_margin_m(&self) -> f64 {
        KNOWN_BEHIND_M + WHEEL_SIGMAS * self.sigma_m
    }

    fn solid_at(&self, point: &Point3<f64>) -> bool {
        self.landmark.mask.solid_about(&point.xy(), SOLID_CELLS)
    }
}
