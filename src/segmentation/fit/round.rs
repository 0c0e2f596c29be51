//! What one round of an iteration on a sphere or a cylinder needs of the readings, a vector of them at
//! a time.
//!
//! A sphere is taken as a cylinder whose axis is zero: all that differs is what its parameters move.

use super::super::vectors::run;
use super::readings::{BLOCK, Readings};
use super::{CAP, LEAST_COSINE, NormalSums, Phase, RIM_COSINE};
use pulp::{Simd, WithSimd};

/// A sphere about `foot`, or a cylinder about the line through `foot` along the unit vector `axis`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    pub foot: [f64; 3],
    /// Zero for a sphere.
    pub axis: [f64; 3],
    pub radius_m: f64,
    /// Directions in which the parameters move the surface: the coordinate axes for a sphere, two
    /// perpendicular to its axis for a cylinder.
    pub sides: [[f64; 3]; 3],
    /// Whether it is seen from within, as a vault or a round room is, so that rays meet it where they leave.
    pub hollow: bool,
}

/// What the readings of a round add up to.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoundSums<const N: usize> {
    pub normal: NormalSums<N>,
    /// Squared errors of the readings that count, and their number.
    pub square: f64,
    pub count: f64,
}

/// Sums over every so-many-th block of readings.
///
/// With N = 4 the parameters are a sphere's centre and radius. With N = 5 they are a cylinder's: moving
/// the axis by a and tilting it by b (per metre of height) moves it at a reading by a + height b; the
/// distance falls by that along the normal, and by the radius.
pub(super) fn sum_round<const N: usize>(
    readings: &Readings,
    round: Round,
    phase: Phase,
    stride: usize,
) -> RoundSums<N> {
    run(Sum::<N> { readings, round, phase, stride })
}

/// Sum of the squared errors across a surface, each cut at [`CAP`].
pub(super) fn capped_error_of(readings: &Readings, round: Round) -> f64 {
    run(Capped { readings, round })
}

/// Mean square of the distances from a surface, in m².
pub(super) fn mean_square_distance_of(readings: &Readings, round: Round) -> f64 {
    run(Distances { readings, round }) / readings.len().max(1) as f64
}

struct Sum<'a, const N: usize> {
    readings: &'a Readings,
    round: Round,
    phase: Phase,
    stride: usize,
}

struct Capped<'a> {
    readings: &'a Readings,
    round: Round,
}

struct Distances<'a> {
    readings: &'a Readings,
    round: Round,
}

/// A vector of readings; places without one have zeros.
#[derive(Clone, Copy)]
pub(super) struct Vectors<V> {
    pub point: [V; 3],
    pub ray: [V; 3],
    pub per_sigma: V,
}

/// From columns.
#[inline(always)]
pub(super) fn vectors<V>([x, y, z, u, v, w, per_sigma]: [V; 7]) -> Vectors<V> {
    Vectors { point: [x, y, z], ray: [u, v, w], per_sigma }
}

/// Places of the vectors of every so-many-th block, of so many vectors.
#[inline(always)]
pub(super) fn some_of<S: Simd>(end: usize, stride: usize) -> impl Iterator<Item = usize> {
    let per_block = BLOCK / S::F32_LANES;
    // Blocks are whole, which the compiler does not know.
    (0..end).step_by(stride * per_block).flat_map(move |i| i..(i + per_block).min(end))
}

/// A vector in space in every place.
#[inline(always)]
pub(super) fn splat<S: Simd>(simd: S, [x, y, z]: [f64; 3]) -> [S::f32s; 3] {
    [simd.splat_f32s(x as f32), simd.splat_f32s(y as f32), simd.splat_f32s(z as f32)]
}

/// Scalar products.
#[inline(always)]
pub(super) fn dot<S: Simd>(simd: S, a: [S::f32s; 3], b: [S::f32s; 3]) -> S::f32s {
    let xy = simd.mul_add_e_f32s(a[0], b[0], simd.mul_f32s(a[1], b[1]));
    simd.mul_add_e_f32s(a[2], b[2], xy)
}

/// `a - b · factor`.
#[inline(always)]
pub(super) fn less<S: Simd>(
    simd: S,
    a: [S::f32s; 3],
    b: [S::f32s; 3],
    factor: S::f32s,
) -> [S::f32s; 3] {
    [
        simd.sub_f32s(a[0], simd.mul_f32s(b[0], factor)),
        simd.sub_f32s(a[1], simd.mul_f32s(b[1], factor)),
        simd.sub_f32s(a[2], simd.mul_f32s(b[2], factor)),
    ]
}

#[inline(always)]
fn scaled<S: Simd>(simd: S, a: [S::f32s; 3], factor: S::f32s) -> [S::f32s; 3] {
    [simd.mul_f32s(a[0], factor), simd.mul_f32s(a[1], factor), simd.mul_f32s(a[2], factor)]
}

/// A surface in every place of a vector.
struct Splat<V> {
    foot: [V; 3],
    axis: [V; 3],
    radius: V,
    per_radius: V,
    one: V,
    /// One where rays leave through the surface, less than none by as much where they enter it.
    leaving: V,
}

#[inline(always)]
fn spread<S: Simd>(simd: S, round: &Round) -> Splat<S::f32s> {
    Splat {
        foot: splat(simd, round.foot),
        axis: splat(simd, round.axis),
        radius: simd.splat_f32s(round.radius_m as f32),
        per_radius: simd.splat_f32s((1.0 / round.radius_m) as f32),
        one: simd.splat_f32s(1.0),
        leaving: simd.splat_f32s(if round.hollow { 1.0 } else { -1.0 }),
    }
}

/// How readings lie to a surface.
struct Seen<V> {
    /// Normals, heights along the axis above the foot, and cosines of incidence.
    normal: [V; 3],
    height: V,
    cosine: V,
    /// Error across the surface or along the ray, in metres along the ray.
    error_m: V,
}

/// By their distance. With `bends` the surface's bend is allowed for: an error along the ray also
/// leads away from the surface that bends back from it.
#[inline(always)]
fn across<S: Simd>(
    simd: S,
    surface: &Splat<S::f32s>,
    readings: &Vectors<S::f32s>,
    bends: bool,
) -> Seen<S::f32s> {
    let d = less(simd, readings.point, surface.foot, surface.one);
    let height = dot(simd, surface.axis, d);
    let radial = less(simd, d, surface.axis, height);
    let length = simd.sqrt_f32s(dot(simd, radial, radial));
    let length = simd.max_f32s(length, simd.splat_f32s(1e-9));
    let per_length = simd.div_f32s(surface.one, length);
    let normal = scaled(simd, radial, per_length);
    let cosine = simd.abs_f32s(dot(simd, normal, readings.ray));
    let cosine = simd.max_f32s(cosine, simd.splat_f32s(LEAST_COSINE as f32));
    let mut distance = simd.sub_f32s(length, surface.radius);
    if bends {
        let lengthwise = dot(simd, surface.axis, readings.ray);
        let along =
            simd.add_f32s(simd.mul_f32s(lengthwise, lengthwise), simd.mul_f32s(cosine, cosine));
        let sideways = simd.max_f32s(simd.sub_f32s(surface.one, along), simd.splat_f32s(0.0));
        // Places without a reading have an infinite deviation here, and do not count.
        let sigma = simd.div_f32s(surface.one, readings.per_sigma);
        let variance = simd.mul_f32s(simd.mul_f32s(sigma, sigma), simd.splat_f32s(0.5));
        let bend = simd.mul_f32s(simd.mul_f32s(variance, sideways), per_length);
        distance = simd.sub_f32s(distance, bend);
    }
    Seen { normal, height, cosine, error_m: simd.div_f32s(distance, cosine) }
}

/// By where their rays enter it, or leave it where it is seen from within, and whether they do.
#[inline(always)]
fn along<S: Simd>(
    simd: S,
    surface: &Splat<S::f32s>,
    readings: &Vectors<S::f32s>,
) -> (Seen<S::f32s>, S::m32s) {
    let lengthwise = dot(simd, surface.axis, readings.ray);
    let sideways = less(simd, readings.ray, surface.axis, lengthwise);
    let foot_height = dot(simd, surface.axis, surface.foot);
    let centre = less(simd, surface.foot, surface.axis, foot_height);
    let speed = dot(simd, sideways, sideways);
    let middle = dot(simd, sideways, centre);
    let beside = less(simd, scaled(simd, centre, speed), sideways, middle);
    // Of the circle, in units of the speed: R² less the square of how far the ray passes its centre.
    let per_speed = simd.div_f32s(surface.one, speed);
    let passes = scaled(simd, beside, per_speed);
    let square =
        simd.sub_f32s(simd.mul_f32s(surface.radius, surface.radius), dot(simd, passes, passes));
    let meets = simd.greater_than_f32s(square, simd.splat_f32s(0.0));
    let reach = simd.mul_f32s(simd.sqrt_f32s(simd.mul_f32s(square, speed)), surface.leaving);
    let range = simd.mul_f32s(simd.add_f32s(middle, reach), per_speed);
    let from_centre = less(simd, scaled(simd, sideways, range), centre, surface.one);
    let normal = scaled(simd, from_centre, surface.per_radius);
    let cosine = simd.mul_f32s(dot(simd, normal, readings.ray), surface.leaving);
    let height = simd.sub_f32s(simd.mul_f32s(lengthwise, range), foot_height);
    // Of the distance from the axis, as it is across the surface: a reading that is too long is nearer to it
    // where the ray enters, and farther where it leaves.
    let error_m = simd.sub_f32s(dot(simd, readings.point, readings.ray), range);
    let error_m = simd.mul_f32s(error_m, surface.leaving);
    (Seen { normal, height, cosine, error_m }, meets)
}

impl<const N: usize> WithSimd for Sum<'_, N> {
    type Output = RoundSums<N>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> RoundSums<N> {
        let Self { readings, round, phase, stride } = self;
        let surface = spread(simd, &round);
        let [e1, e2, e3] = round.sides;
        let sides = [splat(simd, e1), splat(simd, e2), splat(simd, e3)];
        let zero = simd.splat_f32s(0.0);
        let (gate, rim) =
            (simd.splat_f32s(phase.gate() as f32), simd.splat_f32s(RIM_COSINE as f32));
        let mut products = [[zero; N]; N];
        let mut right = [zero; N];
        let (mut square, mut count) = (zero, zero);
        let columns = readings.vectors::<S>();
        for i in some_of::<S>(columns[0].len(), stride) {
            let readings = vectors(columns.map(|column| column[i]));
            let mut counts = simd.greater_than_f32s(readings.per_sigma, zero);
            let seen = if phase == Phase::Rays {
                let (seen, meets) = along(simd, &surface, &readings);
                counts = simd.and_m32s(counts, meets);
                seen
            } else {
                across(simd, &surface, &readings, true)
            };
            let error = simd.mul_f32s(seen.error_m, readings.per_sigma);
            let inside = simd.less_than_or_equal_f32s(simd.abs_f32s(error), gate);
            counts = simd.and_m32s(counts, inside);
            if phase != Phase::Start {
                let steep = simd.greater_than_or_equal_f32s(seen.cosine, rim);
                counts = simd.and_m32s(counts, steep);
            }
            let error = simd.select_f32s(counts, error, zero);
            let scale = simd.div_f32s(readings.per_sigma, seen.cosine);
            let mut derivatives = [zero; N];
            for k in 0..if N == 4 { 3 } else { 2 } {
                let moved = simd.mul_f32s(dot(simd, seen.normal, sides[k]), scale);
                derivatives[k] = simd.select_f32s(counts, moved, zero);
                if N == 5 {
                    let tilted = simd.mul_f32s(seen.height, moved);
                    derivatives[k + 2] = simd.select_f32s(counts, tilted, zero);
                }
            }
            derivatives[N - 1] = simd.select_f32s(counts, scale, zero);
            for (a, &own) in derivatives.iter().enumerate() {
                for (sum, &other) in products[a].iter_mut().zip(&derivatives).skip(a) {
                    *sum = simd.mul_add_e_f32s(own, other, *sum);
                }
                right[a] = simd.mul_add_e_f32s(own, error, right[a]);
            }
            square = simd.mul_add_e_f32s(error, error, square);
            count = simd.add_f32s(count, simd.select_f32s(counts, surface.one, zero));
        }
        let mut normal = NormalSums { products: [[0.0; N]; N], right: [0.0; N] };
        for (a, (row, lanes)) in normal.products.iter_mut().zip(&products).enumerate() {
            for (sum, &lanes) in row.iter_mut().zip(lanes).skip(a) {
                *sum = f64::from(simd.reduce_sum_f32s(lanes));
            }
            normal.right[a] = f64::from(simd.reduce_sum_f32s(right[a]));
        }
        let square = f64::from(simd.reduce_sum_f32s(square));
        let count = f64::from(simd.reduce_sum_f32s(count));
        RoundSums { normal, square, count }
    }
}

impl WithSimd for Capped<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Self { readings, round } = self;
        let surface = spread(simd, &round);
        let mut sum = simd.splat_f32s(0.0);
        let columns = readings.vectors::<S>();
        for i in 0..columns[0].len() {
            let readings = vectors(columns.map(|column| column[i]));
            let seen = across(simd, &surface, &readings, false);
            // Nothing where there is no reading.
            let error = simd.mul_f32s(seen.error_m, readings.per_sigma);
            let square =
                simd.min_f32s(simd.mul_f32s(error, error), simd.splat_f32s((CAP * CAP) as f32));
            sum = simd.add_f32s(sum, square);
        }
        f64::from(simd.reduce_sum_f32s(sum))
    }
}

impl WithSimd for Distances<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Self { readings, round } = self;
        let surface = spread(simd, &round);
        let zero = simd.splat_f32s(0.0);
        let mut sum = zero;
        let columns = readings.vectors::<S>();
        for i in 0..columns[0].len() {
            let readings = vectors(columns.map(|column| column[i]));
            let seen = across(simd, &surface, &readings, false);
            let distance = simd.mul_f32s(seen.error_m, seen.cosine);
            let counts = simd.greater_than_f32s(readings.per_sigma, zero);
            let distance = simd.select_f32s(counts, distance, zero);
            sum = simd.mul_add_e_f32s(distance, distance, sum);
        }
        f64::from(simd.reduce_sum_f32s(sum))
    }
}
