//! The stand-in server in lockstep: lines in, lines out, and time that only [`Session::advance`]
//! moves.
//!
//! One session is one world with all its robots and clients. Physics runs in steps of 5 ms; commands
//! are taken and lines are written at the ends of the game's frames, which are longer and jitter as
//! a real server's do. Equal scenarios, seeds and inputs give equal bytes.
//!
//! ```
//! use std::collections::BTreeMap;
//! use usar_agent::sim::{MapFile, RobotCatalogue, Scenario, Session, World};
//! use usar_agent::time::Span;
//!
//! let map = "name = \"flat\"\nbounds = [-5.0, -5.0, 5.0, 5.0]\n\
//!            [[box]]\ncenter = [0.0, 0.0, -0.5]\nsize = [20.0, 20.0, 1.0]\n\
//!            [[start]]\nname = \"StartA\"\nposition = [0.0, 0.0, 0.2]\n";
//! let world = World::new(&MapFile::parse(map)?, &BTreeMap::new())?;
//! let scenario = Scenario::parse(
//!     "map = \"flat.toml\"\n[[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\n",
//! )?;
//! let catalogue = RobotCatalogue::parse(include_str!("../../maps/robots.toml"))?;
//! let mut session = Session::new(&world, &scenario, &catalogue)?;
//! let client = session.connect();
//! session.receive(client, b"INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}\r\n");
//! session.advance(Span::from_millis(1000));
//! let text = String::from_utf8(session.take_output(client))?;
//! assert!(text.starts_with("NFO {Gametype BotDeathMatch} {Level flat}"));
//! assert!(text.contains("STA {Type GroundVehicle}"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod command;
mod connection;
mod controller;
mod fault;
mod monitor;
mod reply;
mod robot;
mod screen;
mod setting;
#[cfg(test)]
mod tests;

pub use connection::ConnectionId;

use super::catalogue::{RobotCatalogue, RobotClass};
use super::file_check::SpecError;
use super::noise::Noise;
use super::physics::{Physics, RobotKey, STEP_NANOS};
use super::scenario::Scenario;
use super::sensor::{Suite, TagMemory};
use super::surroundings::RobotBody;
use super::truth::{CastTruth, Score, Truth};
use super::world::World;
use crate::protocol::command::Query;
use crate::protocol::message::{Conf, Greeting, ItemsConf, Nfo};
use crate::protocol::{Dialect, Message, encode_message};
use crate::time::{Span, Stamp};
use connection::Connection;
use fault::{Faults, Sudden};
use robot::{Robot, Stage};
use screen::Shown;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Robots at a time, as the game's `MaxPlayers`; one more gets silence.
const MOST_ROBOTS: usize = 16;

/// Robots that are gone and remembered.
const MOST_PAST: usize = 64;

/// A robot of the scenario: what a client gets that asks for its class.
struct Planned {
    name: String,
    start: Option<String>,
    class: Arc<RobotClass>,
}

/// One world with its robots and clients, advanced from outside.
pub struct Session {
    world: Arc<World>,
    catalogue: RobotCatalogue,
    scenario: Scenario,
    planned: Vec<Planned>,
    physics: Physics,
    robots: Vec<Robot>,
    connections: BTreeMap<ConnectionId, Connection>,
    tags: TagMemory,
    shown: Shown,
    faults: Faults,
    /// Scores of robots that are gone, by name.
    past: BTreeMap<String, Truth>,
    past_scores: BTreeMap<String, Score>,
    now: Stamp,
    debt: Span,
    next_tick: Stamp,
    ticks: Noise,
    next_robot: u32,
    next_connection: u32,
}

impl Session {
    /// A session of a scenario in its world.
    ///
    /// Fails if the scenario's robots do not fit the catalogue or the map's start poses.
    pub fn new(
        world: &World,
        scenario: &Scenario,
        catalogue: &RobotCatalogue,
    ) -> Result<Self, SpecError> {
        let models = scenario.models(catalogue)?;
        scenario.check_starts(world)?;
        let planned = scenario
            .robots
            .iter()
            .zip(models)
            .map(|(robot, class)| Planned {
                name: robot.name.clone(),
                start: robot.start.clone(),
                class: Arc::new(class),
            })
            .collect();
        let now = Stamp::from_seconds(scenario.timing.start_time_s);
        let mut session = Self {
            physics: Physics::new(world),
            planned,
            robots: Vec::new(),
            connections: BTreeMap::new(),
            tags: TagMemory::new(world.tags()),
            faults: Faults::new(scenario.faults.clone(), now, scenario.seed),
            past: BTreeMap::new(),
            past_scores: BTreeMap::new(),
            now,
            debt: Span::ZERO,
            next_tick: now,
            ticks: Noise::new(scenario.seed, u64::MAX - 1),
            next_robot: 1,
            next_connection: 1,
            shown: Shown::default(),
            world: Arc::new(world.clone()),
            catalogue: catalogue.clone(),
            scenario: scenario.clone(),
        };
        session.plan_tick();
        Ok(session)
    }

    /// A new client; its greeting waits to be taken.
    pub fn connect(&mut self) -> ConnectionId {
        let id = ConnectionId(self.next_connection);
        self.next_connection += 1;
        self.connections.insert(id, Connection::new(self.scenario.dialect));
        let time_limit = match self.scenario.dialect {
            Dialect::Ut2004 => 0,
            Dialect::Udk => 20,
        };
        let greeting = Message::Nfo(Nfo::Greeting(Greeting {
            gametype: "BotDeathMatch".to_owned(),
            level: self.world.name().to_owned(),
            time_limit: Some(time_limit),
            extra: Vec::new(),
        }));
        self.send(id, &greeting);
        id
    }

    /// Bytes from a client; whole lines are carried out at the next tick. Bytes for a connection
    /// that is closed or unknown are ignored.
    pub fn receive(&mut self, id: ConnectionId, bytes: &[u8]) {
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.receive(bytes);
        }
    }

    /// The client is gone; its robots are destroyed.
    pub fn disconnect(&mut self, id: ConnectionId) {
        let Some(mut connection) = self.connections.remove(&id) else { return };
        for key in connection.take_robots() {
            self.destroy(key);
        }
        if connection.multi_view {
            self.number_views();
        }
    }

    /// The client has sent its last. At the next tick what it still asked is done and answered, then
    /// its robots are destroyed and the connection is closed.
    pub fn finish(&mut self, id: ConnectionId) {
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.finished = true;
        }
    }

    /// Lets simulated time pass, in steps of 5 ms; what is left over counts for the next call.
    pub fn advance(&mut self, span: Span) {
        self.debt += span;
        let step = Span(STEP_NANOS);
        while self.debt >= step {
            self.debt = self.debt - step;
            self.step(step);
        }
    }

    /// The whole lines that a client has to read, in order.
    pub fn take_output(&mut self, id: ConnectionId) -> Vec<u8> {
        self.connections.get_mut(&id).map(Connection::take_output).unwrap_or_default()
    }

    /// Which servers are stood in for.
    pub fn dialect(&self) -> Dialect {
        self.scenario.dialect
    }

    /// Level time.
    pub fn now(&self) -> Stamp {
        self.now
    }

    /// Whether the server has closed a connection, or it never was one.
    pub fn is_closed(&self, id: ConnectionId) -> bool {
        self.connections.get(&id).is_none_or(|connection| connection.closed)
    }

    /// The world of the session.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The truth about a client's robot: for scoring only.
    pub fn truth(&self, id: ConnectionId) -> Option<Truth> {
        let key = self.connections.get(&id)?.robot?;
        self.robot(key).map(|robot| robot.truth(self.now))
    }

    /// The truth about the robot of a name, also when it is gone: for scoring only.
    pub fn truth_by_name(&self, name: &str) -> Option<Truth> {
        let alive = self.robots.iter().find(|robot| robot.name == name);
        alive.map(|robot| robot.truth(self.now)).or_else(|| self.past.get(name).cloned())
    }

    /// Names of all robots that live or lived, in alphabetical order.
    pub fn robot_names(&self) -> Vec<String> {
        let mut names: Vec<String> = self.robots.iter().map(|robot| robot.name.clone()).collect();
        names.extend(self.past.keys().cloned());
        names.sort();
        names.dedup();
        names
    }

    /// Takes the truth of the scanner lines cast since the last call: for scoring only. At most the
    /// latest 256 are kept.
    pub fn take_casts(&mut self, id: ConnectionId) -> Vec<CastTruth> {
        let key = self.connections.get(&id).and_then(|connection| connection.robot);
        let robot = key.and_then(|key| self.robots.iter_mut().find(|robot| robot.key == key));
        robot.map(|robot| robot.casts.drain(..).collect()).unwrap_or_default()
    }

    fn robot(&self, key: RobotKey) -> Option<&Robot> {
        self.robots.iter().find(|robot| robot.key == key)
    }

    fn plan_tick(&mut self) {
        let timing = &self.scenario.timing;
        let frame_s = timing.frame_s(self.scenario.dialect);
        let length = frame_s * (1.0 + self.ticks.symmetric(timing.tick_jitter));
        self.next_tick = self.next_tick + Span::from_seconds(length);
    }

    fn step(&mut self, step: Span) {
        self.now = self.now + step;
        for robot in &mut self.robots {
            robot.before_step(&mut self.physics, &self.world);
        }
        self.physics.step();
        for robot in &mut self.robots {
            robot.after_step(&self.physics, &self.world, self.now);
        }
        if self.now >= self.next_tick {
            self.plan_tick();
            self.tick();
        }
    }

    /// The end of a frame: faults, commands, answers, lines.
    fn tick(&mut self) {
        self.strike();
        for robot in &mut self.robots {
            let inside = self.faults.inside(&robot.name, self.now);
            robot.tick(inside, &mut self.physics, self.now);
        }
        let ids: Vec<ConnectionId> = self.connections.keys().copied().collect();
        for id in &ids {
            self.obey(*id);
            self.bid_farewell(*id);
        }
        let bodies: Vec<RobotBody> = self.robots.iter().map(Robot::body).collect();
        for id in &ids {
            self.answer(*id);
            self.report(*id, &bodies);
        }
        self.idle_robots(&ids, &bodies);
        for id in ids {
            let name = self.robot_name(id);
            let stalled = self.faults.stalled(&name, self.now);
            if let Some(connection) = self.connections.get_mut(&id) {
                connection.deliver(self.now, stalled);
            }
        }
    }

    /// Answers what a client asked that has sent its last, and lets its robots go: before the clients
    /// after it are heard, so that one who comes back finds its place free.
    fn bid_farewell(&mut self, id: ConnectionId) {
        let finished = |connection: &&Connection| connection.finished && !connection.closed;
        while let Some(connection) = self.connections.get(&id).filter(finished) {
            if connection.geo.is_empty() && connection.conf.is_empty() {
                break;
            }
            self.answer(id);
        }
        if let Some(connection) = self.connections.get_mut(&id)
            && connection.finished
        {
            connection.close();
            for key in connection.take_robots() {
                self.destroy(key);
            }
        }
    }

    fn robot_name(&self, id: ConnectionId) -> String {
        let key = self.connections.get(&id).and_then(|connection| connection.robot);
        key.and_then(|key| self.robot(key)).map(|robot| robot.name.clone()).unwrap_or_default()
    }

    fn send(&mut self, id: ConnectionId, message: &Message) {
        let line = encode_message(message, self.scenario.dialect);
        let name = self.robot_name(id);
        let Some(connection) = self.connections.get_mut(&id) else { return };
        connection.send(line, self.now, &mut self.faults.shaping(&name, self.now));
    }

    /// Sudden faults.
    fn strike(&mut self) {
        let names: Vec<String> = self.robots.iter().map(|robot| robot.name.clone()).collect();
        for name in names {
            for Sudden { kind, what, value } in self.faults.strike(&name, self.now) {
                let Some(at) = self.robots.iter().position(|robot| robot.name == name) else {
                    continue;
                };
                if kind == super::scenario::FaultKind::Shove {
                    self.robots[at].shove(&mut self.physics, &what, value.unwrap_or(1.0));
                    continue;
                }
                let key = self.robots[at].key;
                let owner =
                    self.connections.values_mut().find(|connection| connection.robot == Some(key));
                if let Some(connection) = owner {
                    connection.close();
                    let keys = connection.take_robots();
                    keys.into_iter().for_each(|key| self.destroy(key));
                }
            }
        }
    }

    /// One answer of each kind: a UT2004 server reads one GETGEO and one GETCONF per tick.
    fn answer(&mut self, id: ConnectionId) {
        let udk = self.scenario.dialect == Dialect::Udk;
        loop {
            let Some(connection) = self.connections.get_mut(&id) else { return };
            let Some(key) = connection.robot else { return };
            let (geo, conf) = (connection.geo.pop_front(), connection.conf.pop_front());
            if geo.is_none() && conf.is_none() {
                return;
            }
            let Some(robot) = self.robots.iter().find(|robot| robot.key == key) else { return };
            if !robot.powered(self.now) {
                return;
            }
            let answers = [
                geo.and_then(|query| reply::geo(robot, &query)),
                conf.and_then(|query| reply::conf(robot, &query)),
            ];
            for message in answers.into_iter().flatten() {
                self.send(id, &message);
            }
            if !udk {
                return;
            }
        }
    }

    /// The periodic lines of a client's robot.
    fn report(&mut self, id: ConnectionId, bodies: &[RobotBody]) {
        let key = self.connections.get(&id).and_then(|connection| connection.robot);
        let Some(at) = self.robots.iter().position(|robot| Some(robot.key) == key) else { return };
        let stage = Stage { world: &self.world, bodies, now: self.now };
        let interval_s = self.scenario.timing.message_interval_s;
        let lines = report_of(&mut self.robots[at], &stage, &self.tags, interval_s);
        for message in lines {
            self.send(id, &message);
        }
    }

    /// Robots whose socket has gone on to another one keep running, unheard.
    fn idle_robots(&mut self, ids: &[ConnectionId], bodies: &[RobotBody]) {
        let bound: Vec<RobotKey> =
            ids.iter().filter_map(|id| self.connections.get(id)?.robot).collect();
        let stage = Stage { world: &self.world, bodies, now: self.now };
        let interval_s = self.scenario.timing.message_interval_s;
        for robot in self.robots.iter_mut().filter(|robot| !bound.contains(&robot.key)) {
            report_of(robot, &stage, &self.tags, interval_s);
        }
    }

    fn destroy(&mut self, key: RobotKey) {
        let Some(at) = self.robots.iter().position(|robot| robot.key == key) else { return };
        let mut robot = self.robots.remove(at);
        robot.vehicle.remove(&mut self.physics);
        while self.past.len() >= MOST_PAST {
            self.past.pop_first();
        }
        while self.past_scores.len() >= MOST_PAST {
            self.past_scores.pop_first();
        }
        self.past.insert(robot.name.clone(), robot.truth(self.now));
        self.past_scores.insert(robot.name, robot.score.reborn());
        self.number_views();
    }

    /// UDK sends each camera's configuration once, unasked.
    fn announce_cameras(&mut self, id: ConnectionId, key: RobotKey) {
        if self.scenario.dialect != Dialect::Udk {
            return;
        }
        let Some(robot) = self.robot(key) else { return };
        for camera in reply::camera_confs(robot, &Query::default()) {
            let conf = ItemsConf {
                type_name: "Camera".to_owned(),
                items: vec![camera],
                extra: Vec::new(),
            };
            self.send(id, &Message::Conf(Conf::Camera(conf)));
        }
    }
}

/// What a robot says at a tick.
///
/// UT2004: one burst in the recorded order, sensors, packages, state last. UDK: each sensor by its
/// own timer, the state and the actuators by theirs. An empty battery leaves the state alone.
fn report_of(
    robot: &mut Robot,
    stage: &Stage<'_>,
    tags: &TagMemory,
    message_interval_s: f64,
) -> Vec<Message> {
    let (now, stamp) = (stage.now, robot.stamp(stage.now));
    let powered = robot.powered(now);
    let mut lines = Vec::new();
    match robot.dialect {
        Dialect::Ut2004 => {
            if let Some(printed) = robot.scan_due(now) {
                robot.sense(stage, tags, printed, Suite::scan);
                robot.note_casts(printed, now);
            }
            if robot.status_due(now) {
                let sensed = robot.sense(stage, tags, stamp, Suite::burst);
                robot.burst_sent(now, stamp, message_interval_s);
                if powered {
                    lines.extend(sensed);
                    lines.extend(robot.unit_status(stamp));
                }
                lines.push(robot.status(now, stamp));
            }
        }
        Dialect::Udk => {
            let sensed = robot.sense(stage, tags, stamp, Suite::timed);
            if sensed.iter().any(is_laser) {
                robot.note_casts(stamp, now);
            }
            if powered {
                lines.extend(sensed);
            }
            if robot.status_due(now) {
                lines.push(robot.status(now, stamp));
                if powered {
                    lines.extend(robot.unit_status(stamp));
                }
            }
        }
    }
    lines
}

fn is_laser(message: &Message) -> bool {
    use crate::protocol::message::Sen;
    matches!(message, Message::Sen(Sen::RangeScanner(_)))
}
