//! What the wheels tell: odometry, encoders, tachometers.

use super::{Carrier, Mount, Mounting, wheel_index};
use crate::protocol::Dialect;
use crate::protocol::message::sen::{self, EncoderReading};
use crate::sim::noise::Noise;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::scenario::NoiseSpec;
use crate::sim::spec::{Layout, SensorSpec};
use crate::sim::wire;
use crate::time::Stamp;
use std::f64::consts::TAU;

/// Dead reckoning from the front wheels' encoders; the wheels' slip is not in it.
#[derive(Clone, Debug)]
pub(crate) struct Odometry {
    pub(crate) mounting: Mounting,
    pub(crate) encoder_resolution_rad: f64,
    dialect: Dialect,
    relative_noise: f64,
    /// Effective over nominal radius, left and right.
    radius_factors: [f64; 2],
    source: Noise,
    counted_rad: [f64; 2],
    /// x forward, y **right**, theta **clockwise**, from the spawn pose.
    pose: [f64; 3],
}

impl Odometry {
    pub(crate) fn new(
        spec: &SensorSpec,
        units: &[PanTilt],
        dialect: Dialect,
        noise: &NoiseSpec,
        mut source: Noise,
    ) -> Self {
        let radius_factors = [0; 2].map(|_| 1.0 + noise.wheel_slip * source.normal());
        // The resolution is whole Unreal units: 0.01 rad is 104 of them, which CONF prints as 0.0099.
        let units_of = wire::angle_units(spec.encoder_resolution_rad.unwrap_or(0.01)).max(1.0);
        Self {
            mounting: Mounting::new(spec, units),
            encoder_resolution_rad: wire::units_rad(units_of),
            dialect,
            relative_noise: noise.odometry,
            radius_factors,
            source,
            counted_rad: [0.0; 2],
            pose: [0.0; 3],
        }
    }

    /// Adds what the wheels turned since the last call; `scale` is a fault's factor.
    pub(crate) fn update(&mut self, carrier: &Carrier<'_>, scale: f64) {
        let wheels = &carrier.class.wheels;
        let [left, right] = [0, 1].map(|side| {
            let angle = carrier.state.wheel_angles_rad[side];
            let counted = match self.dialect {
                Dialect::Ut2004 => {
                    (angle / self.encoder_resolution_rad).trunc() * self.encoder_resolution_rad
                }
                Dialect::Udk => angle,
            };
            let turned = counted - self.counted_rad[side];
            self.counted_rad[side] = counted;
            let error = 1.0 + self.relative_noise * self.source.normal();
            turned * wheels.radius_m * self.radius_factors[side] * error * scale
        });
        let way = (left + right) / 2.0;
        let turn = (left - right) / wheels.separation_m;
        let [x, y, theta] = &mut self.pose;
        // UDK's Euler step uses the old heading.
        let heading = match self.dialect {
            Dialect::Ut2004 => *theta + turn / 2.0,
            Dialect::Udk => *theta,
        };
        let (sin, cos) = heading.sin_cos();
        *x += way * cos;
        *y += way * sin;
        *theta += turn;
    }

    /// Forgets the way so far.
    pub(crate) fn reset(&mut self) {
        self.pose = [0.0; 3];
    }

    /// The pose as printed.
    pub(crate) fn read(&self, time: Option<Stamp>) -> sen::Odometry {
        let printed = |value: f64| match self.dialect {
            Dialect::Ut2004 => wire::truncate(value, 4),
            Dialect::Udk => wire::round(value, 4),
        };
        let [x_m, y_m, theta_rad] = self.pose.map(printed);
        sen::Odometry {
            time,
            name: self.mounting.name.clone(),
            x_m,
            y_m,
            theta_rad,
            extra: Vec::new(),
        }
    }
}

/// What an encoder counts.
#[derive(Clone, Debug, PartialEq)]
enum Counted {
    Wheel(usize),
    Joint { unit: usize, joint: usize },
}

/// A counter of one wheel or joint.
///
/// A wheel that rolls forward counts down, as a real recording shows; the count wraps at a turn.
#[derive(Clone, Debug)]
pub(crate) struct Encoder {
    pub(crate) mounting: Mounting,
    pub(crate) resolution_rad: f64,
    counted: Counted,
    relative_noise: f64,
    source: Noise,
    seen_rad: f64,
    angle_rad: f64,
}

impl Encoder {
    pub(crate) fn new(
        spec: &SensorSpec,
        carrier: &Carrier<'_>,
        dialect: Dialect,
        noise: &NoiseSpec,
        source: Noise,
    ) -> Self {
        let mounting = Mounting::new(spec, carrier.units);
        let counted = match (&mounting.mount, dialect) {
            (Mount::Link { unit, link }, _) => Counted::Joint { unit: *unit, joint: *link },
            // UDK encoders are named for the driven wheel they report, in the order of the joints.
            (_, Dialect::Udk) => {
                let number = spec.name.trim_start_matches(|c: char| !c.is_ascii_digit());
                let order = udk_wheel_order(carrier.class.wheel_centres().len());
                let number: usize = number.parse().unwrap_or(0);
                Counted::Wheel(order[number.min(order.len() - 1)])
            }
            (Mount::Wheel(name), _) => Counted::Wheel(wheel_index(name, carrier.class)),
            (Mount::Body, _) => Counted::Wheel(0),
        };
        let units = wire::angle_units(spec.encoder_resolution_rad.unwrap_or(0.01745)).max(1.0);
        Self {
            mounting,
            resolution_rad: wire::units_rad(units),
            counted,
            relative_noise: noise.encoder,
            source,
            seen_rad: 0.0,
            angle_rad: 0.0,
        }
    }

    /// Counts what turned since the last call and reads the counter.
    pub(crate) fn read(&mut self, carrier: &Carrier<'_>) -> EncoderReading {
        let angle = match self.counted {
            Counted::Wheel(wheel) => -carrier.state.wheel_angles_rad[wheel],
            Counted::Joint { unit, joint } => carrier.units[unit].joints[joint].angle_rad,
        };
        let turned = angle - self.seen_rad;
        self.seen_rad = angle;
        self.angle_rad += turned * (1.0 + self.source.symmetric(self.relative_noise));
        let tick = ((self.angle_rad % TAU) / self.resolution_rad).trunc() as i64;
        EncoderReading { name: self.mounting.name.clone(), tick }
    }

    /// Counts from here on.
    pub(crate) fn reset(&mut self) {
        self.angle_rad = 0.0;
    }
}

/// Indices into [`RobotClass::wheel_centres`](crate::sim::RobotClass::wheel_centres) in the order of
/// the UDK server's joints: front right, front left, back right, back left.
fn udk_wheel_order(wheels: usize) -> Vec<usize> {
    if wheels == 4 { vec![1, 0, 3, 2] } else { vec![1, 0] }
}

/// Speeds and angles of all driven wheels (UDK).
#[derive(Clone, Debug)]
pub(crate) struct Tachometer {
    pub(crate) mounting: Mounting,
    last: Option<(Stamp, Vec<f64>)>,
    zero_rad: Vec<f64>,
}

impl Tachometer {
    pub(crate) fn new(spec: &SensorSpec, carrier: &Carrier<'_>) -> Self {
        let wheels = match carrier.class.wheels.layout {
            Layout::FourWheels => 4,
            Layout::TwoWheelsAndCaster => 2,
        };
        Self {
            mounting: Mounting::new(spec, carrier.units),
            last: None,
            zero_rad: vec![0.0; wheels],
        }
    }

    /// Speeds since the last reading, angles since the reset.
    pub(crate) fn read(&mut self, carrier: &Carrier<'_>, time: Stamp) -> sen::Tachometer {
        let angles = carrier.state.wheel_angles_rad.clone();
        let order = udk_wheel_order(angles.len());
        let mut reading = sen::Tachometer {
            time: Some(time),
            name: self.mounting.name.clone(),
            ..sen::Tachometer::default()
        };
        if let Some((then, before)) = self.last.as_ref().filter(|(then, _)| *then < time) {
            let elapsed = (time - *then).seconds();
            reading.velocities_rad_s = order
                .iter()
                .map(|&wheel| wire::round((angles[wheel] - before[wheel]) / elapsed, 4))
                .collect();
            reading.positions_rad = order
                .iter()
                .map(|&wheel| wire::round(angles[wheel] - self.zero_rad[wheel], 4))
                .collect();
        }
        self.last = Some((time, angles));
        reading
    }

    /// Counts angles from here on.
    pub(crate) fn reset(&mut self, carrier: &Carrier<'_>) {
        self.zero_rad.clone_from(&carrier.state.wheel_angles_rad);
    }
}
