//! What uneven surfaces mean for the planes of a scan.

use super::field::Field;
use super::fit::{Common, Unevenness};
use super::surface::{PlanePatch, Shape, Surface};
use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, RowVector2, Vector2, Vector3};

/// Variance of a trend over a patch, slope² times extent² / 12, in units of the unevenness.
///
/// Means over a sixth, a quarter and half of the sides of a patch were found to scatter alike, on floors
/// and walls from 0.1 to 2 m across (a nodding SICK scan): waves of all lengths are as high. So what is as
/// long as the patch itself, and which the fit takes for its offset and its tilts, is as high again.
const TREND: f64 = 1.0;
/// Standard deviation of a rotation that says nothing, in radians.
const FREE_RAD: f64 = 1.0;
/// How far off another look at a bent surface may find its patch, in extents of this one.
const BENT_REACH: f64 = 0.5;
/// The same in turns from one piece of an uneven surface to the next: pieces lie where the sensor is, not where
/// anything ends, so that those of two scans look like some that moved along with it.
const PIECES_REACH: f64 = 2.0;
/// Cosine of the turn between two patches beside each other up to which they are pieces of one uneven surface,
/// parted where noise had it: 2.5°.
const PIECES_COSINE: f64 = 0.999;
/// Gap between them in metres.
const PIECES_GAP_M: f64 = 0.15;
/// Squared Mahalanobis distance from which on they are not of one plane.
const PIECES_DIFFER: f64 = 16.0;
/// Step from one to the other from which on something ends there: metres, share of the smaller one's extent
/// times the turn, as facets of a bend lie to one another, and deviations of what surfaces wave by here.
const PIECES_STEP_M: f64 = 0.005;
const PIECES_STEP_SHARE: f64 = 0.25;
const PIECES_STEP_SIGMAS: f64 = 4.0;

/// How uneven the planes of a scan are. The buffers are kept from scan to scan.
#[derive(Clone, Debug, Default)]
pub(super) struct UnevenPlanes {
    /// Place among the surfaces, and what blocks tell.
    planes: Vec<(usize, Option<Unevenness>)>,
    /// Unevenness and cells of planes.
    known: Vec<(f64, usize)>,
    bounds: Vec<Bounds>,
    /// Surfaces with the rotations about y and x, and the step, to a piece beside each.
    pieces: Vec<(usize, Vector2<f64>, f64)>,
}

/// A sphere about a patch's origin in which it lies, its normal, and its place among the surfaces.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    index: usize,
    centre: Vector3<f64>,
    radius_m: f64,
    normal: Vector3<f64>,
}

impl Bounds {
    fn of(surfaces: &[Surface], index: usize) -> Option<Self> {
        let Shape::Plane(patch) = &surfaces[index].shape else { return None };
        let radius_m = patch.hull.iter().map(|vertex| vertex.coords.norm()).fold(0.0, f64::max);
        let Isometry3 { rotation, translation } = patch.grid_from_plane;
        let normal = rotation * Vector3::z();
        Some(Self { index, centre: translation.vector, radius_m, normal })
    }
}

impl UnevenPlanes {
    /// Forgets an earlier scan.
    pub fn start(&mut self) {
        self.planes.clear();
    }

    /// Adds what blocks tell of the plane that will be the surface at `index`, if they tell anything.
    pub fn add(&mut self, index: usize, found: Option<Unevenness>) {
        self.planes.push((index, found));
    }

    /// Adds to the planes' covariances what another look at another part of the same surface may differ
    /// by. What too few readings tell for themselves is taken from what is usual in the scan.
    pub fn tell(&mut self, surfaces: &mut [Surface]) {
        let usual_m2 = self.usual_m2(surfaces);
        self.compare_pieces(surfaces, usual_m2.max(0.0).sqrt());
        for (index, found) in &self.planes {
            let square_m2 = found.map_or(usual_m2, |found| found.told_m2(usual_m2));
            let Shape::Plane(patch) = &mut surfaces[*index].shape else { continue };
            if square_m2 > 0.0 {
                add(patch, square_m2);
            }
            if let Some(found) = found.filter(|found| found.bend != Matrix2::zeros()) {
                add_bend(patch, &found.bend);
            }
        }
        for &(index, turn_rad, step_m) in &self.pieces {
            if let Shape::Plane(patch) = &mut surfaces[index].shape {
                add_turn(patch, &turn_rad, step_m);
            }
        }
    }

    /// Lists the patches that go on in others that are nearly but not quite of their plane.
    fn compare_pieces(&mut self, surfaces: &[Surface], usual_m: f64) {
        let Self { planes, bounds, pieces, .. } = self;
        pieces.clear();
        bounds.clear();
        bounds.extend(planes.iter().filter_map(|&(index, _)| Bounds::of(surfaces, index)));
        // Pieces have boxes that far apart at most in the plane of one, and are tilted by little.
        let apart_m = 2.0 * PIECES_GAP_M + PIECES_STEP_M + PIECES_STEP_SIGMAS * usual_m;
        for (at, own) in bounds.iter().enumerate() {
            for other in &bounds[at + 1..] {
                let reach_m = 2.0 * (own.radius_m + other.radius_m) + apart_m;
                if own.normal.dot(&other.normal) < PIECES_COSINE
                    || (own.centre - other.centre).norm_squared() > reach_m * reach_m
                {
                    continue;
                }
                for [own, other] in [[own.index, other.index], [other.index, own.index]] {
                    let (Shape::Plane(patch), Shape::Plane(beside)) =
                        (&surfaces[own].shape, &surfaces[other].shape)
                    else {
                        continue;
                    };
                    if let Some((turn_rad, step_m)) = piece_beside(patch, beside, usual_m) {
                        pieces.push((own, turn_rad, step_m));
                    }
                }
            }
        }
    }

    /// What the smoother half of the cells lies on: none, in a world of even surfaces.
    fn usual_m2(&mut self, surfaces: &[Surface]) -> f64 {
        self.known.clear();
        self.known.extend(self.planes.iter().filter_map(|(index, found)| {
            let found = found.as_ref()?;
            let sure_m2 = if found.is_sure { found.excess_m2.max(0.0) } else { 0.0 };
            Some((sure_m2, surfaces[*index].points))
        }));
        self.known.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let all: usize = self.known.iter().map(|known| known.1).sum();
        let mut below = 0;
        let middle = self.known.iter().find(|known| {
            below += known.1;
            2 * below >= all
        });
        middle.map_or(0.0, |known| known.0)
    }
}

/// What the readings on a plane have in common, a point of which errs across by `noise_m`.
pub(super) fn common(field: &Field, grid_from_plane: &Isometry3<f64>, noise_m: f64) -> Common {
    Common {
        patch: field.errors.patch,
        row_share: row_share(field, grid_from_plane, noise_m),
        rows_are_lanes: field.transposed,
    }
}

/// Least and greatest coordinate of a patch along an axis of its frame.
fn ends_m(patch: &PlanePatch, axis: usize) -> (f64, f64) {
    let fresh = (f64::INFINITY, f64::NEG_INFINITY);
    let vertices = patch.hull.iter();
    vertices.fold(fresh, |(low, high), vertex| (low.min(vertex[axis]), high.max(vertex[axis])))
}

fn spans_m(patch: &PlanePatch) -> Vector2<f64> {
    Vector2::from_fn(|axis, _| {
        let (low, high) = ends_m(patch, axis);
        (high - low).max(f64::MIN_POSITIVE)
    })
}

fn add(patch: &mut PlanePatch, square_m2: f64) {
    let spans_m = spans_m(patch);
    let tilt = |axis: usize| {
        let span_m: f64 = spans_m[axis];
        (12.0 * TREND * square_m2 / (span_m * span_m)).min(FREE_RAD * FREE_RAD)
    };
    patch.covariance[(0, 0)] += square_m2;
    patch.covariance[(1, 1)] += tilt(0);
    patch.covariance[(2, 2)] += tilt(1);
}

/// Adds what a look at another part of a bent surface differs by.
fn add_bend(patch: &mut PlanePatch, bend: &Matrix2<f64>) {
    let off_m = BENT_REACH * spans_m(patch);
    let turns = bend * Matrix2::from_diagonal(&off_m);
    let turns = turns * turns.transpose();
    let rise_m = 0.5 * off_m.dot(&(bend.abs() * off_m));
    add_turns(patch, &turns, rise_m);
}

/// Adds what a piece beside a patch, that much turned and stepped, tells of the next one.
fn add_turn(patch: &mut PlanePatch, turn_rad: &Vector2<f64>, step_m: f64) {
    let turn_rad = PIECES_REACH * turn_rad;
    let turns = Matrix2::from_diagonal(&turn_rad.component_mul(&turn_rad));
    let rise_m = step_m + 0.5 * turn_rad.abs().dot(&spans_m(patch));
    add_turns(patch, &turns, rise_m);
}

fn add_turns(patch: &mut PlanePatch, turns: &Matrix2<f64>, rise_m: f64) {
    patch.covariance[(0, 0)] += rise_m * rise_m;
    let mut tilts = patch.covariance.fixed_view_mut::<2, 2>(1, 1);
    let most = turns.trace() / (FREE_RAD * FREE_RAD);
    tilts += turns / most.max(1.0);
}

/// The rotations about y and x from a patch to one beside it, and the step between both where they meet;
/// `None` where they are apart, or may be of one plane. Surfaces wave by `usual_m` here.
fn piece_beside(
    patch: &PlanePatch,
    beside: &PlanePatch,
    usual_m: f64,
) -> Option<(Vector2<f64>, f64)> {
    let plane_from_beside = patch.grid_from_plane.inverse() * beside.grid_from_plane;
    let fresh = [f64::INFINITY, f64::NEG_INFINITY];
    let (mut others, mut step_m, mut nearest_m) = ([fresh; 2], 0.0, f64::INFINITY);
    let ends_m = [ends_m(patch, 0), ends_m(patch, 1)];
    let beyond = |p: f64, (low, high): (f64, f64)| (low - p).max(p - high).max(0.0);
    for vertex in &beside.hull {
        let p = plane_from_beside * Point3::new(vertex.x, vertex.y, 0.0);
        let off_m = beyond(p.x, ends_m[0]).hypot(beyond(p.y, ends_m[1]));
        if off_m < nearest_m {
            (nearest_m, step_m) = (off_m, p.z);
        }
        for (axis, [low, high]) in others.iter_mut().enumerate() {
            (*low, *high) = (low.min(p[axis]), high.max(p[axis]));
        }
    }
    let gap_m =
        |axis: usize| (others[axis][0] - ends_m[axis].1).max(ends_m[axis].0 - others[axis][1]);
    if gap_m(0).max(gap_m(1)) > PIECES_GAP_M {
        return None;
    }
    // The other's plane as a perturbation of this frame: its height over the origin, and its tilts.
    let normal = plane_from_beside.rotation * Vector3::z();
    let turn_rad = Vector2::new(normal.x, -normal.y) / normal.z;
    let extent_m = spans_m(patch).max().min(spans_m(beside).max());
    let bend_m = PIECES_STEP_SHARE * extent_m * turn_rad.norm();
    if step_m.abs() > PIECES_STEP_M + bend_m + PIECES_STEP_SIGMAS * usual_m {
        return None;
    }
    let origin = plane_from_beside.translation.vector;
    let offset_m = origin.dot(&normal) / normal.z;
    let difference = Vector3::new(offset_m, turn_rad.x, turn_rad.y);
    // The other's perturbation as one of this frame: a tilt of its own moves it at this origin, too.
    let signs = Matrix2::new(1.0, 0.0, 0.0, -1.0);
    let turned = plane_from_beside.rotation.to_rotation_matrix();
    let mut from_beside = Matrix3::identity();
    let turns = signs * turned.matrix().fixed_view::<2, 2>(0, 0) * signs;
    from_beside.fixed_view_mut::<2, 2>(1, 1).copy_from(&turns);
    let mut to_origin = Matrix3::identity();
    to_origin.fixed_view_mut::<1, 2>(0, 1).copy_from(&RowVector2::new(origin.x, -origin.y));
    let from_beside = to_origin * from_beside;
    let spread = patch.covariance + from_beside * beside.covariance * from_beside.transpose();
    let square = difference.dot(&spread.cholesky()?.solve(&difference));
    (square > PIECES_DIFFER).then_some((turn_rad, step_m.abs()))
}

/// Share of the variance across a plane that the errors of the grid's rows, as far as they are known, have
/// in a point at its frame's origin, where the noise of the ranges gives it `noise_m`.
fn row_share(field: &Field, grid_from_plane: &Isometry3<f64>, noise_m: f64) -> f64 {
    let largest = field.row_sigmas_rad.iter().copied().fold(0.0, f32::max);
    let normal = grid_from_plane.rotation * Vector3::z();
    let lever_m = Vector3::y().cross(&grid_from_plane.translation.vector).dot(&normal);
    let row_m2 = (lever_m * f64::from(largest)).powi(2);
    row_m2 / (row_m2 + noise_m * noise_m).max(f64::MIN_POSITIVE)
}
