//! The paper's Table I: three planes, a straight way of four metres, odometry noise in x and y.

use crate::geometry::EulerPose;
use crate::mapping::{
    Full, FullConfig, Mip, MipConfig, Observation, PlaneMask, ScanObservations, UpdateReport,
};
use nalgebra::{Isometry3, Matrix3, Matrix6, Point2, UnitQuaternion, Vector3, Vector6};
use serde::Serialize;

/// Rows after the first.
const STEPS: usize = 4;

/// The corrected column as printed in the paper: x, y, z, φ, θ, ψ.
pub const PRINTED_CORRECTED: [[f64; 6]; STEPS] = [
    [1.0, 0.002, -9e-6, -6e-4, -2.15e-11, 3.2e-16],
    [2.0, 0.0015, 4e-6, -5e-4, 7e-12, -2.5e-11],
    [3.0, 0.001, 1.9e-6, -5e-4, 2e-12, -2e-11],
    [4.0, 5e-4, 6.7e-6, -5e-4, 7e-12, -2.5e-11],
];

/// The odometry column as printed: x, y.
pub const PRINTED_ODOMETRY: [[f64; 2]; STEPS] =
    [[1.169, 0.169], [2.227, 0.227], [3.470, 0.470], [4.645, 0.645]];

/// One row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Number of the step.
    pub k: usize,
    /// Odometry alone.
    pub odometry: [f64; 6],
    /// Prediction from the last corrected pose.
    pub predicted: [f64; 6],
    /// After the update.
    pub corrected: [f64; 6],
    /// Squared Mahalanobis distances of the pairs.
    pub distances_squared: Vec<f64>,
    /// Planes added to the map.
    pub added: usize,
}

/// A plane of the little world, in the world frame.
#[derive(Clone, Debug)]
pub struct WorldPlane {
    /// Local frame: centre of gravity and normal.
    pub world_from_plane: Isometry3<f64>,
    /// Corners in the local frame.
    pub hull: Vec<Point2<f64>>,
}

fn rectangle(width_m: f64, height_m: f64) -> Vec<Point2<f64>> {
    let (x, y) = (0.5 * width_m, 0.5 * height_m);
    vec![Point2::new(-x, -y), Point2::new(x, -y), Point2::new(x, y), Point2::new(-x, y)]
}

/// The three planes: a front wall, a side wall and the floor. The paper does not print where they
/// are; these centres of gravity are recovered from its residuals.
pub fn world() -> Vec<WorldPlane> {
    let frame = |centre: [f64; 3], normal: Vector3<f64>| {
        let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &normal)
            .expect("no normal here points straight down");
        Isometry3::from_parts(Vector3::from(centre).into(), rotation)
    };
    vec![
        WorldPlane {
            world_from_plane: frame([10.0, 0.0, 0.0], -Vector3::x()),
            hull: rectangle(2.4, 6.0),
        },
        WorldPlane {
            world_from_plane: frame([5.2, 3.0, 0.0], -Vector3::y()),
            hull: rectangle(9.6, 2.4),
        },
        WorldPlane {
            world_from_plane: frame([5.0, 0.0, 0.0], Vector3::z()),
            hull: rectangle(10.0, 6.0),
        },
    ]
}

/// Covariance of an observed plane (offset, two tilts).
pub fn observation_covariance() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(0.005, 0.025, 0.025).map(|sigma| sigma * sigma))
}

/// Covariance of the odometry as a perturbation (x, y, z, rotations about x, y, z). Height, pitch
/// and roll are not measured: "a high value".
pub fn odometry_covariance() -> Matrix6<f64> {
    let sigmas = Vector6::new(0.34, 0.34, 1.0, 1.0, 1.0, 0.011);
    Matrix6::from_diagonal(&sigmas.map(|sigma| sigma * sigma))
}

/// The noise added to each metre of odometry, the same in x and y.
///
/// The printed poses are those of `0.3 * rand() / 32767` with the C library that the authors
/// evidently used, its seed left at 1 and its first value not used: a uniform distribution of mean
/// 0.15 m, not one of 0.3 m standard deviation.
pub fn odometry_noise() -> [f64; STEPS] {
    let mut state: u32 = 1;
    let mut next = || {
        state = state.wrapping_mul(214_013).wrapping_add(2_531_011);
        f64::from(state >> 16 & 0x7fff)
    };
    next();
    std::array::from_fn(|_| 0.3 * next() / 32_767.0)
}

/// Noise-free observations of the world's planes from `world_from_robot`.
pub fn observe(world: &[WorldPlane], world_from_robot: &Isometry3<f64>) -> Vec<Observation> {
    world
        .iter()
        .map(|plane| Observation {
            robot_from_plane: world_from_robot.inverse() * plane.world_from_plane,
            covariance: observation_covariance(),
            hull: plane.hull.clone(),
            mask: PlaneMask::default(),
            points: 100,
            rms_m: 0.003,
        })
        .collect()
}

/// The true pose at step `k`: a pure translation along x, a metre a step.
pub fn true_pose(k: usize) -> Isometry3<f64> {
    Isometry3::translation(k as f64, 0.0, 0.0)
}

/// The odometry increments as measured.
pub fn increments() -> [Isometry3<f64>; STEPS] {
    odometry_noise().map(|noise| Isometry3::translation(1.0 + noise, noise, 0.0))
}

/// Runs the paper's filter over the table's input. `seen` is shown the state after each prediction
/// and after each update, for the picture of figure 2.
pub fn paper_mode(mut seen: impl FnMut(Stage<'_>)) -> Vec<Row> {
    let world = world();
    // The covariance above is the whole error of an observation: no floors beside it.
    let config = MipConfig { offset_floor_m: 0.0, tilt_floor_rad: 0.0, ..MipConfig::default() };
    let mut filter = Mip::new(config, Isometry3::identity(), Matrix6::zeros());
    let mut odometry = Isometry3::identity();
    let mut rows = Vec::new();
    for k in 0..=STEPS {
        if k > 0 {
            let increment = increments()[k - 1];
            odometry *= increment;
            filter.predict(&increment, &odometry_covariance());
        }
        let predicted = *filter.world_from_robot();
        let observations = observe(&world, &true_pose(k));
        seen(Stage { k, updated: false, odometry, filter: &filter, observations: &observations });
        let report = filter.update(&observations);
        seen(Stage { k, updated: true, odometry, filter: &filter, observations: &observations });
        rows.push(row(k, &odometry, &predicted, &report));
    }
    rows
}

/// The same input through the full mode, whose map has covariances of its own.
pub fn full_mode() -> Vec<Row> {
    let world = world();
    let mut full = Full::new(FullConfig::default(), Isometry3::identity(), &Matrix6::zeros());
    let mut odometry = Isometry3::identity();
    let mut rows = Vec::new();
    for k in 0..=STEPS {
        let (increment, covariance) = match k {
            0 => (Isometry3::identity(), Matrix6::zeros()),
            _ => (increments()[k - 1], odometry_covariance()),
        };
        odometry *= increment;
        let predicted = full.world_from_robot() * increment;
        let scan = ScanObservations {
            observations: observe(&world, &true_pose(k)),
            ..ScanObservations::default()
        };
        let report = full.observe(&increment, &covariance, None, &scan);
        rows.push(row(k, &odometry, &predicted, &report));
    }
    rows
}

/// One moment of the run.
pub struct Stage<'a> {
    /// Number of the step.
    pub k: usize,
    /// Whether the update of this step is done.
    pub updated: bool,
    /// Odometry alone.
    pub odometry: Isometry3<f64>,
    /// The filter at this moment.
    pub filter: &'a Mip,
    /// What is observed at this step.
    pub observations: &'a [Observation],
}

fn row(
    k: usize,
    odometry: &Isometry3<f64>,
    predicted: &Isometry3<f64>,
    report: &UpdateReport,
) -> Row {
    // Adding zero turns a negative zero into a plain one.
    let numbers =
        |pose: &Isometry3<f64>| EulerPose::from_isometry(pose).numbers().map(|value| value + 0.0);
    Row {
        k,
        odometry: numbers(odometry),
        predicted: numbers(predicted),
        corrected: numbers(&report.world_from_robot),
        distances_squared: report.associations.iter().map(|pair| pair.distance_squared).collect(),
        added: report.added.len(),
    }
}

/// The table as text, with the paper's figures below ours.
pub fn text(title: &str, rows: &[Row]) -> String {
    use std::fmt::Write;
    let mut out = format!("{title}\n");
    let _ = writeln!(
        out,
        "{:>2}  {:<16}  {:<26}  corrected x, y, z, phi, theta, psi",
        "k", "odometry x, y", "predicted x, y, phi"
    );
    for row in rows {
        let [x, y, z, phi, theta, psi] = row.corrected;
        let _ = writeln!(
            out,
            "{:>2}  {:7.4} {:7.4}   {:8.4} {:8.4} {:9.1e}  {x:8.4} {y:8.4} {z:9.1e} {phi:9.1e} {theta:9.1e} {psi:9.1e}",
            row.k,
            row.odometry[0],
            row.odometry[1],
            row.predicted[0],
            row.predicted[1],
            row.predicted[3],
        );
        if let Some(printed) = row.k.checked_sub(1) {
            let [x, y] = PRINTED_ODOMETRY[printed];
            let [px, py, pz, pphi, ptheta, ppsi] = PRINTED_CORRECTED[printed];
            let _ = writeln!(
                out,
                "    {x:7.3}  {y:7.3}  {:>28}  {px:8.4} {py:8.4} {pz:9.1e} {pphi:9.1e} {ptheta:9.1e} {ppsi:9.1e}  (printed)",
                ""
            );
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odometry_is_the_papers_to_the_last_printed_digit() {
        let rows = paper_mode(|_| ());
        for (row, printed) in rows[1..].iter().zip(PRINTED_ODOMETRY) {
            for (value, printed) in row.odometry.iter().zip(printed) {
                assert!((value - printed).abs() <= 5.1e-4, "{row:?}");
            }
            assert_eq!(&row.odometry[2..], &[0.0; 4]);
        }
    }

    #[test]
    fn the_first_planes_enter_as_unmatched_and_all_match_ever_after() {
        let rows = paper_mode(|_| ());
        assert_eq!((rows[0].added, rows[0].distances_squared.len()), (3, 0));
        for row in &rows[1..] {
            assert_eq!((row.added, row.distances_squared.len()), (0, 3));
        }
    }

    /// Recomputed independently in double precision with the same Q, R and centres of gravity.
    #[test]
    fn corrected_poses_equal_the_recomputed_ones() {
        let rows = paper_mode(|_| ());
        let y = [0.0023, 0.0014, 0.0013, 0.0005];
        let phi = [-5.3e-4, -4.4e-4, -5.6e-4, -4.3e-4];
        for (i, row) in rows[1..].iter().enumerate() {
            let [x, got_y, z, got_phi, theta, psi] = row.corrected;
            assert!((x - row.k as f64).abs() < 5e-4, "{row:?}");
            assert!((got_y - y[i]).abs() < 1e-4 && got_y > 0.0, "{row:?}");
            assert!((got_phi - phi[i]).abs() < 2e-5 && got_phi < 0.0, "{row:?}");
            assert!([z, theta, psi].iter().all(|value| value.abs() < 1e-4), "{row:?}");
        }
    }

    /// On the paper's own input: nothing lost beside the paper's mode, and every step as near to the
    /// truth as the printed table is.
    #[test]
    fn the_full_mode_is_as_near_to_the_truth_as_the_table() {
        let (paper, full) = (paper_mode(|_| ()), full_mode());
        for (paper, full) in paper.iter().zip(&full) {
            assert_eq!(full.odometry, paper.odometry);
            assert_eq!(full.added, paper.added);
            assert_eq!(full.distances_squared.len(), paper.distances_squared.len());
            let [x, y, z, ..] = full.corrected;
            assert!((x - full.k as f64).abs() < 1e-3 && y.abs() < 3e-3, "{full:?}");
            assert!(z.abs() < 1e-4, "{full:?}");
            assert!(full.corrected[3..].iter().all(|angle| angle.abs() < 1e-3), "{full:?}");
        }
    }

    #[test]
    fn predictions_compose_the_corrected_pose_with_the_increment() {
        let rows = paper_mode(|_| ());
        for pair in rows.windows(2) {
            let before = EulerPose::from_numbers(pair[0].corrected).to_isometry();
            let expected = EulerPose::from_isometry(&(before * increments()[pair[0].k]));
            for (a, b) in expected.numbers().iter().zip(pair[1].predicted) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }
}
