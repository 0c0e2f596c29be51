//! Which regions touch.

use super::compete::NO_RETURN;

/// Regions, with none, of which it is kept in bits which ones touch: nearly all scans have fewer.
const FEW: usize = WORDS * 64 - 1;
/// The bit of what is no region, as is that of zero.
const NONE_BIT: u32 = FEW as u32;
/// Words of the bits of a region: one is shifted faster than a number that is twice as wide.
const WORDS: usize = 2;
/// Pairs that are remembered while others are listed.
const LATELY: usize = 256;

/// Pairs of regions as they are found, any number of times each.
#[derive(Clone, Debug)]
pub(super) struct Touching {
    /// Regions, with none.
    count: usize,
    /// For each of few regions the bits of those that it was found to touch.
    bits: [[u64; WORDS]; FEW],
    /// Of many regions: the pairs, and those that were listed lately, each at a place that its labels
    /// give: most come again.
    pairs: Vec<(u32, u32)>,
    lately: [(u32, u32); LATELY],
}

impl Default for Touching {
    fn default() -> Self {
        Self { count: 0, bits: [[0; WORDS]; FEW], pairs: Vec::new(), lately: [(0, 0); LATELY] }
    }
}

impl Touching {
    /// Forgets all pairs; `count` is above all labels of regions.
    pub fn start(&mut self, count: usize) {
        self.count = count;
        self.pairs.clear();
        if count <= FEW {
            self.bits[..count].fill([0; WORDS]);
        } else {
            self.lately.fill((0, 0));
        }
    }

    /// Adds what a region touches; its own label and those of no region do not count.
    #[inline]
    pub fn add(&mut self, region: u32, others: impl Iterator<Item = u32>) {
        if self.count <= FEW {
            let bits = &mut self.bits[region as usize];
            for other in others {
                let other = other.min(NONE_BIT);
                bits[(other / 64) as usize] |= 1 << (other % 64);
            }
        } else {
            others.for_each(|other| self.push(region, other));
        }
    }

    fn push(&mut self, a: u32, b: u32) {
        if a == b || b == 0 || b == NO_RETURN {
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
        let all = |bits: [u64; WORDS]| u128::from(bits[0]) | u128::from(bits[1]) << 64;
        for a in 1..self.count {
            // Those before it go along with the other one.
            let mut before = all(self.bits[a]) & ((1 << a) - 2);
            while before != 0 {
                self.bits[before.trailing_zeros() as usize][a / 64] |= 1 << (a % 64);
                before &= before - 1;
            }
        }
        for a in 1..self.count {
            let mut after = all(self.bits[a]) & !(1 << NONE_BIT) & (u128::MAX << a << 1);
            while after != 0 {
                pairs.push((a as u32, after.trailing_zeros()));
                after &= after - 1;
            }
        }
    }
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
            let other = |b: u32| if b == NONE_BIT { NO_RETURN } else { b };
            let expected: BTreeSet<(u32, u32)> = found
                .iter()
                .filter(|&&(a, b)| a != b && b != 0 && b != NONE_BIT)
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
