//! `Encoder` and `Tachometer`: what the wheels did.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// One encoder.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EncoderReading {
    /// The sensor's name.
    pub name: String,
    /// Steps of `Resolution` radians (CONF; 0.0174 by default); wraps after one turn.
    pub tick: i64,
}

/// Encoders of the robot.
///
/// ```text
/// UT2004  SEN {Type Encoder} {Name ECLeft Tick -277} {Name ECRight Tick -141} …
/// UDK     SEN {Time t} {Type Encoder} {Name W1} {Tick 12}
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Encoder {
    /// When the line was written; UT2004 sends none by default.
    pub time: Option<Stamp>,
    /// All encoders in wire order; UDK sends one a line.
    pub readings: Vec<EncoderReading>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Encoder {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let time = fields.time();
        let groups = fields.groups_or_all("Name", "Tick");
        let readings = fields.read_groups(groups, |group| {
            let name = group.name();
            let tick = group.integer("Tick");
            Ok(EncoderReading { name, tick: group.require("Tick", tick)? })
        });
        Ok(Self { time, readings, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        w.time(self.time, 4).text("Type", "Encoder");
        for EncoderReading { name, tick } in &self.readings {
            super::write_item(w, dialect, name, "Tick", &tick.to_string());
        }
        w.extra(&self.extra);
    }
}

/// `SEN {Time t} {Type Tachometer} {Name n} {Vel v,v,v,v} {Pos p,p,p,p}` (UDK).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tachometer {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// rad/s for each driven wheel in joint order; empty when no time has passed.
    pub velocities_rad_s: Vec<f64>,
    /// Radians since the reset, in the same order.
    pub positions_rad: Vec<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Tachometer {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            time: fields.time(),
            name: fields.name(),
            velocities_rad_s: fields.list("Vel").unwrap_or_default(),
            positions_rad: fields.list("Pos").unwrap_or_default(),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "Tachometer").text_unless_empty("Name", &self.name);
        for (key, values) in [("Vel", &self.velocities_rad_s), ("Pos", &self.positions_rad)] {
            if !values.is_empty() {
                w.list(key, values, 4);
            }
        }
        w.extra(&self.extra);
    }
}
