use super::frames::core_pose;
use crate::protocol::message::GroundTruth;
use crate::time::Stamp;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// The robot's true pose, for scoring.
///
/// The rig offers no conversion of ground truth, and nothing in the core takes this type: only the
/// shell, which writes reports, makes one. `tests/truth.rs` holds the core to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScoringTruth {
    /// True pose of the robot in the simulator's world, core axes.
    pub world_from_robot: Isometry3<f64>,
    /// When, if the server says.
    pub stamp: Option<Stamp>,
}

impl ScoringTruth {
    /// The truth of a message; `None` for UDK's movable variant, which tells the sensor's own pose.
    pub fn of(message: &GroundTruth) -> Option<Self> {
        (!message.movable).then(|| Self {
            world_from_robot: core_pose(message.pose.location, message.pose.orientation),
            stamp: message.time,
        })
    }
}
