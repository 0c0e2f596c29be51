//! Sensors: each measures the simulated world and gives the message a server would print.
//!
//! Every number leaves its sensor on the wire's decimal grid, truncated or rounded as servers do;
//! the writer only formats.

mod beam;
mod contact;
mod depth;
mod gauge;
mod hearing;
mod inertial;
mod motion;
mod objects;
mod ranging;
mod rescue;
mod suite;
mod wheels;

pub(crate) use beam::{Beam, IrScanner};
pub(crate) use contact::Camera;
pub(crate) use depth::DepthCamera;
pub(crate) use gauge::Gauge;
pub(crate) use hearing::Ears;
pub(crate) use inertial::{Ins, WorldPose};
pub(crate) use motion::MotionSensor;
pub(crate) use objects::ObjectSensor;
pub(crate) use ranging::{Scanner, Sonar, UDK_CONES, UDK_MAX_INCIDENCE_RAD, UDK_TRACES};
pub(crate) use rescue::{TagMemory, TagReader, VictimSensor};
pub(crate) use suite::{Device, Instant, Item, Suite, Timer, default_interval_s};
pub(crate) use wheels::{Encoder, Odometry, Tachometer};

use super::catalogue::RobotClass;
use super::pan_tilt::PanTilt;
use super::scenario::link_of_mount;
use super::spec::SensorSpec;
use super::vehicle::VehicleState;
use super::world::placed;
use nalgebra::Isometry3;

/// The part of the robot that carries a sensor.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Mount {
    /// The body.
    Body,
    /// A link of a pan-tilt unit: 0 pans, 1 tilts.
    Link {
        /// Index of the unit.
        unit: usize,
        /// Which of its links.
        link: usize,
    },
    /// A wheel, by the name that GEO gives; for encoders.
    Wheel(String),
}

/// Where a sensor sits.
#[derive(Clone, Debug)]
pub(crate) struct Mounting {
    pub(crate) name: String,
    pub(crate) mount: Mount,
    pub(crate) part_from_sensor: Isometry3<f64>,
}

impl Mounting {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        let named = link_of_mount(&spec.mount).and_then(|(name, link)| {
            Some(Mount::Link { unit: units.iter().position(|unit| unit.name == name)?, link })
        });
        let mount = match named {
            Some(link) => link,
            None if spec.mount.ends_with("Wheel") => Mount::Wheel(spec.mount.clone()),
            None => Mount::Body,
        };
        Self {
            name: spec.name.clone(),
            mount,
            part_from_sensor: placed(spec.position, spec.rpy_deg),
        }
    }
}

/// The robot that carries the sensors, as it is at one instant.
#[derive(Clone, Copy)]
pub(crate) struct Carrier<'a> {
    pub(crate) class: &'a RobotClass,
    pub(crate) state: &'a VehicleState,
    pub(crate) units: &'a [PanTilt],
}

impl Carrier<'_> {
    /// The frame of the part that a sensor is mounted on.
    pub(crate) fn robot_from_part(&self, mount: &Mount) -> Isometry3<f64> {
        match mount {
            Mount::Link { unit, link } => self.units[*unit].robot_from_link(*link),
            Mount::Wheel(name) => {
                let centre = self.class.wheel_centres()[wheel_index(name, self.class)];
                Isometry3::translation(centre.x, centre.y, centre.z)
            }
            Mount::Body => Isometry3::identity(),
        }
    }

    /// The frame of a sensor.
    pub(crate) fn world_from_sensor(&self, mounting: &Mounting) -> Isometry3<f64> {
        self.state.world_from_robot
            * self.robot_from_part(&mounting.mount)
            * mounting.part_from_sensor
    }
}

/// Which of [`RobotClass::wheel_centres`] a wheel's name means: `LeftFWheel`, `RightRWheel`,
/// `LeftWheel`, ….
pub(crate) fn wheel_index(name: &str, class: &RobotClass) -> usize {
    let side = usize::from(name.starts_with("Right"));
    let rear = name.contains("RWheel") || name.contains("BWheel");
    if rear && class.wheel_centres().len() == 4 { 2 + side } else { side }
}
