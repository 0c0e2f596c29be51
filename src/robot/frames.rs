//! The border between the wire frame (x forward, y right, z down) and the core frame (x forward, y
//! left, z up).
//!
//! Both frames are right-handed and share x; one is the other turned by π about x. A rotation keeps
//! its roll and changes the sign of pitch and yaw, and a rotation about an axis keeps its angle when
//! the axis is carried over as a vector.

use nalgebra::{Isometry3, Point3, Quaternion, UnitQuaternion, Vector3};

/// A wire vector or point in the core frame. The map is its own inverse.
pub fn core_vector(wire: [f64; 3]) -> Vector3<f64> {
    Vector3::new(wire[0], -wire[1], -wire[2])
}

/// A wire position in the core frame.
pub fn core_point(wire: [f64; 3]) -> Point3<f64> {
    Point3::from(core_vector(wire))
}

/// The rotation of wire roll, pitch and yaw, applied in that order about the wire's fixed axes
/// (`Rz(yaw)·Ry(pitch)·Rx(roll)`, protocol 5.1), as a rotation of core vectors.
pub fn core_rotation(roll_pitch_yaw: [f64; 3]) -> UnitQuaternion<f64> {
    let [roll, pitch, yaw] = roll_pitch_yaw;
    UnitQuaternion::from_euler_angles(roll, -pitch, -yaw)
}

/// A wire pose (location, orientation) in the core frame.
pub fn core_pose(location: [f64; 3], roll_pitch_yaw: [f64; 3]) -> Isometry3<f64> {
    Isometry3::from_parts(core_vector(location).into(), core_rotation(roll_pitch_yaw))
}

/// The wire position of a core point.
pub fn wire_location(core: &Point3<f64>) -> [f64; 3] {
    [core.x, -core.y, -core.z]
}

/// The wire roll, pitch and yaw of a core rotation, each in (-π, π].
pub fn wire_orientation(core: &UnitQuaternion<f64>) -> [f64; 3] {
    let (roll, pitch, yaw) = core.euler_angles();
    [roll, -pitch, -yaw]
}

/// A core rotation in wire axes, or a wire rotation in core axes: the map is its own inverse.
pub(super) fn turned(rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(rotation.w, rotation.i, -rotation.j, -rotation.k))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn nose_up_on_the_wire_is_negative_pitch_in_the_core() {
        let nose = core_rotation([0.0, 0.3, 0.0]) * Vector3::x();
        assert!(nose.z > 0.29, "wire pitch + lifts the nose, and up is +z: {nose}");
    }

    #[test]
    fn clockwise_on_the_wire_turns_the_nose_right_in_the_core() {
        let nose = core_rotation([0.0, 0.0, 0.3]) * Vector3::x();
        assert!(nose.y < -0.29, "right is -y: {nose}");
    }

    proptest! {
        #[test]
        fn rotations_agree_with_the_matrices_of_the_wire(
            angles in prop::array::uniform3(-1.5..1.5f64), p in prop::array::uniform3(-3.0..3.0f64)
        ) {
            // Rz·Ry·Rx in the wire's own axes, then carried over, against the converted rotation.
            let wire = UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]);
            let moved = wire * Vector3::from(p);
            let expected = core_vector([moved.x, moved.y, moved.z]);
            let found = core_rotation(angles) * core_vector(p);
            prop_assert!((expected - found).norm() < 1e-12);
            prop_assert!((turned(&wire) * core_vector(p) - expected).norm() < 1e-12);
        }

        #[test]
        fn orientation_comes_back(angles in prop::array::uniform3(-1.5..1.5f64)) {
            let back = wire_orientation(&core_rotation(angles));
            for (a, b) in back.iter().zip(angles) {
                prop_assert!((a - b).abs() < 1e-9);
            }
        }
    }
}
