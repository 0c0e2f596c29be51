//! `GETGEO` and `GETCONF`.

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `{Type t} [{Name n}]`: `Robot`, `MisPkg`, `Actuator`, or an item's type.
///
/// One at a time: UT2004 keeps a single request of each kind per tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Query {
    /// What is asked about.
    pub type_name: String,
    /// One item of the type; all if absent.
    pub name: Option<String>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Query {
    /// All items of a type, or the robot.
    pub fn of(type_name: &str) -> Self {
        Self { type_name: type_name.to_owned(), ..Self::default() }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            type_name: fields.text("Type").unwrap_or_default(),
            name: fields.text("Name"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("Type", &self.type_name).optional_text("Name", self.name.as_deref());
        w.extra(&self.extra);
    }
}
