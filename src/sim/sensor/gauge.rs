//! Sensors of one number about the body (UDK): height, compass and the minutes since the spawn.

use super::{Carrier, Mounting};
use crate::protocol::message::sen::{Altitude, Compass, MissionTime};
use crate::sim::spec::SensorSpec;
use crate::sim::wire;
use crate::time::Stamp;

/// Where and when the robot was spawned, against which the gauges count.
#[derive(Clone, Debug)]
pub(crate) struct Gauge {
    pub(crate) mounting: Mounting,
    spawned: Stamp,
    spawn_height_m: f64,
}

/// Height of every spawn above the sea, in metres.
const ABOVE_SEA_M: f64 = 111.0;

impl Gauge {
    pub(crate) fn new(spec: &SensorSpec, carrier: &Carrier<'_>, now: Stamp) -> Self {
        Self {
            mounting: Mounting::new(spec, carrier.units),
            spawned: now,
            spawn_height_m: carrier.state.world_from_robot.translation.z,
        }
    }

    /// The body's height above its spawn and above the sea, which it cannot be below.
    pub(crate) fn altitude(&self, carrier: &Carrier<'_>, time: Stamp) -> Altitude {
        let risen_m = carrier.state.world_from_robot.translation.z - self.spawn_height_m;
        Altitude {
            time: Some(time),
            name: self.mounting.name.clone(),
            relative_m: Some(wire::truncate(risen_m, 4)),
            absolute_m: Some(wire::truncate((ABOVE_SEA_M + risen_m).max(0.0), 4)),
            extra: Vec::new(),
        }
    }

    /// The heading against north, which is the world's x axis. The server takes its radians for
    /// Unreal units, twice, and cuts to whole ones between, so that nothing is left of the angle.
    pub(crate) fn compass(&self, carrier: &Carrier<'_>, time: Stamp) -> Compass {
        let [_, _, yaw] = wire::orientation(&carrier.state.world_from_robot.rotation);
        let whole = (-wire::units_rad(yaw)).trunc();
        Compass {
            time: Some(time),
            name: self.mounting.name.clone(),
            magnetic_angle: wire::round(wire::units_rad(whole), 4),
            extra: Vec::new(),
        }
    }

    /// Whole minutes since the spawn.
    pub(crate) fn minutes(&self, now: Stamp, time: Stamp) -> MissionTime {
        let minutes = ((now - self.spawned).seconds() / 60.0) as i64;
        MissionTime {
            time: Some(time),
            name: self.mounting.name.clone(),
            minutes,
            extra: Vec::new(),
        }
    }
}
