//! Ten thousand updates of the full mode.

use super::world::{World, normal, rng};
use nalgebra::{DMatrix, Isometry3, Vector3};
use usar_agent::mapping::perturbation::perturbed_plane;
use usar_agent::mapping::{Mapper, MapperConfig, MotionSource, ScanObservations};

/// Poses of a round.
const ROUND: usize = 40;
const UPDATES: usize = 10_000;

fn assert_covariance(covariance: DMatrix<f64>, of: &str) {
    let skew = (&covariance - covariance.transpose()).amax();
    assert!(skew <= 1e-12 * covariance.amax(), "{of}: {skew} off symmetry");
    assert!(covariance.clone().cholesky().is_some(), "{of} is not positive: {covariance}");
}

#[test]
fn the_graphs_covariances_stay_symmetric_and_positive_over_10_000_updates() {
    let mut world = World::default();
    world.room((-3.0, 4.0), (-3.0, 3.0), 2.5);
    let step = Isometry3::new(
        Vector3::new(0.1, 0.0, 0.0),
        Vector3::z() * (std::f64::consts::TAU / ROUND as f64),
    );
    let mut truth = Isometry3::identity();
    let round: Vec<ScanObservations> = (0..ROUND)
        .map(|_| {
            let (scan, _) = world.observe(&truth, None);
            truth *= step;
            scan
        })
        .collect();
    let mut rng = rng(7);
    let mut mapper = Mapper::new(MapperConfig::default(), Isometry3::identity());
    for k in 0..UPDATES {
        if k > 0 {
            mapper.predict(&step, MotionSource::Wheels);
        }
        let mut scan = round[k % ROUND].clone();
        for seen in &mut scan.observations {
            let error = Vector3::from_fn(|i, _| seen.covariance[(i, i)].sqrt() * normal(&mut rng));
            seen.robot_from_plane = perturbed_plane(&seen.robot_from_plane, &error);
        }
        let report = mapper.observe(&scan);
        if k % 97 == 0 || k + 1 == UPDATES {
            let whole = |covariance: &[f64], size: usize| {
                DMatrix::from_column_slice(size, size, covariance)
            };
            assert_covariance(whole(report.covariance.as_slice(), 6), "the pose");
            for landmark in mapper.landmarks() {
                let covariance = mapper.landmark_covariance(landmark.id).unwrap();
                assert_covariance(whole(covariance.as_slice(), 3), "a landmark");
            }
            if k > 0 {
                let motion = mapper.motion_covariance(k / 2, k).unwrap();
                assert_covariance(whole(motion.as_slice(), 6), "a motion");
            }
        }
    }
    // It is still where it was ten thousand looks ago.
    let gap = mapper.world_from_robot().translation.vector
        - (0..(UPDATES - 1) % ROUND)
            .fold(Isometry3::identity(), |pose, _| pose * step)
            .translation
            .vector;
    assert!(gap.norm() < 0.005, "{gap}");
}
