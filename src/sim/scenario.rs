//! Scenario files: which world, which robots, how long, how noisy, and what goes wrong.

mod fault;
mod robot;

pub use fault::{FaultKind, FaultSpec};
pub use robot::RobotSpec;
pub(crate) use robot::link_of_mount;

use super::catalogue::{RobotCatalogue, RobotClass};
use super::file_check::{Check, SpecError, read_toml};
use super::spec::wire_name;
use super::vehicle::Motion;
use super::world::World;
use crate::protocol::Dialect;
use serde::{Deserialize, Serialize};

/// A scenario as written, checked by [`Scenario::parse`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Map file, relative to the scenario file.
    pub map: String,
    /// Length of the mission in seconds, > 0.
    #[serde(default = "default_time_limit")]
    pub time_limit_s: f64,
    /// Seed of every noise.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Which servers are stood in for.
    #[serde(default)]
    pub dialect: Dialect,
    /// Rigid bodies, or perfect motion.
    #[serde(default)]
    pub motion: Motion,
    /// When the server does what.
    #[serde(default)]
    pub timing: Timing,
    /// Phases of the mission, in order.
    #[serde(default, rename = "phase")]
    pub phases: Vec<Phase>,
    /// Robots, at least one.
    #[serde(default, rename = "robot")]
    pub robots: Vec<RobotSpec>,
    /// How noisy the sensors are.
    #[serde(default)]
    pub noise: NoiseSpec,
    /// What goes wrong.
    #[serde(default, rename = "fault")]
    pub faults: Vec<FaultSpec>,
    /// Overrides of the agent's configuration, passed on unread.
    #[serde(default)]
    pub agent: toml::Table,
}

/// The server's clockwork.
///
/// The UT2004 defaults give the intervals of a real recording: frames of 55.4 ms, so that bursts due
/// every 0.2 s come after 0.166 or 0.222 s. UDK runs at 60 frames a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Timing {
    /// Level time at which the session begins, in seconds, ≥ 0.
    pub start_time_s: f64,
    /// Length of one frame of the game in seconds, 0.005 to 0.2: commands are taken and lines are
    /// written at its end. Absent means the dialect's own.
    pub tick_s: Option<f64>,
    /// Half width of the uniform jitter of a frame's length, as a part of it, 0 to 0.5.
    pub tick_jitter: f64,
    /// UT2004: seconds between bursts, 0.05 to 10.
    pub message_interval_s: f64,
}

impl Default for Timing {
    fn default() -> Self {
        Self { start_time_s: 100.0, tick_s: None, tick_jitter: 0.01, message_interval_s: 0.2 }
    }
}

impl Timing {
    /// Mean length of a frame in seconds.
    pub fn frame_s(&self, dialect: Dialect) -> f64 {
        self.tick_s.unwrap_or(match dialect {
            Dialect::Ut2004 => 0.0554,
            Dialect::Udk => 1.0 / 60.0,
        })
    }
}

/// A phase of the mission.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Phase {
    /// Who may drive.
    pub name: PhaseName,
    /// Mission time in seconds at which the phase ends.
    pub until_s: f64,
}

/// Who may drive in a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PhaseName {
    /// The robots alone.
    Autonomous,
    /// The robots alone, announced before the run.
    Handoff,
    /// Operator and robots.
    Operator,
}

impl std::fmt::Display for PhaseName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Autonomous => "autonomous",
            Self::Handoff => "handoff",
            Self::Operator => "operator",
        })
    }
}

/// Amplitudes of the noises; zero switches one off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NoiseSpec {
    /// Half width of the uniform relative error of ranges; absent means the dialect's own: 0.001 in
    /// UT2004, none in UDK.
    pub range_relative: Option<f64>,
    /// Standard deviation of a normal error of ranges in metres.
    pub range_sigma_m: f64,
    /// Relative standard deviation of each step of the odometry, beyond slip and encoder steps.
    pub odometry: f64,
    /// Relative standard deviation of each step of the INS.
    pub ins: f64,
    /// Relative standard deviation of the wheels' effective radii, drawn once for each side.
    pub wheel_slip: f64,
    /// Half width of the uniform relative error of encoder steps.
    pub encoder: f64,
    /// Standard deviation of victim locations, as a part of the distance.
    pub victim: f64,
}

impl Default for NoiseSpec {
    fn default() -> Self {
        Self {
            range_relative: None,
            range_sigma_m: 0.0,
            odometry: 0.0,
            ins: 0.05,
            wheel_slip: 0.0,
            encoder: 0.005,
            victim: 0.05,
        }
    }
}

fn default_time_limit() -> f64 {
    1200.0
}

fn default_seed() -> u64 {
    1
}

impl Scenario {
    /// Reads a scenario file's text; reports every violation at once.
    pub fn parse(text: &str) -> Result<Self, SpecError> {
        let scenario: Self = read_toml(text)?;
        let mut check = Check::default();
        scenario.check(&mut check);
        check.finish(scenario)
    }

    fn check(&self, check: &mut Check) {
        check.that(!self.map.is_empty(), "map", "expected a file name, found nothing");
        check.positive(&[self.time_limit_s], "time_limit_s");
        check.that(!self.robots.is_empty(), "robot", "expected at least one robot, found none");
        self.check_timing(check);
        let mut from_s = 0.0;
        for (number, phase) in self.phases.iter().enumerate() {
            check.that(
                phase.until_s > from_s,
                format_args!("phase {} until_s", number + 1),
                format_args!("expected more than {from_s}, found {}", phase.until_s),
            );
            from_s = phase.until_s;
        }
        check.unique(self.robots.iter().map(|robot| robot.name.as_str()), "robot");
        for robot in &self.robots {
            let owner = format!("robot {:?}", robot.name);
            check.that(wire_name(&robot.name), &owner, "expected a name without blanks and braces");
            let battery: Vec<f64> = robot.battery_s.into_iter().collect();
            check.positive(&battery, format_args!("{owner} battery_s"));
            for unit in robot.pan_tilt.iter().flatten() {
                unit.check(check, &owner);
            }
            for sensor in &robot.sensors {
                sensor.check(check, &owner);
            }
        }
        self.check_noise(check);
        for (number, fault) in self.faults.iter().enumerate() {
            let place = format!("fault {}", number + 1);
            let span = [fault.at_s, fault.for_s.unwrap_or_default()];
            check.that(
                span.iter().all(|seconds| *seconds >= 0.0 && seconds.is_finite()),
                &place,
                "expected at_s and for_s ≥ 0",
            );
            check.finite(&[fault.value.unwrap_or_default()], format_args!("{place} value"));
            let known = |name: &String| self.robots.iter().any(|robot| robot.name == *name);
            check.that(
                fault.robot.as_ref().is_none_or(known),
                format_args!("{place} robot"),
                format_args!(
                    "expected a robot of the scenario, found {:?}",
                    fault.robot.as_deref().unwrap_or_default()
                ),
            );
        }
    }

    fn check_timing(&self, check: &mut Check) {
        let timing = &self.timing;
        let ranges = [
            ("start_time_s", timing.start_time_s, 0.0, 1e6),
            ("tick_s", timing.frame_s(self.dialect), 0.005, 0.2),
            ("tick_jitter", timing.tick_jitter, 0.0, 0.5),
            ("message_interval_s", timing.message_interval_s, 0.05, 10.0),
        ];
        for (key, value, least, most) in ranges {
            check.that(
                (least..=most).contains(&value),
                format_args!("timing {key}"),
                format_args!("expected {least} to {most}, found {value}"),
            );
        }
    }

    fn check_noise(&self, check: &mut Check) {
        let noise = &self.noise;
        for (key, value) in [
            ("range_relative", noise.range_relative.unwrap_or_default()),
            ("range_sigma_m", noise.range_sigma_m),
            ("odometry", noise.odometry),
            ("ins", noise.ins),
            ("wheel_slip", noise.wheel_slip),
            ("encoder", noise.encoder),
            ("victim", noise.victim),
        ] {
            check.that(
                (0.0..=1.0).contains(&value),
                format_args!("noise {key}"),
                format_args!("expected 0 to 1, found {value}"),
            );
        }
    }

    /// Whether the map has the start poses that the robots ask for.
    pub fn check_starts(&self, world: &World) -> Result<(), SpecError> {
        let mut check = Check::default();
        for robot in &self.robots {
            let known = robot.start.as_ref().is_none_or(|start| world.start(start).is_some());
            check.that(
                known,
                format_args!("robot {:?} start", robot.name),
                format_args!(
                    "expected a start of map {:?}, found {:?}",
                    world.name(),
                    robot.start.as_deref().unwrap_or_default()
                ),
            );
        }
        check.finish(())
    }

    /// The robots as they will be built: the class with the scenario's own units and sensors.
    pub fn models(&self, catalogue: &RobotCatalogue) -> Result<Vec<RobotClass>, SpecError> {
        let mut check = Check::default();
        let models = self
            .robots
            .iter()
            .filter_map(|robot| {
                let place = format!("robot {:?} class", robot.name);
                let class = catalogue.find(&robot.class, self.dialect);
                check.that(
                    class.is_some(),
                    place,
                    format_args!("expected a class of the robot file, found {:?}", robot.class),
                );
                Some(robot.model(class?, &mut check))
            })
            .collect();
        check.finish(models)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::spec::SensorKind;

    const HEAD: &str = "map = \"m.toml\"\n";
    const ROBOT: &str = "[[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\n";

    fn catalogue() -> RobotCatalogue {
        RobotCatalogue::parse(include_str!("../../maps/robots.toml")).unwrap()
    }

    fn model(more: &str) -> Result<RobotClass, SpecError> {
        let scenario = Scenario::parse(&format!("{HEAD}{ROBOT}{more}"))?;
        Ok(scenario.models(&catalogue())?.remove(0))
    }

    #[test]
    fn an_unknown_key_is_an_error() {
        for text in ["speeed = 1\n", "[noise]\nrangge = 1.0\n", "[[fault]]\nat = 1.0\n"] {
            let error = Scenario::parse(&format!("{HEAD}{text}"));
            assert!(matches!(error, Err(SpecError::Parse(_))), "{text}");
        }
    }

    #[test]
    fn sensors_replace_those_of_their_type_and_leave_the_others() {
        let fixed = "[[robot.sensor]]\ntype = \"RangeScanner\"\nname = \"Fixed\"\nposition = [0.1, 0.0, 0.3]\n";
        let model = model(fixed).unwrap();
        let scanners: Vec<&str> = model
            .sensor
            .iter()
            .filter(|sensor| sensor.kind == SensorKind::RangeScanner)
            .map(|sensor| sensor.name.as_str())
            .collect();
        assert_eq!(scanners, ["Fixed"]);
        assert!(model.sensor.iter().any(|sensor| sensor.kind == SensorKind::Odometry));
    }

    #[test]
    fn a_unit_with_narrow_limits_keeps_the_rest_of_the_class() {
        let narrow = "[[robot.pan_tilt]]\nname = \"Head\"\ntilt_limits_rad = [-0.16, 0.4]\n";
        let model = model(narrow).unwrap();
        assert_eq!(model.pan_tilt[0].tilt_limits_rad, Some([-0.16, 0.4]));
        assert_eq!(model.pan_tilt[0].speed_rad_s, Some(0.17));
        let scanner = model.sensor.iter().find(|s| s.kind == SensorKind::RangeScanner).unwrap();
        assert_eq!(scanner.mount, "Head_Link2");
    }

    #[test]
    fn a_robot_without_a_unit_carries_its_laser_on_the_body() {
        let scanner = model("pan_tilt = []\n").unwrap();
        let scanner = scanner.sensor.iter().find(|s| s.kind == SensorKind::RangeScanner).unwrap();
        assert_eq!(scanner.mount, "body");
        let height: f64 = scanner.position[2];
        assert!((height - 0.42).abs() < 1e-12, "{height}");
    }

    #[test]
    fn a_class_or_a_mount_that_does_not_exist_is_named() {
        let text = format!("{HEAD}[[robot]]\nname = \"R1\"\nclass = \"USARBot.Tank\"\n");
        let error = Scenario::parse(&text).unwrap().models(&catalogue()).unwrap_err();
        assert!(error.to_string().contains("USARBot.Tank"), "{error}");
        let wrong = "[[robot.sensor]]\ntype = \"Camera\"\nname = \"C\"\nmount = \"Arm_Link2\"\n";
        let error = model(wrong).unwrap_err();
        assert!(error.to_string().contains("Arm_Link2"), "{error}");
    }

    #[test]
    fn keys_of_another_sensor_type_are_refused() {
        let wrong = "[[robot.sensor]]\ntype = \"INS\"\nname = \"I\"\nfov_deg = 90.0\n";
        let error = model(wrong).unwrap_err();
        assert!(error.to_string().contains("fov_deg"), "{error}");
    }
}
