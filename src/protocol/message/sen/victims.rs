//! `VictSensor`, `VictRFID` and `HumanMotion`: signs of people.

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// A body part that the victim sensor reports; a false alarm looks the same.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VictimPart {
    /// `Head`, `Arm`, `Hand`, `Chest`, `Pelvis`, `Leg` or `Foot`.
    pub part: String,
    /// Metres in the sensor's frame: x forward, y right, z down.
    pub location: [f64; 3],
}

/// `SEN [{Time t}] {Type VictSensor} [{Name n}] {Status NoVictims}`, or `{PartName p} {Location …}`
/// for each part seen (UT2004, 2007 and later).
///
/// With nothing seen some servers leave the name out and others, the recorded one too, do not.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VictSensor {
    /// When the line was written; not every server sends it.
    pub time: Option<Stamp>,
    /// The sensor's name; may be empty.
    pub name: String,
    /// `NoVictims`.
    pub status: Option<String>,
    /// All parts seen, in wire order.
    pub parts: Vec<VictimPart>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl VictSensor {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let (time, name, status) = (fields.time(), fields.name(), fields.text("Status"));
        let groups = fields.groups("PartName");
        let parts = fields.read_groups(groups, |group| {
            let part = group.text("PartName").unwrap_or_default();
            let location = group.vector("Location");
            Ok(VictimPart { part, location: group.require("Location", location)? })
        });
        Ok(Self { time, name, status, parts, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "VictSensor").text_unless_empty("Name", &self.name);
        w.optional_text("Status", self.status.as_deref());
        for VictimPart { part, location } in &self.parts {
            w.text("PartName", part).list("Location", location, 2);
        }
        w.extra(&self.extra);
    }
}

/// A victim's tag; more of it is told as the robot comes closer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VictimTag {
    /// The identity; the text `None` while too far away.
    pub id: String,
    /// The later variant's name.
    pub name: Option<String>,
    /// The text `None` while too far away.
    pub status: Option<String>,
    /// Metres in the sensor's frame.
    pub location: Option<[f64; 3]>,
}

/// `SEN {Type VictRFID} {Name n} {ID i} {Status s} {Location x,y,z} …` (UT2004, 2006), or the later
/// `{VictimId i} {VictimName n} {VictimStatus s} {Location x,y,z} …`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VictRfid {
    /// When the line was written, if the server says.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// All tags in wire order.
    pub tags: Vec<VictimTag>,
    /// Whether the keys are those of the later variant.
    pub long_keys: bool,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// Keys of identity, name and status in the two variants.
const TAG_KEYS: [[&str; 3]; 2] =
    [["ID", "Name", "Status"], ["VictimId", "VictimName", "VictimStatus"]];

impl VictRfid {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let (time, name) = (fields.time(), fields.name());
        let long_keys = fields.has("VictimId");
        let [id, tag_name, status] = TAG_KEYS[usize::from(long_keys)];
        let groups = fields.groups(id);
        let tags = fields.read_groups(groups, |group| {
            Ok(VictimTag {
                id: group.text(id).unwrap_or_default(),
                name: group.text(tag_name),
                status: group.text(status),
                location: group.vector("Location"),
            })
        });
        Ok(Self { time, name, tags, long_keys, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        let [id, name, status] = TAG_KEYS[usize::from(self.long_keys)];
        w.time(self.time, 4).text("Type", "VictRFID").text_unless_empty("Name", &self.name);
        for tag in &self.tags {
            w.text(id, &tag.id).optional_text(name, tag.name.as_deref());
            w.optional_text(status, tag.status.as_deref());
            if let Some(location) = &tag.location {
                w.list("Location", location, 2);
            }
        }
        w.extra(&self.extra);
    }
}

/// `SEN {Type HumanMotion} {Name n} {Prob p}` (UT2004; known from one client).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HumanMotion {
    /// When the line was written, if the server says.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// 0–1.
    pub probability: f64,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl HumanMotion {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let probability = fields.number("Prob");
        let probability = fields.require("Prob", probability)?;
        Ok(Self { time: fields.time(), name: fields.name(), probability, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "HumanMotion").text_unless_empty("Name", &self.name);
        w.number("Prob", self.probability, 4).extra(&self.extra);
    }
}
