//! The border between this crate's `nalgebra` types and the `glam` types of the physics libraries.
//!
//! Nothing outside `sim` sees `glam`.

use nalgebra::{Isometry3, Point3, Vector3};
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_acts_alike_on_both_sides() {
        let there = Isometry3::new(Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.3, -0.2, 0.9));
        let p = Point3::new(0.4, 0.5, -0.6);
        let moved = pose(&there).transform_point(point(&p));
        assert!((from_vector(moved) - (there * p).coords).norm() < 1e-12);
    }
}
