use super::mask::{MASK_CELL_M, PlaneMask};
use super::mask_builder::{MaskBuilder, Spot};
use super::rounding_errors::RoundingErrors;
use super::row_errors::RowErrors;
use crate::geometry::{Plane, polygon_area};
use crate::scan::PointGrid;
use crate::segmentation::{PlanePatch, Segmentation, Shape, Surface};
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// See [`Observation::log_swallowed`].
const SWALLOWED: f64 = 0.01;
const SWALLOWED_M2: f64 = 1.0;

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
    /// Root mean square of their distances from the plane, in metres.
    pub rms_m: f64,
}

impl Observation {
    /// The observation of a fitted plane; `None` where the surface is none or its fit is not finite.
    pub fn from_surface(surface: &Surface, robot_from_grid: &Isometry3<f64>) -> Option<Self> {
        let Shape::Plane(patch) = &surface.shape else { return None };
        Self::from_patch(patch, surface, robot_from_grid)
    }

    fn from_patch(
        patch: &PlanePatch,
        surface: &Surface,
        robot_from_grid: &Isometry3<f64>,
    ) -> Option<Self> {
        let robot_from_plane = robot_from_grid * patch.grid_from_plane;
        let usable = patch.hull.len() >= 3
            && patch.covariance.iter().all(|entry| entry.is_finite())
            && patch.covariance.cholesky().is_some()
            && robot_from_plane.translation.vector.iter().all(|entry| entry.is_finite());
        usable.then(|| Self {
            robot_from_plane,
            covariance: patch.covariance,
            hull: patch.hull.clone(),
            mask: PlaneMask::default(),
            points: surface.points,
            rms_m: surface.rms_m,
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

    /// Logarithm of how often a surface lies close to another of the map that it is not: a scan before swallowed
    /// it, a door's leaf in its wall, a plank on its floor. Beyond a square metre none is overlooked.
    pub(super) fn log_swallowed(&self) -> f64 {
        SWALLOWED.ln() * (self.area_m2() / SWALLOWED_M2).min(1.0)
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
    let mut found: Vec<Option<(Observation, Painter)>> = segmentation
        .surfaces
        .iter()
        .map(|surface| {
            let observation = Observation::from_surface(surface, robot_from_grid)?;
            let painter = Painter::new(surface)?;
            Some((observation, painter))
        })
        .collect();
    let slots = slots_by_label(segmentation);
    let sigmas_rad = grid.row_sigmas_rad();
    let (rows, columns) = (segmentation.rows, segmentation.columns);
    // The row above and this one: the patch of each cell, if it is of one, and where in it; neighbours of one
    // patch in both rows and columns span a piece that was seen as a whole.
    let mut above = vec![(NO_SLOT, Spot::default()); columns];
    let mut here = above.clone();
    let mut rounding_errors = grid.rounding().map(|known| RoundingErrors::new(known, columns));
    for row in 0..rows {
        let mut left = NO_SLOT;
        for column in 0..columns {
            let label = usize::from(segmentation.labels[row * columns + column]);
            let slot = slots.get(label).copied().unwrap_or(NO_SLOT);
            let seen = found.get_mut(slot).and_then(Option::as_mut).zip(grid.point(row, column));
            let Some(((_, painter), point)) = seen else {
                here[column].0 = NO_SLOT;
                left = NO_SLOT;
                continue;
            };
            let spot = painter.spot(&point);
            painter.builder.insert(&spot);
            if rounding_errors.is_some() || !sigmas_rad.is_empty() {
                let sigma_rad = sigmas_rad.get(row).map_or(0.0, |&sigma_rad| f64::from(sigma_rad));
                let pull = painter.rows.add(row, sigma_rad, &point, &painter.place(&point));
                if let Some(rounding_errors) = &mut rounding_errors {
                    let (slope, own_m2) = (painter.slope(&point), painter.rows.own_m2());
                    rounding_errors.add((row, column), slot, (pull, slope, own_m2));
                }
            }
            here[column] = (slot, spot);
            if left == slot && above[column].0 == slot && above[column - 1].0 == slot {
                let corners = [above[column - 1].1, above[column].1, spot, here[column - 1].1];
                painter.builder.insert_quadrilateral(&corners);
            }
            left = slot;
        }
        std::mem::swap(&mut above, &mut here);
    }
    let of_rounding = rounding_errors.map(|errors| errors.of_right_sides(found.len()));
    let with_errors = |(slot, found): (usize, Option<(Observation, Painter)>)| {
        let (observation, painter) = found?;
        let of_rounding = of_rounding.as_ref().map_or(Matrix3::zeros(), |of| of[slot]);
        let covariance = observation.covariance + painter.rows.covariance(&of_rounding);
        // The map divides by it: what cannot be told is no observation.
        covariance.cholesky()?;
        Some(Observation { covariance, mask: painter.builder.finish(), ..observation })
    };
    found.into_iter().enumerate().filter_map(with_errors).collect()
}

/// The slot of a cell that is of no patch.
const NO_SLOT: usize = usize::MAX;

/// Carries points into a patch's frame and marks the cells they hit.
struct Painter {
    /// The frame's x and y axes and its origin, in the grid's frame.
    axes: [Vector3<f64>; 2],
    origin: Vector3<f64>,
    /// The grid's axes and origin in cells of the mask.
    cells_from_grid: [Vector3<f64>; 2],
    cells_at_grid: Vector2<f64>,
    builder: MaskBuilder,
    rows: RowErrors,
}

impl Painter {
    fn new(surface: &Surface) -> Option<Self> {
        let Shape::Plane(patch) = &surface.shape else { return None };
        let rotation = patch.grid_from_plane.rotation;
        let axes = [rotation * Vector3::x(), rotation * Vector3::y()];
        let origin = patch.grid_from_plane.translation.vector;
        let builder = MaskBuilder::over(&patch.hull)?;
        let cells_from_grid = axes.map(|axis| axis / MASK_CELL_M);
        let [u, v] = cells_from_grid.map(|axis| axis.dot(&origin));
        Some(Self {
            rows: RowErrors::new(rotation * Vector3::z(), patch.noise_m),
            axes,
            origin,
            cells_from_grid,
            cells_at_grid: builder.origin() - Vector2::new(u, v),
            builder,
        })
    }

    /// How far a point moves across the plane for a unit of its range.
    fn slope(&self, point: &Point3<f64>) -> f64 {
        let [x, y] = self.axes;
        x.cross(&y).dot(&point.coords) / point.coords.norm()
    }

    fn spot(&self, point: &Point3<f64>) -> Spot {
        let [u, v] = &self.cells_from_grid;
        let from_grid = Vector2::new(u.dot(&point.coords), v.dot(&point.coords));
        Spot::new((from_grid + self.cells_at_grid).into())
    }

    fn place(&self, point: &Point3<f64>) -> Point2<f64> {
        let from = point.coords - self.origin;
        Point2::new(self.axes[0].dot(&from), self.axes[1].dot(&from))
    }
}

/// Position in `surfaces` of each label; label 0 is none.
fn slots_by_label(segmentation: &Segmentation) -> Vec<usize> {
    let highest = segmentation.surfaces.iter().map(|surface| surface.id).max().unwrap_or(0);
    let mut slots = vec![NO_SLOT; usize::from(highest) + 1];
    for (slot, surface) in segmentation.surfaces.iter().enumerate() {
        slots[usize::from(surface.id)] = slot;
    }
    slots[0] = NO_SLOT;
    slots
}
