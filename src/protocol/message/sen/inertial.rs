//! `Accel`, `AcceleroMeter`, `IMU` and `MagneticCompass` (UDK).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `SEN {Type Accel} {Name n} {Acceleration x,y,z}`, or with gravity included
/// `SEN {Type AcceleroMeter} {Name n} {ProperAcceleration x,y,z}`; sensor frame, m/s².
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Acceleration {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// m/s² along x, y, z of the sensor.
    pub acceleration: [f64; 3],
    /// Whether gravity is included (`AcceleroMeter`).
    pub proper: bool,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Acceleration {
    const FORMS: [(&str, &str); 2] =
        [("Accel", "Acceleration"), ("AcceleroMeter", "ProperAcceleration")];

    pub(super) fn read(fields: &mut Fields<'_>, proper: bool) -> Result<Self, Problem> {
        let (_, key) = Self::FORMS[usize::from(proper)];
        let acceleration = fields.vector(key);
        let acceleration = fields.require(key, acceleration)?;
        let (time, name) = (fields.time(), fields.name());
        Ok(Self { time, name, acceleration, proper, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        let (kind, key) = Self::FORMS[usize::from(self.proper)];
        w.time(self.time, 4).text("Type", kind).text_unless_empty("Name", &self.name);
        w.list(key, &self.acceleration, 4).extra(&self.extra);
    }
}

/// `SEN {Type IMU} {Name n} {XYZAcceleration …} {AngularVel …} {AngularAccel …} {Rotation r,p,y}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Imu {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// m/s².
    pub acceleration: Option<[f64; 3]>,
    /// rad/s.
    pub angular_velocity: Option<[f64; 3]>,
    /// rad/s².
    pub angular_acceleration: Option<[f64; 3]>,
    /// roll, pitch, yaw in radians.
    pub rotation: Option<[f64; 3]>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Imu {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            time: fields.time(),
            name: fields.name(),
            acceleration: fields.vector("XYZAcceleration"),
            angular_velocity: fields.vector("AngularVel"),
            angular_acceleration: fields.vector("AngularAccel"),
            rotation: fields.vector("Rotation"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "IMU").text_unless_empty("Name", &self.name);
        for (key, vector) in [
            ("XYZAcceleration", &self.acceleration),
            ("AngularVel", &self.angular_velocity),
            ("AngularAccel", &self.angular_acceleration),
            ("Rotation", &self.rotation),
        ] {
            if let Some(vector) = vector {
                w.list(key, vector, 4);
            }
        }
        w.extra(&self.extra);
    }
}

/// `SEN {Type MagneticCompass} {Name n} {MagneticAngle a}`; the server converts its unit twice, so
/// the value is almost always 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Compass {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// As the server wrote it.
    pub magnetic_angle: f64,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Compass {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let angle = fields.number("MagneticAngle");
        let magnetic_angle = fields.require("MagneticAngle", angle)?;
        Ok(Self { time: fields.time(), name: fields.name(), magnetic_angle, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "MagneticCompass").text_unless_empty("Name", &self.name);
        w.number("MagneticAngle", self.magnetic_angle, 4).extra(&self.extra);
    }
}
