//! What is not known of the sensor's place on the robot: a server rounds it. Scans tell how the sensor moved,
//! and a turn moves the robot by more or less than that.

use nalgebra::{Matrix3, Matrix6, Rotation3};

/// Covariance that the motion of the robot has beside that of the sensor, as a perturbation `[δt; δr]`, where the
/// sensor's place on the robot is known to `sigma_m` in each axis: its error `δ` puts a robot that was turned
/// `before` and is turned `after` off by `(after - before) δ`.
pub(super) fn lever_covariance(
    before: &Rotation3<f64>,
    after: &Rotation3<f64>,
    sigma_m: f64,
) -> Matrix6<f64> {
    let turned: Matrix3<f64> = after.matrix() - before.matrix();
    let mut covariance = Matrix6::zeros();
    let of_place = turned * turned.transpose() * (sigma_m * sigma_m);
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&of_place);
    covariance
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use std::f64::consts::PI;

    #[test]
    fn a_turn_moves_the_robot_by_what_the_place_of_the_sensor_is_off() {
        let before = Rotation3::from_euler_angles(0.1, 0.2, 0.3);
        assert_eq!(lever_covariance(&before, &before, 0.003), Matrix6::zeros());
        // About the vertical by half a turn: twice the error, and the height as it was.
        let about = Rotation3::new(Vector3::z() * PI);
        let found = lever_covariance(&Rotation3::identity(), &about, 0.003);
        for (i, sigma_m) in [0.006, 0.006, 0.0, 0.0, 0.0, 0.0].into_iter().enumerate() {
            assert!((found[(i, i)].sqrt() - sigma_m).abs() < 1e-9, "{found}");
        }
    }
}
