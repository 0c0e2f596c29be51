//! Where labels change in an image of labels.

/// Finds the cells at which two labels meet.
#[derive(Clone, Debug, Default)]
pub(super) struct Borders {
    /// Whether a cell has the label of both its neighbours in its row.
    level: Vec<u8>,
    /// Whether a cell of the row at hand has the label of all its neighbours.
    inner: Vec<u8>,
}

impl Borders {
    /// Lists, in order, the cells whose label differs from that of one of their eight neighbours.
    ///
    /// Whole rows are compared at a time: most cells of a scan are inside a region, and this costs
    /// them a few instructions each.
    pub fn find(&mut self, labels: &[u32], width: usize, cells: &mut Vec<u32>) {
        cells.clear();
        if width == 0 {
            return;
        }
        self.level.resize(labels.len(), 1);
        for (row, level) in labels.chunks_exact(width).zip(self.level.chunks_exact_mut(width)) {
            level[0] = u8::from(width == 1 || row[0] == row[1]);
            level[width - 1] = u8::from(width == 1 || row[width - 1] == row[width - 2]);
            if width > 2 {
                let (left, middle, right) = (&row[..width - 2], &row[1..width - 1], &row[2..]);
                let sides = left.iter().zip(middle).zip(right);
                for (level, ((a, b), c)) in level[1..width - 1].iter_mut().zip(sides) {
                    *level = u8::from((a == b) & (b == c));
                }
            }
        }
        let rows = labels.len() / width;
        for row in 0..rows {
            let span = row * width..(row + 1) * width;
            self.inner.clear();
            self.inner.extend_from_slice(&self.level[span.clone()]);
            for other in [row.wrapping_sub(1), row + 1] {
                if other < rows {
                    let beside = other * width..(other + 1) * width;
                    let same = labels[span.clone()].iter().zip(&labels[beside.clone()]);
                    let level = &self.level[beside];
                    for ((inner, (a, b)), level) in self.inner.iter_mut().zip(same).zip(level) {
                        *inner &= u8::from(a == b) & level;
                    }
                }
            }
            for (lane, &inner) in self.inner.iter().enumerate() {
                if inner == 0 {
                    cells.push((span.start + lane) as u32);
                }
            }
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
