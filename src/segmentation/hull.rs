//! Convex hulls of many points in a plane, without allocation.

use nalgebra::{Isometry3, Point2, Vector3};
use std::ops::Range;
use wide::f32x4;

/// Directions in which extreme points are sought, 45° apart; what lies inside their polygon is no
/// vertex.
const DIRECTIONS: usize = 8;
/// What single precision may misplace a point by, relative to its distance.
const SINGLE: f32 = 1e-6;

/// Buffers of the hull.
#[derive(Clone, Debug, Default)]
pub(super) struct HullFinder {
    outer: Vec<[f64; 2]>,
    ends: Vec<[f64; 2]>,
    candidates: Vec<[f64; 2]>,
}

fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn distance_squared(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).powi(2) + (b[1] - a[1]).powi(2)
}

impl HullFinder {
    /// The convex hull of `points`, counter-clockwise from the lowest (then leftmost) point, as
    /// [`convex_hull`](crate::geometry::convex_hull) gives it; empty where there is none.
    ///
    /// Jarvis's march costs O(n h), so the points that cannot be vertices are dropped first: those
    /// strictly inside the polygon of the extreme points in eight directions, which is all but a few
    /// per cent of a filled region.
    pub fn find(&mut self, points: &[[f64; 2]], hull: &mut Vec<Point2<f64>>) {
        hull.clear();
        self.keep_outer(points);
        let candidates = &mut self.candidates;
        candidates.sort_unstable_by(|a, b| a[1].total_cmp(&b[1]).then(a[0].total_cmp(&b[0])));
        candidates.dedup();
        if candidates.len() < 3 {
            return;
        }
        let mut current = 0;
        // Rounding can hide the start from the march; n steps end it.
        for _ in 0..candidates.len() {
            let here = candidates[current];
            hull.push(Point2::new(here[0], here[1]));
            let mut next = usize::from(current == 0);
            for (i, &point) in candidates.iter().enumerate() {
                if i == current || i == next {
                    continue;
                }
                let turn = cross(here, candidates[next], point);
                let farther =
                    || distance_squared(here, point) > distance_squared(here, candidates[next]);
                if turn < 0.0 || (turn == 0.0 && farther()) {
                    next = i;
                }
            }
            current = next;
            if current == 0 {
                break;
            }
        }
        if hull.len() < 3 || crate::geometry::polygon_area(hull) <= 0.0 {
            hull.clear();
        }
    }

    /// The convex hull, in the frame of a plane, of the points of runs of cells.
    ///
    /// The ends of the runs are nearly all of the outline: what is inside the polygon of their
    /// extremes is sorted out four points at a time.
    pub fn find_in_runs(
        &mut self,
        [x, y, z]: [&[f32]; 3],
        runs: impl Iterator<Item = Range<usize>> + Clone,
        grid_from_plane: &Isometry3<f64>,
        hull: &mut Vec<Point2<f64>>,
    ) {
        let rotation = grid_from_plane.rotation.to_rotation_matrix().into_inner();
        let origin = grid_from_plane.translation.vector;
        let flat = |cell: usize| {
            let d = Vector3::new(x[cell], y[cell], z[cell]).cast::<f64>() - origin;
            [rotation.column(0).dot(&d), rotation.column(1).dot(&d)]
        };
        self.ends.clear();
        for run in runs.clone() {
            self.ends.extend([flat(run.start), flat(run.end - 1)]);
        }
        let inner = Inner::of(&Extremes::of(self.ends.iter()), origin.norm() as f32);
        let [ex, ey] = [0, 1].map(|i| rotation.column(i).into_owned().cast::<f32>());
        let places = [ex, ey].map(|e| (e, e.dot(&origin.cast::<f32>())));
        let mut outer = std::mem::take(&mut self.outer);
        outer.clear();
        for run in runs {
            if run.len() < 4 {
                outer.extend(run.map(flat));
                continue;
            }
            // The last four may be some that were looked at already, which changes no hull.
            let last = run.end - 4;
            for first in run.step_by(4).map(|first| first.min(last)) {
                let [x, y, z] = [x, y, z].map(|values| f32x4::from(&values[first..first + 4]));
                let at = places.map(|(e, o)| {
                    x * f32x4::splat(e.x) + y * f32x4::splat(e.y) + z * f32x4::splat(e.z)
                        - f32x4::splat(o)
                });
                let outside = inner.outside(at);
                if outside != 0 {
                    outer.extend(
                        (0..4).filter(|i| outside & (1 << i) != 0).map(|i| flat(first + i)),
                    );
                }
            }
        }
        self.find(&outer, hull);
        self.outer = outer;
    }

    /// Copies the points that may be vertices.
    fn keep_outer(&mut self, points: &[[f64; 2]]) {
        let extremes = Extremes::of(points.iter());
        self.candidates.clear();
        self.candidates.extend(points.iter().filter(|point| extremes.may_be_vertex(**point)));
        self.keep_beyond_chords(&extremes);
    }

    /// Takes those candidates out that are inside the triangles that the farthest candidate beyond
    /// each edge of the extremes' polygon makes with it.
    fn keep_beyond_chords(&mut self, extremes: &Extremes) {
        let edges: [_; DIRECTIONS] =
            std::array::from_fn(|k| (extremes.points[k], extremes.points[(k + 1) % DIRECTIONS]));
        let mut tops = edges.map(|(a, _)| (0.0, a));
        for &point in &self.candidates {
            for (top, (a, b)) in tops.iter_mut().zip(edges) {
                let beyond = -cross(a, b, point);
                if beyond > top.0 {
                    *top = (beyond, point);
                }
            }
        }
        self.candidates.retain(|&point| {
            !edges.iter().zip(&tops).any(|(&(a, b), &(height, top))| {
                // Strictly inside, so that no vertex goes.
                height > 0.0
                    && cross(a, b, point) < 0.0
                    && cross(a, top, point) > 0.0
                    && cross(top, b, point) > 0.0
            })
        });
    }
}

/// The inside of the polygon of extremes, for single precision: what it holds is surely inside.
struct Inner {
    /// The rectangle's low and high x, then y.
    rectangle: [f32; 4],
    /// Distances `n · p + c` from the edges, as n and c.
    edges: [[f32; 3]; DIRECTIONS],
}

impl Inner {
    /// `distance_m` is about how far the points are away.
    fn of(extremes: &Extremes, distance_m: f32) -> Self {
        let (low, high) = (extremes.low, extremes.high);
        let size = (extremes.points[0][0] - extremes.points[4][0]) as f32;
        let margin = SINGLE * (distance_m + 4.0 * size);
        // An edge of no length bounds nothing, but then without any edge nothing would be outside.
        let nothing = extremes.points.iter().all(|point| *point == extremes.points[0]);
        let free = if nothing { -1.0 } else { 1.0 };
        let edges = std::array::from_fn(|k| {
            let (a, b) = (extremes.points[k], extremes.points[(k + 1) % DIRECTIONS]);
            let length = distance_squared(a, b).sqrt();
            if length == 0.0 {
                return [0.0, 0.0, free];
            }
            let (nx, ny) = ((a[1] - b[1]) / length, (b[0] - a[0]) / length);
            [nx as f32, ny as f32, -(nx * a[0] + ny * a[1]) as f32 - margin]
        });
        let rectangle = [
            low[0] as f32 + margin,
            high[0] as f32 - margin,
            low[1] as f32 + margin,
            high[1] as f32 - margin,
        ];
        Self { rectangle, edges }
    }

    /// A bit for each of four points that may be outside.
    #[inline]
    fn outside(&self, [x, y]: [f32x4; 2]) -> u32 {
        let [left, right, low, high] = self.rectangle.map(f32x4::splat);
        let within = x.simd_gt(left) & x.simd_lt(right) & y.simd_gt(low) & y.simd_lt(high);
        if within.all() {
            return 0;
        }
        let mut least = f32x4::ONE;
        for [nx, ny, c] in self.edges.map(|edge| edge.map(f32x4::splat)) {
            least = least.fast_min(nx * x + ny * y + c);
        }
        !least.simd_gt(f32x4::ZERO).to_bitmask() & 0xf
    }
}

/// The points farthest in eight directions, counter-clockwise.
struct Extremes {
    points: [[f64; 2]; DIRECTIONS],
    /// A rectangle whose inside is inside the polygon of the points.
    low: [f64; 2],
    high: [f64; 2],
}

impl Extremes {
    fn of<'a>(points: impl Iterator<Item = &'a [f64; 2]>) -> Self {
        let mut extremes = [[0.0; 2]; DIRECTIONS];
        let mut reach = [f64::NEG_INFINITY; DIRECTIONS];
        for point in points {
            let [x, y] = *point;
            let (sum, difference) = (x + y, y - x);
            let along = [x, sum, y, difference, -x, -sum, -y, -difference];
            for k in 0..DIRECTIONS {
                if along[k] > reach[k] {
                    reach[k] = along[k];
                    extremes[k] = *point;
                }
            }
        }
        // A point with one of the four diagonal extremes in each quadrant about it is inside their
        // quadrilateral: that holds in a whole rectangle.
        let [_, a, _, b, _, c, _, d] = extremes;
        let low = [b[0].max(c[0]), c[1].max(d[1])];
        let high = [a[0].min(d[0]), a[1].min(b[1])];
        Self { points: extremes, low, high }
    }

    fn surely_contains(&self, [x, y]: [f64; 2]) -> bool {
        (self.low[0] < x) & (x < self.high[0]) & (self.low[1] < y) & (y < self.high[1])
    }

    /// Whether a point is not strictly inside the polygon: left of all its edges.
    fn may_be_vertex(&self, point: [f64; 2]) -> bool {
        !self.surely_contains(point)
            && point.iter().all(|v| v.is_finite())
            && (0..DIRECTIONS).any(|k| {
                let (a, b) = (self.points[k], self.points[(k + 1) % DIRECTIONS]);
                a != b && cross(a, b, point) <= 0.0
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::convex_hull;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_hull_is_that_of_geometry(
            raw in prop::collection::vec((-50.0..50.0, -50.0..50.0), 0..200),
            flat in any::<bool>(),
        ) {
            let points: Vec<[f64; 2]> =
                raw.iter().map(|&(x, y)| [x, if flat { 0.5 * x } else { y }]).collect();
            let mut hull = Vec::new();
            HullFinder::default().find(&points, &mut hull);
            let all: Vec<Point2<f64>> = points.iter().map(|p| Point2::new(p[0], p[1])).collect();
            prop_assert_eq!(hull, convex_hull(&all));
        }
    }

    #[test]
    fn few_or_equal_points_have_no_hull() {
        let mut hull = Vec::new();
        for points in [vec![], vec![[1.0, 1.0]; 9], vec![[0.0, 0.0], [1.0, 2.0]]] {
            HullFinder::default().find(&points, &mut hull);
            assert!(hull.is_empty());
        }
    }
}
