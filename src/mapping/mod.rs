//! Localisation and the map: planar landmarks, and the axes and centres of curved bodies.
//!
//! [`Mapper`] is the door: odometry increments go in by [`predict`](Mapper::predict), the planes of
//! a scan by [`observe`](Mapper::observe), and pose, covariance and map come out. The paper's filter
//! is [`mip`], written to be read beside its section IV; [`full`] is the mode that keeps the map's own
//! uncertainty and closes loops.
//!
//! The world frame is the one in which the first pose is given. Pose errors and covariances are
//! perturbations `[δt; δr]` in the world frame: the true pose has translation `t + δt` and rotation
//! `exp(δr) R`.

mod anchor;
mod association;
mod attitude;
mod belief;
mod claims;
mod curved;
mod estimate;
mod fork;
pub mod full;
pub mod graph;
mod index;
pub mod innovation;
mod joint_search;
mod landmark;
mod lever;
pub mod line_alignment;
mod mask;
mod mask_builder;
pub mod mip;
mod moved;
mod observation;
mod odometry;
mod odometry_trust;
pub mod perturbation;
pub mod planar;
mod recognise;
mod report;
mod rounding_errors;
mod row_errors;
mod scan_errors;
mod shift;
mod sight;
mod upright;
mod vantage;
mod wall;
pub mod wall_alignment;

pub use association::AssociationConfig;
pub use curved::{CurveKind, CurvedLandmark, CurvedObservation, curved_observations};
pub use full::{Full, FullConfig};
pub use graph::GraphConfig;
pub use landmark::{Landmark, LandmarkId, Opening};
pub use mask::{MASK_CELL_M, PlaneMask};
pub use mip::{Mip, MipConfig};
pub use observation::{Observation, observations};
pub use odometry::{
    InertialNoise, Motion, MotionSource, OdometryNoise, tilted_increment, unmeasured_motion,
};
pub use report::{
    Addition, Association, LEVER_M, MovedKeyframe, Refusal, RefusalReason, UpdateReport,
    WeakDirection, weak_directions,
};
pub use scan_errors::{
    COMMON, CommonColumns, CommonErrors, ScanErrors, ScanObservations, common_error_jacobian,
    curve_error_jacobian,
};
pub use upright::upright;

use lever::lever_covariance;
use nalgebra::{Isometry3, Matrix3, Matrix6};
use odometry_trust::OdometryTrust;
use serde::{Deserialize, Serialize};

/// Which estimator runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The paper's Maximum Incremental Probability filter.
    Mip,
    /// Landmarks with covariance, loops, several explanations.
    #[default]
    Full,
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
    /// The full mode.
    pub full: FullConfig,
}

/// Pose and map, fed with odometry and scans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mapper {
    config: MapperConfig,
    /// Motion since the last scan.
    motion: Motion,
    /// Roll, pitch and their standard deviation as last measured.
    attitude: Option<(f64, f64, f64)>,
    trust: OdometryTrust,
    /// Standard deviation of the sensor's place on the robot in each axis, in metres.
    mounted_within_m: f64,
    engine: Engine,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Engine {
    Mip { filter: Box<Mip>, keyframes: Vec<Told> },
    Full(Box<Full>),
}

/// What the paper's filter has told after a scan: it keeps no more than the last pose itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Told {
    world_from_robot: Isometry3<f64>,
    covariance: Matrix6<f64>,
    sightings: Vec<(LandmarkId, Observation)>,
}

impl Told {
    fn new(filter: &Mip, report: &UpdateReport, observations: &[Observation]) -> Self {
        let known = report.associations.iter().map(|pair| (pair.landmark, pair.observation));
        let new = report.added.iter().map(|added| (added.landmark, added.observation));
        let seen = known.chain(new).map(|(id, index)| (id, observations[index].clone()));
        Self {
            world_from_robot: report.world_from_robot,
            covariance: *filter.covariance(),
            sightings: seen.collect(),
        }
    }
}

/// Pairs that fix a pose.
const FIXING_PAIRS: usize = 3;

/// Whether a scan has fixed the pose in all directions, by so many surfaces that they hardly agree by chance.
pub fn is_fixed(report: &UpdateReport) -> bool {
    report.weak_directions.is_empty() && report.associations.len() >= FIXING_PAIRS
}

impl Mapper {
    /// A mapper with an empty map at a pose that is taken as exact: it defines the world frame.
    pub fn new(config: MapperConfig, world_from_robot: Isometry3<f64>) -> Self {
        Self::starting(config, world_from_robot, &Matrix6::zeros())
    }

    /// A mapper with an empty map at a pose with a covariance, as a perturbation `[δt; δr]`: for a
    /// start on a slope, say, whose attitude an inertial unit has given.
    pub fn starting(
        config: MapperConfig,
        world_from_robot: Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) -> Self {
        let engine = match config.mode {
            Mode::Mip => Engine::Mip {
                filter: Box::new(Mip::new(config.mip.clone(), world_from_robot, *covariance)),
                keyframes: Vec::new(),
            },
            Mode::Full => {
                Engine::Full(Box::new(Full::new(config.full.clone(), world_from_robot, covariance)))
            }
        };
        let trust = OdometryTrust::default();
        let motion = Motion::default();
        Self { config, motion, attitude: None, trust, mounted_within_m: 0.0, engine }
    }

    /// The same with a sensor whose place on the robot is known to `sigma_m` in each axis, not exactly: what is
    /// told of motions counts it in the full mode.
    #[must_use]
    pub fn mounted_within(self, sigma_m: f64) -> Self {
        Self { mounted_within_m: sigma_m, ..self }
    }

    /// The same, nothing observed yet, begun at another pose: the first scan has shown how the robot stands. The motion
    /// since is kept. The sensor's place on it is known by `mount_m` less well than was thought, in each axis.
    #[must_use]
    pub fn begun_at(&self, world_from_robot: Isometry3<f64>, mount_m: f64) -> Self {
        let within_m = self.mounted_within_m.hypot(mount_m);
        let begun = Self::new(self.config.clone(), world_from_robot).mounted_within(within_m);
        Self { motion: self.motion, ..begun }
    }

    /// Settings that the mapper runs with.
    pub fn config(&self) -> &MapperConfig {
        &self.config
    }

    /// Takes in one odometry increment, the robot's pose now in its own frame before, and what
    /// measured the turn in it.
    pub fn predict(&mut self, before_from_after: &Isometry3<f64>, source: MotionSource) {
        self.motion.append(before_from_after, source);
    }

    /// Takes in a motion that something else than the wheels measured, with its covariance as a
    /// perturbation `[δt; δr]` in the frame before: no measurement at all, say, and a wide covariance.
    pub fn predict_with(&mut self, before_from_after: &Isometry3<f64>, covariance: &Matrix6<f64>) {
        self.motion.append_measured(before_from_after, covariance);
    }

    /// The motion since the last scan, as far as it is known: for [`replace_since`](Self::replace_since).
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Puts `before_from_after`, measured with `covariance`, in place of all motion since `mark`, which was
    /// [`motion`](Self::motion) then: odometry has had its part in the measurement.
    pub fn replace_since(
        &mut self,
        mark: &Motion,
        before_from_after: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) {
        self.motion = *mark;
        self.motion.append_measured(before_from_after, covariance);
    }

    /// Takes in the attitude that an inertial unit measures now, roll and pitch of `Rz Ry Rx` with
    /// z up, and its standard deviation. The next [`observe`](Self::observe) uses the last one given.
    pub fn attitude(&mut self, roll_rad: f64, pitch_rad: f64, sigma_rad: f64) {
        self.attitude = Some((roll_rad, pitch_rad, sigma_rad));
    }

    /// Takes in the planes of one scan, made while the robot stood where odometry has it now.
    pub fn observe(&mut self, scan: &ScanObservations) -> UpdateReport {
        let motion = std::mem::take(&mut self.motion);
        let attitude = self.attitude.take();
        let covariance = if motion.is_still() && self.is_empty() {
            // The start is where it was said to be.
            Matrix6::zeros()
        } else {
            self.config.odometry.covariance(&motion)
        };
        match &mut self.engine {
            Engine::Mip { filter, keyframes } => {
                filter.predict(&motion.before_from_after, &covariance);
                if let Some((roll_rad, pitch_rad, sigma_rad)) = attitude {
                    filter.correct_attitude(roll_rad, pitch_rad, sigma_rad);
                }
                let report = filter.update(&scan.observations);
                keyframes.push(Told::new(filter, &report, &scan.observations));
                report
            }
            Engine::Full(full) => {
                let before = full.world_from_robot();
                let told = motion.before_from_after;
                let widened = self.trust.widened(&told, &covariance);
                let report = full.observe(&told, &widened, attitude, scan);
                if report.associations.len() >= FIXING_PAIRS {
                    let found = before.inverse() * report.world_from_robot;
                    self.trust.learn(&told, &covariance, &found, &report.weak_directions);
                }
                report
            }
        }
    }

    /// Whether nothing was observed yet.
    pub fn is_empty(&self) -> bool {
        match &self.engine {
            Engine::Mip { keyframes, .. } => keyframes.is_empty(),
            Engine::Full(full) => full.is_empty(),
        }
    }

    /// What the place of the sensor adds to the covariance of a motion, in the frame of the poses.
    fn by_lever(&self, before: &Isometry3<f64>, after: &Isometry3<f64>) -> Matrix6<f64> {
        let [before, after] = [before, after].map(|pose| pose.rotation.to_rotation_matrix());
        lever_covariance(&before, &after, self.mounted_within_m)
    }

    /// Pose and covariance at the last scan.
    fn last(&self) -> (Isometry3<f64>, Matrix6<f64>) {
        match &self.engine {
            Engine::Mip { filter, .. } => (*filter.world_from_robot(), *filter.covariance()),
            Engine::Full(full) => {
                let pose = full.world_from_robot();
                let first = full.keyframe(0).unwrap_or(pose);
                (pose, full.covariance() + self.by_lever(&first, &pose))
            }
        }
    }

    /// The estimated pose now.
    pub fn world_from_robot(&self) -> Isometry3<f64> {
        let last = match &self.engine {
            Engine::Mip { filter, .. } => *filter.world_from_robot(),
            Engine::Full(full) => full.world_from_robot(),
        };
        last * self.motion.before_from_after
    }

    /// Covariance of the pose now, as a perturbation `[δt; δr]` in the world frame.
    pub fn covariance(&self) -> Matrix6<f64> {
        let (pose, covariance) = self.last();
        if self.motion.is_still() {
            return covariance;
        }
        odometry::predicted_covariance(
            &pose,
            &covariance,
            &self.motion.before_from_after,
            &self.trust.widened(
                &self.motion.before_from_after,
                &self.config.odometry.covariance(&self.motion),
            ),
        )
    }

    /// The landmarks of the map, by identity.
    pub fn landmarks(&self) -> &[Landmark] {
        match &self.engine {
            Engine::Mip { filter, .. } => filter.landmarks(),
            Engine::Full(full) => full.landmarks(),
        }
    }

    /// Cylinders and spheres of the map, in the order in which they were first seen; the paper's mode
    /// has none.
    pub fn curves(&self) -> &[CurvedLandmark] {
        match &self.engine {
            Engine::Mip { .. } => &[],
            Engine::Full(full) => full.curves(),
        }
    }

    /// Number of landmarks of all kinds.
    pub fn surface_count(&self) -> usize {
        self.landmarks().len() + self.curves().len()
    }

    /// Covariance of a landmark now (offset, tilts about y and x); the one in the landmark itself is
    /// that of when it was last seen. `None` for an unknown landmark and in the paper's mode.
    pub fn landmark_covariance(&self, id: LandmarkId) -> Option<Matrix3<f64>> {
        match &self.engine {
            Engine::Mip { .. } => None,
            Engine::Full(full) => full.landmark_covariance(id),
        }
    }

    /// Covariance of the motion between two scans, as a perturbation `[δt; δr]` in the frame of the
    /// first; `None` for unknown scans. The paper's filter forgets old poses: it tells of the way from where it
    /// began alone.
    pub fn motion_covariance(&self, first: usize, second: usize) -> Option<Matrix6<f64>> {
        match &self.engine {
            Engine::Mip { keyframes, .. } => {
                let began = keyframes.first().filter(|_| first == 0)?;
                let turn = began.world_from_robot.rotation.inverse().to_rotation_matrix();
                let mut turned = Matrix6::zeros();
                turned.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
                turned.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
                Some(turned * keyframes.get(second)?.covariance * turned.transpose())
            }
            Engine::Full(full) => {
                let motion = full.keyframe(first)?.inverse() * full.keyframe(second)?;
                let by_lever = self.by_lever(&Isometry3::identity(), &motion);
                Some(full.motion_covariance(first, second)? + by_lever)
            }
        }
    }

    /// The same of the motion to a scan from the one before; `None` for the first, and in the paper's mode, which
    /// forgets where it was before.
    pub fn step_covariance(&self, scan: usize) -> Option<Matrix6<f64>> {
        match &self.engine {
            Engine::Mip { .. } => None,
            Engine::Full(_) => self.motion_covariance(scan.checked_sub(1)?, scan),
        }
    }

    /// What the planes of a scan were taken for: landmark and observation of each. Empty for an unknown
    /// scan.
    pub fn sightings(&self, keyframe: usize) -> Vec<(LandmarkId, &Observation)> {
        match &self.engine {
            Engine::Mip { keyframes, .. } => {
                let told = keyframes.get(keyframe).into_iter().flat_map(|told| &told.sightings);
                told.map(|(id, seen)| (*id, seen)).collect()
            }
            Engine::Full(full) => full.sightings(keyframe).collect(),
        }
    }

    /// The estimated pose at each scan so far, as corrected since.
    pub fn keyframes(&self) -> Vec<Isometry3<f64>> {
        match &self.engine {
            Engine::Mip { keyframes, .. } => {
                keyframes.iter().map(|told| told.world_from_robot).collect()
            }
            Engine::Full(full) => full.keyframes(),
        }
    }
}
