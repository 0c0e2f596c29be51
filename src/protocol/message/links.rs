//! `MISSTA` and `ASTA`: where the links of a package or an actuator are.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// The state of one link.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkState {
    /// Counted from 1, as GEO and CONF do.
    pub link: i64,
    /// Radians (metres if prismatic), with the sign and the zero of the commanded value.
    pub value: f64,
    /// UT2004: minus the configured maximum torque, not a measurement.
    pub torque: Option<f64>,
}

/// `MISSTA {Time t} {Name n} {Link 1} {Value v} {Torque q} {Link 2} …` (UT2004).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MisSta {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The mission package's name.
    pub name: String,
    /// All links of the package in wire order.
    pub links: Vec<LinkState>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// `ASTA {Time t} {Name n} {Link 1} {Value v} {Link 2} …` (UDK).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AsTa {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The actuator's name.
    pub name: String,
    /// All links of the actuator in wire order; no torque.
    pub links: Vec<LinkState>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl MisSta {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let (time, name, links) = (fields.time(), fields.name(), read_links(fields));
        Self { time, name, links, extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        let decimals = match dialect {
            Dialect::Ut2004 => 2,
            Dialect::Udk => 4,
        };
        w.time(self.time, decimals as u32).text_unless_empty("Name", &self.name);
        for link in &self.links {
            w.integer("Link", link.link).number("Value", link.value, 4);
            w.optional_number("Torque", link.torque, decimals);
        }
        w.extra(&self.extra);
    }
}

impl AsTa {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let (time, name, links) = (fields.time(), fields.name(), read_links(fields));
        Self { time, name, links, extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text_unless_empty("Name", &self.name);
        for link in &self.links {
            w.integer("Link", link.link).number("Value", link.value, 4);
            w.optional_number("Torque", link.torque, 4);
        }
        w.extra(&self.extra);
    }
}

fn read_links(fields: &mut Fields<'_>) -> Vec<LinkState> {
    let groups = fields.groups("Link");
    fields.read_groups(groups, |group| -> Result<_, Problem> {
        let link = group.integer("Link");
        let link = group.require("Link", link)?;
        let value = group.number("Value");
        let value = group.require("Value", value)?;
        Ok(LinkState { link, value, torque: group.number("Torque") })
    })
}
