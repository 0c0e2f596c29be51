//! Sums over the readings of one region, from which its plane, frame and errors follow.
//!
//! All are taken in one pass, a vector of readings at a time, about a plane that is nearly right already:
//! what the region's additive moments gave. Then the errors are small numbers and single precision
//! holds them; a Newton step from there is exact, as the problem is linear.

use super::super::field::Field;
use super::super::vectors::run;
use super::packed::{COLUMNS, Packed};
use super::{CAP, GATE, LEAST_COSINE};
use nalgebra::Vector3;
use pulp::{Simd, WithSimd};
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

impl<'a> Columns<'a> {
    /// Those of a field, of which some readings may be left out of fits.
    pub fn of(field: &'a Field, fit_gain: &'a [f32]) -> Self {
        let Field { x, y, z, inverse, gain, .. } = field;
        Self { x, y, z, inverse, gain, fit_gain }
    }

    /// What they have of a cell.
    #[inline]
    pub fn reading(&self, cell: usize) -> [f32; COLUMNS] {
        let Self { x, y, z, inverse, gain, fit_gain } = self;
        [x, y, z, inverse, gain, fit_gain].map(|column| column[cell])
    }

    /// All of them, of one length that the compiler knows to be one.
    #[inline(always)]
    pub(super) fn all(&self) -> ([&'a [f32]; COLUMNS], usize) {
        let Self { x, y, z, inverse, gain, fit_gain } = *self;
        let length = x.len();
        ([x, y, z, inverse, gain, fit_gain].map(|column| &column[..length]), length)
    }
}

/// A plane `q · p = 1` that errors are measured by, with a frame on it.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Reference {
    /// The normal towards the sensor, and two more directions that complete it to a frame.
    pub normal: Vector3<f64>,
    pub sides: [Vector3<f64>; 2],
    /// The normal's coordinate of the plane: not a number where there is no plane.
    pub offset_m: f64,
    /// The point of the plane that places on it are told from.
    pub foot: Vector3<f64>,
    q: [f32; 3],
}

impl Reference {
    /// The plane with the point on it that is next to one of the region's.
    pub fn new(q: [f64; 3], near: [f64; 3]) -> Self {
        let (near, q) = (Vector3::from(near), Vector3::from(q));
        let length = q.norm();
        let is_plane = length > 0.0 && length.is_finite();
        let normal = if is_plane { -q / length } else { Vector3::x() };
        let offset_m = if is_plane { -1.0 / length } else { f64::NAN };
        let gap = if is_plane { normal.dot(&near) - offset_m } else { 0.0 };
        let mut helper = Vector3::zeros();
        helper[normal.iamin()] = 1.0;
        let first = normal.cross(&helper).normalize();
        let sides = [first, normal.cross(&first)];
        let q = [q.x, q.y, q.z].map(|v| v as f32);
        Self { normal, sides, offset_m, foot: near - normal * gap, q }
    }
}

/// Each place in [`PlaneSums::totals`] that a sum over readings has. `s` is the error relative to the
/// range, `u` and `v` the place on the plane that the reading's ray meets, `w` its weight.
pub(in super::super) mod place {
    pub const W: usize = 0;
    pub const WS: usize = 1;
    pub const WSS: usize = 2;
    /// Two each: u, v.
    pub const WD: usize = 3;
    pub const WSD: usize = 5;
    /// Three: uu, uv, vv.
    pub const WDD: usize = 7;
    pub const S: usize = 10;
    pub const SS: usize = 11;
    pub const D: usize = 12;
    pub const SD: usize = 14;
    pub const DD: usize = 16;
    /// Squared errors in units of the noise, each cut.
    pub const ERROR: usize = 19;
    /// Readings that have a weight.
    pub const INLIERS: usize = 20;
    /// Squared gains.
    pub const GAIN: usize = 21;
    /// Squared errors in units of the noise, as they are.
    pub const SQUARE: usize = 22;
    pub const COUNT: usize = 23;

    /// The places of the sums in the order in which they are taken: of the readings' own, of products
    /// with weights, and of those without.
    pub const OWN: [usize; 6] = [WS, WSS, ERROR, INLIERS, GAIN, SQUARE];
    pub const WEIGHTED: [usize; 8] = [0, 3, 4, 5, 6, 7, 8, 9];
    pub const PLAIN: [usize; 9] = [10, 11, 12, 13, 14, 15, 16, 17, 18];
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
        let mut sums = [Self::none(reference)];
        Self::add_blocks(&mut sums, columns, std::iter::once(runs), packed);
        let [sums] = sums;
        sums
    }

    /// Adds what the runs of each block sum up to, all about the plane of the first sums.
    pub fn add_blocks(
        sums: &mut [Self],
        columns: Columns,
        blocks: impl Iterator<Item = impl Iterator<Item = Range<usize>>>,
        packed: &mut Packed,
    ) {
        if let Some(&Self { reference, .. }) = sums.first() {
            run(Summation { reference, columns, blocks, packed, sums });
        }
    }

    /// The sums over no readings.
    pub fn none(reference: Reference) -> Self {
        Self { reference, totals: [0.0; place::COUNT], readings: 0 }
    }

    /// Adds the sums over other readings, about the same plane.
    pub fn add(&mut self, other: &Self) {
        for (total, other) in self.totals.iter_mut().zip(other.totals) {
            *total += other;
        }
        self.readings += other.readings;
    }

    /// The sums over few readings, in arrays of their own.
    pub fn over_few(reference: Reference, columns: Columns, packed: &mut Packed) -> Self {
        Self::over(reference, columns, std::iter::once(0..columns.x.len()), packed)
    }
}

/// Summing over the runs of blocks, for vectors of some width.
struct Summation<'a, I> {
    reference: Reference,
    columns: Columns<'a>,
    blocks: I,
    packed: &'a mut Packed,
    sums: &'a mut [PlaneSums],
}

impl<I: Iterator<Item: Iterator<Item = Range<usize>>>> WithSimd for Summation<'_, I> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { reference, columns, blocks, packed, sums } = self;
        let about = About::of(simd, &reference);
        let (columns, length) = columns.all();
        packed.count = 0;
        for (runs, sums) in blocks.zip(sums) {
            for run in runs {
                let mut at = run.start;
                while at < run.end {
                    let vectors = if at + S::F32_LANES <= length {
                        columns.map(|column| S::as_simd_f32s(&column[at..at + S::F32_LANES]).0[0])
                    } else {
                        columns.map(|column| simd.partial_load_f32s(&column[at..]))
                    };
                    packed.put(simd, vectors, (run.end - at).min(S::F32_LANES));
                    if packed.count >= Packed::FULL {
                        add_up(simd, &about, packed, sums);
                    }
                    at += S::F32_LANES;
                }
            }
            add_up(simd, &about, packed, sums);
        }
    }
}

/// What sums are taken about, in every place of a vector.
struct About<V> {
    q: [V; 3],
    /// Two directions, and the coordinates of the foot along them.
    sides: [[V; 3]; 2],
    foot: [V; 2],
    /// Distance of the plane over the least cosine of incidence.
    least: V,
}

impl<V> About<V> {
    #[inline(always)]
    fn of<S: Simd<f32s = V>>(simd: S, reference: &Reference) -> Self {
        let splat = |value: f64| simd.splat_f32s(value as f32);
        let [x, y, z] = reference.q;
        let [first, second] = reference.sides;
        Self {
            q: [simd.splat_f32s(x), simd.splat_f32s(y), simd.splat_f32s(z)],
            sides: [
                [splat(first.x), splat(first.y), splat(first.z)],
                [splat(second.x), splat(second.y), splat(second.z)],
            ],
            foot: [splat(first.dot(&reference.foot)), splat(second.dot(&reference.foot))],
            least: splat(-reference.offset_m / LEAST_COSINE),
        }
    }
}

/// Adds what is packed to the totals.
///
/// There are more sums than a processor has vectors at hand, so the readings are gone through three times:
/// for what is no product with a place, for the products with weights, and for those without.
#[inline(always)]
fn add_up<S: Simd>(simd: S, about: &About<S::f32s>, packed: &mut Packed, sums: &mut PlaneSums) {
    sums.readings += packed.count;
    let totals = &mut sums.totals;
    let count = packed.fill_up(simd);
    let mut own = [simd.splat_f32s(0.0); 6];
    let [x, y, z, inverse, gain, fit_gain] = &mut packed.columns;
    let [x, y, z, inverse] =
        [x, y, z, inverse].map(|column| S::as_mut_simd_f32s(&mut column[..count]).0);
    let [gain, fit_gain] = [gain, fit_gain].map(|column| S::as_simd_f32s(&column[..count]).0);
    let readings = x.iter_mut().zip(y).zip(z).zip(inverse).zip(gain).zip(fit_gain);
    for (((((x, y), z), inverse), &gain), &fit_gain) in readings {
        // What is seen of readings takes their place.
        let seen = look(simd, about, [*x, *y, *z, *inverse, gain, fit_gain], &mut own);
        [*x, *y, *z, *inverse] = seen;
    }
    let [u, v, s, w, ..] = &packed.columns;
    let (u, v) = (S::as_simd_f32s(&u[..count]).0, S::as_simd_f32s(&v[..count]).0);
    let (s, w) = (S::as_simd_f32s(&s[..count]).0, S::as_simd_f32s(&w[..count]).0);
    let zero = simd.splat_f32s(0.0);
    let mut weighted = [zero; 8];
    for (((&u, &v), &s), &w) in u.iter().zip(v).zip(s).zip(w) {
        plus(simd, &mut weighted[0], w);
        let moved = [mul(simd, w, u), mul(simd, w, v)];
        with_places(simd, &mut weighted[1..], [u, v], moved, s);
    }
    let mut put = |places: &[usize], sums: &[S::f32s]| {
        for (&place, &sum) in places.iter().zip(sums) {
            totals[place] += f64::from(simd.reduce_sum_f32s(sum));
        }
    };
    put(&place::OWN, &own);
    put(&place::WEIGHTED, &weighted);
    let mut plain = [zero; 9];
    for ((&u, &v), &s) in u.iter().zip(v).zip(s) {
        plus(simd, &mut plain[0], s);
        plus_product(simd, &mut plain[1], s, s);
        with_places(simd, &mut plain[2..], [u, v], [u, v], s);
    }
    put(&place::PLAIN, &plain);
}

/// Adds up weighted places on the plane, their products with the errors, and with the places.
#[inline(always)]
fn with_places<S: Simd>(
    simd: S,
    sums: &mut [S::f32s],
    [u, v]: [S::f32s; 2],
    [wu, wv]: [S::f32s; 2],
    s: S::f32s,
) {
    plus(simd, &mut sums[0], wu);
    plus(simd, &mut sums[1], wv);
    plus_product(simd, &mut sums[2], wu, s);
    plus_product(simd, &mut sums[3], wv, s);
    plus_product(simd, &mut sums[4], wu, u);
    plus_product(simd, &mut sums[5], wu, v);
    plus_product(simd, &mut sums[6], wv, v);
}

/// Looks at readings, and adds up what is no product with a place. Returns the places on the plane that
/// their rays meet, from the foot, their errors relative to the range, and their weights; where there is
/// none are zeros.
#[inline(always)]
fn look<S: Simd>(
    simd: S,
    about: &About<S::f32s>,
    [x, y, z, inverse, gain, fit_gain]: [S::f32s; 6],
    sums: &mut [S::f32s; 6],
) -> [S::f32s; 4] {
    let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
    let present = simd.greater_than_f32s(inverse, zero);
    let [qx, qy, qz] = about.q;
    let product = simd.mul_add_e_f32s(qx, x, simd.mul_add_e_f32s(qy, y, mul(simd, qz, z)));
    let s = simd.select_f32s(present, simd.sub_f32s(product, one), zero);
    // Where the ray meets the plane: what follows from it does not depend on the reading's error.
    let near = simd.max_f32s(s, simd.splat_f32s(-FARTHEST));
    let near = simd.min_f32s(near, simd.splat_f32s(FARTHEST));
    let shrink = simd.sub_f32s(one, mul(simd, near, simd.sub_f32s(one, near)));
    let place = |[ex, ey, ez]: [S::f32s; 3], foot: S::f32s| {
        let along = simd.mul_add_e_f32s(ex, x, simd.mul_add_e_f32s(ey, y, mul(simd, ez, z)));
        simd.select_f32s(present, simd.sub_f32s(mul(simd, along, shrink), foot), zero)
    };
    let u = place(about.sides[0], about.foot[0]);
    let v = place(about.sides[1], about.foot[1]);
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
    [u, v, s, w]
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
