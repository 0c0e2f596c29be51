//! Cylinders and spheres as landmarks: the axis of the one and the centre of the other are as good a
//! constraint as a plane, and in a hall of columns often the only one along its length.
//!
//! An axis is a frame with z along it: its error is the 4-vector (offset along x, offset along y, tilt
//! towards x, tilt towards y) of its own, in metres and radians. A turn about z and a shift along it
//! are no errors of an axis. A centre is a point; its error is a 3-vector in the world.

use super::graph::{Factor, Key, Value, scaled_errors};
use super::scan_errors::{ScanErrors, curve_error_jacobian};
use crate::segmentation::{Segmentation, Shape, Surface};
use nalgebra::{
    Isometry3, Matrix3, Matrix4, Point3, Translation3, UnitQuaternion, Vector3, Vector4,
};
use serde::{Deserialize, Serialize};

/// What columns, trees and drums differ from a cylinder by, beside the noise of the ranges: standard
/// deviations of the axis' place and of its tilt over a length of one metre.
const IMPERFECT_M: f64 = 0.003;
const IMPERFECT_RAD_M: f64 = 0.003;
/// A curve is a constraint when it is determined to this (offset, radius: metres; tilt: radians).
const DETERMINED_M: f64 = 0.05;
const DETERMINED_RAD: f64 = 0.05;
/// Points whose distances from the shape exceed this share of its radius in the root mean square are
/// not all of one body.
const MOST_RMS_SHARE: f64 = 0.1;
/// A shorter piece of a cylinder, in radii, says little about its axis; one of so many metres is none.
const LEAST_LENGTH_RADII: f64 = 1.0;
const LONG_M: f64 = 1.5;

/// Which curved body it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CurveKind {
    /// A circular cylinder, of which the axis counts.
    Cylinder,
    /// A sphere, of which the centre counts.
    Sphere,
}

impl CurveKind {
    /// Degrees of freedom of one sighting.
    pub fn degrees(self) -> usize {
        match self {
            Self::Cylinder => 4,
            Self::Sphere => 3,
        }
    }
}

/// A cylinder or a sphere as the robot saw it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvedObservation {
    /// Which body.
    pub kind: CurveKind,
    /// Frame of the curve in the robot frame: origin in the middle of the part of the axis that was
    /// seen, z along the axis; or the centre, with the axes of the scan.
    pub robot_from_curve: Isometry3<f64>,
    /// Covariance of the frame's errors: of an axis all four (m², rad²), of a centre the first three
    /// along the frame's axes (m²).
    pub covariance: Matrix4<f64>,
    /// Radius in metres.
    pub radius_m: f64,
    /// Its standard deviation.
    pub radius_sigma_m: f64,
    /// Extent along the axis in metres; zero for a sphere.
    pub length_m: f64,
    /// Number of points.
    pub points: usize,
    /// Root mean square of their distances from the shape, in metres.
    pub rms_m: f64,
}

impl CurvedObservation {
    /// The observation of a fitted surface; `None` where it is neither cylinder nor sphere or too
    /// loosely determined to constrain anything.
    pub fn from_surface(surface: &Surface, robot_from_grid: &Isometry3<f64>) -> Option<Self> {
        let seen = match &surface.shape {
            Shape::Cylinder(cylinder) => {
                let short =
                    cylinder.length_m < (LEAST_LENGTH_RADII * cylinder.radius_m).min(LONG_M);
                let tilt = IMPERFECT_RAD_M / cylinder.length_m.max(1e-3);
                let imperfect = Vector4::new(IMPERFECT_M, IMPERFECT_M, tilt, tilt);
                (!short).then(|| Self {
                    kind: CurveKind::Cylinder,
                    robot_from_curve: robot_from_grid * cylinder.grid_from_axis(),
                    covariance: cylinder.covariance.fixed_view::<4, 4>(0, 0)
                        + Matrix4::from_diagonal(&imperfect.component_mul(&imperfect)),
                    radius_m: cylinder.radius_m,
                    radius_sigma_m: cylinder.covariance[(4, 4)].max(0.0).sqrt(),
                    length_m: cylinder.length_m,
                    points: surface.points,
                    rms_m: surface.rms_m,
                })?
            }
            Shape::Sphere(sphere) => {
                let mut covariance = Matrix4::identity();
                let of_centre = sphere.covariance.fixed_view::<3, 3>(0, 0)
                    + Matrix3::identity() * (IMPERFECT_M * IMPERFECT_M);
                covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&of_centre);
                Self {
                    kind: CurveKind::Sphere,
                    robot_from_curve: robot_from_grid
                        * Isometry3::from(Translation3::from(sphere.centre.coords)),
                    covariance,
                    radius_m: sphere.radius_m,
                    radius_sigma_m: sphere.covariance[(3, 3)].max(0.0).sqrt(),
                    length_m: 0.0,
                    points: surface.points,
                    rms_m: surface.rms_m,
                }
            }
            Shape::Plane(_) | Shape::Other => return None,
        };
        let thick = surface.rms_m > MOST_RMS_SHARE * seen.radius_m;
        (!thick && seen.is_determined()).then_some(seen)
    }

    fn is_determined(&self) -> bool {
        let loosest = |range: std::ops::Range<usize>| {
            range.map(|i| self.covariance[(i, i)]).fold(0.0, f64::max).sqrt()
        };
        let (offset, tilt) = match self.kind {
            CurveKind::Cylinder => (loosest(0..2), loosest(2..4)),
            CurveKind::Sphere => (loosest(0..3), 0.0),
        };
        self.covariance.iter().all(|entry| entry.is_finite())
            && self.robot_from_curve.translation.vector.iter().all(|entry| entry.is_finite())
            && self.covariance.cholesky().is_some()
            && offset < DETERMINED_M
            && self.radius_sigma_m < DETERMINED_M
            && tilt < DETERMINED_RAD
    }

    /// The measurement that ties the pose `pose` to the landmark `curve`; `errors` are the common
    /// errors of the scan.
    pub(super) fn factor(
        &self,
        pose: Key,
        curve: Key,
        errors: Option<(Key, &ScanErrors)>,
        robot_from_scan: &Isometry3<f64>,
    ) -> Factor {
        let common = errors.map(|(key, errors)| {
            let jacobian = curve_error_jacobian(self, robot_from_scan);
            (key, scaled_errors(&jacobian, &errors.sigmas()))
        });
        match self.kind {
            CurveKind::Cylinder => Factor::Axis {
                pose,
                axis: curve,
                errors: common,
                robot_from_axis: self.robot_from_curve,
                covariance: self.covariance,
            },
            CurveKind::Sphere => {
                let rotation = self.robot_from_curve.rotation.to_rotation_matrix().into_inner();
                let own = self.covariance.fixed_view::<3, 3>(0, 0);
                Factor::Centre {
                    pose,
                    centre: curve,
                    errors: common
                        .map(|(key, jacobian)| (key, rotation * jacobian.fixed_rows::<3>(0))),
                    robot_point: Point3::from(self.robot_from_curve.translation.vector),
                    covariance: rotation * own * rotation.transpose(),
                }
            }
        }
    }

    /// A first guess of the landmark's value.
    pub(super) fn guess(&self, world_from_robot: &Isometry3<f64>) -> Value {
        let frame = world_from_robot * self.robot_from_curve;
        match self.kind {
            CurveKind::Cylinder => Value::Axis(frame),
            CurveKind::Sphere => Value::Centre(Point3::from(frame.translation.vector)),
        }
    }
}

/// An axis frame moved by an error of its own, see the [module](self).
pub(super) fn perturbed_axis(frame: &Isometry3<f64>, error: &Vector4<f64>) -> Isometry3<f64> {
    // z tips towards x by a rotation about y and towards y by one about -x.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(-error[3], error[2], 0.0));
    let shift = Translation3::new(error[0], error[1], 0.0);
    let mut moved = frame * Isometry3::from_parts(shift, turn);
    moved.rotation.renormalize();
    moved
}

/// A cylinder or a sphere of the map.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvedLandmark {
    /// Which body.
    pub kind: CurveKind,
    /// Its frame in the world: z along the axis, the origin on it or in the centre.
    pub world_from_curve: Isometry3<f64>,
    /// Radius in metres, over all sightings.
    pub radius_m: f64,
    /// Its standard deviation.
    pub radius_sigma_m: f64,
    /// Where along z the part that was seen begins and ends, in metres.
    pub along_m: (f64, f64),
    /// Points of all sightings.
    pub points: usize,
    /// Root mean square of their distances from the shapes of their own sightings, in metres.
    pub rms_m: f64,
    /// Number of scans in which it was seen, the first included.
    pub sightings: u32,
    /// Keyframe that saw it first.
    pub first_keyframe: usize,
    /// Keyframe that saw it last.
    pub last_keyframe: usize,
    pub(super) key: Key,
}

impl CurvedLandmark {
    /// A landmark as first observed from `world_from_robot`.
    pub(super) fn first_seen(
        key: Key,
        seen: &CurvedObservation,
        world_from_robot: &Isometry3<f64>,
        keyframe: usize,
    ) -> Self {
        Self {
            kind: seen.kind,
            world_from_curve: world_from_robot * seen.robot_from_curve,
            radius_m: seen.radius_m,
            radius_sigma_m: seen.radius_sigma_m,
            along_m: (-0.5 * seen.length_m, 0.5 * seen.length_m),
            points: seen.points,
            rms_m: seen.rms_m,
            sightings: 1,
            first_keyframe: keyframe,
            last_keyframe: keyframe,
            key,
        }
    }

    /// Takes in that it was seen again.
    pub(super) fn extend(
        &mut self,
        seen: &CurvedObservation,
        world_from_robot: &Isometry3<f64>,
        keyframe: usize,
    ) {
        let curve_from_seen =
            self.world_from_curve.inverse() * world_from_robot * seen.robot_from_curve;
        if self.kind == CurveKind::Cylinder {
            for end in [-0.5, 0.5] {
                let z = (curve_from_seen * Point3::new(0.0, 0.0, end * seen.length_m)).z;
                self.along_m = (self.along_m.0.min(z), self.along_m.1.max(z));
            }
        }
        let weight = |sigma: f64| 1.0 / (sigma * sigma + IMPERFECT_M * IMPERFECT_M);
        let (own, other) = (weight(self.radius_sigma_m), weight(seen.radius_sigma_m));
        self.radius_m = (own * self.radius_m + other * seen.radius_m) / (own + other);
        self.radius_sigma_m = (1.0 / (own + other)).sqrt();
        let squares = |points: usize, rms_m: f64| points as f64 * rms_m * rms_m;
        let sum = squares(self.points, self.rms_m) + squares(seen.points, seen.rms_m);
        self.points += seen.points;
        self.rms_m = (sum / self.points.max(1) as f64).sqrt();
        self.sightings += 1;
        self.last_keyframe = keyframe;
    }

    /// Follows the solution of the graph.
    pub(super) fn follow(&mut self, value: &Value) {
        match value {
            Value::Axis(frame) => self.world_from_curve = *frame,
            Value::Centre(point) => self.world_from_curve.translation.vector = point.coords,
            Value::Pose(_) | Value::Plane(_) | Value::Errors(_) => {}
        }
    }

    /// Gap between the surfaces of this body and of one seen from
    /// `world_from_robot`, in metres: negative where they share room. Of axes that are not parallel
    /// it is the gap about the middle of the part seen.
    pub(super) fn gap_m(&self, seen: &CurvedObservation, world_from_robot: &Isometry3<f64>) -> f64 {
        let middle = (self.world_from_curve.inverse() * world_from_robot * seen.robot_from_curve)
            .translation
            .vector;
        let reach = self.radius_m + seen.radius_m;
        match self.kind {
            CurveKind::Sphere => middle.norm() - reach,
            CurveKind::Cylinder => {
                let half = 0.5 * seen.length_m;
                let beyond =
                    (self.along_m.0 - (middle.z + half)).max(middle.z - half - self.along_m.1);
                (middle.xy().norm() - reach).max(beyond)
            }
        }
    }

    /// Corners of the body in the world: the rims of a cylinder's part that was seen, each of `sides`
    /// corners, lower first; for a sphere the same of its girdle.
    pub fn rims(&self, sides: usize) -> [Vec<Point3<f64>>; 2] {
        let rim = |z: f64| {
            (0..sides)
                .map(|i| {
                    let turn = std::f64::consts::TAU * i as f64 / sides as f64;
                    let (sin, cos) = turn.sin_cos();
                    self.world_from_curve * Point3::new(self.radius_m * cos, self.radius_m * sin, z)
                })
                .collect()
        };
        match self.kind {
            CurveKind::Cylinder => [rim(self.along_m.0), rim(self.along_m.1)],
            CurveKind::Sphere => [rim(-0.7 * self.radius_m), rim(0.7 * self.radius_m)],
        }
    }
}

/// The cylinders and spheres of a segmented scan that can constrain the robot, in the order of the
/// surfaces' ids. `robot_from_grid` is the scan frame's pose at the time of the scan.
pub fn curved_observations(
    segmentation: &Segmentation,
    robot_from_grid: &Isometry3<f64>,
) -> Vec<CurvedObservation> {
    segmentation
        .surfaces
        .iter()
        .filter_map(|surface| CurvedObservation::from_surface(surface, robot_from_grid))
        .collect()
}
