//! The INS with its drift, and the true pose.

use super::{Carrier, Mounting};
use crate::geometry::wrap_pi;
use crate::protocol::message::{GroundTruth, sen};
use crate::protocol::{Dialect, WirePose};
use crate::sim::noise::Noise;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::scenario::NoiseSpec;
use crate::sim::spec::SensorSpec;
use crate::sim::wire;
use crate::time::Stamp;

/// Half widths of the biases that are drawn once for each robot, of angles and of positions.
const ANGLE_BIAS: f64 = 0.5e-6;
const POSITION_BIAS: f64 = 0.5e-3;

/// A turn smaller than this between two steps counts as none: the engine's angle unit, in radians.
const NO_TURN_RAD: f64 = std::f64::consts::TAU / 65_536.0;

/// Inertial navigation: integrates true motion with errors in proportion to it (protocol document
/// 5.2), so that a resting robot does not drift.
#[derive(Clone, Debug)]
pub(crate) struct Ins {
    pub(crate) mounting: Mounting,
    sigma: f64,
    source: Noise,
    angle_bias: [f64; 3],
    position_bias: [f64; 3],
    /// The body's pose at the last step.
    last: Option<WirePose>,
    /// Integration begins after one step without a turn.
    running: bool,
    estimate: WirePose,
}

impl Ins {
    pub(crate) fn new(
        spec: &SensorSpec,
        carrier: &Carrier<'_>,
        noise: &NoiseSpec,
        mut source: Noise,
    ) -> Self {
        let mounting = Mounting::new(spec, carrier.units);
        let scale = if noise.ins > 0.0 { 1.0 } else { 0.0 };
        let angle_bias = [0; 3].map(|_| source.symmetric(ANGLE_BIAS * scale));
        let position_bias = [0; 3].map(|_| source.symmetric(POSITION_BIAS * scale));
        // The estimate starts at the sensor and integrates the body, so the mounting offset stays.
        let mut estimate = wire::pose(&carrier.world_from_sensor(&mounting));
        estimate.orientation = estimate.orientation.map(wire::full_turn);
        Self {
            mounting,
            sigma: noise.ins,
            source,
            angle_bias,
            position_bias,
            last: None,
            running: false,
            estimate,
        }
    }

    /// One step of the integration; steps are 0.2 s apart in both dialects.
    pub(crate) fn update(&mut self, carrier: &Carrier<'_>) {
        let truth = wire::pose(&carrier.state.world_from_robot);
        let Some(last) = self.last.replace(truth) else { return };
        let mut turn = [0.0; 3];
        let mut way = [0.0; 3];
        for axis in 0..3 {
            turn[axis] = wrap_pi(truth.orientation[axis] - last.orientation[axis]);
            way[axis] = truth.location[axis] - last.location[axis];
        }
        if !self.running {
            self.running = turn.iter().all(|angle| angle.abs() < NO_TURN_RAD);
            return;
        }
        let length = way.iter().map(|d| d * d).sum::<f64>().sqrt();
        for axis in 0..3 {
            let error = self.angle_bias[axis] + self.sigma * self.source.normal();
            let angle = self.estimate.orientation[axis] + turn[axis] * (1.0 + error);
            self.estimate.orientation[axis] = wire::full_turn(angle);
            let error = self.position_bias[axis] + self.sigma * self.source.normal();
            self.estimate.location[axis] += way[axis] + length * error;
        }
    }

    /// Sets the estimate, which also ends the drift's bias.
    pub(crate) fn set_pose(&mut self, pose: WirePose) {
        self.estimate = WirePose { orientation: pose.orientation.map(wire::full_turn), ..pose };
        self.angle_bias = [0.0; 3];
        self.position_bias = [0.0; 3];
    }

    /// The estimate as printed; no dialect stamps it.
    pub(crate) fn read(&self) -> sen::Ins {
        let printed = |values: [f64; 3]| values.map(|value| wire::round(value, 2));
        sen::Ins {
            time: None,
            name: self.mounting.name.clone(),
            pose: WirePose {
                location: printed(self.estimate.location),
                orientation: printed(self.estimate.orientation.map(wire::full_turn_units)),
            },
            extra: Vec::new(),
        }
    }
}

/// The ground-truth sensor: the body's pose, wherever it is mounted.
#[derive(Clone, Debug)]
pub(crate) struct WorldPose {
    pub(crate) mounting: Mounting,
    dialect: Dialect,
}

impl WorldPose {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt], dialect: Dialect) -> Self {
        Self { mounting: Mounting::new(spec, units), dialect }
    }

    /// The pose as printed.
    pub(crate) fn read(&self, carrier: &Carrier<'_>, time: Stamp) -> GroundTruth {
        let truth = wire::pose(&carrier.state.world_from_robot);
        let pose = match self.dialect {
            Dialect::Ut2004 => WirePose {
                location: truth.location.map(|value| wire::round(value, 2)),
                orientation: truth.orientation.map(|value| wire::round(wire::full_turn(value), 2)),
            },
            Dialect::Udk => WirePose {
                location: truth.location.map(|value| wire::truncate(value, 3)),
                // The raw rotator by its unit factor: a robot at rest prints plain zeros.
                orientation: truth
                    .orientation
                    .map(|value| wire::truncate(wire::units_rad(wire::angle_units(value)), 3)),
            },
        };
        GroundTruth {
            time: Some(time),
            movable: false,
            name: self.mounting.name.clone(),
            pose,
            extra: Vec::new(),
        }
    }
}
