//! The growing lattice of cells: chunks of 32 × 32 cells, made where something was seen.

use super::column::{BINS, Column, bin_of, slab_of};
use super::surface::GroundCell;
use serde::{Deserialize, Serialize};

/// A cell of the terrain lattice: `x` and `y` count cells from the map's origin, so an index stays
/// valid while the map grows.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct CellIndex {
    /// Cells along map x; cell 0 covers [0, cell side).
    pub x: i32,
    /// Cells along map y.
    pub y: i32,
}

impl CellIndex {
    /// The cell of side `cell_m` that holds the map point `(x_m, y_m)`.
    pub fn at(x_m: f64, y_m: f64, cell_m: f64) -> Self {
        Self { x: (x_m / cell_m).floor() as i32, y: (y_m / cell_m).floor() as i32 }
    }

    /// Centre of the cell in metres.
    pub fn centre_m(self, cell_m: f64) -> [f64; 2] {
        [(f64::from(self.x) + 0.5) * cell_m, (f64::from(self.y) + 0.5) * cell_m]
    }
}

const CHUNK_BITS: u32 = 5;
/// Cells along one side of a chunk.
pub(super) const CHUNK: i32 = 1 << CHUNK_BITS;
const CELLS: usize = (CHUNK * CHUNK) as usize;
const NO_CHUNK: u32 = u32::MAX;

/// The 64 bins above each cell of a chunk at one height.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Slab {
    level: i16,
    columns: Vec<Column>,
}

/// 32 × 32 cells.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Chunk {
    /// The chunk's own index: cell index divided by the chunk's side.
    pub x: i32,
    pub y: i32,
    pub ground: Vec<GroundCell>,
    slabs: Vec<Slab>,
    /// Log-odds of flat occupancy in tenths, from single laser lines; empty until one came.
    flat: Vec<i8>,
}

impl Chunk {
    fn new(x: i32, y: i32) -> Self {
        Self {
            x,
            y,
            ground: vec![GroundCell::default(); CELLS],
            slabs: Vec::new(),
            flat: Vec::new(),
        }
    }

    fn slab_mut(&mut self, level: i16) -> &mut Slab {
        let position =
            self.slabs.iter().position(|slab| slab.level == level).unwrap_or_else(|| {
                self.slabs.push(Slab { level, columns: vec![Column::default(); CELLS] });
                self.slabs.len() - 1
            });
        &mut self.slabs[position]
    }

    /// Takes in hits and passes of the 64 bins that start at `first_bin`, which may straddle slabs.
    pub fn update_column(&mut self, cell: usize, first_bin: i32, hit: u64, passed: u64) {
        let (level, shift) = slab_of(first_bin);
        let (hit_low, passed_low) = (hit << shift, passed << shift);
        if hit_low | passed_low != 0 {
            self.slab_mut(level).columns[cell].update(hit_low, passed_low);
        }
        if shift > 0 {
            let down = BINS as u32 - shift;
            let (hit_high, passed_high) = (hit >> down, passed >> down);
            if hit_high | passed_high != 0 {
                self.slab_mut(level + 1).columns[cell].update(hit_high, passed_high);
            }
        }
    }

    fn gather(&self, cell: usize, first_bin: i32, read: impl Fn(&Column) -> u64) -> u64 {
        let (level, shift) = slab_of(first_bin);
        let mut word = 0;
        for slab in &self.slabs {
            if slab.level == level {
                word |= read(&slab.columns[cell]) >> shift;
            } else if slab.level == level + 1 && shift > 0 {
                word |= read(&slab.columns[cell]) << (BINS as u32 - shift);
            }
        }
        word
    }

    /// Occupied bins of the 64 that start at `first_bin`.
    pub fn occupied(&self, cell: usize, first_bin: i32) -> u64 {
        self.gather(cell, first_bin, Column::occupied)
    }

    /// Bins of the 64 that start at `first_bin` that more than one image has hit.
    pub fn confirmed(&self, cell: usize, first_bin: i32) -> u64 {
        self.gather(cell, first_bin, Column::confirmed)
    }

    /// Bins of the 64 that start at `first_bin` through which a ray passed.
    pub fn passed(&self, cell: usize, first_bin: i32) -> u64 {
        self.gather(cell, first_bin, Column::passed)
    }

    /// Adds to the flat log-odds of a cell, in tenths, saturating at ±5.0.
    pub fn add_flat(&mut self, cell: usize, tenths: i8) {
        if self.flat.is_empty() {
            self.flat = vec![0; CELLS];
        }
        self.flat[cell] = self.flat[cell].saturating_add(tenths).clamp(-50, 50);
    }

    /// Flat log-odds of a cell in tenths; zero where no single line passed.
    pub fn flat(&self, cell: usize) -> i8 {
        self.flat.get(cell).copied().unwrap_or(0)
    }
}

/// Splits a cell index into its chunk and the place in it.
pub(super) fn split(cell: CellIndex) -> ((i32, i32), usize) {
    let chunk = (cell.x >> CHUNK_BITS, cell.y >> CHUNK_BITS);
    let place = (((cell.y & (CHUNK - 1)) << CHUNK_BITS) | (cell.x & (CHUNK - 1))) as usize;
    (chunk, place)
}

/// All chunks, with a dense directory over their bounding box.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Lattice {
    chunks: Vec<Chunk>,
    x0: i32,
    y0: i32,
    width: i32,
    height: i32,
    slots: Vec<u32>,
}

impl Lattice {
    fn slot(&self, x: i32, y: i32) -> Option<usize> {
        let (i, j) = (x - self.x0, y - self.y0);
        (i >= 0 && j >= 0 && i < self.width && j < self.height)
            .then(|| (j * self.width + i) as usize)
    }

    /// The chunk with index `(x, y)`, if anything was seen there.
    pub fn chunk(&self, (x, y): (i32, i32)) -> Option<&Chunk> {
        let index = self.slots[self.slot(x, y)?];
        (index != NO_CHUNK).then(|| &self.chunks[index as usize])
    }

    /// The chunk with index `(x, y)`, made if need be.
    pub fn chunk_or_new(&mut self, (x, y): (i32, i32)) -> &mut Chunk {
        let slot = self.slot(x, y).unwrap_or_else(|| {
            self.grow(x, y);
            self.slot(x, y).expect("the directory was just grown to hold this chunk")
        });
        if self.slots[slot] == NO_CHUNK {
            self.slots[slot] = self.chunks.len() as u32;
            self.chunks.push(Chunk::new(x, y));
        }
        &mut self.chunks[self.slots[slot] as usize]
    }

    fn grow(&mut self, x: i32, y: i32) {
        let (mut x0, mut y0, mut x1, mut y1) = (x, y, x + 1, y + 1);
        if self.width > 0 {
            x0 = x0.min(self.x0);
            y0 = y0.min(self.y0);
            x1 = x1.max(self.x0 + self.width);
            y1 = y1.max(self.y0 + self.height);
        }
        (self.x0, self.y0, self.width, self.height) = (x0, y0, x1 - x0, y1 - y0);
        self.slots = vec![NO_CHUNK; (self.width * self.height) as usize];
        for (index, chunk) in self.chunks.iter().enumerate() {
            let slot = (chunk.y - y0) * self.width + (chunk.x - x0);
            self.slots[slot as usize] = index as u32;
        }
    }

    /// All chunks in the order in which they were first seen.
    pub fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// Ground of one cell, if its chunk exists.
    pub fn ground(&self, cell: CellIndex) -> Option<&GroundCell> {
        let (chunk, place) = split(cell);
        self.chunk(chunk).map(|chunk| &chunk.ground[place])
    }

    /// Ground of one cell, its chunk made if need be.
    pub fn ground_mut(&mut self, cell: CellIndex) -> &mut GroundCell {
        let (chunk, place) = split(cell);
        &mut self.chunk_or_new(chunk).ground[place]
    }

    /// Whether anything at heights `low_m..high_m` above a cell counts as occupied.
    pub fn occupied_between(&self, cell: CellIndex, low_m: f64, high_m: f64) -> bool {
        let (chunk, place) = split(cell);
        let first = bin_of(low_m);
        self.chunk(chunk).is_some_and(|chunk| {
            chunk.occupied(place, first) & super::column::bits(0, bin_of(high_m) - first) != 0
        })
    }

    /// The cells that exist, as `(lowest, one past the highest)`; `None` for an empty lattice.
    pub fn bounds(&self) -> Option<(CellIndex, CellIndex)> {
        (self.width > 0).then(|| {
            (
                CellIndex { x: self.x0 * CHUNK, y: self.y0 * CHUNK },
                CellIndex { x: (self.x0 + self.width) * CHUNK, y: (self.y0 + self.height) * CHUNK },
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::column::bits;

    #[test]
    fn chunks_survive_growth_in_every_direction() {
        let mut lattice = Lattice::default();
        let cells = [(0, 0), (100, 3), (-70, 5), (4, -99), (31, 31), (32, -1)];
        for (number, (x, y)) in cells.into_iter().enumerate() {
            lattice.ground_mut(CellIndex { x, y }).void_z_m = number as f32 + 1.0;
        }
        for (number, (x, y)) in cells.into_iter().enumerate() {
            assert_eq!(
                lattice.ground(CellIndex { x, y }).map(|cell| cell.void_z_m),
                Some(number as f32 + 1.0)
            );
        }
        assert_eq!(lattice.ground(CellIndex { x: 1000, y: 0 }), None);
    }

    #[test]
    fn a_window_that_straddles_slabs_reads_back_what_was_written() {
        let mut lattice = Lattice::default();
        for first_bin in [-90, -28, 0, 7, 36, 50] {
            let chunk = lattice.chunk_or_new((first_bin, 0));
            let (hit, passed) = (bits(3, 9) | bits(60, 63), bits(20, 50));
            chunk.update_column(5, first_bin, hit, passed);
            assert_eq!(chunk.occupied(5, first_bin), hit);
            assert_eq!(chunk.passed(5, first_bin), passed);
        }
    }
}
