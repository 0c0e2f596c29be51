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
/// Stands for the length of a run of no returns, which is one.
const NO_RETURN: u32 = LONGEST as u32;
/// Vectors in a block: what is the same for all lanes is loaded once for them.
const VECTORS: usize = 2;

/// Buffers of the cut, which goes block after block of lanes: what is kept of cells is that of one block,
/// step after step, each step's lanes together. So it stays near the processor.
#[derive(Clone, Debug, Default)]
pub(super) struct Cutter {
    /// Lanes of a block.
    width: usize,
    /// Inverse ranges, per metre; zero without a return, and beyond the last lane.
    inverse: Vec<f32>,
    /// One over the noise of the inverse range at each cell.
    sharpness: Vec<f32>,
    /// Least cost of each lane up to each step, from "nothing yet" on, with the price of a run more.
    cost: Vec<f32>,
    /// Length, less one, of the run that ends at each cell, if one does; [`NO_RETURN`] where nothing came
    /// back.
    length: Vec<u32>,
    /// For runs of two cells on, and where those of each step begin.
    tables: Vec<Table>,
    table_of: Vec<u32>,
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
    /// Takes over the positions of a field's steps.
    pub fn start(&mut self, field: &Field) {
        self.tables.clear();
        self.table_of.clear();
        let mut first = 0;
        for step in 0..field.steps {
            if !holds(&self.tables[first..], &field.positions, step) {
                first = self.tables.len();
                make_tables(&mut self.tables, &field.positions, step);
            }
            self.table_of.push(first as u32);
        }
    }

    /// Cuts a block of lanes from one on, and returns how many these are; there may be fewer.
    pub fn cut(&mut self, field: &Field, lane: usize) -> usize {
        let cut = Cut { cutter: self, field, lane };
        match Arch::new() {
            // Four at a time is what any processor does well.
            Arch::Scalar => Scalar128b.vectorize(cut),
            arch => arch.dispatch(cut),
        }
        self.width
    }

    /// Inverse ranges of the block, step by step.
    pub fn inverse(&self) -> &[f32] {
        &self.inverse
    }

    /// Passes the first and the last step of each run of a lane of the block, from the last run on; runs
    /// without a return are none.
    pub fn for_each_run(&self, lane: usize, mut pass: impl FnMut([u32; 2])) {
        let mut end = self.inverse.len() / self.width;
        while end > 0 {
            let length = self.length[(end - 1) * self.width + lane];
            if length == NO_RETURN {
                end -= 1;
                continue;
            }
            let begin = end - (length as usize + 1).min(end);
            pass([begin as u32, end as u32 - 1]);
            end = begin;
        }
    }
}

/// The cut of one block, for vectors of some width.
struct Cut<'a> {
    cutter: &'a mut Cutter,
    field: &'a Field,
    lane: usize,
}

impl WithSimd for Cut<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { cutter, field, lane } = self;
        let (width, steps) = (VECTORS * S::F32_LANES, field.steps);
        cutter.width = width;
        cutter.inverse.resize(steps * width, 0.0);
        cutter.sharpness.resize(steps * width, 0.0);
        cutter.length.resize(steps * width, 0);
        cutter.cost.resize((steps + 1) * width, 0.0);
        load(simd, cutter, field, lane);
        let Cutter { inverse, sharpness, cost, length, tables, table_of, .. } = cutter;
        let (inverse, _) = S::as_simd_f32s(inverse).0.as_chunks::<VECTORS>();
        let (sharpness, _) = S::as_simd_f32s(sharpness).0.as_chunks::<VECTORS>();
        let (cost, _) = S::as_mut_simd_f32s(cost).0.as_chunks_mut::<VECTORS>();
        let (length, _) = S::as_mut_simd_u32s(length).0.as_chunks_mut::<VECTORS>();
        cost[0] = [simd.splat_f32s(PRICE); VECTORS];
        for (step, &table) in table_of.iter().enumerate() {
            if is_empty(simd, sharpness[step]) {
                cost[step + 1] = cost[step];
                length[step] = [simd.splat_u32s(NO_RETURN); VECTORS];
                continue;
            }
            let first = step - step.min(LONGEST - 1);
            let tables = &tables[table as usize..][..step - first];
            let runs = Runs { tables, past: &inverse[first..step], costs: &cost[first..step] };
            let (best, bits) = extend(simd, runs, cost[step], inverse[step], sharpness[step]);
            cost[step + 1] = best;
            length[step] = bits;
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

/// Copies what the cut needs of the lanes from one on.
#[inline(always)]
fn load<S: Simd>(simd: S, cutter: &mut Cutter, field: &Field, lane: usize) {
    // Readings that err alike break a line no more than one of them does.
    let trust = simd.splat_f32s((1.0 / field.errors.run).sqrt() as f32);
    let (inverse, _) = S::as_mut_simd_f32s(&mut cutter.inverse).0.as_chunks_mut::<VECTORS>();
    let (sharpness, _) = S::as_mut_simd_f32s(&mut cutter.sharpness).0.as_chunks_mut::<VECTORS>();
    let lanes = lane..field.lanes.min(lane + cutter.width);
    for (step, (inverse, sharpness)) in inverse.iter_mut().zip(sharpness).enumerate() {
        let cells = step * field.lanes + lanes.start..step * field.lanes + lanes.end;
        *inverse = vectors(simd, &field.inverse[cells.clone()]);
        let range = vectors(simd, &field.range[cells.clone()]);
        let gain = vectors(simd, &field.gain[cells]);
        for i in 0..VECTORS {
            sharpness[i] = simd.mul_f32s(simd.mul_f32s(gain[i], range[i]), trust);
        }
    }
}

/// The vectors of a block's width that begin with an array, and go on with zeros.
#[inline(always)]
fn vectors<S: Simd>(simd: S, array: &[f32]) -> [S::f32s; VECTORS] {
    let (whole, rest) = S::as_simd_f32s(array);
    let (whole, rest) = (whole, simd.partial_load_f32s(rest));
    std::array::from_fn(|i| match whole.get(i) {
        Some(&vector) => vector,
        None if i == whole.len() => rest,
        None => simd.splat_f32s(0.0),
    })
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

/// Adds the tables for runs that end at a step, from two cells on.
///
/// With times t counted back from the step, the line through the first m readings d predicts the next
/// as `-α Σd - β Σtd`, and that prediction and the reading differ by `1 / γ` times the variance of one.
fn make_tables(tables: &mut Vec<Table>, positions: &[f32], step: usize) {
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
    let mut per_square = [zero; VECTORS];
    for (per_square, line) in per_square.iter_mut().zip(&lines) {
        let steepest = simd.mul_f32s(line.sharpness, line.inverse);
        let steepest = simd.mul_f32s(steepest, simd.splat_f32s(SLOPE));
        let square = simd.mul_f32s(steepest, steepest);
        let square = simd.max_f32s(square, simd.splat_f32s(1e-6));
        *per_square = simd.div_f32s(simd.splat_f32s(1.0), square);
    }
    for (k, table) in tables[..doubted].iter().enumerate() {
        let (shared, length) = shared_by_lanes(simd, table);
        let mean = simd.splat_f32s(table.mean);
        let inverse_scatter = simd.splat_f32s(table.inverse_scatter);
        let at = count - 1 - k;
        for (i, line) in lines.iter_mut().enumerate() {
            line.continue_to(simd, shared, past[at][i]);
            let product = simd.sub_f32s(line.b, simd.mul_f32s(mean, line.a));
            let slope = simd.mul_f32s(product, inverse_scatter);
            // What the expectation says against the slope, at most what the slope explains.
            let said = simd.mul_f32s(simd.mul_f32s(slope, slope), per_square[i]);
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
    let (mut costs, mut lengths) = (before, [simd.splat_u32s(NO_RETURN); VECTORS]);
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
