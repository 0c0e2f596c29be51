//! Where labels change in an image of labels.

use super::compete::NO_RETURN;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Finds the cells at which two labels meet.
#[derive(Clone, Debug, Default)]
pub(super) struct Borders {
    /// The bits in which a cell's label differs from those of its neighbours in its row.
    level: Vec<u32>,
    /// Room for the cells that are listed.
    listed: Vec<u32>,
    /// By how much more of the neighbours of each cell that was listed have its label than have another
    /// one; those without a return have none. Less than any number where fewer than eight were looked at.
    pub leads: Vec<f32>,
}

/// The lead of a cell of which it is not known.
const UNKNOWN: f32 = f32::NEG_INFINITY;

impl Borders {
    /// Lists, in order, the cells whose label differs from that of one of their eight neighbours; those
    /// without a return are none.
    ///
    /// The whole image is compared, many cells at a time: most of a scan's are inside a region, and this
    /// costs them a few instructions each.
    pub fn find(&mut self, labels: &[u32], width: usize, cells: &mut Vec<u32>) {
        cells.clear();
        if width > 0 && !labels.is_empty() {
            let Self { level, listed, leads } = self;
            level.resize(labels.len(), 0);
            listed.resize(labels.len() + PASSED, 0);
            leads.resize(labels.len(), UNKNOWN);
            Arch::new().dispatch(Find { level, listed, leads, labels, width, cells });
        }
    }
}

/// One search; its loops are over arrays, so that they run on vectors of any width.
struct Find<'a> {
    level: &'a mut [u32],
    listed: &'a mut [u32],
    leads: &'a mut [f32],
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
        let Self { level, listed, leads, labels, width, cells } = self;
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
        let bottom = length - width;
        let rows = Rows { labels, level: &*level };
        if bottom == 0 {
            leads.fill(UNKNOWN);
            return rows.list_rim(0..width, &[], cells);
        }
        rows.list_rim(0..width, &[width], cells);
        rows.list_inside(width, listed, leads, cells);
        rows.list_rim(bottom..length, &[bottom - width], cells);
        leads[..width].fill(UNKNOWN);
        leads[bottom..].fill(UNKNOWN);
        for row in leads.chunks_exact_mut(width) {
            (row[0], row[width - 1]) = (UNKNOWN, UNKNOWN);
        }
    }
}

/// Labels, and the bits in which each differs from those beside it.
struct Rows<'a> {
    labels: &'a [u32],
    level: &'a [u32],
}

impl Rows<'_> {
    /// Lists the cells of a row that differ from those beside them, or from other rows.
    fn list_rim(&self, row: Range<usize>, others: &[usize], cells: &mut Vec<u32>) {
        for cell in row.clone() {
            let mut differs = self.level[cell];
            for other in others {
                let other = other + cell - row.start;
                differs |= (self.labels[cell] ^ self.labels[other]) | self.level[other];
            }
            if differs != 0 && self.labels[cell] != NO_RETURN {
                cells.push(cell as u32);
            }
        }
    }

    /// Lists the same of all rows with one above and one below.
    #[inline(always)]
    fn list_inside(
        &self,
        width: usize,
        listed: &mut [u32],
        leads: &mut [f32],
        cells: &mut Vec<u32>,
    ) {
        let bottom = self.labels.len() - width;
        // From the second cell on, the cells above and below have others on both sides.
        let mut first = (width + 1).min(bottom);
        for cell in width..first {
            self.list_rim(cell..cell + 1, &[cell - width, cell + width], cells);
        }
        let parts = |array| {
            let [above, here, below] = three_rows(array, width);
            above.iter().zip(here).zip(below)
        };
        let labels = parts(self.labels);
        let mut count = 0;
        for (((la, l), lb), ((va, v), vb)) in labels.zip(parts(self.level)) {
            let mut differs = [0; PASSED];
            let mut all = 0;
            for i in 0..PASSED {
                let sides = (la[i] ^ l[i]) | (l[i] ^ lb[i]);
                differs[i] = sides | va[i] | v[i] | vb[i];
                all |= differs[i];
            }
            if all != 0 {
                // Written one over the other: which of them are listed is hard to foretell.
                let part: &mut [u32; PASSED] =
                    listed[count..].first_chunk_mut().expect("there is room for a part more");
                let mut some = 0;
                for (cell, (differs, label)) in (first as u32..).zip(differs.iter().zip(l)) {
                    part[some % PASSED] = cell;
                    some += usize::from((*differs != 0) & (*label != NO_RETURN));
                }
                count += some;
                leads[first..first + PASSED].copy_from_slice(&self.leads(first, width));
            }
            first += PASSED;
        }
        cells.extend_from_slice(&listed[..count]);
        leads[first..bottom].fill(UNKNOWN);
        for cell in first..bottom {
            self.list_rim(cell..cell + 1, &[cell - width, cell + width], cells);
        }
    }

    /// The leads of cells from one on, all of which have eight neighbours.
    #[inline(always)]
    fn leads(&self, first: usize, width: usize) -> [f32; PASSED] {
        let row = |begin: usize| -> &[u32; PASSED + 2] {
            self.labels[begin..].first_chunk().expect("all cells have eight neighbours")
        };
        let [above, here, below] = [row(first - width - 1), row(first - 1), row(first + width - 1)];
        std::array::from_fn(|i| {
            let own = here[i + 1];
            // Those with another label count one less than those without a return, and these one less than
            // those with its own.
            let mut votes = 0_i32;
            for near in [&above[i..i + 3], &[here[i], here[i + 2]], &below[i..i + 3]] {
                for &label in near {
                    votes += 2 * i32::from(label == own) + i32::from(label == NO_RETURN);
                }
            }
            (votes - 8) as f32
        })
    }
}

/// The same columns of three rows of an array each, from the second cell of its second row on, in whole
/// parts; all cells have neighbours on both sides.
#[inline(always)]
fn three_rows(array: &[u32], width: usize) -> [&[[u32; PASSED]]; 3] {
    let Some(count) = array.len().checked_sub(2 * width + 2) else { return [&[]; 3] };
    let part = |first: usize| array[first..first + count].as_chunks().0;
    [part(1), part(width + 1), part(2 * width + 1)]
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
