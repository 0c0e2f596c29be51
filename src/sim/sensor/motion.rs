//! Sensors of the body's motion (UDK): accelerometers and the inertial unit.

use super::{Carrier, Mounting};
use crate::geometry::wrap_pi;
use crate::protocol::message::sen::{Acceleration, Imu};
use crate::sim::physics::GRAVITY_MPS2;
use crate::sim::spec::SensorSpec;
use crate::sim::wire;
use crate::time::Stamp;
use nalgebra::Vector3;

/// Differences of the body's velocity and angles from one reading to the next, as the server takes
/// them.
#[derive(Clone, Debug)]
pub(crate) struct MotionSensor {
    pub(crate) mounting: Mounting,
    last: Reading,
}

#[derive(Clone, Debug)]
struct Reading {
    at: Stamp,
    velocity_mps: Vector3<f64>,
    /// Roll, pitch, yaw in the wire's sense.
    angles_rad: [f64; 3],
    angle_rates_rps: [f64; 3],
}

impl MotionSensor {
    pub(crate) fn new(spec: &SensorSpec, carrier: &Carrier<'_>, now: Stamp) -> Self {
        Self {
            mounting: Mounting::new(spec, carrier.units),
            last: Reading {
                at: now,
                velocity_mps: carrier.state.velocity_mps,
                angles_rad: wire::orientation(&carrier.state.world_from_robot.rotation),
                angle_rates_rps: [0.0; 3],
            },
        }
    }

    /// Acceleration of the body in the sensor's frame. The server adds the pull of gravity to the
    /// proper one, so that a robot at rest reads 9.81 m/s² downwards.
    pub(crate) fn acceleration(
        &mut self,
        carrier: &Carrier<'_>,
        proper: bool,
        now: Stamp,
        time: Stamp,
    ) -> Acceleration {
        let Step { mut acceleration, .. } = self.step(carrier, now);
        if proper {
            acceleration.z -= GRAVITY_MPS2;
        }
        Acceleration {
            time: Some(time),
            name: self.mounting.name.clone(),
            acceleration: self.in_sensor(carrier, &acceleration),
            proper,
            extra: Vec::new(),
        }
    }

    /// Acceleration without gravity, and the rates of roll, pitch and yaw.
    pub(crate) fn inertial(&mut self, carrier: &Carrier<'_>, now: Stamp, time: Stamp) -> Imu {
        let Step { acceleration, angle_rates_change } = self.step(carrier, now);
        Imu {
            time: Some(time),
            name: self.mounting.name.clone(),
            acceleration: Some(self.in_sensor(carrier, &acceleration)),
            angular_velocity: Some(self.last.angle_rates_rps.map(cut)),
            angular_acceleration: Some(angle_rates_change.map(cut)),
            rotation: Some(self.last.angles_rad.map(wire::angle)),
            extra: Vec::new(),
        }
    }

    fn step(&mut self, carrier: &Carrier<'_>, now: Stamp) -> Step {
        let seconds = (now - self.last.at).seconds();
        let angles_rad = wire::orientation(&carrier.state.world_from_robot.rotation);
        let velocity_mps = carrier.state.velocity_mps;
        if seconds <= 0.0 {
            return Step { acceleration: Vector3::zeros(), angle_rates_change: [0.0; 3] };
        }
        let last = &self.last;
        let rate = |axis: usize| wrap_pi(angles_rad[axis] - last.angles_rad[axis]) / seconds;
        let angle_rates_rps = [rate(0), rate(1), rate(2)];
        let change = |axis: usize| (angle_rates_rps[axis] - last.angle_rates_rps[axis]) / seconds;
        let step = Step {
            acceleration: (velocity_mps - last.velocity_mps) / seconds,
            angle_rates_change: [change(0), change(1), change(2)],
        };
        self.last = Reading { at: now, velocity_mps, angles_rad, angle_rates_rps };
        step
    }

    fn in_sensor(&self, carrier: &Carrier<'_>, world: &Vector3<f64>) -> [f64; 3] {
        let turned = carrier.world_from_sensor(&self.mounting).rotation.inverse() * world;
        wire::vector(&turned).map(cut)
    }
}

/// What changed between two readings, in the world, for each second.
struct Step {
    acceleration: Vector3<f64>,
    angle_rates_change: [f64; 3],
}

fn cut(value: f64) -> f64 {
    wire::truncate(value, 4)
}
