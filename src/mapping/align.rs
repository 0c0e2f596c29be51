//! Aligning one line of a resting laser with the planes of the map.
//!
//! Between two sweeps the pose is dead reckoning, and every line taken on the way shows how far that
//! has gone wrong: its endpoints lie on planes that are mapped already. An endpoint that can belong to
//! one plane only gives one equation, its distance from that plane. A line so corrects the pose in the
//! directions that the planes in view determine, and leaves the others as odometry has them.

use super::landmark::Landmark;
use super::perturbation::{perturbed_pose, symmetric};
use crate::scan::{LaserLine, Return};
use nalgebra::{Isometry3, Matrix6, Point3, SMatrix, SVector, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Rounds of pairing and solving.
const ROUNDS: usize = 4;
/// Sine of the least angle between a ray and a plane that it measures.
const LEAST_INCIDENCE: f64 = 0.12;
/// Planes nearer to one another than this, and as parallel, are one surface in two pieces.
const SAME_M: f64 = 0.02;
const SAME_COS: f64 = 0.9995;
/// Residual in standard deviations from which on an endpoint counts for less (Huber).
const HUBER: f64 = 1.5;
/// Share of the paired endpoints that must fit in the end.
const LEAST_FITTING: f64 = 0.7;
/// Endpoints that lie this far behind a surface of the map contradict the pose, in metres.
const BEHIND_M: f64 = 0.3;
/// Such endpoints per fitting one from which on the line is not believed.
const MOST_BEHIND: f64 = 0.2;
/// Square of the farthest correction that is believed, in standard deviations: six degrees of freedom
/// exceed it once in three thousand lines.
const FARTHEST: f64 = 25.0;

/// How lines are aligned with the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AlignConfig {
    /// Whether lines correct the pose at all. Off by default: in `station` the corrections at sweeps
    /// grew from 0.07 to 0.11 m with it, along the way more than across; endpoints at grazing
    /// incidence on surfaces that are mapped in part are the suspects.
    pub enabled: bool,
    /// Standard deviation of an endpoint about its plane, in metres: range noise and relief.
    /// Valid: 0.001 to 0.2.
    pub point_sigma_m: f64,
    /// Error that all endpoints on one landmark share, in metres: the landmark's own, and the range
    /// bias. It does not average out from line to line. Valid: 0.001 to 0.2.
    pub landmark_sigma_m: f64,
    /// Standard deviation of the tilt of the resting head, in radians. Valid: 0.0001 to 0.1.
    pub tilt_sigma_rad: f64,
    /// Standard deviation of what the wheels may slip between two lines, in metres, besides what odometry
    /// is charged per way. Valid: 0 to 0.5.
    pub slip_sigma_m: f64,
    /// Distance of an endpoint from a plane at which it may still lie on it, in standard deviations.
    /// Valid: 1 to 6.
    pub gate_sigmas: f64,
    /// Farthest such distance, in metres. Valid: 0.05 to 1.
    pub gate_m: f64,
    /// Fewest endpoints that are worth a correction. Valid: 3 to 1000.
    pub least_points: usize,
    /// Way since the last correction after which another is due, in metres. Valid: 0 to 10.
    pub every_m: f64,
    /// Turn since the last correction after which another is due, in radians. Valid: 0 to 3.
    pub every_rad: f64,
}

impl Default for AlignConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            point_sigma_m: 0.02,
            landmark_sigma_m: 0.015,
            tilt_sigma_rad: 0.004,
            slip_sigma_m: 0.03,
            gate_sigmas: 3.0,
            gate_m: 0.4,
            least_points: 12,
            every_m: 0.15,
            every_rad: 0.05,
        }
    }
}

/// Where a line says that the robot was when it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// The pose.
    pub world_from_robot: Isometry3<f64>,
    /// Its covariance as a perturbation `[δt; δr]` in the world frame.
    pub covariance: Matrix6<f64>,
    /// Endpoints that took part.
    pub points: usize,
}

/// A pose error and the tilt error of the head.
type State = SVector<f64, 7>;
type Information = SMatrix<f64, 7, 7>;

/// An endpoint and how the head's tilt moves it, in the robot frame.
struct Endpoint {
    p: Point3<f64>,
    per_tilt: Vector3<f64>,
}

/// A landmark as far as a line may meet it.
struct Target<'a> {
    landmark: &'a Landmark,
    plane_from_world: Isometry3<f64>,
    normal: Vector3<f64>,
    origin: Point3<f64>,
}

/// Aligns a line taken at `predicted` (covariance: perturbation `[δt; δr]` in the world frame) by a
/// sensor at `robot_from_sensor` with the landmarks. `None` where too few endpoints lie on planes that
/// are known, or what they say contradicts the prediction: the line says nothing then.
pub fn align_line(
    config: &AlignConfig,
    landmarks: &[Landmark],
    predicted: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
    robot_from_sensor: &Isometry3<f64>,
    line: &LaserLine,
) -> Option<Alignment> {
    let endpoints = endpoints(line, robot_from_sensor);
    if endpoints.len() < config.least_points {
        return None;
    }
    let targets = targets(landmarks, &(predicted * robot_from_sensor), line.max_range_m);
    let mut prior = Information::zeros();
    prior.fixed_view_mut::<6, 6>(0, 0).copy_from(&(covariance + Matrix6::identity() * 1e-8));
    prior[(6, 6)] = config.tilt_sigma_rad * config.tilt_sigma_rad;
    let prior_information = prior.cholesky()?.inverse();

    let mut state = State::zeros();
    let mut spread = prior;
    let mut paired = Vec::new();
    for _ in 0..ROUNDS {
        let pose = pose_of(predicted, &state);
        paired = pairs(config, &endpoints, &targets, &pose, state[6], &spread, robot_from_sensor);
        if paired.len() < config.least_points {
            return None;
        }
        let (information, gradient) = normal_equations(config, &paired, targets.len());
        let posterior = symmetric(&(prior_information + information)).cholesky()?;
        state = posterior.solve(&(information * state - gradient));
        spread = posterior.inverse();
    }
    let fits = |pair: &&Pair| pair.residual_m.abs() < 3.0 * config.point_sigma_m;
    let fitting = paired.iter().filter(fits).count();
    let pose = pose_of(predicted, &state);
    let behind = behind(&endpoints, &targets, &pose, robot_from_sensor);
    let farness = (state.transpose() * prior_information * state)[0];
    let believed = farness < FARTHEST
        && fitting >= config.least_points
        && fitting as f64 >= LEAST_FITTING * paired.len() as f64
        && behind as f64 <= MOST_BEHIND * fitting as f64;
    believed.then(|| Alignment {
        world_from_robot: pose,
        covariance: symmetric(&spread.fixed_view::<6, 6>(0, 0).into_owned()),
        points: fitting,
    })
}

fn pose_of(predicted: &Isometry3<f64>, state: &State) -> Isometry3<f64> {
    perturbed_pose(predicted, &Vector6::from_column_slice(&state.as_slice()[..6]))
}

fn endpoints(line: &LaserLine, robot_from_sensor: &Isometry3<f64>) -> Vec<Endpoint> {
    (0..line.len())
        .filter_map(|beam| {
            let Return::Hit(range_m) = line.classify(beam) else { return None };
            let p = line.direction(beam) * range_m;
            let per_tilt = robot_from_sensor.rotation * Vector3::y().cross(&p);
            Some(Endpoint { p: robot_from_sensor * Point3::from(p), per_tilt })
        })
        .collect()
}

/// The landmarks within reach that show the sensor their seen side.
fn targets<'a>(
    landmarks: &'a [Landmark],
    world_from_sensor: &Isometry3<f64>,
    reach_m: f64,
) -> Vec<Target<'a>> {
    let eye = Point3::from(world_from_sensor.translation.vector);
    landmarks
        .iter()
        .filter_map(|landmark| {
            let (normal, origin) = (landmark.normal(), landmark.origin());
            let radius_m = landmark.hull.iter().map(|p| p.coords.norm()).fold(0.0, f64::max);
            let near = (origin - eye).norm() <= reach_m + radius_m;
            (near && normal.dot(&(eye - origin)) > 0.0).then(|| Target {
                plane_from_world: landmark.world_from_plane.inverse(),
                landmark,
                normal,
                origin,
            })
        })
        .collect()
}

/// An endpoint on a plane.
struct Pair {
    target: usize,
    residual_m: f64,
    jacobian: State,
}

/// Each endpoint with the one plane it can lie on; endpoints without one, or with several, tell
/// nothing.
fn pairs(
    config: &AlignConfig,
    endpoints: &[Endpoint],
    targets: &[Target<'_>],
    pose: &Isometry3<f64>,
    tilt_rad: f64,
    spread: &Information,
    robot_from_sensor: &Isometry3<f64>,
) -> Vec<Pair> {
    let eye = pose * Point3::from(robot_from_sensor.translation.vector);
    let noise = config.point_sigma_m.powi(2) + config.landmark_sigma_m.powi(2);
    // How far an endpoint may lie beside the part of a plane that was seen.
    let aside_m = (0..2).map(|i| spread[(i, i)]).fold(0.0, f64::max).sqrt();
    let pair = |endpoint: &Endpoint| {
        let p = pose * (endpoint.p + endpoint.per_tilt * tilt_rad);
        let lever = p.coords - pose.translation.vector;
        let per_tilt = pose.rotation * endpoint.per_tilt;
        let ray = (p - eye).normalize();
        let mut found: Option<Pair> = None;
        for (index, target) in targets.iter().enumerate() {
            let residual_m = target.normal.dot(&(p - target.origin));
            if residual_m.abs() > config.gate_m || -target.normal.dot(&ray) < LEAST_INCIDENCE {
                continue;
            }
            let turn = lever.cross(&target.normal);
            let mut jacobian = State::zeros();
            jacobian.fixed_rows_mut::<3>(0).copy_from(&target.normal);
            jacobian.fixed_rows_mut::<3>(3).copy_from(&turn);
            jacobian[6] = target.normal.dot(&per_tilt);
            let variance = noise + (jacobian.transpose() * spread * jacobian)[0];
            if residual_m.powi(2) > config.gate_sigmas.powi(2) * variance {
                continue;
            }
            let local = (target.plane_from_world * p).xy();
            if !target.landmark.mask.within(&local, aside_m) {
                continue;
            }
            match &found {
                Some(other) if !same_surface(&targets[other.target], target, &p) => return None,
                Some(other) if other.residual_m.abs() <= residual_m.abs() => {}
                _ => found = Some(Pair { target: index, residual_m, jacobian }),
            }
        }
        found
    };
    endpoints.iter().filter_map(pair).collect()
}

/// Endpoints whose ray would have had to pass through a surface of the map.
fn behind(
    endpoints: &[Endpoint],
    targets: &[Target<'_>],
    pose: &Isometry3<f64>,
    robot_from_sensor: &Isometry3<f64>,
) -> usize {
    let eye = pose * Point3::from(robot_from_sensor.translation.vector);
    let passes = |endpoint: &&Endpoint| {
        let p = pose * endpoint.p;
        targets.iter().any(|target| {
            let before_m = target.normal.dot(&(eye - target.origin));
            let after_m = target.normal.dot(&(p - target.origin));
            if before_m <= 0.0 || after_m > -BEHIND_M {
                return false;
            }
            let crossing = eye + (p - eye) * (before_m / (before_m - after_m));
            let local = target.plane_from_world * crossing;
            target.landmark.mask.solid_about(&local.xy(), 1)
        })
    };
    endpoints.iter().filter(passes).count()
}

fn same_surface(a: &Target<'_>, b: &Target<'_>, at: &Point3<f64>) -> bool {
    let offset = |target: &Target<'_>| target.normal.dot(&(at - target.origin));
    a.normal.dot(&b.normal) > SAME_COS && (offset(a) - offset(b)).abs() < SAME_M
}

/// Information and gradient of all pairs, the error that endpoints of one landmark share taken out.
fn normal_equations(config: &AlignConfig, pairs: &[Pair], targets: usize) -> (Information, State) {
    let mut information = Information::zeros();
    let mut gradient = State::zeros();
    let mut shared = vec![(State::zeros(), 0.0, 0.0); targets];
    for pair in pairs {
        let deviation = pair.residual_m.abs() / config.point_sigma_m;
        let weight = (HUBER / deviation.max(HUBER)) / config.point_sigma_m.powi(2);
        let weighted = pair.jacobian * weight;
        information += weighted * pair.jacobian.transpose();
        gradient += weighted * pair.residual_m;
        let (jacobians, weights, residuals) = &mut shared[pair.target];
        *jacobians += weighted;
        *weights += weight;
        *residuals += weight * pair.residual_m;
    }
    let precision = config.landmark_sigma_m.powi(-2);
    for (jacobians, weights, residuals) in
        shared.into_iter().filter(|(_, weights, _)| *weights > 0.0)
    {
        let share = 1.0 / (precision + weights);
        information -= jacobians * jacobians.transpose() * share;
        gradient -= jacobians * (share * residuals);
    }
    (information, gradient)
}

#[cfg(test)]
mod tests {
    use super::super::landmark::LandmarkId;
    use super::super::mask::PlaneMask;
    use super::*;
    use crate::time::Stamp;
    use nalgebra::{Matrix3, Point2, Translation3, UnitQuaternion};

    /// A rectangle of a plane through `centre` that faces along `normal`.
    fn wall(id: u32, centre: [f64; 3], normal: [f64; 3], half: (f64, f64)) -> Landmark {
        let normal = Vector3::from(normal);
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &normal)
            .unwrap_or_else(|| UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0));
        let world_from_plane = Isometry3::from_parts(Translation3::from(centre), rotation);
        let mut mask = PlaneMask::default();
        for x in -80..80 {
            for y in -80..80 {
                let (x, y) = (0.05 + 0.1 * f64::from(x), 0.05 + 0.1 * f64::from(y));
                if x.abs() <= half.0 && y.abs() <= half.1 {
                    mask.insert(&Point2::new(x, y));
                }
            }
        }
        let (a, b) = half;
        Landmark {
            id: LandmarkId(id),
            world_from_plane,
            covariance: Matrix3::zeros(),
            hull: [(-a, -b), (a, -b), (a, b), (-a, b)].map(|(x, y)| Point2::new(x, y)).to_vec(),
            mask,
            sightings: 1,
            first_keyframe: 0,
            last_keyframe: 0,
        }
    }

    /// A room of 8 × 6 m, three metres high, with its floor, seen from within.
    fn room() -> Vec<Landmark> {
        vec![
            wall(0, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], (4.0, 4.0)),
            wall(1, [4.0, 0.0, 1.5], [-1.0, 0.0, 0.0], (3.0, 3.0)),
            wall(2, [-4.0, 0.0, 1.5], [1.0, 0.0, 0.0], (3.0, 3.0)),
            wall(3, [0.0, 3.0, 1.5], [0.0, -1.0, 0.0], (4.0, 4.0)),
            wall(4, [0.0, -3.0, 1.5], [0.0, 1.0, 0.0], (4.0, 4.0)),
        ]
    }

    /// What a laser at a pose sees of the landmarks, with noise of up to `noise_m`.
    fn line(world_from_sensor: &Isometry3<f64>, landmarks: &[Landmark], noise_m: f64) -> LaserLine {
        let mut line = LaserLine {
            stamp: Stamp::default(),
            first_bearing_rad: -std::f64::consts::FRAC_PI_2,
            bearing_step_rad: 1_f64.to_radians(),
            min_range_m: 0.1,
            max_range_m: 20.0,
            ranges_m: vec![20.0; 181],
        };
        let eye = Point3::from(world_from_sensor.translation.vector);
        for beam in 0..181 {
            let ray = world_from_sensor.rotation * line.direction(beam);
            let nearest = landmarks
                .iter()
                .filter_map(|landmark| {
                    let n = landmark.normal();
                    let range_m = n.dot(&(landmark.origin() - eye)) / n.dot(&ray);
                    let hit = landmark.world_from_plane.inverse() * (eye + ray * range_m);
                    (range_m > 0.0 && landmark.mask.contains(&hit.xy())).then_some(range_m)
                })
                .fold(20.0, f64::min);
            line.ranges_m[beam] = nearest + noise_m * (7.0 * beam as f64).sin();
        }
        line
    }

    fn pose(x: f64, y: f64, z: f64, yaw: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
        )
    }

    fn tilted(tilt_rad: f64) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(0.1, 0.0, 0.4),
            UnitQuaternion::from_euler_angles(0.0, tilt_rad, 0.0),
        )
    }

    /// A robot whose position is uncertain by 0.1 m and whose heading by 2°.
    fn prior() -> Matrix6<f64> {
        let sigmas = Vector6::new(0.1, 0.1, 0.02, 0.006, 0.006, 0.035);
        Matrix6::from_diagonal(&sigmas.component_mul(&sigmas))
    }

    #[test]
    fn a_line_in_a_room_corrects_position_and_heading() {
        let landmarks = room();
        for tilt_rad in [0.0, 0.1, 0.15] {
            let truth = pose(0.6, -0.4, 0.2, 0.3);
            let line = line(&(truth * tilted(tilt_rad)), &landmarks, 0.005);
            let predicted = pose(0.68, -0.33, 0.2, 0.335);
            let config = AlignConfig::default();
            let found =
                align_line(&config, &landmarks, &predicted, &prior(), &tilted(tilt_rad), &line)
                    .unwrap_or_else(|| panic!("tilt {tilt_rad}: no alignment"));
            let off = truth.inverse() * found.world_from_robot;
            let heading_rad = off.rotation.angle();
            assert!(heading_rad < 0.01, "tilt {tilt_rad}: {heading_rad} rad");
            let away_m = off.translation.vector.xy().norm();
            assert!(away_m < 0.03, "tilt {tilt_rad}: {away_m} m");
            assert!(found.covariance[(0, 0)] < 0.25 * prior()[(0, 0)]);
        }
    }

    #[test]
    fn a_corridor_leaves_the_way_along_it_to_odometry() {
        let landmarks: Vec<Landmark> =
            [0, 3, 4].iter().map(|&at: &usize| room().swap_remove(at)).collect();
        let truth = pose(0.0, 0.0, 0.2, 0.0);
        let line = line(&(truth * tilted(0.3)), &landmarks, 0.003);
        let predicted = pose(0.08, 0.08, 0.2, 0.02);
        let found = align_line(
            &AlignConfig::default(),
            &landmarks,
            &predicted,
            &prior(),
            &tilted(0.3),
            &line,
        )
        .expect("walls on both sides");
        let at = found.world_from_robot.translation.vector;
        assert!(at.y.abs() < 0.02, "across: {}", at.y);
        assert!((at.x - 0.08).abs() < 0.02, "along: {}", at.x);
        assert!(found.covariance[(0, 0)] > 0.8 * prior()[(0, 0)]);
    }

    #[test]
    fn a_line_of_another_place_says_nothing() {
        let landmarks = room();
        let elsewhere = pose(-1.2, 1.1, 0.2, 0.8);
        let line = line(&(elsewhere * tilted(0.2)), &landmarks, 0.003);
        let predicted = pose(0.6, -0.4, 0.2, 0.3);
        let found = align_line(
            &AlignConfig::default(),
            &landmarks,
            &predicted,
            &prior(),
            &tilted(0.2),
            &line,
        );
        assert_eq!(found, None);
    }

    #[test]
    fn without_planes_there_is_no_alignment() {
        let landmarks = room();
        let truth = pose(0.6, -0.4, 0.2, 0.3);
        let line = line(&(truth * tilted(0.2)), &landmarks, 0.0);
        let aligned = |landmarks: &[Landmark]| {
            align_line(&AlignConfig::default(), landmarks, &truth, &prior(), &tilted(0.2), &line)
        };
        assert_eq!(aligned(&[]), None);
        assert!(aligned(&landmarks).is_some());
    }
}
