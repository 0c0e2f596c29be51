//! `RFID`: tags near the robot (UT2004).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// One tag.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RfidTag {
    /// An integer as a rule; fires of some worlds appear as `Fire…`.
    pub id: String,
    /// Metres in the sensor's frame, y right; the recorded server sends none.
    pub location: Option<[f64; 3]>,
    /// The tag's memory, if the reader is configured to read it; may hold blanks.
    pub memory: Option<String>,
}

/// `SEN [{Time t}] {Type RFID} {Name n} {ID i} [{Location x,y,z}] [{Mem text}] …`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rfid {
    /// When the line was written, if the server says; the recorded one does.
    pub time: Option<Stamp>,
    /// `RFID`, or `RFIDTag` in one generation.
    pub type_name: String,
    /// The sensor's name.
    pub name: String,
    /// All tags in wire order.
    pub tags: Vec<RfidTag>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Rfid {
    pub(super) fn read(fields: &mut Fields<'_>, type_name: String) -> Result<Self, Problem> {
        let (time, name) = (fields.time(), fields.name());
        let groups = fields.groups("ID");
        let tags = fields.read_groups(groups, |group| {
            Ok(RfidTag {
                id: group.text("ID").unwrap_or_default(),
                location: group.vector("Location"),
                memory: group.text("Mem"),
            })
        });
        Ok(Self { time, type_name, name, tags, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", &self.type_name).text_unless_empty("Name", &self.name);
        for tag in &self.tags {
            w.text("ID", &tag.id);
            if let Some(location) = &tag.location {
                w.list("Location", location, 2);
            }
            w.optional_text("Mem", tag.memory.as_deref());
        }
        w.extra(&self.extra);
    }
}
