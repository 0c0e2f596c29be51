//! What the server's screen shows, which is all that the image server sends.
//!
//! UT2004 shows one camera, or four: those that SET Viewports names, or with a MultiView connected
//! those of the first four robots, whose STA then tells their tile. UDK shows the cameras in order of
//! their creation in a grid of two by two tiles.

use super::Session;
use super::connection::ConnectionId;
use super::robot::Robot;
use crate::protocol::Dialect;
use crate::protocol::command::SetForm;
use crate::sim::camera::{Screen, View};
use crate::sim::physics::RobotKey;
use crate::sim::sensor::{Camera, Device};
use crate::sim::surroundings::RobotBody;
use nalgebra::{Isometry3, Translation3, Vector3};
use std::sync::Arc;

/// Size of a tile, and of a picture without a camera.
const TILE: [u32; 2] = [320, 240];

/// Opening of the view of whoever watches a world without robots, in radians.
const SPECTATOR_FOV_RAD: f64 = 1.57;

/// Height of that view above the first start pose in metres.
const SPECTATOR_UP_M: f64 = 1.2;

/// What a client has asked the screen of a UT2004 server to show.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Shown {
    /// The first camera of the first robot.
    #[default]
    First,
    /// A robot's camera.
    One(RobotKey, String),
    /// Cameras of one robot by tile; none stays black.
    Four(RobotKey, [Option<String>; 4]),
}

impl Session {
    /// What is on the screen now. It can be drawn on any thread, whenever there is time.
    pub fn screen(&self) -> Screen {
        let bodies: Arc<[RobotBody]> = self.robots.iter().map(Robot::body).collect();
        let view = |robot: &Robot, camera: &Camera, size: [u32; 2]| View {
            world: self.world.clone(),
            bodies: bodies.clone(),
            own: Some(robot.key),
            world_from_camera: robot.carrier().world_from_sensor(&camera.mounting),
            fov_rad: camera.fov_rad,
            width: size[0],
            height: size[1],
        };
        let grid = |tiles: Vec<(usize, View)>| Screen {
            width: 2 * TILE[0],
            height: 2 * TILE[1],
            tiles: tiles.into_iter().map(|(tile, view)| (corner(tile), view)).collect(),
        };
        if self.scenario.dialect == Dialect::Udk {
            let tiles = self.robots.iter().flat_map(|robot| {
                let numbered = (robot.first_tile..).zip(cameras(robot));
                numbered.map(|(tile, camera)| (tile, view(robot, camera, TILE)))
            });
            return grid(tiles.filter(|(tile, _)| *tile < 4).collect());
        }
        if self.multi_view() {
            let seen = self.robots.iter().filter_map(|robot| {
                let tile = usize::try_from(robot.view).ok().filter(|tile| *tile < 4)?;
                Some((tile, view(robot, cameras(robot).next()?, TILE)))
            });
            return grid(seen.collect());
        }
        let named = |key: RobotKey, name: &str| {
            let robot = self.robot(key)?;
            let is_it = |camera: &&Camera| camera.mounting.name.eq_ignore_ascii_case(name);
            Some((robot, cameras(robot).find(is_it)?))
        };
        if let Shown::Four(key, names) = &self.shown
            && self.robot(*key).is_some()
        {
            let tiles = names.iter().enumerate().filter_map(|(tile, name)| {
                let (robot, camera) = named(*key, name.as_ref()?)?;
                Some((tile, view(robot, camera, TILE)))
            });
            return grid(tiles.collect());
        }
        let chosen = match &self.shown {
            Shown::One(key, name) => named(*key, name),
            _ => None,
        };
        let first = || self.robots.iter().find_map(|robot| Some((robot, cameras(robot).next()?)));
        let only = match chosen.or_else(first) {
            Some((robot, camera)) => view(robot, camera, camera.size),
            None => self.spectator(bodies.clone()),
        };
        Screen { width: only.width, height: only.height, tiles: vec![([0, 0], only)] }
    }

    /// The view of whoever watches a world without robots: from above the first start pose.
    fn spectator(&self, bodies: Arc<[RobotBody]>) -> View {
        let start = self.world.starts().first();
        let place = start.map_or_else(Isometry3::identity, |start| start.world_from_robot);
        let up = Translation3::from(Vector3::z() * SPECTATOR_UP_M);
        View {
            world: self.world.clone(),
            bodies,
            own: None,
            world_from_camera: up * place,
            fov_rad: SPECTATOR_FOV_RAD,
            width: TILE[0],
            height: TILE[1],
        }
    }

    fn multi_view(&self) -> bool {
        self.connections.values().any(|connection| connection.multi_view)
    }

    /// Gives the robots their tiles, or takes them away.
    pub(super) fn number_views(&mut self) {
        let on = self.multi_view();
        for (tile, robot) in (0..).zip(&mut self.robots) {
            robot.view = if on { tile } else { -1 };
        }
    }

    /// The first tile of a new robot's cameras.
    pub(super) fn next_tile(&self) -> usize {
        let ends = self.robots.iter().map(|robot| robot.first_tile + cameras(robot).count());
        ends.max().unwrap_or(0)
    }

    /// Lets a SET that was carried out for a client's robot choose what UT2004 shows.
    pub(super) fn choose_view(&mut self, id: ConnectionId, form: &SetForm) {
        let Some(own) = self.connections.get(&id).and_then(|connection| connection.robot) else {
            return;
        };
        match form {
            SetForm::CameraClient { robot, name, .. } => {
                let key = robot.as_ref().and_then(|robot| {
                    self.robots.iter().find(|other| other.name == *robot).map(|other| other.key)
                });
                self.shown = key.map_or(Shown::First, |key| Shown::One(key, name.clone()));
            }
            SetForm::Viewports { config, views } => {
                let camera = |number: i64| {
                    let view = views.iter().find(|(own, _)| *own == number)?;
                    let none = ["none", "disabled"];
                    (!none.contains(&view.1.to_ascii_lowercase().as_str())).then(|| view.1.clone())
                };
                self.shown = if config.eq_ignore_ascii_case("QuadView") {
                    Shown::Four(own, [1, 2, 3, 4].map(camera))
                } else {
                    camera(1).map_or(Shown::First, |name| Shown::One(own, name))
                };
            }
            SetForm::Opcode { .. } | SetForm::CameraFov { .. } => {}
        }
    }
}

fn cameras(robot: &Robot) -> impl Iterator<Item = &Camera> {
    robot.suite.items.iter().filter_map(|item| match &item.device {
        Device::Camera(camera) => Some(camera),
        _ => None,
    })
}

/// Upper left corner of a tile.
pub(super) fn corner(tile: usize) -> [u32; 2] {
    [(tile % 2) as u32 * TILE[0], (tile / 2) as u32 * TILE[1]]
}
