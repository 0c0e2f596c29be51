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
/// Difference of two distances of steps, as a share of them, that makes none: the error that it leaves in
/// a run is as much smaller than what the run rises by in one step.
const UNEVEN: f32 = 1e-3;
/// Vectors in a block: what is the same for all lanes is loaded once for them.
const VECTORS: usize = 2;

/// Buffers of the cut. What is kept of cells stands block after block of lanes, each from its first
/// step on, and each step's lanes together; the last block is filled up with cells without a return.
#[derive(Clone, Debug, Default)]
pub(super) struct Cutter {
    /// Lanes of a block.
    pub width: usize,
    steps: usize,
    /// Inverse ranges, per metre.
    inverse: Vec<f32>,
    /// One over the noise of the inverse range at each cell.
    sharpness: Vec<f32>,
    /// Least cost of each lane up to each step, from "nothing yet" on, with the price of a run more.
    cost: Vec<f32>,
    /// Length, less one, of the run that ends at each cell, if one does.
    length: Vec<u32>,
    /// For runs of two cells on.
    tables: Vec<Table>,
}

/// What depends on the positions of a run's steps alone, the same for all lanes.
#[derive(Clone, Copy, Debug, Default)]
struct Table {
    /// Position of the farthest step before the last one.
    back: f32,
    /// The prediction of its reading from the sums of the others, negative, and how much its error
    /// counts.
    alpha: f32,
    beta: f32,
    gamma: f32,
    /// The length, as [`LENGTH_BITS`] hold it.
    length: f32,
    /// Mean of the positions, and one over their scatter.
    mean: f32,
    inverse_scatter: f32,
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

    /// The block that begins with a lane.
    pub fn block(&self, lane: usize) -> Block<'_> {
        let first = lane * self.steps;
        let inverse = &self.inverse[first..first + self.steps * self.width];
        Block { width: self.width, inverse }
    }

    /// Passes the first and the last step of each run of a lane, from the last run on; runs without a
    /// return are none.
    pub fn for_each_run(&self, lane: usize, mut pass: impl FnMut([u32; 2])) {
        let first = lane / self.width * self.steps * self.width + lane % self.width;
        let mut end = self.steps;
        while end > 0 {
            let place = first + (end - 1) * self.width;
            let begin = end - (self.length[place] as usize + 1).min(end);
            if self.inverse[place] > 0.0 {
                pass([begin as u32, end as u32 - 1]);
            }
            end = begin;
        }
    }
}

/// A block of lanes: how many, and their inverse ranges, step by step.
#[derive(Clone, Copy)]
pub(super) struct Block<'a> {
    pub width: usize,
    pub inverse: &'a [f32],
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
        let (width, steps) = (VECTORS * S::F32_LANES, field.steps);
        let blocks = field.lanes.div_ceil(width);
        (cutter.width, cutter.steps) = (width, steps);
        let cells = blocks * steps * width;
        cutter.inverse.resize(cells, 0.0);
        cutter.sharpness.resize(cells, 0.0);
        cutter.length.resize(cells, 0);
        cutter.cost.resize(cells + blocks * width, PRICE);
        for block in 0..blocks {
            let first = block * (steps + 1) * width;
            cutter.cost[first..first + width].fill(PRICE);
        }
        load(simd, cutter, field);
        let Cutter { inverse, sharpness, cost, length, tables, .. } = cutter;
        let (inverse, _) = S::as_simd_f32s(inverse).0.as_chunks::<VECTORS>();
        let (sharpness, _) = S::as_simd_f32s(sharpness).0.as_chunks::<VECTORS>();
        let (cost, _) = S::as_mut_simd_f32s(cost).0.as_chunks_mut::<VECTORS>();
        let (length, _) = S::as_mut_simd_u32s(length).0.as_chunks_mut::<VECTORS>();
        tables.clear();
        for step in 0..steps {
            let count = step.min(LONGEST - 1);
            if !holds(tables, &field.positions, step) {
                make_tables(tables, &field.positions, step);
            }
            let tables = &tables[..count];
            for block in 0..blocks {
                let here = block * steps + step;
                // Each block has a cost more than it has steps.
                let before = here + block;
                if is_empty(simd, sharpness[here]) {
                    cost[before + 1] = cost[before];
                    length[here] = [simd.splat_u32s(0); VECTORS];
                    continue;
                }
                let past = &inverse[here - tables.len()..here];
                let costs = &cost[before - tables.len()..before];
                let runs = Runs { tables, past, costs };
                let (best, bits) = extend(simd, runs, cost[before], inverse[here], sharpness[here]);
                cost[before + 1] = best;
                length[here] = bits;
            }
        }
    }
}

/// Whether none of the cells has a return.
#[inline(always)]
fn is_empty<S: Simd>(simd: S, sharpness: [S::f32s; VECTORS]) -> bool {
    let zero = simd.splat_f32s(0.0);
    let mut greatest = zero;
    for vector in sharpness {
        greatest = simd.max_f32s(greatest, vector);
    }
    simd.first_true_m32s(simd.greater_than_f32s(greatest, zero)) == S::F32_LANES
}

/// Copies what the cut needs into blocks.
#[inline(always)]
fn load<S: Simd>(simd: S, cutter: &mut Cutter, field: &Field) {
    // Readings that err alike break a line no more than one of them does.
    let trust = simd.splat_f32s((1.0 / field.errors.run).sqrt() as f32);
    let inverse = S::as_mut_simd_f32s(&mut cutter.inverse).0;
    let sharpness = S::as_mut_simd_f32s(&mut cutter.sharpness).0;
    let vectors = field.lanes.div_ceil(VECTORS * S::F32_LANES) * VECTORS;
    for step in 0..field.steps {
        let row = step * field.lanes..(step + 1) * field.lanes;
        let (a, a_rest) = S::as_simd_f32s(&field.inverse[row.clone()]);
        let (range, range_rest) = S::as_simd_f32s(&field.range[row.clone()]);
        let (gain, gain_rest) = S::as_simd_f32s(&field.gain[row]);
        let rests = [a_rest, range_rest, gain_rest];
        for vector in 0..vectors {
            let at = (vector / VECTORS * field.steps + step) * VECTORS + vector % VECTORS;
            let [a, range, gain] = if vector < a.len() {
                [a[vector], range[vector], gain[vector]]
            } else {
                // What is left of the row, then nothing.
                let [a, range, gain] = if vector == a.len() { rests } else { [&[][..]; 3] };
                [
                    simd.partial_load_f32s(a),
                    simd.partial_load_f32s(range),
                    simd.partial_load_f32s(gain),
                ]
            };
            inverse[at] = a;
            sharpness[at] = simd.mul_f32s(simd.mul_f32s(gain, range), trust);
        }
    }
}

/// Whether tables that were made for another step are those of this one, to a thousandth of the usual
/// distance of two steps: nearly all are evenly spaced. A short run's tables are the first of a longer
/// one's.
fn holds(tables: &[Table], positions: &[f32], step: usize) -> bool {
    let count = step.min(LONGEST - 1);
    let Some(known) = tables.get(..count) else { return false };
    let Some(first) = known.first() else { return true };
    let (here, tolerance) = (positions[step], UNEVEN * first.back);
    let past = positions[step - count..step].iter().rev();
    past.zip(known).all(|(&past, table)| (here - past - table.back).abs() <= tolerance)
}

/// The tables for runs that end at a step, from two cells on.
///
/// With times t counted back from the step, the line through the first m readings d predicts the next
/// as `-α Σd - β Σtd`, and that prediction and the reading differ by `1 / γ` times the variance of one.
fn make_tables(tables: &mut Vec<Table>, positions: &[f32], step: usize) {
    tables.clear();
    let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
    for k in 1..LONGEST.min(step + 1) {
        let back = f64::from(positions[step]) - f64::from(positions[step - k]);
        let m = k as f64;
        let spread = m * squares - sum * sum;
        let (mut alpha, mut beta, mut gamma) = (0.0, 0.0, 0.0);
        if k > 1 && spread > 0.0 {
            let share = 1.0 / spread;
            (alpha, beta) = ((back * sum - squares) * share, (sum - m * back) * share);
            // Its leverage is the prediction of one reading's variance.
            gamma = 1.0 / (1.0 - alpha - beta * back);
        }
        sum += back;
        squares += back * back;
        let mean = sum / (m + 1.0);
        let scatter = (squares - sum * mean).max(1e-14);
        tables.push(Table {
            back: back as f32,
            alpha: alpha as f32,
            beta: beta as f32,
            gamma: gamma as f32,
            length: f32::from_bits(k as u32),
            mean: mean as f32,
            inverse_scatter: (1.0 / scatter) as f32,
        });
    }
}

/// What runs that end at a cell may be: their tables, and the inverse ranges and the costs before it.
#[derive(Clone, Copy)]
struct Runs<'a, V> {
    tables: &'a [Table],
    past: &'a [[V; VECTORS]],
    costs: &'a [[V; VECTORS]],
}

/// A line that grows backwards from a cell, for the lanes of a vector.
struct Line<V> {
    inverse: V,
    sharpness: V,
    /// Sums of the readings, relative to that of the cell and in units of its noise, and of their
    /// products with their positions.
    a: V,
    b: V,
    error: V,
    /// Least cost so far, with the bits of its length.
    best: V,
}

impl<V: Copy> Line<V> {
    /// A run of one cell: it has no error, and its length is one, whose bits are none.
    #[inline(always)]
    fn start<S: Simd<f32s = V>>(simd: S, before: V, inverse: V, sharpness: V) -> Self {
        let zero = simd.splat_f32s(0.0);
        let kept = simd.splat_f32s(f32::from_bits(!LENGTH_BITS));
        let best = simd.sub_f32s(before, simd.splat_f32s(NO_SLOPE));
        let best = simd.and_f32s(best, kept);
        Self { inverse, sharpness, a: zero, b: zero, error: zero, best }
    }

    /// Takes in one reading more.
    #[inline(always)]
    fn continue_to<S: Simd<f32s = V>>(
        &mut self,
        simd: S,
        [back, alpha, beta, gamma]: [V; 4],
        other: V,
    ) {
        let d = simd.mul_f32s(simd.sub_f32s(other, self.inverse), self.sharpness);
        let off = simd.mul_add_e_f32s(alpha, self.a, simd.mul_add_e_f32s(beta, self.b, d));
        self.a = simd.add_f32s(self.a, d);
        self.b = simd.mul_add_e_f32s(back, d, self.b);
        self.error = simd.mul_add_e_f32s(simd.mul_f32s(off, off), gamma, self.error);
    }

    /// Offers the line as it is.
    #[inline(always)]
    fn offer<S: Simd<f32s = V>>(&mut self, simd: S, before: V, error: V, length: V) {
        let kept = simd.splat_f32s(f32::from_bits(!LENGTH_BITS));
        let cost = simd.and_f32s(simd.add_f32s(before, error), kept);
        self.best = simd.min_f32s(self.best, simd.or_f32s(cost, length));
    }
}

/// The costs after cells, and the bits of the lengths of the best runs that end there.
#[inline(always)]
fn extend<S: Simd>(
    simd: S,
    runs: Runs<S::f32s>,
    before: [S::f32s; VECTORS],
    inverse: [S::f32s; VECTORS],
    sharpness: [S::f32s; VECTORS],
) -> ([S::f32s; VECTORS], [S::u32s; VECTORS]) {
    let Runs { tables, past, costs } = runs;
    let zero = simd.splat_f32s(0.0);
    let mut lines: [Line<S::f32s>; VECTORS] = [
        Line::start(simd, before[0], inverse[0], sharpness[0]),
        Line::start(simd, before[1], inverse[1], sharpness[1]),
    ];
    let count = tables.len();
    let (past, costs) = (&past[..count], &costs[..count]);
    let doubted = count.min(DOUBTED);
    for (k, table) in tables[..doubted].iter().enumerate() {
        let (shared, length) = shared_by_lanes(simd, table);
        let mean = simd.splat_f32s(table.mean);
        let inverse_scatter = simd.splat_f32s(table.inverse_scatter);
        let at = count - 1 - k;
        for (i, line) in lines.iter_mut().enumerate() {
            line.continue_to(simd, shared, past[at][i]);
            let product = simd.sub_f32s(line.b, simd.mul_f32s(mean, line.a));
            let slope = simd.mul_f32s(product, inverse_scatter);
            let steepest = simd.mul_f32s(line.sharpness, line.inverse);
            let steepest = simd.mul_f32s(steepest, simd.splat_f32s(SLOPE));
            let square = simd.mul_f32s(steepest, steepest);
            let square = simd.max_f32s(square, simd.splat_f32s(1e-6));
            // What the expectation says against the slope, at most what the slope explains.
            let said = simd.div_f32s(simd.mul_f32s(slope, slope), square);
            let said = simd.min_f32s(said, simd.mul_f32s(slope, product));
            line.offer(simd, costs[at][i], simd.add_f32s(line.error, said), length);
        }
    }
    for (k, table) in tables[doubted..].iter().enumerate() {
        let (shared, length) = shared_by_lanes(simd, table);
        let at = count - 1 - doubted - k;
        for (i, line) in lines.iter_mut().enumerate() {
            line.continue_to(simd, shared, past[at][i]);
            line.offer(simd, costs[at][i], line.error, length);
        }
    }
    let (mut costs, mut lengths) = (before, [simd.splat_u32s(0); VECTORS]);
    for i in 0..VECTORS {
        // A cell without a return is a run of its own, at no price.
        let valid = simd.greater_than_f32s(sharpness[i], zero);
        let cost = simd.add_f32s(lines[i].best, simd.splat_f32s(PRICE));
        costs[i] = simd.select_f32s(valid, cost, before[i]);
        let bits = simd.transmute_u32s_f32s(lines[i].best);
        let bits = simd.and_u32s(bits, simd.splat_u32s(LENGTH_BITS));
        lengths[i] = simd.select_u32s(valid, bits, lengths[i]);
    }
    (costs, lengths)
}

/// What all lanes have in common of a run: its table, and the bits of its length.
#[inline(always)]
fn shared_by_lanes<S: Simd>(simd: S, table: &Table) -> ([S::f32s; 4], S::f32s) {
    let shared = [
        simd.splat_f32s(table.back),
        simd.splat_f32s(table.alpha),
        simd.splat_f32s(table.beta),
        simd.splat_f32s(table.gamma),
    ];
    (shared, simd.splat_f32s(table.length))
}
