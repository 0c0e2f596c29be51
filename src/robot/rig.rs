use super::drive::{BodySpeed, DriveTrain};
use super::head::{Demand, HeadPose, HeadReading, JointAngle, ScanHead};
use super::laser::{Laser, LaserError};
use super::visibility::{GroundView, Visibility};
use crate::protocol::command::{Act, Drive, MisPkg, MisPkgForm, MisPkgLink, Order, Query, Set};
use crate::protocol::message::sen::RangeScanner;
use crate::protocol::message::{AsTa, Conf, LinkState, MisSta};
use crate::protocol::{Command, Dialect, Message};
use crate::scan::LaserLine;
use crate::time::Stamp;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// The robot's body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Length of the hull in metres.
    pub length_m: f64,
    /// Width over the wheels in metres.
    pub width_m: f64,
    /// Height of the hull in metres, without the scan head.
    pub height_m: f64,
    /// Height of the robot frame's origin above level ground, in metres. No message tells it: it is
    /// that of the class, at most half the hull's height, until a scan has measured it.
    pub origin_height_m: f64,
    /// Mass in kilograms.
    pub mass_kg: f64,
}

/// A sonar and where it looks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SonarSensor {
    /// Its name on the wire.
    pub name: String,
    /// Its pose in the robot frame, its axis along x.
    pub robot_from_sonar: Isometry3<f64>,
    /// Opening of its cone in radians.
    pub beam_angle_rad: f64,
    /// Greatest distance it measures, in metres.
    pub max_range_m: f64,
}

/// Any other device whose readings are places: victim sensors, RFID readers, cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Device {
    /// Its type on the wire.
    pub type_name: String,
    /// Its name on the wire.
    pub name: String,
    /// Its mount and the joints that point it.
    pub head: ScanHead,
}

/// The robot as the server describes it: body, wheels, sensors and the joints between them.
///
/// Values of the wire are turned into core frames and units here and nowhere else in the agent. There
/// is no conversion of ground truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rig {
    /// Which commands the server takes.
    pub dialect: Dialect,
    /// Class of the robot without its package, `P3AT` for instance.
    pub class: String,
    /// The body.
    pub body: Body,
    /// The wheels.
    pub drive: DriveTrain,
    /// The laser that scans are made with.
    pub laser: Option<Laser>,
    /// The sonars.
    pub sonars: Vec<SonarSensor>,
    /// Other devices with a mount.
    pub devices: Vec<Device>,
    /// Names of odometry sensors: there are UDK robots without one.
    pub odometry: Vec<String>,
}

/// A reading is cut to a 65536th of a turn and then to four decimals, both towards zero (protocol
/// 1.7), so the true value lies between it and this much more.
const UT2004_READING_CUT_RAD: f64 = 1e-4 + TAU / 65536.0;
/// UDK rounds to four decimals.
const UDK_READING_HALF_RAD: f64 = 5e-5;

impl Rig {
    /// Whether the laser scans one plane only, fixed to the body: 2D mode.
    pub fn is_planar(&self) -> bool {
        self.laser.as_ref().is_none_or(|laser| laser.head.tilt().is_none())
    }

    /// Pose of the laser in the robot frame with its head at `pose`; the robot frame's own without a
    /// laser.
    pub fn robot_from_sensor(&self, pose: HeadPose) -> Isometry3<f64> {
        self.laser
            .as_ref()
            .map_or_else(Isometry3::identity, |laser| laser.head.robot_from_device(pose))
    }

    /// The line of the rig's laser that a message reports; see [`Laser::line`].
    ///
    /// # Errors
    ///
    /// When there is no laser, or the message is no dated line of it.
    pub fn laser_line(
        &self,
        message: &RangeScanner,
        fallback: Option<Stamp>,
    ) -> Result<LaserLine, LaserError> {
        match &self.laser {
            Some(laser) => laser.line(message, self.dialect, fallback),
            None => Err(LaserError::NoLaser { found: message.name.clone() }),
        }
    }

    /// Lets the joints that pan or tilt the laser turn the other way round, for everything that they
    /// carry.
    pub fn invert_head(&mut self, pan: bool, tilt: bool) {
        let Some(laser) = &mut self.laser else { return };
        let axes = [laser.head.pan().filter(|_| pan), laser.head.tilt().filter(|_| tilt)];
        let links: Vec<(String, u32)> =
            axes.into_iter().flatten().map(|axis| (axis.package.clone(), axis.link)).collect();
        let devices = self.devices.iter_mut().map(|device| &mut device.head);
        for head in std::iter::once(&mut laser.head).chain(devices) {
            links.iter().for_each(|(package, link)| head.invert(package, *link));
        }
    }

    /// The laser above level ground.
    pub fn ground_view(&self) -> Option<GroundView<'_>> {
        let laser = self.laser.as_ref()?;
        Some(GroundView {
            head: &laser.head,
            origin_height_m: self.body.origin_height_m,
            half_fov_rad: 0.5 * laser.fov_rad,
        })
    }

    /// What level ground the rig can see; `None` without a laser.
    pub fn visibility(&self) -> Option<Visibility> {
        self.ground_view().map(|view| view.visibility())
    }

    /// Greatest height of body and scan head above the ground, in metres.
    pub fn height_m(&self) -> f64 {
        let hull = self.body.height_m;
        let head = self.ground_view().map_or(0.0, |view| view.laser_height_m());
        // The laser's housing stands about a tenth of a metre above its optical centre.
        const HOUSING_M: f64 = 0.1;
        hull.max(head + HOUSING_M)
    }

    /// Pose of a device in the robot frame; the robot frame's own for a device the rig does not know.
    pub fn device_pose(&self, type_name: &str, name: &str, head: HeadPose) -> Isometry3<f64> {
        let of_type = |d: &&Device| d.type_name.eq_ignore_ascii_case(type_name);
        let named = self.devices.iter().filter(of_type).find(|d| d.name.eq_ignore_ascii_case(name));
        // V leaves the name out where nothing is seen, and a robot has one sensor of a type as a rule.
        named
            .or_else(|| self.devices.iter().find(of_type))
            .map_or_else(Isometry3::identity, |device| device.head.robot_from_device(head))
    }

    /// A status line of the package that carries the laser, in core angles; `None` for any other
    /// package or a line without a time.
    pub fn head_reading(&self, state: &MisSta) -> Option<HeadReading> {
        let half_width_rad = 0.5 * UT2004_READING_CUT_RAD;
        self.reading(state.time?, &state.name, &state.links, |value| {
            (value + half_width_rad.copysign(value), half_width_rad)
        })
    }

    /// The same of an actuator.
    pub fn actuator_reading(&self, state: &AsTa) -> Option<HeadReading> {
        let exact = |value| (value, UDK_READING_HALF_RAD);
        self.reading(state.time?, &state.name, &state.links, exact)
    }

    fn reading(
        &self,
        stamp: Stamp,
        package: &str,
        links: &[LinkState],
        interval: impl Fn(f64) -> (f64, f64),
    ) -> Option<HeadReading> {
        let head = &self.laser.as_ref()?.head;
        let joint = |axis: Option<&super::Axis>| {
            let axis = axis.filter(|axis| axis.package.eq_ignore_ascii_case(package))?;
            let link = links.iter().find(|state| state.link == i64::from(axis.link))?;
            let (value, half_width_rad) = interval(link.value);
            // A cut value of zero may come from either side.
            let (value, half_width_rad) = if link.value == 0.0 {
                (0.0, 2.0 * half_width_rad)
            } else {
                (value, half_width_rad)
            };
            Some(JointAngle { angle_rad: axis.core_angle_rad(value), half_width_rad })
        };
        let (pan, tilt) = (joint(head.pan()), joint(head.tilt()));
        (pan.is_some() || tilt.is_some()).then_some(HeadReading { stamp, pan, tilt })
    }

    /// The lines that make the laser's joints do as told; none for joints that the rig lacks. UDK
    /// knows no rates, so a rate is no command there.
    pub fn head_commands(&self, pan: Option<Demand>, tilt: Option<Demand>) -> Vec<Command> {
        let Some(laser) = &self.laser else { return Vec::new() };
        let demands = [(laser.head.pan(), pan), (laser.head.tilt(), tilt)];
        let wanted: Vec<(&super::Axis, Demand)> =
            demands.into_iter().filter_map(|(axis, demand)| axis.zip(demand)).collect();
        let mut packages: Vec<&str> =
            wanted.iter().map(|(axis, _)| axis.package.as_str()).collect();
        packages.dedup();
        packages
            .into_iter()
            .filter_map(|package| {
                let mut links: Vec<(i64, Demand)> = wanted
                    .iter()
                    .filter(|(axis, _)| axis.package == package)
                    .map(|(axis, demand)| (i64::from(axis.link), wire_demand(axis, *demand)))
                    .collect();
                links.sort_by_key(|&(link, _)| link);
                package_command(self.dialect, package, &links)
            })
            .collect()
    }

    /// Asks the laser for one line at once (protocol 4.5); only scanners without an interval of their
    /// own need it.
    pub fn trigger_command(&self) -> Option<Command> {
        let laser = self.laser.as_ref()?;
        Some(Command::Set(Set::opcode(&laser.type_name, &laser.name, "Scan", None)))
    }

    /// A question that every server answers at once and that changes nothing: how long its answer takes
    /// tells how slow the line is.
    pub fn line_query(&self) -> Command {
        Command::GetConf(Query::of("Robot"))
    }

    /// Whether `message` answers [`Self::line_query`].
    pub fn answers_line_query(&self, message: &Message) -> bool {
        matches!(message, Message::Conf(Conf::Robot(_)))
    }

    /// The DRIVE line for a demanded motion: both sides, in rad/s, never normalised.
    pub fn drive_command(&self, demand: BodySpeed) -> Command {
        let spin = self.drive.spin(demand);
        Command::Drive(Drive::skid(on_wire_grid(spin.left_rps), on_wire_grid(spin.right_rps)))
    }

    /// Stops the wheels.
    pub fn stop_command(&self) -> Command {
        Command::Drive(Drive::skid(0.0, 0.0))
    }
}

fn wire_demand(axis: &super::Axis, demand: Demand) -> Demand {
    match demand {
        Demand::Angle(core) => Demand::Angle(axis.wire_value(axis.clamp(core))),
        Demand::Rate(core) => Demand::Rate(axis.wire_value(core)),
    }
}

fn package_command(dialect: Dialect, package: &str, links: &[(i64, Demand)]) -> Option<Command> {
    match dialect {
        Dialect::Ut2004 => {
            let links = links
                .iter()
                .map(|&(link, demand)| {
                    let (order, value) = match demand {
                        Demand::Angle(value) => (Order::Angle, value),
                        Demand::Rate(value) => (Order::Velocity, value),
                    };
                    MisPkgLink { link, value: on_wire_grid(value), order: Some(order) }
                })
                .collect();
            Some(Command::MisPkg(MisPkg {
                name: package.to_owned(),
                form: MisPkgForm::Links(links),
                ..MisPkg::default()
            }))
        }
        Dialect::Udk => {
            let angles: Vec<(i64, f64)> = links
                .iter()
                .filter_map(|&(link, demand)| match demand {
                    Demand::Angle(value) => Some((link, on_wire_grid(value))),
                    Demand::Rate(_) => None,
                })
                .collect();
            (!angles.is_empty()).then(|| Command::Act(Act::angles(package, angles)))
        }
    }
}

/// Six decimals are finer than any server reads, and keep lines short and free of exponents.
fn on_wire_grid(value: f64) -> f64 {
    let cut = (value * 1e6).round() / 1e6;
    // No minus zero on the wire.
    if cut == 0.0 { 0.0 } else { cut }
}
