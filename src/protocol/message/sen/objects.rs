//! `ObjectSensor` (UDK) and `Ball` (UT2004): recognised objects.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Segment, WirePose};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// An object that the sensor saw; world frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SeenObject {
    /// The object's tag.
    pub tag: String,
    /// The object's pose in the world.
    pub pose: WirePose,
    /// Where the ray hit, metres.
    pub hit: Option<[f64; 3]>,
    /// The material's name.
    pub material: Option<String>,
}

/// `SEN {Type ObjectSensor} {Name n}` then `{Object tag}{Location …}{Orientation …}{HitLoc …}{Material m}`
/// for each object, without a blank between.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectSensor {
    /// Not sent by default.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// All objects in wire order.
    pub objects: Vec<SeenObject>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl ObjectSensor {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let (time, name) = (fields.time(), fields.name());
        let groups = fields.groups("Object");
        let objects = fields.read_groups(groups, |group| {
            let pose = group.pose();
            Ok(SeenObject {
                tag: group.text("Object").unwrap_or_default(),
                pose: group.require("Location", pose)?,
                hit: group.vector("HitLoc"),
                material: group.text("Material"),
            })
        });
        Ok(Self { time, name, objects, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "ObjectSensor").text_unless_empty("Name", &self.name);
        for object in &self.objects {
            w.text("Object", &object.tag).tight().list("Location", &object.pose.location, 4);
            w.tight().list("Orientation", &object.pose.orientation, 4);
            if let Some(hit) = &object.hit {
                w.tight().list("HitLoc", hit, 4);
            }
            if let Some(material) = &object.material {
                w.tight().text("Material", material);
            }
        }
        w.extra(&self.extra);
    }
}

/// `SEN {Type Ball} {Name n} {Pos3D x,y,z} {Visible true}` (UT2004).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ball {
    /// When the line was written, if the server says.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Metres in the sensor's frame.
    pub position: Option<[f64; 3]>,
    /// Whether the ball is seen.
    pub visible: Option<bool>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Ball {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            time: fields.time(),
            name: fields.name(),
            position: fields.vector("Pos3D"),
            visible: fields.flag("Visible"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "Ball").text_unless_empty("Name", &self.name);
        if let Some(position) = &self.position {
            w.list("Pos3D", position, 4);
        }
        if let Some(visible) = self.visible {
            w.client_flag("Visible", visible);
        }
        w.extra(&self.extra);
    }
}
