//! Lanes cut into sticks: the longest runs of cells whose inverse range is a straight line.
//!
//! The cut of a lane is optimal: it minimises the sum of squared errors of the lines, in units of
//! the noise, plus a price for each stick. A dynamic programme finds it in O(n L) for sticks of at
//! most L cells, for many lanes at once. A stick never crosses an edge that shows in its own lane,
//! however narrow the surface, and edges along the lanes lie between sticks by construction.

use super::field::Field;
use super::moments::Moments;

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
const BLOCK: usize = 8;
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
    /// Least cost of each lane up to each step.
    cost: Vec<f32>,
    /// Length of the stick that ends at each cell, if one does.
    length: Vec<u8>,
    /// One over the noise of the inverse range at each cell.
    sharpness: Vec<f32>,
    tables: Vec<Table>,
}

/// What depends on the positions of a stick's steps alone, for sticks of one length.
#[derive(Clone, Copy, Debug, Default)]
struct Table {
    /// Position of the farthest step before the last one.
    back: f32,
    mean: f32,
    inverse_length: f32,
    /// One over the scatter of the positions.
    inverse_scatter: f32,
}

impl Sticks {
    /// Cuts all lanes of a field.
    pub fn cut(&mut self, field: &Field) {
        let (steps, lanes) = (field.steps, field.lanes);
        self.sharpness.clear();
        self.sharpness.extend(field.range.iter().map(|&r| {
            let range = f64::from(r);
            if r > 0.0 { (range * range / field.noise.sigma_m(range)) as f32 } else { 0.0 }
        }));
        self.cost.clear();
        self.cost.resize((steps + 1) * lanes, 0.0);
        self.length.clear();
        self.length.resize(steps * lanes, 1);
        for step in 0..steps {
            self.make_tables(field, step);
            for first in (0..lanes).step_by(BLOCK) {
                self.extend(field, step, first);
            }
        }
        self.collect(field);
    }

    fn make_tables(&mut self, field: &Field, step: usize) {
        self.tables.clear();
        let (mut sum, mut squares) = (0.0, 0.0);
        for k in 0..LONGEST.min(step + 1) {
            let back = field.positions[step] - field.positions[step - k];
            sum += back;
            squares += back * back;
            let length = (k + 1) as f32;
            let scatter = squares - sum * sum / length;
            self.tables.push(Table {
                back,
                mean: sum / length,
                inverse_length: 1.0 / length,
                inverse_scatter: if k > 0 { 1.0 / scatter.max(1e-14) } else { 0.0 },
            });
        }
    }

    /// The best stick that ends at `step`, for the lanes from `first` on.
    fn extend(&mut self, field: &Field, step: usize, first: usize) {
        let lanes = field.lanes;
        let count = BLOCK.min(lanes - first);
        let mut inverse = [0.0_f32; BLOCK];
        let mut sharpness = [0.0_f32; BLOCK];
        let here = step * lanes + first;
        inverse[..count].copy_from_slice(&field.inverse[here..here + count]);
        sharpness[..count].copy_from_slice(&self.sharpness[here..here + count]);
        let mut best = [f32::INFINITY; BLOCK];
        let mut length = [1.0_f32; BLOCK];
        // Relative to the scatter of the positions, what the prior of the slope is worth.
        let doubt: [f32; BLOCK] = std::array::from_fn(|i| {
            let slope = SLOPE * sharpness[i] * inverse[i];
            1.0 / (slope * slope).max(1e-6)
        });
        let (mut a, mut b, mut c) = ([0.0_f32; BLOCK], [0.0_f32; BLOCK], [0.0_f32; BLOCK]);
        for (k, table) in self.tables.iter().enumerate() {
            let at = (step - k) * lanes + first;
            let mut f = [0.0_f32; BLOCK];
            let mut before = [0.0_f32; BLOCK];
            f[..count].copy_from_slice(&field.inverse[at..at + count]);
            // The cost up to the step before is one row up in `cost`, whose row 0 is "nothing yet".
            before[..count].copy_from_slice(&self.cost[at..at + count]);
            for i in 0..BLOCK {
                let d = (f[i] - inverse[i]) * sharpness[i];
                a[i] += d;
                b[i] += table.back * d;
                c[i] += d * d;
                let slope = b[i] - table.mean * a[i];
                let told = table.inverse_scatter * (1.0 - doubt[i] * table.inverse_scatter);
                let error =
                    c[i] - a[i] * a[i] * table.inverse_length - slope * slope * told.max(0.0);
                let price = if k == 0 { PRICE - NO_SLOPE } else { PRICE };
                let cost = before[i] + error.max(0.0) + price;
                let better = cost < best[i];
                best[i] = if better { cost } else { best[i] };
                length[i] = if better { (k + 1) as f32 } else { length[i] };
            }
        }
        for i in 0..count {
            // A cell without a return is a stick of its own, at no price.
            let valid = sharpness[i] > 0.0;
            let at = here + i;
            self.cost[at + lanes] = if valid { best[i] } else { self.cost[at] };
            self.length[at] = if valid { length[i] as u8 } else { 1 };
        }
    }

    /// Walks every lane back from its end and lists its sticks.
    fn collect(&mut self, field: &Field) {
        let (steps, lanes) = (field.steps, field.lanes);
        self.sticks.clear();
        self.of_cell.clear();
        self.of_cell.resize(steps * lanes, NO_STICK);
        for lane in 0..lanes {
            let begin = self.sticks.len();
            let mut end = steps;
            while end > 0 {
                let last = end - 1;
                let first = end - usize::from(self.length[last * lanes + lane]);
                if field.is_valid(last * lanes + lane) {
                    let stick = self.measure(field, lane, first, last);
                    self.sticks.push(stick);
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

    /// The line of a stick and the two points that stand for it.
    fn measure(&self, field: &Field, lane: usize, first: usize, last: usize) -> Stick {
        let lanes = field.lanes;
        let n = (last - first + 1) as f64;
        let (mut t1, mut t2, mut f1, mut tf, mut f2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let anchor = f64::from(field.inverse[first * lanes + lane]);
        let origin = f64::from(field.positions[first]);
        for step in first..=last {
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
        let variance = field.noise.variance(range);
        Stick {
            lane: lane as u32,
            first: first as u32,
            last: last as u32,
            ends,
            weight: 0.5 * n * range * range / variance,
            n,
            error: left * range.powi(4) / variance,
        }
    }
}

/// The ray at a position between two steps of a lane.
fn ray_at(field: &Field, lane: usize, first: usize, last: usize, position: f64) -> [f64; 3] {
    let ray = |step: usize| {
        let cell = step * field.lanes + lane;
        field.point(cell).map(|v| v * f64::from(field.inverse[cell]))
    };
    let mut step = first;
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
