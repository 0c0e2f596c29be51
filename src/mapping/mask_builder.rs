//! Filling a mask from the points of a scan.

use super::mask::{PlaneMask, TILE, cell_of, centre, ones};
use nalgebra::Point2;

/// Neighbouring points farther apart than this have not shown what lies between them: at grazing
/// incidence a doorway fits there.
const LONGEST_SPAN_M: f64 = 0.6;
/// Cells that such points may lie apart in either axis, at most.
const MOST_SPAN: i32 = 7;
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

    /// Column and row of a cell; `None` outside.
    fn place(&self, (x, y): (i32, i32)) -> Option<(usize, usize)> {
        let column = x - self.first_tile.0 * TILE;
        let row = y - self.first_tile.1 * TILE;
        let inside =
            (0..self.size.0 * TILE).contains(&column) && (0..self.size.1 * TILE).contains(&row);
        inside.then_some((column as usize, row as usize))
    }

    /// Sets the cell of a point of the plane.
    pub(super) fn insert(&mut self, spot: &Spot) {
        if let Some((column, row)) = self.place(spot.cell) {
            self.words[row * self.stride + column / 64] |= 1 << (column % 64);
        }
    }

    /// Sets the cells whose centre lies in the quadrilateral of four neighbouring points, whose own
    /// cells are set already.
    pub(super) fn insert_quadrilateral(&mut self, corners: &[Spot; 4]) {
        let [a, b, c, d] = corners;
        let ((ax, ay), (bx, by)) = (a.cell, b.cell);
        let ((cx, cy), (dx, dy)) = (c.cell, d.cell);
        let from = (ax.min(bx).min(cx.min(dx)), ay.min(by).min(cy.min(dy)));
        let to = (ax.max(bx).max(cx.max(dx)), ay.max(by).max(cy.max(dy)));
        // Corners in one cell or in cells side by side leave nothing between them, and those too far
        // apart for their cells are too far apart.
        let (wide, high) = (to.0 - from.0, to.1 - from.1);
        if wide + high <= 1 || wide.max(high) > MOST_SPAN {
            return;
        }
        let (Some((column, row)), Some(_)) = (self.place(from), self.place(to)) else { return };
        let mut quadrilateral = None;
        for step in 0..=high {
            let at = (row + step as usize) * self.stride + column / 64;
            let shift = column % 64;
            let mut bits = self.words[at] >> shift;
            if shift + wide as usize >= 64 {
                bits |= self.words[at + 1] << (64 - shift);
            }
            // Most are set: by their own points, or by the quadrilateral before.
            let mut missing = !bits & ones(0, wide + 1);
            while missing != 0 {
                let bit = missing.trailing_zeros() as usize;
                missing &= missing - 1;
                let shape = quadrilateral.get_or_insert_with(|| Quadrilateral::new(corners));
                if shape.contains(centre(from.0 + bit as i32, from.1 + step)) {
                    let column = column + bit;
                    self.words[(row + step as usize) * self.stride + column / 64] |=
                        1 << (column % 64);
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

/// A point of a plane, and the cell that holds it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    at: Point2<f64>,
    cell: (i32, i32),
}

impl Spot {
    pub(super) fn new(at: Point2<f64>) -> Self {
        Self { at, cell: (cell_of(at.x), cell_of(at.y)) }
    }
}

/// The area of four neighbouring points; none where they lie too far apart.
struct Quadrilateral {
    low: Point2<f64>,
    high: Point2<f64>,
    near: bool,
    triangles: [Triangle; 2],
}

impl Quadrilateral {
    fn new([a, b, c, d]: &[Spot; 4]) -> Self {
        let low = a.at.inf(&b.at).inf(&c.at.inf(&d.at));
        let high = a.at.sup(&b.at).sup(&c.at.sup(&d.at));
        let near = high.x - low.x <= LONGEST_SPAN_M && high.y - low.y <= LONGEST_SPAN_M;
        let triangles = [Triangle::new(a.at, b.at, c.at), Triangle::new(a.at, c.at, d.at)];
        Self { low, high, near, triangles }
    }

    fn contains(&self, (x, y): (f64, f64)) -> bool {
        self.near
            && (self.low.x <= x && x <= self.high.x && self.low.y <= y && y <= self.high.y)
            && (self.triangles[0].contains((x, y)) || self.triangles[1].contains((x, y)))
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
        for p in [Point2::new(0.55, 0.25), Point2::new(-300.0, 0.0), Point2::new(f64::NAN, 1e9)] {
            builder.insert(&Spot::new(p));
        }
        let mask = builder.finish();
        assert!(mask.contains(&Point2::new(0.55, 0.25)) && mask.count() <= 2);
        assert!(MaskBuilder::over(&[Point2::new(0.0, 0.0), Point2::new(1e9, 0.0)]).is_none());
    }
}
