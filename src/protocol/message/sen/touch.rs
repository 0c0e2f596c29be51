//! `Touch` and `TouchArray`: bumpers.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// One bumper.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TouchReading {
    /// The sensor's name; it may itself be `Touch`.
    pub name: String,
    /// Whether it touches something.
    pub touched: bool,
}

/// Bumpers of one type.
///
/// ```text
/// UT2004  SEN {Type Touch} {Name Sensor1 Touch False} {Name Sensor2 Touch False}
/// UDK     SEN {Time t} {Type Touch} {Name n} {Touch False}
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Touch {
    /// When the line was written; UT2004 sends none by default.
    pub time: Option<Stamp>,
    /// All bumpers in wire order; UDK sends one a line.
    pub readings: Vec<TouchReading>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Touch {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let time = fields.time();
        let groups = fields.groups_or_all("Name", "Touch");
        let readings = fields.read_groups(groups, |group| {
            let name = group.name();
            let touched = group.flag("Touch");
            Ok(TouchReading { name, touched: group.require("Touch", touched)? })
        });
        Ok(Self { time, readings, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, kind: &str, dialect: Dialect) {
        w.time(self.time, 4).text("Type", kind);
        for TouchReading { name, touched } in &self.readings {
            let touched = if *touched { "True" } else { "False" };
            super::write_item(w, dialect, name, "Touch", touched);
        }
        w.extra(&self.extra);
    }
}
