//! Which regions touch.

use super::compete::NO_RETURN;

/// Regions, with none, of which it is kept in a table which ones touch: nearly all scans have fewer.
const FEW: usize = 127;
/// Places of the table. The last one is that of what has no return, whose lowest bits are all set; it and
/// that of zero are no region's.
const PLACES: usize = FEW + 1;
/// Pairs that are remembered while others are listed.
const LATELY: usize = 256;

/// Pairs of regions as they are found, any number of times each.
#[derive(Clone, Debug)]
pub(super) struct Touching {
    /// Regions, with none.
    count: usize,
    /// For each of few regions those that it was found to touch, and room for bits of these: a byte is
    /// written with fewer instructions than a bit.
    table: Box<[[bool; PLACES]; PLACES]>,
    bits: Vec<u128>,
    /// Of many regions: the pairs, and those that were listed lately, each at a place that its labels
    /// give: most come again.
    pairs: Vec<(u32, u32)>,
    lately: [(u32, u32); LATELY],
}

impl Default for Touching {
    fn default() -> Self {
        let (table, bits) = (Box::new([[false; PLACES]; PLACES]), Vec::with_capacity(FEW));
        Self { count: 0, table, bits, pairs: Vec::new(), lately: [(0, 0); LATELY] }
    }
}

impl Touching {
    /// Forgets all pairs; `count` is above all labels of regions.
    pub fn start(&mut self, count: usize) {
        self.count = count;
        self.pairs.clear();
        if count <= FEW {
            self.table[..count].fill([false; PLACES]);
        } else {
            self.lately.fill((0, 0));
        }
    }

    /// Adds what a cell's label touches; neither its own one nor those of no region count.
    #[inline]
    pub fn add(&mut self, label: u32, others: impl Iterator<Item = u32>) {
        if self.count <= FEW {
            let row = &mut self.table[label as usize % PLACES];
            for other in others {
                row[other as usize % PLACES] = true;
            }
        } else {
            others.for_each(|other| self.push(label, other));
        }
    }

    fn push(&mut self, a: u32, b: u32) {
        if a == b || a.min(b) == 0 || a.max(b) == NO_RETURN {
            return;
        }
        let pair = (a.min(b), a.max(b));
        let lately = &mut self.lately[(pair.0 * 37 + pair.1) as usize % LATELY];
        if *lately != pair {
            *lately = pair;
            self.pairs.push(pair);
        }
    }

    /// Lists the pairs, each once and in order, the smaller number first.
    pub fn list(&mut self, pairs: &mut Vec<(u32, u32)>) {
        pairs.clear();
        if self.count > FEW {
            pairs.extend_from_slice(&self.pairs);
            sort(pairs);
            return;
        }
        self.bits.clear();
        self.bits.extend(self.table[..self.count].iter().map(bits_of));
        for a in 1..self.count {
            // Those before it go along with the other one.
            let mut before = self.bits[a] & ((1 << a) - 2);
            while before != 0 {
                self.bits[before.trailing_zeros() as usize] |= 1 << a;
                before &= before - 1;
            }
        }
        for a in 1..self.count {
            let mut after = self.bits[a] & !(1 << FEW) & (u128::MAX << a << 1);
            while after != 0 {
                pairs.push((a as u32, after.trailing_zeros()));
                after &= after - 1;
            }
        }
    }
}

/// The numbers of those that hold as bits.
fn bits_of(row: &[bool; PLACES]) -> u128 {
    let mut bits = 0;
    for (place, part) in row.as_chunks::<8>().0.iter().enumerate() {
        // The product brings the lowest bit of each byte to its place in the uppermost byte.
        let bytes = u64::from_le_bytes(part.map(u8::from));
        bits |= u128::from(bytes.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * place);
    }
    bits
}

/// Puts pairs in order, each once.
pub(super) fn sort(pairs: &mut Vec<(u32, u32)>) {
    // One comparison of a number for each pair.
    pairs.sort_unstable_by_key(|&(a, b)| u64::from(a) << 32 | u64::from(b));
    pairs.dedup();
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn few_and_many_regions_are_listed_alike(
            found in prop::collection::vec((1..FEW as u32, 0..FEW as u32 + 1), 0..300),
        ) {
            let other = |b: u32| if b == FEW as u32 { NO_RETURN } else { b };
            let expected: BTreeSet<(u32, u32)> = found
                .iter()
                .filter(|&&(a, b)| a != b && b != 0 && b != FEW as u32)
                .map(|&(a, b)| (a.min(b), a.max(b)))
                .collect();
            let mut touching = Touching::default();
            let mut pairs = Vec::new();
            for count in [FEW, FEW + 1, FEW] {
                touching.start(count);
                for &(a, b) in &found {
                    touching.add(a, std::iter::once(other(b)));
                }
                touching.list(&mut pairs);
                prop_assert!(pairs.iter().eq(&expected));
            }
        }
    }
}
