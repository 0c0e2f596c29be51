//! Sums over the readings of one region, from which its plane, frame and errors follow.
//!
//! All are taken in one pass, a vector of readings at a time, about a plane that is nearly right already:
//! what the region's additive moments gave. Then the errors are small numbers and single precision
//! holds them; a Newton step from there is exact, as the problem is linear.

use super::{CAP, GATE, LEAST_COSINE};
use pulp::{Arch, Scalar128b, Simd, WithSimd};
use std::ops::Range;

/// Vectors of readings that are added up in single precision.
const LONGEST_SUM: usize = 64;
/// Relative error beyond which a reading's place on the plane is not followed.
const FARTHEST: f32 = 0.5;

/// The arrays of a field that fits read.
#[derive(Clone, Copy)]
pub(in super::super) struct Columns<'a> {
    pub x: &'a [f32],
    pub y: &'a [f32],
    pub z: &'a [f32],
    /// One over the range.
    pub inverse: &'a [f32],
    /// Range over its standard deviation.
    pub gain: &'a [f32],
    /// The same, zero for readings that a fit leaves out.
    pub fit_gain: &'a [f32],
}

/// A plane `q · p = 1` that errors are measured by, and a point that sums are taken about.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Reference {
    pub q: [f32; 3],
    pub anchor: [f32; 3],
}

/// Each place in [`PlaneSums::totals`] that a sum over readings has. `s` is the error relative to the
/// range, `d` the place on the plane that the reading's ray meets, from the anchor, `w` its weight.
pub(in super::super) mod place {
    pub const W: usize = 0;
    pub const WS: usize = 1;
    pub const WSS: usize = 2;
    /// Three each.
    pub const WD: usize = 3;
    pub const WSD: usize = 6;
    /// Six: xx, xy, xz, yy, yz, zz.
    pub const WDD: usize = 9;
    pub const S: usize = 15;
    pub const SS: usize = 16;
    pub const D: usize = 17;
    pub const SD: usize = 20;
    pub const DD: usize = 23;
    /// Squared errors in units of the noise, each cut.
    pub const ERROR: usize = 29;
    /// Readings that have a weight.
    pub const INLIERS: usize = 30;
    /// Squared gains.
    pub const GAIN: usize = 31;
    /// Squared errors in units of the noise, as they are.
    pub const SQUARE: usize = 32;
    pub const COUNT: usize = 33;
}

/// The sums.
#[derive(Clone, Debug)]
pub(in super::super) struct PlaneSums {
    pub reference: Reference,
    pub totals: [f64; place::COUNT],
    pub readings: usize,
}

impl PlaneSums {
    /// The sums over runs of successive cells.
    pub fn over(
        reference: Reference,
        columns: Columns,
        runs: impl Iterator<Item = Range<usize>>,
    ) -> Self {
        let summation = Summation { reference, columns, runs };
        match Arch::new() {
            Arch::Scalar => Scalar128b.vectorize(summation),
            arch => arch.dispatch(summation),
        }
    }

    /// The sums over few readings, in arrays of their own.
    pub fn over_few(reference: Reference, columns: Columns) -> Self {
        Self::over(reference, columns, std::iter::once(0..columns.x.len()))
    }
}

/// Summing over runs, for vectors of some width.
struct Summation<'a, I> {
    reference: Reference,
    columns: Columns<'a>,
    runs: I,
}

impl<I: Iterator<Item = Range<usize>>> WithSimd for Summation<'_, I> {
    type Output = PlaneSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> PlaneSums {
        let Self { reference, columns, runs } = self;
        let [x, y, z] = reference.q;
        let offset_m = 1.0 / (x * x + y * y + z * z).sqrt();
        let [ax, ay, az] = reference.anchor;
        let about = About {
            q: [simd.splat_f32s(x), simd.splat_f32s(y), simd.splat_f32s(z)],
            anchor: [simd.splat_f32s(ax), simd.splat_f32s(ay), simd.splat_f32s(az)],
            least: simd.splat_f32s(offset_m / LEAST_COSINE as f32),
        };
        let mut sums = PlaneSums { reference, totals: [0.0; place::COUNT], readings: 0 };
        let mut block = [simd.splat_f32s(0.0); place::COUNT];
        let mut blocks = 0;
        for run in runs {
            sums.readings += run.len();
            let Columns { x, y, z, inverse, gain, fit_gain } = columns;
            let (x, y, z) = (part(simd, x, &run), part(simd, y, &run), part(simd, z, &run));
            let (inverse, gain) = (part(simd, inverse, &run), part(simd, gain, &run));
            let fit_gain = part(simd, fit_gain, &run);
            let whole = x.0.iter().zip(y.0).zip(z.0).zip(inverse.0).zip(gain.0).zip(fit_gain.0);
            for (((((&x, &y), &z), &inverse), &gain), &fit_gain) in whole {
                add(simd, &about, [x, y, z, inverse, gain, fit_gain], &mut block);
            }
            blocks += x.0.len();
            if !run.len().is_multiple_of(S::F32_LANES) {
                let rest = [x.1, y.1, z.1, inverse.1, gain.1, fit_gain.1];
                add(simd, &about, rest, &mut block);
                blocks += 1;
            }
            if blocks > LONGEST_SUM {
                flush(simd, &mut block, &mut sums.totals);
                blocks = 0;
            }
        }
        flush(simd, &mut block, &mut sums.totals);
        sums
    }
}

/// A run of an array: whole vectors, and what is left in one that zeros fill up.
#[inline(always)]
fn part<'a, S: Simd>(simd: S, array: &'a [f32], run: &Range<usize>) -> (&'a [S::f32s], S::f32s) {
    let (whole, rest) = S::as_simd_f32s(&array[run.clone()]);
    (whole, simd.partial_load_f32s(rest))
}

/// What sums are taken about, in every place of a vector.
struct About<V> {
    q: [V; 3],
    anchor: [V; 3],
    /// Distance of the plane over the least cosine of incidence.
    least: V,
}

/// Adds readings to the sums; places without one have zeros.
#[inline(always)]
fn add<S: Simd>(
    simd: S,
    about: &About<S::f32s>,
    [x, y, z, inverse, gain, fit_gain]: [S::f32s; 6],
    sums: &mut [S::f32s; place::COUNT],
) {
    let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
    let present = simd.greater_than_f32s(inverse, zero);
    let [qx, qy, qz] = about.q;
    let product =
        simd.add_f32s(simd.add_f32s(mul(simd, qx, x), mul(simd, qy, y)), mul(simd, qz, z));
    let s = simd.select_f32s(present, simd.sub_f32s(product, one), zero);
    // Where the ray meets the plane: what follows from it does not depend on the reading's error.
    let near = simd.max_f32s(s, simd.splat_f32s(-FARTHEST));
    let near = simd.min_f32s(near, simd.splat_f32s(FARTHEST));
    let shrink = simd.sub_f32s(one, mul(simd, near, simd.sub_f32s(one, near)));
    let [ax, ay, az] = about.anchor;
    let d = [
        simd.select_f32s(present, simd.sub_f32s(mul(simd, x, shrink), ax), zero),
        simd.select_f32s(present, simd.sub_f32s(mul(simd, y, shrink), ay), zero),
        simd.select_f32s(present, simd.sub_f32s(mul(simd, z, shrink), az), zero),
    ];
    let grazing = simd.min_f32s(mul(simd, about.least, inverse), one);
    let error = mul(simd, mul(simd, s, gain), grazing);
    let square = mul(simd, error, error);
    let inside = simd.less_than_or_equal_f32s(square, simd.splat_f32s((GATE * GATE) as f32));
    let weight = mul(simd, mul(simd, fit_gain, shrink), grazing);
    let w = simd.select_f32s(inside, mul(simd, weight, weight), zero);
    let counted = simd.select_f32s(simd.greater_than_f32s(w, zero), one, zero);
    let ws = mul(simd, w, s);
    plus(simd, &mut sums[place::W], w);
    plus(simd, &mut sums[place::WS], ws);
    plus_product(simd, &mut sums[place::WSS], ws, s);
    plus(simd, &mut sums[place::S], s);
    plus_product(simd, &mut sums[place::SS], s, s);
    let capped = simd.min_f32s(square, simd.splat_f32s((CAP * CAP) as f32));
    plus(simd, &mut sums[place::ERROR], capped);
    plus(simd, &mut sums[place::INLIERS], counted);
    plus(simd, &mut sums[place::SQUARE], square);
    plus_product(simd, &mut sums[place::GAIN], gain, gain);
    let mut pair = 0;
    for i in 0..3 {
        plus_product(simd, &mut sums[place::WD + i], w, d[i]);
        plus_product(simd, &mut sums[place::WSD + i], ws, d[i]);
        plus(simd, &mut sums[place::D + i], d[i]);
        plus_product(simd, &mut sums[place::SD + i], s, d[i]);
        for j in i..3 {
            let product = mul(simd, d[i], d[j]);
            plus_product(simd, &mut sums[place::WDD + pair], w, product);
            plus(simd, &mut sums[place::DD + pair], product);
            pair += 1;
        }
    }
}

#[inline(always)]
fn mul<S: Simd>(simd: S, a: S::f32s, b: S::f32s) -> S::f32s {
    simd.mul_f32s(a, b)
}

#[inline(always)]
fn plus_product<S: Simd>(simd: S, sum: &mut S::f32s, a: S::f32s, b: S::f32s) {
    *sum = simd.mul_add_e_f32s(a, b, *sum);
}

#[inline(always)]
fn plus<S: Simd>(simd: S, sum: &mut S::f32s, value: S::f32s) {
    *sum = simd.add_f32s(*sum, value);
}

/// Moves what was added in single precision to the totals.
#[inline(always)]
fn flush<S: Simd>(simd: S, block: &mut [S::f32s; place::COUNT], totals: &mut [f64; place::COUNT]) {
    for (total, block) in totals.iter_mut().zip(block) {
        *total += f64::from(simd.reduce_sum_f32s(*block));
        *block = simd.splat_f32s(0.0);
    }
}
