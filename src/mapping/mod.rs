//! Localisation and the map of planar landmarks.
//!
//! [`Mapper`] is the door: odometry increments go in by [`predict`](Mapper::predict), the planes of
//! a scan by [`observe`](Mapper::observe), and pose, covariance and map come out. The paper's filter
//! is [`mip`], written to be read beside its section IV.
//!
//! The world frame is the one in which the first pose is given. Pose errors and covariances are
//! perturbations `[δt; δr]` in the world frame: the true pose has translation `t + δt` and rotation
//! `exp(δr) R`.

mod attitude;
pub mod graph;
pub mod innovation;
mod landmark;
mod mask;
pub mod mip;
mod observation;
mod odometry;
pub mod perturbation;
mod report;
mod scan_errors;

pub use landmark::{Landmark, LandmarkId};
pub use mask::{MASK_CELL_M, PlaneMask};
pub use mip::{Mip, MipConfig};
pub use observation::{Observation, observations};
pub use odometry::{Motion, OdometryNoise, tilted_increment};
pub use report::{
    Addition, Association, LEVER_M, MovedKeyframe, Refusal, RefusalReason, UpdateReport,
    WeakDirection, weak_directions,
};
pub use scan_errors::{ScanErrors, ScanObservations, common_error_jacobian};

use nalgebra::{Isometry3, Matrix6};
use serde::{Deserialize, Serialize};

/// Which estimator runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The paper's Maximum Incremental Probability filter.
    #[default]
    Mip,
}

/// Settings of localisation and mapping.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MapperConfig {
    /// Which estimator runs.
    pub mode: Mode,
    /// How wrong wheel odometry is.
    pub odometry: OdometryNoise,
    /// The paper's mode.
    pub mip: MipConfig,
}

/// Pose and map, fed with odometry and scans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mapper {
    config: MapperConfig,
    /// Motion since the last update.
    motion: Motion,
    attitude: Option<Attitude>,
    keyframes: Vec<Isometry3<f64>>,
    filter: Mip,
}

/// Roll and pitch as an inertial unit gives them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Attitude {
    roll_rad: f64,
    pitch_rad: f64,
    sigma_rad: f64,
}

impl Mapper {
    /// A mapper with an empty map at a pose that is taken as exact: it defines the world frame.
    pub fn new(config: MapperConfig, world_from_robot: Isometry3<f64>) -> Self {
        let filter = Mip::new(config.mip.clone(), world_from_robot, Matrix6::zeros());
        Self { config, motion: Motion::default(), attitude: None, keyframes: Vec::new(), filter }
    }

    /// Settings that the mapper runs with.
    pub fn config(&self) -> &MapperConfig {
        &self.config
    }

    /// Takes in one odometry increment: the robot's pose now in its own frame before.
    pub fn predict(&mut self, before_from_after: &Isometry3<f64>) {
        self.motion.append(before_from_after);
    }

    /// Takes in the attitude that an inertial unit measures now, roll and pitch of `Rz Ry Rx` with
    /// z up, and its standard deviation. The next [`observe`](Self::observe) uses the last one given.
    pub fn attitude(&mut self, roll_rad: f64, pitch_rad: f64, sigma_rad: f64) {
        self.attitude = Some(Attitude { roll_rad, pitch_rad, sigma_rad });
    }

    /// Takes in the planes of one scan, made while the robot stood where odometry has it now.
    pub fn observe(&mut self, scan: &ScanObservations) -> UpdateReport {
        let motion = std::mem::take(&mut self.motion);
        self.filter.predict(&motion.before_from_after, &self.config.odometry.covariance(&motion));
        if let Some(attitude) = self.attitude.take() {
            self.filter.correct_attitude(attitude.roll_rad, attitude.pitch_rad, attitude.sigma_rad);
        }
        let report = self.filter.update(&scan.observations);
        self.keyframes.push(report.world_from_robot);
        report
    }

    /// The estimated pose now.
    pub fn world_from_robot(&self) -> Isometry3<f64> {
        self.filter.world_from_robot() * self.motion.before_from_after
    }

    /// Covariance of the pose now, as a perturbation `[δt; δr]` in the world frame.
    pub fn covariance(&self) -> Matrix6<f64> {
        if self.motion.is_still() {
            return *self.filter.covariance();
        }
        odometry::predicted_covariance(
            self.filter.world_from_robot(),
            self.filter.covariance(),
            &self.motion.before_from_after,
            &self.config.odometry.covariance(&self.motion),
        )
    }

    /// The landmarks of the map, by identity.
    pub fn landmarks(&self) -> &[Landmark] {
        self.filter.landmarks()
    }

    /// The estimated pose at each scan so far.
    pub fn keyframes(&self) -> &[Isometry3<f64>] {
        &self.keyframes
    }
}
