//! `SET`: asks an item to do something.

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `SET {Type t} …`; answered by RES in UT2004, by nothing in UDK.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Set {
    /// The item's type, `Joint`, `Camera` or `Viewports`.
    pub type_name: String,
    /// What shall be done.
    pub form: SetForm,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// The forms of a SET.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum SetForm {
    /// `{Name n} {Opcode o} [{Params p}]`; UDK: an empty name means every item of the type.
    Opcode {
        /// The item.
        name: String,
        /// What it shall do: `Scan`, `RESET`, `Read`, `Release`, `Angle`, …
        opcode: String,
        /// The opcode's argument, unread: its form depends on the opcode.
        params: Option<String>,
    },
    /// `{Robot r} {Name c} {Client a}`: shows a camera in the Unreal client at an address (UT2004).
    CameraClient {
        /// The robot whose camera it is; without it the view is detached.
        robot: Option<String>,
        /// The camera.
        name: String,
        /// The client's address.
        client: String,
    },
    /// `{Name c} {FOV a}`: a client's form of zooming.
    CameraFov {
        /// The camera.
        name: String,
        /// Radians.
        fov_rad: f64,
    },
    /// `{Config c} {Viewport1 v} …` (UT2004).
    Viewports {
        /// `SingleView` or `QuadView`.
        config: String,
        /// For each viewport named: its number from 1, and a camera, `None` or `Disabled`.
        views: Vec<(i64, String)>,
    },
}

impl Default for SetForm {
    fn default() -> Self {
        Self::Opcode { name: String::new(), opcode: String::new(), params: None }
    }
}

impl Set {
    /// `SET {Type t} {Name n} {Opcode o} [{Params p}]`.
    pub fn opcode(type_name: &str, name: &str, opcode: &str, params: Option<&str>) -> Self {
        let form = SetForm::Opcode {
            name: name.to_owned(),
            opcode: opcode.to_owned(),
            params: params.map(str::to_owned),
        };
        Self { type_name: type_name.to_owned(), form, extra: Vec::new() }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let type_name = fields.text("Type").unwrap_or_default();
        let form = if fields.has("Opcode") {
            SetForm::Opcode {
                name: fields.name(),
                opcode: fields.text("Opcode").unwrap_or_default(),
                params: fields.text("Params"),
            }
        } else if fields.has("Client") {
            SetForm::CameraClient {
                robot: fields.text("Robot"),
                name: fields.name(),
                client: fields.text("Client").unwrap_or_default(),
            }
        } else if fields.has("Config") {
            let config = fields.text("Config").unwrap_or_default();
            let views = (1..=4)
                .filter_map(|number| Some((number, fields.text(&format!("Viewport{number}"))?)));
            SetForm::Viewports { config, views: views.collect() }
        } else if fields.has("FOV") {
            let name = fields.name();
            SetForm::CameraFov { name, fov_rad: fields.engine_number("FOV").unwrap_or(0.0) }
        } else {
            SetForm::Opcode {
                name: fields.name(),
                opcode: String::new(),
                params: fields.text("Params"),
            }
        };
        Self { type_name, form, extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("Type", &self.type_name);
        match &self.form {
            SetForm::Opcode { name, opcode, params } => {
                w.text_unless_empty("Name", name).text_unless_empty("Opcode", opcode);
                w.optional_text("Params", params.as_deref());
            }
            SetForm::CameraClient { robot, name, client } => {
                w.optional_text("Robot", robot.as_deref());
                w.text("Name", name).text("Client", client);
            }
            SetForm::CameraFov { name, fov_rad } => {
                w.text("Name", name).shortest("FOV", *fov_rad);
            }
            SetForm::Viewports { config, views } => {
                w.text("Config", config);
                for (number, view) in views {
                    w.text(&format!("Viewport{number}"), view);
                }
            }
        }
        w.extra(&self.extra);
    }
}
