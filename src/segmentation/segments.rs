//! Whole segments of lanes that are straight, told apart from those that need to be cut.
//!
//! Most of a scan is the inside of surfaces. So the steps are divided into segments, and of each it is
//! asked first, for many lanes at once, whether one cut anywhere in it would be worth its price. That takes
//! running sums alone, a small part of what it takes to seek the best of all cuts.

use super::field::Field;
use super::vectors::run;
use pulp::{Simd, WithSimd};

/// Most steps of a segment.
pub(super) const SEGMENT: usize = 16;
/// Lanes by whose number rows are filled up: as many as the vectors of any processor can share.
pub(super) const ROW: usize = 16;

/// The kinds of segments as numbers.
const EMPTY: u32 = 0;
const STRAIGHT: u32 = 1;
const OPEN: u32 = 2;

/// What a segment is for a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Nothing came back.
    Empty,
    /// One straight run.
    Straight,
    /// To be cut.
    Open,
}

/// What lines through the first or the last readings of a segment need of its positions, which are told
/// from the middle of these.
#[derive(Clone, Copy, Debug, Default)]
struct Share {
    position: f32,
    /// One over the number of readings before and including this step, their mean position, and one over
    /// their scatter; zero where there is none.
    before: [f32; 3],
    /// The same of the readings after it.
    after: [f32; 3],
}

/// The lines through one segment of all lanes, in rows that are filled up.
#[derive(Clone, Debug, Default)]
pub(super) struct Straight {
    /// Mean of the positions, and their scatter.
    pub middle: f32,
    pub scatter: f32,
    shares: Vec<Share>,
    kinds: Vec<u32>,
    pub inverse: Vec<f32>,
    pub slope: Vec<f32>,
    pub error: Vec<f32>,
}

impl Straight {
    /// Looks at the segment of a field that begins with a step.
    pub fn look(&mut self, field: &Field, begin: usize, end: usize, price: f32) {
        self.set_positions(&field.positions[begin..end]);
        let width = field.lanes.next_multiple_of(ROW);
        self.kinds.resize(width, 0);
        for row in [&mut self.inverse, &mut self.slope, &mut self.error] {
            row.resize(width, 0.0);
        }
        let look = Look { straight: self, field, begin, price };
        run(look);
    }

    /// Leaves all lanes to be cut.
    pub fn leave_open(&mut self, lanes: usize) {
        self.kinds.clear();
        self.kinds.resize(lanes.next_multiple_of(ROW), OPEN);
    }

    pub fn kind(&self, lane: usize) -> Kind {
        match self.kinds[lane] {
            EMPTY => Kind::Empty,
            STRAIGHT => Kind::Straight,
            _ => Kind::Open,
        }
    }

    fn set_positions(&mut self, positions: &[f32]) {
        let n = positions.len() as f64;
        let first = f64::from(positions[0]);
        let mean = positions.iter().map(|&p| f64::from(p) - first).sum::<f64>() / n;
        self.shares.clear();
        let mut sums = [0.0; 3];
        let share_of = |[n, t, tt]: [f64; 3]| {
            let scatter = tt - t * t / n;
            let per_scatter = if n > 1.5 { 1.0 / scatter.max(1e-14) } else { 0.0 };
            [1.0 / n, t / n, per_scatter].map(|value| value as f32)
        };
        for &position in positions {
            let t = f64::from(position) - first - mean;
            sums = [sums[0] + 1.0, sums[1] + t, sums[2] + t * t];
            self.shares.push(Share { position: t as f32, before: share_of(sums), after: [0.0; 3] });
        }
        let mut sums_after = [0.0; 3];
        for share in self.shares.iter_mut().rev() {
            if sums_after[0] > 0.5 {
                share.after = share_of(sums_after);
            }
            let t = f64::from(share.position);
            sums_after = [sums_after[0] + 1.0, sums_after[1] + t, sums_after[2] + t * t];
        }
        self.middle = (first + mean) as f32;
        self.scatter = sums[2] as f32;
    }
}

struct Look<'a> {
    straight: &'a mut Straight,
    field: &'a Field,
    begin: usize,
    price: f32,
}

impl WithSimd for Look<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { straight, field, begin, price } = self;
        let Straight { middle: _, scatter, shares, kinds, inverse, slope, error } = straight;
        let lanes = field.lanes;
        // Readings that err alike break a line no more than one of them does.
        let price = simd.splat_f32s(price * field.errors.run as f32);
        let kinds = S::as_mut_simd_u32s(kinds).0;
        let inverse = S::as_mut_simd_f32s(inverse).0;
        let slope = S::as_mut_simd_f32s(slope).0;
        let error = S::as_mut_simd_f32s(error).0;
        let outputs = kinds.iter_mut().zip(inverse).zip(slope).zip(error);
        for (k, (((kind, inverse), slope), error)) in outputs.enumerate() {
            let lane = k * S::F32_LANES;
            if lane >= lanes {
                break;
            }
            let row = |array: &[f32], step: usize| {
                let row = &array[(begin + step) * lanes + lane..];
                match S::as_simd_f32s(row).0.first() {
                    // What is beyond the row's end is of the next one, and not looked at.
                    Some(&vector) => vector,
                    None => simd.partial_load_f32s(row),
                }
            };
            let steps: &[Share] = shares;
            let seen = look_at(simd, steps, *scatter, |step| row(&field.inverse, step));
            let middle = steps.len() / 2;
            let sharpness = simd.mul_f32s(row(&field.gain, middle), row(&field.range, middle));
            let gain = simd.mul_f32s(seen.gain, simd.mul_f32s(sharpness, sharpness));
            let zero = simd.splat_f32s(0.0);
            let is_straight = simd.and_m32s(
                simd.less_than_f32s(gain, price),
                simd.greater_than_f32s(seen.least, zero),
            );
            let [empty, straight, open] = [EMPTY, STRAIGHT, OPEN].map(|kind| simd.splat_u32s(kind));
            let straight = simd.select_u32s(is_straight, straight, open);
            let any = simd.greater_than_f32s(seen.greatest, zero);
            *kind = simd.select_u32s(any, straight, empty);
            (*inverse, *slope, *error) = (seen.inverse, seen.slope, seen.error);
        }
    }
}

/// What readings of a segment are, for the lanes of a vector.
struct Seen<V> {
    least: V,
    greatest: V,
    /// The line, and the squared errors that it leaves.
    inverse: V,
    slope: V,
    error: V,
    /// By how much less two lines in place of one would leave at best.
    gain: V,
}

#[inline(always)]
fn look_at<S: Simd>(
    simd: S,
    shares: &[Share],
    scatter: f32,
    reading: impl Fn(usize) -> S::f32s,
) -> Seen<S::f32s> {
    let count = shares.len().min(SEGMENT);
    let shares = &shares[..count];
    let zero = simd.splat_f32s(0.0);
    let (low, high) = (shares[0].position, shares[count - 1].position);
    // What readings differ by from the line through the first and the last of them is small wherever one
    // line will do, and its squares can be subtracted.
    let first = reading(0);
    let per_length = if high > low { 1.0 / (high - low) } else { 0.0 };
    let chord =
        simd.mul_f32s(simd.sub_f32s(reading(count - 1), first), simd.splat_f32s(per_length));
    let at_middle = simd.sub_f32s(first, simd.mul_f32s(chord, simd.splat_f32s(low)));
    let mut sums = [[zero; 2]; SEGMENT];
    let (mut a, mut b, mut c) = (zero, zero, zero);
    let (mut least, mut greatest) = (first, first);
    for (step, (share, sums)) in shares.iter().zip(&mut sums).enumerate() {
        let reading = reading(step);
        least = simd.min_f32s(least, reading);
        greatest = simd.max_f32s(greatest, reading);
        let position = simd.splat_f32s(share.position);
        let d = simd.sub_f32s(reading, simd.mul_add_e_f32s(chord, position, at_middle));
        a = simd.add_f32s(a, d);
        b = simd.mul_add_e_f32s(position, d, b);
        c = simd.mul_add_e_f32s(d, d, c);
        *sums = [a, b];
    }
    let per_count = simd.splat_f32s(1.0 / count as f32);
    let per_scatter = simd.splat_f32s(if scatter > 0.0 { 1.0 / scatter } else { 0.0 });
    let mean = simd.mul_f32s(a, per_count);
    let turn = simd.mul_f32s(b, per_scatter);
    let whole = simd.mul_add_e_f32s(a, mean, simd.mul_f32s(b, turn));
    let mut best = zero;
    for (share, &[left_a, left_b]) in shares[..count - 1].iter().zip(&sums) {
        let left = explained(simd, share.before, left_a, left_b);
        let (right_a, right_b) = (simd.sub_f32s(a, left_a), simd.sub_f32s(b, left_b));
        let right = explained(simd, share.after, right_a, right_b);
        best = simd.max_f32s(best, simd.add_f32s(left, right));
    }
    Seen {
        least,
        greatest,
        inverse: simd.add_f32s(at_middle, mean),
        slope: simd.add_f32s(chord, turn),
        error: simd.max_f32s(simd.sub_f32s(c, whole), zero),
        gain: simd.sub_f32s(best, whole),
    }
}

/// What a line explains of the squares of readings with these sums.
#[inline(always)]
fn explained<S: Simd>(
    simd: S,
    [per_count, mean, per_scatter]: [f32; 3],
    a: S::f32s,
    b: S::f32s,
) -> S::f32s {
    let product = simd.sub_f32s(b, simd.mul_f32s(simd.splat_f32s(mean), a));
    let sloped = simd.mul_f32s(simd.mul_f32s(product, product), simd.splat_f32s(per_scatter));
    simd.mul_add_e_f32s(simd.mul_f32s(a, a), simd.splat_f32s(per_count), sloped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::PointGrid;
    use crate::segmentation::{RangeNoise, ReadingErrors};

    /// A field of 16 steps whose lanes see a wall through a fan; `shift_m` moves readings towards it.
    fn field(lanes: usize, shift_m: impl Fn(usize, usize) -> f32) -> Field {
        let points = (0..SEGMENT * lanes).map(|i| {
            let (step, lane) = (i / lanes, i % lanes);
            let (tilt, bearing) = (step as f32 * 0.004, lane as f32 * 0.02);
            let ray = [tilt.cos() * bearing.cos(), bearing.sin(), -tilt.sin() * bearing.cos()];
            let range = 3.0 / ray[0] - shift_m(step, lane);
            // What is shifted beyond the sensor has no return.
            if range > 0.0 { ray.map(|v| v * range) } else { [0.0; 3] }
        });
        let mut field = Field::default();
        field.load(&PointGrid::new(SEGMENT, lanes, points.collect()));
        field.set_errors(ReadingErrors::independent(RangeNoise::uniform(0.01)));
        field
    }

    #[test]
    fn a_wall_is_straight_and_a_step_is_open_and_where_nothing_came_back_is_empty() {
        let field = field(21, |step, lane| match lane {
            2 => 9.0,
            5 if step == 3 => 9.0,
            9 if step > 11 => 0.1,
            20 if step < 2 => 0.1,
            _ => 0.0,
        });
        assert!(!field.transposed);
        let mut segment = Straight::default();
        segment.look(&field, 0, SEGMENT, 9.0);
        for lane in 0..21 {
            let expected = match lane {
                2 => Kind::Empty,
                5 | 9 | 20 => Kind::Open,
                _ => Kind::Straight,
            };
            assert_eq!(segment.kind(lane), expected, "lane {lane}");
        }
    }
}
