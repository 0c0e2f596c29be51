//! Filling a mask from the points of a scan.

use super::mask::{MASK_CELL_M, PlaneMask, TILE, cell_of};
use nalgebra::{Point2, Vector2};

/// Neighbouring points farther apart than this have not shown what lies between them: at grazing
/// incidence a doorway fits there.
const LONGEST_SPAN_M: f64 = 0.6;
/// No scanner sees a longer surface.
const LONGEST_EXTENT_M: f64 = 400.0;

/// A mask in the making: a plain bitmap over a known extent, quicker to fill than the map of tiles.
#[derive(Clone, Debug)]
pub(super) struct MaskBuilder {
    first_tile: (i32, i32),
    /// Width and height in tiles.
    size: (i32, i32),
    /// Words of a row of cells, and the rows one after the other.
    stride: usize,
    words: Vec<u64>,
}

impl MaskBuilder {
    /// A builder for points within the extent of `outline`; `None` where that has none or is larger
    /// than any scanner reaches.
    pub(super) fn over(outline: &[Point2<f64>]) -> Option<Self> {
        let first = outline.first()?;
        let (low, high) =
            outline.iter().fold((*first, *first), |(low, high), p| (low.inf(p), high.sup(p)));
        if (high - low).amax() > LONGEST_EXTENT_M {
            return None;
        }
        let tile = |coordinate: f64| cell_of(coordinate).div_euclid(TILE);
        // A tile more on each side: points that are no corners may lie a rounding outside.
        let first_tile = (tile(low.x) - 1, tile(low.y) - 1);
        let size = (tile(high.x) - first_tile.0 + 2, tile(high.y) - first_tile.1 + 2);
        let stride = (size.0 as usize * TILE as usize).div_ceil(64);
        Some(Self { first_tile, size, stride, words: vec![0; stride * (size.1 * TILE) as usize] })
    }

    /// Where the plane's origin lies, in cells from the builder's first corner.
    pub(super) fn origin(&self) -> Vector2<f64> {
        -Vector2::new(f64::from(self.first_tile.0 * TILE), f64::from(self.first_tile.1 * TILE))
    }

    /// Whether a cell lies inside. The first ones lie in the tile to spare, and whatever lies beyond them
    /// was taken for one of them.
    fn holds(&self, (column, row): (u32, u32)) -> bool {
        column.wrapping_sub(1) < (self.size.0 * TILE - 1) as u32
            && row.wrapping_sub(1) < (self.size.1 * TILE - 1) as u32
    }

    /// Sets the cell of a point of the plane.
    pub(super) fn insert(&mut self, spot: &Spot) {
        if self.holds(spot.cell) {
            let (column, row) = (spot.cell.0 as usize, spot.cell.1 as usize);
            self.words[row * self.stride + column / 64] |= 1 << (column % 64);
        }
    }

    /// Sets the cells whose centre lies in the quadrilateral of four neighbouring points.
    pub(super) fn insert_quadrilateral(&mut self, corners: &[Spot; 4]) {
        let [a, b, c, d] = corners.map(|corner| corner.at);
        let least = |a: f64, b: f64| if a < b { a } else { b };
        let most = |a: f64, b: f64| if a > b { a } else { b };
        let spread = |a: f64, b: f64, c: f64, d: f64| {
            (least(least(a, b), least(c, d)), most(most(a, b), most(c, d)))
        };
        let (left, right) = spread(a.x, b.x, c.x, d.x);
        let (low, high) = spread(a.y, b.y, c.y, d.y);
        // Points closer to each other than cells are wide seldom have a centre between them.
        let (first_column, end_column) = ((left + 0.5) as u32, (right + 0.5) as u32);
        let (first_row, end_row) = ((low + 0.5) as u32, (high + 0.5) as u32);
        if first_column >= end_column
            || first_row >= end_row
            || (right - left).max(high - low) > LONGEST_SPAN_M / MASK_CELL_M
            || !self.holds((first_column, first_row))
            || !self.holds((end_column - 1, end_row - 1))
        {
            return;
        }
        let triangles = [Triangle::new(a, b, c), Triangle::new(a, c, d)];
        for row in first_row..end_row {
            for column in first_column..end_column {
                let word = &mut self.words[row as usize * self.stride + column as usize / 64];
                let bit = 1 << (column % 64);
                let centre = (f64::from(column) + 0.5, f64::from(row) + 0.5);
                if *word & bit == 0 && triangles.iter().any(|triangle| triangle.contains(centre)) {
                    *word |= bit;
                }
            }
        }
    }

    /// The mask.
    pub(super) fn finish(self) -> PlaneMask {
        let mut mask = PlaneMask::default();
        for tile_x in 0..self.size.0 {
            for tile_y in 0..self.size.1 {
                let column = (tile_x * TILE) as usize;
                let mut bits = 0;
                for row in (0..TILE).rev() {
                    let word = (tile_y * TILE + row) as usize * self.stride + column / 64;
                    bits = bits << TILE | self.words[word] >> (column % 64) & 0xff;
                }
                if bits != 0 {
                    mask.tiles
                        .insert((tile_x + self.first_tile.0, tile_y + self.first_tile.1), bits);
                }
            }
        }
        mask
    }
}

/// A point of a plane in cells from its builder's first corner, and the cell that holds it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spot {
    at: Point2<f64>,
    cell: (u32, u32),
}

impl Spot {
    /// From coordinates in cells; what is negative or no number comes to lie in the builder's first cells.
    pub(super) fn new(at: Point2<f64>) -> Self {
        Self { at, cell: (at.x as u32, at.y as u32) }
    }
}

/// A triangle of either sense of rotation.
struct Triangle {
    corners: [Point2<f64>; 3],
    turn: f64,
}

impl Triangle {
    fn new(a: Point2<f64>, b: Point2<f64>, c: Point2<f64>) -> Self {
        Self { corners: [a, b, c], turn: side(&a, &b, (c.x, c.y)).signum() }
    }

    fn contains(&self, point: (f64, f64)) -> bool {
        let [a, b, c] = &self.corners;
        let inside = |p, q| side(p, q, point) * self.turn >= 0.0;
        inside(a, b) && inside(b, c) && inside(c, a)
    }
}

/// Twice the area of a triangle, positive when it turns left.
fn side(p: &Point2<f64>, q: &Point2<f64>, (x, y): (f64, f64)) -> f64 {
    (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_builder_takes_points_outside_its_extent_for_nothing() {
        let mut builder =
            MaskBuilder::over(&[Point2::new(0.0, 0.0), Point2::new(1.0, 1.0)]).unwrap();
        for p in [
            Point2::new(0.55, 0.25),
            Point2::new(-300.0, 0.0),
            Point2::new(0.0, 1e12),
            Point2::new(f64::NAN, 0.5),
        ] {
            let spot = Spot::new(p / MASK_CELL_M + builder.origin());
            builder.insert(&spot);
        }
        let mask = builder.finish();
        assert!(mask.contains(&Point2::new(0.55, 0.25)) && mask.count() == 1);
        assert!(MaskBuilder::over(&[Point2::new(0.0, 0.0), Point2::new(1e9, 0.0)]).is_none());
    }
}
