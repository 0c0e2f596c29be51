//! The plane: weighted least squares of the distance, with its covariance.

use super::super::moments::Moments;
use super::{GATE, GATED_VARIANCE, LEAST_COSINE, Model, Readings};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Standard deviation beyond which a rotation says nothing, in radians: what a region one line wide
/// gets about that line.
const FREE_ROTATION_RAD: f64 = 1.0;
/// Fewest core readings, and their least share, for which the border readings can be spared.
const FEWEST_CORE: usize = 12;
const LEAST_CORE_SHARE: f64 = 0.3;

/// A plane with its local frame: z along the normal towards the sensor, x and y along the principal
/// axes of the points, the origin under their centroid.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct PlaneFit {
    pub grid_from_plane: Isometry3<f64>,
    /// Offset along z, rotation about y, rotation about x.
    pub covariance: Matrix3<f64>,
    /// Lesser extent of the readings in metres.
    pub width_m: f64,
    /// Standard deviation of a reading, root mean square, in metres.
    pub sigma_m: f64,
}

impl PlaneFit {
    pub fn model(&self) -> Model {
        let normal = self.grid_from_plane.rotation * Vector3::z();
        Model::Plane { normal, offset_m: normal.dot(&self.grid_from_plane.translation.vector) }
    }
}

/// Sums over the readings of one region, which its plane, frame and errors follow from.
#[derive(Clone, Copy, Debug, Default)]
pub(in super::super) struct PlaneSums {
    /// Each sum twice: weighted by `r² / σ²`, and plain. First those of the readings at the border,
    /// then those of the core.
    sums: [[[f64; 2]; 10]; 2],
    counts: [usize; 2],
}

impl PlaneSums {
    /// Adds a reading of the given weight; `core` as in [`Readings`].
    #[inline]
    pub fn add(&mut self, [x, y, z]: [f64; 3], weight: f64, core: bool) {
        let sums = &mut self.sums[usize::from(core)];
        let terms = [x * x, x * y, x * z, y * y, y * z, z * z, x, y, z, 1.0];
        for (sum, term) in sums.iter_mut().zip(terms) {
            sum[0] += weight * term;
            sum[1] += term;
        }
        self.counts[usize::from(core)] += 1;
    }

    /// Adds readings of the given coordinates, weighted by the squares of their gains. Those of the
    /// core, which most are, are summed up in registers.
    pub fn add_run(&mut self, [x, y, z]: [&[f32]; 3], gains: &[f32], core: &[bool]) {
        let mut sums = [[0.0; 2]; 10];
        let mut count = 0;
        for ((((&x, &y), &z), &gain), &core) in x.iter().zip(y).zip(z).zip(gains).zip(core) {
            let [x, y, z, gain] = [x, y, z, gain].map(f64::from);
            let weight = gain * gain;
            if !core {
                self.add([x, y, z], weight, false);
                continue;
            }
            let terms = [x * x, x * y, x * z, y * y, y * z, z * z, x, y, z, 1.0];
            for (sum, term) in sums.iter_mut().zip(terms) {
                sum[0] += weight * term;
                sum[1] += term;
            }
            count += 1;
        }
        for (sum, more) in self.sums[1].iter_mut().zip(sums) {
            sum[0] += more[0];
            sum[1] += more[1];
        }
        self.counts[1] += count;
    }

    pub fn len(&self) -> usize {
        self.counts[0] + self.counts[1]
    }

    /// The sums without weights: `c` is the number of readings.
    pub fn plain(&self) -> Moments {
        self.moments(0, 1).plus(&self.moments(1, 1))
    }

    fn moments(&self, part: usize, kind: usize) -> Moments {
        let sum = |k: usize| self.sums[part][k][kind];
        Moments {
            a: [sum(0), sum(1), sum(2), sum(3), sum(4), sum(5)],
            b: [sum(6), sum(7), sum(8)],
            c: sum(9),
            n: self.counts[part] as f64,
        }
    }

    /// Whether there are enough core readings to do without those at the border.
    fn use_core(&self) -> bool {
        let core = self.counts[1];
        core >= FEWEST_CORE && core as f64 >= LEAST_CORE_SHARE * self.len() as f64
    }
}

/// A plane through all readings, to measure their errors by.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct PlaneStart {
    frame: Isometry3<f64>,
    centroid: Vector3<f64>,
    normal: [f32; 3],
    offset_m: f32,
    /// Whether readings at the border are left out.
    use_core: bool,
    /// What the plane is fitted to.
    moments: Moments,
    width_m: f64,
    sigma_m: f64,
}

impl PlaneStart {
    /// `None` for readings that span no line.
    pub fn of(sums: &PlaneSums) -> Option<Self> {
        let plain = sums.plain();
        if sums.len() < 3 {
            return None;
        }
        let centroid = Vector3::from(plain.b) / plain.c;
        let square = symmetric(&plain.a) / plain.c;
        let scatter = square - centroid * centroid.transpose();
        let [border, core] = [sums.moments(0, 0), sums.moments(1, 0)];
        let all = core.plus(&border);
        let noise = square.trace() * plain.c / all.c;
        let (frame, middle) = principal_frame(&centroid, &scatter, noise)?;
        let use_core = sums.use_core();
        let moments = if use_core { core } else { all };
        let frame = solve(&frame, &moments)?.frame;
        let normal = frame.rotation * Vector3::z();
        let offset_m = normal.dot(&frame.translation.vector);
        Some(Self {
            frame,
            centroid,
            normal: [normal.x as f32, normal.y as f32, normal.z as f32],
            offset_m: offset_m as f32,
            use_core,
            moments,
            width_m: (12.0 * middle).sqrt(),
            sigma_m: noise.sqrt(),
        })
    }

    /// Error of a reading in standard deviations. One that is far off, or that meets the plane at a
    /// more grazing angle than its weight allows for, is taken out of the fit, or gets its weight.
    #[inline]
    pub fn settle(&mut self, p: [f32; 3], range: f32, gain: f32, core: bool) -> f32 {
        let [x, y, z] = self.normal;
        let distance = x * p[0] + y * p[1] + z * p[2] - self.offset_m;
        // `gain / offset` is one over the deviation of the range times the cosine of incidence.
        let (offset, least) = (self.offset_m.abs(), LEAST_COSINE as f32 * range);
        let error = distance * gain / offset.max(least);
        let outside = error.abs() > GATE as f32;
        if (outside || offset < least) && (core || !self.use_core) {
            let point = p.map(f64::from);
            let weight = f64::from(gain) * f64::from(gain);
            self.moments.sub_point(point, weight);
            if !outside {
                let share = f64::from(offset / least);
                self.moments.add_point(point, weight * share * share);
            }
        }
        error
    }

    /// The plane of the readings that are left.
    pub fn finish(self) -> Option<PlaneFit> {
        let inliers = self.moments.n.round();
        if inliers < 3.0 {
            return None;
        }
        let Solution { frame, covariance, square } = solve(&self.frame, &self.moments)?;
        let mean_square = square / ((inliers - 3.0).max(1.0) * GATED_VARIANCE);
        let (mut frame, covariance) = facing_the_sensor(frame, covariance * mean_square.max(1.0));
        // The centroid's foot on the plane is the origin.
        let normal = frame.rotation * Vector3::z();
        let gap = normal.dot(&(self.centroid - frame.translation.vector));
        let origin = self.centroid - normal * gap;
        let shift = frame.inverse_transform_vector(&(origin - frame.translation.vector));
        let covariance = moved_covariance(&covariance, &shift);
        frame.translation = Translation3::from(origin);
        let (width_m, sigma_m) = (self.width_m, self.sigma_m);
        Some(PlaneFit { grid_from_plane: frame, covariance, width_m, sigma_m })
    }
}

/// Fits a plane; `None` for readings that span no line.
pub(in super::super) fn fit_plane(readings: &Readings) -> Option<PlaneFit> {
    let mut sums = PlaneSums::default();
    let ranges = |i: usize| readings.points[i].dot(&readings.rays[i]);
    for i in 0..readings.len() {
        let gain = ranges(i) / readings.sigmas[i];
        sums.add(readings.points[i].into(), gain * gain, readings.core[i]);
    }
    let mut start = PlaneStart::of(&sums)?;
    for i in 0..readings.len() {
        let p = readings.points[i].map(|v| v as f32).into();
        let range = ranges(i);
        start.settle(p, range as f32, (range / readings.sigmas[i]) as f32, readings.core[i]);
    }
    start.finish()
}

struct Solution {
    frame: Isometry3<f64>,
    covariance: Matrix3<f64>,
    /// Sum of the squared errors that are left.
    square: f64,
}

/// Weighted least squares in the local frame, whose unknowns are the offset and the two rotations: a
/// point at local (x, y) moves by `δz - θ x + ψ y`.
///
/// A reading errs across the plane by its range noise times the cosine of incidence, which is the
/// plane's offset over the range; so its weight is that of [`Moments`] over the square of the
/// offset, and the sums need not be taken anew for each plane. The inverse of the normal matrix is
/// the covariance (domain notes 3.4, for unequal weights). Where the readings scatter more than
/// their noise says, it is scaled up by what they show, never down.
fn solve(frame: &Isometry3<f64>, moments: &Moments) -> Option<Solution> {
    let rotation = frame.rotation.to_rotation_matrix().into_inner();
    let origin = frame.translation.vector;
    let first = Vector3::from(moments.b);
    let shifted = symmetric(&moments.a) - first * origin.transpose() - origin * first.transpose()
        + origin * origin.transpose() * moments.c;
    let l = rotation.transpose() * shifted * rotation;
    let b = rotation.transpose() * (first - origin * moments.c);
    let offset = rotation.column(2).dot(&origin).abs().max(LEAST_COSINE * origin.norm());
    let scale = 1.0 / (offset * offset);
    let normal = Matrix3::new(
        moments.c, -b.x, b.y, //
        -b.x, l.m11, -l.m12, //
        b.y, -l.m12, l.m22,
    ) * scale;
    let right = Vector3::new(b.z, -l.m13, l.m23) * scale;
    // What no reading fixes stays where it is: a prior of one radian.
    let prior = 1.0 / (FREE_ROTATION_RAD * FREE_ROTATION_RAD);
    let information = normal + Matrix3::from_diagonal(&Vector3::new(0.0, prior, prior));
    let covariance = information.cholesky()?.inverse();
    let correction = covariance * right;
    Some(Solution {
        frame: moved(frame, &correction),
        covariance,
        square: (l.m33 * scale - right.dot(&correction)).max(0.0),
    })
}

fn symmetric([xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> Matrix3<f64> {
    Matrix3::new(*xx, *xy, *xz, *xy, *yy, *yz, *xz, *yz, *zz)
}

/// The same plane with its z axis towards the origin: half a turn about x where it looks away.
fn facing_the_sensor(
    frame: Isometry3<f64>,
    covariance: Matrix3<f64>,
) -> (Isometry3<f64>, Matrix3<f64>) {
    if (frame.rotation * Vector3::z()).dot(&frame.translation.vector) <= 0.0 {
        return (frame, covariance);
    }
    let half_turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let signs = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    (frame * half_turn, signs * covariance * signs)
}

/// The frame after a perturbation (offset along z, rotation about y, rotation about x).
fn moved(frame: &Isometry3<f64>, correction: &Vector3<f64>) -> Isometry3<f64> {
    let rotation =
        UnitQuaternion::from_scaled_axis(Vector3::new(correction[2], correction[1], 0.0));
    frame * Isometry3::from_parts(Translation3::new(0.0, 0.0, correction[0]), rotation)
}

/// The covariance of the offset at a point `shift` away in the local frame.
fn moved_covariance(covariance: &Matrix3<f64>, shift: &Vector3<f64>) -> Matrix3<f64> {
    let jacobian = Matrix3::new(1.0, -shift.x, shift.y, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    jacobian * covariance * jacobian.transpose()
}

/// The principal frame of the points, z towards the sensor, and their variance along y.
///
/// Where the points lie on one line within their noise, all planes through it fit. Then the one
/// that faces the sensor most is taken: the eigenvectors across the line are noise, and a plane
/// along the rays would explain any scatter.
fn principal_frame(
    centroid: &Vector3<f64>,
    scatter: &Matrix3<f64>,
    noise: f64,
) -> Option<(Isometry3<f64>, f64)> {
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]).then(a.cmp(&b)));
    let [greatest, middle, _] = order.map(|i| eigen.eigenvalues[i].max(0.0));
    // One centimetre in ten kilometres: points that are all the same.
    if greatest.is_nan() || greatest <= 1e-12 * centroid.norm_squared() {
        return None;
    }
    let ex = largest_positive(eigen.eigenvectors.column(order[0]).into_owned());
    let towards = -centroid;
    let mut ez = if middle <= 4.0 * noise {
        towards - ex * ex.dot(&towards)
    } else {
        eigen.eigenvectors.column(order[2]).into_owned()
    };
    if ez.norm_squared() <= 1e-12 * towards.norm_squared() {
        ez = eigen.eigenvectors.column(order[2]).into_owned();
    }
    let ez = (ez - ex * ex.dot(&ez)).normalize();
    let ez = if ez.dot(&towards) < 0.0 { -ez } else { ez };
    let rotation =
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[ex, ez.cross(&ex), ez]));
    let frame = Isometry3::from_parts(
        Translation3::from(*centroid),
        UnitQuaternion::from_rotation_matrix(&rotation),
    );
    Some((frame, middle))
}

/// The vector or its opposite: the one whose largest component is positive.
pub(super) fn largest_positive(v: Vector3<f64>) -> Vector3<f64> {
    let largest = v.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    if largest < 0.0 { -v } else { v }
}
