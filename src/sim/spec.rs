//! What a file says about a robot: body, wheels, pan-tilt units and sensors.
//!
//! The same structs stand in `maps/robots.toml` and in scenario files, where keys that are left out
//! come from the robot's class. Core frame: x forward, y left, z up, from the robot's origin.

use super::file_check::Check;
use crate::protocol::Dialect;
use serde::{Deserialize, Serialize};

/// A box that belongs to a robot's body: seen by others' sensors, felt in contacts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartSpec {
    /// Name, for messages.
    pub name: String,
    /// Centre in the robot's frame, in metres.
    pub center: [f64; 3],
    /// Full extents in metres.
    pub size: [f64; 3],
    /// Mass in kilograms, spread evenly.
    pub mass_kg: f64,
}

/// How a robot rolls.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Four driven wheels, the two of a side turning alike.
    FourWheels,
    /// Two driven wheels beside the origin and a frictionless caster behind.
    TwoWheelsAndCaster,
}

/// Wheels and motors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WheelSpec {
    /// Which wheels there are.
    pub layout: Layout,
    /// Radius in metres.
    pub radius_m: f64,
    /// Width of the tyre in metres.
    pub width_m: f64,
    /// Distance between the middles of left and right wheels in metres.
    pub separation_m: f64,
    /// Distance between front and rear axles in metres; for the caster its distance behind.
    pub base_m: f64,
    /// Height of the axles in the robot's frame in metres, usually below the origin.
    pub axle_z_m: f64,
    /// Mass of one wheel in kilograms.
    pub mass_kg: f64,
    /// Coefficient of friction of the tyre; the ground's is multiplied by it.
    pub friction: f64,
    /// Top spin in rad/s, as CONF reports it.
    pub max_spin_rps: f64,
    /// Most that one wheel's motor can give, in N m.
    pub max_torque_nm: f64,
    /// Largest change of the commanded spin in rad/s².
    pub max_spin_change_rps2: f64,
}

/// A pan-tilt unit: link 1 turns about the vertical, link 2 about the axis to the left.
///
/// Core signs: pan positive to the left, tilt positive **down**; limits are given in wire signs,
/// as the protocol prints them (tilt positive up), because that is what CONF says.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PanTiltSpec {
    /// Name of the package or actuator.
    pub name: String,
    /// Where the pan axis meets the unit's pan joint, in the robot's frame, in metres.
    pub position: Option<[f64; 3]>,
    /// Tilt joint from the pan joint, in metres, at zero pan.
    pub tilt_offset: Option<[f64; 3]>,
    /// Least and greatest pan in radians, positive left; greater first means no limit.
    pub pan_limits_rad: Option<[f64; 2]>,
    /// Least and greatest tilt in radians, positive up; greater first means no limit.
    pub tilt_limits_rad: Option<[f64; 2]>,
    /// Top speed of both links in rad/s.
    pub speed_rad_s: Option<f64>,
    /// Greatest torque as CONF and MISSTA report it, in engine units.
    pub torque: Option<f64>,
    /// Whether the unit's angles are reported (MISSTA, ASTA).
    pub status: Option<bool>,
    /// Whether the pan turns to the right where the wire's frames promise left.
    pub pan_inverted: Option<bool>,
    /// Whether the tilt turns down where the wire's frames promise up.
    pub tilt_inverted: Option<bool>,
    /// UDK: undamped frequency of the joint's spring in hertz.
    pub spring_hz: Option<f64>,
    /// UDK: damping ratio of the joint's spring.
    pub spring_damping: Option<f64>,
}

impl PanTiltSpec {
    /// This unit with what it leaves out taken from `other`.
    pub fn or(&self, other: &Self) -> Self {
        Self {
            name: self.name.clone(),
            position: self.position.or(other.position),
            tilt_offset: self.tilt_offset.or(other.tilt_offset),
            pan_limits_rad: self.pan_limits_rad.or(other.pan_limits_rad),
            tilt_limits_rad: self.tilt_limits_rad.or(other.tilt_limits_rad),
            speed_rad_s: self.speed_rad_s.or(other.speed_rad_s),
            torque: self.torque.or(other.torque),
            status: self.status.or(other.status),
            pan_inverted: self.pan_inverted.or(other.pan_inverted),
            tilt_inverted: self.tilt_inverted.or(other.tilt_inverted),
            spring_hz: self.spring_hz.or(other.spring_hz),
            spring_damping: self.spring_damping.or(other.spring_damping),
        }
    }

    pub(crate) fn check(&self, check: &mut Check, owner: &str) {
        let place = format!("{owner} pan_tilt {:?}", self.name);
        check.that(wire_name(&self.name), &place, "expected a name without blanks and braces");
        check.finite(&self.position.unwrap_or_default(), format_args!("{place} position"));
        check.finite(&self.tilt_offset.unwrap_or_default(), format_args!("{place} tilt_offset"));
        check.finite(
            &self.pan_limits_rad.unwrap_or_default(),
            format_args!("{place} pan_limits_rad"),
        );
        check.finite(
            &self.tilt_limits_rad.unwrap_or_default(),
            format_args!("{place} tilt_limits_rad"),
        );
        let positive = [self.speed_rad_s, self.torque, self.spring_hz, self.spring_damping];
        let positive: Vec<f64> = positive.into_iter().flatten().collect();
        check.positive(&positive, format_args!("{place} speed, torque and spring"));
    }
}

/// The kinds of sensors and effecters a robot can carry, named as on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum SensorKind {
    /// Laser scanner.
    RangeScanner,
    /// Ultrasonic ranger.
    Sonar,
    /// Dead reckoning by wheel encoders.
    Odometry,
    /// One counter of a wheel or a joint.
    Encoder,
    /// Inertial navigation.
    #[serde(rename = "INS")]
    Ins,
    /// Bumper.
    Touch,
    /// Victim sensor (UT2004).
    VictSensor,
    /// Radio tag reader (UT2004).
    #[serde(rename = "RFID")]
    Rfid,
    /// Radio tag dropper (UT2004).
    #[serde(rename = "RFIDReleaser")]
    RfidReleaser,
    /// The true pose, for scoring.
    GroundTruth,
    /// Satellite positioning; indoors it has no fix.
    #[serde(rename = "GPS")]
    Gps,
    /// Wheel speeds (UDK).
    Tachometer,
    /// Depth camera: an image in strips when told to (UDK's KinectDepth).
    RangeImager,
    /// A camera; its pictures come from the image server.
    Camera,
    /// The battery's case (UDK): it can be asked where it is and says nothing by itself.
    Battery,
    /// Infrared ranger of one ray.
    #[serde(rename = "IR")]
    Ir,
    /// Plain ranger of one ray.
    Range,
    /// Infrared scanner.
    #[serde(rename = "IRScanner")]
    IrScanner,
    /// Acceleration without gravity (UDK).
    Accel,
    /// Acceleration with gravity (UDK).
    AcceleroMeter,
    /// Accelerations, rates and attitude (UDK).
    #[serde(rename = "IMU")]
    Imu,
    /// Heading against north, lost in the server's conversion (UDK).
    MagneticCompass,
    /// Height above the spawn (UDK).
    AltitudeSensor,
    /// Minutes since the spawn (UDK).
    MissionTime,
    /// Objects that a fan of beams meets (UDK).
    ObjectSensor,
    /// What is heard, and from where (UDK).
    Acoustic,
    /// What is heard (UT2004).
    Sound,
}

impl SensorKind {
    /// The type's name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::RangeScanner => "RangeScanner",
            Self::Sonar => "Sonar",
            Self::Odometry => "Odometry",
            Self::Encoder => "Encoder",
            Self::Ins => "INS",
            Self::Touch => "Touch",
            Self::VictSensor => "VictSensor",
            Self::Rfid => "RFID",
            Self::RfidReleaser => "RFIDReleaser",
            Self::GroundTruth => "GroundTruth",
            Self::Gps => "GPS",
            Self::Tachometer => "Tachometer",
            Self::RangeImager => "RangeImager",
            Self::Camera => "Camera",
            Self::Battery => "Battery",
            Self::Ir => "IR",
            Self::Range => "Range",
            Self::IrScanner => "IRScanner",
            Self::Accel => "Accel",
            Self::AcceleroMeter => "AcceleroMeter",
            Self::Imu => "IMU",
            Self::MagneticCompass => "MagneticCompass",
            Self::AltitudeSensor => "AltitudeSensor",
            Self::MissionTime => "MissionTime",
            Self::ObjectSensor => "ObjectSensor",
            Self::Acoustic => "Acoustic",
            Self::Sound => "Sound",
        }
    }

    /// The keys beyond name, mount and pose that mean something for this kind.
    fn own_keys(self) -> &'static [&'static str] {
        match self {
            Self::RangeScanner => {
                &["min_range_m", "max_range_m", "fov_deg", "resolution_deg", "interval_s"]
            }
            Self::Sonar => &["min_range_m", "max_range_m", "beam_deg", "interval_s"],
            Self::Odometry => &["encoder_resolution_rad", "interval_s"],
            Self::Encoder => &["encoder_resolution_rad", "interval_s"],
            Self::VictSensor => &["max_range_m", "fov_deg", "interval_s"],
            Self::Rfid => &["max_range_m", "interval_s", "locations", "always_read_memory"],
            Self::RfidReleaser => &["tags"],
            Self::Touch => &["diameter_m", "interval_s"],
            Self::Gps => &["satellites", "interval_s"],
            Self::RangeImager => &["max_range_m", "width", "height", "fov_deg", "interval_s"],
            Self::Camera => &["fov_deg", "min_fov_deg", "max_fov_deg", "width", "height"],
            Self::Ir | Self::Range => &["min_range_m", "max_range_m", "interval_s"],
            Self::IrScanner => {
                &["min_range_m", "max_range_m", "fov_deg", "resolution_deg", "yaw", "interval_s"]
            }
            Self::ObjectSensor => &["max_range_m", "fov_deg", "resolution_deg", "interval_s"],
            Self::Ins
            | Self::GroundTruth
            | Self::Tachometer
            | Self::Accel
            | Self::AcceleroMeter
            | Self::Imu
            | Self::MagneticCompass
            | Self::AltitudeSensor
            | Self::MissionTime
            | Self::Acoustic
            | Self::Sound => &["interval_s"],
            Self::Battery => &[],
        }
    }

    /// Whether a server of that dialect sends such lines; some kinds are of one alone.
    pub(crate) fn speaks(self, dialect: Dialect) -> bool {
        let udk_alone = matches!(
            self,
            Self::Accel
                | Self::AcceleroMeter
                | Self::Imu
                | Self::MagneticCompass
                | Self::AltitudeSensor
                | Self::MissionTime
                | Self::ObjectSensor
                | Self::Acoustic
        );
        match dialect {
            Dialect::Ut2004 => !udk_alone,
            Dialect::Udk => self != Self::Sound,
        }
    }
}

/// One sensor or effecter: where it is mounted, and its own keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorSpec {
    /// What it is.
    #[serde(rename = "type")]
    pub kind: SensorKind,
    /// Its name on the wire.
    pub name: String,
    /// `body`, or a part: `PACKAGE_Link1` (pan), `PACKAGE_Link2` (tilt), a wheel such as `LeftFWheel`.
    #[serde(default = "body")]
    pub mount: String,
    /// Position in the part's frame, in metres.
    #[serde(default)]
    pub position: [f64; 3],
    /// Roll, pitch, yaw in the part's frame, in degrees.
    #[serde(default)]
    pub rpy_deg: [f64; 3],
    /// Nearest measurable distance in metres.
    pub min_range_m: Option<f64>,
    /// Farthest measurable distance in metres.
    pub max_range_m: Option<f64>,
    /// Whole opening in degrees: of a scanner's fan, of a victim sensor's or camera's view.
    pub fov_deg: Option<f64>,
    /// Angle between a scanner's beams in degrees.
    pub resolution_deg: Option<f64>,
    /// Whether an infrared scanner's beams are spread at all; as a server comes they are not.
    pub yaw: Option<bool>,
    /// Whole opening of a sonar's cone in degrees.
    pub beam_deg: Option<f64>,
    /// Seconds between readings; UT2004 sensors without it report in every burst.
    pub interval_s: Option<f64>,
    /// Angle of one count in radians.
    pub encoder_resolution_rad: Option<f64>,
    /// Whether a tag reader tells where the tags are.
    pub locations: Option<bool>,
    /// Whether a tag reader tells what the tags hold without being asked.
    pub always_read_memory: Option<bool>,
    /// How many tags a releaser carries.
    pub tags: Option<u32>,
    /// Diameter of a bumper in metres.
    pub diameter_m: Option<f64>,
    /// Satellites in view; four and more give a fix.
    pub satellites: Option<u32>,
    /// Least view of a zoom in degrees.
    pub min_fov_deg: Option<f64>,
    /// Widest view of a zoom in degrees.
    pub max_fov_deg: Option<f64>,
    /// Columns of a picture.
    pub width: Option<u32>,
    /// Rows of a picture.
    pub height: Option<u32>,
}

fn body() -> String {
    "body".to_owned()
}

/// Whether a name can stand between braces and blanks.
pub(crate) fn wire_name(name: &str) -> bool {
    !name.is_empty() && !name.contains([' ', '{', '}', '\r', '\n', '\t'])
}

impl SensorSpec {
    pub(crate) fn check(&self, check: &mut Check, owner: &str) {
        let place = format!("{owner} sensor {:?}", self.name);
        check.that(wire_name(&self.name), &place, "expected a name without blanks and braces");
        check.finite(&self.position, format_args!("{place} position"));
        check.finite(&self.rpy_deg, format_args!("{place} rpy_deg"));
        let numbers = [
            ("min_range_m", self.min_range_m),
            ("max_range_m", self.max_range_m),
            ("fov_deg", self.fov_deg),
            ("resolution_deg", self.resolution_deg),
            ("beam_deg", self.beam_deg),
            // A scanner with interval 0 reports on demand.
            ("interval_s", self.interval_s.filter(|seconds| *seconds != 0.0)),
            ("encoder_resolution_rad", self.encoder_resolution_rad),
            ("diameter_m", self.diameter_m),
            ("min_fov_deg", self.min_fov_deg),
            ("max_fov_deg", self.max_fov_deg),
            ("width", self.width.map(f64::from)),
            ("height", self.height.map(f64::from)),
        ];
        let flags = [
            ("locations", self.locations.is_some()),
            ("always_read_memory", self.always_read_memory.is_some()),
            ("tags", self.tags.is_some()),
            ("yaw", self.yaw.is_some()),
            ("satellites", self.satellites.is_some()),
        ];
        let given = numbers.iter().map(|(key, value)| (*key, value.is_some())).chain(flags);
        for (key, _) in given.filter(|(_, given)| *given) {
            check.that(
                self.kind.own_keys().contains(&key),
                format_args!("{place} {key}"),
                format_args!(
                    "expected one of {:?}, which a {} has",
                    self.kind.own_keys(),
                    self.kind.name()
                ),
            );
        }
        for (key, value) in numbers {
            let values: Vec<f64> = value.into_iter().collect();
            check.positive(&values, format_args!("{place} {key}"));
        }
        if [SensorKind::RangeScanner, SensorKind::IrScanner, SensorKind::ObjectSensor]
            .contains(&self.kind)
        {
            check.that(
                self.beams() <= 4096,
                &place,
                format_args!("expected at most 4096 beams, found {}", self.beams()),
            );
        }
    }

    /// Refuses a kind that servers of the robot's dialect do not have.
    pub(crate) fn check_dialect(&self, dialect: Dialect, check: &mut Check, owner: &str) {
        check.that(
            self.kind.speaks(dialect),
            format_args!("{owner} sensor {:?}", self.name),
            format_args!("expected a type of that dialect, found {}", self.kind.name()),
        );
    }

    /// How many beams a scanner has: one at each end of its fan.
    pub fn beams(&self) -> usize {
        let steps = self.fov_deg.unwrap_or(180.0) / self.resolution_deg.unwrap_or(1.0);
        // A hair above the quotient, so that 180 / 0.1 counts as 1800 steps.
        (steps * (1.0 + 1e-9)).floor() as usize + 1
    }
}
