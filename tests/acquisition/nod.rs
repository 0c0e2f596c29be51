//! Sweeps taken while the robot drives.

use super::bench::{Bench, Setting, quantile};
use usar_agent::acquisition::{AcquisitionConfig, FanConfig, Profile, SweepRequest};
use usar_agent::protocol::Dialect;
use usar_agent::robot::HeadPose;

#[test]
fn rows_of_a_nod_lie_where_the_robot_saw_them_from() {
    let setting = Setting { scenario: "station", ..Setting::new(Dialect::Ut2004, true) };
    let mut bench = Bench::new(&setting, AcquisitionConfig::default());
    bench.calibrate();
    let view = bench.rig.ground_view().unwrap();
    let mut profile =
        Profile::ground_fan(&view, &FanConfig { nearest_m: 1.2, ..FanConfig::default() });
    profile.tilts.sort();
    bench.drive(0.15);
    let scan = bench.take(SweepRequest::nodding(profile));
    bench.drive(0.0);
    let driven_m = scan.driven_m.unwrap();
    assert!(driven_m > 0.4, "{driven_m} m in {} s", scan.seconds());
    assert!(quantile(&bench.tilt_errors_deg(&scan), 0.99) < 0.3);
    // Where the sensor was at each row, seen from where it was at the last: by the image, and truly.
    let rows = scan.image.rows();
    let last = rows.last().unwrap();
    let true_last = bench.cast_of(last).unwrap().world_from_sensor;
    let errors: Vec<(f64, f64)> = rows
        .iter()
        .map(|row| {
            let told = last.scan_from_sensor.inverse() * row.scan_from_sensor;
            let truth = true_last.inverse() * bench.cast_of(row).unwrap().world_from_sensor;
            let off = truth.inverse() * told;
            (off.translation.vector.norm(), off.rotation.angle().to_degrees())
        })
        .collect();
    let metres: Vec<f64> = errors.iter().map(|error| error.0).collect();
    let degrees: Vec<f64> = errors.iter().map(|error| error.1).collect();
    // Odometry is cut to 0.01 m and counts every 0.2 s; without compensation rows are half a metre off.
    assert!(quantile(&metres, 0.95) < 0.05, "{} m", quantile(&metres, 0.95));
    assert!(quantile(&degrees, 0.95) < 0.5, "{}°", quantile(&degrees, 0.95));
    let head = &bench.rig.laser.as_ref().unwrap().head;
    let uncompensated = head.robot_from_device(HeadPose::tilted(last.tilt_rad)).inverse()
        * head.robot_from_device(HeadPose::tilted(rows[0].tilt_rad));
    let truth = true_last.inverse() * bench.cast_of(&rows[0]).unwrap().world_from_sensor;
    let left_alone_m = (truth.inverse() * uncompensated).translation.vector.norm();
    assert!(left_alone_m > 10.0 * metres[0].max(0.02), "{left_alone_m} m, {} m", metres[0]);
}
