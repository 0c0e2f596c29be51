//! Wheel odometry out of tachometer readings, for robots that carry no odometry sensor.

use super::drive::DriveTrain;
use super::readings::OdometryReading;
use crate::protocol::message::sen::Tachometer;
use nalgebra::{Isometry2, Vector2};
use serde::{Deserialize, Serialize};

/// Dead reckoning from the turns of the driven wheels.
///
/// The UDK server's robots have a tachometer where older ones had odometry (protocol reference, sections
/// 3.5 and 5.3): wheel angles since the reset, in joint order, which is right before left on either
/// axle. As with the odometry sensor, slip is not in it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WheelCount {
    /// Mean angle of the right and the left wheels at the last reading, in radians.
    last_rad: Option<[f64; 2]>,
    odom_from_robot: Isometry2<f64>,
    retired: bool,
}

impl WheelCount {
    /// Counts no longer: the robot has an odometry sensor of its own.
    pub fn retire(&mut self) {
        self.retired = true;
    }

    /// The pose since the first reading; `None` for a reading without angles, or after retirement.
    pub fn tachometer(
        &mut self,
        message: &Tachometer,
        drive: &DriveTrain,
    ) -> Option<OdometryReading> {
        let angles = &message.positions_rad;
        if self.retired || angles.len() < 2 || !angles.len().is_multiple_of(2) {
            return None;
        }
        let mean = |side: usize| {
            let wheels = angles.iter().skip(side).step_by(2);
            wheels.sum::<f64>() * 2.0 / angles.len() as f64
        };
        let now_rad = [mean(0), mean(1)];
        let before_rad = self.last_rad.replace(now_rad).unwrap_or(now_rad);
        let [right_m, left_m] = [0, 1].map(|side| {
            let turned_rad: f64 = now_rad[side] - before_rad[side];
            turned_rad * drive.wheel_radius_m
        });
        let turn_rad = (right_m - left_m) / drive.wheel_separation_m;
        let way_m = 0.5 * (right_m + left_m);
        // The chord of the arc, seen from half way through the turn.
        let (sin, cos) = (0.5 * turn_rad).sin_cos();
        self.odom_from_robot *= Isometry2::new(Vector2::new(way_m * cos, way_m * sin), turn_rad);
        Some(OdometryReading { odom_from_robot: self.odom_from_robot, stamp: message.time })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DRIVE: DriveTrain = DriveTrain {
        wheel_radius_m: 0.1,
        wheel_separation_m: 0.4,
        wheel_base_m: 0.25,
        max_spin_rps: 1.3,
        turn_share: 1.0,
    };

    fn reading(right_rad: f64, left_rad: f64) -> Tachometer {
        let positions_rad = vec![right_rad, left_rad, right_rad, left_rad];
        Tachometer { positions_rad, ..Tachometer::default() }
    }

    #[test]
    fn a_quarter_circle_to_the_left_is_counted_as_one() {
        let mut count = WheelCount::default();
        count.tachometer(&reading(3.0, -1.0), &DRIVE).unwrap();
        // Radius 1 m to the middle: the outer wheels roll 1.2 m, the inner ones 0.8 m, times π/2.
        let quarter = std::f64::consts::FRAC_PI_2;
        let mut pose = Isometry2::identity();
        for step in 1..=100 {
            let share = f64::from(step) / 100.0;
            let now = reading(3.0 + 12.0 * quarter * share, -1.0 + 8.0 * quarter * share);
            pose = count.tachometer(&now, &DRIVE).unwrap().odom_from_robot;
        }
        assert!((pose.translation.vector - Vector2::new(1.0, 1.0)).norm() < 1e-3);
        assert!((pose.rotation.angle() - quarter).abs() < 1e-9);
    }

    #[test]
    fn a_robot_with_odometry_does_not_count() {
        let mut count = WheelCount::default();
        count.retire();
        assert_eq!(count.tachometer(&reading(1.0, 1.0), &DRIVE), None);
    }

    #[test]
    fn a_reading_without_angles_is_passed_over() {
        assert_eq!(WheelCount::default().tachometer(&Tachometer::default(), &DRIVE), None);
    }
}
