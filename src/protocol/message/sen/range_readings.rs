//! `Sonar`, `Range` and `IR`: named single ranges.

use crate::protocol::encode::{LineWriter, joined};
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// One sensor's range.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeReading {
    /// The sensor's name.
    pub name: String,
    /// Metres; a saturated reading is the maximum range or slightly less, some servers write -1.
    pub range_m: f64,
}

/// Ranges of one or more like sensors.
///
/// ```text
/// UT2004  SEN {Time t} {Type Sonar} {Name F1 Range 1.9991} {Name F2 Range 5.0000} …
/// UDK     SEN {Time t} {Type Sonar} {Name F1} {Range 4.4690}
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeReadings {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// All readings in wire order; UDK sends one a line.
    pub readings: Vec<RangeReading>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl RangeReadings {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let time = fields.time();
        let groups = fields.groups_or_all("Name", "Range");
        let readings = fields.read_groups(groups, |group| {
            let name = group.name();
            let range_m = group.number("Range");
            Ok(RangeReading { name, range_m: group.require("Range", range_m)? })
        });
        Ok(Self { time, readings, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, kind: &str, dialect: Dialect) {
        w.time(self.time, 4).text("Type", kind);
        for RangeReading { name, range_m } in &self.readings {
            let range = joined(&[*range_m], 4);
            super::write_item(w, dialect, name, "Range", &range);
        }
        w.extra(&self.extra);
    }
}
