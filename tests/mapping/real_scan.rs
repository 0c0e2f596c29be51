//! A real scan, moved by a known transform and associated with itself.
//!
//! The points are the same, but what they are seen from is not: regions end elsewhere, and walls, floors
//! and pillars that are plane to a few millimetres give another plane for every other extent.

use crate::protocol::reference_data;
use nalgebra::{Isometry3, Matrix6, Point3, Vector3};
use usar_agent::files::pcd::read_pcd;
use usar_agent::mapping::perturbation::pose_error;
use usar_agent::mapping::{
    Mapper, MapperConfig, MotionSource, ScanErrors, ScanObservations, UpdateReport,
    curved_observations, observations,
};
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{SegmentationConfig, Segmenter};

/// Every so many columns of a scan, as it looks from `pose`.
fn seen_from(scan: &PointGrid, pose: &Isometry3<f64>, every: usize) -> PointGrid {
    let back = pose.inverse();
    let columns = scan.columns().div_ceil(every);
    let cells = (0..scan.rows())
        .flat_map(|row| (0..columns).map(move |column| scan.point(row, column * every)));
    let moved = |point: Option<Point3<f64>>| {
        point.map_or([f32::NAN; 3], |point| (back * point).coords.map(|v| v as f32).into())
    };
    PointGrid::new(scan.rows(), columns, cells.map(moved).collect())
}

fn look(mapper: &mut Mapper, grid: &PointGrid) -> (UpdateReport, usize) {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let segmentation = segmenter.segment(grid);
    let scan = ScanObservations {
        observations: observations(segmentation, grid, &Isometry3::identity()),
        curves: curved_observations(segmentation, &Isometry3::identity()),
        robot_from_scan: Isometry3::identity(),
        errors: ScanErrors::default(),
        contacts: Vec::new(),
    };
    (mapper.observe(&scan), scan.observations.len())
}

/// What became of a scan and itself from `pose`.
struct Outcome {
    error_m: f64,
    error_rad: f64,
    nees: f64,
    paired_share: f64,
}

fn moved(scan: &PointGrid, pose: &Isometry3<f64>, every: usize) -> Outcome {
    let mut mapper = Mapper::new(MapperConfig::default(), Isometry3::identity());
    look(&mut mapper, &seen_from(scan, &Isometry3::identity(), every));
    mapper.predict(pose, MotionSource::Wheels);
    let (report, planes) = look(&mut mapper, &seen_from(scan, pose, every));
    let error = pose_error(&mapper.world_from_robot(), pose);
    let covariance: Matrix6<f64> = mapper.covariance();
    Outcome {
        error_m: error.fixed_rows::<3>(0).norm(),
        error_rad: error.fixed_rows::<3>(3).norm(),
        nees: error.dot(&covariance.cholesky().expect("a covariance").solve(&error)),
        paired_share: report.associations.len() as f64 / planes as f64,
    }
}

#[test]
fn a_real_scan_moved_by_a_known_transform_is_as_far_off_as_it_is_told() {
    let Some(bytes) = reference_data("scans/kurt3d_000.pcd") else { return };
    let scan = read_pcd(&bytes).unwrap().into_grid().unwrap();
    let pose = |x: f64, y: f64, yaw_deg: f64| {
        Isometry3::new(Vector3::new(x, y, 0.0), Vector3::z() * yaw_deg.to_radians())
    };
    let poses =
        [pose(0.1, 0.0, 0.0), pose(0.2, 0.0, 0.0), pose(0.3, 0.1, 5.0), pose(0.3, -0.4, -15.0)];
    let mut sum = 0.0;
    for every in [1, 2] {
        for pose in &poses {
            let Outcome { error_m, error_rad, nees, paired_share } = moved(&scan, pose, every);
            println!(
                "every {every}: {:.1} mm {:.3}°, NEES {nees:.1}, {paired_share:.2} paired",
                1e3 * error_m,
                error_rad.to_degrees()
            );
            assert!(error_m < 0.01 && error_rad < 0.003, "{error_m} m, {error_rad} rad");
            assert!(paired_share > 0.35, "{paired_share}");
            sum += nees;
        }
    }
    // 6 expected; told by the noise of the ranges alone it is at 70.
    let mean = sum / (2 * poses.len()) as f64;
    assert!(mean < 15.0, "{mean}");
}
