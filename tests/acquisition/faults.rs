//! What goes wrong with scans: each ends in a usable part of one, and a line that says so.

use super::bench::{Bench, Setting, quantile};
use usar_agent::acquisition::{AcquisitionConfig, Scan, SweepRequest};
use usar_agent::protocol::Dialect;
use usar_agent::sim::{FaultKind, FaultSpec};

/// A model scan during which something happens.
fn scan_with(kind: FaultKind, what: Option<&str>, value: Option<f64>) -> (Bench, Scan) {
    let fault = FaultSpec {
        // The opening and the calibration take some 30 s; the sweep is under way then.
        at_s: 55.0,
        for_s: None,
        robot: None,
        kind,
        what: what.map(str::to_owned),
        value,
    };
    let setting = Setting { faults: vec![fault], ..Setting::new(Dialect::Ut2004, true) };
    let mut bench = Bench::new(&setting, AcquisitionConfig::default());
    let report = bench.calibrate();
    assert!(bench.acquisition.is_calibrated(), "{}", report.text);
    let scan = bench.take(SweepRequest::model());
    (bench, scan)
}

fn usable(bench: &Bench, scan: &Scan, says: &str) {
    assert!(scan.filed >= 30, "{} rows: {:?}", scan.filed, scan.remarks);
    let errors = bench.tilt_errors_deg(scan);
    assert!(quantile(&errors, 0.99) <= 0.15, "{}", quantile(&errors, 0.99));
    assert!(scan.remarks.iter().any(|remark| remark.contains(says)), "{:?}", scan.remarks);
}

#[test]
fn a_tilt_that_sticks_leaves_the_rows_before() {
    let (bench, scan) = scan_with(FaultKind::TiltStuck, None, None);
    assert!(!scan.complete);
    usable(&bench, &scan, "the tilt rests at");
}

#[test]
fn limits_narrower_than_told_leave_the_rows_within() {
    let (bench, scan) = scan_with(FaultKind::TiltLimits, None, Some(0.3));
    assert!(!scan.complete);
    usable(&bench, &scan, "the tilt rests at");
}

#[test]
fn a_laser_that_stops_leaves_the_rows_before() {
    let (bench, scan) = scan_with(FaultKind::SensorLoss, Some("RangeScanner"), None);
    assert!(!scan.complete);
    usable(&bench, &scan, "the laser has been silent");
}

#[test]
fn readings_that_come_late_are_waited_for() {
    let (bench, scan) = scan_with(FaultKind::Delay, Some("MISSTA"), Some(2.0));
    assert!(scan.complete, "{:?}", scan.remarks);
    usable(&bench, &scan, "readings came late");
}
