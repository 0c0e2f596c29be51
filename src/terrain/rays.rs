//! What the rays of one image hit and passed through, collected cell by cell before the lattice is
//! told: one image counts once, however many of its rays cross a cell.

use super::column::{BINS, bin_of, bits};
use super::lattice::{CHUNK, CellIndex, Lattice};
use nalgebra::{Point3, Vector3};

/// Bins below the floor on which the robot stands: what lies deeper is no evidence about its level.
const BELOW_FLOOR_BINS: i32 = 28;
/// A ray clears only up to this distance before its hit: range noise and the slant of a beam within
/// a cell must not let a surface erase itself.
const STOP_SHORT_M: f64 = 0.08;
/// The first stretch of every ray lies above the robot itself.
const START_M: f64 = 0.15;

#[derive(Clone, Copy, Default)]
struct Seen {
    hit: u64,
    passed: u64,
}

/// A rectangle of cells with the 64 bins about the robot's floor in each.
pub(super) struct RayWindow {
    low: CellIndex,
    width: i32,
    height: i32,
    cell_m: f64,
    first_bin: i32,
    top_m: f64,
    seen: Vec<Seen>,
}

impl RayWindow {
    /// A window over the cells `low..=high`, for a robot whose floor lies at `floor_z_m`.
    pub fn new(low: CellIndex, high: CellIndex, cell_m: f64, floor_z_m: f64) -> Self {
        let (width, height) = ((high.x - low.x + 1).max(0), (high.y - low.y + 1).max(0));
        let first_bin = bin_of(floor_z_m) - BELOW_FLOOR_BINS;
        Self {
            low,
            width,
            height,
            cell_m,
            first_bin,
            top_m: f64::from(first_bin + BINS) * super::column::BIN_M,
            seen: vec![Seen::default(); (width * height) as usize],
        }
    }

    fn index(&self, cell: CellIndex) -> Option<usize> {
        let (x, y) = (cell.x - self.low.x, cell.y - self.low.y);
        (x >= 0 && y >= 0 && x < self.width && y < self.height)
            .then(|| (y * self.width + x) as usize)
    }

    /// Notes a surface point; points outside the window or its heights are left out.
    pub fn hit(&mut self, p: &Point3<f64>) {
        let bin = bin_of(p.z) - self.first_bin;
        if let Some(index) = self.index(CellIndex::at(p.x, p.y, self.cell_m)) {
            self.seen[index].hit |= bits(bin, bin);
        }
    }

    /// Notes what a ray from `origin` along the unit `direction` passes on its first `length_m`,
    /// as far as it stays below the window's top, or below `ceiling_m` if that is lower.
    pub fn pass(
        &mut self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        length_m: f64,
        ceiling_m: f64,
    ) {
        let top_m = self.top_m.min(ceiling_m);
        let mut end_m = length_m - STOP_SHORT_M;
        if direction.z > 1e-9 {
            end_m = end_m.min((top_m - origin.z) / direction.z);
        }
        if end_m <= START_M || origin.z > top_m {
            return;
        }
        // Amanatides-Woo over the cells, with the ray's length as the parameter.
        let cell_m = self.cell_m;
        let start = origin + direction * START_M;
        let mut cell = CellIndex::at(start.x, start.y, cell_m);
        let axis = |from: f64, along: f64, index: i32| {
            if along.abs() < 1e-12 {
                return (0, f64::INFINITY, f64::INFINITY);
            }
            let border = f64::from(if along > 0.0 { index + 1 } else { index }) * cell_m;
            let step = if along > 0.0 { 1 } else { -1 };
            (step, (border - from) / along, cell_m / along.abs())
        };
        let (step_x, mut next_x, every_x) = axis(origin.x, direction.x, cell.x);
        let (step_y, mut next_y, every_y) = axis(origin.y, direction.y, cell.y);
        let bin_scale = 1.0 / super::column::BIN_M;
        let height =
            |t: f64| ((origin.z + direction.z * t) * bin_scale).floor() as i32 - self.first_bin;
        let mut bin = height(START_M);
        loop {
            let leave = next_x.min(next_y);
            let out = leave.min(end_m);
            let Some(index) = self.index(cell) else { return };
            let next_bin = height(out);
            self.seen[index].passed |= if bin == next_bin && (0..BINS).contains(&bin) {
                1 << bin
            } else {
                bits(bin.min(next_bin), bin.max(next_bin))
            };
            if leave >= end_m {
                return;
            }
            bin = next_bin;
            if next_x < next_y {
                cell.x += step_x;
                next_x += every_x;
            } else {
                cell.y += step_y;
                next_y += every_y;
            }
        }
    }

    /// Tells the lattice what was seen, and the surfaces of each cell what passed beneath them.
    pub fn apply(&self, lattice: &mut Lattice, scan: u32) {
        let chunk_of = |cell: i32| cell.div_euclid(CHUNK);
        let (x1, y1) = (self.low.x + self.width - 1, self.low.y + self.height - 1);
        for chunk_y in chunk_of(self.low.y)..=chunk_of(y1) {
            for chunk_x in chunk_of(self.low.x)..=chunk_of(x1) {
                self.apply_chunk(lattice, (chunk_x, chunk_y), scan);
            }
        }
    }

    fn apply_chunk(&self, lattice: &mut Lattice, at: (i32, i32), scan: u32) {
        let (x0, y0) = (at.0 * CHUNK, at.1 * CHUNK);
        let columns = x0.max(self.low.x)..(x0 + CHUNK).min(self.low.x + self.width);
        let rows = y0.max(self.low.y)..(y0 + CHUNK).min(self.low.y + self.height);
        let words = rows.flat_map(|y| columns.clone().map(move |x| (x, y))).filter_map(|(x, y)| {
            let seen = self.seen[((y - self.low.y) * self.width + (x - self.low.x)) as usize];
            (seen.hit | seen.passed != 0).then_some((x - x0, y - y0, seen))
        });
        let mut words = words.peekable();
        if words.peek().is_none() {
            return;
        }
        let chunk = lattice.chunk_or_new(at);
        for (x, y, seen) in words {
            let place = (y * CHUNK + x) as usize;
            chunk.update_column(place, self.first_bin, seen.hit, seen.passed);
            let ground = &mut chunk.ground[place];
            if !ground.surfaces().is_empty() {
                ground.undercut(scan, |low_m, high_m| {
                    let mask =
                        bits(bin_of(low_m) - self.first_bin, bin_of(high_m) - 1 - self.first_bin);
                    seen.passed & mask != 0
                });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window() -> RayWindow {
        RayWindow::new(CellIndex { x: -40, y: -40 }, CellIndex { x: 40, y: 40 }, 0.05, 0.0)
    }

    #[test]
    fn a_ray_passes_the_cells_a_dense_walk_along_it_visits() {
        let origin = Point3::new(0.02, -0.01, 0.6);
        for step in 0..24 {
            let yaw = f64::from(step) * 0.27 + 0.013;
            let direction = Vector3::new(yaw.cos(), yaw.sin(), -0.35).normalize();
            let mut window = window();
            window.pass(&origin, &direction, 1.5, 9.0);
            let mut missed = 0;
            for walk in 0..10_000 {
                let t = START_M + (1.5 - STOP_SHORT_M - START_M) * f64::from(walk) / 9_999.0;
                let p = origin + direction * t;
                let index = window.index(CellIndex::at(p.x, p.y, 0.05)).unwrap();
                let bin = bin_of(p.z) - window.first_bin;
                missed += u32::from(window.seen[index].passed & bits(bin, bin) == 0);
            }
            assert!(missed <= 2, "{missed} of 10000 points along the ray not passed");
            let end = origin + direction * 1.5;
            let index = window.index(CellIndex::at(end.x, end.y, 0.05)).unwrap();
            let bin = bin_of(end.z) - window.first_bin;
            assert_eq!(window.seen[index].passed & bits(bin, bin), 0, "the end is not passed");
        }
    }

    #[test]
    fn rays_that_rise_end_at_the_ceiling() {
        let mut window = window();
        let direction = Vector3::new(1.0, 0.0, 0.5).normalize();
        window.pass(&Point3::new(0.0, 0.0, 0.6), &direction, 1.9, 0.8);
        let beyond = window.index(CellIndex { x: 12, y: 0 }).unwrap();
        assert_eq!(window.seen[beyond].passed, 0);
    }
}
