//! `MOVE` and `GOTO`: avatars (UDK).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `MOVE {Action New} {Type Run} {Location x,y}`, or `{Action Pause}`, `{Action Resume}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Move {
    /// `New`, `Append`, `Pause` or `Resume`.
    pub action: String,
    /// `Walk_Forward`, `Walk_Backward` or `Run`.
    pub gait: Option<String>,
    /// Metres in the world; a third value is taken from the wrong component by the server.
    pub location: Option<[f64; 2]>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Move {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            action: fields.text("Action").unwrap_or_default(),
            gait: fields.text("Type"),
            location: fields.engine_vector("Location"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("Action", &self.action).optional_text("Type", self.gait.as_deref());
        if let Some(location) = &self.location {
            w.shortest_list("Location", location);
        }
        w.extra(&self.extra);
    }
}

/// `GOTO {Name node}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Goto {
    /// The path node.
    pub name: String,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Goto {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self { name: fields.name(), extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("Name", &self.name).extra(&self.extra);
    }
}
