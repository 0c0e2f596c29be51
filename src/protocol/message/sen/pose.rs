//! `Odometry`, `INS` and `INU`: where the robot believes it is.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Segment, WirePose};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `SEN [{Time t}] {Type Odometry} {Name n} {Pose x,y,theta}`, relative to the spawn pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// When the line was written; UT2004 sends none by default.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Metres forward.
    pub x_m: f64,
    /// Metres **to the right**.
    pub y_m: f64,
    /// Radians **clockwise**; UDK does not wrap it.
    pub theta_rad: f64,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Odometry {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let pose = fields.vector("Pose");
        let [x_m, y_m, theta_rad] = fields.require("Pose", pose)?;
        let (time, name) = (fields.time(), fields.name());
        Ok(Self { time, name, x_m, y_m, theta_rad, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "Odometry").text_unless_empty("Name", &self.name);
        w.list("Pose", &[self.x_m, self.y_m, self.theta_rad], 4).extra(&self.extra);
    }
}

/// `SEN {Type INS} {Name n} {Location x,y,z} {Orientation roll,pitch,yaw}`, 2 decimals.
///
/// World frame; it starts from the true pose, so its position is no evidence of localisation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ins {
    /// No server stamps it by default.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Angles wrapped to [0, 2π).
    pub pose: WirePose,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Ins {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let location = fields.vector("Location");
        let location = fields.require("Location", location)?;
        let orientation = fields.vector("Orientation");
        let orientation = fields.require("Orientation", orientation)?;
        let pose = WirePose { location, orientation };
        Ok(Self { time: fields.time(), name: fields.name(), pose, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "INS").text_unless_empty("Name", &self.name);
        w.pose(&self.pose, 2).extra(&self.extra);
    }
}

/// `SEN {Type INU} {Name n} {Orientation roll,pitch,yaw}` (UT2004 of 2006).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inu {
    /// No server stamps it by default.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// roll, pitch, yaw in the wire frame.
    pub orientation_rad: [f64; 3],
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Inu {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let orientation = fields.vector("Orientation");
        Ok(Self {
            orientation_rad: fields.require("Orientation", orientation)?,
            time: fields.time(),
            name: fields.name(),
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "INU").text_unless_empty("Name", &self.name);
        w.list("Orientation", &self.orientation_rad, 2).extra(&self.extra);
    }
}
