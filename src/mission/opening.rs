//! The opening of a session: greeting, start poses, INIT, the first STA, then GEO and CONF one
//! question at a time (protocol document 2.2 and 10.1).
//!
//! UT2004 servers keep one GETGEO and one GETCONF per tick in single slots, so each question waits
//! for its answer; UDK servers say nothing where they have nothing, so each wait ends.

use crate::protocol::command::Init;
use crate::protocol::message::{Nfo, Sen};
use crate::protocol::{Command, Dialect, Message, NamedPose, WirePose};
use crate::robot::RigBuilder;
use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Where the robot is to be put.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum Placement {
    /// At the first start pose that the server lists.
    #[default]
    FirstStart,
    /// At a start pose by name.
    Start(String),
    /// At a pose on the wire's axes.
    At(WirePose),
}

/// How long the opening waits for what.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpeningConfig {
    /// For the greeting and the start poses, in seconds; the opening goes on without them.
    pub greeting_timeout_s: f64,
    /// For the first STA after INIT, in seconds; without it there is no robot. Valid: above 0.
    pub sta_timeout_s: f64,
    /// For each answer to GETGEO and GETCONF, in seconds.
    pub answer_timeout_s: f64,
    /// How long the sensors are listened to before they are asked after, in seconds.
    pub listen_s: f64,
}

impl Default for OpeningConfig {
    fn default() -> Self {
        Self { greeting_timeout_s: 2.0, sta_timeout_s: 10.0, answer_timeout_s: 1.5, listen_s: 0.7 }
    }
}

/// What the opening is waiting for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Stage {
    Greeting,
    StartPoses,
    FirstSta,
    Listening,
    Answer(Command),
    Observing,
    Open,
    Failed,
}

/// What the opening has to say.
#[derive(Clone, Debug, PartialEq)]
pub enum OpeningStep {
    /// Send this.
    Send(Command),
    /// Carried on, but not as told.
    Warn(String),
    /// All questions are answered or given up; the robot may move.
    Open,
    /// There is no robot, and why.
    Failed(String),
}

/// The opening as a state machine: messages and time in, steps out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opening {
    config: OpeningConfig,
    class_name: String,
    robot_name: String,
    placement: Placement,
    stage: Stage,
    deadline: Arrival,
    start_poses: Vec<NamedPose>,
    level: Option<String>,
    questions: VecDeque<Command>,
    sensor_types: Vec<String>,
    pose: Option<WirePose>,
    /// Attitude of an observed robot at its start, as its inertial unit gives it.
    stands: [f64; 3],
    rig: Option<RigBuilder>,
}

impl Opening {
    /// An opening that begins when the link comes up, at `now`.
    pub fn new(
        config: OpeningConfig,
        class_name: &str,
        robot_name: &str,
        placement: Placement,
        now: Arrival,
    ) -> Self {
        Self {
            deadline: now + Span::from_seconds(config.greeting_timeout_s),
            config,
            class_name: class_name.to_owned(),
            robot_name: robot_name.to_owned(),
            placement,
            stage: Stage::Greeting,
            start_poses: Vec::new(),
            level: None,
            questions: VecDeque::new(),
            sensor_types: Vec::new(),
            pose: None,
            stands: [0.0; 3],
            rig: None,
        }
    }

    /// An opening that asks nothing: for recordings of others, whose lines tell what they tell. It
    /// opens with the first STA; answers to GEO and CONF that come before it are learnt from.
    pub fn observing(class_name: &str) -> Self {
        let config = OpeningConfig { listen_s: 0.0, ..OpeningConfig::default() };
        let mut opening = Self::new(config, class_name, "", Placement::FirstStart, Arrival(0));
        opening.stage = Stage::Observing;
        opening
    }

    /// Name of the server's level, once it has greeted.
    pub fn level(&self) -> Option<&str> {
        self.level.as_deref()
    }

    /// Where INIT put the robot, on the wire's axes; `None` for a start pose that only the server
    /// knows.
    pub fn placed_at(&self) -> Option<WirePose> {
        self.pose
    }

    /// The rig as far as the server has told; `None` before the first STA.
    pub fn rig(&self) -> Option<&RigBuilder> {
        self.rig.as_ref()
    }

    /// When the opening wants to be woken.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        match self.stage {
            Stage::Open | Stage::Failed | Stage::Observing => None,
            _ => Some(self.deadline),
        }
    }

    /// Takes in a message. `dialect` is what the lines so far have told.
    pub fn message(
        &mut self,
        message: &Message,
        dialect: Option<Dialect>,
        now: Arrival,
    ) -> Vec<OpeningStep> {
        if let Message::Sen(sensor) = message
            && let Some(name) = asked_type(sensor)
            && !self.sensor_types.iter().any(|known| known == name)
        {
            self.sensor_types.push(name.to_owned());
        }
        if self.stage == Stage::Observing && matches!(message, Message::Geo(_) | Message::Conf(_)) {
            let class = &self.class_name;
            self.rig.get_or_insert_with(|| RigBuilder::new(Dialect::default(), class));
        }
        if let Some(rig) = &mut self.rig {
            rig.learn(message);
        }
        match (&self.stage, message) {
            (Stage::Greeting, Message::Nfo(Nfo::Greeting(greeting))) => {
                self.level = Some(greeting.level.clone());
                self.ask_start_poses(now)
            }
            (Stage::StartPoses, Message::Nfo(Nfo::StartPoses(poses))) => {
                self.start_poses.clone_from(poses);
                self.init(now)
            }
            (Stage::FirstSta, Message::Sta(_)) => {
                self.stage = Stage::Listening;
                self.deadline = now + Span::from_seconds(self.config.listen_s);
                let stands = self.pose.map_or([0.0; 3], |pose| pose.orientation);
                self.rig = Some(
                    RigBuilder::new(dialect.unwrap_or_default(), &self.class_name)
                        .standing_at(stands),
                );
                Vec::new()
            }
            (Stage::Observing, Message::Nfo(Nfo::Greeting(greeting))) => {
                self.level = Some(greeting.level.clone());
                Vec::new()
            }
            (Stage::Observing, Message::Sen(Sen::Ins(ins))) => {
                self.stands = ins.pose.orientation;
                Vec::new()
            }
            (Stage::Observing, Message::Sta(_)) => {
                let rig = self.rig.take().unwrap_or_else(|| {
                    RigBuilder::new(dialect.unwrap_or_default(), &self.class_name)
                });
                // Mountings were measured in the world, where the robot stood at its start.
                let rig = rig.speaking(dialect.unwrap_or_default()).standing_at(self.stands);
                self.rig = Some(rig);
                self.stage = Stage::Open;
                vec![OpeningStep::Open]
            }
            (Stage::Answer(question), _) if self.has_answer(question) => self.ask_next(now),
            _ => Vec::new(),
        }
    }

    fn has_answer(&self, question: &Command) -> bool {
        self.rig.as_ref().is_some_and(|rig| rig.has_answer(question))
    }

    /// Takes in that time has passed.
    pub fn wake(&mut self, now: Arrival) -> Vec<OpeningStep> {
        if now < self.deadline {
            return Vec::new();
        }
        match &self.stage {
            Stage::Greeting => {
                let mut steps =
                    vec![OpeningStep::Warn("no greeting from the server; going on without".into())];
                steps.extend(self.ask_start_poses(now));
                steps
            }
            Stage::StartPoses => {
                let mut steps = vec![OpeningStep::Warn("no answer to GETSTARTPOSES".into())];
                steps.extend(self.init(now));
                steps
            }
            Stage::FirstSta => {
                self.stage = Stage::Failed;
                vec![OpeningStep::Failed(format!(
                    "no STA within {} s of INIT: the server does not know the class {}, or the \
                     place is blocked",
                    self.config.sta_timeout_s, self.class_name
                ))]
            }
            Stage::Listening => {
                let questions = self.rig.as_ref().map(RigBuilder::queries).unwrap_or_default();
                let wanted = questions.into_iter().filter(|query| self.is_worth_asking(query));
                self.questions = wanted.collect();
                self.ask_next(now)
            }
            // What is missing the rig supposes, and says so.
            Stage::Answer(_) => self.ask_next(now),
            Stage::Open | Stage::Failed | Stage::Observing => Vec::new(),
        }
    }

    fn ask_start_poses(&mut self, now: Arrival) -> Vec<OpeningStep> {
        self.stage = Stage::StartPoses;
        self.deadline = now + Span::from_seconds(self.config.greeting_timeout_s);
        vec![OpeningStep::Send(Command::GetStartPoses)]
    }

    fn init(&mut self, now: Arrival) -> Vec<OpeningStep> {
        self.stage = Stage::FirstSta;
        self.deadline = now + Span::from_seconds(self.config.sta_timeout_s);
        let mut steps = Vec::new();
        let at = |pose: WirePose| {
            Init::at_pose(&self.class_name, &self.robot_name, pose.location, pose.orientation)
        };
        let init = match &self.placement {
            Placement::At(pose) => {
                self.pose = Some(*pose);
                at(*pose)
            }
            Placement::Start(name) => {
                let known = self.start_poses.iter().find(|p| p.name.eq_ignore_ascii_case(name));
                if let Some(start) = known {
                    self.pose = Some(start.pose);
                    at(start.pose)
                } else {
                    let names: Vec<_> = self.start_poses.iter().map(|p| p.name.as_str()).collect();
                    steps.push(OpeningStep::Warn(format!(
                        "the server lists no start pose `{name}` (it lists: {}); asking for it by \
                         name, the map begins at zero",
                        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
                    )));
                    Init::at_start(&self.class_name, &self.robot_name, name)
                }
            }
            Placement::FirstStart => {
                if let Some(start) = self.start_poses.first() {
                    self.pose = Some(start.pose);
                    at(start.pose)
                } else {
                    steps.push(OpeningStep::Warn(
                        "the server lists no start pose and none was given; starting at 0,0,0"
                            .into(),
                    ));
                    self.pose = Some(WirePose::default());
                    at(WirePose::default())
                }
            }
        };
        steps.push(OpeningStep::Send(Command::Init(init)));
        steps
    }

    /// Whether a question may be answered: sensors that were not heard are not asked after, since
    /// UDK servers would let the wait run out on each.
    fn is_worth_asking(&self, query: &Command) -> bool {
        let (Command::GetGeo(query) | Command::GetConf(query)) = query else { return false };
        let always = ["Robot", "MisPkg", "Actuator", "RangeScanner"];
        let is = |name: &str| name.eq_ignore_ascii_case(&query.type_name);
        always.iter().any(|name| is(name)) || self.sensor_types.iter().any(|name| is(name))
    }

    fn ask_next(&mut self, now: Arrival) -> Vec<OpeningStep> {
        let Some(question) = self.questions.pop_front() else {
            self.stage = Stage::Open;
            return vec![OpeningStep::Open];
        };
        self.deadline = now + Span::from_seconds(self.config.answer_timeout_s);
        self.stage = Stage::Answer(question.clone());
        vec![OpeningStep::Send(question)]
    }
}

/// The type under which the mounting of a sensor is asked for, if anything here needs it.
fn asked_type(sensor: &Sen) -> Option<&'static str> {
    Some(match sensor {
        Sen::Odometry(_) => "Odometry",
        Sen::Ins(_) => "INS",
        Sen::Sonar(_) => "Sonar",
        Sen::Touch(_) => "Touch",
        Sen::VictSensor(_) => "VictSensor",
        Sen::Rfid(_) => "RFID",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{encode_command, parse};

    fn opening(placement: Placement) -> Opening {
        Opening::new(OpeningConfig::default(), "USARBot.P3AT", "R1", placement, Arrival(0))
    }

    /// Runs an opening against a server that answers as `answer` says; gives what was sent and the
    /// last step.
    fn talk(
        opening: &mut Opening,
        dialect: Dialect,
        mut answer: impl FnMut(&str) -> Vec<&'static str>,
    ) -> (Vec<String>, OpeningStep) {
        let mut sent = Vec::new();
        let mut now = Arrival(0);
        let mut inbox: VecDeque<&str> =
            ["NFO {Gametype BotDeathMatch} {Level DM-Box} {TimeLimit 0}"].into();
        for _ in 0..200 {
            let steps = match inbox.pop_front() {
                Some(line) => opening.message(&parse(line.as_bytes()).message, Some(dialect), now),
                None => {
                    now = opening.next_wakeup().expect("an unfinished opening names its wake-up");
                    opening.wake(now)
                }
            };
            for step in steps {
                match step {
                    OpeningStep::Send(command) => {
                        let line = encode_command(&command, dialect);
                        let line = String::from_utf8(line).unwrap().trim_end().to_owned();
                        inbox.extend(answer(&line));
                        sent.push(line);
                    }
                    OpeningStep::Warn(_) => {}
                    end => return (sent, end),
                }
            }
        }
        panic!("the opening never ends; sent {sent:?}");
    }

    const STA: &str = "STA {Type GroundVehicle} {Time 1.00} {Battery 1200}";

    #[test]
    fn asks_one_thing_at_a_time_and_opens() {
        let mut opening = opening(Placement::FirstStart);
        let (sent, end) = talk(&mut opening, Dialect::Ut2004, |line| match line {
            "GETSTARTPOSES" => vec!["NFO {StartPoses 1} {A 1.00,2.00,-0.10 0.00,0.00,1.57}"],
            line if line.starts_with("INIT") => {
                vec![STA, "SEN {Type Odometry} {Name O} {Pose 0,0,0}"]
            }
            "GETGEO {Type Robot}" => vec!["GEO {Type GroundVehicle} {Name P3AT}"],
            _ => vec![],
        });
        assert_eq!(end, OpeningStep::Open);
        assert_eq!(
            sent[..4],
            [
                "GETSTARTPOSES",
                "INIT {ClassName USARBot.P3AT} {Name R1} {Location 1,2,-0.1} {Rotation 0,0,1.57}",
                "GETGEO {Type Robot}",
                "GETCONF {Type Robot}",
            ]
        );
        assert_eq!(sent.last().unwrap(), "GETGEO {Type Odometry}");
        assert_eq!(opening.placed_at().unwrap().location, [1.0, 2.0, -0.1]);
        assert_eq!(opening.level(), Some("DM-Box"));
    }

    #[test]
    fn a_server_without_sta_fails_by_name() {
        let mut opening = opening(Placement::FirstStart);
        let (_, end) = talk(&mut opening, Dialect::Ut2004, |_| vec![]);
        let OpeningStep::Failed(reason) = end else { panic!("{end:?}") };
        assert!(reason.contains("no STA within 10 s") && reason.contains("USARBot.P3AT"));
    }

    #[test]
    fn a_silent_udk_server_opens_after_its_timeouts() {
        let mut opening = opening(Placement::Start("Pad".into()));
        let (sent, end) = talk(&mut opening, Dialect::Udk, |line| {
            if line.starts_with("INIT") { vec!["STA {Time 1.0000} {Battery 9}"] } else { vec![] }
        });
        assert_eq!(end, OpeningStep::Open);
        assert!(sent.iter().any(|line| line == "GETGEO {Type Actuator}"));
        assert!(sent.iter().any(|line| line.contains("{Start Pad}")));
        assert_eq!(opening.placed_at(), None);
    }
}
