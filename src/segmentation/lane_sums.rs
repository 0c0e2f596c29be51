//! Sums along lanes, so that those of any run are differences of two.

use pulp::{Arch, Simd, WithSimd};

/// For each lane of a block: sums of the inverse ranges, of their products with the positions of their
/// steps and of their squares, up to each step, from "nothing yet" on.
///
/// Double precision loses nothing by the difference: the squares of a lane add up to some hundreds per
/// square metre, and what a run scatters by is above 1e-9 per square metre.
#[derive(Clone, Debug, Default)]
pub(super) struct LaneSums {
    width: usize,
    sums: Vec<[[f64; LANES]; 3]>,
}

/// Lanes that are added up at a time; a block has some times as many.
const LANES: usize = 8;

impl LaneSums {
    /// Takes over the inverse ranges of a block of so many lanes, step by step.
    pub fn sum_up(&mut self, inverse: &[f32], lanes: usize, positions: &[f32]) {
        self.width = lanes / LANES;
        self.sums.resize((positions.len() + 1) * self.width, [[0.0; LANES]; 3]);
        let (inverse, _) = inverse.as_chunks();
        let width = self.width;
        Arch::new().dispatch(SumUp { inverse, width, positions, sums: &mut self.sums });
    }

    /// The sums of a lane of the block over `begin..end` steps.
    pub fn between(&self, lane: usize, begin: usize, end: usize) -> [f64; 3] {
        let (part, lane) = (lane / LANES, lane % LANES);
        let low = &self.sums[begin * self.width + part];
        let high = &self.sums[end * self.width + part];
        [high[0][lane] - low[0][lane], high[1][lane] - low[1][lane], high[2][lane] - low[2][lane]]
    }
}

/// One summation; its loops are over arrays, so that they run on vectors of any width.
struct SumUp<'a> {
    inverse: &'a [[f32; LANES]],
    width: usize,
    positions: &'a [f32],
    sums: &'a mut [[[f64; LANES]; 3]],
}

impl WithSimd for SumUp<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { inverse, width, positions, sums } = self;
        for part in 0..if inverse.is_empty() { 0 } else { width } {
            let mut sum = [[0.0; LANES]; 3];
            sums[part] = sum;
            let parts = inverse[part..].iter().step_by(width);
            let ends = sums[width + part..].iter_mut().step_by(width);
            for ((end, inverse), &position) in ends.zip(parts).zip(positions) {
                let position = f64::from(position);
                for lane in 0..LANES {
                    let f = f64::from(inverse[lane]);
                    sum[0][lane] += f;
                    sum[1][lane] += position * f;
                    sum[2][lane] += f * f;
                }
                *end = sum;
            }
        }
    }
}
