//! The sphere or cylinder that explains the best part of a few facets, algebraically.
//!
//! Most guesses fail, so what they cost is what matters: readings are kept by column and gone through a
//! vector at a time, and nothing is fitted that is not asked for.

use super::fit::{LEAST_COSINE, Model, across};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use pulp::{Arch, Simd, WithSimd};

/// Part of a facet that a guess is fitted to, and how often it is chosen anew.
const KEPT_SHARE: f64 = 0.7;
const TRIMS: usize = 3;
/// Mean square error of the best part of the facets beyond which trimming does not save a guess.
const HOPELESS: f64 = 40.0;

/// Readings that a facet's columns are filled up to a multiple of; as many as the vectors of any processor
/// can share.
const BLOCK: usize = 8;

/// Readings of facets by coordinate, each facet filled up with places of no gain.
#[derive(Clone, Debug, Default)]
pub(super) struct Guesser {
    points: [Vec<f64>; 3],
    /// Squares of the ranges over their variances.
    gains: Vec<f64>,
    /// One over the variances; zero for no reading.
    weights: Vec<f64>,
    /// The weights, zero for readings that a guess is not fitted to.
    kept: Vec<f64>,
    errors: Vec<f64>,
    /// Where each facet begins, and its readings.
    facets: Vec<(usize, usize)>,
    readings: usize,
    centroid: Vector3<f64>,
    /// Scatter of the points about the centroid, not divided by their number.
    scatter: Matrix3<f64>,
}

impl Guesser {
    pub fn clear(&mut self) {
        let [x, y, z] = &mut self.points;
        for column in [x, y, z, &mut self.gains] {
            column.clear();
        }
        self.facets.clear();
        self.readings = 0;
    }

    /// Adds a reading of the facet at hand, whose range has this square over its variance.
    #[inline]
    pub fn push(&mut self, point: [f64; 3], gain: f64) {
        for (column, value) in self.points.iter_mut().zip(point) {
            column.push(value);
        }
        self.gains.push(gain);
    }

    /// Ends a facet; returns whether it has any readings.
    pub fn end_facet(&mut self) -> bool {
        let begin = self.end_of_last();
        let count = self.gains.len() - begin;
        let end = self.gains.len().next_multiple_of(BLOCK);
        let [x, y, z] = &mut self.points;
        for column in [x, y, z, &mut self.gains] {
            column.resize(end, 0.0);
        }
        self.facets.push((begin, count));
        self.readings += count;
        count > 0
    }

    /// Where the last facet that has ended does.
    fn end_of_last(&self) -> usize {
        self.facets.last().map_or(0, |&(begin, count)| (begin + count).next_multiple_of(BLOCK))
    }

    /// Makes the readings ready to be fitted to.
    pub fn prepare(&mut self) {
        for column in [&mut self.weights, &mut self.kept, &mut self.errors] {
            column.resize(self.gains.len(), 0.0);
        }
        Arch::new().dispatch(Prepare(self));
    }

    /// The direction in which the points extend most.
    pub fn principal_axis(&self) -> Vector3<f64> {
        let eigen = self.scatter.symmetric_eigen();
        eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned()
    }

    /// The cylinder along `axis` that fits the best part of each facet, and the mean square error of that
    /// part, if it is less than `enough`: a facet may have taken in a stick that is not its own.
    pub fn cylinder(&mut self, axis: Vector3<f64>, enough: f64) -> Option<(f64, Model)> {
        let (e1, e2) = across(&axis);
        Arch::new().dispatch(Trim::<3> { of: self, axis, sides: [e1, e2], enough })
    }

    /// The same with a sphere.
    pub fn sphere(&mut self, enough: f64) -> Option<(f64, Model)> {
        let none = Vector3::zeros();
        Arch::new().dispatch(Trim::<4> { of: self, axis: none, sides: [none, none], enough })
    }
}

/// Weights, centroid and scatter.
struct Prepare<'a>(&'a mut Guesser);

impl WithSimd for Prepare<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        const { assert!(BLOCK.is_multiple_of(S::F64_LANES), "blocks are whole vectors") };
        let Guesser { points, gains, weights, readings, centroid, scatter, .. } = self.0;
        let zero = simd.splat_f64s(0.0);
        let mut sums = [zero; 3];
        let mut products = [[zero; 3]; 3];
        let columns = points.each_ref().map(|column| S::as_simd_f64s(column).0);
        let gains = S::as_simd_f64s(gains).0;
        let weights = S::as_mut_simd_f64s(weights).0;
        for (i, (weight, &gain)) in weights.iter_mut().zip(gains).enumerate() {
            let p = columns.map(|column| column[i]);
            for a in 0..3 {
                sums[a] = simd.add_f64s(sums[a], p[a]);
                for b in 0..=a {
                    products[a][b] = simd.mul_add_e_f64s(p[a], p[b], products[a][b]);
                }
            }
            let there = simd.greater_than_f64s(gain, zero);
            let per_variance = simd.div_f64s(gain, dot(simd, p, p));
            *weight = simd.select_f64s(there, per_variance, zero);
        }
        let n = (*readings).max(1) as f64;
        *centroid = Vector3::from(sums.map(|sum| simd.reduce_sum_f64s(sum))) / n;
        let products = products.map(|row| row.map(|sum| simd.reduce_sum_f64s(sum)));
        *scatter =
            Matrix3::from_fn(|a, b| products[a.max(b)][a.min(b)] - n * centroid[a] * centroid[b]);
    }
}

/// A fit of a circle across an axis, N being 3, or of a sphere, N being 4.
struct Trim<'a, const N: usize> {
    of: &'a mut Guesser,
    axis: Vector3<f64>,
    sides: [Vector3<f64>; 2],
    enough: f64,
}

impl<const N: usize> WithSimd for Trim<'_, N> {
    type Output = Option<(f64, Model)>;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> Option<(f64, Model)> {
        self.of.kept.clone_from(&self.of.weights);
        let mut model = self.fit(simd)?;
        let mut mean = f64::INFINITY;
        for round in 1..=TRIMS {
            let (error, changed) = self.trim(simd, &model);
            mean = error;
            // With the last choice it is decided what the error is. What is fitted to the same readings is
            // the same.
            let is_last = round == TRIMS || !changed;
            if mean > HOPELESS || (is_last && mean >= self.enough) {
                return None;
            }
            if !changed {
                break;
            }
            model = self.fit(simd)?;
        }
        let (foot, radius_m) = model;
        let model = match N {
            3 => Model::Cylinder { foot, axis: self.axis, radius_m },
            _ => Model::Sphere { centre: foot, radius_m },
        };
        Some((mean, model))
    }
}

impl<const N: usize> Trim<'_, N> {
    /// The foot or centre, and the radius, that fit the kept readings algebraically.
    #[inline(always)]
    fn fit<S: Simd>(&self, simd: S) -> Option<(Vector3<f64>, f64)> {
        let Guesser { points, kept, centroid, .. } = &*self.of;
        let zero = simd.splat_f64s(0.0);
        let columns = points.each_ref().map(|column| S::as_simd_f64s(column).0);
        let sides = self.sides.map(|side| splat(simd, &side));
        let middle = splat(simd, centroid);
        let mut products = [[zero; N]; N];
        let mut right = [zero; N];
        for (i, &weight) in S::as_simd_f64s(kept).0.iter().enumerate() {
            let p = columns.map(|column| column[i]);
            let d = [0, 1, 2].map(|k| simd.sub_f64s(p[k], middle[k]));
            // The last of the row is one.
            let mut row = [simd.splat_f64s(1.0); N];
            let mut square = zero;
            for k in 0..N - 1 {
                row[k] = if N == 3 { dot(simd, sides[k], d) } else { d[k] };
                square = simd.mul_add_e_f64s(row[k], row[k], square);
            }
            for a in 0..N {
                let weighted = if a == N - 1 { weight } else { simd.mul_f64s(row[a], weight) };
                for b in 0..=a {
                    products[a][b] = simd.mul_add_e_f64s(weighted, row[b], products[a][b]);
                }
                right[a] = simd.mul_add_e_f64s(weighted, square, right[a]);
            }
        }
        // Twice the coordinates are the factors. The decomposition looks at the lower triangle alone.
        let factor = |k: usize| if k == N - 1 { 1.0 } else { 2.0 };
        let mut normal = SMatrix::<f64, N, N>::zeros();
        let mut sum = SVector::<f64, N>::zeros();
        for a in 0..N {
            for b in 0..=a {
                normal[(a, b)] = factor(a) * factor(b) * simd.reduce_sum_f64s(products[a][b]);
            }
            sum[a] = factor(a) * simd.reduce_sum_f64s(right[a]);
        }
        let solution = normal.cholesky()?.solve(&sum);
        let mut foot = *centroid;
        let mut square = solution[N - 1];
        for k in 0..N - 1 {
            square += solution[k] * solution[k];
            if N == 3 {
                foot += self.sides[k] * solution[k];
            } else {
                foot[k] += solution[k];
            }
        }
        let radius_m = square.sqrt();
        radius_m.is_finite().then_some((foot, radius_m))
    }

    /// Keeps the best part of each facet; returns its mean square error, and whether it is another one than
    /// before.
    #[inline(always)]
    fn trim<S: Simd>(&mut self, simd: S, model: &(Vector3<f64>, f64)) -> (f64, bool) {
        let zero = simd.splat_f64s(0.0);
        let one = simd.splat_f64s(1.0);
        let (mut sum, mut count, mut change) = (zero, zero, zero);
        for k in 0..self.of.facets.len() {
            let (begin, readings) = self.of.facets[k];
            let part = begin..(begin + readings).next_multiple_of(BLOCK);
            let range = self.tell_errors(simd, part.clone(), model);
            let keep = (KEPT_SHARE * (readings - 1) as f64).ceil() as usize + 1;
            let Guesser { weights, kept, errors, .. } = &mut *self.of;
            let errors = S::as_simd_f64s(&errors[part.clone()]).0;
            let limit = if keep < readings { limit(simd, errors, keep, range) } else { range[1] };
            let limit = simd.splat_f64s(limit);
            let weights = S::as_simd_f64s(&weights[part.clone()]).0;
            let kept = S::as_mut_simd_f64s(&mut kept[part]).0;
            for ((kept, &weight), &error) in kept.iter_mut().zip(weights).zip(errors) {
                let stays = simd.less_than_or_equal_f64s(error, limit);
                let now = simd.select_f64s(stays, weight, zero);
                change = simd.max_f64s(change, simd.abs_f64s(simd.sub_f64s(now, *kept)));
                *kept = now;
                sum = simd.add_f64s(sum, simd.select_f64s(stays, error, zero));
                count = simd.add_f64s(count, simd.select_f64s(stays, one, zero));
            }
        }
        let mean = simd.reduce_sum_f64s(sum) / simd.reduce_sum_f64s(count);
        (mean, simd.reduce_max_f64s(change) > 0.0)
    }

    /// Computes the squared errors of a facet's readings, infinite where there is none; returns the least and
    /// the greatest of them.
    #[inline(always)]
    fn tell_errors<S: Simd>(
        &mut self,
        simd: S,
        part: std::ops::Range<usize>,
        &(foot, radius_m): &(Vector3<f64>, f64),
    ) -> [f64; 2] {
        let Guesser { points, gains, errors, .. } = &mut *self.of;
        let (zero, infinity) = (simd.splat_f64s(0.0), simd.splat_f64s(f64::INFINITY));
        let columns = points.each_ref().map(|column| S::as_simd_f64s(&column[part.clone()]).0);
        let gains = S::as_simd_f64s(&gains[part.clone()]).0;
        let errors = S::as_mut_simd_f64s(&mut errors[part]).0;
        let (foot, axis) = (splat(simd, &foot), splat(simd, &self.axis));
        let radius = simd.splat_f64s(radius_m);
        let shallow = simd.splat_f64s(LEAST_COSINE * LEAST_COSINE);
        let (mut least, mut greatest) = (infinity, zero);
        for (i, (error, &gain)) in errors.iter_mut().zip(gains).enumerate() {
            let p = columns.map(|column| column[i]);
            let mut radial = [0, 1, 2].map(|k| simd.sub_f64s(p[k], foot[k]));
            if N == 3 {
                let height = dot(simd, axis, radial);
                radial =
                    [0, 1, 2].map(|k| simd.sub_f64s(radial[k], simd.mul_f64s(axis[k], height)));
            }
            let square = simd.max_f64s(dot(simd, radial, radial), simd.splat_f64s(1e-18));
            let distance = simd.sub_f64s(simd.sqrt_f64s(square), radius);
            // The radial's length divides the normal, so it need not be divided by.
            let inwards = dot(simd, radial, p);
            let believed = simd.mul_f64s(shallow, simd.mul_f64s(square, dot(simd, p, p)));
            let incidence = simd.max_f64s(simd.mul_f64s(inwards, inwards), believed);
            let across = simd.mul_f64s(simd.mul_f64s(distance, distance), square);
            let along = simd.div_f64s(simd.mul_f64s(across, gain), incidence);
            let there = simd.greater_than_f64s(gain, zero);
            *error = simd.select_f64s(there, along, infinity);
            least = simd.min_f64s(least, *error);
            greatest = simd.max_f64s(greatest, simd.select_f64s(there, along, zero));
        }
        [simd.reduce_min_f64s(least), simd.reduce_max_f64s(greatest)]
    }
}

/// What exactly `keep` of the errors do not exceed, unless several are equal, from the least and the greatest
/// of them.
#[inline(always)]
fn limit<S: Simd>(simd: S, errors: &[S::f64s], keep: usize, range: [f64; 2]) -> f64 {
    // Numbers that are not negative are in the order of their bits.
    let [least, mut high] = range.map(f64::to_bits);
    let mut low = least.saturating_sub(1);
    let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
    while low + 1 < high {
        let middle = u64::midpoint(low, high);
        let bound = simd.splat_f64s(f64::from_bits(middle));
        let count = errors.iter().fold(zero, |count, &error| {
            let below = simd.less_than_or_equal_f64s(error, bound);
            simd.add_f64s(count, simd.select_f64s(below, one, zero))
        });
        let count = simd.reduce_sum_f64s(count) as usize;
        if count == keep {
            return f64::from_bits(middle);
        }
        // Which way is hard to foretell, so both are taken.
        let fewer = count < keep;
        low = std::hint::select_unpredictable(fewer, middle, low);
        high = std::hint::select_unpredictable(fewer, high, middle);
    }
    f64::from_bits(high)
}

#[inline(always)]
fn splat<S: Simd>(simd: S, v: &Vector3<f64>) -> [S::f64s; 3] {
    [simd.splat_f64s(v.x), simd.splat_f64s(v.y), simd.splat_f64s(v.z)]
}

#[inline(always)]
fn dot<S: Simd>(simd: S, a: [S::f64s; 3], b: [S::f64s; 3]) -> S::f64s {
    let xy = simd.mul_add_e_f64s(a[0], b[0], simd.mul_f64s(a[1], b[1]));
    simd.mul_add_e_f64s(a[2], b[2], xy)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two facets of a column of 0.3 m at 3 m, one of which has a reading that is not its own.
    fn facets() -> Guesser {
        let mut guesser = Guesser::default();
        for facet in [-1.0, 1.0] {
            for i in 0..11 {
                let (turn, height) = (0.1 * facet * f64::from(i), 0.1 * f64::from(i % 4));
                let radius = if facet > 0.0 && i == 5 { 0.4 } else { 0.3 };
                let point = [3.0 - radius * turn.cos(), radius * turn.sin(), height];
                guesser.push(point, 9.0 / 1e-4);
            }
            assert!(guesser.end_facet());
        }
        guesser.prepare();
        guesser
    }

    #[test]
    fn a_column_is_guessed_without_what_is_not_its_own() {
        let (error, model) = facets().cylinder(Vector3::z(), 4.0).expect("it is a column");
        let Model::Cylinder { foot, radius_m, .. } = model else { panic!("{model:?}") };
        assert!(error < 1e-6, "{error}");
        assert!((radius_m - 0.3).abs() < 1e-6 && (foot.x - 3.0).abs() < 1e-6, "{foot} {radius_m}");
        assert!(facets().cylinder(Vector3::x(), 4.0).is_none_or(|(error, _)| error > 1.0));
        assert!(facets().cylinder(Vector3::z(), error).is_none(), "no better than is asked for");
    }
}
