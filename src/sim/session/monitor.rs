//! What others than clients ask. The wireless simulation, on the monitor port (protocol document
//! 7.3): where the robots are, and how many obstacles lie between two places. Tools, on UDK's truth
//! port (7.6): the true poses, for lines without a verb.

use super::Session;
use super::robot::Robot;
use crate::protocol::{Dialect, RawLine};
use crate::sim::wire;
use nalgebra::Point3;
use std::fmt::Write as _;

impl Session {
    /// The answer to a line of the monitor port, with its line end; `None` where the server is silent.
    pub fn monitor(&self, line: &[u8]) -> Option<Vec<u8>> {
        let request = RawLine::parse(line, &mut Vec::new());
        let answer = if request.is("GETPOS") {
            self.positions()
        } else if request.is("GETOBS") {
            self.obstacle_count(&request)?
        } else if request.verb.is_empty() && self.dialect() == Dialect::Udk {
            self.true_poses(&request)
        } else {
            return None;
        };
        Some((answer + "\r\n").into_bytes())
    }

    fn positions(&self) -> String {
        let mut answer = format!("POSITIONS {{Robots {}}}", self.robots.len());
        for robot in &self.robots {
            let [x, y, z] = wire::point(&place(robot)).map(|value| wire::truncate(value, 4));
            let empty = if robot.powered(self.now) { "False" } else { "True" };
            let name = &robot.name;
            let _ = write!(
                answer,
                " {{Name {name} Location {x:.4},{y:.4},{z:.4} BatteryEmpty {empty}}}"
            );
        }
        answer
    }

    /// A line for each robot of the class and the name that were asked for, and the line of the end.
    fn true_poses(&self, request: &RawLine) -> String {
        let wanted = |key: &str, own: &str| {
            let asked = request.get(key).map(|asked| asked.rsplit('.').next().unwrap_or_default());
            asked.is_none_or(|asked| asked.is_empty() || asked.eq_ignore_ascii_case(own))
        };
        let mut answer = String::new();
        for robot in &self.robots {
            let class = robot.class.short_name();
            if !(wanted("class", class) && wanted("name", &robot.name)) {
                continue;
            }
            let name = &robot.name;
            let time = self.now.seconds();
            let pose = wire::pose(&robot.vehicle.state().world_from_robot);
            let [x, y, z] = pose.location.map(|value| wire::round(value, 2));
            let [roll, pitch, yaw] = pose.orientation.map(|value| wire::round(value, 2));
            let _ = write!(
                answer,
                "{{Name {name}}} {{Class {class}}} {{Time {time:.4}}} \
                 {{Location {x:.2},{y:.2},{z:.2}}} {{Rotation {roll:.2},{pitch:.2},{yaw:.2}}}\r\n"
            );
        }
        answer + "{End}"
    }

    /// By robots' names or by two points; -1 for a robot that is unknown.
    fn obstacle_count(&self, request: &RawLine) -> Option<String> {
        let robot = |key| {
            let name = request.get(key)?;
            self.robots.iter().find(|robot| robot.name == name).map(place)
        };
        let point = |key| {
            let numbers: Vec<f64> =
                request.get(key)?.split(',').filter_map(|n| n.trim().parse().ok()).collect();
            let wire: [f64; 3] = numbers.try_into().ok()?;
            wire.iter().all(|n| n.is_finite()).then(|| Point3::from(wire::core_vector(wire)))
        };
        let (keys, ends) = if request.get("From").is_some() {
            (["From", "To"], robot("From").zip(robot("To")))
        } else {
            (["Start", "End"], Some((point("Start")?, point("End")?)))
        };
        let count = ends.map_or(-1.0, |(from, to)| self.world.obstacles_between(&from, &to) as f64);
        let [a, b] = keys.map(|key| format!("{{{key} {}}}", request.get(key).unwrap_or_default()));
        Some(format!("NUMOBS {a} {b} {{ObstCount {count:.4}}}"))
    }
}

fn place(robot: &Robot) -> Point3<f64> {
    robot.vehicle.state().world_from_robot.translation.vector.into()
}
