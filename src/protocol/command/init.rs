//! `INIT`: puts a robot into the world.

use crate::protocol::Segment;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use serde::{Deserialize, Serialize};

/// `INIT {ClassName USARBot.P3AT} [{Name R1}] [{Location x,y,z}] [{Rotation r,p,y}] [{Start s}]`.
///
/// There is no acknowledgement: the first STA is the success, and a class that the server does not
/// know gets silence for ever.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Init {
    /// `USARBot.<Robot>`.
    pub class_name: String,
    /// Must differ between robots of one world.
    pub name: Option<String>,
    /// Metres, wire frame (z down).
    pub location: Option<[f64; 3]>,
    /// roll, pitch, yaw, radians, wire frame (yaw clockwise).
    pub rotation: Option<[f64; 3]>,
    /// A start pose by name; wins over location and rotation.
    pub start: Option<String>,
    /// UT3: 255 is none.
    pub team: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Init {
    /// A robot at a named start pose.
    pub fn at_start(class_name: &str, name: &str, start: &str) -> Self {
        Self {
            class_name: class_name.to_owned(),
            name: Some(name.to_owned()),
            start: Some(start.to_owned()),
            ..Self::default()
        }
    }

    /// A robot at a wire pose: metres and radians, z down.
    pub fn at_pose(class_name: &str, name: &str, location: [f64; 3], rotation: [f64; 3]) -> Self {
        Self {
            class_name: class_name.to_owned(),
            name: Some(name.to_owned()),
            location: Some(location),
            rotation: Some(rotation),
            ..Self::default()
        }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            class_name: fields.text("ClassName").unwrap_or_default(),
            name: fields.text("Name"),
            location: fields.engine_vector("Location"),
            rotation: fields.engine_vector("Rotation"),
            start: fields.text("Start"),
            team: fields.engine_integer("Team"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.text("ClassName", &self.class_name).optional_text("Name", self.name.as_deref());
        for (key, vector) in [("Location", &self.location), ("Rotation", &self.rotation)] {
            if let Some(vector) = vector {
                w.shortest_list(key, vector);
            }
        }
        w.optional_text("Start", self.start.as_deref()).optional_integer("Team", self.team);
        w.extra(&self.extra);
    }
}
