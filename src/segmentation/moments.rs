//! Sufficient statistics of a plane seen by range readings: they add up.
//!
//! On a plane `q · p = 1` (with `q = n / d`) the inverse range is linear in the ray's direction, so a
//! reading `p` of variance σ² errs by `r (q · p - 1)` in range, to first order. The sum of squares
//! over a region, in units of its noise, is therefore a quadratic form of ten sums with weights
//! `v = r² / σ²`: `c - 2 q·b + qᵀ A q`, where `A = Σ v p pᵀ`, `b = Σ v p`, `c = Σ v`.
//! Two regions become one by adding their sums.

/// Tangent of the angle of incidence up to which planes are expected: 72°.
const SLOPE: f64 = 3.0;

/// The ten sums and the number of readings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Moments {
    /// Σ v p pᵀ: xx, xy, xz, yy, yz, zz.
    pub a: [f64; 6],
    /// Σ v p.
    pub b: [f64; 3],
    /// Σ v.
    pub c: f64,
    /// Number of readings.
    pub n: f64,
}

impl Moments {
    pub fn add_point(&mut self, [x, y, z]: [f64; 3], v: f64) {
        let (vx, vy, vz) = (v * x, v * y, v * z);
        self.a[0] += vx * x;
        self.a[1] += vx * y;
        self.a[2] += vx * z;
        self.a[3] += vy * y;
        self.a[4] += vy * z;
        self.a[5] += vz * z;
        self.b[0] += vx;
        self.b[1] += vy;
        self.b[2] += vz;
        self.c += v;
        self.n += 1.0;
    }

    pub fn add(&mut self, other: &Self) {
        for (a, b) in self.a.iter_mut().zip(other.a) {
            *a += b;
        }
        for (a, b) in self.b.iter_mut().zip(other.b) {
            *a += b;
        }
        self.c += other.c;
        self.n += other.n;
    }

    pub fn sub_point(&mut self, [x, y, z]: [f64; 3], v: f64) {
        self.add_point([x, y, z], -v);
        self.n -= 2.0;
    }

    /// The sums of both.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let mut sum = *self;
        sum.add(other);
        sum
    }

    /// What is believed of a plane before it is seen: the tangent of the angle of incidence, which is
    /// the slope of `q` against the ray in units of the inverse range, is about [`SLOPE`] at most.
    ///
    /// Readings on one ray or one line leave `q` free across it; this keeps that part finite and its
    /// variance honest. Against readings that do fix `q` it is far below their noise.
    fn prior(&self) -> f64 {
        let [xx, _, _, yy, _, zz] = self.a;
        (xx + yy + zz + f64::MIN_POSITIVE) / (SLOPE * SLOPE * (self.c + f64::MIN_POSITIVE))
    }

    /// The best `q`, by Cholesky's decomposition.
    pub fn solve(&self) -> [f64; 3] {
        self.solve_with_covariance().0
    }

    /// The best `q` and the inverse of `A`, its covariance: xx, xy, xz, yy, yz, zz.
    pub fn solve_with_covariance(&self) -> ([f64; 3], [f64; 6]) {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let ridge = self.prior();
        // A = L Lᵀ; with M = L⁻¹ the covariance is Mᵀ M, and q follows from it.
        let m00 = 1.0 / (xx + ridge).sqrt();
        let (l10, l20) = (xy * m00, xz * m00);
        let m11 = 1.0 / (yy + ridge - l10 * l10).max(ridge).sqrt();
        let l21 = (yz - l20 * l10) * m11;
        let m22 = 1.0 / (zz + ridge - l20 * l20 - l21 * l21).max(ridge).sqrt();
        let m10 = -l10 * m00 * m11;
        let m21 = -l21 * m11 * m22;
        let m20 = -(l20 * m00 + l21 * m10) * m22;
        let covariance = [
            m00 * m00 + m10 * m10 + m20 * m20,
            m10 * m11 + m20 * m21,
            m20 * m22,
            m11 * m11 + m21 * m21,
            m21 * m22,
            m22 * m22,
        ];
        let [b0, b1, b2] = self.b;
        let w = [m00 * b0, m10 * b0 + m11 * b1, m20 * b0 + m21 * b1 + m22 * b2];
        let q = [m00 * w[0] + m10 * w[1] + m20 * w[2], m11 * w[1] + m21 * w[2], m22 * w[2]];
        (q, covariance)
    }

    /// Sum of the squared errors under the plane `q`, in units of the noise.
    pub fn error(&self, q: &[f64; 3]) -> f64 {
        let [x, y, z] = *q;
        let linear = self.b[0] * x + self.b[1] * y + self.b[2] * z;
        (self.c - 2.0 * linear + self.square(q)).max(0.0)
    }

    /// Sum of the squares of what readings on a plane move by, in units of the noise, when `moved` is
    /// added to its `q`.
    pub fn square(&self, moved: &[f64; 3]) -> f64 {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        let [x, y, z] = *moved;
        xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z)
    }

    /// As [`error`](Self::error), with what the prior says against the plane.
    pub fn cost(&self, q: &[f64; 3]) -> f64 {
        self.error(q) + self.prior() * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on_plane(q: [f64; 3], u: [f64; 3]) -> [f64; 3] {
        let range = 1.0 / (q[0] * u[0] + q[1] * u[1] + q[2] * u[2]);
        u.map(|v| v * range)
    }

    #[test]
    fn the_best_plane_of_exact_readings_is_theirs() {
        let q = [0.3, -0.05, 0.1];
        let mut moments = Moments::default();
        for i in 0..30 {
            let (a, b) = (f64::from(i % 6) * 0.02, f64::from(i / 6) * 0.01);
            moments.add_point(on_plane(q, [1.0, a, b]), 1e7);
        }
        let found = moments.solve();
        for i in 0..3 {
            assert!((found[i] - q[i]).abs() < 1e-4, "{found:?}");
        }
        assert!(moments.error(&found) < 1e-3);
    }

    #[test]
    fn the_error_is_that_of_the_readings_one_by_one() {
        let q = [0.3, -0.05, 0.1];
        let mut moments = Moments::default();
        let mut sum = 0.0;
        for i in 0..40 {
            let (a, b) = (f64::from(i % 6) * 0.02, f64::from(i / 6) * 0.01);
            let wrong = 1.0 + 1e-3 * f64::from(i % 7 - 3);
            let p = on_plane(q, [1.0, a, b]).map(|v| v * wrong);
            let range = p.iter().map(|v| v * v).sum::<f64>().sqrt();
            let v = range * range / (0.01 * 0.01);
            moments.add_point(p, v);
            sum += (range * (1.0 - 1.0 / (q[0] * p[0] + q[1] * p[1] + q[2] * p[2])) / 0.01).powi(2);
        }
        assert!((moments.error(&q) / sum - 1.0).abs() < 0.01, "{} {sum}", moments.error(&q));
    }

    #[test]
    fn readings_on_one_line_have_a_finite_plane() {
        let mut moments = Moments::default();
        for i in 0..20 {
            moments.add_point([2.0, 0.0, f64::from(i) * 0.02], 1e4);
        }
        assert!(moments.solve().iter().all(|q| q.is_finite()));
        assert!(Moments::default().solve().iter().all(|q| q.is_finite()));
    }
}
