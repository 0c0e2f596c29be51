//! Faults: what goes wrong between session and client, and inside the robot.

use crate::sim::noise::Noise;
use crate::sim::scenario::{FaultKind, FaultSpec};
use crate::time::{Span, Stamp};

/// The faults of a session, with what has begun and ended so far.
pub(super) struct Faults {
    specs: Vec<FaultSpec>,
    began: Stamp,
    /// Whether each sudden fault has struck.
    struck: Vec<bool>,
    noise: Noise,
}

/// What faults do to the inside of one robot at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Inside {
    /// Types and names of silenced sensors; an empty text means all.
    pub(super) silenced: Vec<String>,
    /// Names of units whose tilt is stuck; an empty text means all.
    pub(super) tilt_stuck: Vec<String>,
    /// Bound of the tilt in radians.
    pub(super) tilt_bound_rad: Option<f64>,
    /// Sides whose wheels are blocked.
    pub(super) jammed: [bool; 2],
    /// Factor on the odometry.
    pub(super) odometry_scale: f64,
    /// What stamps are off by.
    pub(super) clock_offset: Span,
}

/// A fault that happens once.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sudden {
    pub(super) kind: FaultKind,
    pub(super) what: String,
    pub(super) value: Option<f64>,
}

const DEFAULT_DELAY_S: f64 = 0.5;
const DEFAULT_REORDER_S: f64 = 0.5;
const DEFAULT_SPLIT_S: f64 = 0.05;

impl Faults {
    pub(super) fn new(specs: Vec<FaultSpec>, began: Stamp, seed: u64) -> Self {
        let struck = vec![false; specs.len()];
        Self { specs, began, struck, noise: Noise::new(seed, u64::MAX) }
    }

    fn active(&self, robot: &str, now: Stamp) -> impl Iterator<Item = &FaultSpec> {
        let since = (now - self.began).seconds();
        self.specs.iter().filter(move |fault| {
            let over = fault.for_s.is_some_and(|length| since >= fault.at_s + length);
            since >= fault.at_s && !over && fault.robot.as_ref().is_none_or(|name| name == robot)
        })
    }

    /// What faults do inside a robot at `now`.
    pub(super) fn inside(&self, robot: &str, now: Stamp) -> Inside {
        let mut inside = Inside { odometry_scale: 1.0, ..Inside::default() };
        for fault in self.active(robot, now) {
            let what = fault.what.clone().unwrap_or_default();
            match fault.kind {
                FaultKind::SensorLoss => inside.silenced.push(what),
                FaultKind::TiltStuck => inside.tilt_stuck.push(what),
                FaultKind::TiltLimits => {
                    inside.tilt_bound_rad = Some(fault.value.unwrap_or(0.2).abs());
                }
                FaultKind::WheelStuck => {
                    inside.jammed[0] |= !what.eq_ignore_ascii_case("right");
                    inside.jammed[1] |= !what.eq_ignore_ascii_case("left");
                }
                FaultKind::OdometryScale => inside.odometry_scale *= fault.value.unwrap_or(1.0),
                FaultKind::ClockJump => {
                    inside.clock_offset += Span::from_seconds(fault.value.unwrap_or(1.0));
                }
                _ => {}
            }
        }
        inside
    }

    /// The sudden faults that strike a robot now: each strikes each session once.
    pub(super) fn strike(&mut self, robot: &str, now: Stamp) -> Vec<Sudden> {
        let since = (now - self.began).seconds();
        let mut striking = Vec::new();
        for (fault, struck) in self.specs.iter().zip(&mut self.struck) {
            let sudden = matches!(fault.kind, FaultKind::Disconnect | FaultKind::Shove);
            let mine = fault.robot.as_ref().is_none_or(|name| name == robot);
            if sudden && mine && !*struck && since >= fault.at_s {
                *struck = true;
                striking.push(Sudden {
                    kind: fault.kind,
                    what: fault.what.clone().unwrap_or_default(),
                    value: fault.value,
                });
            }
        }
        striking
    }

    /// What faults do to the lines of a robot's connection at `now`.
    pub(super) fn shaping(&mut self, robot: &str, now: Stamp) -> Shaping<'_> {
        let active = self
            .active(robot, now)
            .filter(|fault| {
                matches!(
                    fault.kind,
                    FaultKind::Drop
                        | FaultKind::Delay
                        | FaultKind::Reorder
                        | FaultKind::Duplicate
                        | FaultKind::Split
                        | FaultKind::Garble
                        | FaultKind::Stall
                )
            })
            .cloned()
            .collect();
        Shaping { active, noise: &mut self.noise }
    }

    /// Whether nothing comes through to a robot's client at `now`.
    pub(super) fn stalled(&self, robot: &str, now: Stamp) -> bool {
        self.active(robot, now).any(|fault| fault.kind == FaultKind::Stall)
    }
}

/// Line faults that are active now.
pub(super) struct Shaping<'a> {
    active: Vec<FaultSpec>,
    noise: &'a mut Noise,
}

/// A line, or a part of one, on its way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub(super) bytes: Vec<u8>,
    /// How late it comes.
    pub(super) late: Span,
    /// Whether what is sent after it may arrive before it.
    pub(super) overtaken: bool,
}

impl Shaping<'_> {
    /// The pieces of a line.
    pub(super) fn shape(&mut self, line: Vec<u8>) -> Vec<Piece> {
        let mut line = line;
        let mut overtaken = false;
        let mut late = Span::ZERO;
        let mut copies = 1;
        let mut cut_late = None;
        for fault in &self.active {
            if !concerns(fault, &line) {
                continue;
            }
            let value = fault.value;
            // A certain fault draws no number, so that it does not disturb the others.
            let mut chance = || {
                let probability = value.unwrap_or(1.0);
                probability >= 1.0 || self.noise.unit() < probability
            };
            match fault.kind {
                FaultKind::Drop if chance() => return Vec::new(),
                FaultKind::Duplicate if chance() => copies += 1,
                FaultKind::Garble if chance() => garble(&mut line, self.noise),
                FaultKind::Delay => late += Span::from_seconds(value.unwrap_or(DEFAULT_DELAY_S)),
                FaultKind::Reorder => {
                    let most_s = value.unwrap_or(DEFAULT_REORDER_S);
                    late += Span::from_seconds(most_s * self.noise.unit());
                    overtaken = true;
                }
                FaultKind::Split => {
                    cut_late = Some(Span::from_seconds(value.unwrap_or(DEFAULT_SPLIT_S)));
                }
                // Sent, but held back: later than now by the least there is.
                FaultKind::Stall => late += Span(1),
                _ => {}
            }
        }
        let mut pieces = Vec::new();
        for _ in 0..copies {
            match cut_late {
                // Other lines must not come between the two parts of one.
                Some(gap) if line.len() > 1 => {
                    let (head, tail) = line.split_at(line.len() / 2);
                    let piece = |bytes: &[u8], late| Piece {
                        bytes: bytes.to_vec(),
                        late,
                        overtaken: false,
                    };
                    pieces.extend([piece(head, late), piece(tail, late + gap)]);
                }
                _ => pieces.push(Piece { bytes: line.clone(), late, overtaken }),
            }
        }
        pieces
    }
}

/// Whether a fault's `what` means this line: its verb, its sensor type or a sensor's name.
fn concerns(fault: &FaultSpec, line: &[u8]) -> bool {
    let Some(what) = fault.what.as_deref() else { return true };
    let text = String::from_utf8_lossy(line);
    let verb = text.split([' ', '{', '\r']).next().unwrap_or_default();
    verb.eq_ignore_ascii_case(what)
        || text.contains(&format!("{{Type {what}}}"))
        || text.contains(&format!("{{Name {what}"))
}

/// Changes one octet before the line end into another printable one.
fn garble(line: &mut [u8], noise: &mut Noise) {
    let end = line.len().saturating_sub(2);
    if end == 0 {
        return;
    }
    let at = ((noise.unit() * end as f64) as usize).min(end - 1);
    let other = b'!' + (noise.unit() * 90.0) as u8;
    line[at] = if line[at] == other { b'~' } else { other };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: FaultKind, what: Option<&str>, value: Option<f64>) -> FaultSpec {
        FaultSpec {
            at_s: 1.0,
            for_s: Some(2.0),
            robot: None,
            kind,
            what: what.map(str::to_owned),
            value,
        }
    }

    fn shaped(fault: FaultSpec, at_s: f64, line: &str) -> Vec<Piece> {
        let mut faults = Faults::new(vec![fault], Stamp(0), 1);
        faults.shaping("R1", Stamp::from_seconds(at_s)).shape(line.as_bytes().to_vec())
    }

    const LASER: &str = "SEN {Time 1.00} {Type RangeScanner} {Name Scanner1} {Range 1.0}\r\n";

    #[test]
    fn a_fault_acts_in_its_time_and_on_its_lines_only() {
        let drop = || fault(FaultKind::Drop, Some("RangeScanner"), None);
        assert_eq!(shaped(drop(), 0.5, LASER).len(), 1);
        assert_eq!(shaped(drop(), 1.5, LASER).len(), 0);
        assert_eq!(shaped(drop(), 3.0, LASER).len(), 1);
        assert_eq!(shaped(drop(), 1.5, "STA {Type GroundVehicle}\r\n").len(), 1);
        assert_eq!(
            shaped(fault(FaultKind::Drop, Some("STA"), None), 1.5, "STA {Time 1}\r\n").len(),
            0
        );
    }

    #[test]
    fn lines_are_doubled_split_delayed_and_garbled() {
        assert_eq!(shaped(fault(FaultKind::Duplicate, None, None), 2.0, LASER).len(), 2);
        let split = shaped(fault(FaultKind::Split, None, Some(0.1)), 2.0, LASER);
        assert_eq!([&split[0].bytes[..], &split[1].bytes].concat(), LASER.as_bytes());
        assert_eq!(split[1].late, Span::from_millis(100));
        let late = shaped(fault(FaultKind::Delay, None, Some(0.3)), 2.0, LASER);
        assert_eq!((late[0].late, late[0].overtaken), (Span::from_millis(300), false));
        let disordered = shaped(fault(FaultKind::Reorder, None, Some(0.3)), 2.0, LASER);
        let late_s = disordered[0].late.seconds();
        assert!(disordered[0].overtaken && late_s > 0.0 && late_s < 0.3, "{late_s} s");
        let garbled = shaped(fault(FaultKind::Garble, None, None), 2.0, LASER);
        let changed = garbled[0].bytes.iter().zip(LASER.bytes()).filter(|(a, b)| **a != *b).count();
        assert_eq!((garbled[0].bytes.len(), changed), (LASER.len(), 1));
    }

    #[test]
    fn sudden_faults_strike_once() {
        let mut faults = Faults::new(vec![fault(FaultKind::Shove, None, None)], Stamp(0), 1);
        assert!(faults.strike("R1", Stamp::from_seconds(0.9)).is_empty());
        assert_eq!(faults.strike("R1", Stamp::from_seconds(1.1)).len(), 1);
        assert!(faults.strike("R1", Stamp::from_seconds(1.2)).is_empty());
    }
}
