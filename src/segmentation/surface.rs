use super::fit::across;
use crate::geometry::{Plane, polygon_area};
use nalgebra::{
    Isometry3, Matrix3, Matrix4, Matrix5, Point2, Point3, Rotation3, Unit, UnitQuaternion, Vector3,
};
use serde::{Deserialize, Serialize};

/// The result of segmenting one [`PointGrid`](crate::scan::PointGrid).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Segmentation {
    /// Rows of the grid.
    pub rows: usize,
    /// Columns of the grid.
    pub columns: usize,
    /// One label per cell, row by row: 0 for none, else the `id` of a surface. Each label is one
    /// 8-connected region.
    pub labels: Vec<u16>,
    /// Surfaces in the order of their ids.
    pub surfaces: Vec<Surface>,
    /// Regions that were found and dropped, and why.
    pub rejected: Vec<Rejected>,
}

/// One fitted region, in the frame of the grid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Surface {
    /// Label of the region, from 1.
    pub id: u16,
    /// Number of points of the region.
    pub points: usize,
    /// Root mean square of the geometric distance of its points from the fitted shape, in metres.
    pub rms_m: f64,
    /// Centre of gravity of its points.
    pub centroid: Point3<f64>,
    /// The fitted shape.
    pub shape: Shape,
}

/// What was fitted to a region.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Shape {
    /// A planar patch.
    Plane(PlanePatch),
    /// A sphere.
    Sphere(Sphere),
    /// A circular cylinder of any axis.
    Cylinder(Cylinder),
    /// A region that none of the models describes.
    Other,
}

/// A bounded piece of a plane.
///
/// Its local frame has its origin at the centre of gravity, z along the normal (towards the
/// sensor), x along the greater and y along the lesser principal axis of the points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanePatch {
    /// Pose of the local frame in the frame of the grid.
    pub grid_from_plane: Isometry3<f64>,
    /// Covariance of a perturbation of the local frame: offset along z in m², rotation about y
    /// (the paper's θ) and rotation about x (its ψ) in rad². It holds what noise leaves open, and, where
    /// blocks of readings show that surfaces are uneven, what a look at another part may differ by.
    pub covariance: Matrix3<f64>,
    /// Convex hull of the points in the local x-y plane, counter-clockwise, in metres.
    pub hull: Vec<Point2<f64>>,
    /// Standard deviation across the plane that the noise of the ranges gives a point at the centre of
    /// gravity, in metres.
    pub noise_m: f64,
}

/// A sphere.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sphere {
    /// Centre.
    pub centre: Point3<f64>,
    /// Radius in metres.
    pub radius_m: f64,
    /// Covariance of centre and radius, m².
    pub covariance: Matrix4<f64>,
}

/// A bounded circular cylinder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cylinder {
    /// Middle of the measured part of the axis.
    pub axis_point: Point3<f64>,
    /// Direction of the axis; the sign carries no meaning.
    pub axis: Unit<Vector3<f64>>,
    /// Radius in metres.
    pub radius_m: f64,
    /// Extent of the points along the axis, in metres.
    pub length_m: f64,
    /// Covariance of the offset across the axis (two directions, m²), its tilt (two, rad²) and the
    /// radius (m²). The first direction is `axis × e`, with `e` the coordinate axis that `axis` has
    /// least of; the second is `axis ×` the first; a positive tilt turns the axis towards them.
    pub covariance: Matrix5<f64>,
}

/// A region that did not become a surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rejected {
    /// Number of its points.
    pub points: usize,
    /// Why it was dropped.
    pub reason: String,
}

impl Surface {
    /// The same surface in a frame of the same axes, in which the grid's origin lies at `by`.
    #[must_use]
    pub fn translated(&self, by: &Vector3<f64>) -> Self {
        let mut moved = self.clone();
        moved.centroid += by;
        match &mut moved.shape {
            Shape::Plane(patch) => patch.grid_from_plane.translation.vector += by,
            Shape::Sphere(sphere) => sphere.centre += by,
            Shape::Cylinder(cylinder) => cylinder.axis_point += by,
            Shape::Other => {}
        }
        moved
    }
}

impl Cylinder {
    /// Pose of the axis in the frame of the grid: origin in the middle of the measured part, x and y
    /// along the two directions of the covariance, z along the axis.
    pub fn grid_from_axis(&self) -> Isometry3<f64> {
        let (first, second) = across(&self.axis);
        let basis = Rotation3::from_basis_unchecked(&[first, second, self.axis.into_inner()]);
        let rotation = UnitQuaternion::from_rotation_matrix(&basis);
        Isometry3::from_parts(self.axis_point.coords.into(), rotation)
    }
}

impl PlanePatch {
    /// The infinite plane of the patch in the frame of the grid, facing the sensor.
    pub fn plane(&self) -> Plane {
        let normal = self.grid_from_plane.rotation * Vector3::z();
        Plane { normal, offset_m: normal.dot(&self.grid_from_plane.translation.vector) }
    }

    /// Area of the hull in m².
    pub fn area_m2(&self) -> f64 {
        polygon_area(&self.hull)
    }

    /// The hull's vertices in the frame of the grid.
    pub fn hull_points(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        self.hull.iter().map(|p| self.grid_from_plane * Point3::new(p.x, p.y, 0.0))
    }
}
