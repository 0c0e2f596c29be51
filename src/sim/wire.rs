//! From the core's frames and doubles to what a server prints.
//!
//! Servers truncate most numbers and round some (protocol document 1.7). Here is the one place where
//! that happens; the writer of lines only formats.

use crate::protocol::WirePose;
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// Unreal angle units in a turn.
const UNITS_PER_TURN: f64 = 65_536.0;

/// What a number may fall short of its last decimal before it loses it: less than any server shows,
/// more than doubles err.
const GRID_SLACK: f64 = 1e-6;

/// A value this small is zero without a sign; a server prints `-0.0000` for larger ones only.
const NOTHING: f64 = 1e-9;

/// Cuts a value towards zero at `decimals`.
pub(crate) fn truncate(value: f64, decimals: i32) -> f64 {
    if value.abs() < NOTHING {
        return 0.0;
    }
    let scale = 10_f64.powi(decimals);
    (value * scale + GRID_SLACK.copysign(value)).trunc() / scale
}

/// Rounds a value to `decimals`, halves away from zero.
pub(crate) fn round(value: f64, decimals: i32) -> f64 {
    if value.abs() < NOTHING {
        return 0.0;
    }
    let scale = 10_f64.powi(decimals);
    (value * scale).round() / scale
}

/// Whole Unreal units of an angle, cut towards zero.
pub(crate) fn angle_units(angle_rad: f64) -> f64 {
    let units = angle_rad * (UNITS_PER_TURN / TAU);
    (units + GRID_SLACK.copysign(units)).trunc()
}

/// The angle of a number of Unreal units.
pub(crate) fn units_rad(units: f64) -> f64 {
    units * (TAU / UNITS_PER_TURN)
}

/// An angle as the converter prints it: cut to 1/65536 of a turn, then to 4 decimals.
pub(crate) fn angle(angle_rad: f64) -> f64 {
    truncate(units_rad(angle_units(angle_rad)), 4)
}

/// An angle as the engine keeps it, in whole units, in [0, 2π).
pub(crate) fn full_turn_units(angle_rad: f64) -> f64 {
    full_turn(units_rad(angle_units(angle_rad)))
}

/// A pose as the engine keeps it: its angles are whole units. A robot that rests on level ground has
/// none at all, however its wheels press into the floor.
pub(crate) fn engine_pose(core: &Isometry3<f64>) -> Isometry3<f64> {
    let exact = pose(core);
    core_pose(&WirePose {
        orientation: exact.orientation.map(|angle| units_rad(angle_units(angle))),
        ..exact
    })
}

/// An angle in [0, 2π).
pub(crate) fn full_turn(angle_rad: f64) -> f64 {
    let wrapped = angle_rad.rem_euclid(TAU);
    // A negative angle too small to be told from a whole turn wraps to that turn.
    if wrapped < TAU { wrapped } else { 0.0 }
}

/// A point or vector in wire axes: y right, z down.
pub(crate) fn vector(core: &Vector3<f64>) -> [f64; 3] {
    [core.x, -core.y, -core.z]
}

/// A point in wire axes.
pub(crate) fn point(core: &Point3<f64>) -> [f64; 3] {
    vector(&core.coords)
}

/// A wire vector in core axes.
pub(crate) fn core_vector(wire: [f64; 3]) -> Vector3<f64> {
    Vector3::new(wire[0], -wire[1], -wire[2])
}

/// Roll, pitch and yaw as the wire counts them: nose up and clockwise are positive.
pub(crate) fn orientation(rotation: &UnitQuaternion<f64>) -> [f64; 3] {
    let (roll, pitch, yaw) = rotation.euler_angles();
    [roll, -pitch, -yaw]
}

/// A pose in wire axes, not yet on any grid of decimals.
pub(crate) fn pose(core: &Isometry3<f64>) -> WirePose {
    WirePose {
        location: vector(&core.translation.vector),
        orientation: orientation(&core.rotation),
    }
}

/// The core pose of a wire pose.
pub(crate) fn core_pose(wire: &WirePose) -> Isometry3<f64> {
    let [roll, pitch, yaw] = wire.orientation;
    Isometry3::from_parts(
        core_vector(wire.location).into(),
        UnitQuaternion::from_euler_angles(roll, -pitch, -yaw),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn numbers_are_cut_as_servers_cut_them() {
        assert_eq!(truncate(4.56789, 4), 4.5678);
        assert_eq!(truncate(-4.56789, 2), -4.56);
        assert_eq!(truncate(0.145, 4), 0.145);
        assert_eq!(format!("{:.4} {:.4}", truncate(-0.0, 4), truncate(-3e-5, 4)), "0.0000 -0.0000");
        assert_eq!(format!("{} {}", angle(PI), angle(FRAC_PI_2)), "3.1415 1.5707");
        assert_eq!(angle(1_f64.to_radians()), 0.0174);
        assert_eq!(angle(0.01), 0.0099);
        assert_eq!(round(5085.8188, 2), 5085.82);
    }

    #[test]
    fn angles_wrap_into_one_turn() {
        assert_eq!(full_turn(-1e-20), 0.0);
        assert!((full_turn(-0.01) - 6.273).abs() < 1e-3);
    }

    #[test]
    fn the_engine_keeps_whole_units_of_angle_and_exact_places() {
        let unit = TAU / 65_536.0;
        let tilted = |roll: f64, yaw: f64| {
            let turned = UnitQuaternion::from_euler_angles(roll, 0.0, yaw);
            Isometry3::from_parts(Vector3::new(1.0, 2.0, 3.0).into(), turned)
        };
        assert_eq!(engine_pose(&tilted(0.9 * unit, 0.0)), tilted(0.0, 0.0));
        let kept = engine_pose(&tilted(0.0, 2.5 * unit));
        assert!(kept.rotation.angle_to(&tilted(0.0, 2.0 * unit).rotation) < 1e-12);
        assert_eq!(kept.translation.vector, Vector3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn yaw_is_clockwise_and_pitch_nose_up_on_the_wire() {
        let left = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5);
        assert!((orientation(&left)[2] + 0.5).abs() < 1e-12);
        // In the core a positive pitch lowers the nose.
        let nose_down = UnitQuaternion::from_euler_angles(0.0, 0.3, 0.0);
        assert!((orientation(&nose_down)[1] + 0.3).abs() < 1e-12);
    }

    #[test]
    fn poses_survive_the_way_to_the_wire_and_back() {
        let there = Isometry3::new(Vector3::new(1.0, -2.0, 0.5), Vector3::new(0.2, -0.4, 1.3));
        let back = core_pose(&pose(&there));
        assert!((back.inv_mul(&there)).translation.vector.norm() < 1e-12);
        assert!(back.rotation.angle_to(&there.rotation) < 1e-12);
    }
}
