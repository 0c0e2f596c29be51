use super::landmark::LandmarkId;
use nalgebra::{Isometry3, Matrix6, SymmetricEigen, Vector6};
use serde::{Deserialize, Serialize};

/// What one scan did to pose and map.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UpdateReport {
    /// Number of the keyframe that the scan became, counted from 0.
    pub keyframe: usize,
    /// Pose after the update.
    pub world_from_robot: Isometry3<f64>,
    /// Covariance of that pose as a perturbation `[δt; δr]` in the world frame.
    pub covariance: Matrix6<f64>,
    /// Accepted pairs, by observation.
    pub associations: Vec<Association>,
    /// Landmarks that this scan added, by observation.
    pub added: Vec<Addition>,
    /// Observations that were used for nothing, and why.
    pub refused: Vec<Refusal>,
    /// Cylinders and spheres that were recognised.
    pub curves_known: usize,
    /// Those that are new in the map.
    pub curves_new: usize,
    /// Those that were used for nothing: they fit several landmarks, or one almost.
    pub curves_refused: usize,
    /// Normalised innovation squared of all accepted pairs of planes together.
    pub nis: f64,
    /// Its degrees of freedom.
    pub nis_degrees: usize,
    /// Directions of motion that this scan did not see, strongest information last.
    pub weak_directions: Vec<WeakDirection>,
    /// Keyframes whose pose was corrected by more than the reporting limits: grid, trajectory and
    /// whatever else hangs on old poses must follow. Empty after an ordinary scan.
    pub moved: Vec<MovedKeyframe>,
    /// Landmarks that were found to be others seen again, as (kept, gone).
    pub merged: Vec<(LandmarkId, LandmarkId)>,
    /// Whether this scan closed a loop: it recognised landmarks from long before.
    pub loop_closed: bool,
    /// Whether an earlier loop closure was found wrong and undone.
    pub loop_undone: bool,
    /// Number of explanations of the data that are still alive; 1 when nothing is ambiguous.
    pub hypotheses: usize,
    /// Rounds of linearisation that the update took.
    pub iterations: usize,
}

impl UpdateReport {
    /// A report to be filled in.
    pub(super) fn begun(keyframe: usize, nis: f64) -> Self {
        Self {
            keyframe,
            world_from_robot: Isometry3::identity(),
            covariance: Matrix6::zeros(),
            associations: Vec::new(),
            added: Vec::new(),
            refused: Vec::new(),
            curves_known: 0,
            curves_new: 0,
            curves_refused: 0,
            nis,
            nis_degrees: 0,
            weak_directions: Vec::new(),
            moved: Vec::new(),
            merged: Vec::new(),
            loop_closed: false,
            loop_undone: false,
            hypotheses: 1,
            iterations: 0,
        }
    }

    pub(super) fn refuse(&mut self, observation: usize, reason: RefusalReason) {
        self.refused.push(Refusal { observation, reason });
    }
}

/// An observation accepted as a landmark of the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Association {
    /// Index of the observation within its scan.
    pub observation: usize,
    /// The landmark.
    pub landmark: LandmarkId,
    /// Squared Mahalanobis distance, equation (8), before the update.
    pub distance_squared: f64,
}

/// An observation that became a new landmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Addition {
    /// Index of the observation within its scan.
    pub observation: usize,
    /// The landmark.
    pub landmark: LandmarkId,
}

/// An observation that was left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Refusal {
    /// Index of the observation within its scan.
    pub observation: usize,
    /// Why.
    pub reason: RefusalReason,
}

/// Why an observation was left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum RefusalReason {
    /// It fitted a landmark before the update and no longer after it; the number is the squared
    /// Mahalanobis distance after the update.
    FailedRetest(f64),
    /// The scan has more planes than one update takes in, and this is one of the smaller; or more landmarks
    /// are near than one update compares, and it may be one of those left out.
    Crowded,
    /// It fits several landmarks, and nothing decides between them yet.
    Ambiguous,
    /// It is too far from a landmark to be it and too near to be something else; the number is the
    /// squared Mahalanobis distance.
    Doubtful(f64),
}

/// A direction in which a scan did not fix the robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WeakDirection {
    /// Unit direction in the robot frame: forward, left, up in metres, then rotations about the same
    /// axes in units of [`LEVER_M`] radians.
    pub direction: Vector6<f64>,
    /// Standard deviation in metres that the scan alone leaves along it; infinite where it says
    /// nothing.
    pub sigma_m: f64,
}

impl WeakDirection {
    /// The axis that it has most of, in a word.
    pub fn word(&self) -> &'static str {
        ["forward", "left", "up", "roll", "pitch", "heading"][self.direction.iamax()]
    }
}

/// A keyframe whose pose was corrected.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MovedKeyframe {
    /// Number of the keyframe.
    pub keyframe: usize,
    /// Pose before.
    pub before: Isometry3<f64>,
    /// Pose now.
    pub world_from_robot: Isometry3<f64>,
}

/// Distance in metres at which a rotation counts as much as a shift of the same length.
pub const LEVER_M: f64 = 3.0;

/// Directions in which `information` (per perturbation `[δt; δr]` in the world frame) leaves more
/// than `limit_m`, weakest first.
pub fn weak_directions(
    information: &Matrix6<f64>,
    world_from_robot: &Isometry3<f64>,
    limit_m: f64,
) -> Vec<WeakDirection> {
    let rotation = world_from_robot.rotation.to_rotation_matrix().into_inner();
    // World perturbation per unit of the scaled robot-frame direction.
    let mut world_from_direction = Matrix6::zeros();
    world_from_direction.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    world_from_direction.fixed_view_mut::<3, 3>(3, 3).copy_from(&(rotation / LEVER_M));
    let scaled = world_from_direction.transpose() * information * world_from_direction;
    let eigen = SymmetricEigen::new((scaled + scaled.transpose()) * 0.5);
    let mut weak: Vec<WeakDirection> = eigen
        .eigenvalues
        .iter()
        .zip(eigen.eigenvectors.column_iter())
        .map(|(&value, vector)| {
            // The sign of an eigenvector is arbitrary: the greatest entry is made positive.
            let direction: Vector6<f64> = vector.into_owned();
            let sign = direction[direction.iamax()].signum();
            let sigma_m = if value > 1e-9 { 1.0 / value.sqrt() } else { f64::INFINITY };
            WeakDirection { direction: direction * sign, sigma_m }
        })
        .filter(|weak| weak.sigma_m > limit_m)
        .collect();
    weak.sort_by(|a, b| b.sigma_m.total_cmp(&a.sigma_m));
    weak
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_floor_alone_leaves_forward_left_and_heading_open() {
        let mut information = Matrix6::zeros();
        for i in [2, 3, 4] {
            information[(i, i)] = 1e6;
        }
        let robot = Isometry3::new(Vector3::new(3.0, 1.0, 0.0), Vector3::z() * 0.6);
        let weak = weak_directions(&information, &robot, 0.05);
        assert_eq!(weak.len(), 3);
        for direction in weak {
            assert!(direction.sigma_m.is_infinite());
            let seen = [2, 3, 4].iter().map(|&i| direction.direction[i].abs()).sum::<f64>();
            assert!(seen < 1e-9);
        }
    }

    #[test]
    fn a_corridor_leaves_only_its_length_open() {
        let mut information = Matrix6::identity() * 1e6;
        information[(0, 0)] = 4.0;
        let weak = weak_directions(&information, &Isometry3::identity(), 0.05);
        assert_eq!(weak.len(), 1);
        assert!((weak[0].direction[0] - 1.0).abs() < 1e-9 && (weak[0].sigma_m - 0.5).abs() < 1e-9);
    }
}
