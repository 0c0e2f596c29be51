//! How a joint follows its set-point: the laws of the two engines, in closed form.

use crate::robot::Demand;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Width of the proportional gap of a UT2004 hinge: 364 of 65536 parts of a turn (protocol 6.3).
pub const HINGE_GAP_RAD: f64 = 364.0 / 65536.0 * 2.0 * PI;

/// Where a joint is and how fast it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ServoState {
    /// Joint angle in radians.
    pub angle_rad: f64,
    /// Joint rate in radians per second.
    pub rate_rad_s: f64,
}

impl ServoState {
    /// A joint at rest.
    pub fn at_rest(angle_rad: f64) -> Self {
        Self { angle_rad, rate_rad_s: 0.0 }
    }
}

/// The law by which a joint approaches a demanded angle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ServoLaw {
    /// UT2004: constant speed, then proportional to the remaining angle inside a gap, so that the
    /// rest decays with the time constant `gap / speed`.
    Hinge {
        /// Speed outside the gap, in radians per second, above 0.
        speed_rad_s: f64,
        /// Half-width of the proportional zone around the target, in radians, above 0.
        gap_rad: f64,
    },
    /// UDK: a damped spring pulls the joint to its target, without a speed limit.
    Spring {
        /// Undamped angular frequency in radians per second, above 0.
        frequency_rad_s: f64,
        /// Damping ratio, above 0; 1 is critical.
        damping: f64,
    },
}

impl ServoLaw {
    /// The UT2004 law of a link with the given maximum speed.
    pub fn hinge(speed_rad_s: f64) -> Self {
        Self::Hinge { speed_rad_s, gap_rad: HINGE_GAP_RAD }
    }

    /// The state `dt_s` seconds after `state`, the demand having been in force all the while.
    ///
    /// Exact for any `dt_s >= 0`: steps compose. A spring has no rate order; it stands still under
    /// [`Demand::Rate`], as a server that ignores the order would leave it.
    pub fn advance(&self, state: ServoState, demand: Demand, dt_s: f64) -> ServoState {
        match (*self, demand) {
            (Self::Hinge { speed_rad_s, gap_rad }, Demand::Angle(target_rad)) => {
                hinge_to(state, target_rad, dt_s, speed_rad_s, gap_rad)
            }
            (Self::Hinge { speed_rad_s, .. }, Demand::Rate(rate_rad_s)) => {
                let rate_rad_s = rate_rad_s.clamp(-speed_rad_s, speed_rad_s);
                ServoState { angle_rad: state.angle_rad + rate_rad_s * dt_s, rate_rad_s }
            }
            (Self::Spring { frequency_rad_s, damping }, Demand::Angle(target_rad)) => {
                spring_to(state, target_rad, dt_s, frequency_rad_s, damping)
            }
            (Self::Spring { .. }, Demand::Rate(_)) => ServoState::at_rest(state.angle_rad),
        }
    }

    /// Seconds after which a joint that starts at rest `error_rad` away from its target is, and
    /// stays, within `tolerance_rad` of it.
    pub fn settle_s(&self, error_rad: f64, tolerance_rad: f64) -> f64 {
        let error = error_rad.abs();
        if error <= tolerance_rad {
            return 0.0;
        }
        match *self {
            Self::Hinge { speed_rad_s, gap_rad } => {
                let slew = (error - gap_rad.max(tolerance_rad)).max(0.0) / speed_rad_s;
                let creep = (error.min(gap_rad) / tolerance_rad).ln().max(0.0);
                slew + creep * gap_rad / speed_rad_s
            }
            Self::Spring { frequency_rad_s, damping } => {
                spring_settle_s(error, tolerance_rad, frequency_rad_s, damping)
            }
        }
    }

    /// Seconds a hinge slews at full speed before it enters its gap; 0 for a spring.
    pub fn slew_s(&self, error_rad: f64) -> f64 {
        match *self {
            Self::Hinge { speed_rad_s, gap_rad } => {
                (error_rad.abs() - gap_rad).max(0.0) / speed_rad_s
            }
            Self::Spring { .. } => 0.0,
        }
    }

    /// The same law a little slower than found, to compute waiting times from: a fit is good to a few
    /// percent, a proof must not be.
    #[must_use]
    pub fn derated(self) -> Self {
        match self {
            Self::Hinge { speed_rad_s, gap_rad } => {
                Self::Hinge { speed_rad_s: 0.93 * speed_rad_s, gap_rad: 1.03 * gap_rad }
            }
            Self::Spring { frequency_rad_s, damping } => {
                // Damping away from critical on either side makes a spring settle later.
                let damping = if damping < 1.0 { 0.9 * damping } else { 1.1 * damping };
                Self::Spring { frequency_rad_s: 0.9 * frequency_rad_s, damping }
            }
        }
    }

    /// The set-point that brings a joint from `state` to `wanted_rad` within `dt_s`; infinite, with the
    /// sign of the way, if none does.
    pub fn set_point_for(&self, state: ServoState, wanted_rad: f64, dt_s: f64) -> f64 {
        match *self {
            Self::Hinge { .. } => {
                state.angle_rad + self.lead_rad(wanted_rad - state.angle_rad, dt_s)
            }
            Self::Spring { .. } => {
                // The spring is linear: where it coasts to, and what a set-point adds to that.
                let coast = self.advance(state, Demand::Angle(state.angle_rad), dt_s).angle_rad;
                state.angle_rad + self.lead_rad(wanted_rad - coast, dt_s)
            }
        }
    }

    /// How far ahead of a resting joint the set-point must lie for the joint to move `travel_rad`
    /// within `dt_s`; infinite if no set-point moves it that far.
    pub fn lead_rad(&self, travel_rad: f64, dt_s: f64) -> f64 {
        let travel = travel_rad.abs();
        let lead = match *self {
            Self::Hinge { speed_rad_s, gap_rad } => {
                let reach = speed_rad_s * dt_s;
                let share = 1.0 - (-reach / gap_rad).exp();
                if travel > reach {
                    f64::INFINITY
                } else if travel <= gap_rad * share {
                    travel / share
                } else {
                    // Slews for the first part of the time and decays for the rest: the travel grows
                    // with the lead, so a bisection finds it between the two closed forms.
                    bisect(gap_rad, gap_rad + reach, |lead| {
                        let end = self.advance(ServoState::default(), Demand::Angle(lead), dt_s);
                        end.angle_rad >= travel
                    })
                }
            }
            Self::Spring { .. } => {
                let unit = self.advance(ServoState::default(), Demand::Angle(1.0), dt_s);
                if unit.angle_rad > 1e-9 { travel / unit.angle_rad } else { f64::INFINITY }
            }
        };
        lead.copysign(travel_rad)
    }
}

fn hinge_to(
    state: ServoState,
    target_rad: f64,
    dt_s: f64,
    speed_rad_s: f64,
    gap_rad: f64,
) -> ServoState {
    let error = target_rad - state.angle_rad;
    let slew_s = ((error.abs() - gap_rad).max(0.0) / speed_rad_s).min(dt_s);
    let after_slew = error.abs() - speed_rad_s * slew_s;
    let rest = after_slew * (-(dt_s - slew_s) * speed_rad_s / gap_rad).exp();
    let rate = speed_rad_s * (rest / gap_rad).min(1.0);
    ServoState {
        angle_rad: target_rad - rest.copysign(error),
        rate_rad_s: if rest > 0.0 { rate.copysign(error) } else { 0.0 },
    }
}

fn spring_to(
    state: ServoState,
    target_rad: f64,
    dt_s: f64,
    frequency_rad_s: f64,
    damping: f64,
) -> ServoState {
    let e0 = state.angle_rad - target_rad;
    let v0 = state.rate_rad_s;
    let w = frequency_rad_s;
    let decay = damping * w;
    // Inside this band around critical damping the two other forms divide by almost nothing.
    const CRITICAL_BAND: f64 = 1e-6;
    let (e, v) = if (damping - 1.0).abs() < CRITICAL_BAND {
        let fall = (-w * dt_s).exp();
        let c = v0 + w * e0;
        ((e0 + c * dt_s) * fall, (v0 - w * c * dt_s) * fall)
    } else if damping < 1.0 {
        let wd = w * (1.0 - damping * damping).sqrt();
        let (sin, cos) = (wd * dt_s).sin_cos();
        let fall = (-decay * dt_s).exp();
        (
            fall * (e0 * cos + (v0 + decay * e0) / wd * sin),
            fall * (v0 * cos - (decay * v0 + w * w * e0) / wd * sin),
        )
    } else {
        let root = (damping * damping - 1.0).sqrt();
        let (slow, fast) = (-w * (damping - root), -w * (damping + root));
        let a = (v0 - fast * e0) / (slow - fast);
        let b = e0 - a;
        let (ea, eb) = (a * (slow * dt_s).exp(), b * (fast * dt_s).exp());
        (ea + eb, slow * ea + fast * eb)
    };
    ServoState { angle_rad: target_rad + e, rate_rad_s: v }
}

/// The energy norm `√(e² + (v/ω)²)` of a damped spring never grows, and it bounds the error: once it
/// is under the tolerance the joint stays there, however it still swings.
fn spring_settle_s(error: f64, tolerance: f64, frequency_rad_s: f64, damping: f64) -> f64 {
    let norm = |t: f64| {
        let s = spring_to(ServoState::at_rest(error), 0.0, t, frequency_rad_s, damping);
        s.angle_rad.hypot(s.rate_rad_s / frequency_rad_s)
    };
    let mut late = 1.0 / frequency_rad_s;
    // A spring this slow does not settle within anybody's patience; the bound keeps the loop finite.
    const LONGEST_S: f64 = 3600.0;
    while norm(late) > tolerance && late < LONGEST_S {
        late *= 2.0;
    }
    bisect(0.0, late, |t| norm(t) <= tolerance)
}

/// The smallest argument in `[low, high]` for which a monotone condition holds.
fn bisect(mut low: f64, mut high: f64, holds: impl Fn(f64) -> bool) -> f64 {
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if holds(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_law() -> impl Strategy<Value = ServoLaw> {
        prop_oneof![
            (0.02..2.0f64, 0.005..0.1f64)
                .prop_map(|(speed_rad_s, gap_rad)| ServoLaw::Hinge { speed_rad_s, gap_rad }),
            (3.0..40.0f64, 0.2..3.0f64).prop_map(|(frequency_rad_s, damping)| ServoLaw::Spring {
                frequency_rad_s,
                damping
            }),
        ]
    }

    /// The laws as differential equations, integrated in small steps.
    fn integrate(law: ServoLaw, mut s: ServoState, target: f64, dt_s: f64) -> ServoState {
        let steps = 200_000;
        let h = dt_s / f64::from(steps);
        for _ in 0..steps {
            match law {
                ServoLaw::Hinge { speed_rad_s, gap_rad } => {
                    let e = target - s.angle_rad;
                    s.rate_rad_s = speed_rad_s * (e / gap_rad).clamp(-1.0, 1.0);
                    s.angle_rad += h * s.rate_rad_s;
                }
                ServoLaw::Spring { frequency_rad_s: w, damping } => {
                    let a = w * w * (target - s.angle_rad) - 2.0 * damping * w * s.rate_rad_s;
                    s.rate_rad_s += h * a;
                    s.angle_rad += h * s.rate_rad_s;
                }
            }
        }
        s
    }

    #[test]
    fn quarter_degree_steps_settle_as_the_protocol_document_says() {
        let law = ServoLaw::hinge(0.17);
        let step = 0.25_f64.to_radians();
        // Protocol 6.3: to 10 % in 0.47 s, to 5 % in 0.62 s.
        assert!((law.settle_s(step, 0.1 * step) - 0.47).abs() < 0.01);
        assert!((law.settle_s(step, 0.05 * step) - 0.62).abs() < 0.01);
        let five = 5.0_f64.to_radians();
        assert!((law.settle_s(five, 0.1 * HINGE_GAP_RAD) - (0.31 + 0.47)).abs() < 0.02);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn closed_forms_match_the_integrated_equations(
            law in any_law(), from in -0.5..0.5f64, rate in -0.3..0.3f64, to in -0.5..0.5f64, dt in 0.01..1.5f64
        ) {
            let start = ServoState { angle_rad: from, rate_rad_s: rate };
            let exact = law.advance(start, Demand::Angle(to), dt);
            let stepped = integrate(law, start, to, dt);
            prop_assert!((exact.angle_rad - stepped.angle_rad).abs() < 2e-4, "{exact:?} {stepped:?}");
        }
    }

    proptest! {
        #[test]
        fn steps_compose(
            law in any_law(), from in -0.5..0.5f64, to in -0.5..0.5f64, a in 0.0..0.7f64, b in 0.0..0.7f64
        ) {
            let start = ServoState::at_rest(from);
            let demand = Demand::Angle(to);
            let at_once = law.advance(start, demand, a + b);
            let in_two = law.advance(law.advance(start, demand, a), demand, b);
            prop_assert!((at_once.angle_rad - in_two.angle_rad).abs() < 1e-9);
            prop_assert!((at_once.rate_rad_s - in_two.rate_rad_s).abs() < 1e-6);
        }

        #[test]
        fn settled_is_settled_for_good(law in any_law(), error in 0.001..1.0f64, later in 0.0..3.0f64) {
            let tolerance = 2e-4;
            let t = law.settle_s(error, tolerance);
            let s = law.advance(ServoState::at_rest(error), Demand::Angle(0.0), t + later);
            prop_assert!(s.angle_rad.abs() <= tolerance * (1.0 + 1e-6), "{s:?} after {t} s");
        }

        #[test]
        fn a_set_point_brings_a_moving_joint_where_wanted(
            law in any_law(), rate in -0.2..0.2f64, travel in -0.03..0.03f64, dt in 0.1..0.4f64
        ) {
            let state = ServoState { angle_rad: 0.1, rate_rad_s: rate };
            let set_point = law.set_point_for(state, 0.1 + travel, dt);
            prop_assume!(set_point.is_finite());
            let end = law.advance(state, Demand::Angle(set_point), dt);
            prop_assert!((end.angle_rad - 0.1 - travel).abs() < 1e-9, "{}", end.angle_rad);
        }

        #[test]
        fn a_derated_law_settles_later(law in any_law(), error in 0.01..1.0f64) {
            // Near critical damping the time jumps where the overshoot begins to count.
            let jumps = matches!(law, ServoLaw::Spring { damping, .. } if damping > 0.8);
            prop_assume!(!jumps);
            prop_assert!(law.derated().settle_s(error, 2e-4) > law.settle_s(error, 2e-4));
        }

        #[test]
        fn a_lead_moves_the_joint_by_the_travel_asked(
            law in any_law(), travel in -0.05..0.05f64, dt in 0.1..0.4f64
        ) {
            let lead = law.lead_rad(travel, dt);
            prop_assume!(lead.is_finite());
            let end = law.advance(ServoState::default(), Demand::Angle(lead), dt);
            prop_assert!((end.angle_rad - travel).abs() < 1e-9, "{} for {travel}", end.angle_rad);
        }
    }
}
