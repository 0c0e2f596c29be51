//! The full mode: landmarks with covariance and correlations, loops, and several explanations where
//! the data allow several.

use super::association::AssociationConfig;
use super::estimate::{Arrival, Attitude, Estimate};
use super::graph::GraphConfig;
use super::landmark::{Landmark, LandmarkId};
use super::report::UpdateReport;
use super::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Matrix3, Matrix6};
use serde::{Deserialize, Serialize};

/// Settings of the full mode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FullConfig {
    /// Data association.
    pub association: AssociationConfig,
    /// The graph.
    pub graph: GraphConfig,
}

/// How much worse than told odometry may be before the scan is no longer believed: the motion's
/// standard deviations are widened by this when a scan does not fit the map.
const WIDENING: f64 = 4.0;
/// Pairs below which a scan is tried again with a widened motion.
const FEW_PAIRS: usize = 3;

/// The full mode's state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Full {
    config: FullConfig,
    estimate: Estimate,
}

impl Full {
    /// An empty map at a pose.
    pub fn new(
        config: FullConfig,
        world_from_robot: Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) -> Self {
        let estimate = Estimate::new(config.graph, world_from_robot, covariance);
        Self { config, estimate }
    }

    /// Takes in a scan made after `motion`, whose covariance is a perturbation in the frame at its
    /// beginning, and the attitude (roll, pitch, standard deviation) measured with it.
    pub fn observe(
        &mut self,
        motion: &Isometry3<f64>,
        motion_covariance: &Matrix6<f64>,
        attitude: Option<(f64, f64, f64)>,
        scan: &ScanObservations,
    ) -> UpdateReport {
        let arrival = Arrival {
            motion: *motion,
            motion_covariance: *motion_covariance,
            attitude: attitude.map(|(roll_rad, pitch_rad, sigma_rad)| Attitude {
                roll_rad,
                pitch_rad,
                sigma_rad,
            }),
            scan,
        };
        let config = &self.config.association;
        let mut prepared = self.estimate.prepare(&arrival, config, 1.0);
        let pairs = prepared.assignments[0].pairs.len();
        let expected = scan.observations.len().min(config.anchors) / 3;
        if !self.estimate.landmarks().is_empty() && pairs < expected.max(FEW_PAIRS) {
            let wide = self.estimate.prepare(&arrival, config, WIDENING);
            if wide.assignments[0].pairs.len() >= (2 * pairs).max(FEW_PAIRS + 1) {
                prepared = wide;
            }
        }
        let best = prepared.assignments[0].clone();
        self.estimate.apply(&arrival, &prepared, &best, config)
    }

    /// Whether nothing was observed yet.
    pub fn is_empty(&self) -> bool {
        self.estimate.is_empty()
    }

    /// Pose at the last scan.
    pub fn world_from_robot(&self) -> Isometry3<f64> {
        self.estimate.last_pose()
    }

    /// Covariance of that pose as a perturbation `[δt; δr]` in the world frame.
    pub fn covariance(&self) -> Matrix6<f64> {
        self.estimate.last_covariance()
    }

    /// The landmarks, by identity.
    pub fn landmarks(&self) -> &[Landmark] {
        self.estimate.landmarks()
    }

    /// Covariance of a landmark now; the one in the landmark is that of when it was last seen.
    pub fn landmark_covariance(&self, id: LandmarkId) -> Option<Matrix3<f64>> {
        self.estimate.landmark_covariance(id)
    }

    /// Covariance of the motion between two scans, as a perturbation in the frame of the first.
    pub fn motion_covariance(&self, first: usize, second: usize) -> Option<Matrix6<f64>> {
        self.estimate.motion_covariance(first, second)
    }

    /// Poses at all scans.
    pub fn keyframes(&self) -> Vec<Isometry3<f64>> {
        self.estimate.poses()
    }
}
