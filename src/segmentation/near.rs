//! The eight neighbours of a cell of an image of labels, compared at once.

use wide::u32x4;

/// The bits of all eight neighbours: four for the row above, four for the cell's own, of which the
/// second one is the cell, and four for the row below; the fourth of each is no neighbour.
pub(super) const ALL: u32 = 0b0111_0101_0111;

/// Which cells of an image are so near its rim that not all neighbours can be loaded as vectors.
#[derive(Clone, Debug, Default)]
pub(super) struct Rim {
    width: usize,
    is_on: Vec<bool>,
}

impl Rim {
    /// Takes over an image's size.
    pub fn set_size(&mut self, width: usize, length: usize) {
        if (self.width, self.is_on.len()) == (width, length) {
            return;
        }
        self.width = width;
        self.is_on.clear();
        self.is_on.extend((0..length).map(|cell| {
            let lane = cell % width;
            lane == 0 || lane + 1 == width || cell < width || cell + width + 2 >= length
        }));
    }

    pub fn is_on(&self, cell: usize) -> bool {
        self.is_on[cell]
    }
}

/// The labels around a cell that is not on the rim.
#[derive(Clone, Copy)]
pub(super) struct Near {
    /// The fourth of each row is no neighbour.
    rows: [u32x4; 3],
}

impl Near {
    #[inline(always)]
    pub fn of(labels: &[u32], cell: usize, width: usize) -> Self {
        let row = |first: usize| {
            let row = labels[first..].first_chunk().expect("cells off the rim have room");
            u32x4::new(*row)
        };
        Self { rows: [row(cell - width - 1), row(cell - 1), row(cell + width - 1)] }
    }

    /// The labels of up to eight neighbours of a cell that is; `none` stands for those that there are
    /// not.
    pub fn on_rim(labels: &[u32], cell: usize, width: usize, none: u32) -> Self {
        let (lane, length) = (cell % width, labels.len());
        let rows = [
            (cell >= width, cell.wrapping_sub(width)),
            (true, cell),
            (cell + width < length, cell + width),
        ];
        Self {
            rows: rows.map(|(present, middle)| {
                let at = |inside: bool, cell: usize| {
                    if present && inside { labels[cell] } else { none }
                };
                let left = at(lane > 0, middle.wrapping_sub(1));
                u32x4::new([
                    left,
                    at(true, middle),
                    at(lane + 1 < width, middle.wrapping_add(1)),
                    none,
                ])
            }),
        }
    }

    /// The bits of the neighbours with a label.
    #[inline(always)]
    pub fn with(&self, label: u32) -> u32 {
        let label = u32x4::splat(label);
        let [above, beside, below] = self.rows;
        let above = above.simd_eq(label).to_bitmask();
        let beside = beside.simd_eq(label).to_bitmask();
        let below = below.simd_eq(label).to_bitmask();
        (above | beside << 4 | below << 8) & ALL
    }
}

/// The cell of a neighbour that has a bit.
#[inline(always)]
pub(super) fn neighbour(cell: usize, width: usize, bit: u32) -> usize {
    let (row, column) = (bit as usize / 4, bit as usize % 4);
    (cell + row * width + column).wrapping_sub(width + 1)
}

#[cfg(test)]
mod tests {
    use super::super::morphology::neighbours8;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn neighbours_are_those_of_the_definition(
            labels in prop::collection::vec(0..3_u32, 0..120),
            width in 1..9_usize,
        ) {
            let labels = &labels[..labels.len() / width * width];
            let mut rim = Rim::default();
            rim.set_size(width, labels.len());
            for cell in 0..labels.len() {
                let near = if rim.is_on(cell) {
                    Near::on_rim(labels, cell, width, 9)
                } else {
                    Near::of(labels, cell, width)
                };
                for label in 0..3 {
                    let bits = near.with(label);
                    let found: Vec<usize> = (0..12)
                        .filter(|bit| bits & 1 << bit != 0)
                        .map(|bit| neighbour(cell, width, bit))
                        .collect();
                    let expected: Vec<usize> = neighbours8(cell, width, labels.len())
                        .filter(|&n| labels[n] == label)
                        .collect();
                    prop_assert_eq!(found, expected);
                }
            }
        }
    }
}
