//! Least-squares fits of planes, spheres and cylinders to the points of one region.
//!
//! A reading errs along its ray, so its error across a surface of normal `n` is the range noise
//! times `|n · u|`, `u` being the ray's direction. All fits weight by it; on a floor seen at a
//! grazing angle that is a factor of ten between near and far, and the difference between an
//! unweighted fit and the information that is there.

mod choose;
mod cylinder;
mod packed;
mod plane;
mod reach;
mod readings;
mod round;
mod sphere;
mod sums;
mod unevenness;

pub(super) use choose::{
    choose, improve_model, is_flat, mean_square_distance, settle, settle_known, settle_model,
};
pub(super) use cylinder::across;
pub(super) use packed::Packed;
pub(super) use plane::{PlaneFit, centroid_of, fit_plane, plane_of};
pub(super) use readings::Readings;
pub(super) use sums::{
    Columns, PlaneSums, Reference,
    place::{ERROR as SUMMED_ERROR, SQUARE as SUMMED_SQUARE},
};
pub(super) use unevenness::{Blocks, Common, Unevenness};

use nalgebra::{Matrix4, Matrix5, Point3, SMatrix, SVector, Unit, Vector3};

/// Least cosine of the angle of incidence that weights believe in: beyond 87° the error is no
/// longer that of the range but of the ray's angle.
pub(super) const LEAST_COSINE: f64 = 0.05;
/// Least cosine of incidence of the readings that settle a sphere or a cylinder: nearer the rim a
/// reading may as well have missed, so those that did not are no fair sample.
const RIM_COSINE: f64 = 0.3;
/// Readings farther from the surface than this many standard deviations do not count in a fit.
const GATE: f64 = 3.0;
/// Standard deviation left inside the gate of ±3 of a normal distribution, squared.
const GATED_VARIANCE: f64 = 0.9733;

/// About how many readings, evenly taken, lead an iteration to where all of them finish it.
const START_READINGS: usize = 250;

/// How a round of an iteration measures errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Across the surface, for some of the readings.
    Start,
    /// Across the surface, without those that are far off.
    Gated,
    /// Along the rays, without those that are far off. Where a ray meets the surface does not depend
    /// on the reading's error, so neither do the normal there and the weight. Taken at the reading
    /// they are larger where it errs to one side, which biases the fit by about σ² / R.
    Rays,
}

impl Phase {
    /// The phase of a round if the one before it had another at the latest.
    fn of(round: usize, rounds: usize, phase: Self) -> Self {
        if phase == Self::Start && round >= rounds / 2 { Self::Gated } else { phase }
    }

    /// The phase after one that has converged.
    fn next(self) -> Option<Self> {
        (self == Self::Start).then_some(Self::Gated)
    }

    /// Greatest error that counts.
    fn gate(self) -> f64 {
        if self == Self::Start { f64::INFINITY } else { GATE }
    }

    /// Variance that is left inside the gate.
    fn variance(self) -> f64 {
        if self == Self::Start { 1.0 } else { GATED_VARIANCE }
    }

    /// Step through the readings in a round. Along the rays some of them lead the way at first, too.
    fn stride(self, round: usize, readings: &Readings) -> usize {
        match self {
            Self::Gated => 1,
            Self::Rays if round >= THIN_RAY_ROUNDS => 1,
            Self::Start | Self::Rays => readings.start_stride(),
        }
    }
}

/// Rounds that improve a surface whose readings are about to change again.
const FEW_ROUNDS: usize = 4;

/// Start of a sphere or cylinder, in the greatest radius that is believed, beyond which it is not worth
/// refining: what a plane leads to is larger by far, and noise makes starts too small.
const STRAY: f64 = 3.0;

/// Errors beyond this many standard deviations cost no more: the cost is that of an outlier.
pub(super) const CAP: f64 = 5.0;

/// Rounds along the rays, at most, and how many of them some readings are enough for.
const RAY_ROUNDS: usize = 4;
const THIN_RAY_ROUNDS: usize = 2;
/// Square of a step, in its standard deviations, after which there is no other.
const CONVERGED: f64 = 1e-4;

/// Sums of a least-squares problem of N unknowns.
#[derive(Clone, Copy, Debug)]
struct NormalSums<const N: usize> {
    /// The upper triangle is kept.
    products: [[f64; N]; N],
    right: [f64; N],
}

impl<const N: usize> NormalSums<N> {
    fn normal(&self) -> SMatrix<f64, N, N> {
        SMatrix::from_fn(|a, b| self.products[a.min(b)][a.max(b)])
    }

    fn right(&self) -> SVector<f64, N> {
        SVector::from(self.right)
    }
}

/// A surface as the choice between readings sees it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Model {
    Plane { normal: Vector3<f64>, offset_m: f64 },
    Sphere { centre: Vector3<f64>, radius_m: f64 },
    Cylinder { foot: Vector3<f64>, axis: Vector3<f64>, radius_m: f64 },
}

impl Model {
    /// From the centre of a sphere or the axis of a cylinder to a point, and the radius.
    pub fn radial(&self, p: &Vector3<f64>) -> Option<(Vector3<f64>, f64)> {
        match self {
            Model::Plane { .. } => None,
            Model::Sphere { centre, radius_m } => Some((p - centre, *radius_m)),
            Model::Cylinder { foot, axis, radius_m } => {
                let d = p - foot;
                Some((d - axis * axis.dot(&d), *radius_m))
            }
        }
    }

    /// Signed distance of a point from the surface and the surface's normal there.
    pub fn distance(&self, p: &Vector3<f64>) -> (f64, Vector3<f64>) {
        match self {
            Model::Plane { normal, offset_m } => (normal.dot(p) - offset_m, *normal),
            Model::Sphere { centre, radius_m } => {
                let radial = p - centre;
                let length = radial.norm().max(1e-9);
                (length - radius_m, radial / length)
            }
            Model::Cylinder { foot, axis, radius_m } => {
                let d = p - foot;
                let radial = d - axis * axis.dot(&d);
                let length = radial.norm().max(1e-9);
                (length - radius_m, radial / length)
            }
        }
    }

    /// Error of a reading in standard deviations of its noise.
    pub fn error(&self, p: &Vector3<f64>, ray: &Vector3<f64>, sigma: f64) -> f64 {
        match self.radial(p) {
            Some((radial, radius_m)) => {
                // The radial's length divides the normal, so it need not be divided by.
                let length = radial.norm().max(1e-9);
                let incidence = radial.dot(ray).abs().max(LEAST_COSINE * length);
                (length - radius_m) * length / (sigma * incidence)
            }
            None => {
                let (distance, normal) = self.distance(p);
                distance / (sigma * normal.dot(ray).abs().max(LEAST_COSINE))
            }
        }
    }

    /// The radius of a sphere or a cylinder.
    pub fn radius_m(&self) -> Option<f64> {
        match self {
            Model::Plane { .. } => None,
            Model::Sphere { radius_m, .. } | Model::Cylinder { radius_m, .. } => Some(*radius_m),
        }
    }

    /// Number of parameters, the price of the model.
    pub fn parameters(&self) -> f64 {
        match self {
            Model::Plane { .. } => 3.0,
            Model::Sphere { .. } => 4.0,
            Model::Cylinder { .. } => 5.0,
        }
    }
}

/// A fitted surface of any kind.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Fitted {
    Plane(PlaneFit),
    Sphere {
        centre: Point3<f64>,
        radius_m: f64,
        covariance: Matrix4<f64>,
    },
    Cylinder {
        axis_point: Point3<f64>,
        axis: Unit<Vector3<f64>>,
        radius_m: f64,
        length_m: f64,
        covariance: Matrix5<f64>,
    },
    Other,
}
