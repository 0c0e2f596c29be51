//! Lanes cut into sticks: the longest runs of cells whose inverse range is a straight line.
//!
//! The cut of a lane is optimal: it minimises the sum of squared errors of the lines, in units of
//! the noise, plus a price for each stick. A dynamic programme finds it in O(n L) for sticks of at
//! most L cells, for many lanes at once. A stick never crosses an edge that shows in its own lane,
//! however narrow the surface, and edges along the lanes lie between sticks by construction.

use super::field::Field;
use super::moments::Moments;
use wide::f32x4;

/// Most cells of a stick.
pub(super) const LONGEST: usize = 16;
/// Price of a stick in units of the noise variance: chance breaks gain about 2 ln(2 L) = 7.
const PRICE: f32 = 9.0;
/// What a stick of one cell is cheaper: it has no slope.
const NO_SLOPE: f32 = 2.5;
/// Tangent of the angle of incidence up to which slopes are expected. It keeps a cell of its own
/// from forming a line with any one cell beside it.
const SLOPE: f32 = 6.0;
/// Lanes that are worked on together, in registers.
const BLOCK: usize = 4;
/// A value of each lane of a block.
type Block = f32x4;
/// Bits of a cost that give way to the length of its stick, less one: the least of such costs brings
/// its length with it. What is left of the cost is good to one part in a million.
const LENGTH_BITS: u32 = LONGEST as u32 - 1;
/// No stick.
pub(super) const NO_STICK: u32 = u32::MAX;

/// A run of cells on one lane, `first..=last` steps, all of them valid.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stick {
    pub lane: u32,
    pub first: u32,
    pub last: u32,
    /// Two points that stand for the stick's readings: for any error linear in the step they give
    /// the same sum of squares as all of them.
    pub ends: [[f64; 3]; 2],
    /// Weight `r² / σ²` of each end, times half the number of readings.
    pub weight: f64,
    /// Number of readings.
    pub n: f64,
    /// Sum of squared errors of the readings about the line, in units of their noise.
    pub error: f64,
}

impl Stick {
    /// Adds the stick's readings, but for their scatter about the line.
    pub fn add_to(&self, moments: &mut Moments) {
        for end in self.ends {
            moments.add_point(end, self.weight);
        }
        moments.n += self.n - 2.0;
    }
}

/// All sticks of a scan, lane after lane, each lane in order of steps.
#[derive(Clone, Debug, Default)]
pub(super) struct Sticks {
    pub sticks: Vec<Stick>,
    /// Stick of each cell.
    pub of_cell: Vec<u32>,
    /// Blocks of lanes; the last is filled up with cells without a return. All that is kept of them
    /// stands block after block, each from its first step on.
    blocks: usize,
    steps: usize,
    inverse: Vec<Block>,
    /// One over the noise of the inverse range at each cell.
    sharpness: Vec<Block>,
    /// Least cost of each lane up to each step, from "nothing yet" on, with the price of a stick more.
    cost: Vec<Block>,
    /// Length of the stick that ends at each cell, if one does.
    length: Vec<[u8; BLOCK]>,
    tables: Vec<Table>,
}

/// What depends on the positions of a stick's steps alone, for sticks of one length from two cells on;
/// the same for all lanes.
#[derive(Clone, Copy, Debug, Default)]
struct Table {
    /// Position of the farthest step before the last one.
    back: Block,
    mean: Block,
    inverse_length: Block,
    /// One over the scatter of the positions, and its square.
    inverse_scatter: Block,
    square: Block,
    /// The length, as [`LENGTH_BITS`] hold it.
    length: Block,
}

impl Sticks {
    /// Cuts all lanes of a field.
    pub fn cut(&mut self, field: &Field) {
        self.load(field);
        self.cost.clear();
        self.cost.resize((field.steps + 1) * self.blocks, Block::splat(PRICE));
        self.length.resize(field.steps * self.blocks, [1; BLOCK]);
        for step in 0..field.steps {
            self.make_tables(field, step);
            for block in 0..self.blocks {
                self.extend(step, block);
            }
        }
        self.collect(field);
    }

    /// Copies what the cut needs into blocks.
    fn load(&mut self, field: &Field) {
        self.blocks = field.lanes.div_ceil(BLOCK);
        self.steps = field.steps;
        // Readings that err alike break a line no more than one of them does.
        let trust = (1.0 / field.errors.run).sqrt() as f32;
        let cells = self.blocks * field.steps;
        self.inverse.resize(cells, Block::ZERO);
        self.sharpness.resize(cells, Block::ZERO);
        for step in 0..field.steps {
            let row = step * field.lanes..(step + 1) * field.lanes;
            let (inverse, ranges) = (&field.inverse[row.clone()], &field.range[row.clone()]);
            let cells = inverse.chunks(BLOCK).zip(ranges.chunks(BLOCK));
            let blocks = (step..).step_by(field.steps);
            for (((inverse, ranges), gains), at) in
                cells.zip(field.gain[row].chunks(BLOCK)).zip(blocks)
            {
                let [inverse, ranges, gains] = [inverse, ranges, gains].map(four);
                self.inverse[at] = inverse;
                self.sharpness[at] = gains * ranges * Block::splat(trust);
            }
        }
    }

    fn make_tables(&mut self, field: &Field, step: usize) {
        self.tables.clear();
        let (mut sum, mut squares) = (0.0, 0.0);
        for k in 1..LONGEST.min(step + 1) {
            let back = field.positions[step] - field.positions[step - k];
            sum += back;
            squares += back * back;
            let length = (k + 1) as f32;
            let scatter: f32 = squares - sum * sum / length;
            let inverse_scatter = 1.0 / scatter.max(1e-14);
            self.tables.push(Table {
                back: Block::splat(back),
                mean: Block::splat(sum / length),
                inverse_length: Block::splat(1.0 / length),
                inverse_scatter: Block::splat(inverse_scatter),
                square: Block::splat(inverse_scatter * inverse_scatter),
                length: Block::splat(f32::from_bits(k as u32)),
            });
        }
    }

    /// The best stick that ends at `step`, for the lanes of a block.
    fn extend(&mut self, step: usize, block: usize) {
        let here = block * self.steps + step;
        let (inverse, sharpness) = (self.inverse[here], self.sharpness[here]);
        // Relative to the scatter of the positions, what the prior of the slope is worth.
        let slope = sharpness * inverse * Block::splat(SLOPE);
        let doubt = Block::ONE / (slope * slope).fast_max(Block::splat(1e-6));
        let weight = sharpness * sharpness;
        let kept = Block::splat(f32::from_bits(!LENGTH_BITS));
        // Each block has a cost more than it has steps.
        let before = self.cost[here + block];
        // A stick of one cell has no error; its length is one, whose bits are none.
        let mut best = (before - Block::splat(NO_SLOPE)) & kept;
        let (mut a, mut b, mut c) = (Block::ZERO, Block::ZERO, Block::ZERO);
        let past = &self.inverse[here - self.tables.len()..here];
        let costs = &self.cost[here + block - self.tables.len()..here + block];
        for ((table, &other), &cost) in
            self.tables.iter().zip(past.iter().rev()).zip(costs.iter().rev())
        {
            let d = other - inverse;
            a += d;
            b += table.back * d;
            c += d * d;
            let slope = b - table.mean * a;
            let told = (table.inverse_scatter - doubt * table.square).fast_max(Block::ZERO);
            let error = c - a * a * table.inverse_length - slope * slope * told;
            best = best.fast_min(((cost + weight * error) & kept) | table.length);
        }
        let (best, before) = (best.to_array(), before.to_array());
        let valid = sharpness.to_array();
        let mut cost = [0.0; BLOCK];
        for i in 0..BLOCK {
            // A cell without a return is a stick of its own, at no price.
            let valid = valid[i] > 0.0;
            cost[i] = if valid { best[i] + PRICE } else { before[i] };
            let length = (best[i].to_bits() & LENGTH_BITS) as u8 + 1;
            self.length[here][i] = if valid { length } else { 1 };
        }
        self.cost[here + block + 1] = Block::new(cost);
    }

    /// Walks every lane back from its end and lists its sticks.
    fn collect(&mut self, field: &Field) {
        let (steps, lanes) = (field.steps, field.lanes);
        self.sticks.clear();
        self.of_cell.clear();
        self.of_cell.resize(steps * lanes, NO_STICK);
        for lane in 0..lanes {
            let begin = self.sticks.len();
            let (block, place) = (lane / BLOCK, lane % BLOCK);
            let mut end = steps;
            while end > 0 {
                let last = end - 1;
                let first = end - usize::from(self.length[block * steps + last][place]);
                if field.is_valid(last * lanes + lane) {
                    self.sticks.push(measure(field, lane, first, last));
                }
                end = first;
            }
            self.sticks[begin..].reverse();
            for (k, stick) in self.sticks[begin..].iter().enumerate() {
                for step in stick.first..=stick.last {
                    self.of_cell[step as usize * lanes + lane] = (begin + k) as u32;
                }
            }
        }
    }
}

/// Up to four values, filled up with zeros.
#[inline]
fn four(values: &[f32]) -> Block {
    match values.first_chunk::<BLOCK>() {
        Some(&values) => Block::new(values),
        None => Block::new(std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))),
    }
}

/// The line of a stick and the two points that stand for it.
fn measure(field: &Field, lane: usize, first: usize, last: usize) -> Stick {
    let lanes = field.lanes;
    let n = (last - first + 1) as f64;
    let (mut t1, mut t2, mut f1, mut tf, mut f2) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let anchor = f64::from(field.inverse[first * lanes + lane]);
    let origin = f64::from(field.positions[first]);
    let mut gains = 0.0;
    for step in first..=last {
        gains += field.weight(step * lanes + lane);
        let t = f64::from(field.positions[step]) - origin;
        let f = f64::from(field.inverse[step * lanes + lane]) - anchor;
        t1 += t;
        t2 += t * t;
        f1 += f;
        tf += t * f;
        f2 += f * f;
    }
    let (mean_t, mean_f) = (t1 / n, f1 / n);
    let scatter = (t2 - t1 * mean_t).max(0.0);
    let product = tf - t1 * mean_f;
    let slope = if last > first { product / scatter } else { 0.0 };
    let reach = (scatter / n).sqrt();
    let left = (f2 - f1 * mean_f - slope * product).max(0.0);
    let middle = anchor + mean_f;
    let ends = [-reach, reach].map(|t| {
        let f = middle + slope * t;
        let ray = ray_at(field, lane, first, last, origin + mean_t + t);
        ray.map(|u| u / f)
    });
    let range = 1.0 / middle;
    Stick {
        lane: lane as u32,
        first: first as u32,
        last: last as u32,
        ends,
        weight: 0.5 * gains,
        n,
        error: left * range * range * (gains / n),
    }
}

/// The ray at a position between two steps of a lane.
fn ray_at(field: &Field, lane: usize, first: usize, last: usize, position: f64) -> [f64; 3] {
    let ray = |step: usize| {
        let cell = step * field.lanes + lane;
        field.point(cell).map(|v| v * f64::from(field.inverse[cell]))
    };
    // Steps are about evenly spaced: the search is short from there.
    let away = (position - f64::from(field.positions[first])) / f64::from(field.along_rad);
    let mut step = (first + away.max(0.0) as usize).min(last.saturating_sub(1)).max(first);
    while step > first && f64::from(field.positions[step]) >= position {
        step -= 1;
    }
    while step + 1 < last && f64::from(field.positions[step + 1]) < position {
        step += 1;
    }
    if step == last {
        return ray(step);
    }
    let (a, b) = (f64::from(field.positions[step]), f64::from(field.positions[step + 1]));
    let share = ((position - a) / (b - a)).clamp(0.0, 1.0);
    let (u, v) = (ray(step), ray(step + 1));
    std::array::from_fn(|i| u[i] + share * (v[i] - u[i]))
}
