//! What goes wrong in a scenario, and when.

use serde::{Deserialize, Serialize};

/// Something that goes wrong.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultSpec {
    /// Seconds after the session began.
    pub at_s: f64,
    /// How many seconds it lasts; absent means to the end. Sudden kinds ignore it.
    #[serde(default)]
    pub for_s: Option<f64>,
    /// The robot it befalls; absent means all.
    #[serde(default)]
    pub robot: Option<String>,
    /// What happens.
    pub kind: FaultKind,
    /// What it happens to, by kind: a verb, sensor type or sensor name; a package; `left` or
    /// `right`; a direction.
    #[serde(default)]
    pub what: Option<String>,
    /// How much, by kind.
    #[serde(default)]
    pub value: Option<f64>,
}

/// Kinds of faults. The first eight happen between the session and the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// Lines are lost, with probability `value` (1).
    Drop,
    /// Lines come `value` (0.5) seconds late.
    Delay,
    /// Lines come up to `value` (0.5) seconds late, each by its own chance, and others overtake them.
    Reorder,
    /// Lines come twice, with probability `value` (1).
    Duplicate,
    /// Lines come in two pieces, the second `value` (0.05) seconds late.
    Split,
    /// One octet in each line is another, with probability `value` (1).
    Garble,
    /// Nothing comes; all of it comes when the fault ends.
    Stall,
    /// The connection closes.
    Disconnect,
    /// The sensors whose type or name is `what` (all) fall silent.
    SensorLoss,
    /// The tilt of unit `what` (all) stays where it is.
    TiltStuck,
    /// The tilt moves within ± `value` radians only.
    TiltLimits,
    /// The wheels of side `what` (both) are blocked.
    WheelStuck,
    /// Odometry reports `value` times the distance.
    OdometryScale,
    /// Stamps are `value` seconds off.
    ClockJump,
    /// The body gets a push of `value` (1) m/s towards `what`: `forward`, `back`, `left` (default)
    /// or `right`.
    Shove,
}
