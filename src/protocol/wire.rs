//! Values in the wire's own frame and units, named so that they are not mistaken for the core's.

use serde::{Deserialize, Serialize};

/// A pose as the wire gives it: x forward, **y right, z down**, metres; roll, pitch, yaw in radians
/// about those axes, so yaw is clockwise seen from above (protocol document 5.1).
///
/// The rotation is R = Rz(yaw) · Ry(pitch) · Rx(roll). Conversion to the core's frames is the
/// business of `robot`, and of `sim` in the other direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WirePose {
    /// x, y, z in metres.
    pub location: [f64; 3],
    /// roll, pitch, yaw in radians.
    pub orientation: [f64; 3],
}

/// A named pose: a start pose or a path node.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NamedPose {
    /// The marker's tag; UT2004 repeats `PlayerStart` for markers without one.
    pub name: String,
    /// Where the marker stands, in the world.
    pub pose: WirePose,
}

/// A named scalar, such as a joint's angle in a status line.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NamedValue {
    /// The joint's name as the server spells it.
    pub name: String,
    /// Radians, or metres on a slider.
    pub value: f64,
}
