//! `GEO`: the answer to GETGEO, where things sit.

use crate::protocol::encode::{LineWriter, joined};
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment, WirePose, text};
use serde::{Deserialize, Serialize};

/// One `GEO` line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Geo {
    /// The robot's body: the answer to `GETGEO {Type Robot}`.
    Robot(RobotGeo),
    /// Mountings of all sensors or other items of one type.
    Items(ItemsGeo<Mounting>),
    /// Mission packages (UT2004); a robot without packages answers with none.
    MisPkg(ItemsGeo<PackageGeo>),
    /// Actuators (UDK).
    Actuator(ItemsGeo<ActuatorGeo>),
}

/// `GEO {Type GroundVehicle} {Name n} {Dimensions x,y,z} {COG x,y,z} {WheelRadius r} {WheelSeparation s} {WheelBase b}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RobotGeo {
    /// `GroundVehicle`, …; UDK's aerial and legged robots send none.
    pub vehicle_type: Option<String>,
    /// The class; UT2004 may put the package before it, as in `USARBot.P2AT`.
    pub name: String,
    /// Length, width, height in metres; UDK gives distances between wheels instead of the hull.
    pub dimensions_m: Option<[f64; 3]>,
    /// Centre of gravity, metres, body frame.
    pub cog_m: Option<[f64; 3]>,
    /// Metres.
    pub wheel_radius_m: Option<f64>,
    /// Metres between left and right wheels.
    pub wheel_separation_m: Option<f64>,
    /// Metres between front and rear axle.
    pub wheel_base_m: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// The items of one type. An answer without an item means: not found (UT2004).
///
/// ```text
/// UT2004  GEO {Type Sonar} {Name F1 Location x,y,z Orientation r,p,y Mount HARD} {Name F2 …} …
/// UDK     GEO {Type Sonar} {Name F1} {Location x,y,z} {Orientation r,p,y}{Mount P3AT} …
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ItemsGeo<T> {
    /// The type that was asked for.
    pub type_name: String,
    /// All items in wire order.
    pub items: Vec<T>,
    /// The name that was asked for, if there is no such item.
    pub not_found: Option<String>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// Where an item is mounted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mounting {
    /// The item's name.
    pub name: String,
    /// In the frame of the part that it is mounted on. UDK computes it as a world-frame difference,
    /// right only while the robot stands at zero rotation.
    pub pose: WirePose,
    /// `HARD` (UT2004) or the robot's class (UDK) for the body; else a part such as `RightFWheel`
    /// or `CameraPanTilt_Link2`, or an actuator's name (UDK).
    pub mount: String,
    /// UDK: which link of the actuator, from 1.
    pub mount_link: Option<i64>,
}

/// `{Name n} {Link 1} {ParentLink -1} {Location x,y,z} {Orientation r,p,y} {Link 2} …`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PackageGeo {
    /// The package's name.
    pub name: String,
    /// All links in wire order.
    pub links: Vec<PackageLinkGeo>,
}

/// Where a link's joint sits at zero joint angles.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PackageLinkGeo {
    /// From 1.
    pub link: i64,
    /// UT2004: -1 is the body. UDK: 0 is the actuator's base.
    pub parent_link: i64,
    /// The joint's frame, its z axis being the joint axis, in the parent's static frame
    /// (protocol document 5.4).
    pub pose: Option<WirePose>,
}

/// `{Name n} {Location …} {Orientation …}{Mount P3AT} {Link 1} {Parent 0} {Location …} {Orientation …} …{Tip x,y,z}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActuatorGeo {
    /// The base: name, pose and what it is mounted on.
    pub mounting: Mounting,
    /// All links in wire order.
    pub links: Vec<PackageLinkGeo>,
    /// The tip, in Unreal units through the configured factor.
    pub tip: Option<[f64; 3]>,
}

/// Types that name a robot's body and not an item.
const VEHICLE_TYPES: [&str; 7] = [
    "GroundVehicle",
    "AerialVehicle",
    "NauticVehicle",
    "LeggedRobot",
    "LeggedVehicle",
    "StaticPlatform",
    "Robot",
];

pub(super) fn is_vehicle_type(type_name: &[u8]) -> bool {
    VEHICLE_TYPES.iter().any(|vehicle| type_name.eq_ignore_ascii_case(vehicle.as_bytes()))
}

impl Geo {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let type_name = match fields.take("Type") {
            None => return Ok(Self::Robot(RobotGeo::read(fields, None))),
            Some(vehicle) if is_vehicle_type(vehicle) => {
                return Ok(Self::Robot(RobotGeo::read(fields, Some(text::from_wire(vehicle)))));
            }
            Some(type_name) => type_name,
        };
        if type_name.eq_ignore_ascii_case(b"MisPkg") {
            return Ok(Self::MisPkg(ItemsGeo::read(type_name, fields, |group| {
                Ok(PackageGeo { name: group.name(), links: read_links(group, "ParentLink") })
            })));
        }
        if type_name.eq_ignore_ascii_case(b"Actuator") {
            return Ok(Self::Actuator(ItemsGeo::read(type_name, fields, read_actuator)));
        }
        Ok(Self::Items(ItemsGeo::read(type_name, fields, |group| {
            let name = group.name();
            let pose = group.pose();
            let pose = group.require("Location", pose)?;
            Ok(read_mounting(group, name, pose))
        })))
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        match self {
            Self::Robot(robot) => robot.write(w),
            Self::Items(items) => {
                items.write(w, |w, item| write_mounting(w, item, dialect));
            }
            Self::MisPkg(packages) => packages.write(w, |w, package| {
                w.text("Name", &package.name);
                for link in &package.links {
                    w.integer("Link", link.link).integer("ParentLink", link.parent_link);
                    if let Some(pose) = &link.pose {
                        w.pose(pose, 4);
                    }
                }
            }),
            Self::Actuator(actuators) => actuators.write(w, write_actuator),
        }
    }
}

impl<T> ItemsGeo<T> {
    fn read<'a>(
        type_name: &[u8],
        fields: &mut Fields<'a>,
        read: impl FnMut(&mut Fields<'a>) -> Result<T, Problem>,
    ) -> Self {
        let mut groups = fields.groups("Name");
        let mut not_found = None;
        if let [group] = groups.as_mut_slice()
            && group.len() == 1
        {
            not_found = group.text("Name");
            groups.clear();
        }
        let items = fields.read_groups(groups, read);
        Self { type_name: text::from_wire(type_name), items, not_found, extra: fields.rest() }
    }

    fn write(&self, w: &mut LineWriter, mut item: impl FnMut(&mut LineWriter, &T)) {
        w.text("Type", &self.type_name).optional_text("Name", self.not_found.as_deref());
        for it in &self.items {
            item(w, it);
        }
        w.extra(&self.extra);
    }
}

impl RobotGeo {
    fn read(fields: &mut Fields<'_>, vehicle_type: Option<String>) -> Self {
        Self {
            vehicle_type,
            name: fields.name(),
            dimensions_m: fields.vector("Dimensions"),
            cog_m: fields.vector("COG"),
            wheel_radius_m: fields.number("WheelRadius"),
            wheel_separation_m: fields.number("WheelSeparation"),
            wheel_base_m: fields.number("WheelBase"),
            extra: fields.rest(),
        }
    }

    fn write(&self, w: &mut LineWriter) {
        w.optional_text("Type", self.vehicle_type.as_deref()).text("Name", &self.name);
        for (key, vector) in [("Dimensions", &self.dimensions_m), ("COG", &self.cog_m)] {
            if let Some(vector) = vector {
                w.list(key, vector, 4);
            }
        }
        w.optional_number("WheelRadius", self.wheel_radius_m, 4);
        w.optional_number("WheelSeparation", self.wheel_separation_m, 4);
        w.optional_number("WheelBase", self.wheel_base_m, 4).extra(&self.extra);
    }
}

fn read_mounting(group: &mut Fields<'_>, name: String, pose: WirePose) -> Mounting {
    let mount = group.text("Mount").unwrap_or_default();
    Mounting { name, pose, mount, mount_link: group.integer("MountLink") }
}

fn write_mounting(w: &mut LineWriter, item: &Mounting, dialect: Dialect) {
    let Mounting { name, pose, mount, mount_link } = item;
    match dialect {
        Dialect::Ut2004 if !name.contains(' ') && !mount.contains(' ') => {
            w.compound(&[
                ("Name", name),
                ("Location", &joined(&pose.location, 4)),
                ("Orientation", &joined(&pose.orientation, 4)),
                ("Mount", mount),
            ]);
        }
        Dialect::Ut2004 => {
            w.text("Name", name).pose(pose, 4).text("Mount", mount);
        }
        Dialect::Udk => {
            w.text("Name", name).pose(pose, 2).tight().text("Mount", mount);
            if let Some(link) = mount_link {
                w.tight().integer("MountLink", *link);
            }
        }
    }
}

fn read_actuator(group: &mut Fields<'_>) -> Result<ActuatorGeo, Problem> {
    let tip = group.vector("Tip");
    let name = group.name();
    // The base's pose stands before the first link; each link has its own.
    let links = read_links(group, "Parent");
    let pose = group.pose();
    let pose = group.require("Location", pose)?;
    Ok(ActuatorGeo { mounting: read_mounting(group, name, pose), links, tip })
}

fn write_actuator(w: &mut LineWriter, actuator: &ActuatorGeo) {
    let Mounting { name, pose, mount, mount_link } = &actuator.mounting;
    w.text("Name", name).list("Location", &pose.location, 3);
    w.list("Orientation", &pose.orientation, 2).tight().text("Mount", mount);
    if let Some(link) = mount_link {
        w.tight().integer("MountLink", *link);
    }
    for link in &actuator.links {
        w.integer("Link", link.link).integer("Parent", link.parent_link);
        if let Some(pose) = &link.pose {
            w.list("Location", &pose.location, 3).list("Orientation", &pose.orientation, 2);
        }
    }
    if let Some(tip) = &actuator.tip {
        w.tight().list("Tip", tip, 4);
    }
}

fn read_links(fields: &mut Fields<'_>, parent_key: &str) -> Vec<PackageLinkGeo> {
    let groups = fields.groups("Link");
    fields.read_groups(groups, |group| {
        let link = group.integer("Link");
        let link = group.require("Link", link)?;
        let parent = group.integer(parent_key);
        let parent_link = group.require(parent_key, parent)?;
        Ok(PackageLinkGeo { link, parent_link, pose: group.pose() })
    })
}
