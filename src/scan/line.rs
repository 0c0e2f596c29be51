use crate::time::Stamp;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// What one beam reported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Return {
    /// A surface at this distance in metres.
    Hit(f64),
    /// The beam was fired and nothing within the scanner's range came back.
    Nothing,
    /// No usable reading: the line was lost, or the value is not a range this scanner can give.
    Missing,
}

/// One laser reading in the sensor frame: beams in the sensor's x-y plane, counter-clockwise.
///
/// Beam `i` points along `first_bearing_rad + i * bearing_step_rad`, measured from x towards y
/// (left), so a USARSim line, whose first value is the rightmost beam, keeps its order with a
/// positive step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaserLine {
    /// When the rays were cast, by the server's stamp.
    pub stamp: Stamp,
    /// Bearing of beam 0 in radians, left positive.
    pub first_bearing_rad: f64,
    /// Angle from one beam to the next in radians.
    pub bearing_step_rad: f64,
    /// Nearest distance the scanner can measure, in metres.
    pub min_range_m: f64,
    /// Distance from which on the scanner reports no return, in metres.
    pub max_range_m: f64,
    /// Distances in metres as received; NaN where the wire had no usable number.
    pub ranges_m: Vec<f64>,
    /// The range that beams carry here which hit nothing, where the line itself shows that; they are NaN.
    pub phantom_m: Option<f64>,
}

impl LaserLine {
    /// Number of beams.
    pub fn len(&self) -> usize {
        self.ranges_m.len()
    }

    /// Whether the line has no beams.
    pub fn is_empty(&self) -> bool {
        self.ranges_m.is_empty()
    }

    /// Bearing of beam `beam` in radians, left positive.
    pub fn bearing_rad(&self, beam: usize) -> f64 {
        self.first_bearing_rad + beam as f64 * self.bearing_step_rad
    }

    /// What beam `beam` reported, judged by the scanner's own limits.
    ///
    /// Servers print a saturated beam as the maximum range cut to four decimals or multiplied by
    /// their ±0.1 % noise, some as -1: all of those are [`Return::Nothing`].
    pub fn classify(&self, beam: usize) -> Return {
        let range = self.ranges_m[beam];
        if range.is_nan() {
            Return::Missing
        } else if range < 0.0 || range >= 0.9985 * self.max_range_m {
            Return::Nothing
        } else if range < self.min_range_m {
            Return::Missing
        } else {
            Return::Hit(range)
        }
    }

    /// Unit direction of beam `beam` in the sensor frame.
    pub fn direction(&self, beam: usize) -> Vector3<f64> {
        let (sin, cos) = self.bearing_rad(beam).sin_cos();
        Vector3::new(cos, sin, 0.0)
    }
}
