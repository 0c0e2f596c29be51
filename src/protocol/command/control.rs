//! `CONTROL`: the world controller (protocol document 7.5).

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::number;
use serde::{Deserialize, Serialize};

/// `CONTROL {Type t} [{Name n}] …`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Control {
    /// The object or robot; empty if the line names none.
    pub name: String,
    /// What shall be done.
    pub action: ControlAction,
    /// Segments not named above, such as `Material` and `Permanent` of a new object.
    pub extra: Vec<Segment>,
}

/// The actions of the world controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ControlAction {
    /// A new object.
    Create {
        /// Its class.
        class_name: String,
        /// Metres, wire frame.
        location: [f64; 3],
        /// roll, pitch, yaw in radians.
        rotation: [f64; 3],
        /// Factors along x, y, z.
        scale: Option<[f64; 3]>,
        /// `None`, `RigidBody`; UT2004: `None`, `Ground`, `Falling`.
        physics: Option<String>,
        /// Its memory text.
        memory: Option<String>,
    },
    /// Removes an object.
    Kill,
    /// Removes all objects, or those between two corners.
    KillAll {
        /// Smallest and largest coordinates, metres, wire frame.
        corners: Option<[[f64; 3]; 2]>,
    },
    /// Moves an object or a robot to a pose.
    AbsMove {
        /// Metres, wire frame.
        location: Option<[f64; 3]>,
        /// roll, pitch, yaw in radians.
        rotation: Option<[f64; 3]>,
    },
    /// Moves an object or a robot by a pose.
    RelMove {
        /// Metres, wire frame.
        location: Option<[f64; 3]>,
        /// roll, pitch, yaw in radians.
        rotation: Option<[f64; 3]>,
    },
    /// Spins an object.
    Rotate {
        /// roll, pitch, yaw per second.
        speed: [f64; 3],
    },
    /// Appends waypoints.
    AddWp(Waypoints),
    /// Replaces waypoints.
    SetWp(Waypoints),
    /// Forgets waypoints.
    ClearWp,
    /// Sets a conveyor's speed.
    Conveyor {
        /// As the server takes it.
        speed: f64,
    },
    /// Asks for STA lines of objects.
    GetSta {
        /// One class; all if absent.
        class_name: Option<String>,
    },
    /// An action that is not known; its segments are among the extra ones.
    Other(String),
}

impl Default for ControlAction {
    fn default() -> Self {
        Self::Other(String::new())
    }
}

/// `[{WP x,y,z;x,y,z;…}] [{Speed s}|{Time t}] [{Loop b}] [{ResetOnClear b}] [{Moving b}]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Waypoints {
    /// Metres, wire frame.
    pub points: Vec<[f64; 3]>,
    /// Metres per second.
    pub speed: Option<f64>,
    /// Seconds for the whole way.
    pub time_s: Option<f64>,
    /// Whether the way begins again at its end.
    pub repeat: Option<bool>,
    /// Whether clearing sets the object back.
    pub reset_on_clear: Option<bool>,
    /// Whether the object moves.
    pub moving: Option<bool>,
}

impl Waypoints {
    fn read(fields: &mut Fields<'_>) -> Self {
        let list = fields.take("WP").unwrap_or_default();
        let points = list.split(|octet| *octet == b';');
        Self {
            points: points.filter_map(|point| number::array(point).ok()).collect(),
            speed: fields.engine_number("Speed"),
            time_s: fields.engine_number("Time"),
            repeat: fields.flag("Loop"),
            reset_on_clear: fields.flag("ResetOnClear"),
            moving: fields.flag("Moving"),
        }
    }

    fn write(&self, w: &mut LineWriter) {
        let points: Vec<_> = self.points.iter().map(|[x, y, z]| format!("{x},{y},{z}")).collect();
        w.text_unless_empty("WP", &points.join(";"));
        for (key, value) in [("Speed", self.speed), ("Time", self.time_s)] {
            if let Some(value) = value {
                w.shortest(key, value);
            }
        }
        let flags =
            [("Loop", self.repeat), ("ResetOnClear", self.reset_on_clear), ("Moving", self.moving)];
        for (key, flag) in flags {
            if let Some(flag) = flag {
                w.client_flag(key, flag);
            }
        }
    }
}

impl Control {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let type_name = fields.text("Type").unwrap_or_default();
        let name = fields.name();
        let action = ControlAction::read(type_name, fields);
        Self { name, action, extra: fields.rest() }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("Type", self.action.type_name());
        if let ControlAction::Create { class_name, .. } = &self.action {
            w.text("ClassName", class_name);
        }
        if let ControlAction::GetSta { class_name } = &self.action {
            w.optional_text("ClassName", class_name.as_deref());
        }
        w.text_unless_empty("Name", &self.name);
        self.action.write(w);
        w.extra(&self.extra);
    }
}

impl ControlAction {
    fn read(type_name: String, fields: &mut Fields<'_>) -> Self {
        let class_name = |fields: &mut Fields<'_>| fields.text("ClassName");
        match type_name.to_ascii_lowercase().as_str() {
            "create" => Self::Create {
                class_name: class_name(fields).unwrap_or_default(),
                location: fields.engine_vector("Location").unwrap_or_default(),
                rotation: fields.engine_vector("Rotation").unwrap_or_default(),
                scale: fields.engine_vector("Scale"),
                physics: fields.text("Physics"),
                memory: fields.text("Memory"),
            },
            "kill" => Self::Kill,
            "killall" => {
                let corners = ["MinPos", "MaxPos"].map(|key| fields.engine_vector(key));
                let corners = match corners {
                    [Some(min), Some(max)] => Some([min, max]),
                    _ => None,
                };
                Self::KillAll { corners }
            }
            "absmove" => Self::AbsMove {
                location: fields.engine_vector("Location"),
                rotation: fields.engine_vector("Rotation"),
            },
            "relmove" => Self::RelMove {
                location: fields.engine_vector("Location"),
                rotation: fields.engine_vector("Rotation"),
            },
            "rotate" => Self::Rotate { speed: fields.engine_vector("Speed").unwrap_or_default() },
            "addwp" => Self::AddWp(Waypoints::read(fields)),
            "setwp" => Self::SetWp(Waypoints::read(fields)),
            "clearwp" => Self::ClearWp,
            "conveyor" => Self::Conveyor { speed: fields.engine_number("Speed").unwrap_or(0.0) },
            "getsta" => Self::GetSta { class_name: class_name(fields) },
            _ => Self::Other(type_name),
        }
    }

    fn type_name(&self) -> &str {
        match self {
            Self::Create { .. } => "Create",
            Self::Kill => "Kill",
            Self::KillAll { .. } => "KillAll",
            Self::AbsMove { .. } => "AbsMove",
            Self::RelMove { .. } => "RelMove",
            Self::Rotate { .. } => "Rotate",
            Self::AddWp(_) => "AddWP",
            Self::SetWp(_) => "SetWP",
            Self::ClearWp => "ClearWP",
            Self::Conveyor { .. } => "Conveyor",
            Self::GetSta { .. } => "GetSTA",
            Self::Other(name) => name,
        }
    }

    fn write(&self, w: &mut LineWriter) {
        let vector = |w: &mut LineWriter, key: &str, vector: &Option<[f64; 3]>| {
            if let Some(vector) = vector {
                w.shortest_list(key, vector);
            }
        };
        match self {
            Self::Create { location, rotation, scale, physics, memory, .. } => {
                w.shortest_list("Location", location).shortest_list("Rotation", rotation);
                vector(w, "Scale", scale);
                w.optional_text("Physics", physics.as_deref());
                w.optional_text("Memory", memory.as_deref());
            }
            Self::KillAll { corners: Some([min, max]) } => {
                w.shortest_list("MinPos", min).shortest_list("MaxPos", max);
            }
            Self::AbsMove { location, rotation } | Self::RelMove { location, rotation } => {
                vector(w, "Location", location);
                vector(w, "Rotation", rotation);
            }
            Self::Rotate { speed } => {
                w.shortest_list("Speed", speed);
            }
            Self::AddWp(waypoints) | Self::SetWp(waypoints) => waypoints.write(w),
            Self::Conveyor { speed } => {
                w.shortest("Speed", *speed);
            }
            Self::Kill
            | Self::KillAll { corners: None }
            | Self::ClearWp
            | Self::GetSta { .. }
            | Self::Other(_) => {}
        }
    }
}
