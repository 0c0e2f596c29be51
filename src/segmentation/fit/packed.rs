//! Readings of a region put end to end, so that whole vectors of them can be gone through.

/// Readings that are put together before they are added up, at most.
const FULL: usize = 256;
/// Readings that are copied at a time.
const COPIED: usize = 16;
/// Arrays that are copied.
const COLUMNS: usize = 6;

/// Runs put end to end: those of most regions are shorter than a vector, or a little longer.
///
/// Columns begin where lines of the cache do, so no vector is in two of them.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(in super::super) struct Packed {
    pub columns: [[f32; FULL + COPIED]; COLUMNS],
    pub count: usize,
}

impl Default for Packed {
    fn default() -> Self {
        Self { columns: [[0.0; FULL + COPIED]; COLUMNS], count: 0 }
    }
}

impl Packed {
    pub const FULL: usize = FULL;

    /// Takes cells from `at` on up to `end`, and returns where it stopped: there, or as it was full.
    #[inline(always)]
    pub fn take(&mut self, columns: &[&[f32]; COLUMNS], mut at: usize, end: usize) -> usize {
        while at < end && self.count < FULL {
            let count = COPIED.min(end - at).min(FULL - self.count);
            for (packed, column) in self.columns.iter_mut().zip(columns) {
                // What is copied beyond the end gives way to the next.
                let room = packed[self.count..].first_chunk_mut::<COPIED>();
                match (room, column[at..].first_chunk::<COPIED>()) {
                    (Some(room), Some(whole)) => *room = *whole,
                    _ => packed[self.count..self.count + count]
                        .copy_from_slice(&column[at..at + count]),
                }
            }
            self.count += count;
            at += count;
        }
        at
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
