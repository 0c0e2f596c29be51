//! What clients' commands do.

use super::connection::{ConnectionId, Question};
use super::robot::{Birth, Robot, Stage};
use super::{MOST_ROBOTS, Planned, Session, is_laser, setting};
use crate::protocol::command::{CameraCommand, Init, MisPkgForm, Order};
use crate::protocol::message::Nfo;
use crate::protocol::{Command, Dialect, Message, NamedPose, WirePose};
use crate::sim::catalogue::RobotClass;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::physics::RobotKey;
use crate::sim::sensor::{Carrier, Suite};
use crate::sim::surroundings::RobotBody;
use crate::sim::vehicle::spawn;
use crate::sim::wire;
use nalgebra::{Isometry3, Vector3};
use std::sync::Arc;

/// What a robot is called whose client gives no name.
const NAMELESS: &str = "Unnamed";

/// A start above the floor by less than this is a marker on it; floors higher are storeys.
const HEADROOM_M: f64 = 0.05;

/// Two robots nearer than this part of their sizes stand in each other.
const CROWDED: f64 = 0.35;

impl Session {
    /// Carries out the commands that a client sent since the last tick.
    pub(super) fn obey(&mut self, id: ConnectionId) {
        let Some(connection) = self.connections.get_mut(&id) else { return };
        for command in connection.take_commands() {
            self.carry_out(id, command);
        }
    }

    fn carry_out(&mut self, id: ConnectionId, command: Command) {
        match command {
            Command::Init(init) => self.init(id, &init),
            Command::GetStartPoses => {
                let poses = self.start_poses();
                self.send(id, &Message::Nfo(Nfo::StartPoses(poses)));
            }
            Command::GetPathNodes if self.scenario.dialect == Dialect::Udk => {
                self.send(id, &Message::Nfo(Nfo::PathNodes(Vec::new())));
            }
            Command::GetGeo(query) => self.question(id, Question::Geo(query)),
            Command::GetConf(query) => self.question(id, Question::Conf(query)),
            Command::Set(set) => self.set(id, &set),
            Command::Control(control) => self.control(id, &control),
            other => self.steer(id, &other),
        }
    }

    /// Questions before INIT are lost, as nobody is there to answer.
    fn question(&mut self, id: ConnectionId, question: Question) {
        if let Some(connection) = self.connections.get_mut(&id)
            && connection.robot.is_some()
        {
            connection.ask(question);
        }
    }

    fn powered_robot(&mut self, id: ConnectionId) -> Option<&mut Robot> {
        let key = self.connections.get(&id)?.robot?;
        let now = self.now;
        self.robots.iter_mut().find(|robot| robot.key == key && robot.powered(now))
    }

    /// Commands that move something. What a ground robot does not have is ignored in silence, as
    /// servers do: aerial, nautic and omni drives, flippers, traces, pauses.
    fn steer(&mut self, id: ConnectionId, command: &Command) {
        let now = self.now;
        let Some(robot) = self.powered_robot(id) else { return };
        let udk = robot.dialect == Dialect::Udk;
        match command {
            Command::Drive(drive) => robot.drive(drive, now),
            Command::MisPkg(package) => robot.package(package),
            Command::Act(act) if udk => {
                for link in &act.links {
                    robot.order_link(&act.name, link.link, Order::Angle, link.value);
                }
            }
            Command::Camera(camera) if !udk => point_camera(robot, camera),
            _ => {}
        }
    }

    fn set(&mut self, id: ConnectionId, set: &crate::protocol::command::Set) {
        let key = self.connections.get(&id).and_then(|connection| connection.robot);
        let now = self.now;
        let bodies: Vec<RobotBody> = self.robots.iter().map(Robot::body).collect();
        let robot = self.robots.iter_mut().find(|robot| Some(robot.key) == key);
        let Some(robot) = robot.filter(|robot| robot.powered(now)) else { return };
        let stage = Stage { world: &self.world, bodies: &bodies, now };
        let outcome = setting::apply(robot, set, &mut self.tags, &stage);
        let stamp = robot.stamp(now);
        if outcome.lines.iter().any(is_laser) {
            robot.note_casts(stamp, now);
        }
        let dialect = robot.dialect;
        if dialect == Dialect::Ut2004 {
            self.choose_view(id, &set.form);
        }
        let answer = setting::answer(dialect, set, outcome.result, stamp);
        for message in answer.into_iter().chain(outcome.lines) {
            self.send(id, &message);
        }
    }

    fn start_poses(&self) -> Vec<NamedPose> {
        let printed = |values: [f64; 3]| match self.scenario.dialect {
            Dialect::Ut2004 => values.map(|value| wire::round(value, 2)),
            Dialect::Udk => values.map(|value| wire::truncate(value, 4)),
        };
        self.world
            .starts()
            .iter()
            .map(|start| {
                let pose = wire::pose(&start.world_from_robot);
                NamedPose {
                    name: start.name.clone(),
                    pose: WirePose {
                        location: printed(pose.location),
                        orientation: printed(pose.orientation),
                    },
                }
            })
            .collect()
    }

    /// Makes a robot. A class that nobody knows, and a place that another robot takes, get silence.
    fn init(&mut self, id: ConnectionId, init: &Init) {
        let multi_view = is_class(&init.class_name, "MultiView");
        let controller = is_class(&init.class_name, "WorldController");
        if let Some(connection) = self.connections.get_mut(&id)
            && (multi_view || controller)
        {
            connection.multi_view |= multi_view && self.scenario.dialect == Dialect::Ut2004;
            connection.controller |= controller;
            return self.number_views();
        }
        let name = init.name.clone().filter(|name| !name.is_empty());
        let name = name.unwrap_or_else(|| NAMELESS.to_owned());
        let Some(class) = self.class_for(&init.class_name, &name) else {
            tracing::warn!(class = init.class_name, "no such robot class: the client gets silence");
            return;
        };
        if self.robots.len() >= MOST_ROBOTS {
            tracing::warn!(robot = name, MOST_ROBOTS, "too many robots: the client gets silence");
            return;
        }
        let wanted = self.spawn_pose(init, &name);
        let place = self.lifted(wanted, &class);
        if self.crowded(&place, &class) {
            tracing::warn!(robot = name, "another robot stands there: the client gets silence");
            return;
        }
        let Some(connection) = self.connections.get_mut(&id) else { return };
        let key = RobotKey(self.next_robot);
        self.next_robot += 1;
        connection.earlier.extend(connection.robot.replace(key));
        let dialect = self.scenario.dialect;
        let motion = self.scenario.motion;
        let vehicle = spawn(motion, &class, key, &mut self.physics, &place);
        let units: Vec<PanTilt> =
            class.pan_tilt.iter().map(|unit| PanTilt::new(unit, dialect)).collect();
        let carrier = Carrier { class: &class, state: vehicle.state(), units: &units };
        let Self { scenario, now, .. } = &*self;
        let suite = Suite::new(&carrier, dialect, &scenario.noise, scenario.seed, key, *now);
        let score = self.past_scores.remove(&name).unwrap_or_default();
        self.past.remove(&name);
        self.robots.push(Robot::new(Birth {
            key,
            name,
            class,
            dialect,
            vehicle,
            units,
            suite,
            score,
            now: self.now,
            message_interval_s: self.scenario.timing.message_interval_s,
            first_tile: self.next_tile(),
        }));
        self.number_views();
        self.announce_cameras(id, key);
    }

    /// The scenario's robot of that class, the one of that name first; else the catalogue's.
    fn class_for(&self, class: &str, name: &str) -> Option<Arc<RobotClass>> {
        let of_class = |planned: &&Planned| {
            planned.class.class.eq_ignore_ascii_case(class)
                || planned.class.short_name().eq_ignore_ascii_case(class)
        };
        let mut planned = self.planned.iter().filter(of_class);
        let first = planned.clone().next();
        let own = planned.find(|planned| planned.name == name).or(first);
        own.map(|planned| planned.class.clone())
            .or_else(|| self.catalogue.find(class, self.scenario.dialect).cloned().map(Arc::new))
    }

    /// Where INIT puts the robot: a named start, a location, or the scenario's start for the robot
    /// of that name; else the origin. An unknown start is the origin too, as in UDK.
    fn spawn_pose(&self, init: &Init, name: &str) -> Isometry3<f64> {
        if let Some(start) = init.start.as_deref().filter(|start| !start.is_empty()) {
            let known = self.world.start(start).map(|start| start.world_from_robot);
            return known.unwrap_or_else(Isometry3::identity);
        }
        if init.location.is_some() || init.rotation.is_some() {
            return wire::core_pose(&WirePose {
                location: init.location.unwrap_or_default(),
                orientation: init.rotation.unwrap_or_default(),
            });
        }
        let planned = self.planned.iter().find(|planned| planned.name == name);
        let start = planned.and_then(|planned| match &planned.start {
            Some(start) => self.world.start(start),
            None => self.world.starts().first(),
        });
        start.map_or_else(Isometry3::identity, |start| start.world_from_robot)
    }

    /// The pose, raised until the wheels stand on the floor below it.
    fn lifted(&self, wanted: Isometry3<f64>, class: &RobotClass) -> Isometry3<f64> {
        let mut place = wanted;
        let reach = class.wheels.radius_m;
        let feet = class
            .wheel_centres()
            .into_iter()
            .flat_map(|centre| [-reach, 0.0, reach].map(|ahead| centre + Vector3::x() * ahead));
        for foot in feet {
            let below = wanted * nalgebra::Point3::from(foot);
            let from = wanted.translation.z + HEADROOM_M;
            let Some(floor) = self.world.floor_height_m(below.x, below.y, from) else { continue };
            place.translation.z = place.translation.z.max(floor + class.origin_height_m() + 0.002);
        }
        place
    }

    fn crowded(&self, place: &Isometry3<f64>, class: &RobotClass) -> bool {
        let size = |class: &RobotClass| {
            let [length, width, _] = class.extents_m();
            length + width
        };
        self.robots.iter().any(|robot| {
            let other = robot.vehicle.state().world_from_robot.translation.vector;
            let apart = (place.translation.vector - other).norm();
            apart < CROWDED * (size(class) + size(&robot.class)) / 2.0
        })
    }
}

/// Whether INIT names a class, with its package or without.
fn is_class(given: &str, class: &str) -> bool {
    given.rsplit('.').next().is_some_and(|short| short.eq_ignore_ascii_case(class))
}

/// CAMERA of 2.x is MISPKG's rotation for the first unit, with a zoom.
fn point_camera(robot: &mut Robot, camera: &CameraCommand) {
    let unit = robot.units.first().map(|unit| unit.name.clone());
    if let (Some(name), Some(rotation)) = (unit, camera.rotation) {
        robot.package(&crate::protocol::command::MisPkg {
            name,
            form: MisPkgForm::Rotation { rotation, order: camera.order },
            ..Default::default()
        });
    }
}
