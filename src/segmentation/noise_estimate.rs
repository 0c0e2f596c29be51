//! How noisy the ranges are, told from the scan itself.
//!
//! Along a lane the inverse range of a smooth surface hardly has a third difference: the angle
//! between neighbours is small, and the inverse range of a plane is linear in the ray's direction.
//! What is left of it is noise of known gain. Edges are outliers that a trimmed variance ignores.

use super::field::Field;
use super::noise::{RangeNoise, ReadingErrors};
use super::noise_filing::{
    ANGLE_UNIT, ByRange, BySlope, FLATTEST, FileSteps, Filing, RANGE_CLASSES, SIZE_CLASSES,
};
use super::noise_model::{Class, model};
use pulp::Arch;
use std::ops::Range;

/// Variance of a third difference of white noise of unit variance: 1 + 9 + 9 + 1.
const GAIN: f64 = 20.0;
/// Share of the samples, the smallest, that make the estimate: up to 40 % may be edges.
const KEPT: f64 = 0.6;
/// Variance of a standard normal variable that is cut at its KEPT quantile of size (0.8416).
const KEPT_VARIANCE: f64 = 0.2146;
/// The same for differences over wider pitches, up to 65 % of which may be edges.
const FAR_KEPT: f64 = 0.35;
const FAR_KEPT_VARIANCE: f64 = 0.0667;
/// The part of them that tells how many are edges, as they scatter more and more the more of them are kept,
/// and its variance.
const CHECKED: f64 = 0.7;
const CHECKED_VARIANCE: f64 = 0.3096;
/// Where each twentieth of the differences cross edges, from none on: what the part that is checked has more
/// of a variance than the part that is kept, and this one than there is without them. With `v(q)` the
/// variance of a standard normal variable that is cut at its q quantile of size, and a share p of edges, both
/// follow from `v(q / (1 - p)) / v(q)`.
const BY_EDGES: [(f64, f64); 7] = [
    (1.0, 1.0),
    (1.0219, 1.1131),
    (1.0506, 1.2469),
    (1.0900, 1.4069),
    (1.1477, 1.6008),
    (1.2442, 1.8389),
    (1.5120, 2.1365),
];
/// Ratio of variances beyond which the wider pitch counts.
const MUCH_LARGER: f64 = 1.7;
/// Smallest standard deviation that is told apart: readings that are rounded may all agree.
const LEAST_M: f64 = 1e-4;
/// Bins that are added up at a time; a class has some times as many.
const COUNTED: usize = 8;
/// Fewest samples that make a class of range count.
const FEWEST: f64 = 60.0;
/// About how many samples are taken of a scan: of next neighbours, which tell the
/// variance to 2 %, and of others, which only have to tell whether theirs is much larger.
const SAMPLES: usize = 10_000;
const FAR_SAMPLES: usize = 3_000;
/// Widest pitch of the differences that tell how far errors are alike: 2.3°, with four of them less
/// than most things are wide; and in cells.
const WIDEST_RAD: f32 = 0.04;
const WIDEST_CELLS: usize = 16;
/// Growth of the variance over a doubled pitch below which the errors are alike no more.
const STILL_GROWING: f64 = 1.3;
/// Least share of the samples of a slope class that counts.
const LEAST_SHARE: f64 = 0.02;
/// Power of the squared slope with which the variance rises at least where it does. It is 1 without
/// any other noise; scans with independent ranges have up to 0.1, for their edges.
const LEAST_RISE: f64 = 0.4;
/// Ratio of the variances that two parts of the samples tell, from which on they are of several sizes.
const MIXED: f64 = 1.03;
/// The same ratio beyond which edges alone are no reason for it.
const SEVERAL: f64 = 1.25;
/// Buffers of the estimate.
#[derive(Clone, Debug)]
pub(super) struct NoiseEstimator {
    /// Number and squares of the samples: bins of size, class after class, and one for what does not
    /// count.
    bins: Vec<[f32; 2]>,
    classes: Vec<Class>,
}

/// What each class of range tells, where it has enough samples.
type Classes = [Option<Class>; RANGE_CLASSES];

impl Default for NoiseEstimator {
    fn default() -> Self {
        Self {
            bins: vec![[0.0; 2]; RANGE_CLASSES * SIZE_CLASSES + 1],
            classes: Vec::with_capacity(RANGE_CLASSES),
        }
    }
}

/// Cells apart, along and across, of the four readings of a third difference, and what is kept of
/// them.
#[derive(Clone, Copy, Debug)]
struct Probe {
    down: usize,
    right: usize,
    kept: f64,
    /// Variance of a standard normal variable that is cut at its `kept` quantile of size.
    kept_variance: f64,
    /// About how many samples are taken.
    samples: usize,
}

impl Probe {
    fn near() -> Self {
        let (kept, kept_variance) = (KEPT, KEPT_VARIANCE);
        Self { down: 1, right: 0, kept, kept_variance, samples: SAMPLES }
    }

    fn far(down: usize, right: usize) -> Self {
        let (kept, kept_variance) = (FAR_KEPT, FAR_KEPT_VARIANCE);
        Self { down, right, kept, kept_variance, samples: FAR_SAMPLES }
    }
}

impl NoiseEstimator {
    /// The errors of the readings in a field. A scan without enough neighbours gets 10 mm.
    ///
    /// Readings of a real scanner err together: they are rounded, a row's tilt is off, depth from
    /// triangulation is correlated over several pixels. Next neighbours then agree better than a
    /// surface is known. So differences over a wider pitch along, and across, are taken too; they
    /// cross more edges, and a smaller part of them is kept. Where these are much larger all over the
    /// scan, or the differences are not of one size, it is asked whether that is an error of the
    /// angle, which shows with the slope of the surfaces, and if not, over how many cells the errors
    /// are alike.
    pub fn estimate(&mut self, field: &Field) -> ReadingErrors {
        let [nearest, farthest] = field.extent;
        let span = (nearest, RANGE_CLASSES as f32 / (farthest - nearest).max(1e-3));
        if field.knows_row_errors() {
            let (down, right) = if field.transposed { (1, 0) } else { (0, 1) };
            let (within, _) = self.measure(field, span, Probe { down, right, ..Probe::near() });
            return ReadingErrors::independent(self.model([&within]));
        }
        let pitch = ((field.across_rad / field.along_rad).round() as usize).clamp(3, 8);
        let near = self.measure(field, span, Probe::near());
        // Noise of one size has the same variance whatever part of it is kept.
        let mixed = growth(&near.1, &near.0) > MIXED;
        let (near, near_far_part) = near;
        let of_one_size = growth(&near_far_part, &near) <= SEVERAL;
        let along = self.measure_far(field, span, [pitch, 0], of_one_size);
        // Across, it is asked whether errors are smaller, of which edges hide some and make up none.
        let across = self.measure_far(field, span, [0, 1], false);
        let alike = growth(&near, &along) > MUCH_LARGER;
        let angle = if alike || mixed || growth(&across, &near) > MUCH_LARGER {
            self.angle_error(field, span, pitch, &near)
        } else {
            None
        };
        if !alike && angle.is_none() {
            return ReadingErrors::independent(self.model([&near, &along, &across]));
        }
        let (along, length) = self.follow(field, (span, of_one_size), [pitch, 0], along, &near);
        let common = if alike { (1.0 - 1.0 / growth(&near, &along)).max(0.0) } else { 0.0 };
        let run = 1.0 + common * (length - 1.0);
        if let Some(angle_rad) = angle {
            // Along, the errors of the angle are told apart; what shows across is the range's.
            let noise = self.model([&near, &across]);
            return ReadingErrors { noise, angle_rad, common, run, patch: run, inflation: run };
        }
        let (across, width) = self.follow(field, (span, false), [0, 1], across, &across);
        let noise = self.model([&near, &along, &across]);
        let patch = 1.0 + common * (length * width - 1.0);
        ReadingErrors { noise, angle_rad: 0.0, common, run, patch, inflation: patch }
    }

    /// The noise that the first classes tell, or the others where these are much larger.
    fn model<const N: usize>(&mut self, told: [&Classes; N]) -> RangeNoise {
        self.classes.clear();
        for class in 0..RANGE_CLASSES {
            if let Some(near) = told[0][class] {
                let wider = told[1..].iter().filter_map(|wider| wider[class]);
                let wider = wider.map(|wider| wider.variance);
                let wider = wider.filter(|&variance| variance > MUCH_LARGER * near.variance);
                let variance = wider.fold(near.variance, f64::max);
                self.classes.push(Class { variance, ..near });
            }
        }
        model(&self.classes)
    }

    /// Follows the variance from `first`, that of differences over the pitch `[down, right]`, to
    /// twice as wide ones until it grows no more: the variance there, and the pitch at which it has
    /// come half way there from `least`.
    fn follow(
        &mut self,
        field: &Field,
        (span, less_edges): ((f32, f32), bool),
        [down, right]: [usize; 2],
        first: Classes,
        least: &Classes,
    ) -> (Classes, f64) {
        let (pitch, cells) =
            if down > 0 { (field.along_rad, field.steps) } else { (field.across_rad, field.lanes) };
        let widest = ((WIDEST_RAD / pitch) as usize).min(cells / 12).min(WIDEST_CELLS);
        let mut steps = [(0, 0.0); 8];
        let mut count = 0;
        let (mut last, mut scale) = (first, 1);
        loop {
            steps[count] = (scale * down.max(right), growth(least, &last));
            count += 1;
            if 2 * scale * down.max(right) > widest || count == steps.len() {
                break;
            }
            let wider = [2 * scale * down, 2 * scale * right];
            let next = self.measure_far(field, span, wider, less_edges);
            if growth(&last, &next) < STILL_GROWING {
                break;
            }
            (last, scale) = (next, 2 * scale);
        }
        let full = steps[count - 1].1;
        let half = steps[..count].iter().find(|step| step.1 >= 0.5 * full);
        let length = half.map_or(1, |step| step.0);
        (last, if full > MUCH_LARGER { length as f64 } else { 1.0 })
    }

    /// Standard deviation of the rays' angles along; `None` where errors of the angle do not show.
    ///
    /// An error of the angle shows as one of range in proportion to the range's slope over the angle:
    /// the variances of slope classes, in units of what `near` says of the range, rise with the
    /// squared slope, in those units.
    fn angle_error(
        &mut self,
        field: &Field,
        span: (f32, f32),
        pitch: usize,
        near: &Classes,
    ) -> Option<f64> {
        let model = self.model([near]);
        // The middle of each class of range stands for it.
        let sigmas: [f32; RANGE_CLASSES] = std::array::from_fn(|class| {
            model.sigma_m(f64::from(span.0) + (class as f64 + 0.5) / f64::from(span.1)) as f32
        });
        let by_slope = BySlope { positions: &field.positions, pitch, span, sigmas };
        self.gather(field, [pitch, 0], SAMPLES, by_slope);
        let mut told = [SlopeClass::default(); RANGE_CLASSES];
        let all = self.samples(1..RANGE_CLASSES);
        let fewest = FEWEST.max(LEAST_SHARE * all);
        let mut count = 0;
        let unit = f64::from(ANGLE_UNIT);
        for class in 1..RANGE_CLASSES {
            let samples = self.samples(class..class + 1);
            if samples >= fewest {
                let kept = trimmed_mean(&self.bins[bins_of(class..class + 1)], samples, KEPT);
                let variance = kept / (KEPT_VARIANCE * GAIN * unit * unit);
                let steepness = f64::from(FLATTEST) * 2.0_f64.powf(class as f64 - 0.5);
                told[count] = SlopeClass { steepness, variance, samples };
                count += 1;
            }
        }
        angle_of(&told[..count])
    }

    /// Takes differences of four readings, `[down, right]` cells apart along and across, and counts the
    /// size of each in the class in which it is filed.
    fn gather(
        &mut self,
        field: &Field,
        [down, right]: [usize; 2],
        samples: usize,
        filing: impl Filing,
    ) {
        self.bins.fill([0.0; 2]);
        let lanes = field.lanes;
        let last = lanes.saturating_sub(3 * right);
        if last == 0 {
            return;
        }
        Arch::new().dispatch(FileSteps {
            filing,
            inverse: &field.inverse,
            range: &field.range,
            lanes,
            steps: 0..field.steps.saturating_sub(3 * down),
            stride: (field.len() / samples).max(1),
            apart: down * lanes + right,
            count: last,
            bins: &mut self.bins,
        });
    }

    /// Samples in classes.
    fn samples(&self, classes: Range<usize>) -> f64 {
        // Whole numbers, whose sum is exact in any order.
        let mut sums = [0.0; COUNTED];
        for bins in self.bins[bins_of(classes)].as_chunks::<COUNTED>().0 {
            for (sum, bin) in sums.iter_mut().zip(bins) {
                *sum += bin[0];
            }
        }
        f64::from(sums.iter().sum::<f32>())
    }

    /// The variance in each class of range of differences over a wider pitch; with `less_edges` what edges make
    /// of it is taken away, which can be told of noise of one size only: any other scatters more the more of it
    /// is kept, too.
    fn measure_far(
        &mut self,
        field: &Field,
        span: (f32, f32),
        [down, right]: [usize; 2],
        less_edges: bool,
    ) -> Classes {
        let (told, checked) = self.measure(field, span, Probe::far(down, right));
        if !less_edges {
            return told;
        }
        let excess = excess_by_edges(growth(&told, &checked));
        told.map(|class| class.map(|class| Class { variance: class.variance / excess, ..class }))
    }

    /// The variance in each class of range, from the part that the probe keeps and from another part: of near
    /// differences the one that is kept of far ones, of far ones the one that tells edges; `span` is the
    /// nearest range and classes per metre.
    fn measure(&mut self, field: &Field, span: (f32, f32), probe: Probe) -> (Classes, Classes) {
        self.gather(field, [probe.down, probe.right], probe.samples, ByRange { span });
        let (nearest, per_metre) = span;
        let mut told = ([None; RANGE_CLASSES], [None; RANGE_CLASSES]);
        for class in 0..RANGE_CLASSES {
            let samples = self.samples(class..class + 1);
            if samples < FEWEST {
                continue;
            }
            let range_m = f64::from(nearest) + (class as f64 + 0.5) / f64::from(per_metre);
            let bins = &self.bins[bins_of(class..class + 1)];
            let part = |share: f64, kept_variance: f64| {
                let kept = trimmed_mean(bins, samples, share);
                let variance = (kept / (kept_variance * GAIN)).max(LEAST_M * LEAST_M);
                Some(Class { range_m, variance, samples })
            };
            told.0[class] = part(probe.kept, probe.kept_variance);
            told.1[class] = if probe.kept == FAR_KEPT {
                part(CHECKED, CHECKED_VARIANCE)
            } else {
                part(FAR_KEPT, FAR_KEPT_VARIANCE)
            };
        }
        told
    }
}

/// The bins of classes.
fn bins_of(classes: Range<usize>) -> Range<usize> {
    classes.start * SIZE_CLASSES..classes.end * SIZE_CLASSES
}

/// How many times as large a variance is for the edges among the differences, of which the part that is checked
/// has so many times the variance of the part that is kept.
fn excess_by_edges(checked: f64) -> f64 {
    let after = BY_EDGES.iter().position(|&(share, _)| checked < share).unwrap_or(BY_EDGES.len());
    match (after.checked_sub(1).map(|k| BY_EDGES[k]), BY_EDGES.get(after)) {
        (Some((low, from)), Some((high, to))) => {
            from + (to - from) * (checked - low) / (high - low)
        }
        (Some((_, most)), None) => most,
        (None, _) => 1.0,
    }
}

/// What readings of one steepness tell: the slope of the range over the angle, and the variance, both
/// in units of the noise.
#[derive(Clone, Copy, Debug, Default)]
struct SlopeClass {
    steepness: f64,
    variance: f64,
    samples: f64,
}

/// The angle that explains how variances rise with the slope; `None` where they do not rise all over.
///
/// Edges have large variances too, but at some slopes: over the logarithms, the variances must rise
/// as a whole, and the angle is the classes' weighted median.
fn angle_of(told: &[SlopeClass]) -> Option<f64> {
    if told.len() < 3 {
        return None;
    }
    let (mut n, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let mut own = f64::INFINITY;
    for class in told {
        let (lx, ly) = (2.0 * class.steepness.ln(), class.variance.max(1e-12).ln());
        n += class.samples;
        x += class.samples * lx;
        y += class.samples * ly;
        xx += class.samples * lx * lx;
        xy += class.samples * lx * ly;
        own = own.min(class.variance);
    }
    let rise = (xy - x * y / n) / (xx - x * x / n);
    if rise.is_nan() || rise < LEAST_RISE {
        return None;
    }
    let mut angles = [(0.0, 0.0); RANGE_CLASSES];
    for (angle, class) in angles.iter_mut().zip(told) {
        *angle = ((class.variance - own).sqrt() / class.steepness, class.samples);
    }
    let angles = &mut angles[..told.len()];
    angles.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut below = 0.0;
    let middle = angles.iter().find(|angle| {
        below += angle.1;
        below >= 0.5 * n
    });
    middle.map(|angle| angle.0).filter(|&angle| angle > 0.0)
}

/// How many times larger the variance of the second is, as the mean of the classes' logarithms.
fn growth(from: &Classes, to: &Classes) -> f64 {
    let mut sum = (0.0, 0.0);
    for (from, to) in from.iter().zip(to) {
        if let (Some(from), Some(to)) = (from, to) {
            let samples = from.samples.min(to.samples);
            sum.0 += samples * (to.variance / from.variance).ln();
            sum.1 += samples;
        }
    }
    if sum.1 > 0.0 { (sum.0 / sum.1).exp() } else { 1.0 }
}

/// Mean square of the `share` smallest errors.
fn trimmed_mean(bins: &[[f32; 2]], samples: f64, share: f64) -> f64 {
    let mut left = share * samples;
    let mut sum = 0.0;
    for &[count, square] in bins {
        let (count, square) = (f64::from(count), f64::from(square));
        if left <= count {
            // The last part of them; nothing at all is no part.
            sum += square * (left / count.max(f64::MIN_POSITIVE));
            break;
        }
        sum += square;
        left -= count;
    }
    sum / (share * samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_edges_make_of_a_variance_follows_from_how_it_rises() {
        let rising = [0.9, 1.0, 1.03625, 1.1477, 1.5119, 2.0].map(excess_by_edges);
        let expected = [1.0, 1.0, 1.18, 1.6008, 2.1364, 2.1365];
        for (told, expected) in rising.into_iter().zip(expected) {
            assert!((told - expected).abs() < 1e-3, "{told} for {expected}");
        }
    }

    fn classes(variance: impl Fn(usize, f64) -> f64) -> Vec<SlopeClass> {
        (1..8_i32)
            .map(|k| {
                let steepness = 22.0 * 2.0_f64.powi(k);
                let variance = variance(k as usize, steepness);
                SlopeClass { steepness, variance, samples: 100.0 }
            })
            .collect()
    }

    #[test]
    fn variances_that_rise_with_the_slope_tell_the_angle_whatever_an_edge_says() {
        let told = classes(|k, h| if k == 2 { 90.0 } else { 0.5 + 1e-4 * h * h });
        let angle = angle_of(&told).unwrap();
        assert!((angle / 1e-2 - 1.0).abs() < 0.1, "{angle}");
    }

    #[test]
    fn level_variances_are_no_error_of_the_angle() {
        let told = classes(|k, _| [1.0, 1.1, 0.9, 1.0, 1.2, 1.1, 1.7, 3.0][k]);
        assert_eq!(angle_of(&told), None);
        assert_eq!(angle_of(&told[..2]), None);
    }
}
