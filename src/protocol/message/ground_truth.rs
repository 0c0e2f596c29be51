//! Ground truth: the simulator's own answer to the question the robot is trying to solve.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment, WirePose};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `SEN {Time t} {Type GroundTruth} {Name n} {Location x,y,z} {Orientation r,p,y}`.
///
/// A variant of [`Message`](super::Message) of its own and not of [`Sen`](super::Sen): code that is
/// handed sensor readings cannot be handed the truth by mistake. It is for scoring only.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GroundTruth {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// `GroundTruth`, or `GroundTruthMovable` (UDK: the sensor's own pose, not the body's).
    pub movable: bool,
    /// The sensor's name.
    pub name: String,
    /// UT2004: 2 decimals, angles in [0, 2π). UDK: 3 decimals, angles of any number of turns.
    pub pose: WirePose,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl GroundTruth {
    pub(super) fn read(fields: &mut Fields<'_>, movable: bool) -> Result<Self, Problem> {
        let time = fields.time();
        let name = fields.name();
        let location = fields.vector("Location");
        let location = fields.require("Location", location)?;
        let orientation = fields.vector("Orientation");
        let orientation = fields.require("Orientation", orientation)?;
        let pose = WirePose { location, orientation };
        Ok(Self { time, movable, name, pose, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        let kind = if self.movable { "GroundTruthMovable" } else { "GroundTruth" };
        let decimals = match dialect {
            Dialect::Ut2004 => 2,
            Dialect::Udk => 3,
        };
        w.time(self.time, 4).text("Type", kind).text_unless_empty("Name", &self.name);
        w.pose(&self.pose, decimals).extra(&self.extra);
    }
}
