//! Convex hulls of many points in a plane, without allocation.

use super::outermost::{Flat, Outermost};
use nalgebra::{Isometry3, Point2, Vector3};
use std::ops::Range;

/// Buffers of the hull.
#[derive(Clone, Debug, Default)]
pub(super) struct HullFinder {
    /// Cells at the ends of rows and columns, and of these the ones that may be vertices.
    ends: Vec<u32>,
    outermost: Outermost,
    candidates: Vec<[f64; 2]>,
}

fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// Continues a hull that turns left at all points but the first so many.
fn climb(points: impl Iterator<Item = [f64; 2]>, hull: &mut Vec<Point2<f64>>, kept: usize) {
    for point in points {
        while let [.., a, b] = hull[kept..]
            && cross([a.x, a.y], [b.x, b.y], point) <= 0.0
        {
            hull.pop();
        }
        hull.push(point.into());
    }
}

fn narrow(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

impl HullFinder {
    /// The convex hull of `points`, counter-clockwise from the lowest (then leftmost) point, as
    /// [`convex_hull`](crate::geometry::convex_hull) gives it; empty where there is none.
    ///
    /// Sorting costs the most, so the points that cannot be vertices are dropped first: those
    /// strictly inside a polygon of others, which is all but a few per cent of a filled region.
    #[cfg(test)]
    pub fn find(&mut self, points: &[[f64; 2]], hull: &mut Vec<Point2<f64>>) {
        self.ends.clear();
        self.ends.extend(0..points.len() as u32);
        let columns = points.iter().map(|point| point.map(|value| value as f32));
        self.outermost.keep(columns, &mut self.ends);
        self.candidates.clear();
        self.candidates.extend(self.ends.iter().map(|&point| points[point as usize]));
        self.march(hull);
    }

    /// Andrew's monotone chains around the candidates: up on the right, down on the left.
    fn march(&mut self, hull: &mut Vec<Point2<f64>>) {
        hull.clear();
        let candidates = &mut self.candidates;
        // What is not a number is no vertex.
        candidates.retain(|point| point.iter().all(|value| value.is_finite()));
        candidates.sort_unstable_by(|a, b| a[1].total_cmp(&b[1]).then(a[0].total_cmp(&b[0])));
        candidates.dedup();
        let Some(&lowest) = candidates.first() else { return };
        climb(candidates.iter().copied(), hull, 0);
        let highest = hull.len() - 1;
        climb(candidates.iter().rev().skip(1).copied(), hull, highest);
        // The chain comes down to where it began.
        if hull.last() == Some(&lowest.into()) {
            hull.pop();
        }
        if hull.len() < 3 || crate::geometry::polygon_area(hull) <= 0.0 {
            hull.clear();
        }
    }

    /// The convex hull, in the frame of a plane, of the points of runs of cells, which are in order in
    /// rows of `width`.
    ///
    /// A ray between others meets a plane between the points where these do: a cell with others of the
    /// region on all four sides is no vertex, but for its noise. So the ends of the rows and of the
    /// columns are all that is looked at.
    pub fn find_in_runs(
        &mut self,
        [x, y, z]: [&[f32]; 3],
        width: usize,
        runs: impl DoubleEndedIterator<Item = Range<usize>> + Clone,
        grid_from_plane: &Isometry3<f64>,
        hull: &mut Vec<Point2<f64>>,
    ) {
        self.find_ends(width, runs);
        let rotation = grid_from_plane.rotation.to_rotation_matrix().into_inner();
        let origin = grid_from_plane.translation.vector;
        let (ex, ey) = (rotation.column(0).into_owned(), rotation.column(1).into_owned());
        let frame = Flat { origin: narrow(&origin), sides: [narrow(&ex), narrow(&ey)] };
        self.outermost.keep_in_plane([x, y, z], &frame, &mut self.ends);
        self.candidates.clear();
        self.candidates.extend(self.ends.iter().map(|&cell| {
            let cell = cell as usize;
            let d = Vector3::new(x[cell], y[cell], z[cell]).cast::<f64>() - origin;
            [ex.dot(&d), ey.dot(&d)]
        }));
        self.march(hull);
    }

    /// Lists the first and the last cell of each row, and what may be the first or the last of a column:
    /// the cells of columns that are outside all those between the region's ends in the rows before, or
    /// after. A column that a row with a gap has left out lies between these rows' ends.
    fn find_ends(
        &mut self,
        width: usize,
        runs: impl DoubleEndedIterator<Item = Range<usize>> + Clone,
    ) {
        self.ends.clear();
        let mut row_end = 0;
        // First and end of the columns of all rows.
        let mut all = (usize::MAX, 0);
        for run in runs.clone() {
            // Successive runs of a row end it later each.
            if run.start < row_end
                && let Some(last) = self.ends.last_mut()
            {
                *last = run.end as u32 - 1;
            } else {
                row_end = (run.start / width + 1) * width;
                self.ends.extend([run.start as u32, run.end as u32 - 1]);
            }
            let row = row_end - width;
            all = (all.0.min(run.start - row), all.1.max(run.end - row));
        }
        self.list_new_columns(width, all, runs.clone());
        self.list_new_columns(width, all, runs.rev());
    }

    /// Lists the cells whose columns are beyond those of the rows that were passed; `all` are the first
    /// and the end of all.
    fn list_new_columns(
        &mut self,
        width: usize,
        all: (usize, usize),
        runs: impl Iterator<Item = Range<usize>>,
    ) {
        // First and end of the columns of the rows before, and with those of the row at hand, whose own
        // gaps are not passed yet.
        let (mut seen, mut here) = ((usize::MAX, 0), (usize::MAX, 0));
        let mut row = 0;
        for run in runs {
            if run.start < row || run.start >= row + width {
                if here == all {
                    break;
                }
                seen = here;
                row = run.start / width * width;
            }
            let columns = run.start - row..run.end - row;
            here = (here.0.min(columns.start), here.1.max(columns.end));
            if columns.start >= seen.0 && columns.end <= seen.1 {
                continue;
            }
            let left = columns.start..columns.end.min(seen.0);
            let right = columns.start.max(seen.1).max(left.end)..columns.end;
            for columns in [left, right] {
                self.ends.extend(columns.map(|column| (row + column) as u32));
            }
        }
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
    fn the_hull_of_a_seen_patch_is_that_of_all_its_points() {
        // A slanted plane on which cells of a grid of rays form a ring with a gap.
        let width = 12;
        let cells: Vec<usize> = (0..width * 9)
            .filter(|cell| {
                let (row, column) =
                    (*cell as f64 / width as f64 - 4.0, (cell % width) as f64 - 5.0);
                (4.0..20.0).contains(&(row * row + column * column)) && column != 1.0
            })
            .collect();
        let point = |cell: usize| {
            let (a, b) = ((cell / width) as f64 * 0.1 - 0.4, (cell % width) as f64 * 0.1 - 0.5);
            Vector3::new(1.0, b, a) * (3.0 / (1.0 + 0.2 * b - 0.3 * a))
        };
        let all: Vec<Vector3<f64>> = (0..width * 9).map(point).collect();
        let columns: [Vec<f32>; 3] =
            std::array::from_fn(|i| all.iter().map(|p| p[i] as f32).collect());
        let runs = cells.chunk_by(|a, b| a + 1 == *b && a / width == b / width);
        let runs: Vec<Range<usize>> = runs.map(|run| run[0]..run[run.len() - 1] + 1).collect();
        let frame = Isometry3::identity();
        let (mut hull, mut expected) = (Vec::new(), Vec::new());
        let mut finder = HullFinder::default();
        let arrays = [&columns[0][..], &columns[1], &columns[2]];
        for _ in 0..2 {
            finder.find_in_runs(arrays, width, runs.iter().cloned(), &frame, &mut hull);
        }
        let flat: Vec<[f64; 2]> = cells
            .iter()
            .map(|&cell| [f64::from(columns[0][cell]), f64::from(columns[1][cell])])
            .collect();
        finder.find(&flat, &mut expected);
        let (area, whole) =
            (crate::geometry::polygon_area(&hull), crate::geometry::polygon_area(&expected));
        assert!(whole > 0.1 && (area / whole - 1.0).abs() < 1e-5, "{area} {whole}");
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
