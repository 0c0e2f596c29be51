//! `SEN`: one sensor reading, or the readings of several like sensors.
//!
//! `SEN [{Time t}] {Type type} [{Name name}] …`: any sensor may come with or without its time. The
//! decimals of a time depend on dialect and type: UT2004 stamps what casts rays in images and lines
//! with 2 and everything else with 4, UDK all with 4.

mod environment;
mod gps;
mod inertial;
mod objects;
mod point_cloud;
mod pose;
mod range_imager;
mod range_readings;
mod range_scanner;
mod rfid;
mod sound;
mod touch;
mod victims;
mod wheels;

pub use environment::{Gas, MissionTime};
pub use gps::{Altitude, GeoCoordinate, Gps};
pub use inertial::{Acceleration, Compass, Imu};
pub use objects::{Ball, ObjectSensor, SeenObject};
pub use point_cloud::{LineLaser, PointCloud};
pub use pose::{Ins, Inu, Odometry};
pub use range_imager::RangeImager;
pub use range_readings::{RangeReading, RangeReadings};
pub use range_scanner::{RangeScanner, RangeScanner3d};
pub use rfid::{Rfid, RfidTag};
pub use sound::{Acoustic, HeardSound, Sound};
pub use touch::{Touch, TouchReading};
pub use victims::{HumanMotion, VictRfid, VictSensor, VictimPart, VictimTag};
pub use wheels::{Encoder, EncoderReading, Tachometer};

use crate::protocol::Dialect;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::text;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// A sensor line by its type. Ground truth is no sensor: see [`GroundTruth`](super::GroundTruth).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "each variant is named for the wire's type and holds its struct")]
pub enum Sen {
    RangeScanner(RangeScanner),
    IrScanner(RangeScanner),
    RangeScanner3d(RangeScanner3d),
    RangeImager(RangeImager),
    PointCloud(PointCloud),
    LineLaser(LineLaser),
    Sonar(RangeReadings),
    Range(RangeReadings),
    Ir(RangeReadings),
    Odometry(Odometry),
    Ins(Ins),
    Inu(Inu),
    Encoder(Encoder),
    Tachometer(Tachometer),
    Touch(Touch),
    TouchArray(Touch),
    VictSensor(VictSensor),
    VictRfid(VictRfid),
    HumanMotion(HumanMotion),
    Rfid(Rfid),
    Sound(Sound),
    Acoustic(Acoustic),
    Gps(Gps),
    Altitude(Altitude),
    Acceleration(Acceleration),
    Imu(Imu),
    Compass(Compass),
    MissionTime(MissionTime),
    ObjectSensor(ObjectSensor),
    Ball(Ball),
    Gas(Gas),
}

/// Does the same with whatever struct a variant holds.
macro_rules! each {
    ($sen:expr, $it:ident => $what:expr) => {
        match $sen {
            Sen::RangeScanner($it) | Sen::IrScanner($it) => $what,
            Sen::RangeScanner3d($it) => $what,
            Sen::RangeImager($it) => $what,
            Sen::PointCloud($it) => $what,
            Sen::LineLaser($it) => $what,
            Sen::Sonar($it) | Sen::Range($it) | Sen::Ir($it) => $what,
            Sen::Odometry($it) => $what,
            Sen::Ins($it) => $what,
            Sen::Inu($it) => $what,
            Sen::Encoder($it) => $what,
            Sen::Tachometer($it) => $what,
            Sen::Touch($it) | Sen::TouchArray($it) => $what,
            Sen::VictSensor($it) => $what,
            Sen::VictRfid($it) => $what,
            Sen::HumanMotion($it) => $what,
            Sen::Rfid($it) => $what,
            Sen::Sound($it) => $what,
            Sen::Acoustic($it) => $what,
            Sen::Gps($it) => $what,
            Sen::Altitude($it) => $what,
            Sen::Acceleration($it) => $what,
            Sen::Imu($it) => $what,
            Sen::Compass($it) => $what,
            Sen::MissionTime($it) => $what,
            Sen::ObjectSensor($it) => $what,
            Sen::Ball($it) => $what,
            Sen::Gas($it) => $what,
        }
    };
}

impl Sen {
    /// The line's own time, if the server wrote one.
    pub fn time(&self) -> Option<Stamp> {
        each!(self, reading => reading.time)
    }

    /// Reads a line whose `Type` has been taken; `None` for a type that is not known.
    pub(super) fn read(type_name: &[u8], fields: &mut Fields<'_>) -> Result<Option<Self>, Problem> {
        let lower = type_name.to_ascii_lowercase();
        Ok(Some(match lower.as_slice() {
            b"rangescanner" => Self::RangeScanner(RangeScanner::read(fields)?),
            b"irscanner" => Self::IrScanner(RangeScanner::read(fields)?),
            b"rangescanner3d" | b"3drangescanner" => {
                Self::RangeScanner3d(RangeScanner3d::read(fields, text::from_wire(type_name))?)
            }
            b"rangeimager" => Self::RangeImager(RangeImager::read(fields)?),
            b"pcl" => Self::PointCloud(PointCloud::read(fields)?),
            b"linelaser" => Self::LineLaser(LineLaser::read(fields)?),
            b"sonar" => Self::Sonar(RangeReadings::read(fields)?),
            b"range" => Self::Range(RangeReadings::read(fields)?),
            b"ir" => Self::Ir(RangeReadings::read(fields)?),
            b"odometry" => Self::Odometry(Odometry::read(fields)?),
            b"ins" => Self::Ins(Ins::read(fields)?),
            b"inu" => Self::Inu(Inu::read(fields)?),
            b"encoder" => Self::Encoder(Encoder::read(fields)?),
            b"tachometer" => Self::Tachometer(Tachometer::read(fields)),
            b"touch" => Self::Touch(Touch::read(fields)?),
            b"toucharray" => Self::TouchArray(Touch::read(fields)?),
            b"victsensor" => Self::VictSensor(VictSensor::read(fields)?),
            b"victrfid" => Self::VictRfid(VictRfid::read(fields)?),
            b"humanmotion" => Self::HumanMotion(HumanMotion::read(fields)?),
            b"rfid" | b"rfidtag" => Self::Rfid(Rfid::read(fields, text::from_wire(type_name))?),
            b"sound" => Self::Sound(Sound::read(fields)),
            b"acoustic" => Self::Acoustic(Acoustic::read(fields)?),
            b"gps" => Self::Gps(Gps::read(fields)?),
            b"altitudesensor" => Self::Altitude(Altitude::read(fields)),
            b"accel" => Self::Acceleration(Acceleration::read(fields, false)?),
            b"accelerometer" => Self::Acceleration(Acceleration::read(fields, true)?),
            b"imu" => Self::Imu(Imu::read(fields)),
            b"magneticcompass" => Self::Compass(Compass::read(fields)?),
            b"missiontime" => Self::MissionTime(MissionTime::read(fields)?),
            b"objectsensor" => Self::ObjectSensor(ObjectSensor::read(fields)?),
            b"ball" => Self::Ball(Ball::read(fields)),
            b"co2sensor" => Self::Gas(Gas::read(fields)?),
            _ => return Ok(None),
        }))
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        match self {
            Self::RangeScanner(reading) => reading.write(w, "RangeScanner", dialect),
            Self::IrScanner(reading) => reading.write(w, "IRScanner", dialect),
            Self::RangeScanner3d(reading) => reading.write(w),
            Self::RangeImager(reading) => reading.write(w, dialect),
            Self::PointCloud(reading) => reading.write(w),
            Self::LineLaser(reading) => reading.write(w),
            Self::Sonar(reading) => reading.write(w, "Sonar", dialect),
            Self::Range(reading) => reading.write(w, "Range", dialect),
            Self::Ir(reading) => reading.write(w, "IR", dialect),
            Self::Odometry(reading) => reading.write(w),
            Self::Ins(reading) => reading.write(w),
            Self::Inu(reading) => reading.write(w),
            Self::Encoder(reading) => reading.write(w, dialect),
            Self::Tachometer(reading) => reading.write(w),
            Self::Touch(reading) => reading.write(w, "Touch", dialect),
            Self::TouchArray(reading) => reading.write(w, "TouchArray", dialect),
            Self::VictSensor(reading) => reading.write(w),
            Self::VictRfid(reading) => reading.write(w),
            Self::HumanMotion(reading) => reading.write(w),
            Self::Rfid(reading) => reading.write(w),
            Self::Sound(reading) => reading.write(w),
            Self::Acoustic(reading) => reading.write(w),
            Self::Gps(reading) => reading.write(w),
            Self::Altitude(reading) => reading.write(w),
            Self::Acceleration(reading) => reading.write(w),
            Self::Imu(reading) => reading.write(w),
            Self::Compass(reading) => reading.write(w),
            Self::MissionTime(reading) => reading.write(w),
            Self::ObjectSensor(reading) => reading.write(w),
            Self::Ball(reading) => reading.write(w),
            Self::Gas(reading) => reading.write(w),
        }
    }
}

/// One sensor of a line that may hold several: `{Name n Key v}` in UT2004, `{Name n} {Key v}` in UDK.
///
/// A name with a blank cannot stand in a compound segment and is written in the simple form.
fn write_item(w: &mut LineWriter, dialect: Dialect, name: &str, key: &str, value: &str) {
    if dialect == Dialect::Ut2004 && !name.is_empty() && !name.contains([' ', '\t']) {
        w.compound(&[("Name", name), (key, value)]);
    } else {
        w.text_unless_empty("Name", name).text(key, value);
    }
}
