//! One column of the lattice: what was hit and what was passed through, by height.

use serde::{Deserialize, Serialize};

/// Height of one bin of a column in metres.
pub(super) const BIN_M: f64 = 0.05;

/// Bins in one slab of a column: 3.2 m.
pub(super) const BINS: i32 = 64;

/// A slab's lowest bin lies this many bins below a multiple of [`BINS`], so that a floor at the
/// start's height and the robot's band above it share one slab.
const SLAB_BELOW: i32 = 28;

/// Evidence a hit adds and a ray that passes takes away: a moved object that was hit once is gone
/// after two sweeps that look through it, one that was hit often after six.
const HIT_WEIGHT: u32 = 3;

/// Evidence from which on a bin counts as occupied.
const OCCUPIED: u32 = 2;

/// The bin that holds height `z_m`.
pub(super) fn bin_of(z_m: f64) -> i32 {
    (z_m / BIN_M).floor() as i32
}

/// The slab that holds `bin`, and the bit of the bin in it.
pub(super) fn slab_of(bin: i32) -> (i16, u32) {
    let shifted = bin + SLAB_BELOW;
    (shifted.div_euclid(BINS) as i16, shifted.rem_euclid(BINS) as u32)
}

/// Bits `low..=high` cut to a word; none when the range lies outside or is empty.
pub(super) fn bits(low: i32, high: i32) -> u64 {
    if high < 0 || low >= BINS || low > high {
        return 0;
    }
    let (low, high) = (low.max(0) as u32, high.min(BINS - 1) as u32);
    (u64::MAX << low) & (u64::MAX >> (63 - high))
}

/// Sixty-four bins above one cell, each with a saturating counter of three bits kept as bit planes,
/// so that all bins are updated at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Column {
    passed: u64,
    planes: [u64; 3],
}

impl Column {
    /// Takes in what one image saw here. A bin that was hit is not cleared by rays of the same image
    /// that pass beside the surface: a pole thinner than a cell must not erase itself.
    pub fn update(&mut self, hit: u64, passed: u64) {
        let passed = passed & !hit;
        for _ in 0..HIT_WEIGHT {
            self.increment(hit);
        }
        self.decrement(passed);
        self.passed = (self.passed | passed) & !hit;
    }

    fn increment(&mut self, mask: u64) {
        let [low, middle, high] = self.planes;
        let mask = mask & !(low & middle & high);
        let carry = low & mask;
        self.planes[0] ^= mask;
        self.planes[1] ^= carry;
        self.planes[2] ^= middle & carry;
    }

    fn decrement(&mut self, mask: u64) {
        let [low, middle, high] = self.planes;
        let mask = mask & (low | middle | high);
        let borrow = !low & mask;
        self.planes[0] ^= mask;
        self.planes[1] ^= borrow;
        self.planes[2] ^= !middle & borrow;
    }

    /// The bins that count as occupied.
    pub fn occupied(&self) -> u64 {
        const { assert!(OCCUPIED == 2) };
        self.planes[1] | self.planes[2]
    }

    /// The bins that more than one image has hit.
    pub fn confirmed(&self) -> u64 {
        const { assert!(HIT_WEIGHT < 4) };
        self.planes[2]
    }

    /// The bins a ray has passed through since they were last hit.
    pub fn passed(&self) -> u64 {
        self.passed
    }

    /// Evidence of one bin, 0 to 7.
    #[cfg(test)]
    fn weight(&self, bit: u32) -> u32 {
        (0..3).map(|plane| ((self.planes[plane] >> bit & 1) as u32) << plane).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_bit_planes_count_like_saturating_counters(
            updates in prop::collection::vec((any::<u64>(), any::<u64>()), 1..40),
        ) {
            let mut column = Column::default();
            let mut counters = [0_u32; 64];
            for (hit, passed) in updates {
                column.update(hit, passed);
                for (bit, counter) in counters.iter_mut().enumerate() {
                    if hit >> bit & 1 == 1 {
                        *counter = (*counter + HIT_WEIGHT).min(7);
                    } else if passed >> bit & 1 == 1 {
                        *counter = counter.saturating_sub(1);
                    }
                }
            }
            for (bit, counter) in counters.iter().enumerate() {
                prop_assert_eq!(column.weight(bit as u32), *counter);
                prop_assert_eq!(column.occupied() >> bit & 1 == 1, *counter >= OCCUPIED);
            }
        }

        #[test]
        fn every_bin_has_one_slab_and_bit(bin in -10_000_i32..10_000) {
            let (slab, bit) = slab_of(bin);
            prop_assert_eq!(i32::from(slab) * BINS + bit as i32 - SLAB_BELOW, bin);
        }
    }

    #[test]
    fn bit_ranges_are_cut_to_the_word() {
        assert_eq!(bits(0, 63), u64::MAX);
        assert_eq!(bits(-5, 1), 0b11);
        assert_eq!(bits(62, 90), 0b11 << 62);
        assert_eq!(bits(4, 3) | bits(64, 70) | bits(-4, -1), 0);
    }

    #[test]
    fn what_moved_away_is_forgotten_after_a_few_sweeps() {
        let mut column = Column::default();
        column.update(1, 0);
        assert_eq!(column.occupied(), 1);
        column.update(0, 1);
        assert_eq!(column.occupied(), 1, "one look through is not enough");
        column.update(0, 1);
        assert_eq!(column.occupied(), 0);
    }
}
