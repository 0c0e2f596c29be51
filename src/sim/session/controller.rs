//! The world controller (protocol document 7.5): robots moved by hand, and asked where they are.
//!
//! A map's objects are fixed here, so that nothing is created, spun or sent along waypoints: such lines
//! are ignored in silence, as servers ignore what they do not know.

use super::Session;
use super::connection::ConnectionId;
use crate::protocol::command::{Control, ControlAction};
use crate::protocol::message::ObjectSta;
use crate::protocol::{Message, WirePose};
use crate::sim::wire;

impl Session {
    /// Carries out a CONTROL line of a world controller; other clients' are ignored.
    pub(super) fn control(&mut self, id: ConnectionId, control: &Control) {
        if !self.connections.get(&id).is_some_and(|connection| connection.controller) {
            return;
        }
        match &control.action {
            ControlAction::AbsMove { location, rotation } => {
                self.move_robot(&control.name, |pose| WirePose {
                    location: location.unwrap_or(pose.location),
                    orientation: rotation.unwrap_or(pose.orientation),
                });
            }
            ControlAction::RelMove { location, rotation } => {
                let plus = |a: [f64; 3], b: Option<[f64; 3]>| {
                    let b = b.unwrap_or_default();
                    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
                };
                self.move_robot(&control.name, |pose| WirePose {
                    location: plus(pose.location, *location),
                    orientation: plus(pose.orientation, *rotation),
                });
            }
            ControlAction::GetSta { class_name } => {
                for state in self.states(&control.name, class_name.as_deref()) {
                    self.send(id, &Message::ObjectSta(state));
                }
            }
            _ => tracing::debug!(?control, "the world controller cannot do this here"),
        }
    }

    fn move_robot(&mut self, name: &str, moved: impl FnOnce(WirePose) -> WirePose) {
        let Some(robot) = self.robots.iter_mut().find(|robot| robot.name == name) else { return };
        let pose = moved(wire::pose(&robot.vehicle.state().world_from_robot));
        let finite = pose.location.iter().chain(&pose.orientation).all(|value| value.is_finite());
        if finite {
            robot.vehicle.place(&mut self.physics, &wire::core_pose(&pose));
        }
    }

    /// States of the robots of a name and a class; an empty name means all.
    fn states(&self, name: &str, class: Option<&str>) -> Vec<ObjectSta> {
        let cut = |values: [f64; 3]| values.map(|value| wire::truncate(value, 4));
        let robots = self.robots.iter().filter(|robot| {
            let of_class = |class: &str| {
                let short = class.rsplit('.').next().unwrap_or_default();
                robot.class.short_name().eq_ignore_ascii_case(short)
            };
            (name.is_empty() || robot.name == name) && class.is_none_or(of_class)
        });
        robots
            .map(|robot| {
                let pose = wire::pose(&robot.vehicle.state().world_from_robot);
                ObjectSta {
                    name: robot.name.clone(),
                    size: cut(robot.class.extents_m()),
                    location: Some(cut(pose.location)),
                    memory: String::new(),
                    rotation: Some(cut(pose.orientation)),
                    extra: Vec::new(),
                }
            })
            .collect()
    }
}
