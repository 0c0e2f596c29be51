//! Sums along lanes, so that those of any run are differences of two.

use super::cut::Block;
use pulp::{Arch, Simd, WithSimd};

/// For each lane of a block: sums of the inverse ranges, of their products with the positions of their
/// steps and of their squares, up to each step, from "nothing yet" on.
///
/// Double precision loses nothing by the difference: the squares of a lane add up to some hundreds per
/// square metre, and what a run scatters by is above 1e-9 per square metre.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneSums {
    width: usize,
    sums: [Vec<f64>; 3],
}

impl LaneSums {
    /// Takes over a block.
    pub fn sum_up(&mut self, block: Block, positions: &[f32]) {
        self.width = block.width;
        for sums in &mut self.sums {
            sums.resize((positions.len() + 1) * block.width, 0.0);
            sums[..block.width].fill(0.0);
        }
        Arch::new().dispatch(SumUp { block, positions, sums: &mut self.sums });
    }

    /// The sums of a lane of the block over `begin..end` steps.
    pub fn between(&self, lane: usize, begin: usize, end: usize) -> [f64; 3] {
        let (low, high) = (begin * self.width + lane, end * self.width + lane);
        self.sums.each_ref().map(|sums| sums[high] - sums[low])
    }
}

/// One summation; its loop is over arrays, so that it runs on vectors of any width.
struct SumUp<'a> {
    block: Block<'a>,
    positions: &'a [f32],
    sums: &'a mut [Vec<f64>; 3],
}

impl WithSimd for SumUp<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { block: Block { width, inverse }, positions, sums: [first, product, square] } =
            self;
        for (step, &position) in positions.iter().enumerate() {
            let position = f64::from(position);
            let (before, here) = (step * width, (step + 1) * width);
            let inverse = &inverse[before..here];
            let (first, next) = first[before..here + width].split_at_mut(width);
            for ((sum, next), &f) in first.iter().zip(next).zip(inverse) {
                *next = sum + f64::from(f);
            }
            let (product, next) = product[before..here + width].split_at_mut(width);
            for ((sum, next), &f) in product.iter().zip(next).zip(inverse) {
                *next = sum + position * f64::from(f);
            }
            let (square, next) = square[before..here + width].split_at_mut(width);
            for ((sum, next), &f) in square.iter().zip(next).zip(inverse) {
                *next = sum + f64::from(f) * f64::from(f);
            }
        }
    }
}
