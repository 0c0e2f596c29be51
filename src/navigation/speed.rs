//! How fast is safe: free functions of plain numbers, each a bound of its own.

/// Distance in metres within which a robot at `speed_mps` stands, if it begins to brake at
/// `deceleration_mps2` after `latency_s`.
pub fn stopping_distance_m(speed_mps: f64, latency_s: f64, deceleration_mps2: f64) -> f64 {
    let speed_mps = speed_mps.abs();
    speed_mps * latency_s + speed_mps * speed_mps / (2.0 * deceleration_mps2)
}

/// The highest speed in m/s from which a robot stands within `distance_m`: the inverse of
/// [`stopping_distance_m`]. Zero for no distance.
pub fn speed_to_stop_within(distance_m: f64, latency_s: f64, deceleration_mps2: f64) -> f64 {
    if distance_m <= 0.0 {
        return 0.0;
    }
    let lost_mps = deceleration_mps2 * latency_s;
    (lost_mps * lost_mps + 2.0 * deceleration_mps2 * distance_m).sqrt() - lost_mps
}

/// Speed in m/s for the room about the robot: full speed from `comfortable_m` on, falling linearly
/// to `slow_mps` where the robot barely fits (`needed_m`).
pub fn speed_for_room(
    room_m: f64,
    needed_m: f64,
    comfortable_m: f64,
    slow_mps: f64,
    full_mps: f64,
) -> f64 {
    if comfortable_m <= needed_m {
        return slow_mps.min(full_mps);
    }
    let share = ((room_m - needed_m) / (comfortable_m - needed_m)).clamp(0.0, 1.0);
    let slow_mps = slow_mps.min(full_mps);
    slow_mps + share * (full_mps - slow_mps)
}

/// Speed in m/s for a curvature in 1/m at which the turn rate stays within `turn_limit_rps`.
pub fn speed_for_curvature(curvature_per_m: f64, turn_limit_rps: f64, full_mps: f64) -> f64 {
    let curvature = curvature_per_m.abs();
    if curvature * full_mps <= turn_limit_rps { full_mps } else { turn_limit_rps / curvature }
}

/// Speed in m/s for a slope (rise per metre, sign ignored): full on the level, falling linearly to
/// `slow_mps` at the steepest slope that may be driven.
pub fn speed_for_slope(slope: f64, steepest: f64, slow_mps: f64, full_mps: f64) -> f64 {
    let slow_mps = slow_mps.min(full_mps);
    if steepest <= 0.0 {
        return slow_mps;
    }
    full_mps - (slope.abs() / steepest).min(1.0) * (full_mps - slow_mps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_speed_for_a_distance_is_the_inverse_of_the_stopping_distance(
            distance in 0.0_f64..30.0, latency in 0.0_f64..2.0, braking in 0.05_f64..5.0,
        ) {
            let speed = speed_to_stop_within(distance, latency, braking);
            prop_assert!((stopping_distance_m(speed, latency, braking) - distance).abs() < 1e-9);
        }

        #[test]
        fn no_rule_exceeds_full_speed_or_turns_negative(
            room in -1.0_f64..3.0, curvature in -50.0_f64..50.0, slope in -2.0_f64..2.0,
            slow in 0.0_f64..0.5, full in 0.0_f64..2.0,
        ) {
            for speed in [
                speed_for_room(room, 0.25, 0.6, slow, full),
                speed_for_curvature(curvature, 0.8, full),
                speed_for_slope(slope, 0.4, slow, full),
            ] {
                prop_assert!(speed >= 0.0 && speed <= full + 1e-12);
            }
        }
    }
}
