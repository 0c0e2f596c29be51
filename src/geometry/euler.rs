//! Poses as six numbers, the way the mapping paper prints them, and the Jacobians of its ⊕.
//!
//! The estimators keep poses as rigid motions and perturb them by rotation vectors; this form is
//! for reading tables, writing tables, and holding the Jacobians of the paper against ours.

use super::lie::skew;
use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A pose `[x, y, z, φ, θ, ψ]` with rotation `Rz(φ) Ry(θ) Rx(ψ)`.
///
/// The mapping paper calls the angles roll, pitch and yaw "around the global z, y and x axis": φ is
/// the heading and ψ what is called roll elsewhere.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EulerPose {
    /// Position along x in metres.
    pub x: f64,
    /// Position along y in metres.
    pub y: f64,
    /// Position along z in metres.
    pub z: f64,
    /// Rotation about z (heading) in radians.
    pub phi: f64,
    /// Rotation about the turned y axis in radians, within ±π/2.
    pub theta: f64,
    /// Rotation about the twice turned x axis in radians.
    pub psi: f64,
}

impl EulerPose {
    /// The six numbers of a rigid motion.
    pub fn from_isometry(target_from_source: &Isometry3<f64>) -> Self {
        let (psi, theta, phi) = target_from_source.rotation.euler_angles();
        let t = target_from_source.translation.vector;
        Self { x: t.x, y: t.y, z: t.z, phi, theta, psi }
    }

    /// The rigid motion of the six numbers.
    pub fn to_isometry(self) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(self.x, self.y, self.z),
            UnitQuaternion::from_euler_angles(self.psi, self.theta, self.phi),
        )
    }

    /// The composition `self ⊕ other`: the location of the product of both homogeneous matrices.
    #[must_use]
    pub fn compose(self, other: Self) -> Self {
        Self::from_isometry(&(self.to_isometry() * other.to_isometry()))
    }

    /// The inverse location `⊖ self`.
    #[must_use]
    pub fn inverse(self) -> Self {
        Self::from_isometry(&self.to_isometry().inverse())
    }

    /// The map from rates of (φ, θ, ψ) to the angular velocity in the outer frame; columns are the
    /// axes about which the three angles turn. Singular at θ = ±π/2.
    fn rates_to_rotation(self) -> Matrix3<f64> {
        let (sin_phi, cos_phi) = self.phi.sin_cos();
        let (sin_theta, cos_theta) = self.theta.sin_cos();
        Matrix3::from_columns(&[
            Vector3::z(),
            Vector3::new(-sin_phi, cos_phi, 0.0),
            Vector3::new(cos_phi * cos_theta, sin_phi * cos_theta, -sin_theta),
        ])
    }

    /// Inverse of [`rates_to_rotation`](Self::rates_to_rotation).
    fn rotation_to_rates(self) -> Matrix3<f64> {
        let (sin_phi, cos_phi) = self.phi.sin_cos();
        let (tan_theta, cos_theta) = (self.theta.tan(), self.theta.cos());
        Matrix3::new(
            cos_phi * tan_theta,
            sin_phi * tan_theta,
            1.0,
            -sin_phi,
            cos_phi,
            0.0,
            cos_phi / cos_theta,
            sin_phi / cos_theta,
            0.0,
        )
    }

    /// `J1⊕`: the derivative of `self ⊕ other` with respect to `self`, both as six numbers.
    ///
    /// Infinite where the composition has θ = ±π/2: there the six numbers are singular, not the
    /// pose.
    pub fn j1(self, other: Self) -> Matrix6<f64> {
        let composed = self.compose(other);
        let lever = Vector3::new(composed.x - self.x, composed.y - self.y, composed.z - self.z);
        let turn = self.rates_to_rotation();
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-skew(&lever) * turn));
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&(composed.rotation_to_rates() * turn));
        jacobian
    }

    /// `J2⊕`: the derivative of `self ⊕ other` with respect to `other`, both as six numbers.
    pub fn j2(self, other: Self) -> Matrix6<f64> {
        let composed = self.compose(other);
        let rotation = self.to_isometry().rotation.to_rotation_matrix().into_inner();
        let turn = composed.rotation_to_rates() * rotation * other.rates_to_rotation();
        let mut jacobian = Matrix6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        jacobian
    }

    /// The derivative of the perturbation `[translation; rotation vector]` in the outer frame with
    /// respect to the six numbers: it carries Jacobians and covariances between both forms.
    pub fn perturbation_from_numbers(self) -> Matrix6<f64> {
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rates_to_rotation());
        jacobian
    }

    /// The six numbers in the paper's order.
    pub fn numbers(self) -> [f64; 6] {
        [self.x, self.y, self.z, self.phi, self.theta, self.psi]
    }

    /// The pose of six numbers in the paper's order.
    pub fn from_numbers([x, y, z, phi, theta, psi]: [f64; 6]) -> Self {
        Self { x, y, z, phi, theta, psi }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::wrap_pi;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = EulerPose> {
        (prop::array::uniform3(-5.0..5.0f64), -3.0..3.0f64, -1.3..1.3f64, -3.0..3.0f64)
            .prop_map(|([x, y, z], phi, theta, psi)| EulerPose { x, y, z, phi, theta, psi })
    }

    fn difference(a: EulerPose, b: EulerPose, step: f64) -> [f64; 6] {
        let (a, b) = (a.numbers(), b.numbers());
        std::array::from_fn(|i| {
            let gap = a[i] - b[i];
            (if i < 3 { gap } else { wrap_pi(gap) }) / (2.0 * step)
        })
    }

    #[test]
    fn phi_is_the_heading() {
        let ahead = EulerPose { phi: std::f64::consts::FRAC_PI_2, ..EulerPose::default() };
        let moved = ahead.to_isometry() * nalgebra::Point3::new(1.0, 0.0, 0.0);
        assert!((moved.y - 1.0).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn inverse_undoes_composition(a in pose(), b in pose()) {
            let back = a.inverse().compose(a.compose(b));
            for (left, right) in back.numbers().into_iter().zip(b.numbers()) {
                prop_assert!((left - right).abs() < 1e-9);
            }
        }

        #[test]
        fn jacobians_of_composition_match_central_differences(a in pose(), b in pose()) {
            let composed = a.compose(b);
            prop_assume!(composed.theta.abs() < 1.4);
            let step = 1e-6;
            let (j1, j2) = (a.j1(b), a.j2(b));
            for axis in 0..6 {
                let shifted = |pose: EulerPose, by: f64| {
                    let mut numbers = pose.numbers();
                    numbers[axis] += by;
                    EulerPose::from_numbers(numbers)
                };
                let first = difference(shifted(a, step).compose(b), shifted(a, -step).compose(b), step);
                let second = difference(a.compose(shifted(b, step)), a.compose(shifted(b, -step)), step);
                for row in 0..6 {
                    let scale = 1.0 / composed.theta.cos();
                    prop_assert!((j1[(row, axis)] - first[row]).abs() < 1e-6 * scale * scale);
                    prop_assert!((j2[(row, axis)] - second[row]).abs() < 1e-6 * scale * scale);
                }
            }
        }
    }
}
