//! The paper's Maximum Incremental Probability filter, equations (1)-(14) of its section IV.
//!
//! The state is the pose alone; planes enter the map as observed, without covariance, and never
//! move. That makes the filter O(1) per plane; it can neither doubt its map nor close a loop.
//!
//! Two things differ from the text. The pose is kept as a rigid motion and its covariance as that of
//! a perturbation (see [`perturbation`](super::perturbation)): with R on absolute Euler angles S is
//! singular for every wall that faces the robot and the filter diverges. Equation (14) is computed in
//! Joseph's form, which is equal for the optimal gain and stays symmetric and positive in rounding.

use super::attitude::attitude_rows;
use super::innovation::Innovation;
use super::landmark::{Landmark, LandmarkId, carried_hull, hulls_meet};
use super::observation::Observation;
use super::odometry::predicted_covariance;
use super::perturbation::{perturbed_pose, symmetric};
use super::report::{Addition, Association, Refusal, RefusalReason, UpdateReport, weak_directions};
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix6, Vector3};
use serde::{Deserialize, Serialize};

/// Settings of the paper's mode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MipConfig {
    /// Gate on the squared Mahalanobis distance of a pair, χ² with 3 degrees of freedom; the paper
    /// prints none. 7.815 is 95 %, 11.345 is 99 %. Valid: above 0.
    pub gate: f64,
    /// Gate of the same distance after the update; a pair beyond it is dropped and the update done
    /// again without it. Valid: above 0.
    pub retest_gate: f64,
    /// Greatest angle between the normals of a pair in radians. Valid: 0 to π/2.
    pub max_angle_rad: f64,
    /// Greatest gap of a pair along the normal in metres. Valid: above 0.
    pub max_offset_m: f64,
    /// Greatest distance in the plane between the hulls of a pair in metres. Valid: 0 or more.
    pub max_hull_gap_m: f64,
    /// Share of the smaller hull that must overlap where the gap decides nothing. Valid: 0 to 1.
    pub min_overlap_share: f64,
    /// Standard deviation added to every observed offset in metres: errors of a real scanner that do
    /// not average out over a patch. Valid: 0 or more.
    pub offset_floor_m: f64,
    /// Standard deviation added to every observed tilt in radians. Valid: 0 or more.
    pub tilt_floor_rad: f64,
}

impl Default for MipConfig {
    fn default() -> Self {
        Self {
            gate: 11.345,
            retest_gate: 11.345,
            max_angle_rad: 15_f64.to_radians(),
            max_offset_m: 0.5,
            max_hull_gap_m: 0.4,
            min_overlap_share: 0.1,
            offset_floor_m: 0.010,
            tilt_floor_rad: 0.3_f64.to_radians(),
        }
    }
}

/// Pose, its covariance and the map: all that the paper's filter knows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mip {
    config: MipConfig,
    world_from_robot: Isometry3<f64>,
    covariance: Matrix6<f64>,
    landmarks: Vec<Landmark>,
    updates: usize,
}

/// A pair that passed the gates.
struct Candidate {
    observation: usize,
    landmark: usize,
    distance_squared: f64,
}

impl Mip {
    /// A filter with an empty map; the paper starts with `x = 0`, `P = 0`.
    pub fn new(
        config: MipConfig,
        world_from_robot: Isometry3<f64>,
        covariance: Matrix6<f64>,
    ) -> Self {
        Self { config, world_from_robot, covariance, landmarks: Vec::new(), updates: 0 }
    }

    /// The estimated pose.
    pub fn world_from_robot(&self) -> &Isometry3<f64> {
        &self.world_from_robot
    }

    /// Covariance P of the pose as a perturbation `[δt; δr]` in the world frame.
    pub fn covariance(&self) -> &Matrix6<f64> {
        &self.covariance
    }

    /// The map, by identity.
    pub fn landmarks(&self) -> &[Landmark] {
        &self.landmarks
    }

    /// Prediction, equations (1) and (2): `u` is the motion since the last prediction in the frame
    /// before it, `q` its covariance as a perturbation `[δt; δr]` in that frame.
    pub fn predict(&mut self, u: &Isometry3<f64>, q: &Matrix6<f64>) {
        self.covariance = predicted_covariance(&self.world_from_robot, &self.covariance, u, q);
        self.world_from_robot *= u;
        self.world_from_robot.rotation.renormalize();
    }

    /// A measured attitude: two rows of an ordinary update. Not in the paper, whose robot has no
    /// inertial unit. Roll and pitch are those of `Rz Ry Rx` in a world whose z is up.
    pub fn correct_attitude(&mut self, roll_rad: f64, pitch_rad: f64, sigma_rad: f64) {
        let (innovation, rows) = attitude_rows(&self.world_from_robot, roll_rad, pitch_rad);
        let h = DVector::from_row_slice(innovation.as_slice());
        let h_x = DMatrix::from_iterator(2, 6, rows.iter().copied());
        let noise = DMatrix::identity(2, 2) * (sigma_rad * sigma_rad);
        self.correct(&h, &h_x, &noise);
    }

    /// Association and update with the planes of one scan, equations (3)-(14). Planes that fit no
    /// feature of the map are added to it.
    pub fn update(&mut self, observations: &[Observation]) -> UpdateReport {
        let keyframe = self.updates;
        self.updates += 1;
        let mut refused = Vec::new();
        let (mut pairs, matched) = self.associate(observations);
        let predicted = (self.world_from_robot, self.covariance);
        let mut nis = 0.0;
        let mut iterations = 0;
        let mut information = Matrix6::zeros();
        while !pairs.is_empty() {
            (self.world_from_robot, self.covariance) = predicted;
            let (h, h_x, r) = self.joint(observations, &pairs);
            nis = self.correct(&h, &h_x, &r);
            information = scan_information(&h_x, &r);
            iterations += 1;
            let worst = pairs
                .iter()
                .map(|pair| self.distance_squared(&observations[pair.observation], pair.landmark))
                .enumerate()
                .max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((at, distance)) = worst.filter(|(_, d)| *d > self.config.retest_gate) else {
                break;
            };
            let observation = pairs.remove(at).observation;
            refused.push(Refusal { observation, reason: RefusalReason::FailedRetest(distance) });
        }
        if pairs.is_empty() {
            (self.world_from_robot, self.covariance) = predicted;
            nis = 0.0;
        }
        for pair in &pairs {
            let landmark = &mut self.landmarks[pair.landmark];
            landmark.extend(&observations[pair.observation], &self.world_from_robot);
            landmark.sightings += 1;
            landmark.last_keyframe = keyframe;
        }
        let added = self.add_unmatched(observations, &matched, keyframe);
        UpdateReport {
            world_from_robot: self.world_from_robot,
            covariance: self.covariance,
            nis_degrees: 3 * pairs.len(),
            associations: pairs.iter().map(|pair| self.association(pair)).collect(),
            added,
            refused,
            weak_directions: weak_directions(&information, &self.world_from_robot, 0.05),
            iterations,
            ..UpdateReport::begun(keyframe, nis)
        }
    }

    fn association(&self, pair: &Candidate) -> Association {
        Association {
            observation: pair.observation,
            landmark: self.landmarks[pair.landmark].id,
            distance_squared: pair.distance_squared,
        }
    }

    /// "The planes that cannot be associated to any feature in the map are added to it after
    /// applying the composition of both transformations."
    fn add_unmatched(
        &mut self,
        observations: &[Observation],
        matched: &[bool],
        keyframe: usize,
    ) -> Vec<Addition> {
        let mut added = Vec::new();
        for (index, observation) in observations.iter().enumerate().filter(|(i, _)| !matched[*i]) {
            let id = LandmarkId(self.landmarks.len() as u32);
            let landmark = Landmark::first_seen(id, observation, &self.world_from_robot, keyframe);
            self.landmarks.push(landmark);
            added.push(Addition { observation: index, landmark: id });
        }
        added
    }

    /// R of one observation: its own covariance and the floors.
    fn observation_covariance(&self, observation: &Observation) -> Matrix3<f64> {
        let floors = Vector3::new(
            self.config.offset_floor_m,
            self.config.tilt_floor_rad,
            self.config.tilt_floor_rad,
        );
        observation.covariance + Matrix3::from_diagonal(&floors.component_mul(&floors))
    }

    /// Equations (3) to (8) for one pair: the squared Mahalanobis distance at the present pose.
    fn distance_squared(&self, observation: &Observation, landmark: usize) -> f64 {
        let innovation = self.innovation(observation, landmark);
        let r = self.observation_covariance(observation);
        let s = innovation.h_x * self.covariance * innovation.h_x.transpose()
            + innovation.h_z * r * innovation.h_z.transpose();
        symmetric(&s)
            .cholesky()
            .map_or(f64::INFINITY, |cholesky| innovation.h.dot(&cholesky.solve(&innovation.h)))
    }

    fn innovation(&self, observation: &Observation, landmark: usize) -> Innovation {
        Innovation::new(
            &self.landmarks[landmark].world_from_plane,
            &self.world_from_robot,
            &observation.robot_from_plane,
        )
    }

    /// Nearest pairs first, each observation and each landmark once; and which observations fitted
    /// any landmark, taken or not, so that none of those founds a double.
    fn associate(&self, observations: &[Observation]) -> (Vec<Candidate>, Vec<bool>) {
        let mut candidates = Vec::new();
        for (index, observation) in observations.iter().enumerate() {
            for landmark in 0..self.landmarks.len() {
                if !self.comparable(observation, landmark) {
                    continue;
                }
                let distance_squared = self.distance_squared(observation, landmark);
                if distance_squared < self.config.gate {
                    candidates.push(Candidate { observation: index, landmark, distance_squared });
                }
            }
        }
        candidates.sort_by(|a, b| {
            a.distance_squared
                .total_cmp(&b.distance_squared)
                .then(a.observation.cmp(&b.observation))
                .then(a.landmark.cmp(&b.landmark))
        });
        let mut observation_taken = vec![false; observations.len()];
        let mut landmark_taken = vec![false; self.landmarks.len()];
        let mut pairs = Vec::new();
        let mut matched = vec![false; observations.len()];
        for candidate in candidates {
            matched[candidate.observation] = true;
            if !observation_taken[candidate.observation] && !landmark_taken[candidate.landmark] {
                observation_taken[candidate.observation] = true;
                landmark_taken[candidate.landmark] = true;
                pairs.push(candidate);
            }
        }
        (pairs, matched)
    }

    /// The tests beside the gate: same facing, a bounded gap, and hulls that meet. Without them every
    /// two coplanar walls would be one, and a wide covariance would let anything pass.
    fn comparable(&self, observation: &Observation, landmark: usize) -> bool {
        let map = &self.landmarks[landmark];
        let plane_from_observed =
            map.world_from_plane.inverse() * self.world_from_robot * observation.robot_from_plane;
        let facing = (plane_from_observed.rotation * Vector3::z()).z;
        if facing < self.config.max_angle_rad.cos()
            || plane_from_observed.translation.vector.z.abs() > self.config.max_offset_m
        {
            return false;
        }
        let carried = carried_hull(&observation.hull, &plane_from_observed);
        let slack = 2.0 * (self.covariance[(0, 0)] + self.covariance[(1, 1)]).sqrt().min(0.5);
        hulls_meet(
            &map.hull,
            &carried,
            self.config.min_overlap_share,
            self.config.max_hull_gap_m + slack,
        )
    }

    /// Equations (9) and (10): the stacked innovation, its Jacobian, and `H_z R H_zᵀ`, which is all
    /// that (11) needs of `H_z` and R.
    fn joint(
        &self,
        observations: &[Observation],
        pairs: &[Candidate],
    ) -> (DVector<f64>, DMatrix<f64>, DMatrix<f64>) {
        let rows = 3 * pairs.len();
        let mut h = DVector::zeros(rows);
        let mut h_x = DMatrix::zeros(rows, 6);
        let mut noise = DMatrix::zeros(rows, rows);
        for (i, pair) in pairs.iter().enumerate() {
            let observation = &observations[pair.observation];
            let innovation = self.innovation(observation, pair.landmark);
            let r = self.observation_covariance(observation);
            h.fixed_rows_mut::<3>(3 * i).copy_from(&innovation.h);
            h_x.fixed_view_mut::<3, 6>(3 * i, 0).copy_from(&innovation.h_x);
            noise
                .fixed_view_mut::<3, 3>(3 * i, 3 * i)
                .copy_from(&(innovation.h_z * r * innovation.h_z.transpose()));
        }
        (h, h_x, noise)
    }

    /// Equations (11) to (14) with the noise `H_z R H_zᵀ`; returns `hᵀ S⁻¹ h`.
    fn correct(&mut self, h: &DVector<f64>, h_x: &DMatrix<f64>, noise: &DMatrix<f64>) -> f64 {
        let p = DMatrix::from_column_slice(6, 6, self.covariance.as_slice());
        let cross = &p * h_x.transpose();
        // (11)
        let s = h_x * &cross + noise;
        let Some(cholesky) = ((&s + s.transpose()) * 0.5).cholesky() else {
            // S is a sum of covariances; without a positive part there is nothing to learn from.
            return 0.0;
        };
        // (12), as the solution of S Wᵀ = (P H_xᵀ)ᵀ
        let w = cholesky.solve(&cross.transpose()).transpose();
        // (13)
        let step = -(&w * h);
        self.world_from_robot =
            perturbed_pose(&self.world_from_robot, &step.fixed_rows::<6>(0).into_owned());
        // (14) in Joseph's form
        let keep = DMatrix::identity(6, 6) - &w * h_x;
        let corrected = &keep * p * keep.transpose() + &w * noise * w.transpose();
        self.covariance = symmetric(&Matrix6::from_column_slice(corrected.as_slice()));
        h.dot(&cholesky.solve(h))
    }
}

/// Information of a scan about the pose when its map is taken as exact: `H_xᵀ (H_z R H_zᵀ)⁻¹ H_x`.
fn scan_information(h_x: &DMatrix<f64>, noise: &DMatrix<f64>) -> Matrix6<f64> {
    noise.clone().cholesky().map_or_else(Matrix6::zeros, |cholesky| {
        Matrix6::from_column_slice((h_x.transpose() * cholesky.solve(h_x)).as_slice())
    })
}
