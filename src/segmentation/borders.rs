//! Where labels change in an image of labels.

use pulp::{Arch, Simd, WithSimd};

/// Finds the cells at which two labels meet.
#[derive(Clone, Debug, Default)]
pub(super) struct Borders {
    /// The bits in which a cell's label differs from those of its neighbours in its row.
    level: Vec<u32>,
    /// The bits in which a cell of the row at hand differs from any neighbour.
    around: Vec<u32>,
}

impl Borders {
    /// Lists, in order, the cells whose label differs from that of one of their eight neighbours.
    ///
    /// Whole rows are compared at a time: most cells of a scan are inside a region, and this costs
    /// them a few instructions each.
    pub fn find(&mut self, labels: &[u32], width: usize, cells: &mut Vec<u32>) {
        cells.clear();
        if width > 0 {
            self.level.resize(labels.len(), 0);
            Arch::new().dispatch(Find { borders: self, labels, width, cells });
        }
    }
}

/// One search; its loops are over arrays, so that they run on vectors of any width.
struct Find<'a> {
    borders: &'a mut Borders,
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
        let Self { borders: Borders { level, around }, labels, width, cells } = self;
        for (row, level) in labels.chunks_exact(width).zip(level.chunks_exact_mut(width)) {
            if width == 1 {
                level[0] = 0;
                continue;
            }
            level[0] = row[0] ^ row[1];
            level[width - 1] = row[width - 1] ^ row[width - 2];
            let (left, middle, right) = (&row[..width - 2], &row[1..width - 1], &row[2..]);
            let sides = left.iter().zip(middle).zip(right);
            for (level, ((a, b), c)) in level[1..width - 1].iter_mut().zip(sides) {
                *level = (a ^ b) | (b ^ c);
            }
        }
        let rows = labels.len() / width;
        for row in 0..rows {
            let span = row * width..(row + 1) * width;
            around.clear();
            around.extend_from_slice(&level[span.clone()]);
            for other in [row.wrapping_sub(1), row + 1] {
                if other < rows {
                    let beside = other * width..(other + 1) * width;
                    let both = labels[span.clone()].iter().zip(&labels[beside.clone()]);
                    for ((around, (a, b)), level) in around.iter_mut().zip(both).zip(&level[beside])
                    {
                        *around |= (a ^ b) | level;
                    }
                }
            }
            let (parts, rest) = around.as_chunks::<PASSED>();
            let mut first = span.start as u32;
            for part in parts {
                if part.iter().fold(0, |all, differs| all | differs) != 0 {
                    list(part, first, cells);
                }
                first += PASSED as u32;
            }
            list(rest, first, cells);
        }
    }
}

/// Lists the cells that differ, the first of which is given.
fn list(differing: &[u32], first: u32, cells: &mut Vec<u32>) {
    for (cell, &differs) in (first..).zip(differing) {
        if differs != 0 {
            cells.push(cell);
        }
    }
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
