use super::beams::unprinted_angle;
use super::class_table::{ClassEntry, camera_pan_tilt, entry};
use super::head::ScanHead;
use super::laser::Laser;
use super::mount::{Joint, JointKind, Mount, corrected_link_location, wire_rotation};
use super::rig::{Body, Device, Rig, SonarSensor};
use super::warning::RigWarning;
use crate::geometry::AngleSpan;
use crate::protocol::command::Query;
use crate::protocol::message::sen::Sen;
use crate::protocol::message::{
    ActuatorConf, ActuatorGeo, Conf, Geo, Mounting, PackageConf, PackageGeo, PackageLinkGeo,
    RangeScannerConf, RobotConf, RobotGeo, SonarConf,
};
use crate::protocol::{Command, Dialect, Message};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Gathers what the server tells of the robot, one message at a time, and makes a [`Rig`] of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigBuilder {
    dialect: Dialect,
    class: String,
    /// Attitude of the robot when GEO was asked, wire roll, pitch and yaw.
    attitude: [f64; 3],
    robot_geo: Option<RobotGeo>,
    robot_conf: Option<RobotConf>,
    mountings: BTreeMap<String, Vec<Mounting>>,
    packages: Vec<PackageGeo>,
    package_confs: Vec<PackageConf>,
    actuators: Vec<ActuatorGeo>,
    actuator_confs: Vec<ActuatorConf>,
    scanners: Vec<RangeScannerConf>,
    sonars: Vec<SonarConf>,
    /// Scanners seen in sensor lines: name and field of view.
    heard: Vec<(String, Option<f64>)>,
    answered: Vec<(Asked, String)>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Asked {
    Geo,
    Conf,
}

/// What UDK rounds the places of sensors to in each axis, in metres (protocol 3.9); UT2004 cuts them to a
/// tenth of a millimetre.
const UDK_PLACE_STEP_M: f64 = 0.01;

/// Sensor types whose mountings are asked for, in the order of asking.
const SENSOR_TYPES: [&str; 7] =
    ["RangeScanner", "Sonar", "VictSensor", "RFID", "Camera", "INS", "Odometry"];

impl RigBuilder {
    /// A rig of which only dialect and class are known yet.
    pub fn new(dialect: Dialect, class: &str) -> Self {
        Self {
            dialect,
            class: class.rsplit('.').next().unwrap_or(class).to_owned(),
            attitude: [0.0; 3],
            robot_geo: None,
            robot_conf: None,
            mountings: BTreeMap::new(),
            packages: Vec::new(),
            package_confs: Vec::new(),
            actuators: Vec::new(),
            actuator_confs: Vec::new(),
            scanners: Vec::new(),
            sonars: Vec::new(),
            heard: Vec::new(),
            answered: Vec::new(),
        }
    }

    /// The attitude (wire roll, pitch, yaw) in which the robot stands while GEO is asked, as INIT or
    /// the start pose gave it. Both engines measure mountings in the world (protocol 3.9, 5.4), so
    /// for a robot that was created at a heading they have to be turned back.
    #[must_use]
    pub fn standing_at(mut self, roll_pitch_yaw: [f64; 3]) -> Self {
        self.attitude = roll_pitch_yaw;
        self
    }

    /// The same for a server of another dialect: which one it is may be known only after its first
    /// answers.
    #[must_use]
    pub fn speaking(mut self, dialect: Dialect) -> Self {
        self.dialect = dialect;
        self
    }

    /// Everything to ask of the server, in order. It must be asked one at a time: UT2004 keeps a
    /// single request of each kind per tick.
    pub fn queries(&self) -> Vec<Command> {
        let joints = match self.dialect {
            Dialect::Ut2004 => "MisPkg",
            Dialect::Udk => "Actuator",
        };
        let both = |what| [Command::GetGeo(Query::of(what)), Command::GetConf(Query::of(what))];
        let mut queries: Vec<Command> =
            ["Robot", "RangeScanner", joints, "Sonar"].into_iter().flat_map(both).collect();
        let located = ["VictSensor", "RFID", "Odometry"];
        queries.extend(located.into_iter().map(|what| Command::GetGeo(Query::of(what))));
        queries
    }

    /// Whether a query of [`Self::queries`] has been answered.
    pub fn has_answer(&self, query: &Command) -> bool {
        let (asked, type_name) = match query {
            Command::GetGeo(query) => (Asked::Geo, &query.type_name),
            Command::GetConf(query) => (Asked::Conf, &query.type_name),
            _ => return false,
        };
        self.answered.iter().any(|(a, t)| *a == asked && t.eq_ignore_ascii_case(type_name))
    }

    /// Learns from a message; true if it told something about the rig.
    pub fn learn(&mut self, message: &Message) -> bool {
        match message {
            Message::Geo(geo) => self.learn_geo(geo),
            Message::Conf(conf) => self.learn_conf(conf),
            Message::Sen(Sen::RangeScanner(line)) => {
                if !self.heard.iter().any(|(name, _)| *name == line.name) {
                    self.heard.push((line.name.clone(), line.fov_rad));
                    return true;
                }
                false
            }
            _ => false,
        }
    }

    fn learn_geo(&mut self, geo: &Geo) -> bool {
        let answered = match geo {
            Geo::Robot(robot) => {
                self.robot_geo = Some(robot.clone());
                "Robot".to_owned()
            }
            Geo::Items(items) => {
                self.mountings.insert(items.type_name.to_ascii_lowercase(), items.items.clone());
                items.type_name.clone()
            }
            Geo::MisPkg(packages) => {
                self.packages = packages.items.clone();
                packages.type_name.clone()
            }
            Geo::Actuator(actuators) => {
                self.actuators = actuators.items.clone();
                actuators.type_name.clone()
            }
        };
        self.answered.push((Asked::Geo, answered));
        true
    }

    fn learn_conf(&mut self, conf: &Conf) -> bool {
        let answered = match conf {
            Conf::Robot(robot) => {
                self.robot_conf = Some(robot.clone());
                "Robot"
            }
            Conf::RangeScanner(items) => {
                self.scanners = items.items.clone();
                &items.type_name
            }
            Conf::Sonar(items) => {
                self.sonars.extend(items.items.iter().cloned());
                &items.type_name
            }
            Conf::MisPkg(items) => {
                self.package_confs = items.items.clone();
                &items.type_name
            }
            Conf::Actuator(items) => {
                self.actuator_confs = items.items.clone();
                &items.type_name
            }
            Conf::VictSensor(items) => &items.type_name,
            // UDK sends it unasked; it says nothing about mountings.
            Conf::Camera(_) | Conf::Gripper(_) => return false,
            Conf::Item(items) => &items.type_name,
        };
        self.answered.push((Asked::Conf, answered.to_owned()));
        true
    }

    /// The rig as far as it is known, the rest from the class table, and what had to be supposed.
    pub fn build(&self) -> (Rig, Vec<RigWarning>) {
        let table = entry(&self.class, self.dialect);
        let mut warnings = Vec::new();
        if !table.known {
            warnings.push(RigWarning::UnknownClass { class: self.class.clone() });
        }
        let (body, mut drive) = (self.body(&table, &mut warnings), table.drive.clone());
        if let Some(geo) = &self.robot_geo {
            let positive = |value: Option<f64>| value.filter(|v| *v > 0.0);
            drive.wheel_radius_m = positive(geo.wheel_radius_m).unwrap_or(drive.wheel_radius_m);
            drive.wheel_separation_m =
                positive(geo.wheel_separation_m).unwrap_or(drive.wheel_separation_m);
            drive.wheel_base_m = positive(geo.wheel_base_m).unwrap_or(drive.wheel_base_m);
        }
        match self.robot_conf.as_ref().and_then(|c| c.max_spin_rad_s).filter(|spin| *spin > 0.0) {
            Some(spin) => drive.max_spin_rps = spin,
            None => warnings.push(RigWarning::NoConf {
                what: "Robot".into(),
                supposed: format!("wheel spin up to {:.3} rad/s", drive.max_spin_rps),
            }),
        }
        let laser = self.laser(&table, &mut warnings);
        let rig = Rig {
            dialect: self.dialect,
            class: self.class.clone(),
            body,
            drive,
            laser,
            sonars: self.sonar_sensors(&mut warnings),
            devices: self.devices(&mut warnings),
            odometry: self.mounted("odometry").iter().map(|m| m.name.clone()).collect(),
        };
        (rig, warnings)
    }

    fn body(&self, table: &ClassEntry, warnings: &mut Vec<RigWarning>) -> Body {
        let mut body = table.body.clone();
        if let Some(mass) = self.robot_conf.as_ref().and_then(|c| c.mass_kg).filter(|m| *m > 0.0) {
            body.mass_kg = mass;
        }
        let told = self.robot_geo.as_ref().and_then(|geo| geo.dimensions_m);
        match told {
            Some([length, width, height]) if height > 0.0 => {
                (body.length_m, body.width_m, body.height_m) = (length, width, height);
                // A hull told with its mast says nothing of where the origin lies: half of it would
                // put the floor far too low, and the guard line would take the floor for a step.
                body.origin_height_m = body.origin_height_m.min(0.5 * height);
            }
            // UDK gives distances between wheels, with no height, in place of the hull.
            Some([length, width, _]) => {
                if !table.known {
                    let wheel = 2.0 * table.drive.wheel_radius_m;
                    (body.length_m, body.width_m) = (length + wheel, width + 0.5 * wheel);
                }
                warnings.push(RigWarning::WheelsForHull {
                    wheels_m: [length, width],
                    supposed_m: [body.length_m, body.width_m, body.height_m],
                });
            }
            None => warnings.push(RigWarning::NoGeo {
                what: "Robot".into(),
                supposed: format!("hull {:.2} × {:.2} m", body.length_m, body.width_m),
            }),
        }
        body
    }

    fn laser(&self, table: &ClassEntry, warnings: &mut Vec<RigWarning>) -> Option<Laser> {
        let mounted: Vec<(&Mounting, ScanHead)> = self
            .mounted("rangescanner")
            .iter()
            .map(|mounting| (mounting, ScanHead::new(self.mount_of(mounting, warnings))))
            .collect();
        // A scanner that can tilt is the one to scan with; else the first.
        let chosen = mounted.iter().find(|(_, head)| head.tilt().is_some()).or(mounted.first());
        let mut laser = table.laser.clone();
        match chosen {
            Some((mounting, head)) => {
                laser.name = mounting.name.clone();
                laser.head = head.clone();
                laser.mounted_within_m = match self.dialect {
                    Dialect::Ut2004 => 0.0,
                    Dialect::Udk => UDK_PLACE_STEP_M / 12_f64.sqrt(),
                };
            }
            None if self.says_there_is_no("RangeScanner") => return None,
            None => {
                if let Some((name, _)) = self.heard.first() {
                    laser.name = name.clone();
                }
                let at = laser.head.robot_from_device(super::HeadPose::default()).translation;
                warnings.push(RigWarning::NoGeo {
                    what: "RangeScanner".into(),
                    supposed: format!(
                        "{} at ({:.3}, {:.3}, {:.3}) m{}",
                        laser.name,
                        at.x,
                        at.y,
                        at.z,
                        if laser.head.tilt().is_some() {
                            " on the pan-tilt"
                        } else {
                            " on the body"
                        }
                    ),
                });
            }
        }
        self.laser_limits(&mut laser, warnings);
        self.link_warnings(&laser.head, warnings);
        Some(laser)
    }

    /// An answer without any item: the robot has no such thing.
    fn says_there_is_no(&self, type_name: &str) -> bool {
        let asked = Command::GetGeo(Query::of(type_name));
        self.has_answer(&asked) && self.heard.is_empty()
    }

    fn laser_limits(&self, laser: &mut Laser, warnings: &mut Vec<RigWarning>) {
        if let Some((_, Some(fov))) =
            self.heard.iter().find(|(name, _)| name.eq_ignore_ascii_case(&laser.name))
        {
            laser.fov_rad = *fov;
        }
        let Some(conf) =
            self.scanners.iter().find(|conf| conf.name.eq_ignore_ascii_case(&laser.name))
        else {
            warnings.push(RigWarning::NoConf {
                what: format!("RangeScanner {}", laser.name),
                supposed: format!("ranges {} to {} m", laser.min_range_m, laser.max_range_m),
            });
            return;
        };
        laser.min_range_m = conf.min_range_m.unwrap_or(laser.min_range_m);
        laser.max_range_m = conf.max_range_m.filter(|m| *m > 0.0).unwrap_or(laser.max_range_m);
        laser.fov_rad = conf.fov_rad.unwrap_or(laser.fov_rad);
        laser.resolution_rad = conf.resolution_rad.unwrap_or(laser.resolution_rad);
    }

    fn link_warnings(&self, head: &ScanHead, warnings: &mut Vec<RigWarning>) {
        if let Some(axis) = head.tilt().or(head.pan()) {
            self.package_warnings(&axis.package, head, warnings);
        }
        for (axis, what) in [(head.pan(), "pan"), (head.tilt(), "tilt")] {
            let Some(axis) = axis else { continue };
            if axis.speed_rad_s.is_none() && self.dialect == Dialect::Ut2004 {
                warnings.push(RigWarning::NoLinkSpeed {
                    package: axis.package.clone(),
                    link: axis.link,
                    role: what.to_owned(),
                });
            }
        }
        if head.tilt().is_none() {
            warnings.push(RigWarning::Planar);
        }
    }

    /// What the server did not tell of the package that turns the laser.
    fn package_warnings(&self, package: &str, head: &ScanHead, warnings: &mut Vec<RigWarning>) {
        let is = |name: &str| name.eq_ignore_ascii_case(package);
        let what = match self.dialect {
            Dialect::Ut2004 => "MisPkg",
            Dialect::Udk => "Actuator",
        };
        let has_geo = self.packages.iter().any(|geo| is(&geo.name))
            || self.actuators.iter().any(|geo| is(&geo.mounting.name));
        if !has_geo {
            let supposed = format!("{package} where the class table has it");
            warnings.push(RigWarning::NoGeo { what: what.into(), supposed });
        }
        let has_conf = self.package_confs.iter().any(|conf| is(&conf.name))
            || self.actuator_confs.iter().any(|conf| is(&conf.name));
        if !has_conf {
            let limits = head.tilt().and_then(|axis| axis.limits);
            let supposed = limits.map_or("a tilt without limits".to_owned(), |span| {
                let degrees = [span.min_rad, span.max_rad].map(f64::to_degrees);
                format!("tilts from {:+.1}° to {:+.1}° (down)", degrees[0], degrees[1])
            });
            warnings.push(RigWarning::NoConf { what: format!("{what} {package}"), supposed });
        }
    }

    fn sonar_sensors(&self, warnings: &mut Vec<RigWarning>) -> Vec<SonarSensor> {
        self.mounted("sonar")
            .iter()
            .map(|mounting| {
                let conf = self.sonars.iter().find(|c| c.name.eq_ignore_ascii_case(&mounting.name));
                let mount = self.mount_of(mounting, warnings);
                SonarSensor {
                    name: mounting.name.clone(),
                    robot_from_sonar: mount.robot_from_device(|_| 0.0),
                    beam_angle_rad: conf.and_then(|c| c.beam_angle_rad).unwrap_or(0.349),
                    max_range_m: conf.and_then(|c| c.max_range_m).unwrap_or(5.0),
                }
            })
            .collect()
    }

    fn devices(&self, warnings: &mut Vec<RigWarning>) -> Vec<Device> {
        SENSOR_TYPES
            .iter()
            .filter(|type_name| !matches!(**type_name, "RangeScanner" | "Sonar"))
            .flat_map(|type_name| self.mounted(type_name).iter().map(move |m| (type_name, m)))
            .map(|(type_name, mounting)| Device {
                type_name: (*type_name).to_owned(),
                name: mounting.name.clone(),
                head: ScanHead::new(self.mount_of(mounting, warnings)),
            })
            .collect()
    }

    fn mounted(&self, type_name: &str) -> &[Mounting] {
        self.mountings.get(&type_name.to_ascii_lowercase()).map_or(&[], Vec::as_slice)
    }

    fn unprinted(&self, orientation: [f64; 3]) -> [f64; 3] {
        orientation.map(|angle| unprinted_angle(angle, self.dialect))
    }

    fn world_from_body(&self) -> UnitQuaternion<f64> {
        let [roll, pitch, yaw] = self.attitude;
        UnitQuaternion::from_euler_angles(roll, pitch, yaw)
    }

    /// The joints and the place of a mounted device.
    fn mount_of(&self, mounting: &Mounting, warnings: &mut Vec<RigWarning>) -> Mount {
        let mut location = mounting.pose.location;
        if self.dialect == Dialect::Udk {
            // UDK prints a difference of world positions (protocol 3.9).
            let body = self.world_from_body().inverse() * Vector3::from(location);
            location = body.into();
        }
        let turned = self.unprinted(mounting.pose.orientation);
        let part_from_device = super::core_pose(location, turned);
        let joints = self.joints_to(&mounting.mount, mounting.mount_link, 0).unwrap_or_else(|| {
            warnings.push(RigWarning::UnknownPart {
                item: mounting.name.clone(),
                part: mounting.mount.clone(),
            });
            Vec::new()
        });
        Mount { joints, part_from_device }
    }

    /// The joints from the body to a part; empty for the body itself, `None` for a part that no
    /// package explains.
    fn joints_to(&self, part: &str, link: Option<i64>, depth: usize) -> Option<Vec<Joint>> {
        // Actuators may sit on actuators; a chain longer than this is a loop.
        const DEEPEST: usize = 8;
        let is_body = part.is_empty()
            || part.eq_ignore_ascii_case("HARD")
            || part.eq_ignore_ascii_case(&self.class);
        if is_body || depth > DEEPEST {
            return Some(Vec::new());
        }
        let (package, link) = match link {
            Some(link) => (part, Some(link)),
            None => package_and_link(part),
        };
        if let Some(geo) = self.packages.iter().find(|p| p.name.eq_ignore_ascii_case(package)) {
            let link = link.or_else(|| geo.links.last().map(|l| l.link))?;
            return self.chain(&geo.name, &geo.links, link, None);
        }
        if let Some(geo) =
            self.actuators.iter().find(|a| a.mounting.name.eq_ignore_ascii_case(package))
        {
            let link = link.or_else(|| geo.links.last().map(|l| l.link))?;
            let turned = self.unprinted(geo.mounting.pose.orientation);
            let base = super::core_pose(geo.mounting.pose.location, turned);
            let mut joints =
                self.joints_to(&geo.mounting.mount, geo.mounting.mount_link, depth + 1)?;
            joints.extend(self.chain(&geo.mounting.name, &geo.links, link, Some(base))?);
            return Some(joints);
        }
        let table = camera_pan_tilt();
        let known = table[0].package.eq_ignore_ascii_case(package) && self.packages.is_empty();
        known.then(|| table.into_iter().take(link.map_or(2, |l| l.max(0) as usize)).collect())
    }

    /// The links from the base of a package to `link`, in that order.
    fn chain(
        &self,
        package: &str,
        links: &[PackageLinkGeo],
        link: i64,
        base: Option<Isometry3<f64>>,
    ) -> Option<Vec<Joint>> {
        let mut path = Vec::new();
        let mut next = link;
        while let Some(geo) = links.iter().find(|l| l.link == next) {
            path.push(geo);
            if path.len() > links.len() {
                return None;
            }
            next = geo.parent_link;
        }
        path.reverse();
        let mut body_from_parent = UnitQuaternion::identity();
        let mut joints = Vec::new();
        for (index, geo) in path.iter().enumerate() {
            let pose = geo.pose.unwrap_or_default();
            let mut location = pose.location;
            if index > 0 && self.dialect == Dialect::Ut2004 {
                location =
                    corrected_link_location(location, &body_from_parent, &self.world_from_body());
            }
            let number = u32::try_from(geo.link).ok()?;
            let (kind, limits, max_speed) = self.link_conf(package, geo.link);
            let turned = self.unprinted(pose.orientation);
            let mut joint = Joint::from_wire(package, number, kind, location, turned);
            (joint.limits, joint.max_speed) = (limits, max_speed);
            body_from_parent *= wire_rotation(&joint);
            if let (0, Some(base)) = (index, base) {
                joint.parent_from_joint = base * joint.parent_from_joint;
            }
            joints.push(joint);
        }
        (!joints.is_empty()).then_some(joints)
    }

    fn link_conf(&self, package: &str, link: i64) -> (JointKind, Option<AngleSpan>, Option<f64>) {
        let kind = |joint_type: &str| match joint_type.eq_ignore_ascii_case("Prismatic") {
            true => JointKind::Prismatic,
            false => JointKind::Revolute,
        };
        let span = |limits: Option<[f64; 2]>| limits.map(|[low, high]| AngleSpan::new(low, high));
        if let Some(conf) = self.package_confs.iter().find(|c| c.name.eq_ignore_ascii_case(package))
            && let Some(conf) = conf.links.iter().find(|l| l.link == link)
        {
            let speed = conf.max_speed.filter(|speed| *speed > 0.0);
            return (kind(&conf.joint_type), span(conf.limits()), speed);
        }
        if let Some(conf) =
            self.actuator_confs.iter().find(|c| c.name.eq_ignore_ascii_case(package))
            && let Some(conf) = conf.links.iter().find(|l| l.link == link)
        {
            let limits = conf.min_value.zip(conf.max_value).filter(|(low, high)| low <= high);
            return (kind(&conf.joint_type), span(limits.map(|(low, high)| [low, high])), None);
        }
        (JointKind::Revolute, None, None)
    }
}

/// Splits a part name such as `CameraPanTilt_Link2`.
fn package_and_link(part: &str) -> (&str, Option<i64>) {
    let lower = part.to_ascii_lowercase();
    match lower.rfind("_link") {
        Some(at) => match part[at + "_link".len()..].parse() {
            Ok(link) => (&part[..at], Some(link)),
            Err(_) => (part, None),
        },
        None => (part, None),
    }
}
