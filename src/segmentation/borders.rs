//! Where labels change in an image of labels.

use super::compete::NO_RETURN;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Finds the cells at which two labels meet.
#[derive(Clone, Debug, Default)]
pub(super) struct Borders {
    /// The bits in which a cell's label differs from those of its neighbours in its row.
    level: Vec<u32>,
}

impl Borders {
    /// Lists, in order, the cells whose label differs from that of one of their eight neighbours; those
    /// without a return are none.
    ///
    /// The whole image is compared, many cells at a time: most of a scan's are inside a region, and this
    /// costs them a few instructions each.
    pub fn find(&mut self, labels: &[u32], width: usize, cells: &mut Vec<u32>) {
        cells.clear();
        if width > 0 && !labels.is_empty() {
            self.level.resize(labels.len(), 0);
            Arch::new().dispatch(Find { level: &mut self.level, labels, width, cells });
        }
    }
}

/// One search; its loops are over arrays, so that they run on vectors of any width.
struct Find<'a> {
    level: &'a mut [u32],
    labels: &'a [u32],
    width: usize,
    cells: &'a mut Vec<u32>,
}

/// Cells that are passed over at a time where no labels meet.
const PASSED: usize = 16;

impl WithSimd for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { level, labels, width, cells } = self;
        let length = labels.len();
        if length > 2 {
            let (left, middle, right) = (&labels[..length - 2], &labels[1..], &labels[2..]);
            let sides = left.iter().zip(middle).zip(right);
            for (level, ((a, b), c)) in level[1..length - 1].iter_mut().zip(sides) {
                *level = (a ^ b) | (b ^ c);
            }
        }
        // The ends of the rows have one neighbour, or none.
        for first in (0..length).step_by(width) {
            let last = first + width - 1;
            level[first] = if width > 1 { labels[first] ^ labels[first + 1] } else { 0 };
            level[last] = if width > 1 { labels[last] ^ labels[last - 1] } else { 0 };
        }
        let (top, bottom) = (width.min(length), length - width.min(length));
        let above_of = |cells: Range<usize>| cells.start - width..cells.end - width;
        let below_of = |cells: Range<usize>| cells.start + width..cells.end + width;
        let rows = Rows { labels, level: &*level };
        if length == width {
            rows.list(0..width, &[], cells);
            return;
        }
        rows.list(0..top, &[below_of(0..top)], cells);
        for first in (top..bottom).step_by(PASSED) {
            let part = first..(first + PASSED).min(bottom);
            rows.list(part.clone(), &[above_of(part.clone()), below_of(part)], cells);
        }
        rows.list(bottom..length, &[above_of(bottom..length)], cells);
    }
}

/// Labels, and the bits in which each differs from those beside it.
struct Rows<'a> {
    labels: &'a [u32],
    level: &'a [u32],
}

impl Rows<'_> {
    /// Lists the cells of a part that differ from those beside them, or from the parts above and below.
    #[inline(always)]
    fn list(&self, part: Range<usize>, others: &[Range<usize>], cells: &mut Vec<u32>) {
        for first in part.clone().step_by(PASSED) {
            let labels = load(self.labels, first);
            let mut differs = load(self.level, first);
            for other in others {
                let at = other.start + first - part.start;
                let (beside, level) = (load(self.labels, at), load(self.level, at));
                for i in 0..PASSED {
                    differs[i] |= (labels[i] ^ beside[i]) | level[i];
                }
            }
            if differs.iter().fold(0, |all, differs| all | differs) == 0 {
                continue;
            }
            // What is loaded beyond the part is not of it.
            for (cell, i) in (first as u32..part.end as u32).zip(0..PASSED) {
                if differs[i] != 0 && labels[i] != NO_RETURN {
                    cells.push(cell);
                }
            }
        }
    }
}

/// So many numbers from a place on; zeros where there are no more.
#[inline(always)]
fn load(array: &[u32], first: usize) -> [u32; PASSED] {
    let rest = &array[first..];
    rest.first_chunk().copied().unwrap_or_else(|| {
        let mut few = [0; PASSED];
        few[..rest.len()].copy_from_slice(rest);
        few
    })
}

#[cfg(test)]
mod tests {
    use super::super::morphology::neighbours8;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn borders_are_those_of_the_definition(
            labels in prop::collection::vec(0..3_u32, 0..120),
            width in 1..9_usize,
        ) {
            let labels = &labels[..labels.len() / width * width];
            let mut cells = Vec::new();
            Borders::default().find(labels, width, &mut cells);
            let expected: Vec<u32> = (0..labels.len())
                .filter(|&c| neighbours8(c, width, labels.len()).any(|n| labels[n] != labels[c]))
                .map(|c| c as u32)
                .collect();
            prop_assert_eq!(cells, expected);
        }
    }
}
