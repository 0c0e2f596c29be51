//! Labels to the result: regions, final fits, hulls, ids.

use super::Stage;
use super::axes::candidate_axes;
use super::borders::Borders;
use super::components::{Components, NONE};
use super::config::SegmentationConfig;
use super::field::Field;
use super::fit::{
    CAP, Candidates, Fitted, Model, PlaneFit, PlaneStart, PlaneSums, Readings, choose, is_flat,
};
use super::hull::HullFinder;
use super::surface::{Cylinder, PlanePatch, Rejected, Segmentation, Shape, Sphere, Surface};
use nalgebra::{Point2, Point3, Vector3};
use std::fmt::Write as _;
use std::ops::Range;

/// Rejected regions smaller than this share one line: a scan has hundreds of them.
const REPORTED_POINTS: usize = 10;

/// The square at which an error is cut.
const CAP_SQUARE: f32 = (CAP * CAP) as f32;

/// Room for any reason, so that a string can take another one without a new allocation.
const REASON_BYTES: usize = 64;

/// Room for the vertices of nearly any hull, so that any region can take any spare one.
const HULL_VERTICES: usize = 64;

/// About how many cells of a region tell which shape it has.
const TRIAL_CELLS: usize = 250;

/// Buffers that make results without new allocations.
#[derive(Clone, Debug, Default)]
pub(super) struct Assembler {
    components: Components,
    borders: Borders,
    border: Vec<u32>,
    /// Whether each cell is far from the border of its region to another.
    core: Vec<bool>,
    readings: Readings,
    fitted: Vec<(usize, Fitted, PlaneSums)>,
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
        let (mut labelled, mut specks, mut speck_points) = (0, 0, 0);
        for component in 0..self.components.len() {
            let cells = self.components.cells(component);
            let first = if field.transposed {
                cells.iter().map(|&cell| field.grid_index(cell as usize)).min()
            } else {
                cells.first().map(|&cell| cell as usize)
            };
            let first = first.expect("a component has at least the cell it was started from");
            labelled += cells.len();
            if cells.len() >= config.min_points.max(3) {
                self.order.push((first, component));
            } else if cells.len() >= REPORTED_POINTS {
                let (points, least) = (cells.len(), config.min_points.max(3));
                let reason = format_args!("{points} points, fewer than {least}");
                reject(&mut self.spare_reasons, result, points, reason);
            } else {
                specks += 1;
                speck_points += cells.len();
            }
        }
        if specks > 0 {
            let reason =
                format_args!("{specks} regions of fewer than {REPORTED_POINTS} points each");
            reject(&mut self.spare_reasons, result, speck_points, reason);
        }
        let valid = field.range.iter().filter(|&&range| range > 0.0).count();
        if valid > labelled {
            let reason = format_args!("single points that no surface beside them explains");
            reject(&mut self.spare_reasons, result, valid - labelled, reason);
        }
        self.order.sort_unstable();
        if self.order.len() > usize::from(u16::MAX) {
            for &(_, component) in &self.order[usize::from(u16::MAX)..] {
                let points = self.components.cells(component).len();
                let reason = format_args!("more regions than 16-bit labels");
                reject(&mut self.spare_reasons, result, points, reason);
            }
            self.order.truncate(usize::from(u16::MAX));
        }
    }

    fn fit_regions(&mut self, field: &Field, config: &SegmentationConfig) {
        self.find_core(field);
        self.fitted.clear();
        for k in 0..self.order.len() {
            let (_, component) = self.order[k];
            let (sums, plane) = self.fit_plane(field, component, config);
            let fitted = match plane {
                Some((plane, true)) => Fitted::Plane(plane),
                Some((plane, false)) => {
                    self.choose_shape(field, component, config).unwrap_or(Fitted::Plane(plane))
                }
                None => Fitted::Other,
            };
            self.fitted.push((component, fitted, sums));
        }
    }

    /// Marks the cells that have no valid neighbour of another component.
    fn find_core(&mut self, field: &Field) {
        let of_cell = &self.components.of_cell;
        self.borders.find(of_cell, field.lanes, &mut self.border);
        self.core.clear();
        self.core.resize(field.len(), true);
        for &cell in &self.border {
            self.core[cell as usize] = self.components.is_core(cell as usize, field);
        }
    }

    /// The plane of a component, if it has one, and whether it explains the readings.
    fn fit_plane(
        &self,
        field: &Field,
        component: usize,
        config: &SegmentationConfig,
    ) -> (PlaneSums, Option<(PlaneFit, bool)>) {
        let cells = self.components.cells(component);
        let mut sums = PlaneSums::default();
        for run in runs(cells) {
            let (x, y, z) = (&field.x[run.clone()], &field.y[run.clone()], &field.z[run.clone()]);
            sums.add_run([x, y, z], &field.gain[run.clone()], &self.core[run]);
        }
        let Some(mut start) = PlaneStart::of(&sums) else { return (sums, None) };
        let mut error = 0.0;
        for run in runs(cells) {
            let (x, y, z) = (&field.x[run.clone()], &field.y[run.clone()], &field.z[run.clone()]);
            let (ranges, gains) = (&field.range[run.clone()], &field.gain[run.clone()]);
            let points = x.iter().zip(y).zip(z).zip(ranges).zip(gains).zip(&self.core[run]);
            for (((((&x, &y), &z), &range), &gain), &core) in points {
                let e = start.settle([x, y, z], range, gain, core);
                error += f64::from((e * e).min(CAP_SQUARE));
            }
        }
        let plane = start.finish().map(|plane| {
            let flat = is_flat(error, cells.len(), &plane, &config.limits, &field.errors);
            (plane, flat)
        });
        (sums, plane)
    }

    /// The shape of a component that a plane does not explain; `None` if a plane is still best.
    ///
    /// A part of the cells, evenly taken, tells which shape it is; only a curved one is then fitted
    /// to all of them.
    fn choose_shape(
        &mut self,
        field: &Field,
        component: usize,
        config: &SegmentationConfig,
    ) -> Option<Fitted> {
        let cells = self.components.cells(component);
        let belongs = |cell: usize| self.components.of_cell[cell] == component as u32;
        let axes = candidate_axes(field, cells, belongs);
        let stride = cells.len().div_ceil(TRIAL_CELLS).max(1);
        gather(field, cells.iter().step_by(stride), &self.core, &mut self.readings);
        let (trial, _) =
            choose(&self.readings, &axes, &config.limits, &field.errors, Candidates::All);
        let candidates = match trial {
            Fitted::Plane(_) => return None,
            Fitted::Other => return Some(Fitted::Other),
            Fitted::Sphere { .. } => Candidates::Sphere,
            Fitted::Cylinder { .. } => Candidates::Cylinder,
        };
        if stride == 1 {
            return Some(trial);
        }
        gather(field, cells.iter(), &self.core, &mut self.readings);
        match choose(&self.readings, &axes, &config.limits, &field.errors, candidates) {
            (Fitted::Plane(_), _) => None,
            (fitted, _) => Some(fitted),
        }
    }

    fn write_surfaces(&mut self, field: &Field, result: &mut Segmentation) {
        // Readings that err alike tell less than their number says.
        let patch = field.errors.patch;
        for (index, (component, fitted, sums)) in self.fitted.drain(..).enumerate() {
            let cells = self.components.cells(component);
            let points = cells.iter().map(|&cell| Vector3::from(field.point(cell as usize)));
            let plain = sums.plain();
            let centroid = Vector3::from(plain.b) / plain.c;
            let (shape, square) = match fitted {
                Fitted::Plane(plane) => {
                    let PlaneFit { grid_from_plane, covariance, .. } = plane;
                    let covariance = covariance * patch;
                    let rotation = grid_from_plane.rotation.to_rotation_matrix();
                    let (ex, ey) = (rotation * Vector3::x(), rotation * Vector3::y());
                    let origin = grid_from_plane.translation.vector;
                    self.flat.clear();
                    self.flat.extend(points.map(|p| {
                        let d = p - origin;
                        [ex.dot(&d), ey.dot(&d)]
                    }));
                    let fresh = || Vec::with_capacity(HULL_VERTICES);
                    let mut hull = self.spare_hulls.pop().unwrap_or_else(fresh);
                    self.hull.find(&self.flat, &mut hull);
                    let patch = PlanePatch { grid_from_plane, covariance, hull };
                    let plane = patch.plane();
                    let square = plain.mean_square_distance(&plane.normal, plane.offset_m);
                    (Shape::Plane(patch), square)
                }
                Fitted::Sphere { centre, radius_m, covariance } => {
                    let covariance = covariance * patch;
                    let model = Model::Sphere { centre: centre.coords, radius_m };
                    let square = mean_square_distance(&model, points);
                    (Shape::Sphere(Sphere { centre, radius_m, covariance }), square)
                }
                Fitted::Cylinder { axis_point, axis, radius_m, length_m, covariance } => {
                    let covariance = covariance * patch;
                    let (foot, direction) = (axis_point.coords, axis.into_inner());
                    let model = Model::Cylinder { foot, axis: direction, radius_m };
                    let square = mean_square_distance(&model, points);
                    let shape = Cylinder { axis_point, axis, radius_m, length_m, covariance };
                    (Shape::Cylinder(shape), square)
                }
                Fitted::Other => {
                    // From the plane across the line of sight through the centroid.
                    let square = plain.mean_square_distance(&centroid.normalize(), centroid.norm());
                    (Shape::Other, square)
                }
            };
            result.surfaces.push(Surface {
                id: index as u16 + 1,
                points: cells.len(),
                rms_m: square.max(0.0).sqrt(),
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
                let cell = if field.transposed { field.grid_index(cell) } else { cell };
                result.labels[cell] = self.ids[component as usize];
            }
        }
    }
}

/// Runs of successive cells.
fn runs(cells: &[u32]) -> impl Iterator<Item = Range<usize>> + '_ {
    cells.chunk_by(|a, b| a + 1 == *b).map(|run| run[0] as usize..run[0] as usize + run.len())
}

/// Adds a line to the rejected, in a string that an earlier result had.
fn reject(
    spare: &mut Vec<String>,
    result: &mut Segmentation,
    points: usize,
    reason: std::fmt::Arguments,
) {
    let mut text = spare.pop().unwrap_or_else(|| String::with_capacity(REASON_BYTES));
    text.clear();
    text.write_fmt(reason).expect("writing to a string does not fail");
    result.rejected.push(Rejected { points, reason: text });
}

/// Gathers the readings of cells.
fn gather<'a>(
    field: &Field,
    cells: impl Iterator<Item = &'a u32>,
    core: &[bool],
    readings: &mut Readings,
) {
    readings.clear();
    for &cell in cells {
        let cell = cell as usize;
        let (inverse, sigma) = (f64::from(field.inverse[cell]), field.sigma_m(cell));
        readings.push(field.point(cell), inverse, sigma, core[cell]);
    }
}

/// Mean square of the geometric distance from a shape.
fn mean_square_distance(model: &Model, points: impl ExactSizeIterator<Item = Vector3<f64>>) -> f64 {
    let count = points.len().max(1) as f64;
    points.map(|p| model.distance(&p).0.powi(2)).sum::<f64>() / count
}
