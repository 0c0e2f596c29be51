//! `EFF`: the state of an effector (UDK).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `EFF {Time t} {Type Gripper} {Name g} {Status OPEN}`, or a generic effector's `{On}`, `{Off}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Eff {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// `Gripper`, `ToolChanger`, …
    pub type_name: String,
    /// The effector's name.
    pub name: String,
    /// `OPEN` or `CLOSED`.
    pub status: Option<String>,
    /// What a generic effector reports.
    pub on: Option<bool>,
    /// The type of the tool that a tool changer holds.
    pub tool_type: Option<String>,
    /// The name of the tool that a tool changer holds.
    pub tool: Option<String>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Eff {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            time: fields.time(),
            type_name: fields.text("Type").unwrap_or_default(),
            name: fields.name(),
            status: fields.text("Status"),
            on: match (fields.take("On"), fields.take("Off")) {
                (Some(_), _) => Some(true),
                (None, Some(_)) => Some(false),
                (None, None) => None,
            },
            tool_type: fields.text("ToolType"),
            tool: fields.text("Tool"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", &self.type_name).text_unless_empty("Name", &self.name);
        w.optional_text("Status", self.status.as_deref());
        match self.on {
            Some(true) => {
                w.bare("On");
            }
            Some(false) => {
                w.bare("Off");
            }
            None => {}
        }
        if let Some(tool_type) = &self.tool_type {
            w.tight().text("ToolType", tool_type);
        }
        w.optional_text("Tool", self.tool.as_deref()).extra(&self.extra);
    }
}
