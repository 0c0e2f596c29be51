//! `CONF`: the answer to GETCONF, what things can do.

mod items;
mod links;
mod robot;

pub use items::{CameraConf, GripperConf, ItemConf, RangeScannerConf, SonarConf, VictSensorConf};
pub use links::{ActuatorConf, ActuatorLinkConf, PackageConf, PackageLinkConf};
pub use robot::RobotConf;

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment, text};
use serde::{Deserialize, Serialize};

/// One `CONF` line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Conf {
    /// The robot: the answer to `GETCONF {Type Robot}`.
    Robot(RobotConf),
    /// `RangeScanner`, `IRScanner` and other scanners of one line.
    RangeScanner(ItemsConf<RangeScannerConf>),
    /// `Sonar`, `Range` and `IR`.
    Sonar(ItemsConf<SonarConf>),
    /// `VictSensor`.
    VictSensor(ItemsConf<VictSensorConf>),
    /// `Camera`; UDK also sends it unasked once the camera's view exists.
    Camera(ItemsConf<CameraConf>),
    /// `Gripper`.
    Gripper(ItemsConf<GripperConf>),
    /// Mission packages.
    MisPkg(ItemsConf<PackageConf>),
    /// Actuators (UDK).
    Actuator(ItemsConf<ActuatorConf>),
    /// Everything with a scan interval or a resolution at most: odometry, encoders, INS, GPS,
    /// ground truth, tachometer, touch; and types that are not known, with all their segments.
    Item(ItemsConf<ItemConf>),
}

/// The items of one type. An answer without an item means: not found (UT2004).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ItemsConf<T> {
    /// The type that was asked for.
    pub type_name: String,
    /// All items in wire order.
    pub items: Vec<T>,
    /// Segments that belong to no item.
    pub extra: Vec<Segment>,
}

impl<T> ItemsConf<T> {
    fn read<'a>(
        type_name: &[u8],
        fields: &mut Fields<'a>,
        read: impl FnMut(&mut Fields<'a>) -> Result<T, Problem>,
    ) -> Self {
        let groups = fields.groups("Name");
        let items = fields.read_groups(groups, read);
        Self { type_name: text::from_wire(type_name), items, extra: fields.rest() }
    }

    fn write(
        &self,
        w: &mut LineWriter,
        dialect: Dialect,
        write: impl Fn(&T, &mut LineWriter, Dialect),
    ) {
        w.text("Type", &self.type_name);
        for item in &self.items {
            write(item, w, dialect);
        }
        w.extra(&self.extra);
    }
}

impl Conf {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let type_name = fields.take("Type");
        let type_name = fields.require("Type", type_name)?;
        let lower = type_name.to_ascii_lowercase();
        Ok(match lower.as_slice() {
            _ if super::geo::is_vehicle_type(type_name) || fields.has("SteeringType") => {
                Self::Robot(RobotConf::read(fields, text::from_wire(type_name)))
            }
            b"rangescanner" | b"irscanner" => {
                Self::RangeScanner(ItemsConf::read(type_name, fields, RangeScannerConf::read))
            }
            b"sonar" | b"range" | b"ir" => {
                Self::Sonar(ItemsConf::read(type_name, fields, SonarConf::read))
            }
            b"victsensor" => {
                Self::VictSensor(ItemsConf::read(type_name, fields, VictSensorConf::read))
            }
            b"camera" => Self::Camera(ItemsConf::read(type_name, fields, CameraConf::read)),
            b"gripper" => Self::Gripper(ItemsConf::read(type_name, fields, GripperConf::read)),
            b"mispkg" => Self::MisPkg(ItemsConf::read(type_name, fields, PackageConf::read)),
            b"actuator" => Self::Actuator(ItemsConf::read(type_name, fields, ActuatorConf::read)),
            _ => Self::Item(ItemsConf::read(type_name, fields, ItemConf::read)),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        match self {
            Self::Robot(robot) => robot.write(w, dialect),
            Self::RangeScanner(items) => items.write(w, dialect, RangeScannerConf::write),
            Self::Sonar(items) => items.write(w, dialect, SonarConf::write),
            Self::VictSensor(items) => items.write(w, dialect, VictSensorConf::write),
            Self::Camera(items) => items.write(w, dialect, CameraConf::write),
            Self::Gripper(items) => items.write(w, dialect, GripperConf::write),
            Self::MisPkg(items) => items.write(w, dialect, PackageConf::write),
            Self::Actuator(items) => items.write(w, dialect, ActuatorConf::write),
            Self::Item(items) => items.write(w, dialect, ItemConf::write),
        }
    }
}

/// A key that each dialect spells in its own way.
fn spelled(dialect: Dialect, ut2004: &'static str, udk: &'static str) -> &'static str {
    match dialect {
        Dialect::Ut2004 => ut2004,
        Dialect::Udk => udk,
    }
}
