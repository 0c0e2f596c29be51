use super::beams::Beams;
use super::head::ScanHead;
use crate::protocol::Dialect;
use crate::protocol::message::sen::RangeScanner;
use crate::scan::{LaserLine, are_whole_steps};
use crate::time::{Span, Stamp};
use serde::{Deserialize, Serialize};

/// The scanner that scans are made with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Laser {
    /// Its name on the wire.
    pub name: String,
    /// Its type on the wire, `RangeScanner` as a rule.
    pub type_name: String,
    /// Its mount and the joints that point it.
    pub head: ScanHead,
    /// Standard deviation of its place on the part that carries it in each axis, in metres: what the server has
    /// rounded that to.
    #[serde(default)]
    pub mounted_within_m: f64,
    /// Nearest distance it measures, in metres.
    pub min_range_m: f64,
    /// Distance from which on it reports no return, in metres.
    pub max_range_m: f64,
    /// Angle from the first beam to the last as printed, in radians.
    pub fov_rad: f64,
    /// Angle between beams as printed, in radians.
    pub resolution_rad: f64,
}

/// Why a message is no line of the rig's laser.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LaserError {
    /// The rig has no laser.
    #[error("a line of scanner {found:?}, but the rig has no laser")]
    NoLaser {
        /// The scanner's name.
        found: String,
    },
    /// Another scanner's line.
    #[error("a line of scanner {found:?}, expected {expected:?}")]
    OtherScanner {
        /// The line's scanner.
        found: String,
        /// The rig's laser.
        expected: String,
    },
    /// The line has no ranges.
    #[error("a line of scanner {name:?} without ranges")]
    Empty {
        /// The scanner's name.
        name: String,
    },
    /// Neither the line nor anything before it was stamped.
    #[error("a line of scanner {name:?} without a time, and none known")]
    NoTime {
        /// The scanner's name.
        name: String,
    },
}

/// Why a reading of a beam is worthless.
const NO_READING: f64 = f64::NAN;

/// UDK writes ranges with two decimals, cut; half a step is added back (protocol 3.5).
const UDK_RANGE_STEP_M: f64 = 0.01;
/// UT2004 writes four, cut as well.
const UT2004_RANGE_STEP_M: f64 = 0.0001;

impl Laser {
    /// The line that a message reports, in the sensor frame.
    ///
    /// Beam 1 is the rightmost in both dialects, so the order stays and the step is positive. A line
    /// without a time takes `fallback`, which should be the newest stamp known. In UDK beams that
    /// carry the distance to the world's origin for want of a hit become missing.
    ///
    /// # Errors
    ///
    /// When the line is of another scanner, empty, or cannot be dated.
    pub fn line(
        &self,
        message: &RangeScanner,
        dialect: Dialect,
        fallback: Option<Stamp>,
    ) -> Result<LaserLine, LaserError> {
        let name = || message.name.clone();
        if !message.name.is_empty() && !message.name.eq_ignore_ascii_case(&self.name) {
            return Err(LaserError::OtherScanner { found: name(), expected: self.name.clone() });
        }
        if message.ranges_m.is_empty() {
            return Err(LaserError::Empty { name: name() });
        }
        let stamp = message.time.or(fallback).ok_or_else(|| LaserError::NoTime { name: name() })?;
        let beams = self.beams(message, dialect);
        let (ranges_m, phantom_m) = match dialect {
            Dialect::Ut2004 => {
                let uncut = |&range: &f64| uncut(range, UT2004_RANGE_STEP_M);
                (message.ranges_m.iter().map(uncut).collect(), None)
            }
            Dialect::Udk => self.udk_ranges(&message.ranges_m, beams.step_rad),
        };
        Ok(LaserLine {
            stamp,
            first_bearing_rad: beams.first_bearing_rad,
            bearing_step_rad: beams.step_rad,
            min_range_m: self.min_range_m,
            max_range_m: self.max_range_m,
            ranges_m,
            phantom_m,
        })
    }

    /// Bearings of the beams of a message, which tells its own field of view as a rule.
    fn beams(&self, message: &RangeScanner, dialect: Dialect) -> Beams {
        let fov = message.fov_rad.unwrap_or(self.fov_rad);
        let count = message.ranges_m.len();
        match dialect {
            Dialect::Ut2004 => Beams::spread_evenly(fov, count),
            Dialect::Udk => {
                Beams::stepped(fov, message.resolution_rad.unwrap_or(self.resolution_rad), count)
            }
        }
    }

    /// Expected time between two lines until it is measured.
    pub fn usual_interval(&self) -> Span {
        Span::from_millis(200)
    }

    /// Ranges as meant, and what those carry that hit nothing, where the line shows it.
    fn udk_ranges(&self, ranges_m: &[f64], step_rad: f64) -> (Vec<f64>, Option<f64>) {
        // A scanner that writes finer than two decimals is no SICK of UDK and is not cut to them.
        let coarse = are_whole_steps(ranges_m, UDK_RANGE_STEP_M);
        let step_m = if coarse { UDK_RANGE_STEP_M } else { UT2004_RANGE_STEP_M };
        let phantom = coarse.then(|| phantom_range(ranges_m, self.max_range_m, step_rad)).flatten();
        let meant = |&range: &f64| match phantom {
            Some(phantom) if (range - phantom).abs() < 1.5 * UDK_RANGE_STEP_M => NO_READING,
            _ => uncut(range, step_m),
        };
        (ranges_m.iter().map(meant).collect(), phantom.map(|phantom| uncut(phantom, step_m)))
    }
}

/// The middle of the values that print as `range`; codes such as -1 and 0 stay as they are.
fn uncut(range: f64, step_m: f64) -> f64 {
    if range > 0.0 { range + 0.5 * step_m } else { range }
}

/// The range that UDK's SICK and Hokuyo give for beams that hit nothing: the distance to a point the
/// engine never filled in, most likely the world's origin (protocol 3.5).
///
/// It is the same for all such beams, so it shows as a run of equal values longer than any surface
/// makes one: a wall square to the beam at distance d leaves the grid of 0.01 m at √(2·0.01/d) to
/// either side. Values beyond the maximum range are told by the line itself and need no detection.
fn phantom_range(ranges_m: &[f64], max_range_m: f64, step_rad: f64) -> Option<f64> {
    let mut longest: Option<(usize, f64)> = None;
    let mut begin = 0;
    for end in 1..=ranges_m.len() {
        let ended = ranges_m.get(end).is_none_or(|&r| (r - ranges_m[begin]).abs() > 1e-6);
        if !ended {
            continue;
        }
        let (length, range) = (end - begin, ranges_m[begin]);
        let natural =
            2.0 * (2.0 * UDK_RANGE_STEP_M / range.max(UDK_RANGE_STEP_M)).sqrt() / step_rad;
        let odd = range > 0.0 && range < max_range_m && length as f64 > 1.5 * natural + 3.0;
        if odd && longest.is_none_or(|(most, _)| length > most) {
            longest = Some((length, range));
        }
        begin = end;
    }
    longest.map(|(_, range)| range)
}

#[cfg(test)]
mod tests {
    use super::super::mount::Mount;
    use super::*;
    use crate::protocol::{Message, message::Sen, parse};
    use crate::scan::Return;
    use std::f64::consts::FRAC_PI_2;

    fn sick(name: &str) -> Laser {
        Laser {
            name: name.into(),
            type_name: "RangeScanner".into(),
            mounted_within_m: 0.0,
            head: ScanHead::new(Mount::on_body([0.2, 0.0, -0.2], [0.0; 3])),
            min_range_m: 0.1,
            max_range_m: 20.0,
            fov_rad: super::super::beams::PRINTED_PI,
            resolution_rad: 0.0174,
        }
    }

    fn message(line: &str) -> RangeScanner {
        let Message::Sen(Sen::RangeScanner(message)) = parse(line.as_bytes()).message else {
            panic!("no laser line: {line}")
        };
        message
    }

    #[test]
    fn the_first_value_is_the_rightmost_beam() {
        let m = message(
            "SEN {Time 5.02} {Type RangeScanner} {Name Scanner1} {FOV 3.1415} {Range 1.0000,2.0000,3.0000}",
        );
        let line = sick("Scanner1").line(&m, Dialect::Ut2004, None).unwrap();
        assert!((line.bearing_rad(0) + FRAC_PI_2).abs() < 1e-9 && line.bearing_rad(1).abs() < 1e-9);
        assert_eq!(line.stamp, Stamp::from_seconds(5.02));
        assert!((line.ranges_m[1] - 2.00005).abs() < 1e-12);
    }

    #[test]
    fn udk_ranges_get_half_a_step_back_and_saturation_stays() {
        let m = message(
            "SEN {Time 5.0200} {Type RangeScanner} {Name lms200} {Resolution 0.0174} {FOV 3.1414} {Range 1.00,20.00,437.55}",
        );
        let line = sick("lms200").line(&m, Dialect::Udk, None).unwrap();
        assert_eq!(line.classify(0), Return::Hit(1.005));
        assert_eq!((line.classify(1), line.classify(2)), (Return::Nothing, Return::Nothing));
    }

    #[test]
    fn a_constant_distance_to_the_origin_is_no_surface() {
        // A wall 5 m ahead fills the middle; to either side nothing is hit, and the origin is 7.31 m off.
        let ranges: Vec<String> = (0..181)
            .map(|i| {
                let bearing = f64::from(i - 90).to_radians();
                let wall = 5.0 / bearing.cos();
                if wall < 6.5 { (wall * 100.0).floor() / 100.0 } else { 7.31 }
            })
            .map(|r| format!("{r:.2}"))
            .collect();
        let m = message(&format!(
            "SEN {{Time 5.0200}} {{Type RangeScanner}} {{Name lms200}} {{Resolution 0.0174}} {{FOV 3.1414}} {{Range {}}}",
            ranges.join(",")
        ));
        let line = sick("lms200").line(&m, Dialect::Udk, None).unwrap();
        assert_eq!((line.classify(0), line.classify(180)), (Return::Missing, Return::Missing));
        assert!(matches!(line.classify(90), Return::Hit(r) if (r - 5.005).abs() < 1e-9));
        assert!((60..=120).all(|i| matches!(line.classify(i), Return::Hit(_))), "the wall stays");
    }

    #[test]
    fn a_wall_square_to_the_beam_is_not_mistaken_for_the_origin() {
        for distance in [0.3, 1.0, 3.0, 9.0, 19.0] {
            let ranges: Vec<f64> = (0..181)
                .map(|i| {
                    let bearing = f64::from(i - 90).to_radians();
                    (distance / bearing.cos().max(0.02) * 100.0).floor() / 100.0
                })
                .collect();
            assert_eq!(phantom_range(&ranges, 20.0, 0.017449), None, "{distance} m");
        }
    }

    #[test]
    fn foreign_empty_and_undated_lines_are_refused_with_both_sides() {
        let laser = sick("Scanner1");
        let other = message("SEN {Time 1.00} {Type RangeScanner} {Name Scanner2} {Range 1.0}");
        let error = laser.line(&other, Dialect::Ut2004, None).unwrap_err();
        assert_eq!(error.to_string(), "a line of scanner \"Scanner2\", expected \"Scanner1\"");
        let undated = message("SEN {Type RangeScanner} {Name scanner1} {Range 1.0}");
        assert!(matches!(
            laser.line(&undated, Dialect::Ut2004, None),
            Err(LaserError::NoTime { .. })
        ));
        let stamp = Some(Stamp::from_seconds(9.0));
        assert_eq!(laser.line(&undated, Dialect::Ut2004, stamp).unwrap().stamp.seconds(), 9.0);
    }
}
