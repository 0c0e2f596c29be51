//! A robot that is driven through a world of rectangles while a mapper listens.

use super::world::{World, drawn6, rng};
use nalgebra::{Isometry3, Vector3, Vector6};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;
use usar_agent::mapping::perturbation::{perturbed_pose, pose_error};
use usar_agent::mapping::{
    LandmarkId, Mapper, MapperConfig, Motion, MotionSource, OdometryNoise, UpdateReport,
};

/// A motion in the plane: metres ahead and to the left, then a turn in degrees.
pub fn step(ahead: f64, left: f64, turn_deg: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(ahead, left, 0.0), Vector3::z() * turn_deg.to_radians())
}

/// The robot, what it believes, and which rectangle each landmark is.
pub struct Drive<'a> {
    pub world: &'a World,
    pub mapper: Mapper,
    pub truth: Isometry3<f64>,
    pub behind: BTreeMap<LandmarkId, usize>,
    /// Accepted pairs that were of one plane, and that were not.
    pub right: usize,
    pub wrong: usize,
    rng: Pcg64,
}

impl<'a> Drive<'a> {
    /// A robot that stands at the origin of the mapper's world and has looked once.
    pub fn begin(world: &'a World, config: MapperConfig, start: Isometry3<f64>, seed: u64) -> Self {
        let mapper = Mapper::new(config, start);
        let behind = BTreeMap::new();
        let rng = rng(seed);
        let mut drive = Self { world, mapper, truth: start, behind, right: 0, wrong: 0, rng };
        drive.look();
        drive
    }

    /// Looks from where the robot stands.
    pub fn look(&mut self) -> UpdateReport {
        let (scan, planes) = self.world.observe(&self.truth, Some(&mut self.rng));
        let report = self.mapper.observe(&scan);
        for added in &report.added {
            self.behind.insert(added.landmark, planes[added.observation]);
        }
        for pair in &report.associations {
            // Another explanation may have become the best, with landmarks of its own.
            let known = self.behind.entry(pair.landmark).or_insert(planes[pair.observation]);
            if self.world.coplanar(*known, planes[pair.observation]) {
                self.right += 1;
            } else {
                self.wrong += 1;
            }
        }
        report
    }

    /// Moves as told by odometry but for `error`, a perturbation in the frame before; does not look.
    pub fn slide(&mut self, told: &Isometry3<f64>, error: &Vector6<f64>) {
        self.truth *= perturbed_pose(told, error);
        self.mapper.predict(told, MotionSource::Wheels);
    }

    /// Moves with an error drawn from `noise`, then looks.
    pub fn go(&mut self, told: &Isometry3<f64>, noise: &OdometryNoise) -> UpdateReport {
        let mut motion = Motion::default();
        motion.append(told, MotionSource::Wheels);
        let error = drawn6(&mut self.rng, &noise.covariance(&motion));
        self.slide(told, &error);
        self.look()
    }

    /// Moves exactly to `target`, as one who steers by what he sees, while odometry, its turn measured by
    /// an inertial unit, tells a motion with an error drawn from `noise`; then looks.
    pub fn steer_to(&mut self, target: Isometry3<f64>, noise: &OdometryNoise) -> UpdateReport {
        let moved = self.truth.inverse() * target;
        let mut motion = Motion::default();
        motion.append(&moved, MotionSource::InertialTurn);
        let error = drawn6(&mut self.rng, &noise.covariance(&motion));
        self.truth = target;
        self.mapper.predict(&perturbed_pose(&moved, &error), MotionSource::InertialTurn);
        self.look()
    }

    /// Error of the pose: metres, radians.
    pub fn error(&self) -> (f64, f64) {
        let error = pose_error(&self.mapper.world_from_robot(), &self.truth);
        (error.fixed_rows::<3>(0).norm(), error.fixed_rows::<3>(3).norm())
    }

    /// Squared error of the pose under its own covariance; 6 is expected.
    pub fn nees(&self) -> f64 {
        let error = pose_error(&self.mapper.world_from_robot(), &self.truth);
        let covariance = self.mapper.covariance();
        error.dot(&covariance.cholesky().expect("a covariance is positive").solve(&error))
    }
}
