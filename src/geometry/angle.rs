use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// The angle equivalent to `angle_rad` in (-π, π].
pub fn wrap_pi(angle_rad: f64) -> f64 {
    let wrapped = angle_rad.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// An inclusive range of angles in radians, `min_rad <= max_rad`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AngleSpan {
    /// Lower bound, inclusive.
    pub min_rad: f64,
    /// Upper bound, inclusive.
    pub max_rad: f64,
}

impl AngleSpan {
    /// The span between two angles given in either order.
    pub fn new(a_rad: f64, b_rad: f64) -> Self {
        Self { min_rad: a_rad.min(b_rad), max_rad: a_rad.max(b_rad) }
    }

    /// Whether `angle_rad` lies within the bounds.
    pub fn contains(&self, angle_rad: f64) -> bool {
        (self.min_rad..=self.max_rad).contains(&angle_rad)
    }

    /// The angle of the span that is nearest to `angle_rad`.
    pub fn clamp(&self, angle_rad: f64) -> f64 {
        angle_rad.clamp(self.min_rad, self.max_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrap_is_half_open_at_minus_pi() {
        assert_eq!(wrap_pi(PI), PI);
        assert_eq!(wrap_pi(-PI), PI);
        assert!((wrap_pi(3.0 * TAU + 0.25) - 0.25).abs() < 1e-12);
        assert!((wrap_pi(-0.25) + 0.25).abs() < 1e-15);
    }
}
