//! What the wireless simulation asks for on the monitor port (protocol document 7.3): where the robots
//! are, and how many obstacles lie between two places.

use super::Session;
use super::robot::Robot;
use crate::protocol::RawLine;
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
