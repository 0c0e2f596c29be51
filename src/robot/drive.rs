use serde::{Deserialize, Serialize};

/// A demanded motion of the robot's body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodySpeed {
    /// Forward speed in metres per second.
    pub linear_mps: f64,
    /// Turning speed in radians per second, left positive.
    pub angular_rps: f64,
}

/// Spin of the wheels of either side in radians per second, forward positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WheelSpin {
    /// Left side.
    pub left_rps: f64,
    /// Right side.
    pub right_rps: f64,
}

/// Wheels of a skid-steered robot and what they can do.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DriveTrain {
    /// Radius of the wheels in metres, above 0.
    pub wheel_radius_m: f64,
    /// Distance between left and right wheels in metres, above 0.
    pub wheel_separation_m: f64,
    /// Distance between front and rear wheels in metres.
    pub wheel_base_m: f64,
    /// Greatest wheel spin in radians per second, above 0.
    pub max_spin_rps: f64,
    /// Turning speed reached, as a share of what rolling wheels would give, in (0, 1]. Skid steering
    /// slips, so a demanded turn is commanded this much faster.
    pub turn_share: f64,
}

impl DriveTrain {
    /// Greatest forward speed in metres per second.
    pub fn max_linear_mps(&self) -> f64 {
        self.wheel_radius_m * self.max_spin_rps
    }

    /// Greatest turning speed on the spot in radians per second.
    pub fn max_angular_rps(&self) -> f64 {
        2.0 * self.max_linear_mps() * self.turn_share / self.wheel_separation_m
    }

    /// Wheel spin for a demanded motion.
    ///
    /// Where the faster side would exceed its limit both sides are slowed by the same factor, which
    /// keeps the curvature: a robot that cuts a corner because one side saturated leaves its path.
    /// A demand that is not finite stops the wheels.
    pub fn spin(&self, demand: BodySpeed) -> WheelSpin {
        let turn_mps = 0.5 * demand.angular_rps * self.wheel_separation_m / self.turn_share;
        let left = (demand.linear_mps - turn_mps) / self.wheel_radius_m;
        let right = (demand.linear_mps + turn_mps) / self.wheel_radius_m;
        if !(left.is_finite() && right.is_finite()) {
            return WheelSpin::default();
        }
        let excess = left.abs().max(right.abs()) / self.max_spin_rps;
        let scale = if excess > 1.0 { 1.0 / excess } else { 1.0 };
        WheelSpin { left_rps: left * scale, right_rps: right * scale }
    }

    /// The motion that rolling wheels of this spin give, slip by `turn_share` included.
    pub fn body_speed(&self, spin: WheelSpin) -> BodySpeed {
        let (left, right) =
            (spin.left_rps * self.wheel_radius_m, spin.right_rps * self.wheel_radius_m);
        BodySpeed {
            linear_mps: 0.5 * (left + right),
            angular_rps: (right - left) * self.turn_share / self.wheel_separation_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn p2at() -> DriveTrain {
        DriveTrain {
            wheel_radius_m: 0.13,
            wheel_separation_m: 0.4712,
            wheel_base_m: 0.2884,
            max_spin_rps: 5.385,
            turn_share: 1.0,
        }
    }

    #[test]
    fn a_p2at_tops_out_at_seven_tenths_of_a_metre_per_second() {
        assert!((p2at().max_linear_mps() - 0.70).abs() < 0.001);
        let spin = p2at().spin(BodySpeed { linear_mps: 5.0, angular_rps: 0.0 });
        assert!((spin.left_rps - 5.385).abs() < 1e-12 && spin.left_rps == spin.right_rps);
    }

    #[test]
    fn turning_left_spins_the_right_side_faster() {
        let spin = p2at().spin(BodySpeed { linear_mps: 0.0, angular_rps: 0.5 });
        assert!(spin.right_rps > 0.0 && spin.left_rps == -spin.right_rps);
    }

    #[test]
    fn a_demand_that_is_no_number_stops_the_wheels() {
        let spin = p2at().spin(BodySpeed { linear_mps: f64::NAN, angular_rps: 0.5 });
        assert_eq!(spin, WheelSpin::default());
    }

    proptest! {
        #[test]
        fn saturation_keeps_the_curvature(v in -3.0..3.0f64, w in -6.0..6.0f64, share in 0.2..1.0f64) {
            let train = DriveTrain { turn_share: share, ..p2at() };
            let spin = train.spin(BodySpeed { linear_mps: v, angular_rps: w });
            prop_assert!(spin.left_rps.abs() <= 5.385 + 1e-9 && spin.right_rps.abs() <= 5.385 + 1e-9);
            let got = train.body_speed(spin);
            prop_assert!((got.linear_mps * w - got.angular_rps * v).abs() < 1e-9);
            prop_assert!(got.linear_mps * v >= 0.0 && got.angular_rps * w >= 0.0);
        }
    }
}
