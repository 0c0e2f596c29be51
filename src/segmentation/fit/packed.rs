//! The readings of a region put end to end, so that whole vectors of them can be gone through.

use pulp::Simd;

/// Readings that are put together before they are added up, about.
const FULL: usize = 256;
/// Most readings of a vector.
const WIDEST: usize = 16;
/// Room for a vector after the last one that is put before all are added up.
const ROOM: usize = FULL + 2 * WIDEST;
/// Numbers of a reading.
pub(super) const COLUMNS: usize = 6;

/// Runs put end to end: those of most regions are shorter than a vector, or a little longer, so that whatever
/// is reckoned from vectors of single runs is reckoned twice as often.
///
/// Columns begin where lines of the cache do, so no vector is in two of them.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(in super::super) struct Packed {
    pub columns: [[f32; ROOM]; COLUMNS],
    pub count: usize,
}

impl Default for Packed {
    fn default() -> Self {
        Self { columns: [[0.0; ROOM]; COLUMNS], count: 0 }
    }
}

impl Packed {
    pub const FULL: usize = FULL;

    /// Appends the first so many of vectors; there is room for one as long as it is not full.
    #[inline(always)]
    pub fn put<S: Simd>(&mut self, _: S, vectors: [S::f32s; COLUMNS], count: usize) {
        // That there is room is known to the caller, but not to the compiler.
        let at = self.count.min(FULL + WIDEST);
        for (column, vector) in self.columns.iter_mut().zip(vectors) {
            // What comes after them gives way to the next.
            S::as_mut_simd_f32s(&mut column[at..at + S::F32_LANES]).0[0] = vector;
        }
        self.count = at + count;
    }

    /// Fills the last vector up with zeros and starts anew; returns how many readings, with these,
    /// are to be gone through.
    #[inline(always)]
    pub fn fill_up<S: Simd>(&mut self, simd: S) -> usize {
        let end = self.count.next_multiple_of(S::F32_LANES);
        self.put(simd, [simd.splat_f32s(0.0); COLUMNS], 0);
        self.count = 0;
        end
    }
}
