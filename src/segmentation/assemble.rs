//! Labels to the result: regions, final fits, hulls, ids.

use super::Stage;
use super::axes::candidate_axes;
use super::components::{Components, NONE};
use super::config::SegmentationConfig;
use super::field::Field;
use super::fit::{Fitted, PlaneFit, Readings, choose};
use super::hull::HullFinder;
use super::surface::{Cylinder, PlanePatch, Rejected, Segmentation, Shape, Sphere, Surface};
use nalgebra::{Point2, Point3, Vector3};
use std::fmt::Write as _;

/// Regions smaller than this share of `min_points` are not worth a line among the rejected.
const REPORTED_SHARE: usize = 4;

/// Buffers that make results without new allocations.
#[derive(Clone, Debug, Default)]
pub(super) struct Assembler {
    components: Components,
    readings: Readings,
    fitted: Vec<(usize, Fitted, f64)>,
    order: Vec<(usize, usize)>,
    ids: Vec<u16>,
    hull: HullFinder,
    flat: Vec<[f64; 2]>,
    spare_hulls: Vec<Vec<Point2<f64>>>,
    spare_reasons: Vec<String>,
}

impl Assembler {
    /// Turns `labels` (field order, 0 for none) into `result`.
    pub fn assemble(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        labels: &[u32],
        (rows, columns): (usize, usize),
        result: &mut Segmentation,
        observe: &mut dyn FnMut(Stage),
    ) {
        self.recycle(result);
        (result.rows, result.columns) = (rows, columns);
        self.components.find(labels, field.lanes);
        self.number_regions(field, config, result);
        self.fit_regions(field, config);
        observe(Stage::Fit);
        self.write_surfaces(field, result);
        self.write_labels(field, result);
        observe(Stage::Hull);
    }

    /// Takes back what the last result had allocated.
    fn recycle(&mut self, result: &mut Segmentation) {
        for surface in result.surfaces.drain(..) {
            if let Shape::Plane(patch) = surface.shape {
                self.spare_hulls.push(patch.hull);
            }
        }
        self.spare_reasons.extend(result.rejected.drain(..).map(|rejected| rejected.reason));
    }

    /// Puts the regions in the order of their first cell in the grid, and rejects the small ones.
    fn number_regions(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        result: &mut Segmentation,
    ) {
        self.order.clear();
        for component in 0..self.components.len() {
            let cells = self.components.cells(component);
            let first = cells.iter().map(|&cell| field.grid_index(cell as usize)).min();
            let first = first.expect("a component has at least the cell it was started from");
            if cells.len() >= config.min_points.max(3) {
                self.order.push((first, component));
            } else if cells.len() * REPORTED_SHARE >= config.min_points {
                let mut reason = self.spare_reasons.pop().unwrap_or_default();
                reason.clear();
                write!(reason, "{} points, fewer than {}", cells.len(), config.min_points)
                    .expect("writing to a string does not fail");
                result.rejected.push(Rejected { points: cells.len(), reason });
            }
        }
        self.order.sort_unstable();
        if self.order.len() > usize::from(u16::MAX) {
            for &(_, component) in &self.order[usize::from(u16::MAX)..] {
                let points = self.components.cells(component).len();
                let reason = "more regions than 16-bit labels".to_owned();
                result.rejected.push(Rejected { points, reason });
            }
            self.order.truncate(usize::from(u16::MAX));
        }
    }

    fn fit_regions(&mut self, field: &Field, config: &SegmentationConfig) {
        self.fitted.clear();
        for &(_, component) in &self.order {
            self.readings.clear();
            let cells = self.components.cells(component);
            for &cell in cells {
                let cell = cell as usize;
                let sigma = field.sigma_m(cell);
                let core = self.components.is_core(cell, field);
                self.readings.push(field.point(cell), f64::from(field.inverse[cell]), sigma, core);
            }
            let belongs = |cell: usize| self.components.of_cell[cell] == component as u32;
            let axes = candidate_axes(field, cells, belongs);
            let (fitted, mean_square) = choose(&self.readings, &axes, &config.limits);
            self.fitted.push((component, fitted, mean_square));
        }
    }

    fn write_surfaces(&mut self, field: &Field, result: &mut Segmentation) {
        for (index, (component, fitted, _)) in self.fitted.drain(..).enumerate() {
            let cells = self.components.cells(component);
            let points = cells.iter().map(|&cell| Vector3::from(field.point(cell as usize)));
            let centroid: Vector3<f64> = points.clone().sum::<Vector3<f64>>() / cells.len() as f64;
            let shape = match fitted {
                Fitted::Plane(plane) => {
                    let PlaneFit { grid_from_plane, covariance, .. } = plane;
                    self.flat.clear();
                    self.flat.extend(points.clone().map(|p| {
                        let local = grid_from_plane.inverse_transform_point(&Point3::from(p));
                        [local.x, local.y]
                    }));
                    let mut hull = self.spare_hulls.pop().unwrap_or_default();
                    self.hull.find(&self.flat, &mut hull);
                    Shape::Plane(PlanePatch { grid_from_plane, covariance, hull })
                }
                Fitted::Sphere { centre, radius_m, covariance } => {
                    Shape::Sphere(Sphere { centre, radius_m, covariance })
                }
                Fitted::Cylinder { axis_point, axis, radius_m, length_m, covariance } => {
                    Shape::Cylinder(Cylinder { axis_point, axis, radius_m, length_m, covariance })
                }
                Fitted::Other => Shape::Other,
            };
            result.surfaces.push(Surface {
                id: index as u16 + 1,
                points: cells.len(),
                rms_m: rms_m(&shape, &centroid, points),
                centroid: Point3::from(centroid),
                shape,
            });
        }
    }

    fn write_labels(&mut self, field: &Field, result: &mut Segmentation) {
        self.ids.clear();
        self.ids.resize(self.components.len(), 0);
        for (index, &(_, component)) in self.order.iter().enumerate() {
            self.ids[component] = index as u16 + 1;
        }
        result.labels.clear();
        result.labels.resize(field.len(), 0);
        for (cell, &component) in self.components.of_cell.iter().enumerate() {
            if component != NONE {
                result.labels[field.grid_index(cell)] = self.ids[component as usize];
            }
        }
    }
}

/// Root mean square of the geometric distance from the shape; from the centroid's plane of sight
/// for none.
fn rms_m(
    shape: &Shape,
    centroid: &Vector3<f64>,
    points: impl ExactSizeIterator<Item = Vector3<f64>>,
) -> f64 {
    use super::fit::Model;
    let model = match shape {
        Shape::Plane(patch) => {
            let plane = patch.plane();
            Model::Plane { normal: plane.normal, offset_m: plane.offset_m }
        }
        Shape::Sphere(s) => Model::Sphere { centre: s.centre.coords, radius_m: s.radius_m },
        Shape::Cylinder(c) => Model::Cylinder {
            foot: c.axis_point.coords,
            axis: c.axis.into_inner(),
            radius_m: c.radius_m,
        },
        Shape::Other => {
            let normal = centroid.normalize();
            Model::Plane { normal, offset_m: centroid.norm() }
        }
    };
    let count = points.len().max(1) as f64;
    (points.map(|p| model.distance(&p).0.powi(2)).sum::<f64>() / count).sqrt()
}
