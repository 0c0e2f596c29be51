use crate::protocol::Dialect;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// One Unreal angle unit in radians: servers compute angles in whole parts of 1/65536 of a turn.
const UNREAL_RAD: f64 = TAU / 65536.0;

/// π as servers print it, cut to four decimals: the field of view of a UT2004 SICK.
#[expect(clippy::approx_constant, reason = "it stands for what the wire says")]
pub(super) const PRINTED_PI: f64 = 3.1415;

/// π/2 as servers print it.
#[cfg(test)]
#[expect(clippy::approx_constant, reason = "it stands for what the wire says")]
const PRINTED_HALF_PI: f64 = 1.5707;

/// The field of view of a UDK SICK as printed.
pub(super) const PRINTED_UDK_SICK_FOV: f64 = 3.1414;

/// Bearings of a scanner's beams in its own frame, first beam on the right.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beams {
    /// Bearing of the first beam in radians, left positive.
    pub first_bearing_rad: f64,
    /// Angle from one beam to the next in radians.
    pub step_rad: f64,
}

impl Beams {
    /// UT2004: `count` beams spread evenly over the field of view (protocol 3.5).
    ///
    /// The printed field of view is a whole number of Unreal units cut to four decimals; π prints as
    /// 3.1415. The whole number is found again, which moves the outermost beam of a SICK by 0.003°.
    pub fn spread_evenly(printed_fov_rad: f64, count: usize) -> Self {
        let fov = candidates(printed_fov_rad).last().map_or(printed_fov_rad, |k| k * UNREAL_RAD);
        let gaps = count.saturating_sub(1).max(1) as f64;
        Self { first_bearing_rad: -0.5 * fov, step_rad: fov / gaps }
    }

    /// UDK: beams from `floor(fov/2)` down in whole Unreal steps (protocol 3.5).
    ///
    /// Of the steps that print as `printed_step_rad` the one is taken that gives `count` beams; if
    /// none does, the beams are spread evenly.
    pub fn stepped(printed_fov_rad: f64, printed_step_rad: f64, count: usize) -> Self {
        for fov in candidates(printed_fov_rad).rev() {
            let first = (0.5 * fov).floor();
            for step in candidates(printed_step_rad).rev() {
                // Beams run from `first` down while they are at least -fov/2.
                let beams = ((first + 0.5 * fov) / step).floor() + 1.0;
                if beams == count as f64 {
                    let first_bearing_rad = -first * UNREAL_RAD;
                    return Self { first_bearing_rad, step_rad: step * UNREAL_RAD };
                }
            }
        }
        Self::spread_evenly(printed_fov_rad, count)
    }

    /// Bearings of `count` beams in radians, left positive.
    pub fn bearings_rad(&self, count: usize) -> Vec<f64> {
        (0..count).map(|beam| self.first_bearing_rad + beam as f64 * self.step_rad).collect()
    }
}

/// The angle that a server of `dialect` prints as `printed` in a GEO line.
///
/// UT2004 cuts a whole number of Unreal units to four decimals, which leaves one or two of them; the
/// greater is taken, as 3.1415 is π. UDK rounds to two decimals, which leaves a hundred; mounts are
/// drawn in fives of degrees as a rule, so such an angle is taken if it prints like that.
pub(super) fn unprinted_angle(printed: f64, dialect: Dialect) -> f64 {
    match dialect {
        Dialect::Ut2004 if printed.abs() >= 1e-4 => {
            let units = candidates(printed.abs()).last();
            units.map_or(printed, |k| (k * UNREAL_RAD).copysign(printed))
        }
        Dialect::Ut2004 => 0.0,
        Dialect::Udk => {
            let fives = (printed.to_degrees() / 5.0).round() * 5.0;
            if (fives.to_radians() - printed).abs() <= 0.005_001 {
                fives.to_radians()
            } else {
                printed
            }
        }
    }
}

/// Whole numbers of Unreal units that print as `printed` when cut to four decimals, ascending.
fn candidates(printed: f64) -> impl DoubleEndedIterator<Item = f64> {
    // A hair's breadth keeps a value such as 3.1415, which is not exact in binary, on the right side
    // of the cut.
    const HAIR: f64 = 1e-9;
    let low = ((printed - HAIR) / UNREAL_RAD).ceil().max(1.0) as i64;
    let high = ((printed + 1e-4 - HAIR) / UNREAL_RAD).floor().max(0.0) as i64;
    (low..=high).map(|k| k as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn a_ut2004_sick_covers_exactly_half_a_turn() {
        let beams = Beams::spread_evenly(PRINTED_PI, 181);
        assert!((beams.first_bearing_rad + FRAC_PI_2).abs() < 1e-12, "{}", beams.first_bearing_rad);
        assert!((beams.step_rad - PI / 180.0).abs() < 1e-12);
        assert!(beams.bearings_rad(181)[90].abs() < 1e-12, "the middle beam looks ahead");
    }

    #[test]
    fn udk_scanners_have_the_documents_beams() {
        // Protocol 3.5: printed FOV and resolution, beams, first, last (wire sign) and true step.
        let rows = [
            (PRINTED_UDK_SICK_FOV, 0.0174, 181, 16383.0 * UNREAL_RAD, -1.570_125, 0.017_449_0),
            (4.1889, 0.0184, 228, 2.094_459, -2.084_105, 0.018_407_8),
            (3.1399, 0.1569, 21, 1.569_933, -1.568_975, 0.156_945_4),
        ];
        for (fov, resolution, count, first, last, step) in rows {
            let beams = Beams::stepped(fov, resolution, count);
            let bearings = beams.bearings_rad(count);
            assert!((bearings[0] + first).abs() < 1e-6, "{fov}: {}", bearings[0]);
            assert!((bearings[count - 1] + last).abs() < 1e-6, "{fov}: {}", bearings[count - 1]);
            assert!((beams.step_rad - step).abs() < 1e-6);
        }
    }

    #[test]
    fn printed_mount_angles_are_found_again() {
        assert_eq!(unprinted_angle(PRINTED_PI, Dialect::Ut2004), PI);
        assert!((unprinted_angle(-PRINTED_HALF_PI, Dialect::Ut2004) + FRAC_PI_2).abs() < 1e-15);
        assert_eq!(unprinted_angle(-0.0, Dialect::Ut2004), 0.0);
        assert!((unprinted_angle(-1.57, Dialect::Udk) + FRAC_PI_2).abs() < 1e-15);
        assert_eq!(unprinted_angle(0.13, Dialect::Udk), 0.13);
    }

    #[test]
    fn a_count_that_no_step_explains_is_spread_evenly() {
        let beams = Beams::stepped(PRINTED_UDK_SICK_FOV, 0.0174, 90);
        assert_eq!(beams, Beams::spread_evenly(PRINTED_UDK_SICK_FOV, 90));
    }

    #[test]
    fn one_beam_and_no_field_of_view_are_not_divided_by_zero() {
        assert!(Beams::spread_evenly(0.0, 1).step_rad.is_finite());
        assert!(Beams::spread_evenly(PRINTED_PI, 0).step_rad.is_finite());
    }
}
