//! How far readings reach along an axis and round a sphere or a cylinder.

use super::super::vectors::run;
use super::Readings;
use super::round::{Vectors, dot, less, some_of, splat, vectors};
use nalgebra::Vector3;
use pulp::{Simd, WithSimd};

/// Least and greatest coordinate of the readings along an axis.
pub(super) fn heights(readings: &Readings, axis: &Vector3<f64>) -> (f64, f64) {
    run(Heights { readings, axis: (*axis).into() })
}

/// Whether most readings are of the inner side of a cylinder about `axis` through `foot`, or of a sphere
/// about `foot`, for which the axis is zero: their rays go outwards where they end. Some blocks of them tell.
pub(super) fn are_within(readings: &Readings, foot: &Vector3<f64>, axis: &Vector3<f64>) -> bool {
    run(Outwards { readings, foot: (*foot).into(), axis: (*axis).into() }) > 0.0
}

/// Number of readings that are seen from `centre` at an angle of more than that of a cosine from the
/// direction `middle`.
pub(super) fn beyond_cap(
    readings: &Readings,
    centre: &Vector3<f64>,
    middle: &Vector3<f64>,
    cosine: f64,
) -> usize {
    run(BeyondCap { readings, centre: (*centre).into(), middle: (*middle).into(), cosine })
}

/// Number of readings that are seen from `foot` on the one and on the other side of `middle`, at an angle of
/// more than that of a sine and cosine about what `middle` and, as long as it, `side` are perpendicular to.
pub(super) fn beyond_arc(
    readings: &Readings,
    foot: &Vector3<f64>,
    [middle, side]: [&Vector3<f64>; 2],
    (sine, cosine): (f64, f64),
) -> [usize; 2] {
    let directions = [(*middle).into(), (*side).into()];
    run(BeyondArc { readings, foot: (*foot).into(), directions, sine, cosine })
}

struct Heights<'a> {
    readings: &'a Readings,
    axis: [f64; 3],
}

struct Outwards<'a> {
    readings: &'a Readings,
    foot: [f64; 3],
    axis: [f64; 3],
}

struct BeyondCap<'a> {
    readings: &'a Readings,
    centre: [f64; 3],
    middle: [f64; 3],
    cosine: f64,
}

struct BeyondArc<'a> {
    readings: &'a Readings,
    foot: [f64; 3],
    directions: [[f64; 3]; 2],
    sine: f64,
    cosine: f64,
}

impl WithSimd for Heights<'_> {
    type Output = (f64, f64);

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> (f64, f64) {
        let [x, y, z, .., per_sigma] = self.readings.vectors::<S>();
        let axis = splat(simd, self.axis);
        let infinity = simd.splat_f32s(f32::INFINITY);
        let (mut low, mut high) = (infinity, simd.neg_f32s(infinity));
        for (((&x, &y), &z), &per_sigma) in x.iter().zip(y).zip(z).zip(per_sigma) {
            let there = simd.greater_than_f32s(per_sigma, simd.splat_f32s(0.0));
            let height = dot(simd, axis, [x, y, z]);
            low = simd.min_f32s(low, simd.select_f32s(there, height, low));
            high = simd.max_f32s(high, simd.select_f32s(there, height, high));
        }
        (f64::from(simd.reduce_min_f32s(low)), f64::from(simd.reduce_max_f32s(high)))
    }
}

impl WithSimd for Outwards<'_> {
    /// Those that go outwards less those that do not.
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let columns = self.readings.vectors::<S>();
        let (foot, axis) = (splat(simd, self.foot), splat(simd, self.axis));
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let mut excess = zero;
        for i in some_of::<S>(columns[0].len(), self.readings.start_stride()) {
            let Vectors { point, ray, per_sigma } = vectors(columns.map(|column| column[i]));
            let there = simd.greater_than_f32s(per_sigma, zero);
            let there = simd.select_f32s(there, one, zero);
            let d = less(simd, point, foot, one);
            let radial = less(simd, d, axis, dot(simd, axis, d));
            let outwards = simd.greater_than_f32s(dot(simd, radial, ray), zero);
            let vote = simd.select_f32s(outwards, there, simd.neg_f32s(there));
            excess = simd.add_f32s(excess, vote);
        }
        simd.reduce_sum_f32s(excess)
    }
}

impl WithSimd for BeyondCap<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let [x, y, z, .., per_sigma] = self.readings.vectors::<S>();
        let (centre, middle) = (splat(simd, self.centre), splat(simd, self.middle));
        let cosine = simd.splat_f32s(self.cosine as f32);
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let mut count = zero;
        for (((&x, &y), &z), &per_sigma) in x.iter().zip(y).zip(z).zip(per_sigma) {
            let radial = less(simd, [x, y, z], centre, one);
            let length = simd.sqrt_f32s(dot(simd, radial, radial));
            let along = dot(simd, radial, middle);
            let beyond = simd.less_than_f32s(along, simd.mul_f32s(cosine, length));
            let beyond = simd.and_m32s(beyond, simd.greater_than_f32s(per_sigma, zero));
            count = simd.add_f32s(count, simd.select_f32s(beyond, one, zero));
        }
        simd.reduce_sum_f32s(count) as usize
    }
}

impl WithSimd for BeyondArc<'_> {
    type Output = [usize; 2];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [usize; 2] {
        let [x, y, z, .., per_sigma] = self.readings.vectors::<S>();
        let foot = splat(simd, self.foot);
        let [middle, side] = self.directions.map(|direction| splat(simd, direction));
        let (sine, cosine) =
            (simd.splat_f32s(self.sine as f32), simd.splat_f32s(self.cosine as f32));
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let mut counts = [zero; 2];
        for (((&x, &y), &z), &per_sigma) in x.iter().zip(y).zip(z).zip(per_sigma) {
            let there = simd.greater_than_f32s(per_sigma, zero);
            let there = simd.select_f32s(there, one, zero);
            let d = less(simd, [x, y, z], foot, one);
            let across = simd.mul_f32s(dot(simd, side, d), cosine);
            let bound = simd.mul_f32s(dot(simd, middle, d), sine);
            for (count, across) in counts.iter_mut().zip([across, simd.neg_f32s(across)]) {
                let beyond = simd.and_m32s(
                    simd.greater_than_f32s(across, bound),
                    simd.greater_than_f32s(across, zero),
                );
                *count = simd.add_f32s(*count, simd.select_f32s(beyond, there, zero));
            }
        }
        counts.map(|count| simd.reduce_sum_f32s(count) as usize)
    }
}
