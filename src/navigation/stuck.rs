use super::{DriveCommand, Pose2};
use crate::geometry::wrap_pi;
use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// When the robot counts as in trouble.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StuckConfig {
    /// Time over which motion is compared with commands, in seconds. [0.5, 10]
    pub window_s: f64,
    /// Commanded distance within the window below which nothing is judged, in metres. (0, 1]
    pub least_distance_m: f64,
    /// Commanded turn within the window below which nothing is judged, in radians. (0, 3]
    pub least_turn_rad: f64,
    /// Share of the commanded motion below which the robot is stuck; skid steering turns at a third
    /// of the commanded rate on grippy floors. [0, 1]
    pub moving_share: f64,
    /// Share of the odometry's motion below which the wheels slip. [0, 1]
    pub gripping_share: f64,
    /// Motion without a command that counts as a push, in metres. (0, 1]
    pub push_m: f64,
    /// Time in which a stopped robot may still roll out and its odometry lag behind, in seconds.
    /// [0, 2]
    pub coast_s: f64,
    /// Time in which a robot that was told to move may still stand, in seconds: the way of the command
    /// and of the reading, and the motors. [0, 2]
    pub start_s: f64,
    /// Roll or pitch beyond which the robot may tip over, in radians. (0, 1.2]
    pub tilt_rad: f64,
}

impl Default for StuckConfig {
    fn default() -> Self {
        Self {
            window_s: 2.5,
            least_distance_m: 0.15,
            least_turn_rad: 0.5,
            moving_share: 0.2,
            gripping_share: 0.35,
            push_m: 0.10,
            coast_s: 1.0,
            start_s: 0.6,
            tilt_rad: 0.47,
        }
    }
}

/// What was commanded and what came of it, at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// When.
    pub arrival: Arrival,
    /// The command in force since the sample before.
    pub command: DriveCommand,
    /// Pose by the wheels.
    pub odometry: Pose2,
    /// Pose by anything that does not feel the wheels: INS, laser.
    pub observed: Option<Pose2>,
    /// Roll of the body in radians.
    pub roll_rad: f64,
    /// Pitch of the body in radians.
    pub pitch_rad: f64,
}

/// What is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Trouble {
    /// The wheels do not turn though they should.
    Stuck {
        /// Commanded motion: metres, or radians for a turn in place.
        commanded: f64,
        /// Measured motion in the same unit.
        moved: f64,
    },
    /// The wheels turn and the robot stays.
    Slipping {
        /// Motion by the wheels: metres, or radians for a turn in place.
        wheels: f64,
        /// Measured motion in the same unit.
        moved: f64,
    },
    /// The body leans so far that it may tip over.
    Tilted {
        /// Roll in radians.
        roll_rad: f64,
        /// Pitch in radians.
        pitch_rad: f64,
    },
    /// Something moved the robot while it was to stand.
    Pushed {
        /// By how much, metres.
        moved_m: f64,
    },
}

impl std::fmt::Display for Trouble {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Stuck { commanded, moved } => {
                write!(f, "stuck: {moved:.2} of {commanded:.2} commanded")
            }
            Self::Slipping { wheels, moved } => {
                write!(f, "slipping: {moved:.2} moved, {wheels:.2} by the wheels")
            }
            Self::Tilted { roll_rad, pitch_rad } => write!(
                f,
                "tilted: roll {:.0}°, pitch {:.0}°",
                roll_rad.to_degrees(),
                pitch_rad.to_degrees()
            ),
            Self::Pushed { moved_m } => write!(f, "pushed by {moved_m:.2} m"),
        }
    }
}

/// Compares what was commanded with what was measured over the last seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StuckDetector {
    config: StuckConfig,
    samples: VecDeque<Sample>,
    /// The way that the command in force moves the robot, and since when.
    way: Option<(Way, Arrival)>,
}

/// One moment, and whether the robot may still have to start.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Sample {
    motion: Motion,
    starting: bool,
}

/// Which way a command moves the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Way {
    Ahead,
    Back,
    Left,
    Right,
}

impl Way {
    fn of(command: DriveCommand) -> Option<Self> {
        if command.linear_mps != 0.0 {
            Some(if command.linear_mps > 0.0 { Self::Ahead } else { Self::Back })
        } else if command.angular_rps != 0.0 {
            Some(if command.angular_rps > 0.0 { Self::Left } else { Self::Right })
        } else {
            None
        }
    }
}

impl StuckDetector {
    /// A detector that has seen nothing.
    pub fn new(config: StuckConfig) -> Self {
        Self { config, samples: VecDeque::new(), way: None }
    }

    /// Forgets the past: after a recovery, a jump of the pose, a pause.
    pub fn reset(&mut self) {
        self.samples.clear();
        self.way = None;
    }

    /// Whether a body that rolls and pitches by so much, in radians, may tip over.
    pub fn leans(&self, roll_rad: f64, pitch_rad: f64) -> bool {
        roll_rad.abs().max(pitch_rad.abs()) > self.config.tilt_rad
    }

    /// Takes in a sample and says what is wrong, if anything. Leaning is reported at once, the rest
    /// when a whole window was seen.
    pub fn note(&mut self, motion: Motion) -> Option<Trouble> {
        let window = Span::from_seconds(self.config.window_s);
        let way = Way::of(motion.command);
        if self.way.map(|(way, _)| way) != way {
            self.way = way.map(|way| (way, motion.arrival));
        }
        let starting = self.way.is_some_and(|(_, since)| {
            motion.arrival - since <= Span::from_seconds(self.config.start_s)
        });
        self.samples.push_back(Sample { motion, starting });
        while self.samples.len() > 2 && motion.arrival - self.samples[1].motion.arrival >= window {
            self.samples.pop_front();
        }
        if self.leans(motion.roll_rad, motion.pitch_rad) {
            let Motion { roll_rad, pitch_rad, .. } = motion;
            return Some(Trouble::Tilted { roll_rad, pitch_rad });
        }
        if motion.arrival - self.samples[0].motion.arrival < window {
            return None;
        }
        self.judge()
    }

    fn judge(&self) -> Option<Trouble> {
        let config = &self.config;
        let (mut asked_m, mut asked_rad) = (0.0, 0.0);
        let (mut turned_by_wheels, mut turned) = (0.0, 0.0);
        for (before, after) in self.samples.iter().zip(self.samples.iter().skip(1)) {
            let may_stand = after.starting;
            let (before, after) = (&before.motion, &after.motion);
            if !may_stand {
                let dt_s = (after.arrival - before.arrival).seconds();
                asked_m += after.command.linear_mps * dt_s;
                asked_rad += after.command.angular_rps * dt_s;
            }
            turned_by_wheels += wrap_pi(after.odometry.yaw_rad - before.odometry.yaw_rad);
            if let (Some(a), Some(b)) = (before.observed, after.observed) {
                turned += wrap_pi(b.yaw_rad - a.yaw_rad);
            }
        }
        let (first, last) = (&self.samples.front()?.motion, &self.samples.back()?.motion);
        let by_wheels_m = last.odometry.distance_m(&first.odometry.point());
        let observed_m = match (first.observed, last.observed) {
            (Some(a), Some(b)) => Some(b.distance_m(&a.point())),
            _ => None,
        };
        let still = self.samples.iter().skip(1).all(|sample| sample.motion.command.is_stop());
        if still {
            let coasted = first.arrival + Span::from_seconds(config.coast_s);
            let mut motions = self.samples.iter().map(|sample| &sample.motion);
            let rest = motions.find(|motion| motion.arrival >= coasted)?;
            let moved_m = match (rest.observed, last.observed) {
                (Some(a), Some(b)) => b.distance_m(&a.point()),
                _ => last.odometry.distance_m(&rest.odometry.point()),
            };
            return (moved_m > config.push_m).then_some(Trouble::Pushed { moved_m });
        }
        // A window with motion both ways has little net command: nothing to judge it by.
        let (asked_m, asked_rad) = (asked_m.abs(), asked_rad.abs());
        if asked_m >= config.least_distance_m {
            let moved = observed_m.unwrap_or(by_wheels_m).min(by_wheels_m);
            if by_wheels_m < config.moving_share * asked_m {
                return Some(Trouble::Stuck { commanded: asked_m, moved });
            }
            if let Some(moved) = observed_m
                && by_wheels_m >= config.least_distance_m
                && moved < config.gripping_share * by_wheels_m
            {
                return Some(Trouble::Slipping { wheels: by_wheels_m, moved });
            }
        } else if asked_rad >= config.least_turn_rad {
            let by_wheels = turned_by_wheels.abs();
            if by_wheels < config.moving_share * asked_rad {
                return Some(Trouble::Stuck { commanded: asked_rad, moved: by_wheels });
            }
            // Skid steering slips by its nature: only a robot that hardly turns at all is in trouble.
            let hardly = 0.5 * config.moving_share * by_wheels;
            if observed_m.is_some() && turned.abs() < hardly {
                return Some(Trouble::Slipping { wheels: by_wheels, moved: turned.abs() });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs 6 s of samples at 5 Hz; `moves(command)` gives (by the wheels, by the laser) per second.
    fn run(
        command: DriveCommand,
        wheels: (f64, f64),
        laser: Option<(f64, f64)>,
        lean_rad: f64,
    ) -> Option<Trouble> {
        let mut detector = StuckDetector::new(StuckConfig::default());
        let (mut odometry, mut observed) = (Pose2::default(), Pose2::default());
        (0..30).find_map(|step| {
            odometry = odometry.driven(0.2 * wheels.0, 0.2 * wheels.1);
            if let Some((ahead, turn)) = laser {
                observed = observed.driven(0.2 * ahead, 0.2 * turn);
            }
            detector.note(Motion {
                arrival: Arrival::from_seconds(0.2 * f64::from(step)),
                command,
                odometry,
                observed: laser.map(|_| observed),
                roll_rad: 0.0,
                pitch_rad: lean_rad,
            })
        })
    }

    const AHEAD: DriveCommand = DriveCommand { linear_mps: 0.3, angular_rps: 0.0 };
    const ROUND: DriveCommand = DriveCommand { linear_mps: 0.0, angular_rps: 0.6 };

    #[test]
    fn driving_and_turning_as_commanded_is_no_trouble() {
        assert_eq!(run(AHEAD, (0.28, 0.0), Some((0.25, 0.01)), 0.1), None);
        assert_eq!(run(ROUND, (0.0, 0.6), Some((0.0, 0.2)), 0.0), None);
        assert_eq!(run(DriveCommand::STOP, (0.0, 0.0), Some((0.001, 0.0)), 0.0), None);
    }

    #[test]
    fn wheels_that_stand_are_stuck() {
        assert!(matches!(run(AHEAD, (0.01, 0.0), None, 0.0), Some(Trouble::Stuck { .. })));
        assert!(matches!(run(ROUND, (0.0, 0.02), None, 0.0), Some(Trouble::Stuck { .. })));
    }

    #[test]
    fn wheels_that_spin_in_place_slip() {
        let slips = run(AHEAD, (0.3, 0.0), Some((0.02, 0.0)), 0.0);
        assert!(matches!(slips, Some(Trouble::Slipping { .. })), "{slips:?}");
    }

    #[test]
    fn leaning_too_far_is_reported_at_once() {
        assert!(matches!(run(AHEAD, (0.3, 0.0), None, 0.6), Some(Trouble::Tilted { .. })));
    }

    #[test]
    fn rolling_out_after_a_stop_is_no_push() {
        let mut detector = StuckDetector::new(StuckConfig::default());
        let mut odometry = Pose2::default();
        for step in 0..40 {
            let (command, speed_mps) = match step {
                0..20 => (AHEAD, 0.7),
                // The brakes take a second and a half metre.
                20..25 => (DriveCommand::STOP, 0.5),
                _ => (DriveCommand::STOP, 0.0),
            };
            odometry = odometry.driven(0.2 * speed_mps, 0.0);
            let trouble = detector.note(Motion {
                arrival: Arrival::from_seconds(0.2 * f64::from(step)),
                command,
                odometry,
                observed: None,
                roll_rad: 0.0,
                pitch_rad: 0.0,
            });
            assert_eq!(trouble, None, "step {step}");
        }
    }

    #[test]
    fn a_robot_that_has_just_been_told_to_start_is_not_stuck() {
        // It stood; the command reaches the wheels after half a second, and they gain speed slowly.
        let mut detector = StuckDetector::new(StuckConfig::default());
        let mut odometry = Pose2::default();
        for step in 0..40 {
            let command = if step < 20 { DriveCommand::STOP } else { AHEAD };
            let speed_mps = 0.3 * (f64::from(step - 22) / 5.0).clamp(0.0, 1.0);
            odometry = odometry.driven(0.2 * speed_mps, 0.0);
            let trouble = detector.note(Motion {
                arrival: Arrival::from_seconds(0.2 * f64::from(step)),
                command,
                odometry,
                observed: None,
                roll_rad: 0.0,
                pitch_rad: 0.0,
            });
            assert_eq!(trouble, None, "step {step}");
        }
    }

    #[test]
    fn motion_without_a_command_is_a_push() {
        let pushed = run(DriveCommand::STOP, (0.0, 0.0), Some((0.1, 0.0)), 0.0);
        assert!(matches!(pushed, Some(Trouble::Pushed { .. })), "{pushed:?}");
    }
}
