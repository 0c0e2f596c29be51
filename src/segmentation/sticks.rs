//! Lanes cut into sticks: the longest runs of cells whose inverse range is a straight line.
//!
//! The cut of a lane is optimal: it minimises the sum of squared errors of the lines, in units of
//! the noise, plus a price for each stick; see [`Cutter`]. A stick never crosses an edge that shows
//! in its own lane, however narrow the surface, and edges along the lanes lie between sticks by
//! construction.

use super::cut::{Cutter, LONGEST};
use super::field::Field;
use super::moments::Moments;
use std::ops::Range;

/// Most cells without a return between two sticks of a lane that are still neighbours.
const BRIDGED: u32 = 2;

/// Whole steps from the first of so many to the nearer of the two points that stand for them, where
/// they are evenly spaced: `(n - 1) / 2 - √((n² - 1) / 12)`.
const INNER: [usize; LONGEST + 1] = [0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2];

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
    /// The same of one reading.
    pub gain: f64,
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
    cutter: Cutter,
    /// First stick of each lane, and the end of the last.
    starts: Vec<u32>,
    /// Sticks of the lane before and of the lane after that touch each stick, corners included.
    beside: Vec<[Range<u32>; 2]>,
    /// Sums of the positions of the steps and of their squares, up to each step.
    sums: Vec<[f64; 2]>,
    /// One over the difference of the positions of each step and the next.
    per_gap: Vec<f32>,
}

impl Sticks {
    /// Cuts all lanes of a field.
    pub fn cut(&mut self, field: &Field) {
        self.cutter.cut(field);
        self.sums.clear();
        let mut sum = [0.0; 2];
        self.sums.push(sum);
        for &position in &field.positions {
            let position = f64::from(position);
            sum = [sum[0] + position, sum[1] + position * position];
            self.sums.push(sum);
        }
        self.per_gap.clear();
        self.per_gap.extend(field.positions.windows(2).map(|pair| 1.0 / (pair[1] - pair[0])));
        self.collect(field);
        self.link();
    }

    /// Walks every lane back from its end and lists its sticks.
    fn collect(&mut self, field: &Field) {
        let (steps, lanes) = (field.steps, field.lanes);
        self.sticks.clear();
        self.starts.clear();
        for lane in 0..lanes {
            let begin = self.sticks.len();
            self.starts.push(begin as u32);
            let (place, apart) = self.cutter.place(lane);
            let mut end = steps;
            while end > 0 {
                let last = end - 1;
                let first = end - self.cutter.length(place + last * apart);
                if self.cutter.inverse[place + last * apart] > 0.0 {
                    self.sticks.push(self.measure(field, lane, first, last));
                }
                end = first;
            }
            self.sticks[begin..].reverse();
        }
        self.starts.push(self.sticks.len() as u32);
    }

    /// Gives the cells of each stick a label, in an image as wide as there are lanes.
    pub fn paint(&self, labels: &mut [u32], label_of: impl Fn(usize) -> u32) {
        let lanes = self.starts.len().saturating_sub(1);
        for (s, stick) in self.sticks.iter().enumerate() {
            let label = label_of(s);
            let mut cell = stick.first as usize * lanes + stick.lane as usize;
            for _ in stick.first..stick.last + 1 {
                labels[cell] = label;
                cell += lanes;
            }
        }
    }

    /// Finds which sticks of neighbouring lanes touch.
    fn link(&mut self) {
        self.beside.clear();
        self.beside.resize(self.sticks.len(), [0..0, 0..0]);
        let lanes = self.starts.len() - 1;
        for lane in 0..lanes {
            for (side, other) in [lane.wrapping_sub(1), lane + 1].into_iter().enumerate() {
                if other >= lanes {
                    continue;
                }
                let (mut low, end) = (self.starts[other], self.starts[other + 1]);
                let mut high = low;
                for stick in self.starts[lane]..self.starts[lane + 1] {
                    let Stick { first, last, .. } = self.sticks[stick as usize];
                    while low < end && self.sticks[low as usize].last + 1 < first {
                        low += 1;
                    }
                    high = high.max(low);
                    while high < end && self.sticks[high as usize].first <= last + 1 {
                        high += 1;
                    }
                    self.beside[stick as usize][side] = low..high;
                }
            }
        }
    }

    /// The sticks of the lane before and of the lane after that touch a stick.
    pub fn beside(&self, stick: u32) -> &[Range<u32>; 2] {
        &self.beside[stick as usize]
    }

    /// The next stick of the same lane if no more than a few cells without a return are between.
    fn next(&self, stick: u32) -> Option<u32> {
        let here = &self.sticks[stick as usize];
        let other = self.sticks.get(stick as usize + 1)?;
        (other.lane == here.lane && other.first - here.last <= BRIDGED + 1).then_some(stick + 1)
    }

    /// All sticks that touch a stick, in order of lanes, then steps.
    pub fn near(&self, stick: u32) -> impl Iterator<Item = u32> + '_ {
        let [before, after] = self.beside(stick).clone();
        let last = stick.checked_sub(1).filter(|&last| self.next(last).is_some());
        before.chain(last).chain(self.next(stick)).chain(after)
    }

    /// Those of them that come after the stick.
    pub fn near_after(&self, stick: u32) -> impl Iterator<Item = u32> + '_ {
        self.next(stick).into_iter().chain(self.beside(stick)[1].clone())
    }

    /// The line of a stick and the two points that stand for it.
    fn measure(&self, field: &Field, lane: usize, first: usize, last: usize) -> Stick {
        let (place, apart) = self.cutter.place(lane);
        let cell = |step: usize| step * field.lanes + lane;
        let count = last - first + 1;
        let n = count as f64;
        let inverse = &self.cutter.inverse[place + first * apart..=place + last * apart];
        let anchor = f64::from(inverse[0]);
        let origin = f64::from(field.positions[first]);
        let (mut f1, mut tf, mut f2) = (0.0, 0.0, 0.0);
        let mut at = 0;
        for &position in &field.positions[first..=last] {
            let f = f64::from(inverse[at]) - anchor;
            let t = f64::from(position) - origin;
            at += apart;
            f1 += f;
            tf += t * f;
            f2 += f * f;
        }
        let (low, high) = (self.sums[first], self.sums[last + 1]);
        let t1 = (high[0] - low[0]) - n * origin;
        let t2 = (high[1] - low[1]) - origin * (2.0 * t1 + n * origin);
        let share = 1.0 / n;
        let (mean_t, mean_f) = (t1 * share, f1 * share);
        let scatter = (t2 - t1 * mean_t).max(0.0);
        let product = tf - t1 * mean_f;
        let slope = if last > first { product / scatter } else { 0.0 };
        let reach = (scatter * share).sqrt();
        let left = (f2 - f1 * mean_f - slope * product).max(0.0);
        let middle = anchor + mean_f;
        let guess = INNER[count];
        let guesses = [guess, count.saturating_sub(2 + guess)];
        let ends = [(-reach, guesses[0]), (reach, guesses[1])].map(|(t, guess)| {
            let range = 1.0 / (middle + slope * t);
            self.ray_at(field, lane, [first, last], mean_t + t, guess).map(|u| u * range)
        });
        // The gain changes smoothly along a stick.
        let [a, b, c] = [first, first + count / 2, last].map(|step| field.weight(cell(step)));
        let gain = (a + b + c) / 3.0;
        let range = 1.0 / middle;
        Stick {
            lane: lane as u32,
            first: first as u32,
            last: last as u32,
            ends,
            weight: 0.5 * gain * n,
            gain,
            n,
            error: left * range * range * gain,
        }
    }

    /// The ray of a lane at a position between two steps, which counts from the first; `guess` is
    /// where between them that is about.
    fn ray_at(
        &self,
        field: &Field,
        lane: usize,
        [first, last]: [usize; 2],
        position: f64,
        guess: usize,
    ) -> [f64; 3] {
        let lanes = field.lanes;
        let at = first * lanes + lane;
        if first == last {
            let inverse = field.inverse[at];
            return [field.x[at], field.y[at], field.z[at]].map(|v| f64::from(v * inverse));
        }
        let positions = &field.positions[first..=last];
        let position = position as f32 + positions[0];
        let mut step = guess.min(last - first - 1);
        while step > 0 && positions[step] >= position {
            step -= 1;
        }
        while step + 1 < last - first && positions[step + 1] < position {
            step += 1;
        }
        let share = (position - positions[step]) * self.per_gap[first + step];
        let share = share.clamp(0.0, 1.0);
        // Of one line between two rays, whose parts are inverse ranges times coordinates.
        let (a, b) = (at + step * lanes, at + (step + 1) * lanes);
        let (u, v) = ((1.0 - share) * field.inverse[a], share * field.inverse[b]);
        [
            f64::from(u * field.x[a] + v * field.x[b]),
            f64::from(u * field.y[a] + v * field.y[b]),
            f64::from(u * field.z[a] + v * field.z[b]),
        ]
    }
}
