//! `CO2Sensor` (UT2004) and `MissionTime` (UDK).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `SEN {Type CO2Sensor} {Name n} {Gas CO2} {Density 0.00}` (UT2004).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gas {
    /// When the line was written, if the server says.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// The gas.
    pub gas: String,
    /// As the server wrote it, 2 decimals.
    pub density: f64,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Gas {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let density = fields.number("Density");
        Ok(Self {
            density: fields.require("Density", density)?,
            time: fields.time(),
            name: fields.name(),
            gas: fields.text("Gas").unwrap_or_default(),
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "CO2Sensor").text_unless_empty("Name", &self.name);
        w.text_unless_empty("Gas", &self.gas).number("Density", self.density, 2).extra(&self.extra);
    }
}

/// `SEN {Type MissionTime} {Name n} {Minutes i}` (UDK).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MissionTime {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Whole minutes.
    pub minutes: i64,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl MissionTime {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let minutes = fields.integer("Minutes");
        let minutes = fields.require("Minutes", minutes)?;
        Ok(Self { time: fields.time(), name: fields.name(), minutes, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "MissionTime").text_unless_empty("Name", &self.name);
        w.integer("Minutes", self.minutes).extra(&self.extra);
    }
}
