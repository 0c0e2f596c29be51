//! Messages from the server, one file per family.

mod conf;
mod die;
mod eff;
mod geo;
mod ground_truth;
mod links;
mod nfo;
mod res;
pub mod sen;
mod sta;

pub use conf::{
    ActuatorConf, ActuatorLinkConf, CameraConf, Conf, GripperConf, ItemConf, ItemsConf,
    PackageConf, PackageLinkConf, RangeScannerConf, RobotConf, SonarConf, VictSensorConf,
};
pub use die::Die;
pub use eff::Eff;
pub use geo::{ActuatorGeo, Geo, ItemsGeo, Mounting, PackageGeo, PackageLinkGeo, RobotGeo};
pub use ground_truth::GroundTruth;
pub use links::{AsTa, LinkState, MisSta};
pub use nfo::{Greeting, Nfo};
pub use res::{CameraResult, Res, SetResult};
pub use sen::Sen;
pub use sta::{ObjectSta, Sta};

use super::encode::LineWriter;
use super::fields::Fields;
use super::problem::Problem;
use super::{Dialect, RawLine};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// A line from the server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// Greeting, start poses, path nodes.
    Nfo(Nfo),
    /// State of the robot.
    Sta(Sta),
    /// State of one object of the world controller.
    ObjectSta(ObjectSta),
    /// A sensor reading.
    Sen(Sen),
    /// The truth: for scoring, never for estimation.
    GroundTruth(GroundTruth),
    /// State of a mission package (UT2004).
    MisSta(MisSta),
    /// State of an actuator (UDK).
    AsTa(AsTa),
    /// State of an effector (UDK).
    Eff(Eff),
    /// Answer to GETGEO.
    Geo(Geo),
    /// Answer to GETCONF.
    Conf(Conf),
    /// Answer to SET (UT2004).
    Res(Res),
    /// The robot was destroyed by the game.
    Die(Die),
    /// A verb or a type that is not known, or a known one without its essentials. Nothing of the
    /// line is lost.
    Unknown(RawLine),
}

/// What one line was read as, and what was wrong with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parsed {
    /// The message; [`Message::Unknown`] if the line could not be understood.
    pub message: Message,
    /// Damage, in wire order; empty for a good line, an unknown type included.
    pub problems: Vec<Problem>,
}

impl Message {
    /// The line's own time, if the server wrote one. UT2004 does not stamp odometry, encoders, INS
    /// and touch.
    pub fn time(&self) -> Option<Stamp> {
        match self {
            Self::Sta(sta) => sta.time,
            Self::Sen(sen) => sen.time(),
            Self::GroundTruth(truth) => truth.time,
            Self::MisSta(state) => state.time,
            Self::AsTa(state) => state.time,
            Self::Eff(state) => state.time,
            Self::Res(answer) => answer.time,
            Self::Nfo(_)
            | Self::ObjectSta(_)
            | Self::Geo(_)
            | Self::Conf(_)
            | Self::Die(_)
            | Self::Unknown(_) => None,
        }
    }
}

/// Reads one line from a server, without its line end, in either dialect.
///
/// Never fails: what cannot be understood is [`Message::Unknown`], what is damaged is told in
/// `problems`. A message without an essential value (a laser line with a broken range) is unknown
/// as a whole; an optional value that cannot be read stays among the extra segments.
pub fn parse(line: &[u8]) -> Parsed {
    let (verb, mut fields) = Fields::of_line(line);
    let (message, problem) = match read(verb, &mut fields) {
        Ok(Some(message)) => (message, None),
        Ok(None) => (unknown(line), None),
        Err(problem) => (unknown(line), Some(problem)),
    };
    let mut problems = fields.problems;
    problems.extend(problem);
    Parsed { message, problems }
}

fn unknown(line: &[u8]) -> Message {
    Message::Unknown(RawLine::parse(line, &mut Vec::new()))
}

fn read(verb: &[u8], fields: &mut Fields<'_>) -> Result<Option<Message>, Problem> {
    let upper = verb.to_ascii_uppercase();
    Ok(Some(match upper.as_slice() {
        b"SEN" => return read_sen(fields),
        b"STA" => match ObjectSta::read(fields) {
            Some(object) => Message::ObjectSta(object),
            None => Message::Sta(Sta::read(fields)),
        },
        b"MISSTA" => Message::MisSta(MisSta::read(fields)),
        b"ASTA" => Message::AsTa(AsTa::read(fields)),
        b"EFF" => Message::Eff(Eff::read(fields)),
        b"NFO" => Message::Nfo(Nfo::read(fields)?),
        b"GEO" => Message::Geo(Geo::read(fields)?),
        b"CONF" => Message::Conf(Conf::read(fields)?),
        b"RES" => Message::Res(Res::read(fields)?),
        b"DIE" => Message::Die(Die::read(fields)),
        _ => return Ok(None),
    }))
}

fn read_sen(fields: &mut Fields<'_>) -> Result<Option<Message>, Problem> {
    let type_name = fields.take("Type");
    let type_name = fields.require("Type", type_name)?;
    for (kind, movable) in [(&b"GroundTruth"[..], false), (b"GroundTruthMovable", true)] {
        if type_name.eq_ignore_ascii_case(kind) {
            return GroundTruth::read(fields, movable).map(|it| Some(Message::GroundTruth(it)));
        }
    }
    Ok(Sen::read(type_name, fields)?.map(Message::Sen))
}

/// Writes a message as a server of `dialect` does, with CR LF.
///
/// Decimals, blanks, order and compound segments are the dialect's. Values are formatted and never
/// truncated here: the simulated sensor has put them on the wire's decimal grid before, and on that
/// grid `parse(encode(m)) == m`.
pub fn encode_message(message: &Message, dialect: Dialect) -> Vec<u8> {
    let line = |verb: &str, write: &dyn Fn(&mut LineWriter)| {
        let mut writer = LineWriter::new(verb);
        write(&mut writer);
        writer.finish()
    };
    match message {
        Message::Nfo(nfo) => line("NFO", &|w| nfo.write(w, dialect)),
        Message::Sta(sta) => line("STA", &|w| sta.write(w, dialect)),
        Message::ObjectSta(object) => line("STA", &|w| object.write(w, dialect)),
        Message::Sen(sen) => line("SEN", &|w| sen.write(w, dialect)),
        Message::GroundTruth(truth) => line("SEN", &|w| truth.write(w, dialect)),
        Message::MisSta(state) => line("MISSTA", &|w| state.write(w, dialect)),
        Message::AsTa(state) => line("ASTA", &|w| state.write(w)),
        Message::Eff(state) => line("EFF", &|w| state.write(w)),
        Message::Geo(geo) => line("GEO", &|w| geo.write(w, dialect)),
        Message::Conf(conf) => line("CONF", &|w| conf.write(w, dialect)),
        Message::Res(answer) => line("RES", &|w| answer.write(w)),
        Message::Die(die) => line("DIE", &|w| die.write(w)),
        Message::Unknown(raw) => raw.encode(),
    }
}
