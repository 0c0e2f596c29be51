use nalgebra::{Isometry3, Point2, Point3, Vector2};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Edge of a mask cell in metres.
pub const MASK_CELL_M: f64 = 0.1;
/// Cells along the edge of a tile; a tile is one `u64`.
pub(super) const TILE: i32 = 8;
/// A cell's edge in fixed point.
const CELL_BITS: u32 = 24;
const ONE_CELL: f64 = (1 << CELL_BITS) as f64;
/// Cells of which a mask is sampled when only nearness is asked.
const NEAR_SAMPLES: usize = 200;
/// The same where only half of it is asked for.
const COVER_SAMPLES: usize = 40;

/// Which cells of a plane were hit: a bit per 0.1 m square of its local x-y plane.
///
/// A convex hull covers doorways and stair wells; this does not. Stored in tiles of 8 × 8 cells, so
/// that a long wall costs a few hundred bytes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlaneMask {
    pub(super) tiles: BTreeMap<(i32, i32), u64>,
}

/// The cell that holds a local coordinate.
pub(super) fn cell_of(coordinate_m: f64) -> i32 {
    // `floor` is a call on processors without SSE4, and there is one coordinate after the other.
    let cells = (coordinate_m / MASK_CELL_M).clamp(-1e6, 1e6);
    let towards_zero = cells as i32;
    towards_zero - i32::from(f64::from(towards_zero) > cells)
}

impl PlaneMask {
    /// Whether no cell is set.
    pub fn is_empty(&self) -> bool {
        self.tiles.is_empty()
    }

    /// Number of cells that are set.
    pub fn count(&self) -> usize {
        self.tiles.values().map(|bits| bits.count_ones() as usize).sum()
    }

    /// Number of tiles of 8 × 8 cells that hold any: what the mask costs.
    pub fn tiles(&self) -> usize {
        self.tiles.len()
    }

    /// Area of all cells that are set, in m².
    pub fn area_m2(&self) -> f64 {
        self.count() as f64 * MASK_CELL_M * MASK_CELL_M
    }

    fn set(&mut self, x: i32, y: i32) {
        let bit = y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE);
        *self.tiles.entry((x.div_euclid(TILE), y.div_euclid(TILE))).or_default() |= 1 << bit;
    }

    fn get(&self, x: i32, y: i32) -> bool {
        let bit = y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE);
        self.tiles
            .get(&(x.div_euclid(TILE), y.div_euclid(TILE)))
            .is_some_and(|bits| bits >> bit & 1 == 1)
    }

    /// Sets the cell of a point of the plane; a point that is not finite sets none.
    pub fn insert(&mut self, point: &Point2<f64>) {
        if point.x.is_finite() && point.y.is_finite() {
            self.set(cell_of(point.x), cell_of(point.y));
        }
    }

    /// Whether the cell of a point is set.
    pub fn contains(&self, point: &Point2<f64>) -> bool {
        self.get(cell_of(point.x), cell_of(point.y))
    }

    /// Whether a point is half a cell within the cells that are set: one hit sets a whole cell, of which the
    /// surface may cover but an edge.
    pub fn contains_well(&self, point: &Point2<f64>) -> bool {
        let half = 0.5 * MASK_CELL_M;
        [(-half, -half), (half, -half), (-half, half), (half, half)]
            .iter()
            .all(|&(x, y)| self.contains(&(point + Vector2::new(x, y))))
    }

    /// Whether the cell of a point and all within `reach` cells of it in each axis are set.
    pub fn solid_about(&self, point: &Point2<f64>, reach: i32) -> bool {
        let window = Window::about(cell_of(point.x), cell_of(point.y), reach);
        window
            .tiles()
            .all(|(tile, wanted)| self.tiles.get(&tile).is_some_and(|bits| bits & wanted == wanted))
    }

    /// Centres of the cells that are set, by tile, then row by row.
    pub fn cells(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        self.tiles.iter().flat_map(|(&(tile_x, tile_y), &bits)| {
            (0..TILE * TILE).filter(move |bit| bits >> bit & 1 == 1).map(move |bit| {
                let (x, y) = centre(tile_x * TILE + bit % TILE, tile_y * TILE + bit / TILE);
                Point2::new(x, y)
            })
        })
    }

    /// Adds the cells of `other`, whose plane lies at `self_from_other` (its z is dropped).
    ///
    /// A lattice of half a cell meets every cell whatever the turn, so a filled area stays filled.
    pub fn merge(&mut self, other: &Self, self_from_other: &Isometry3<f64>) {
        let turn = self_from_other.rotation.to_rotation_matrix().into_inner();
        let shift = self_from_other.translation.vector / MASK_CELL_M;
        // Cells in fixed point, so that a cell is a shift away.
        let fixed = |cells: f64| (cells * ONE_CELL).round().clamp(-1e15, 1e15) as i64;
        let half_step = |row: usize, column: usize| fixed(0.5 * turn[(row, column)]);
        let (x_by_u, x_by_v) = (half_step(0, 0), half_step(0, 1));
        let (y_by_u, y_by_v) = (half_step(1, 0), half_step(1, 1));
        for (&(tile_x, tile_y), &bits) in &other.tiles {
            // The first lattice point of the tile, a quarter of a cell within its corner.
            let (u, v) = (f64::from(tile_x * TILE) + 0.25, f64::from(tile_y * TILE) + 0.25);
            let x = fixed(turn[(0, 0)] * u + turn[(0, 1)] * v + shift.x);
            let y = fixed(turn[(1, 0)] * u + turn[(1, 1)] * v + shift.y);
            // Where the tile's corner that lies lowest comes to.
            let side = 2 * i64::from(TILE) - 1;
            let low = |at: i64, by_u: i64, by_v: i64| at + side * (by_u.min(0) + by_v.min(0));
            let first_x = (low(x, x_by_u, x_by_v) >> CELL_BITS).div_euclid(i64::from(TILE));
            let first_y = (low(y, y_by_u, y_by_v) >> CELL_BITS).div_euclid(i64::from(TILE));
            let high = |at: i64, by_u: i64, by_v: i64| at + side * (by_u.max(0) + by_v.max(0));
            let last_x = (high(x, x_by_u, x_by_v) >> CELL_BITS).div_euclid(i64::from(TILE));
            let last_y = (high(y, y_by_u, y_by_v) >> CELL_BITS).div_euclid(i64::from(TILE));
            // Where all that it can reach is set, as within a surface that was seen before, it is no news.
            let mut reached = (first_y..=last_y)
                .flat_map(|tile_y| (first_x..=last_x).map(move |tile_x| (tile_x, tile_y)));
            if reached.all(|(tile_x, tile_y)| {
                self.tiles.get(&(tile_x as i32, tile_y as i32)) == Some(&u64::MAX)
            }) {
                continue;
            }
            // A turned tile spreads over three tiles at most in each axis.
            let mut spread = [[0_u64; 3]; 3];
            let mut left = bits;
            while left != 0 {
                let bit = left.trailing_zeros();
                left &= left - 1;
                let (column, row) = (i64::from(bit) % 8, i64::from(bit) / 8);
                for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (i, j) = (2 * column + i, 2 * row + j);
                    let cell_x = ((x + i * x_by_u + j * x_by_v) >> CELL_BITS) - 8 * first_x;
                    let cell_y = ((y + i * y_by_u + j * y_by_v) >> CELL_BITS) - 8 * first_y;
                    let (cell_x, cell_y) = (cell_x as usize, cell_y as usize);
                    spread[cell_y / 8][cell_x / 8] |= 1 << (cell_y % 8 * 8 + cell_x % 8);
                }
            }
            for (tile_y, row) in (first_y as i32..).zip(&spread) {
                for (tile_x, bits) in (first_x as i32..).zip(row).filter(|(_, bits)| **bits != 0) {
                    *self.tiles.entry((tile_x, tile_y)).or_default() |= bits;
                }
            }
        }
    }

    /// The cells at which [`near`](Self::near) looks, those in the middle first: patches that share
    /// anything mostly share that. A large mask is sampled at some hundred cells.
    pub fn samples(&self) -> Vec<Point2<f64>> {
        let mut samples = self.thinned(NEAR_SAMPLES);
        let half = samples.len() / 2;
        samples.rotate_left(half);
        samples
    }

    /// Centres of the cells that are set, in the order of [`cells`](Self::cells): every n-th, so that
    /// they are at least `about` and less than twice as many where there are so many.
    pub fn thinned(&self, about: usize) -> Vec<Point2<f64>> {
        let stride = (self.count() / about).max(1);
        let mut found = Vec::with_capacity(2 * about);
        let mut skipped = 0;
        for (&(tile_x, tile_y), &bits) in &self.tiles {
            let count = bits.count_ones() as usize;
            if skipped >= count {
                skipped -= count;
                continue;
            }
            let mut left = bits;
            while left != 0 {
                let bit = left.trailing_zeros() as i32;
                left &= left - 1;
                if skipped == 0 {
                    let (x, y) = centre(tile_x * TILE + bit % TILE, tile_y * TILE + bit / TILE);
                    found.push(Point2::new(x, y));
                    skipped = stride;
                }
                skipped -= 1;
            }
        }
        found
    }

    /// Whether any of the `samples` of another mask, carried over by `self_from_other`, lies within
    /// `reach_m` (in each axis) of a cell that is set here.
    pub fn near(
        &self,
        samples: &[Point2<f64>],
        self_from_other: &Isometry3<f64>,
        reach_m: f64,
    ) -> bool {
        let reach = (reach_m / MASK_CELL_M).ceil() as i32;
        samples.iter().any(|cell| {
            let p = self_from_other * Point3::new(cell.x, cell.y, 0.0);
            self.any_within(cell_of(p.x), cell_of(p.y), reach)
        })
    }

    /// Whether any of the `samples` of another mask, carried over by `self_from_other`, lies where all cells
    /// within `reach_m` (in each axis) are set here.
    pub fn surrounds(
        &self,
        samples: &[Point2<f64>],
        self_from_other: &Isometry3<f64>,
        reach_m: f64,
    ) -> bool {
        let reach = (reach_m / MASK_CELL_M).ceil() as i32;
        samples.iter().any(|cell| {
            let p = (self_from_other * Point3::new(cell.x, cell.y, 0.0)).xy();
            self.contains(&p) && self.solid_about(&p, reach)
        })
    }

    /// Whether half of the `samples` of another mask, carried over by `self_from_other`, or more lie
    /// within `reach_m` (in each axis) of a cell that is set here.
    pub fn covers(
        &self,
        samples: &[Point2<f64>],
        self_from_other: &Isometry3<f64>,
        reach_m: f64,
    ) -> bool {
        let reach = (reach_m / MASK_CELL_M).ceil() as i32;
        let looked_at = samples.iter().step_by(samples.len().div_ceil(COVER_SAMPLES).max(1));
        let is_near = |cell: &&Point2<f64>| {
            let p = self_from_other * Point3::new(cell.x, cell.y, 0.0);
            self.any_within(cell_of(p.x), cell_of(p.y), reach)
        };
        2 * looked_at.clone().filter(is_near).count() >= looked_at.len()
    }

    /// Whether a cell within `reach` cells of `(x, y)` in each axis is set.
    fn any_within(&self, x: i32, y: i32, reach: i32) -> bool {
        let window = Window::about(x, y, reach);
        // A place that is hardly known has a window larger than most masks.
        if reach > TILE && window.is_wider_than(self.tiles.len()) {
            return self.tiles.iter().any(|(&tile, bits)| bits & window.within(tile) != 0);
        }
        let found = |(tile, wanted)| self.tiles.get(&tile).is_some_and(|bits| bits & wanted != 0);
        window.tiles().any(found)
    }

    /// The outline of the set cells as straight pieces between cell corners, for drawing.
    pub fn boundary(&self) -> Vec<(Point2<f64>, Point2<f64>)> {
        let mut pieces = Vec::new();
        for cell in self.cells() {
            let (x, y) = (cell_of(cell.x), cell_of(cell.y));
            let corner = |dx: i32, dy: i32| {
                Point2::new(f64::from(x + dx) * MASK_CELL_M, f64::from(y + dy) * MASK_CELL_M)
            };
            let sides = [
                ((0, -1), (0, 0), (1, 0)),
                ((1, 0), (1, 0), (1, 1)),
                ((0, 1), (1, 1), (0, 1)),
                ((-1, 0), (0, 1), (0, 0)),
            ];
            for ((dx, dy), from, to) in sides {
                if !self.get(x + dx, y + dy) {
                    pieces.push((corner(from.0, from.1), corner(to.0, to.1)));
                }
            }
        }
        pieces
    }
}

/// A square of cells.
struct Window {
    low: (i32, i32),
    high: (i32, i32),
}

impl Window {
    /// All cells within `reach` of one in each axis.
    fn about(x: i32, y: i32, reach: i32) -> Self {
        Self { low: (x - reach, y - reach), high: (x + reach, y + reach) }
    }

    /// Whether it meets more than so many tiles.
    fn is_wider_than(&self, tiles: usize) -> bool {
        let span = |low: i32, high: i32| f64::from(high - low) / f64::from(TILE);
        span(self.low.0, self.high.0) * span(self.low.1, self.high.1) > tiles as f64
    }

    /// The tiles that it meets, each with the bits that lie within.
    fn tiles(&self) -> impl Iterator<Item = ((i32, i32), u64)> {
        let (low, high) = (self.low, self.high);
        let span = |low: i32, high: i32| low.div_euclid(TILE)..=high.div_euclid(TILE);
        span(low.1, high.1).flat_map(move |tile_y| {
            let rows = rows(low.1, high.1, tile_y);
            span(low.0, high.0).map(move |tile_x| {
                let (first, end) = part(low.0, high.0, tile_x);
                ((tile_x, tile_y), rows * ones(first, end))
            })
        })
    }

    /// The bits of a tile that lie within.
    fn within(&self, (tile_x, tile_y): (i32, i32)) -> u64 {
        let meets = |low: i32, high: i32, tile: i32| high >= tile * TILE && low < (tile + 1) * TILE;
        if !meets(self.low.0, self.high.0, tile_x) || !meets(self.low.1, self.high.1, tile_y) {
            return 0;
        }
        let (first, end) = part(self.low.0, self.high.0, tile_x);
        rows(self.low.1, self.high.1, tile_y) * ones(first, end)
    }
}

/// The cells of a tile, in one axis, between two cells of which it has some: the first and the one after them.
fn part(low: i32, high: i32, tile: i32) -> (i32, i32) {
    let at = |cell: i32| (cell - tile * TILE).clamp(0, TILE);
    (at(low), at(high + 1))
}

/// The first bit of each row of a tile between two rows.
fn rows(low: i32, high: i32, tile: i32) -> u64 {
    const FIRST: u64 = 0x0101_0101_0101_0101;
    let (first, end) = part(low, high, tile);
    FIRST & ones(TILE * first, TILE * end)
}

/// Ones from bit `first` up to but not including `end`, which is greater.
fn ones(first: i32, end: i32) -> u64 {
    (u64::MAX >> (64 - (end - first))) << first
}

fn centre(x: i32, y: i32) -> (f64, f64) {
    ((f64::from(x) + 0.5) * MASK_CELL_M, (f64::from(y) + 0.5) * MASK_CELL_M)
}

#[cfg(test)]
mod tests {
    use super::super::mask_builder::{MaskBuilder, Spot};
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    fn rectangle(x0: f64, y0: f64, x1: f64, y1: f64) -> PlaneMask {
        let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| Point2::new(x, y));
        let mut builder = MaskBuilder::over(&corners).unwrap();
        // Pieces shorter than what is filled between two points of a scan.
        let pieces = |low: f64, high: f64| {
            let count = ((high - low) / 0.4).ceil().max(1.0) as u32;
            let step = (high - low) / f64::from(count);
            (0..count).map(move |i| {
                let from = low + step * f64::from(i);
                (from, from + step)
            })
        };
        for (left, right) in pieces(x0, x1) {
            for (low, high) in pieces(y0, y1) {
                let corners = [(left, low), (right, low), (right, high), (left, high)];
                builder.insert_quadrilateral(
                    &corners.map(|(x, y)| {
                        Spot::new(Point2::new(x, y) / MASK_CELL_M + builder.origin())
                    }),
                );
            }
        }
        builder.finish()
    }

    #[test]
    fn the_edge_of_what_was_hit_holds_nothing_well() {
        let mut mask = PlaneMask::default();
        for (x, y) in [(0.05, 0.05), (0.15, 0.05), (0.05, 0.15), (0.15, 0.15)] {
            mask.insert(&Point2::new(x, y));
        }
        assert!(mask.contains_well(&Point2::new(0.1, 0.1)));
        assert!(mask.contains_well(&Point2::new(0.051, 0.149)));
        for (x, y) in [(0.04, 0.1), (0.16, 0.1), (0.1, 0.04), (0.1, 0.16)] {
            let point = Point2::new(x, y);
            assert!(mask.contains(&point) && !mask.contains_well(&point));
        }
    }

    #[test]
    fn a_doorway_between_two_pieces_stays_open() {
        let mut wall = rectangle(-3.0, 0.0, -0.45, 2.0);
        wall.merge(&rectangle(0.45, 0.0, 3.0, 2.0), &Isometry3::identity());
        assert!(wall.contains(&Point2::new(-1.0, 1.0)) && wall.contains(&Point2::new(1.0, 1.0)));
        assert!(!wall.contains(&Point2::new(0.0, 1.0)));
        assert!((wall.area_m2() - 2.0 * 2.55 * 2.0).abs() < 0.6);
    }

    #[test]
    fn near_reaches_as_far_as_told() {
        let (a, b) = (rectangle(0.0, 0.0, 1.0, 1.0), rectangle(1.74, 0.0, 2.5, 1.0));
        assert!(!a.near(&b.samples(), &Isometry3::identity(), 0.5));
        assert!(a.near(&b.samples(), &Isometry3::identity(), 0.8));
        assert!(a.near(&b.samples(), &Isometry3::translation(-0.5, 0.0, 0.0), 0.3));
    }

    #[test]
    fn a_patch_beside_another_is_neither_covered_nor_surrounded_by_it() {
        let (a, b) = (rectangle(0.0, 0.0, 3.0, 2.0), rectangle(3.1, 0.0, 4.6, 2.0));
        let at = |x: f64| Isometry3::translation(x, 0.0, 0.0);
        for open_m in [0.0, 0.2, 0.4] {
            assert!(!a.covers(&b.samples(), &at(0.0), open_m), "{open_m}");
            assert!(!a.surrounds(&b.samples(), &at(0.0), open_m), "{open_m}");
        }
        // Half of it, as far as one knows.
        assert!(a.covers(&b.samples(), &at(-0.95), 0.0) && a.covers(&b.samples(), &at(0.0), 0.95));
        // A strip of it, wherever within 0.2 m it lies.
        assert!(a.surrounds(&b.samples(), &at(-0.6), 0.2));
        assert!(!a.surrounds(&b.samples(), &at(-0.2), 0.2));
    }

    #[test]
    fn the_boundary_of_a_square_is_its_four_sides() {
        assert_eq!(rectangle(0.0, 0.0, 1.0, 1.0).boundary().len(), 40);
    }

    proptest! {
        #[test]
        fn near_agrees_with_a_search_cell_by_cell(
            a in prop::collection::vec((-20..20_i32, -20..20_i32), 0..12),
            b in prop::collection::vec((-20..20_i32, -20..20_i32), 0..12), reach in 0..40_i32,
        ) {
            let mask = |cells: &[(i32, i32)]| {
                let mut mask = PlaneMask::default();
                for &(x, y) in cells {
                    mask.set(x, y);
                }
                mask
            };
            let expected = a.iter().any(|(x, y)| {
                b.iter().any(|(u, v)| (x - u).abs() <= reach && (y - v).abs() <= reach)
            });
            let reach_m = f64::from(reach) * MASK_CELL_M - 1e-9;
            prop_assert_eq!(mask(&a).near(&mask(&b).samples(), &Isometry3::identity(), reach_m), expected);
        }

        #[test]
        fn a_filled_area_stays_filled_under_any_turn(angle in -3.2..3.2f64, x in -2.0..2.0f64) {
            let turned = Isometry3::from_parts(
                Vector3::new(x, 0.3, 0.0).into(),
                UnitQuaternion::from_scaled_axis(Vector3::z() * angle),
            );
            let mut mask = PlaneMask::default();
            mask.merge(&rectangle(-1.0, -1.0, 1.0, 1.0), &turned);
            for i in -8..=8 {
                for j in -8..=8 {
                    let p = turned * Point3::new(f64::from(i) * 0.1, f64::from(j) * 0.1, 0.0);
                    prop_assert!(mask.contains(&p.xy()));
                }
            }
            prop_assert!(mask.area_m2() < 4.0 + 8.0 * 0.2 + 0.5);
        }
    }
}
