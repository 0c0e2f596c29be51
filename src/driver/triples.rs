//! Triples of odometry, tilt and laser from a recorded session.

use super::replay::Replay;
use crate::acquisition::{Synchronised, Synchroniser, TiltMount};
use crate::mission::{Agent, MotionTracker};
use crate::protocol::message::Sen;
use crate::protocol::{Message, parse};
use crate::record::{Recording, What};
use crate::robot::{HeadReading, InsReading, OdometryReading, Rig};
use crate::time::{Span, Stamp};
use nalgebra::Isometry3;

/// Why a session yields no triples.
#[derive(Debug, thiserror::Error)]
pub enum TriplesError {
    /// An operator event of the recording is not readable.
    #[error("the recording holds an unreadable operator event")]
    Operator(#[from] crate::mission::OperatorDecodeError),
    /// No robot was ever made.
    #[error("the session never had a robot in service")]
    NoRobot,
    /// The robot's laser cannot be tilted.
    #[error("the robot has no laser on a tilt")]
    NoTilt,
}

/// Replays `recording` through `agent` and puts its lines, tilt readings and odometry together. The
/// rays of a line are taken to be cast `line_lag` after its stamp, by default as the session's own
/// calibration found, else at the stamp itself.
///
/// # Errors
///
/// When there was no robot with a laser that tilts.
pub fn triples_of(
    agent: Agent,
    recording: &Recording,
    line_lag: Option<Span>,
) -> Result<Synchronised, TriplesError> {
    let mut replay = Replay::new(agent, recording);
    let mut gathered = Gathered::default();
    for entry in &recording.entries {
        let more = replay.step()?;
        match (&entry.what, replay.agent().running()) {
            (What::Received(line), Some(running)) => {
                gathered.message(&parse(line).message, running.rig());
            }
            // The odometry of a new robot begins at zero.
            (What::Connected, _) => gathered.motion.restart_wheels(),
            _ => {}
        }
        if !more {
            break;
        }
    }
    let running = replay.agent().running().ok_or(TriplesError::NoRobot)?;
    let laser = running.rig().laser.as_ref().ok_or(TriplesError::NoTilt)?;
    let mount = TiltMount::of(&laser.head).ok_or(TriplesError::NoTilt)?;
    let found = || running.line_lag().unwrap_or(Span::ZERO);
    let lag = line_lag.unwrap_or_else(found);
    let mut synchronised = gathered.synchronised(lag);
    synchronised.record = synchronised.record.on(mount);
    Ok(synchronised)
}

#[derive(Default)]
struct Gathered {
    lines: Vec<crate::scan::LaserLine>,
    readings: Synchroniser,
    motion: MotionTracker,
    frame_from_robot: Isometry3<f64>,
    latest: Stamp,
}

impl Gathered {
    fn message(&mut self, message: &Message, rig: &Rig) {
        if let Message::Sen(Sen::RangeScanner(line)) = message {
            // A line that cannot be used is none; the agent has warned of it.
            self.lines.extend(rig.laser_line(line, Some(self.latest)));
            return;
        }
        if let Some(stamp) = message.time() {
            self.latest = self.latest.max(stamp);
        }
        match message {
            Message::Sen(Sen::Odometry(odometry)) => self.odometry(&rig.odometry(odometry)),
            Message::Sen(Sen::Ins(ins)) => self.attitude(&rig.ins(ins)),
            Message::Sen(Sen::Inu(inu)) => self.attitude(&rig.inu(inu)),
            Message::MisSta(state) => self.joints(rig.head_reading(state)),
            Message::AsTa(state) => self.joints(rig.actuator_reading(state)),
            _ => {}
        }
    }

    fn joints(&mut self, reading: Option<HeadReading>) {
        if let Some(reading) = reading
            && let Some(tilt) = reading.tilt
        {
            self.readings.tilt(reading.stamp, tilt.angle_rad);
        }
    }

    fn attitude(&mut self, reading: &InsReading) {
        self.motion.attitude(reading.into());
    }

    fn odometry(&mut self, reading: &OdometryReading) {
        if let Some((increment, _)) = self.motion.wheels(reading.into()) {
            self.frame_from_robot *= increment;
        }
        self.readings.pose(reading.stamp.unwrap_or(self.latest), self.frame_from_robot);
    }

    fn synchronised(mut self, lag: Span) -> Synchronised {
        for line in self.lines {
            self.readings.line(line.stamp + lag, line);
        }
        self.readings.triples()
    }
}
