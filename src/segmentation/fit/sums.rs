//! Sums over the readings of one region, from which its plane, frame and errors follow.
//!
//! All are taken in one pass, a vector of readings at a time, about a plane that is nearly right already:
//! what the region's additive moments gave. Then the errors are small numbers and single precision
//! holds them; a Newton step from there is exact, as the problem is linear.

use super::packed::Packed;
use super::{CAP, GATE, LEAST_COSINE};
use pulp::{Arch, Scalar128b, Simd, WithSimd};
use std::ops::Range;

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

    /// The places of the sums in the order in which they are taken: of the readings' own, of products
    /// with weights, and of those without.
    pub const OWN: [usize; 6] = [WS, WSS, ERROR, INLIERS, GAIN, SQUARE];
    pub const WEIGHTED: [usize; 13] = [0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14];
    pub const PLAIN: [usize; 14] = [15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28];
}

/// The sums.
#[derive(Clone, Debug)]
pub(in super::super) struct PlaneSums {
    pub reference: Reference,
    pub totals: [f64; place::COUNT],
    pub readings: usize,
}

impl PlaneSums {
    /// The sums over runs of successive cells with a return.
    pub fn over(
        reference: Reference,
        columns: Columns,
        runs: impl Iterator<Item = Range<usize>>,
        packed: &mut Packed,
    ) -> Self {
        run(Summation::<_, true> { reference, columns, runs, packed })
    }

    /// The same without the sums that have no weights, which only a frame is told from.
    pub fn weighted_over(
        reference: Reference,
        columns: Columns,
        runs: impl Iterator<Item = Range<usize>>,
        packed: &mut Packed,
    ) -> Self {
        run(Summation::<_, false> { reference, columns, runs, packed })
    }

    /// The sums over few readings, in arrays of their own.
    pub fn over_few(reference: Reference, columns: Columns, packed: &mut Packed) -> Self {
        Self::over(reference, columns, std::iter::once(0..columns.x.len()), packed)
    }
}

fn run<W: WithSimd>(work: W) -> W::Output {
    match Arch::new() {
        Arch::Scalar => Scalar128b.vectorize(work),
        arch => arch.dispatch(work),
    }
}

/// Summing over runs, for vectors of some width; `PLAIN` sums have no weights.
struct Summation<'a, I, const PLAIN: bool> {
    reference: Reference,
    columns: Columns<'a>,
    runs: I,
    packed: &'a mut Packed,
}

impl<I: Iterator<Item = Range<usize>>, const PLAIN: bool> WithSimd for Summation<'_, I, PLAIN> {
    type Output = PlaneSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> PlaneSums {
        let Self { reference, columns, runs, packed } = self;
        let about = About::of(simd, &reference);
        let Columns { x, y, z, inverse, gain, fit_gain } = columns;
        let columns = [x, y, z, inverse, gain, fit_gain];
        let mut sums = PlaneSums { reference, totals: [0.0; place::COUNT], readings: 0 };
        packed.count = 0;
        for run in runs {
            sums.readings += run.len();
            let mut at = run.start;
            while at < run.end {
                at = packed.take(&columns, at, run.end);
                if packed.count == Packed::FULL {
                    add_up::<_, PLAIN>(simd, &about, packed, &mut sums.totals);
                }
            }
        }
        add_up::<_, PLAIN>(simd, &about, packed, &mut sums.totals);
        sums
    }
}

/// What sums are taken about, in every place of a vector.
struct About<V> {
    q: [V; 3],
    anchor: [V; 3],
    /// Distance of the plane over the least cosine of incidence.
    least: V,
}

impl<V> About<V> {
    #[inline(always)]
    fn of<S: Simd<f32s = V>>(simd: S, reference: &Reference) -> Self {
        let [x, y, z] = reference.q;
        let offset_m = 1.0 / (x * x + y * y + z * z).sqrt();
        let [ax, ay, az] = reference.anchor;
        Self {
            q: [simd.splat_f32s(x), simd.splat_f32s(y), simd.splat_f32s(z)],
            anchor: [simd.splat_f32s(ax), simd.splat_f32s(ay), simd.splat_f32s(az)],
            least: simd.splat_f32s(offset_m / LEAST_COSINE as f32),
        }
    }
}

/// Adds what is packed to the totals.
///
/// There are more sums than a processor has vectors at hand, so the readings are gone through three
/// times: once for what follows from each alone, which takes the place of what it follows from, and once
/// each for the products with and without weights.
#[inline(always)]
fn add_up<S: Simd, const PLAIN: bool>(
    simd: S,
    about: &About<S::f32s>,
    packed: &mut Packed,
    totals: &mut [f64; place::COUNT],
) {
    let count = packed.fill_up(S::F32_LANES);
    let [x, y, z, inverse, gain, fit_gain] = packed.columns.each_mut();
    let (x, y) = (S::as_mut_simd_f32s(&mut x[..count]).0, S::as_mut_simd_f32s(&mut y[..count]).0);
    let z = S::as_mut_simd_f32s(&mut z[..count]).0;
    let inverse = S::as_simd_f32s(&inverse[..count]).0;
    let gain = S::as_mut_simd_f32s(&mut gain[..count]).0;
    let fit_gain = S::as_mut_simd_f32s(&mut fit_gain[..count]).0;
    let mut own = [simd.splat_f32s(0.0); 6];
    let columns = x.iter_mut().zip(&mut *y).zip(&mut *z).zip(inverse).zip(&mut *gain);
    for (((((x, y), z), inverse), gain), fit_gain) in columns.zip(&mut *fit_gain) {
        let seen = look(simd, about, [*x, *y, *z, *inverse, *gain, *fit_gain], &mut own);
        ([*x, *y, *z], *gain, *fit_gain) = (seen.d, seen.s, seen.w);
    }
    let mut weighted = [simd.splat_f32s(0.0); 13];
    for ((((&x, &y), &z), &s), &w) in x.iter().zip(&*y).zip(&*z).zip(&*gain).zip(&*fit_gain) {
        plus(simd, &mut weighted[0], w);
        with_places(
            simd,
            &mut weighted[1..],
            [x, y, z],
            [mul(simd, w, x), mul(simd, w, y), mul(simd, w, z)],
            s,
        );
    }
    let mut put = |places: &[usize], sums: &[S::f32s]| {
        for (&place, &sum) in places.iter().zip(sums) {
            totals[place] += f64::from(simd.reduce_sum_f32s(sum));
        }
    };
    put(&place::OWN, &own);
    put(&place::WEIGHTED, &weighted);
    if !PLAIN {
        return;
    }
    let mut plain = [simd.splat_f32s(0.0); 14];
    for (((&x, &y), &z), &s) in x.iter().zip(&*y).zip(&*z).zip(&*gain) {
        plus(simd, &mut plain[0], s);
        plus_product(simd, &mut plain[1], s, s);
        with_places(simd, &mut plain[2..], [x, y, z], [x, y, z], s);
    }
    put(&place::PLAIN, &plain);
}

/// Adds up weighted places on the plane, their products with the places, and with the errors.
#[inline(always)]
fn with_places<S: Simd>(
    simd: S,
    sums: &mut [S::f32s],
    d: [S::f32s; 3],
    weighted: [S::f32s; 3],
    s: S::f32s,
) {
    let mut pair = 6;
    for i in 0..3 {
        plus(simd, &mut sums[i], weighted[i]);
        plus_product(simd, &mut sums[3 + i], weighted[i], s);
        for &other in &d[i..] {
            plus_product(simd, &mut sums[pair], weighted[i], other);
            pair += 1;
        }
    }
}

/// What follows from readings: their errors relative to the range, the places on the plane that their
/// rays meet, from the anchor, and their weights.
struct Seen<V> {
    s: V,
    d: [V; 3],
    w: V,
}

/// Looks at readings, and adds up what is no product with a place; where there is none are zeros.
#[inline(always)]
fn look<S: Simd>(
    simd: S,
    about: &About<S::f32s>,
    [x, y, z, inverse, gain, fit_gain]: [S::f32s; 6],
    sums: &mut [S::f32s; 6],
) -> Seen<S::f32s> {
    let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
    let present = simd.greater_than_f32s(inverse, zero);
    let [qx, qy, qz] = about.q;
    let product = simd.mul_add_e_f32s(qx, x, simd.mul_add_e_f32s(qy, y, mul(simd, qz, z)));
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
    let [sum_ws, sum_wss, sum_error, sum_inliers, sum_gain, sum_square] = sums;
    plus(simd, sum_ws, ws);
    plus_product(simd, sum_wss, ws, s);
    plus(simd, sum_error, simd.min_f32s(square, simd.splat_f32s((CAP * CAP) as f32)));
    plus(simd, sum_inliers, counted);
    plus_product(simd, sum_gain, gain, gain);
    plus(simd, sum_square, square);
    Seen { s, d, w }
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
