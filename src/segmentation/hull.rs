//! Convex hulls of many points in a plane, without allocation.

use nalgebra::Point2;

/// Directions in which extreme points are sought, 45° apart; what lies inside their polygon is no
/// vertex.
const DIRECTIONS: usize = 8;
/// Step through the points for a first guess at what is inside.
const ROUGH_STEP: usize = 8;

/// Buffers of the hull.
#[derive(Clone, Debug, Default)]
pub(super) struct HullFinder {
    outer: Vec<[f64; 2]>,
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

    /// Copies the points that may be vertices.
    fn keep_outer(&mut self, points: &[[f64; 2]]) {
        // A part of the points is enough to spare most of the others any more work.
        let rough = Extremes::of(points.iter().step_by(ROUGH_STEP));
        self.outer.clear();
        // Equal points make no polygon that others could be inside of.
        let one = rough.points.iter().all(|point| *point == rough.points[0]);
        self.outer.extend(points.iter().filter(|point| one || rough.may_be_vertex(**point)));
        let extremes = Extremes::of(self.outer.iter());
        self.candidates.clear();
        self.candidates
            .extend(self.outer.iter().filter(|point| extremes.may_be_vertex(**point)).copied());
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
