//! `RES`: the answer to a SET (UT2004 only).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `RES [{Time t}] {Type t} …`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Res {
    /// When the answer was written; older servers leave it out.
    pub time: Option<Stamp>,
    /// The type that the SET named.
    pub type_name: String,
    /// The answer itself.
    pub result: SetResult,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// The forms of an answer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum SetResult {
    /// `{Name n} {Status OK}`, after an RFID read with `{ID i} {Mem text}`.
    Item {
        /// The item's name; empty if the answer has none.
        name: String,
        /// Whether the status is `OK`; `Failed` also answers for an item that does not exist.
        ok: bool,
        /// The tag that was read.
        id: Option<String>,
        /// The tag's memory; may hold blanks.
        memory: Option<String>,
    },
    /// `{Name n} {FOV f} {Status OK}`, repeated for every camera.
    Cameras(Vec<CameraResult>),
    /// `{Config c} {Status OK} {Viewport1 v} {Status OK} …`.
    Viewports {
        /// `SingleView` or `QuadView`.
        config: String,
        /// Whether the configuration was taken.
        ok: bool,
        /// For each viewport from 1: a camera's name, `None` or `Disabled`, and whether it was taken.
        views: Vec<(String, bool)>,
    },
}

/// The answer for one camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraResult {
    /// The camera's name.
    pub name: String,
    /// Field of view in radians.
    pub fov_rad: f64,
    /// Whether it was set.
    pub ok: bool,
}

/// The screen has four tiles; the bound keeps a hostile line from costing quadratic time.
const MAX_VIEWPORTS: usize = 16;

fn status(fields: &mut Fields<'_>) -> Option<bool> {
    fields.take("Status").map(|status| status.eq_ignore_ascii_case(b"OK"))
}

fn write_status(w: &mut LineWriter, ok: bool) {
    w.text("Status", if ok { "OK" } else { "Failed" });
}

impl Res {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let time = fields.time();
        let type_name = fields.text("Type").unwrap_or_default();
        let result = if fields.has("Config") {
            let config = fields.text("Config").unwrap_or_default();
            let ok = status(fields);
            let ok = fields.require("Status", ok)?;
            SetResult::Viewports { config, ok, views: read_views(fields) }
        } else if fields.has("FOV") {
            let groups = fields.groups("Name");
            SetResult::Cameras(fields.read_groups(groups, |group| {
                let name = group.name();
                let fov_rad = group.number("FOV");
                let fov_rad = group.require("FOV", fov_rad)?;
                let ok = status(group);
                Ok(CameraResult { name, fov_rad, ok: group.require("Status", ok)? })
            }))
        } else {
            let name = fields.name();
            let ok = status(fields);
            let ok = fields.require("Status", ok)?;
            SetResult::Item { name, ok, id: fields.text("ID"), memory: fields.text("Mem") }
        };
        Ok(Self { time, type_name, result, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 2).text("Type", &self.type_name);
        match &self.result {
            SetResult::Item { name, ok, id, memory } => {
                w.text_unless_empty("Name", name);
                write_status(w, *ok);
                w.optional_text("ID", id.as_deref()).optional_text("Mem", memory.as_deref());
            }
            SetResult::Cameras(cameras) => {
                for camera in cameras {
                    w.text("Name", &camera.name).number("FOV", camera.fov_rad, 4);
                    write_status(w, camera.ok);
                }
            }
            SetResult::Viewports { config, ok, views } => {
                w.text("Config", config);
                write_status(w, *ok);
                for (index, (view, ok)) in views.iter().enumerate() {
                    w.text(&format!("Viewport{}", index + 1), view);
                    write_status(w, *ok);
                }
            }
        }
        w.extra(&self.extra);
    }
}

fn read_views(fields: &mut Fields<'_>) -> Vec<(String, bool)> {
    let mut views = Vec::new();
    while views.len() < MAX_VIEWPORTS
        && let Some(view) = fields.text(&format!("Viewport{}", views.len() + 1))
    {
        views.push((view, status(fields).unwrap_or(false)));
    }
    views
}
