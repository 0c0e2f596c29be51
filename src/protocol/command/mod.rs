//! Commands from the client, one file per command.

mod act;
mod avatar;
mod camera;
mod control;
mod drive;
mod init;
mod mispkg;
mod query;
mod set;
mod trace;

pub use act::{Act, ActLink};
pub use avatar::{Goto, Move};
pub use camera::CameraCommand;
pub use control::{Control, ControlAction, Waypoints};
pub use drive::{Drive, DriveForm, MultiDrive, WheelCommand};
pub use init::Init;
pub use mispkg::{MisPkg, MisPkgForm, MisPkgLink, Order};
pub use query::Query;
pub use set::{Set, SetForm};
pub use trace::{Pause, Trace};

use super::encode::LineWriter;
use super::fields::Fields;
use super::problem::Problem;
use super::{Dialect, RawLine};
use serde::{Deserialize, Serialize};

/// A line to the server.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Creates the robot; unanswered.
    Init(Init),
    /// `GETSTARTPOSES`, answered by NFO.
    GetStartPoses,
    /// `GETPATHNODES` (UDK), answered by NFO.
    GetPathNodes,
    /// `GETCLOSESTPATHNODE` (UDK), answered by NFO; its arguments are not documented.
    GetClosestPathNode(RawLine),
    /// Moves the robot; holds until the next one.
    Drive(Drive),
    /// Several joints to absolute angles (UT2004).
    MultiDrive(MultiDrive),
    /// Links of a mission package (UT2004).
    MisPkg(MisPkg),
    /// Links of an actuator (UDK).
    Act(Act),
    /// Asks an item to do something; answered by RES in UT2004.
    Set(Set),
    /// `GETGEO`, answered by GEO.
    GetGeo(Query),
    /// `GETCONF`, answered by CONF.
    GetConf(Query),
    /// Coloured marks behind the robot (UT2004).
    Trace(Trace),
    /// The 2.x predecessor of MISPKG and SET Camera.
    Camera(CameraCommand),
    /// `PAUSE`; its effect is not known.
    Pause(Pause),
    /// World controller.
    Control(Control),
    /// Avatars (UDK).
    Move(Move),
    /// Avatars (UDK).
    Goto(Goto),
    /// A verb that is not known, or one whose arguments are not documented. Nothing is lost.
    Unknown(RawLine),
}

/// What one line from a client was read as, and what was wrong with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ParsedCommand {
    /// The command; servers ignore [`Command::Unknown`] in silence.
    pub command: Command,
    /// Damage, in wire order.
    pub problems: Vec<Problem>,
}

/// Reads one line from a client, without its line end, as generously as any server did.
///
/// Keys and flags are taken in any case, vectors with or without commas, numbers as the engine
/// takes them (the longest number at the front, else 0; noted as a problem). Never fails.
pub fn parse_command(line: &[u8]) -> ParsedCommand {
    let (verb, mut fields) = Fields::of_line(line);
    let raw = || RawLine::parse(line, &mut Vec::new());
    let upper = verb.to_ascii_uppercase();
    let fields_ref = &mut fields;
    let command = match upper.as_slice() {
        b"INIT" => Command::Init(Init::read(fields_ref)),
        b"GETSTARTPOSES" => Command::GetStartPoses,
        b"GETPATHNODES" => Command::GetPathNodes,
        b"GETCLOSESTPATHNODE" => Command::GetClosestPathNode(raw()),
        b"DRIVE" => Command::Drive(Drive::read(fields_ref)),
        b"MULTIDRIVE" => Command::MultiDrive(MultiDrive::read(fields_ref)),
        b"MISPKG" => Command::MisPkg(MisPkg::read(fields_ref)),
        b"ACT" => Command::Act(Act::read(fields_ref)),
        b"SET" => Command::Set(Set::read(fields_ref)),
        b"GETGEO" => Command::GetGeo(Query::read(fields_ref)),
        b"GETCONF" => Command::GetConf(Query::read(fields_ref)),
        b"TRACE" => Command::Trace(Trace::read(fields_ref)),
        b"CAMERA" => Command::Camera(CameraCommand::read(fields_ref)),
        b"PAUSE" => Command::Pause(Pause::read(fields_ref)),
        b"CONTROL" => Command::Control(Control::read(fields_ref)),
        b"MOVE" => Command::Move(Move::read(fields_ref)),
        b"GOTO" => Command::Goto(Goto::read(fields_ref)),
        _ => Command::Unknown(raw()),
    };
    ParsedCommand { command, problems: fields.problems }
}

/// Writes a command as the servers of `dialect` want it, with CR LF.
///
/// Flags are lower case, numbers carry no exponent and as many digits as it takes to read them back
/// unchanged, ACT counts links from 0 and MISPKG from 1.
pub fn encode_command(command: &Command, dialect: Dialect) -> Vec<u8> {
    let line = |verb: &str, write: &dyn Fn(&mut LineWriter)| {
        let mut writer = LineWriter::new(verb);
        write(&mut writer);
        writer.finish()
    };
    match command {
        Command::Init(init) => line("INIT", &|w| init.write(w)),
        Command::GetStartPoses => line("GETSTARTPOSES", &|_| {}),
        Command::GetPathNodes => line("GETPATHNODES", &|_| {}),
        Command::Drive(drive) => line("DRIVE", &|w| drive.write(w)),
        Command::MultiDrive(drive) => line("MULTIDRIVE", &|w| drive.write(w)),
        Command::MisPkg(package) => line("MISPKG", &|w| package.write(w, dialect)),
        Command::Act(act) => line("ACT", &|w| act.write(w)),
        Command::Set(set) => line("SET", &|w| set.write(w)),
        Command::GetGeo(query) => line("GETGEO", &|w| query.write(w)),
        Command::GetConf(query) => line("GETCONF", &|w| query.write(w)),
        Command::Trace(trace) => line("TRACE", &|w| trace.write(w)),
        Command::Camera(camera) => line("CAMERA", &|w| camera.write(w)),
        Command::Pause(pause) => line("PAUSE", &|w| pause.write(w)),
        Command::Control(control) => line("CONTROL", &|w| control.write(w)),
        Command::Move(walk) => line("MOVE", &|w| walk.write(w)),
        Command::Goto(goto) => line("GOTO", &|w| goto.write(w)),
        Command::GetClosestPathNode(raw) | Command::Unknown(raw) => raw.encode(),
    }
}
