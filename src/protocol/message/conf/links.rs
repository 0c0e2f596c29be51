//! Configurations of mission packages and actuators.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use serde::{Deserialize, Serialize};

/// `{Name n}` and its links.
///
/// ```text
/// UT2004  {Link 1} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00} {MinRange 1} {MaxRange 0} …
/// UDK     {Link 1} {JointType Revolute} {MaxRotationSpeed 1.571} {MaxTorque f} {MinRange f} {MaxRange f} …
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PackageConf {
    /// The package's name; its case may differ from GEO's.
    pub name: String,
    /// All links in wire order.
    pub links: Vec<PackageLinkConf>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// What one link can do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PackageLinkConf {
    /// From 1.
    pub link: i64,
    /// `Revolute` or `Prismatic`.
    pub joint_type: String,
    /// rad/s, or m/s if prismatic. UDK's constant 1.571 is enforced by nothing.
    pub max_speed: Option<f64>,
    /// Engine units.
    pub max_torque: Option<f64>,
    /// Radians or metres. **Greater than `max_range` means no limit**, see [`Self::limits`].
    pub min_range: Option<f64>,
    /// Radians or metres.
    pub max_range: Option<f64>,
}

impl PackageLinkConf {
    /// The smallest and largest value, or `None` if the link has no limit.
    pub fn limits(&self) -> Option<[f64; 2]> {
        let (min, max) = (self.min_range?, self.max_range?);
        (min <= max).then_some([min, max])
    }
}

impl PackageConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        let name = group.name();
        let groups = group.groups("Link");
        let links = group.read_groups(groups, |link| {
            let number = link.integer("Link");
            Ok(PackageLinkConf {
                link: link.require("Link", number)?,
                joint_type: link.text("JointType").unwrap_or_default(),
                max_speed: link.number("MaxSpeed").or_else(|| link.number("MaxRotationSpeed")),
                max_torque: link.number("MaxTorque"),
                min_range: link.number("MinRange"),
                max_range: link.number("MaxRange"),
            })
        });
        Ok(Self { name, links, extra: group.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        // The one sample in UT2004 was typed by hand with mixed decimals; a link without limits
        // shows that 1 and 0 are printed as such.
        w.text("Name", &self.name);
        for link in &self.links {
            w.integer("Link", link.link).text_unless_empty("JointType", &link.joint_type);
            match dialect {
                Dialect::Ut2004 => w.optional_number("MaxSpeed", link.max_speed, 2),
                Dialect::Udk => w.optional_number("MaxRotationSpeed", link.max_speed, 3),
            };
            w.optional_number("MaxTorque", link.max_torque, 2);
            let decimals = |value: Option<f64>| match (link.limits(), dialect, value) {
                (None, _, Some(value)) if value.fract() == 0.0 => 0,
                (_, Dialect::Ut2004, _) => 2,
                (_, Dialect::Udk, _) => 4,
            };
            w.optional_number("MinRange", link.min_range, decimals(link.min_range));
            w.optional_number("MaxRange", link.max_range, decimals(link.max_range));
        }
        w.extra(&self.extra);
    }
}

/// `{Name n} {Link 1} {JointType Revolute} {MaxTorque f} {MinValue f} {MaxValue f} …` (UDK).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActuatorConf {
    /// The actuator's name.
    pub name: String,
    /// All links in wire order.
    pub links: Vec<ActuatorLinkConf>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// What one link can do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActuatorLinkConf {
    /// From 1, although ACT counts the same links from 0.
    pub link: i64,
    /// `Revolute` or `Prismatic`.
    pub joint_type: String,
    /// Engine units.
    pub max_torque: Option<f64>,
    /// Radians or metres.
    pub min_value: Option<f64>,
    /// Radians or metres.
    pub max_value: Option<f64>,
}

impl ActuatorConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        let name = group.name();
        let groups = group.groups("Link");
        let links = group.read_groups(groups, |link| {
            let number = link.integer("Link");
            Ok(ActuatorLinkConf {
                link: link.require("Link", number)?,
                joint_type: link.text("JointType").unwrap_or_default(),
                max_torque: link.number("MaxTorque"),
                min_value: link.number("MinValue"),
                max_value: link.number("MaxValue"),
            })
        });
        Ok(Self { name, links, extra: group.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, _: Dialect) {
        w.text("Name", &self.name);
        for link in &self.links {
            w.integer("Link", link.link).text_unless_empty("JointType", &link.joint_type);
            w.optional_number("MaxTorque", link.max_torque, 4);
            w.optional_number("MinValue", link.min_value, 4);
            w.optional_number("MaxValue", link.max_value, 4);
        }
        w.extra(&self.extra);
    }
}
