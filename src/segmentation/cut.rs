//! The optimal cut of lanes into runs whose inverse range is a straight line.
//!
//! A dynamic programme over the steps, for as many lanes at once as the processor's vectors hold. The
//! error of a line that is continued backwards by one reading is what it was and the squared error of
//! its prediction of that reading, times a factor that depends on the positions of the steps alone:
//! so a longer line costs a few operations more, and no difference of large sums is taken.

use super::field::Field;
use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Most cells of a run.
pub(super) const LONGEST: usize = 16;
/// Price of a run in units of the noise variance: chance breaks gain about 2 ln(2 L) = 7.
const PRICE: f32 = 9.0;
/// What a run of one cell is cheaper: it has no slope.
const NO_SLOPE: f32 = 2.5;
/// Tangent of the angle of incidence up to which slopes are expected. It keeps a cell of its own
/// from forming a line with any one cell beside it.
const SLOPE: f32 = 6.0;
/// Longest runs, less one cell, of which that expectation is asked: from five cells on the readings
/// tell the slope themselves.
const DOUBTED: usize = 3;
/// Bits of a cost that give way to the length of its run, less one: the least of such costs brings
/// its length with it. What is left of the cost is good to one part in a million.
const LENGTH_BITS: u32 = LONGEST as u32 - 1;
/// Values in the table of a length.
const TABLE: usize = 7;

/// Buffers of the cut. What is kept of cells stands block after block of lanes, each from its first
/// step on, and each step's lanes together; the last block is filled up with cells without a return.
#[derive(Clone, Debug, Default)]
pub(super) struct Cutter {
    /// Lanes of a block.
    width: usize,
    steps: usize,
    /// Inverse ranges, per metre.
    pub inverse: Vec<f32>,
    /// One over the noise of the inverse range at each cell.
    sharpness: Vec<f32>,
    /// Least cost of each lane up to each step, from "nothing yet" on, with the price of a run more.
    cost: Vec<f32>,
    /// Length, less one, of the run that ends at each cell, if one does.
    length: Vec<u32>,
    /// What depends on the positions of a run's steps alone, for runs of two cells on, each value as
    /// often as a block has lanes.
    tables: Vec<f32>,
}

impl Cutter {
    /// Cuts all lanes of a field.
    pub fn cut(&mut self, field: &Field) {
        let cut = Cut { cutter: self, field };
        match Arch::new() {
            // Four at a time is what any processor does well.
            Arch::Scalar => Scalar128b.vectorize(cut),
            arch => arch.dispatch(cut),
        }
    }

    /// Where the first step of a lane is kept, and how far apart its steps are.
    pub fn place(&self, lane: usize) -> (usize, usize) {
        (lane / self.width * self.steps * self.width + lane % self.width, self.width)
    }

    /// Cells of the run that ends at a place.
    pub fn length(&self, place: usize) -> usize {
        self.length[place] as usize + 1
    }
}

/// One cut, for vectors of some width.
struct Cut<'a> {
    cutter: &'a mut Cutter,
    field: &'a Field,
}

impl WithSimd for Cut<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { cutter, field } = self;
        let (width, steps) = (S::F32_LANES, field.steps);
        let blocks = field.lanes.div_ceil(width);
        (cutter.width, cutter.steps) = (width, steps);
        let cells = blocks * steps * width;
        cutter.inverse.resize(cells, 0.0);
        cutter.sharpness.resize(cells, 0.0);
        cutter.length.resize(cells, 0);
        cutter.cost.clear();
        cutter.cost.resize(cells + blocks * width, PRICE);
        load(simd, cutter, field);
        let Cutter { inverse, sharpness, cost, length, tables, .. } = cutter;
        let inverse = S::as_simd_f32s(inverse).0;
        let sharpness = S::as_simd_f32s(sharpness).0;
        let (cost, length) = (S::as_mut_simd_f32s(cost).0, S::as_mut_simd_u32s(length).0);
        for step in 0..steps {
            make_tables(tables, width, &field.positions, step);
            let (tables, _) = S::as_simd_f32s(tables).0.as_chunks::<TABLE>();
            for block in 0..blocks {
                let here = block * steps + step;
                // Each block has a cost more than it has steps.
                let before = here + block;
                let past = &inverse[here - tables.len()..here];
                let costs = &cost[before - tables.len()..before];
                let runs = Runs { tables, past, costs };
                let (best, bits) =
                    extend(simd, runs, cost[before], inverse[here], sharpness[here]);
                cost[before + 1] = best;
                length[here] = bits;
            }
        }
    }
}

/// Copies what the cut needs into blocks.
#[inline(always)]
fn load<S: Simd>(simd: S, cutter: &mut Cutter, field: &Field) {
    // Readings that err alike break a line no more than one of them does.
    let trust = simd.splat_f32s((1.0 / field.errors.run).sqrt() as f32);
    let width = S::F32_LANES;
    let inverse = S::as_mut_simd_f32s(&mut cutter.inverse).0;
    let sharpness = S::as_mut_simd_f32s(&mut cutter.sharpness).0;
    for step in 0..field.steps {
        let row = step * field.lanes..(step + 1) * field.lanes;
        let arrays = [&field.inverse, &field.range, &field.gain].map(|array| &array[row.clone()]);
        let [inverses, ranges, gains] = arrays.map(|array| array.chunks(width));
        for (block, ((a, b), c)) in inverses.zip(ranges).zip(gains).enumerate() {
            let at = block * field.steps + step;
            let [a, range, gain] = [a, b, c].map(|values| simd.partial_load_f32s(values));
            inverse[at] = a;
            sharpness[at] = simd.mul_f32s(simd.mul_f32s(gain, range), trust);
        }
    }
}

/// The tables for runs that end at a step, from two cells on.
///
/// With times t counted back from the step, the line through the first m readings d predicts the next
/// as `α Σd + β Σtd`, and that prediction and the reading differ by `1 / γ` times the variance of one.
#[inline(always)]
fn make_tables(tables: &mut Vec<f32>, width: usize, positions: &[f32], step: usize) {
    tables.clear();
    let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
    for k in 1..LONGEST.min(step + 1) {
        let back = f64::from(positions[step]) - f64::from(positions[step - k]);
        let m = k as f64;
        let spread = m * squares - sum * sum;
        let (mut alpha, mut beta, mut gamma) = (0.0, 0.0, 0.0);
        if k > 1 && spread > 0.0 {
            (alpha, beta) = ((squares - back * sum) / spread, (m * back - sum) / spread);
            gamma = 1.0 / (1.0 + (squares - 2.0 * back * sum + m * back * back) / spread);
        }
        sum += back;
        squares += back * back;
        let mean = sum / (m + 1.0);
        let scatter = squares - sum * mean;
        let values = [back, alpha, beta, gamma, mean, 1.0 / scatter.max(1e-14)];
        for value in values.map(|value| value as f32) {
            tables.extend(std::iter::repeat_n(value, width));
        }
        tables.extend(std::iter::repeat_n(f32::from_bits(k as u32), width));
    }
}

/// What runs that end at a cell may be: their tables, and the inverse ranges and the costs before it.
#[derive(Clone, Copy)]
struct Runs<'a, S: Simd> {
    tables: &'a [[S::f32s; TABLE]],
    past: &'a [S::f32s],
    costs: &'a [S::f32s],
}

/// The cost after a cell, and the bits of the length of the best run that ends there.
#[inline(always)]
fn extend<S: Simd>(
    simd: S,
    runs: Runs<S>,
    before: S::f32s,
    inverse: S::f32s,
    sharpness: S::f32s,
) -> (S::f32s, S::u32s) {
    let kept = simd.splat_f32s(f32::from_bits(!LENGTH_BITS));
    let zero = simd.splat_f32s(0.0);
    // A run of one cell has no error; its length is one, whose bits are none.
    let mut best = simd.and_f32s(simd.sub_f32s(before, simd.splat_f32s(NO_SLOPE)), kept);
    let (mut a, mut b, mut error) = (zero, zero, zero);
    let steepest = simd.mul_f32s(simd.mul_f32s(sharpness, inverse), simd.splat_f32s(SLOPE));
    let steepest = simd.max_f32s(simd.mul_f32s(steepest, steepest), simd.splat_f32s(1e-6));
    let doubt = simd.div_f32s(simd.splat_f32s(1.0), steepest);
    let all = runs.tables.iter().zip(runs.past.iter().rev()).zip(runs.costs.iter().rev());
    let continued = |table: &[S::f32s; TABLE], other, a: &mut S::f32s, b: &mut S::f32s| {
        let [back, alpha, beta, gamma, ..] = *table;
        let d = simd.mul_f32s(simd.sub_f32s(other, inverse), sharpness);
        let off = simd.sub_f32s(d, simd.mul_f32s(alpha, *a));
        let off = simd.sub_f32s(off, simd.mul_f32s(beta, *b));
        *a = simd.add_f32s(*a, d);
        *b = simd.add_f32s(*b, simd.mul_f32s(back, d));
        simd.mul_f32s(simd.mul_f32s(off, off), gamma)
    };
    let better = |best, cost, error, length| {
        let cost = simd.and_f32s(simd.add_f32s(cost, error), kept);
        simd.min_f32s(best, simd.or_f32s(cost, length))
    };
    for ((table, &other), &cost) in all.clone().take(DOUBTED) {
        error = simd.add_f32s(error, continued(table, other, &mut a, &mut b));
        let [.., mean, inverse_scatter, length] = *table;
        let product = simd.sub_f32s(b, simd.mul_f32s(mean, a));
        let slope = simd.mul_f32s(product, inverse_scatter);
        // What the expectation says against the slope, at most what the slope explains.
        let said = simd.mul_f32s(simd.mul_f32s(slope, slope), doubt);
        let said = simd.min_f32s(said, simd.mul_f32s(slope, product));
        best = better(best, cost, simd.add_f32s(error, said), length);
    }
    for ((table, &other), &cost) in all.skip(DOUBTED) {
        error = simd.add_f32s(error, continued(table, other, &mut a, &mut b));
        best = better(best, cost, error, table[TABLE - 1]);
    }
    // A cell without a return is a run of its own, at no price.
    let valid = simd.greater_than_f32s(sharpness, zero);
    let cost = simd.add_f32s(best, simd.splat_f32s(PRICE));
    let cost = simd.select_f32s(valid, cost, before);
    let bits = simd.and_u32s(simd.transmute_u32s_f32s(best), simd.splat_u32s(LENGTH_BITS));
    (cost, simd.select_u32s(valid, bits, simd.splat_u32s(0)))
}
