use super::clock::{ClockStep, StampClock};
use super::config::AcquisitionConfig;
use super::servo::ServoLaw;
use super::track::{AxisReading, AxisTrack};
use super::{HeadCommand, HeadEvent};
use crate::robot::{Demand, HeadPose, JointAngle, ScanHead};
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What is known of the scan head over time: clocks, joints, and the rhythm of the laser.
///
/// Sweeps come and go; this stays, so that what one sweep learns serves the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeadControl {
    head: ScanHead,
    /// The map between the session's clock and the server's, from everything but the scanner.
    clock: StampClock,
    /// The same from the scanner's stamps alone, for a server that stamps nothing else.
    scanner_clock: StampClock,
    /// The tilt joint.
    pub(super) tilt: AxisTrack,
    /// The pan joint.
    pub(super) pan: AxisTrack,
    /// When lines come, and how many beams they have.
    pub(super) rhythm: LineRhythm,
    latency: Span,
    /// Typical time from the clock's lower bound at sending until a command is in force.
    pub(super) command_delay: Span,
    /// Typical time from a line's stamp to the casting of its rays.
    pub(super) line_lag: Span,
}

/// UT2004 stamps scanner lines with the time of the burst before, so a clock that hears nothing else
/// must take such a stamp for this much later to stay on the safe side.
const SCANNER_LAG: Span = Span::from_millis(300);

impl HeadControl {
    /// A head at rest at zero, as a robot is created, whose joints follow `law` where one is known.
    pub fn new(head: &ScanHead, law: Option<ServoLaw>, config: &AcquisitionConfig) -> Self {
        let track = |axis: Option<&crate::robot::Axis>| {
            let law = match (law, axis.and_then(|a| a.speed_rad_s)) {
                (Some(ServoLaw::Hinge { gap_rad, .. }), Some(speed_rad_s)) => {
                    Some(ServoLaw::Hinge { speed_rad_s, gap_rad })
                }
                (law, _) => law,
            };
            AxisTrack::new(law, axis.and_then(|a| a.limits), 0.0)
        };
        let latency = config.command_latency();
        Self {
            head: head.clone(),
            clock: StampClock::new(),
            scanner_clock: StampClock::new(),
            tilt: track(head.tilt()),
            pan: track(head.pan()),
            rhythm: LineRhythm::default(),
            latency,
            command_delay: Span::from_seconds(0.5 * latency.seconds()),
            line_lag: Span::ZERO,
        }
    }

    /// Takes note of an event; true if the server's clock jumped and all known times are void.
    pub(super) fn note(&mut self, event: &HeadEvent<'_>, now: Arrival) -> bool {
        let step = match event {
            HeadEvent::Stamped(stamp) => self.clock.observe(*stamp, now),
            HeadEvent::Joints(reading) => {
                // A late reading says nothing about the clock, and must not look like a jump back.
                let in_time = self.clock.latest().is_none_or(|latest| reading.stamp >= latest);
                let step = match in_time {
                    true => self.clock.observe(reading.stamp, now),
                    false => ClockStep::Steady,
                };
                let read = |track: &mut AxisTrack, joint: Option<JointAngle>| {
                    if let Some(JointAngle { angle_rad, half_width_rad }) = joint {
                        let stamp = reading.stamp;
                        track.read(AxisReading { stamp, angle_rad, half_width_rad });
                    }
                };
                if step == ClockStep::Steady {
                    read(&mut self.tilt, reading.tilt);
                    read(&mut self.pan, reading.pan);
                }
                step
            }
            HeadEvent::Line(line) => {
                self.rhythm.note(line, now);
                let step = self.scanner_clock.observe(line.stamp + SCANNER_LAG, now);
                if self.clock.latest().is_some() { ClockStep::Steady } else { step }
            }
            HeadEvent::Tick => ClockStep::Steady,
        };
        if step == ClockStep::Steady {
            return false;
        }
        self.tilt.forget_times();
        self.pan.forget_times();
        self.rhythm.forget_times();
        true
    }

    /// The clock to go by.
    pub(super) fn clock(&self) -> &StampClock {
        match self.clock.latest() {
            Some(_) => &self.clock,
            None => &self.scanner_clock,
        }
    }

    /// The latest stamp at which a command sent `now` is in force; `None` while the server's clock
    /// is unknown.
    pub(super) fn in_force(&self, now: Arrival) -> Option<Stamp> {
        self.clock().in_force_by(now, self.latency)
    }

    /// Commands the tilt joint and takes note of it.
    pub(super) fn command_tilt(&mut self, demand: Demand, now: Arrival) -> HeadCommand {
        if let Some(stamp) = self.expected_in_force(now) {
            self.tilt.demand(stamp, demand);
        }
        HeadCommand { pan: None, tilt: Some(demand) }
    }

    /// Commands the pan joint and takes note of it.
    pub(super) fn command_pan(&mut self, demand: Demand, now: Arrival) -> HeadCommand {
        if let Some(stamp) = self.expected_in_force(now) {
            self.pan.demand(stamp, demand);
        }
        HeadCommand { pan: Some(demand), tilt: None }
    }

    fn expected_in_force(&self, now: Arrival) -> Option<Stamp> {
        self.clock().earliest(now).map(|stamp| stamp + self.command_delay)
    }

    /// The head's joints and mounts.
    pub fn head(&self) -> &ScanHead {
        &self.head
    }

    /// The scan frame: the sensor at zero pan and tilt.
    pub(super) fn robot_from_scan(&self) -> Isometry3<f64> {
        self.head.robot_from_device(HeadPose::default())
    }

    /// The sensor under `pose` in the scan frame.
    pub(super) fn scan_from_sensor(&self, pose: HeadPose) -> Isometry3<f64> {
        self.robot_from_scan().inverse() * self.head.robot_from_device(pose)
    }
}

/// When lines come, and how many beams they have.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct LineRhythm {
    recent: VecDeque<Stamp>,
    last_arrival: Option<Arrival>,
    beams: Option<usize>,
    other: Option<(usize, u32)>,
}

impl LineRhythm {
    /// The laser's interval until it is measured: the UT2004 timer and UDK's ScanInterval.
    const USUAL_INTERVAL: Span = Span::from_millis(200);
    const KEPT: usize = 16;
    /// Lines of another length that make it the usual one: a cut line comes alone.
    const CONVINCING: u32 = 3;

    fn note(&mut self, line: &LaserLine, now: Arrival) {
        self.last_arrival = Some(now);
        if self.recent.back().is_none_or(|&last| line.stamp > last) {
            self.recent.push_back(line.stamp);
            if self.recent.len() > Self::KEPT {
                self.recent.pop_front();
            }
        }
        let beams = line.len();
        if self.beams.is_none_or(|usual| usual == beams) {
            self.beams = Some(beams);
            self.other = None;
            return;
        }
        let seen = self.other.filter(|&(other, _)| other == beams).map_or(1, |(_, n)| n + 1);
        self.other = Some((beams, seen));
        if seen >= Self::CONVINCING {
            self.beams = Some(beams);
            self.other = None;
        }
    }

    fn forget_times(&mut self) {
        self.recent.clear();
    }

    /// Median time between lines.
    pub(super) fn interval(&self) -> Span {
        let mut gaps: Vec<Span> =
            self.recent.iter().zip(self.recent.iter().skip(1)).map(|(a, b)| *b - *a).collect();
        gaps.sort();
        gaps.get(gaps.len() / 2).copied().unwrap_or(Self::USUAL_INTERVAL)
    }

    /// Whether a line has the length that lines of this scanner have.
    pub(super) fn is_whole(&self, line: &LaserLine) -> bool {
        self.beams.is_none_or(|beams| beams == line.len()) && !line.is_empty()
    }

    /// When the last line arrived.
    pub(super) fn last_arrival(&self) -> Option<Arrival> {
        self.last_arrival
    }
}
