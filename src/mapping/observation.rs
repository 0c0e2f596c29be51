use super::mask::PlaneMask;
use crate::geometry::{Plane, polygon_area};
use crate::scan::PointGrid;
use crate::segmentation::{PlanePatch, Segmentation, Shape, Surface};
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// One planar patch as the robot saw it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Local frame of the patch in the robot frame: origin at the centre of gravity, z along the
    /// normal towards the sensor, x along the greater principal axis.
    pub robot_from_plane: Isometry3<f64>,
    /// The paper's `R_ij`: covariance of a perturbation of that frame (offset along z in m²,
    /// rotation about y and about x in rad²) from noise that is independent from plane to plane.
    pub covariance: Matrix3<f64>,
    /// Convex hull of the points in the frame's x-y plane, counter-clockwise, in metres.
    pub hull: Vec<Point2<f64>>,
    /// Which cells of the plane were hit, where the points are known.
    pub mask: PlaneMask,
    /// Number of points of the patch.
    pub points: usize,
}

impl Observation {
    /// The observation of a fitted plane; `None` where the surface is none or its fit is not finite.
    pub fn from_surface(surface: &Surface, robot_from_grid: &Isometry3<f64>) -> Option<Self> {
        let Shape::Plane(patch) = &surface.shape else { return None };
        Self::from_patch(patch, surface.points, robot_from_grid)
    }

    fn from_patch(
        patch: &PlanePatch,
        points: usize,
        robot_from_grid: &Isometry3<f64>,
    ) -> Option<Self> {
        let robot_from_plane = robot_from_grid * patch.grid_from_plane;
        let usable = patch.hull.len() >= 3
            && patch.covariance.iter().all(|entry| entry.is_finite())
            && (0..3).all(|i| patch.covariance[(i, i)] > 0.0)
            && robot_from_plane.translation.vector.iter().all(|entry| entry.is_finite());
        usable.then(|| Self {
            robot_from_plane,
            covariance: patch.covariance,
            hull: patch.hull.clone(),
            mask: PlaneMask::default(),
            points,
        })
    }

    /// The infinite plane in the robot frame, facing the sensor.
    pub fn plane(&self) -> Plane {
        let normal = self.normal();
        Plane { normal, offset_m: normal.dot(&self.robot_from_plane.translation.vector) }
    }

    /// Unit normal in the robot frame.
    pub fn normal(&self) -> Vector3<f64> {
        self.robot_from_plane.rotation * Vector3::z()
    }

    /// Centre of gravity in the robot frame.
    pub fn centroid(&self) -> Point3<f64> {
        Point3::from(self.robot_from_plane.translation.vector)
    }

    /// Area of the hull in m².
    pub fn area_m2(&self) -> f64 {
        polygon_area(&self.hull)
    }

    /// The hull's vertices in the robot frame.
    pub fn hull_points(&self) -> impl Iterator<Item = Point3<f64>> + '_ {
        self.hull.iter().map(|p| self.robot_from_plane * Point3::new(p.x, p.y, 0.0))
    }
}

/// The planes of a segmented scan, each with the mask of the cells that its points cover, in the
/// order of the surfaces' ids. `robot_from_grid` is the scan frame's pose at the time of the scan.
pub fn observations(
    segmentation: &Segmentation,
    grid: &PointGrid,
    robot_from_grid: &Isometry3<f64>,
) -> Vec<Observation> {
    let mut found: Vec<Option<Observation>> = segmentation
        .surfaces
        .iter()
        .map(|surface| Observation::from_surface(surface, robot_from_grid))
        .collect();
    let slots = slots_by_label(segmentation);
    let planes_from_grid: Vec<Option<Isometry3<f64>>> = segmentation
        .surfaces
        .iter()
        .map(|surface| match &surface.shape {
            Shape::Plane(patch) => Some(patch.grid_from_plane.inverse()),
            _ => None,
        })
        .collect();
    let columns = segmentation.columns;
    let label_at = |row: usize, column: usize| segmentation.labels.get(row * columns + column);
    for row in 0..segmentation.rows {
        for column in 0..columns {
            let Some(&label) = label_at(row, column).filter(|label| **label > 0) else { continue };
            let Some(&Some(slot)) = slots.get(usize::from(label)) else { continue };
            let (Some(observation), Some(plane_from_grid)) =
                (&mut found[slot], &planes_from_grid[slot])
            else {
                continue;
            };
            let local = |row: usize, column: usize| {
                (row < segmentation.rows && column < columns)
                    .then(|| label_at(row, column).filter(|other| **other == label))
                    .flatten()
                    .and_then(|_| grid.point(row, column))
                    .map(|p| (plane_from_grid * p).xy())
            };
            let Some(corner) = local(row, column) else { continue };
            observation.mask.insert(&corner);
            // Four neighbours of one region span a piece that was seen as a whole.
            let ring = [local(row, column + 1), local(row + 1, column + 1), local(row + 1, column)];
            if let [Some(b), Some(c), Some(d)] = ring {
                observation.mask.insert_triangle(&[corner, b, c]);
                observation.mask.insert_triangle(&[corner, c, d]);
            }
        }
    }
    found.into_iter().flatten().collect()
}

/// Position in `surfaces` of each label.
fn slots_by_label(segmentation: &Segmentation) -> Vec<Option<usize>> {
    let highest = segmentation.surfaces.iter().map(|surface| surface.id).max().unwrap_or(0);
    let mut slots = vec![None; usize::from(highest) + 1];
    for (slot, surface) in segmentation.surfaces.iter().enumerate() {
        slots[usize::from(surface.id)] = Some(slot);
    }
    slots
}
