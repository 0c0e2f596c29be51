//! Labels to the result: regions, final fits, hulls, ids.

use super::Stage;
use super::axes::candidate_axes;
use super::components::{BORDER, Components, fill_ahead};
use super::config::SegmentationConfig;
use super::doubt::{Doubts, square};
use super::field::Field;
use super::fit::{
    Blocks, CAP, Columns, Fitted, Model, Packed, PlaneFit, PlaneSums, Readings, Reference,
    SUMMED_ERROR, SUMMED_SQUARE, Unevenness, centroid_of, choose, fit_plane, is_flat,
    mean_square_distance, plane_of, settle, settle_known,
};
use super::hull::HullFinder;
use super::stick_chain::Found;
use super::surface::{Cylinder, PlanePatch, Rejected, Segmentation, Shape, Sphere, Surface};
use super::unevenness::{UnevenPlanes, common};
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use pulp::{Arch, Simd, WithSimd};
use std::fmt::Write as _;

/// Rejected regions smaller than this share one line: a scan has hundreds of them.
const REPORTED_POINTS: usize = 10;

/// Room for any reason, so that a string can take another one without a new allocation.
const REASON_BYTES: usize = 64;

/// Room for the vertices of nearly any hull, so that any region can take any spare one.
const HULL_VERTICES: usize = 64;

/// About how many cells of a region tell which shape it has.
const TRIAL_CELLS: usize = 250;

/// Deviation of a plane's points, as a share of its length, from which on it is none: bushes, people
/// and heaps have a best plane too, and no map gains by it.
const THICKEST: f64 = 0.1;

/// Fewest core readings, and their least share, for which the border readings can be spared.
const FEWEST_CORE: usize = 12;
const LEAST_CORE_SHARE: f64 = 0.3;

/// Share of a region's cells that are on further beams than the two that have most of them,
/// below which the region is no plane by itself: through two beams there is one whatever they lie on, and
/// nothing that contradicts it.
const BEYOND_TWO_BEAMS: f64 = 0.1;
/// Mean square error, in units of the noise, of two beams on a plane seen elsewhere that they may be a
/// further piece of; both may have an error that all of a beam has in common.
const SAME_PLANE: f64 = 4.0;

/// Mean square error of a plane, beyond one and in units of the noise, from which on a step or the like
/// is looked for in it.
const DOUBTED_EXCESS: f64 = 0.5;
/// Most times that regions are parted.
const PARTINGS: usize = 4;

/// Buffers that make results without new allocations.
#[derive(Clone, Debug, Default)]
pub(super) struct Assembler {
    components: Components,
    doubts: Doubts,
    /// Gains of the cells, zero at borders of regions that can spare them.
    fit_gain: Vec<f32>,
    readings: Readings,
    packed: Packed,
    blocks: Blocks,
    uneven: UnevenPlanes,
    fitted: Vec<FittedRegion>,
    spare_fitted: Vec<FittedRegion>,
    /// Planes that were seen on more than two beams, and the fitted regions that were not.
    planes: Vec<[f64; 3]>,
    guesses: Vec<usize>,
    order: Vec<(usize, usize)>,
    /// Id of each component's surface, 0 for none.
    ids: Vec<u16>,
    hull: HullFinder,
    spare_hulls: Vec<Vec<Point2<f64>>>,
    spare_reasons: Vec<String>,
}

/// What the result says of a component.
#[derive(Clone, Debug)]
struct FittedRegion {
    component: usize,
    /// Its first cell in the grid.
    first: usize,
    cells: usize,
    shape: Fitted,
    centroid: Vector3<f64>,
    /// Mean square distance of the points from a sphere or a cylinder.
    square_m2: Option<f64>,
    /// Whether there are readings that a plane does not explain.
    doubtful: bool,
    /// What blocks of the readings tell of a plane.
    unevenness: Option<Unevenness>,
}

/// What is known of labels: found by a chain, or parts of such.
#[derive(Clone, Copy)]
struct Known<'a> {
    found: &'a Found<'a>,
    parts: &'a [[f64; 3]],
}

impl<'a> Known<'a> {
    /// The plane `q · p = 1` of a label.
    fn plane(&self, label: u32) -> [f64; 3] {
        let label = label as usize;
        match self.found.moments.get(label) {
            Some(moments) => moments.solve(),
            None => self.parts[label - self.found.moments.len()],
        }
    }

    /// What a label was found to be instead of a plane.
    fn model(&self, label: u32) -> Option<&'a Model> {
        self.found.models.get(label as usize).and_then(Option::as_ref)
    }
}

impl Assembler {
    /// Turns labels (field order, 0 for none) and what was found of them into `result`.
    pub fn assemble(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        (labels, found): (&[u32], Found),
        (rows, columns): (usize, usize),
        result: &mut Segmentation,
        observe: &mut dyn FnMut(Stage),
    ) {
        self.recycle(result);
        (result.rows, result.columns) = (rows, columns);
        self.components.find(labels, (field.lanes, found.moments.len()));
        self.number_regions(field, config, result);
        self.fit_regions(field, config, labels, Known { found: &found, parts: &[] });
        if self.fitted.iter().any(|region| region.doubtful) {
            let mut doubts = std::mem::take(&mut self.doubts);
            doubts.start();
            for _ in 0..PARTINGS {
                if !self.part_doubtful(field, config, (labels, &found), &mut doubts) {
                    break;
                }
                self.spare_reasons
                    .extend(result.rejected.drain(..).map(|rejected| rejected.reason));
                let count = found.moments.len() + doubts.planes.len();
                self.components.find(&doubts.labels, (field.lanes, count));
                self.number_regions(field, config, result);
                let known = Known { found: &found, parts: &doubts.planes };
                self.fit_regions(field, config, &doubts.labels, known);
            }
            self.doubts = doubts;
        }
        self.refuse_guesses(field);
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
            let points = self.components.sizes[component];
            let firsts = self.components.runs(component).map(|run| field.grid_index(run.start));
            // The runs are in order unless the grid is turned.
            let first = if field.transposed { firsts.min() } else { firsts.clone().next() };
            let first = first.expect("a component has at least the run it was started from");
            labelled += points;
            if points >= config.min_points.max(3) {
                self.order.push((first, component));
            } else if points >= REPORTED_POINTS {
                let least = config.min_points.max(3);
                let reason = format_args!("{points} points, fewer than {least}");
                reject(&mut self.spare_reasons, result, points, reason);
            } else {
                specks += 1;
                speck_points += points;
            }
        }
        if specks > 0 {
            let reason =
                format_args!("{specks} regions of fewer than {REPORTED_POINTS} points each");
            reject(&mut self.spare_reasons, result, speck_points, reason);
        }
        let valid = field.returns();
        if valid > labelled {
            let reason = format_args!("single points that no surface beside them explains");
            reject(&mut self.spare_reasons, result, valid - labelled, reason);
        }
        self.order.sort_unstable();
        if self.order.len() > usize::from(u16::MAX) {
            for &(_, component) in &self.order[usize::from(u16::MAX)..] {
                let points = self.components.sizes[component];
                let reason = format_args!("more regions than 16-bit labels");
                reject(&mut self.spare_reasons, result, points, reason);
            }
            self.order.truncate(usize::from(u16::MAX));
        }
    }

    fn fit_regions(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        labels: &[u32],
        known: Known,
    ) {
        self.leave_borders_out(field);
        // What was fitted before the last parting and is none of the parted comes again as it was.
        let mut before =
            std::mem::replace(&mut self.fitted, std::mem::take(&mut self.spare_fitted));
        let mut known_regions = before.drain(..).peekable();
        for k in 0..self.order.len() {
            let (first, component) = self.order[k];
            let cells = self.components.sizes[component];
            while known_regions.next_if(|region| region.first < first).is_some() {}
            let same =
                known_regions.next_if(|region| (region.first, region.cells) == (first, cells));
            let region = match same {
                // That it could not be parted is known.
                Some(same) => FittedRegion { component, doubtful: false, ..same },
                None => {
                    let label = labels[self.middle(component)];
                    let (q, model) = (known.plane(label), known.model(label));
                    self.fit_region(field, (first, component), config, q, model)
                }
            };
            self.fitted.push(region);
        }
        drop(known_regions);
        self.spare_fitted = before;
    }

    /// Parts the planes that do not explain all of their readings; returns whether there were any that
    /// could be parted.
    fn part_doubtful(
        &mut self,
        field: &Field,
        config: &SegmentationConfig,
        (labels, found): (&[u32], &Found),
        doubts: &mut Doubts,
    ) -> bool {
        let mut parted = false;
        let known = (labels, found.moments.len(), config.min_points.max(3));
        for FittedRegion { component, shape, doubtful, .. } in &self.fitted {
            if let (true, Fitted::Plane(plane)) = (doubtful, shape) {
                let (normal, offset_m) = plane.equation();
                let q = (normal / offset_m).into();
                if doubts.part(field, &self.components, *component, q, known) {
                    parted = true;
                }
            }
        }
        parted
    }

    /// A cell in the middle of a component.
    fn middle(&self, component: usize) -> usize {
        let run = self.components.middle_run(component);
        usize::midpoint(run.start, run.end)
    }

    /// The shape and the centroid of a component, with its first cell in the grid, whose plane is about
    /// `q · p = 1`; `model` is what it was found to be instead.
    fn fit_region(
        &mut self,
        field: &Field,
        (first, component): (usize, usize),
        config: &SegmentationConfig,
        q: [f64; 3],
        model: Option<&Model>,
    ) -> FittedRegion {
        let cells = self.components.sizes[component];
        let sums = self.sum_up(field, component, q);
        let error = sums.totals[SUMMED_ERROR];
        let fitted = |shape: Fitted, sums: &PlaneSums| {
            // Readings that are worth one each.
            let n = (cells as f64 / field.errors.patch).max(1.0);
            let excess = DOUBTED_EXCESS.max(4.0 * (2.0 / n).sqrt());
            let doubtful = sums.totals[SUMMED_SQUARE] > cells as f64 * (1.0 + excess);
            let centroid = centroid_of(sums);
            let unevenness = None;
            FittedRegion {
                component,
                first,
                cells,
                shape,
                centroid,
                square_m2: None,
                doubtful,
                unevenness,
            }
        };
        if let Some(plane) = plane_of(&sums)
            && is_flat(error, cells, &plane, &config.limits, &field.errors)
        {
            let unevenness = self.unevenness(field, &plane);
            return FittedRegion { unevenness, ..fitted(Fitted::Plane(plane), &sums) };
        }
        if let Some(model) = model {
            let columns = Columns::of(field, &self.fit_gain);
            self.readings.gather_runs(columns, &field.range, self.components.runs(component));
            let (limits, errors) = (&config.limits, &field.errors);
            if let Some(shape) = settle_known(&self.readings, model, limits, errors, error) {
                let square_m2 = mean_square_distance(&self.readings, &shape);
                return FittedRegion { square_m2, ..fitted(shape, &sums) };
            }
        }
        match self.choose_shape(field, component, config) {
            Fitted::Plane(plane) => {
                // The readings' own plane is the better start.
                let (normal, offset_m) = plane.equation();
                let sums = self.sum_up(field, component, (normal / offset_m).into());
                let plane = plane_of(&sums);
                let unevenness = plane.as_ref().and_then(|plane| self.unevenness(field, plane));
                let shape = plane.map_or(Fitted::Other, Fitted::Plane);
                FittedRegion { unevenness, ..fitted(shape, &sums) }
            }
            shape => {
                let square_m2 = mean_square_distance(&self.readings, &shape);
                FittedRegion { square_m2, ..fitted(shape, &sums) }
            }
        }
    }

    /// Takes the gains of the cells at borders to other regions away: which region they belong to
    /// was decided by their error, so they would bias a fit. Small regions keep theirs.
    fn leave_borders_out(&mut self, field: &Field) {
        let components = &self.components;
        self.fit_gain.resize(field.len(), 0.0);
        let (borders, fit_gain) = (components.borders(), &mut self.fit_gain[..]);
        Arch::new().dispatch(LeaveOut { borders, gain: &field.gain, fit_gain });
        for (component, &all) in components.sizes.iter().enumerate() {
            let core = all - components.border_cells[component];
            if core < FEWEST_CORE || (core as f64) < LEAST_CORE_SHARE * all as f64 {
                for run in components.runs(component) {
                    self.fit_gain[run.clone()].copy_from_slice(&field.gain[run]);
                }
            }
        }
    }

    /// The sums of a component, about the plane `q · p = 1`.
    fn sum_up(&mut self, field: &Field, component: usize, q: [f64; 3]) -> PlaneSums {
        let cell = self.middle(component);
        let reference = Reference::new(q, field.point(cell));
        let columns = Columns::of(field, &self.fit_gain);
        let runs = (self.components.runs(component), field.lanes);
        self.blocks.sum_up(reference, columns, runs, &mut self.packed)
    }

    /// How uneven the component is that was summed up last, and whose plane was found.
    fn unevenness(&self, field: &Field, plane: &PlaneFit) -> Option<Unevenness> {
        let frame = &plane.grid_from_plane;
        self.blocks.unevenness(frame, &common(field, frame, noise_across(field, frame)))
    }

    /// The shape of a component that the plane of its label does not explain.
    ///
    /// A part of the cells, evenly taken, tells which shape it is; only a curved one is then fitted
    /// to all of them.
    fn choose_shape(
        &mut self,
        field: &Field,
        component: usize,
        config: &SegmentationConfig,
    ) -> Fitted {
        let cells = self.components.cells(component);
        let count = self.components.sizes[component];
        let belongs = |cell: usize| self.components.of(cell) == Some(component);
        let axes = candidate_axes(field, cells.clone(), count, belongs);
        let stride = count.div_ceil(TRIAL_CELLS).max(1);
        let columns = Columns::of(field, &self.fit_gain);
        self.readings.gather(columns, &field.range, cells.step_by(stride));
        let (chosen, _) = choose(&mut self.readings, &axes, &config.limits, &field.errors);
        if matches!(chosen, Fitted::Plane(_)) {
            return chosen;
        }
        if stride > 1 {
            self.readings.gather_runs(columns, &field.range, self.components.runs(component));
        }
        settle(&self.readings, chosen, &config.limits, &field.errors).unwrap_or_else(|| {
            fit_plane(&mut self.readings).map_or(Fitted::Other, |(plane, _)| Fitted::Plane(plane))
        })
    }

    /// Takes planes through two beams for none, unless they lie on one that was seen better: what is two
    /// beams wide may as well be a column. Two rows of a floor are kept; what their tilts may be off by goes
    /// along with them.
    fn refuse_guesses(&mut self, field: &Field) {
        self.planes.clear();
        self.guesses.clear();
        for (k, FittedRegion { component, shape, .. }) in self.fitted.iter().enumerate() {
            let Fitted::Plane(plane) = shape else { continue };
            let beyond = self.components.beyond_two_beams(*component, field.transposed) as f64;
            if beyond < BEYOND_TWO_BEAMS * self.components.sizes[*component] as f64 {
                self.guesses.push(k);
            } else {
                let (normal, offset_m) = plane.equation();
                self.planes.push((normal / offset_m).into());
            }
        }
        for &k in &self.guesses {
            let component = self.fitted[k].component;
            let most = SAME_PLANE as f32 * self.components.sizes[component] as f32;
            // On most planes a few of the readings err by more than all of them may.
            let lies_on = |q: &[f64; 3]| {
                let mut error = 0.0;
                self.components.cells(component).all(|cell| {
                    error += square(field, q, cell).min((CAP * CAP) as f32);
                    error < most
                })
            };
            if !self.planes.iter().any(lies_on) {
                self.fitted[k].shape = Fitted::Other;
            }
        }
    }

    fn write_surfaces(&mut self, field: &Field, result: &mut Segmentation) {
        // Readings that err alike tell less than their number says.
        let inflation = field.errors.inflation;
        self.uneven.start();
        for (index, region) in self.fitted.drain(..).enumerate() {
            let FittedRegion { component, shape, centroid, square_m2, unevenness, .. } = region;
            let cells = self.components.cells(component);
            let count = self.components.sizes[component];
            let (shape, square) = match shape {
                Fitted::Plane(plane) => {
                    let PlaneFit { grid_from_plane, covariance, square_m2, .. } = plane;
                    let fresh = || Vec::with_capacity(HULL_VERTICES);
                    let mut hull = self.spare_hulls.pop().unwrap_or_else(fresh);
                    let points = [&field.x[..], &field.y, &field.z];
                    let runs = self.components.runs(component);
                    let width = field.lanes;
                    self.hull.find_in_runs(points, width, runs, &grid_from_plane, &mut hull);
                    if square_m2 > (THICKEST * across_m(&hull)).powi(2) {
                        self.spare_hulls.push(hull);
                        (Shape::Other, Some(square_m2))
                    } else {
                        let covariance = covariance * inflation;
                        let noise_m = noise_across(field, &grid_from_plane);
                        self.uneven.add(index, unevenness);
                        let plane = PlanePatch { grid_from_plane, covariance, hull, noise_m };
                        (Shape::Plane(plane), Some(square_m2))
                    }
                }
                Fitted::Sphere { centre, radius_m, covariance } => {
                    let covariance = covariance * inflation;
                    (Shape::Sphere(Sphere { centre, radius_m, covariance }), square_m2)
                }
                Fitted::Cylinder { axis_point, axis, radius_m, length_m, covariance } => {
                    let covariance = covariance * inflation;
                    let shape = Cylinder { axis_point, axis, radius_m, length_m, covariance };
                    (Shape::Cylinder(shape), square_m2)
                }
                Fitted::Other => {
                    // From the plane across the line of sight through the centroid.
                    let (normal, offset_m) = (centroid.normalize(), centroid.norm());
                    let points = cells.map(|cell| Vector3::from(field.point(cell)));
                    let squares = points.map(|p| (normal.dot(&p) - offset_m).powi(2));
                    (Shape::Other, Some(squares.sum::<f64>() / count as f64))
                }
            };
            result.surfaces.push(Surface {
                id: index as u16 + 1,
                points: count,
                rms_m: square.unwrap_or(0.0).max(0.0).sqrt(),
                centroid: Point3::from(centroid),
                shape,
            });
        }
        self.uneven.tell(&mut result.surfaces);
    }

    fn write_labels(&mut self, field: &Field, result: &mut Segmentation) {
        self.ids.clear();
        self.ids.resize(self.components.len(), 0);
        for (index, &(_, component)) in self.order.iter().enumerate() {
            self.ids[component] = index as u16 + 1;
        }
        let labels = &mut result.labels;
        labels.resize(field.len(), 0);
        if field.transposed {
            labels.fill(0);
            for (run, component) in self.components.all_runs() {
                run.for_each(|cell| labels[field.grid_index(cell)] = self.ids[component]);
            }
            return;
        }
        let mut end = 0;
        for (run, component) in self.components.all_runs() {
            fill_ahead(labels, end..run.start, 0);
            end = run.end;
            fill_ahead(labels, run, self.ids[component]);
        }
        labels[end..].fill(0);
    }
}

/// Takes over the gains of cells that are at no border, and none of the others.
struct LeaveOut<'a> {
    borders: &'a [u8],
    gain: &'a [f32],
    fit_gain: &'a mut [f32],
}

impl WithSimd for LeaveOut<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for ((fit_gain, gain), border) in self.fit_gain.iter_mut().zip(self.gain).zip(self.borders)
        {
            *fit_gain = if border & BORDER == 0 { *gain } else { 0.0 };
        }
    }
}

/// Standard deviation across a plane that the noise of the ranges gives a point at its frame's origin.
fn noise_across(field: &Field, grid_from_plane: &Isometry3<f64>) -> f64 {
    let place = grid_from_plane.translation.vector;
    let range_m = place.norm();
    let cosine = (grid_from_plane.rotation * Vector3::z()).dot(&place).abs() / range_m;
    field.errors.noise.sigma_m(range_m) * cosine
}

/// Length of a hull along the longer axis of its frame, in metres.
fn across_m(hull: &[Point2<f64>]) -> f64 {
    let fresh = [f64::INFINITY, f64::NEG_INFINITY];
    let span = |axis: usize| {
        let [low, high] =
            hull.iter().fold(fresh, |[low, high], p| [low.min(p[axis]), high.max(p[axis])]);
        high - low
    };
    if hull.is_empty() { 0.0 } else { span(0).max(span(1)) }
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
