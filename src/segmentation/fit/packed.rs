//! What is summed of the readings of a region, put end to end, so that whole vectors of them can be gone
//! through.

use pulp::Simd;

/// Readings that are put together before they are added up, about.
const FULL: usize = 256;
/// Most readings of a vector.
const WIDEST: usize = 16;
/// Numbers of a reading.
const COLUMNS: usize = 4;

/// Runs put end to end: those of most regions are shorter than a vector, or a little longer.
///
/// Columns begin where lines of the cache do, so no vector is in two of them.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(in super::super) struct Packed {
    pub columns: [[f32; FULL + WIDEST]; COLUMNS],
    pub count: usize,
}

impl Default for Packed {
    fn default() -> Self {
        Self { columns: [[0.0; FULL + WIDEST]; COLUMNS], count: 0 }
    }
}

impl Packed {
    pub const FULL: usize = FULL;

    /// Appends the first so many of vectors; there is room for one as long as it is not full.
    #[inline(always)]
    pub fn put<S: Simd>(&mut self, _: S, vectors: [S::f32s; COLUMNS], count: usize) {
        for (column, vector) in self.columns.iter_mut().zip(vectors) {
            // What comes after them gives way to the next.
            let room = &mut column[self.count..self.count + S::F32_LANES];
            S::as_mut_simd_f32s(room).0[0] = vector;
        }
        self.count += count;
    }

    /// Fills the last vector up with zeros and starts anew; returns how many readings, with these,
    /// are to be gone through.
    #[inline(always)]
    pub fn fill_up(&mut self, multiple: usize) -> usize {
        let end = self.count.next_multiple_of(multiple);
        for column in &mut self.columns {
            column[self.count..end].fill(0.0);
        }
        self.count = 0;
        end
    }
}
