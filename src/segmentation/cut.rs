//! Lanes cut into runs whose inverse range is a straight line.
//!
//! Lanes are cut segment by segment: what is not one straight run is cut by a dynamic programme over its
//! steps, for as many lanes at once as the processor's vectors hold. The error of a line that is continued
//! backwards by one reading is what it was and the squared error of its prediction of that reading, times a
//! factor that depends on the positions of the steps alone: so a longer line costs a few operations more,
//! and no difference of large sums is taken. Runs that go on in the next segment are joined. Where so many
//! steps are too wide an angle for a segment, the programme goes over whole lanes.

use super::field::Field;
use super::run::Run;
use super::segments::{Kind, SEGMENT, Straight};
use super::vectors::run;
use pulp::{Simd, WithSimd};

/// Most cells of a run.
pub(super) const LONGEST: usize = 2 * SEGMENT;
/// Price of a run in units of the noise variance: chance breaks gain about 2 ln(2 L) = 7.
const PRICE: f32 = 7.0;
/// The same where lanes are not cut in segments.
const COARSE_PRICE: f32 = 9.0;
/// Angle of the widest segments. Over a wider one a crease must not depend on being worth a cut: there the
/// programme goes over whole lanes, and cuts wherever it is cheapest for its runs to be no longer.
const WIDEST_SEGMENT_RAD: f32 = 0.08;
/// What a cut of a segment must be worth for the best one to be sought: where none is worth as much, chance
/// is as likely a reason.
const SUSPECTED: f32 = 8.0;
/// What a run of one cell is cheaper: it has no slope.
const NO_SLOPE: f32 = 2.5;
/// Angle of the longest runs: over a wider one planes bend.
const WIDEST_RAD: f32 = 0.15;
/// Price of a run that is longer than a segment, which may bend already.
const LONG_PRICE: f32 = 5.0;
/// Tangent of the angle of incidence up to which slopes are expected. It keeps a cell of its own
/// from forming a line with any one cell beside it.
const SLOPE: f32 = 6.0;
/// Longest runs, less one cell, of which that expectation is asked: from five cells on the readings
/// tell the slope themselves.
const DOUBTED: usize = 3;
/// Bits of a cost that give way to the length of its run, less one: the least of such costs brings
/// its length with it. What is left of the cost is good to one part in a million.
const LENGTH_BITS: u32 = SEGMENT as u32 - 1;
/// Difference of two distances of steps, as a share of them, that makes none: the error that it leaves in
/// a run is as much smaller than what the run rises by in one step.
const UNEVEN: f32 = 1e-3;
/// Stands for the length of a run of no returns, which is one.
const NO_RETURN: u32 = SEGMENT as u32;
/// Vectors in a block: what is the same for all lanes is loaded once for them.
const VECTORS: usize = 2;

/// Buffers of the cut.
#[derive(Clone, Debug, Default)]
pub(super) struct Cutter {
    /// First step of each segment, and the end of the last.
    begins: Vec<usize>,
    straight: Vec<Straight>,
    /// Most cells of a run that is joined.
    longest: usize,
    /// Lanes that are cut in a segment.
    open: Vec<u32>,
    block: Block,
    /// Runs of the segments that were cut, and which of them are each lane's.
    runs: Vec<Run>,
    places: Vec<[u32; 2]>,
    /// For runs of two cells on, and where those of each step begin.
    tables: Vec<Table>,
    table_of: Vec<u32>,
}

/// Some lanes of a segment, step after step, each step's lanes together.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Lanes, a whole number of vectors.
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
        self.make_tables(field);
        self.longest = ((WIDEST_RAD / field.along_rad) as usize).clamp(SEGMENT, LONGEST);
        self.begins.clear();
        let is_coarse = SEGMENT as f32 * field.along_rad > WIDEST_SEGMENT_RAD;
        let count = if is_coarse { 1 } else { field.steps.div_ceil(SEGMENT) };
        let price = if is_coarse { COARSE_PRICE } else { PRICE };
        self.begins.extend((0..=count).map(|k| k * field.steps / count.max(1)));
        self.straight.resize(self.straight.len().max(count), Straight::default());
        self.runs.clear();
        self.places.clear();
        for segment in 0..count {
            let (begin, end) = (self.begins[segment], self.begins[segment + 1]);
            if is_coarse {
                self.straight[segment].leave_open(field.lanes);
            } else {
                self.straight[segment].look(field, begin, end, SUSPECTED);
            }
            self.open.clear();
            for lane in 0..field.lanes {
                if self.straight[segment].kind(lane) == Kind::Open {
                    self.open.push(lane as u32);
                }
                self.places.push([0, 0]);
            }
            let mut cut = 0;
            while cut < self.open.len() {
                let lanes = &self.open[cut..];
                let (tables, table_of) = (&self.tables, &self.table_of[begin..end]);
                let block = &mut self.block;
                let work = Cut { block, field, lanes, begin, price, tables, table_of };
                run(work);
                let width = self.block.width.min(lanes.len());
                for place in 0..width {
                    let lane = self.open[cut + place] as usize;
                    let from = self.runs.len();
                    self.block.list_runs(
                        place,
                        &field.positions[begin..end],
                        begin,
                        &mut self.runs,
                    );
                    self.places[segment * field.lanes + lane] =
                        [from as u32, self.runs.len() as u32];
                }
                cut += width;
            }
        }
    }

    /// Passes the runs of a lane, in order.
    pub fn for_each_run(&self, field: &Field, lane: usize, mut pass: impl FnMut(&Run)) {
        let mut last: Option<Run> = None;
        let mut take = |run: &Run, begin: usize| {
            if let Some(last) = &mut last {
                if last.end == run.first
                    && run.first as usize == begin
                    && let Some(joined) = join(self, field, lane, last, run)
                {
                    *last = joined;
                    return;
                }
                pass(last);
            }
            last = Some(*run);
        };
        for (segment, ends) in self.begins.windows(2).enumerate() {
            let straight = &self.straight[segment];
            match straight.kind(lane) {
                Kind::Empty => {}
                Kind::Straight => {
                    let run = Run {
                        first: ends[0] as u32,
                        end: ends[1] as u32,
                        middle: straight.middle,
                        scatter: straight.scatter,
                        inverse: straight.inverse[lane],
                        slope: straight.slope[lane],
                        error: straight.error[lane],
                    };
                    take(&run, ends[0]);
                }
                Kind::Open => {
                    let [from, to] = self.places[segment * field.lanes + lane];
                    for run in &self.runs[from as usize..to as usize] {
                        take(run, ends[0]);
                    }
                }
            }
        }
        if let Some(last) = &last {
            pass(last);
        }
    }

    /// Takes over the positions of a field's steps.
    fn make_tables(&mut self, field: &Field) {
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
}

/// One run in place of two that a segment's end parts, if that costs less.
#[inline]
fn join(cutter: &Cutter, field: &Field, lane: usize, run: &Run, next: &Run) -> Option<Run> {
    let count = run.len() + next.len();
    // Too few cells have a line in any case.
    if count > cutter.longest || count <= DOUBTED + 1 {
        return None;
    }
    let (joined, more) = run.joined(next);
    let cell = next.first as usize * field.lanes + lane;
    let sharpness = field.gain[cell] * field.range[cell];
    let single = run.len() == 1 || next.len() == 1;
    let price = if count > SEGMENT {
        LONG_PRICE
    } else if single {
        PRICE - NO_SLOPE
    } else {
        PRICE
    };
    (more * sharpness * sharpness < price * field.errors.run as f32).then_some(joined)
}

impl Block {
    /// Appends the runs of a lane, whose steps are at these positions, the first of which is step `begin`.
    fn list_runs(&self, lane: usize, positions: &[f32], begin: usize, runs: &mut Vec<Run>) {
        let from = runs.len();
        let mut end = positions.len();
        while end > 0 {
            let length = self.length[(end - 1) * self.width + lane];
            if length == NO_RETURN {
                end -= 1;
                continue;
            }
            let first = end - (length as usize + 1).min(end);
            let readings = (first..end).map(|step| self.inverse[step * self.width + lane]);
            runs.push(Run::through(begin + first, &positions[first..end], readings));
            end = first;
        }
        runs[from..].reverse();
    }
}

/// The cut of the first of some lanes, for vectors of some width.
struct Cut<'a> {
    block: &'a mut Block,
    field: &'a Field,
    lanes: &'a [u32],
    begin: usize,
    /// What a run costs, in units of the noise.
    price: f32,
    tables: &'a [Table],
    table_of: &'a [u32],
}

impl WithSimd for Cut<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { block, field, lanes, begin, price, tables, table_of } = self;
        let (width, steps) = (VECTORS * S::F32_LANES, table_of.len());
        block.load(field, &lanes[..lanes.len().min(width)], (begin, steps), width);
        let Block { inverse, sharpness, cost, length, .. } = block;
        let (inverse, _) = S::as_simd_f32s(inverse).0.as_chunks::<VECTORS>();
        let (sharpness, _) = S::as_simd_f32s(sharpness).0.as_chunks::<VECTORS>();
        let (cost, _) = S::as_mut_simd_f32s(cost).0.as_chunks_mut::<VECTORS>();
        let (length, _) = S::as_mut_simd_u32s(length).0.as_chunks_mut::<VECTORS>();
        let price = simd.splat_f32s(price);
        cost[0] = [price; VECTORS];
        for (step, &table) in table_of.iter().enumerate() {
            let first = step - step.min(SEGMENT - 1);
            let tables = &tables[table as usize..][..step - first];
            let runs =
                Runs { tables, past: &inverse[first..step], costs: &cost[first..step], price };
            let (best, bits) = extend(simd, runs, cost[step], inverse[step], sharpness[step]);
            cost[step + 1] = best;
            length[step] = bits;
        }
    }
}

impl Block {
    /// Copies what the cut needs of some lanes.
    #[inline(always)]
    fn load(&mut self, field: &Field, lanes: &[u32], (begin, steps): (usize, usize), width: usize) {
        self.width = width;
        for array in [&mut self.inverse, &mut self.sharpness] {
            array.resize(steps * width, 0.0);
        }
        self.length.resize(steps * width, 0);
        self.cost.resize((steps + 1) * width, 0.0);
        // Readings that err alike break a line no more than one of them does.
        let trust = (1.0 / field.errors.run).sqrt() as f32;
        let rows = self.inverse.chunks_exact_mut(width).zip(self.sharpness.chunks_exact_mut(width));
        for (step, (inverse, sharpness)) in (begin..).zip(rows) {
            let row = step * field.lanes..(step + 1) * field.lanes;
            let [readings, ranges, gains] = [&field.inverse, &field.range, &field.gain]
                .map(|array: &Vec<f32>| &array[row.clone()]);
            for (&lane, (inverse, sharpness)) in
                lanes.iter().zip(inverse.iter_mut().zip(sharpness.iter_mut()))
            {
                let lane = lane as usize;
                *inverse = readings[lane];
                *sharpness = ranges[lane] * gains[lane] * trust;
            }
            inverse[lanes.len()..].fill(0.0);
            sharpness[lanes.len()..].fill(0.0);
        }
    }
}

/// Whether tables that were made for another step are those of this one, to a thousandth of the usual
/// distance of two steps: nearly all are evenly spaced. A short run's tables are the first of a longer
/// one's.
fn holds(tables: &[Table], positions: &[f32], step: usize) -> bool {
    let count = step.min(SEGMENT - 1);
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
    for k in 1..SEGMENT.min(step + 1) {
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
    price: V,
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
    let Runs { tables, past, costs, price } = runs;
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
        let cost = simd.add_f32s(lines[i].best, price);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::PointGrid;
    use crate::segmentation::{RangeNoise, ReadingErrors};

    #[test]
    fn only_fine_lanes_have_runs_that_are_longer_than_a_segment() {
        for (pitch_rad, is_fine) in [(0.004_f32, true), (0.009, false)] {
            let points = (0..64 * 20).map(|i| {
                let (tilt, bearing) = ((i / 20) as f32 * pitch_rad, (i % 20) as f32 * 0.02);
                let ray = [tilt.cos() * bearing.cos(), bearing.sin(), -tilt.sin() * bearing.cos()];
                ray.map(|v| v * 3.0 / ray[0])
            });
            let mut field = Field::default();
            field.load(&PointGrid::new(64, 20, points.collect()));
            field.set_errors(ReadingErrors::independent(RangeNoise::uniform(0.01)));
            let mut cutter = Cutter::default();
            cutter.cut(&field);
            for lane in 0..field.lanes {
                let (mut end, mut longest) = (0, 0);
                cutter.for_each_run(&field, lane, |run| {
                    assert_eq!(run.first, end);
                    (end, longest) = (run.end, longest.max(run.len()));
                });
                assert_eq!((end, longest > SEGMENT), (64, is_fine), "lane {lane}: {longest}");
            }
        }
    }
}
