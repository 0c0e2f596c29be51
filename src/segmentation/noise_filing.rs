//! Differences of readings filed by their size, in classes of what the noise may depend on.

use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Classes of range in which the variance is estimated apart.
pub(super) const RANGE_CLASSES: usize = 12;
/// Classes of size, eight to an octave, taken from the bits of a 32-bit float.
pub(super) const SIZE_CLASSES: usize = 128;
const SIZE_SHIFT: u32 = 20;
/// Size class of 2^-15 m, the smallest that is told apart: a third of the smallest standard deviation that
/// is. The largest is all beyond 2 m.
const FIRST_SIZE: u32 = (127 - 15) << 3;
/// Slope of the range over its angle, in units of the range, beyond which it is an edge's.
const STEEPEST: f32 = 4.0;
/// Slope over noise from which on an error of the angle may show; classes are octaves.
pub(super) const FLATTEST: f32 = 22.0;
/// A unit of one standard deviation that the size classes resolve, in metres.
pub(super) const ANGLE_UNIT: f32 = 0.01;

/// The class of a difference and its error, in metres or a unit like it.
pub(super) trait Filing: Copy {
    /// The class, and the error, of a difference between readings that begin at a step.
    fn file(&self, difference: Difference, step: usize) -> (u32, f32);
}

/// By the range.
#[derive(Clone, Copy)]
pub(super) struct ByRange {
    /// The nearest range, and classes per metre.
    pub span: (f32, f32),
}

impl Filing for ByRange {
    #[inline(always)]
    fn file(&self, difference: Difference, _: usize) -> (u32, f32) {
        (range_class(difference.range, self.span), difference.error_m())
    }
}

/// By the slope, from class 1 on, in units of what is known of the noise.
#[derive(Clone, Copy)]
pub(super) struct BySlope<'a> {
    /// Angles of the steps, and steps from one reading of a difference to the next.
    pub positions: &'a [f32],
    pub pitch: usize,
    /// The nearest range, and classes per metre.
    pub span: (f32, f32),
    /// Standard deviation in each class of range.
    pub sigmas: [f32; RANGE_CLASSES],
}

impl Filing for BySlope<'_> {
    #[inline(always)]
    fn file(&self, difference: Difference, step: usize) -> (u32, f32) {
        let turn = self.positions[step + 3 * self.pitch] - self.positions[step];
        let slope = difference.first.abs() / turn * difference.range;
        let sigma = self.sigmas[range_class(difference.range, self.span) as usize];
        let steepness = slope * difference.range / sigma;
        let class = ((steepness / FLATTEST).log2().floor().clamp(-1.0, 10.0) + 1.0) as u32;
        // In a unit that the size classes are made for.
        let error = difference.error_m() / sigma * ANGLE_UNIT;
        (if slope > STEEPEST { RANGE_CLASSES as u32 } else { class }, error)
    }
}

/// Samples that are reckoned at a time, of which so many are in a vector, and so many are filed in a go.
const RECKONED: usize = 256;
const IN_VECTOR: usize = 8;
const FILED: usize = 4;

/// Files the samples of some steps; those of cells without a return go beyond all classes.
pub(super) struct FileSteps<'a, F> {
    pub filing: F,
    /// The field's inverse ranges and ranges, and how wide it is.
    pub inverse: &'a [f32],
    pub range: &'a [f32],
    pub lanes: usize,
    /// The steps, and from one to the next that is looked at.
    pub steps: Range<usize>,
    pub stride: usize,
    /// Cells between the readings of a sample, and samples of a step.
    pub apart: usize,
    pub count: usize,
    /// Number and squares of the samples: bins of size, class after class, and one for what does not count.
    pub bins: &'a mut [[f32; 2]],
}

impl<F: Filing> WithSimd for FileSteps<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        const BEYOND: u32 = (RANGE_CLASSES * SIZE_CLASSES) as u32;
        let Self { filing, inverse, range, lanes, steps, stride, apart, count, bins } = self;
        // Which bin, and what is added to it, is found for many samples at once, in arrays that nothing else
        // can be in.
        let (mut places, mut samples) = ([0; RECKONED], [[0.0; 2]; RECKONED]);
        for step in steps.step_by(stride) {
            for part in (0..count).step_by(RECKONED) {
                let (first, count) = (step * lanes + part, (count - part).min(RECKONED));
                // There are readings of others after the last ones, for vectors to be full.
                let full = count.next_multiple_of(IN_VECTOR);
                let width = if first + 3 * apart + full <= inverse.len() { full } else { count };
                let row = |k: usize| &inverse[first + k * apart..first + k * apart + width];
                let ranges = &range[first + apart..first + apart + width];
                let readings = row(0).iter().zip(row(1)).zip(row(2)).zip(row(3)).zip(ranges);
                let filed = places.iter_mut().zip(&mut samples);
                for ((place, sample), ((((&a, &b), &c), &d), &range)) in filed.zip(readings) {
                    let (first, third) = (d - a, (a - d) + 3.0 * (c - b));
                    let difference = Difference { first, third, range };
                    let (class, error) = filing.file(difference, step);
                    let bin = class * SIZE_CLASSES as u32 + size_class(error);
                    *place = if a * b * c * d == 0.0 { BEYOND } else { bin.min(BEYOND) };
                    *sample = [1.0, error * error];
                }
                let end = count.next_multiple_of(FILED);
                places[count..end].fill(BEYOND);
                let (places, samples) = (&places[..end], &samples[..end]);
                let samples = samples.as_chunks::<FILED>().0;
                for (places, samples) in places.as_chunks::<FILED>().0.iter().zip(samples) {
                    for (&place, sample) in places.iter().zip(samples) {
                        let bin = &mut bins[place as usize];
                        *bin = [bin[0] + sample[0], bin[1] + sample[1]];
                    }
                }
            }
        }
    }
}

/// What four readings at equal distances differ by.
pub(super) struct Difference {
    /// Of the inverse ranges, the last from the first, per metre.
    first: f32,
    /// The third difference of the inverse ranges, per metre.
    third: f32,
    /// Range of the second, in metres.
    range: f32,
}

impl Difference {
    /// The third difference as one of ranges, in metres.
    #[inline(always)]
    fn error_m(&self) -> f32 {
        self.third.abs() * self.range * self.range
    }
}

#[inline(always)]
fn range_class(range: f32, (nearest, per_metre): (f32, f32)) -> u32 {
    let class = ((range - nearest) * per_metre - 0.5).clamp(0.0, RANGE_CLASSES as f32 - 1.0);
    // At this size the last bit of a number is one: the nearest whole number, without a conversion,
    // which would be made one by one.
    (class + 8_388_608.0).to_bits() & 0xf
}

#[inline(always)]
fn size_class(error: f32) -> u32 {
    let size = (error.to_bits() >> SIZE_SHIFT) as i32 - FIRST_SIZE as i32;
    size.clamp(0, SIZE_CLASSES as i32 - 1) as u32
}
