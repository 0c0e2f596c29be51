//! Lanes cut into sticks: runs of cells whose inverse range is a straight line.
//!
//! The cut minimises the sum of squared errors of the lines, in units of the noise, plus a price for
//! each stick, segment by segment of a lane; see [`Cutter`]. A stick never crosses an edge that shows
//! in its own lane, however narrow the surface, and edges along the lanes lie between sticks by
//! construction.

use super::cut::Cutter;
use super::field::Field;
use super::moments::Moments;
use super::run::Run;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Most cells without a return between two sticks of a lane that are still neighbours.
const BRIDGED: u32 = 2;

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
    /// The same of one reading, and its root.
    pub gain: f64,
    pub root_gain: f64,
    /// Number of readings, and one over it.
    pub n: f64,
    pub per_reading: f64,
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

/// Which sticks of another lane, the first of which is given, touch each stick of a lane.
fn touch(lane: &[[u32; 2]], other: &[[u32; 2]], first: u32, mut put: impl FnMut(usize, [u32; 2])) {
    let (mut low, mut high) = (0, 0);
    for (stick, &[begin, last]) in lane.iter().enumerate() {
        while other.get(low).is_some_and(|other| other[1] + 1 < begin) {
            low += 1;
        }
        high = high.max(low);
        while other.get(high).is_some_and(|other| other[0] <= last + 1) {
            high += 1;
        }
        put(stick, [first + low as u32, first + high as u32]);
    }
}

/// All sticks of a scan, lane after lane, each lane in order of steps.
#[derive(Clone, Debug, Default)]
pub(super) struct Sticks {
    pub sticks: Vec<Stick>,
    cutter: Cutter,
    /// First stick of each lane, and the end of the last.
    starts: Vec<u32>,
    /// First and last step of each stick, close together.
    pub spans: Vec<[u32; 2]>,
    /// Sticks of the lane before, of its own and of the lane after that touch each stick, corners
    /// included: first and end each. Its own are a stick itself and those next to it.
    beside: Vec<[[u32; 2]; 3]>,
    /// One over the difference of the positions of each step and the next.
    per_gap: Vec<f32>,
    /// For each step how many sticks begin up to it, and the lanes and labels of sticks in the order of
    /// their first steps.
    beginnings: Vec<u32>,
    order: Vec<(u32, u32)>,
    /// Labels of the sticks that the lanes are in.
    row: Vec<u32>,
}

/// Writing labels row by row.
struct Paint<'a> {
    field: &'a Field,
    begun: &'a [u32],
    order: &'a [(u32, u32)],
    row: &'a mut [u32],
    no_return: u32,
    labels: &'a mut [u32],
}

impl WithSimd for Paint<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { field, begun, order, row, no_return, labels } = self;
        let lanes = field.lanes.max(1);
        let rows = labels.chunks_exact_mut(lanes).zip(field.range.chunks_exact(lanes));
        let mut begin = 0;
        for ((labels, ranges), &end) in rows.zip(begun) {
            for &(lane, label) in &order[begin..end as usize] {
                row[lane as usize] = label;
            }
            begin = end as usize;
            for ((label, &range), &stick) in labels.iter_mut().zip(ranges).zip(&*row) {
                *label = if range > 0.0 { stick } else { no_return };
            }
        }
    }
}

impl Sticks {
    /// Cuts all lanes of a field.
    pub fn cut(&mut self, field: &Field) {
        self.cutter.cut(field);
        self.per_gap.clear();
        self.per_gap.extend(field.positions.windows(2).map(|pair| 1.0 / (pair[1] - pair[0])));
        self.collect(field);
        self.link();
    }

    /// Lists the sticks of all lanes.
    fn collect(&mut self, field: &Field) {
        self.sticks.clear();
        self.starts.clear();
        self.spans.clear();
        let Self { sticks, cutter, starts, spans, per_gap, .. } = self;
        for lane in 0..field.lanes {
            starts.push(spans.len() as u32);
            cutter.for_each_run(field, lane, |run| {
                spans.push([run.first, run.end - 1]);
                sticks.push(measure(field, per_gap, lane, run));
            });
        }
        starts.push(sticks.len() as u32);
    }

    /// Gives the cells of each stick a label, and those without a return another one.
    ///
    /// A row is the labels of the sticks that its lanes are in, so few of which change from the row before
    /// that whole rows are written.
    pub fn paint(
        &mut self,
        field: &Field,
        label_of: impl Fn(usize) -> u32,
        no_return: u32,
        labels: &mut Vec<u32>,
    ) {
        let Self { sticks, beginnings, order, row, .. } = self;
        beginnings.clear();
        beginnings.resize(field.steps + 1, 0);
        for stick in &*sticks {
            beginnings[stick.first as usize + 1] += 1;
        }
        for step in 0..field.steps {
            beginnings[step + 1] += beginnings[step];
        }
        order.resize(sticks.len(), (0, 0));
        for (s, stick) in sticks.iter().enumerate() {
            let place = &mut beginnings[stick.first as usize];
            order[*place as usize] = (stick.lane, label_of(s));
            *place += 1;
        }
        labels.resize(field.len(), no_return);
        row.clear();
        row.resize(field.lanes, no_return);
        // Each beginning has moved to the next one's place.
        Arch::new().dispatch(Paint { field, begun: beginnings, order, row, no_return, labels });
    }

    /// Finds which sticks touch.
    fn link(&mut self) {
        let lanes = self.starts.len() - 1;
        self.beside.clear();
        for lane in 0..lanes {
            let own = self.starts[lane]..self.starts[lane + 1];
            // How far the gap to the stick before is bridged.
            let mut bridged = 0;
            for stick in own.clone() {
                let last = self.spans[stick as usize][1];
                let next = self.spans[stick as usize + 1..own.end as usize].first();
                let is_near = next.is_some_and(|next| next[0] - last <= BRIDGED + 1);
                let end = stick + 1 + u32::from(is_near);
                self.beside.push([[0, 0], [stick - bridged, end], [0, 0]]);
                bridged = u32::from(is_near);
            }
        }
        for lane in 1..lanes {
            let (before, here) = (self.starts[lane - 1], self.starts[lane]);
            let end = self.starts[lane + 1];
            let (low, rest) = self.beside.split_at_mut(here as usize);
            let (low_spans, rest_spans) = self.spans.split_at(here as usize);
            let (low, low_spans) = (&mut low[before as usize..], &low_spans[before as usize..]);
            let count = (end - here) as usize;
            let (high, high_spans) = (&mut rest[..count], &rest_spans[..count]);
            touch(low_spans, high_spans, here, |stick, range| low[stick][2] = range);
            touch(high_spans, low_spans, before, |stick, range| high[stick][0] = range);
        }
    }

    /// The sticks of the lane before and of the lane after that touch a stick.
    pub fn beside(&self, stick: u32) -> [Range<u32>; 2] {
        let [before, _, after] = self.around(stick);
        [before, after]
    }

    /// The sticks that touch a stick, in order of lanes, then steps; it is one of them.
    pub fn around(&self, stick: u32) -> [Range<u32>; 3] {
        self.beside[stick as usize].map(|[first, end]| first..end)
    }

    /// Those of them that come after the stick.
    pub fn after(&self, stick: u32) -> [Range<u32>; 2] {
        let [_, [_, end], [first_after, end_after]] = self.beside[stick as usize];
        [stick + 1..end, first_after..end_after]
    }
}

/// The stick of a run, and the two points that stand for it.
#[inline]
fn measure(field: &Field, per_gap: &[f32], lane: usize, run: &Run) -> Stick {
    let (begin, end) = (run.first as usize, run.end as usize);
    let count = end - begin;
    let n = count as f64;
    let per_reading = 1.0 / count as f32;
    let reach = (run.scatter * per_reading).sqrt();
    // Whole steps from the first to the nearer of the two points where they are evenly spaced:
    // `(n - 1) / 2 - √((n² - 1) / 12)`.
    let guess = (0.211_325 * count as f32 - 0.5).max(0.0) as usize;
    let guesses = [guess, count.saturating_sub(2 + guess)];
    // Inverse ranges at the two points, and from one division the ranges.
    let rise = run.slope * reach;
    let (low, high) = (run.inverse - rise, run.inverse + rise);
    let per_product = 1.0 / (low * high);
    let end_at = |position: f32, range: f32, guess: usize| {
        let ray = ray_at(field, per_gap, lane, [begin, end], position, guess);
        ray.map(|v| f64::from(v * range))
    };
    let ends = [
        end_at(run.middle - reach, high * per_product, guesses[0]),
        end_at(run.middle + reach, low * per_product, guesses[1]),
    ];
    // The gain changes smoothly along a stick.
    let gain_at = |step: usize| field.gain[step * field.lanes + lane].powi(2);
    let gain = (gain_at(begin) + gain_at(begin + count / 2) + gain_at(end - 1)) * (1.0 / 3.0);
    let (gain, root_gain) = (f64::from(gain), f64::from(gain.sqrt()));
    Stick {
        lane: lane as u32,
        first: run.first,
        last: run.end - 1,
        ends,
        weight: 0.5 * gain * n,
        gain,
        root_gain,
        n,
        per_reading: f64::from(per_reading),
        error: f64::from(run.error * per_product) * gain,
    }
}

/// The ray of a lane at a position of `begin..end` steps; `guess` is between which of them, counted
/// from the first, that is about.
#[inline(always)]
fn ray_at(
    field: &Field,
    per_gap: &[f32],
    lane: usize,
    [begin, end]: [usize; 2],
    position: f32,
    guess: usize,
) -> [f32; 3] {
    let lanes = field.lanes;
    let at = begin * lanes + lane;
    if end - begin == 1 {
        let inverse = field.inverse[at];
        return [field.x[at] * inverse, field.y[at] * inverse, field.z[at] * inverse];
    }
    let positions = &field.positions[begin..end];
    let most = positions.len() - 2;
    let mut step = guess.min(most);
    while step > 0 && positions[step] >= position {
        step -= 1;
    }
    while step < most && positions[step + 1] < position {
        step += 1;
    }
    let share = (position - positions[step]) * per_gap[begin + step];
    let share = share.clamp(0.0, 1.0);
    // Of one line between two rays, whose parts are inverse ranges times coordinates.
    let first = at + step * lanes;
    let ends = |array: &[f32]| {
        let pair = &array[first..first + lanes + 1];
        (pair[0], pair[lanes])
    };
    let (inverse, x, y, z) = (ends(&field.inverse), ends(&field.x), ends(&field.y), ends(&field.z));
    let (u, v) = ((1.0 - share) * inverse.0, share * inverse.1);
    [u * x.0 + v * x.1, u * y.0 + v * y.1, u * z.0 + v * z.1]
}
