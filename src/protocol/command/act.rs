//! `ACT`: the links of an actuator (UDK).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `ACT {Name n} {Link 0} {Value v} {Link 1} {Value v} …`.
///
/// The wire counts links from 0 here and from 1 in ASTA, GEO and CONF. **In this type they count
/// from 1 as everywhere else**; reading and writing do the shift.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Act {
    /// The actuator.
    pub name: String,
    /// What its links shall do.
    pub links: Vec<ActLink>,
    /// 0 or 1.
    pub gripper: Option<i64>,
    /// A stored sequence.
    pub sequence: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// One link of an actuator command.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActLink {
    /// From **1**, as ASTA numbers it; 1 is `{Link 0}` on the wire.
    pub link: i64,
    /// Radians, metres if prismatic; clamped to the joint's limits by the server.
    pub value: f64,
}

impl Act {
    /// Links (from 1) to absolute angles in radians.
    pub fn angles(name: &str, links: impl IntoIterator<Item = (i64, f64)>) -> Self {
        let links = links.into_iter().map(|(link, value)| ActLink { link, value }).collect();
        Self { name: name.to_owned(), links, ..Self::default() }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let name = fields.name();
        let gripper = fields.engine_integer("Gripper");
        let sequence = fields.engine_integer("Sequence");
        let groups = fields.groups("Link");
        let links = fields.read_groups(groups, |group| {
            let wire_link = group.engine_integer("Link").unwrap_or(0);
            let value = group.engine_number("Value").unwrap_or(0.0);
            Ok(ActLink { link: wire_link.saturating_add(1), value })
        });
        Self { name, links, gripper, sequence, extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("Name", &self.name);
        for ActLink { link, value } in &self.links {
            w.integer("Link", link.saturating_sub(1)).shortest("Value", *value);
        }
        w.optional_integer("Gripper", self.gripper).optional_integer("Sequence", self.sequence);
        w.extra(&self.extra);
    }
}
