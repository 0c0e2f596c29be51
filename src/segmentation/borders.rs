//! Where labels change in an image of labels.

use super::around::{Around, Code, Label, bits, list_bits, words};
use super::compete::NO_RETURN;
use pulp::{Arch, Simd, WithSimd};
use wide::u8x16;

/// Finds the cells at which two labels meet.
#[derive(Clone, Debug, Default)]
pub(super) struct Borders {
    around: Around,
    /// What `Lead` tells of each cell.
    leads: Vec<u8>,
    /// Room for the cells that are listed.
    listed: Vec<u32>,
}

/// By how much more of the neighbours of a cell have its label than have another one, those without a
/// return none; `INSIDE` where none has another one, or the cell has no return.
struct Lead;

const INSIDE: u8 = 8;
/// The lead of a cell of which it is not known: less than any other.
const UNKNOWN: u8 = i8::MIN as u8;

impl Code for Lead {
    #[inline(always)]
    fn of<T: Label>(own: T, _: T, same: T, none: T) -> u8 {
        // Those with another label count one less than those without a return, and these one less than
        // those with its own.
        let lead = (same + same + none).byte().wrapping_sub(8);
        if own == T::narrow(NO_RETURN) { INSIDE } else { lead }
    }
}

impl Borders {
    /// Lists, in order, the cells whose label differs from that of one of their eight neighbours; those
    /// without a return are none. Labels are below `count`.
    ///
    /// The whole image is compared, many cells at a time: most of a scan's are inside a region, and this
    /// costs them a few instructions each.
    pub fn find(&mut self, labels: &[u32], (width, count): (usize, usize), cells: &mut Vec<u32>) {
        let Self { around, leads, listed } = self;
        cells.clear();
        around.look::<Lead>(labels, (width, count), leads);
        leads[labels.len()..].fill(INSIDE);
        let inner = &mut leads[..labels.len()];
        let forget = |lead: &mut u8| *lead = if *lead == INSIDE { INSIDE } else { UNKNOWN };
        for row in inner.chunks_exact_mut(width.max(1)) {
            forget(&mut row[0]);
            forget(&mut row[width - 1]);
        }
        let end = inner.len().min(width);
        inner[..end].iter_mut().for_each(forget);
        let bottom = inner.len() - end;
        inner[bottom..].iter_mut().for_each(forget);
        listed.resize(leads.len(), 0);
        let count = Arch::new().dispatch(List { leads, listed });
        cells.extend_from_slice(&listed[..count]);
    }

    /// By how much more of the neighbours of each cell have its label than have another one, where it is
    /// listed; less than any number where fewer than eight were looked at.
    pub fn leads(&self) -> &[u8] {
        &self.leads
    }

    /// Whether a cell was listed.
    pub fn is_listed(&self, cell: usize) -> bool {
        self.leads[cell] != INSIDE
    }

    /// Takes a cell for a listed one.
    pub fn add(&mut self, cell: usize) {
        self.leads[cell] = UNKNOWN;
    }
}

/// Lists the cells that are not inside.
struct List<'a> {
    leads: &'a [u8],
    listed: &'a mut [u32],
}

impl WithSimd for List<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        let inside = u8x16::splat(INSIDE);
        let words = words(self.leads).iter();
        list_bits(words.map(|leads| !bits(leads, |leads| leads.simd_eq(inside))), self.listed)
    }
}

#[cfg(test)]
mod tests {
    use super::super::morphology::neighbours8;
    use super::*;
    use proptest::prelude::*;

    /// One of the labels 1 and 2 as one of the two greatest of so many.
    fn high(label: u32, count: u32) -> u32 {
        if matches!(label, 1 | 2) { label + count - 3 } else { label }
    }

    proptest! {
        #[test]
        fn borders_are_those_of_the_definition(
            labels in prop::collection::vec(
                prop::sample::select(vec![0, 1, 2, NO_RETURN]),
                0..120,
            ),
            width in 1..50_usize,
        ) {
            let labels = &labels[..labels.len() / width * width];
            let expected: Vec<u32> = (0..labels.len())
                .filter(|&c| labels[c] != NO_RETURN)
                .filter(|&c| neighbours8(c, width, labels.len()).any(|n| labels[n] != labels[c]))
                .map(|c| c as u32)
                .collect();
            let mut cells = Vec::new();
            // Labels of each width, up to the greatest that there is.
            for count in [3, 255, 256, 65_535, 65_536] {
                let labels: Vec<u32> =
                    labels.iter().map(|&label| high(label, count)).collect();
                Borders::default().find(&labels, (width, count as usize), &mut cells);
                prop_assert_eq!(&cells, &expected);
            }
        }
    }
}
