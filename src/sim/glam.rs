//! The border between this crate's `nalgebra` types and the `glam` types of the physics libraries.
//!
//! Nothing outside `sim` sees `glam`.

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::math::{Pose, Rotation, Vector};

pub(crate) fn vector(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

pub(crate) fn from_vector(v: Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

pub(crate) fn point(p: &Point3<f64>) -> Vector {
    Vector::new(p.x, p.y, p.z)
}

pub(crate) fn pose(isometry: &Isometry3<f64>) -> Pose {
    let q = isometry.rotation.quaternion();
    Pose::from_parts(vector(&isometry.translation.vector), Rotation::from_xyzw(q.i, q.j, q.k, q.w))
}

/// The pose as an isometry; the quaternion is normalised, because the solver lets it drift.
pub(crate) fn from_pose(pose: &Pose) -> Isometry3<f64> {
    let q = pose.rotation;
    Isometry3::from_parts(
        Translation3::from(from_vector(pose.translation)),
        UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_survives_the_round_trip_and_acts_alike() {
        let there = Isometry3::new(Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.3, -0.2, 0.9));
        let p = Point3::new(0.4, 0.5, -0.6);
        let moved = pose(&there).transform_point(point(&p));
        assert!((from_vector(moved) - (there * p).coords).norm() < 1e-12);
        let back = from_pose(&pose(&there));
        assert!((back.inv_mul(&there)).translation.vector.norm() < 1e-12);
    }
}
