//! What goes wrong with scans: each ends in a usable part of one, and a line that says so.

use super::bench::{Bench, Setting, quantile};
use usar_agent::acquisition::{AcquisitionConfig, Profile, QuarterDegrees, Scan, SweepRequest};
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
    let (mut bench, scan) = scan_with(FaultKind::TiltLimits, None, Some(0.3));
    assert!(!scan.complete);
    usable(&bench, &scan, "the tilt rests at");
    // The next one meets the other end, and later ones keep to both.
    for says in ["the tilt rests at", "the tilt's limits cut"] {
        let later = bench.take(SweepRequest::model());
        assert!(later.filed >= 100, "{} rows: {:?}", later.filed, later.remarks);
        usable(&bench, &later, says);
    }
}

#[test]
fn a_laser_that_stops_leaves_the_rows_before() {
    let (bench, scan) = scan_with(FaultKind::SensorLoss, Some("RangeScanner"), None);
    assert!(!scan.complete);
    usable(&bench, &scan, "the laser has been silent");
}

/// The same with messages held back up to a second, each by chance, and overtaken by others.
fn disordered(what: &str) -> (Bench, Scan) {
    scan_with(FaultKind::Reorder, Some(what), Some(1.0))
}

#[test]
fn readings_out_of_order_and_late_count_by_their_own_times() {
    let (bench, scan) = disordered("MISSTA");
    assert!(scan.complete && scan.filed >= 210, "{} rows: {:?}", scan.filed, scan.remarks);
    usable(&bench, &scan, "readings of the tilt and 0 lines came out of order");
    usable(&bench, &scan, "readings came late");
}

#[test]
fn lines_out_of_order_and_late_become_rows_in_their_places() {
    let (bench, scan) = disordered("RangeScanner");
    assert!(scan.filed >= 200, "{} rows: {:?}", scan.filed, scan.remarks);
    assert!(scan.image.rows().is_sorted_by_key(|row| row.stamp));
    usable(&bench, &scan, "0 readings of the tilt and ");
    usable(&bench, &scan, "lines came out of order");
}

#[test]
fn a_sweep_at_rest_files_no_row_by_a_line_or_reading_of_another() {
    for what in ["MISSTA", "RangeScanner"] {
        let fault = FaultSpec {
            at_s: 3.0,
            for_s: None,
            robot: None,
            kind: FaultKind::Reorder,
            what: Some(what.to_owned()),
            value: Some(1.0),
        };
        let setting = Setting { faults: vec![fault], ..Setting::new(Dialect::Ut2004, true) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        let profile =
            Profile { name: "at rest".into(), tilts: (0..30).map(QuarterDegrees).collect() };
        let paper = SweepRequest::paper(bench.acquisition.config());
        let scan = bench.take(SweepRequest { profile, ..paper });
        let errors = bench.tilt_errors_deg(&scan);
        assert!(scan.filed >= 28, "{what}: {} rows: {:?}", scan.filed, scan.remarks);
        assert!(quantile(&errors, 1.0) <= 0.0125, "{what}: {errors:?}");
        let told = |part: &str| scan.remarks.iter().any(|remark| remark.contains(part));
        assert!(told("came out of order"), "{what}: {:?}", scan.remarks);
    }
}

#[test]
fn readings_that_come_late_are_waited_for() {
    let (bench, scan) = scan_with(FaultKind::Delay, Some("MISSTA"), Some(2.0));
    assert!(scan.complete, "{:?}", scan.remarks);
    usable(&bench, &scan, "readings came late");
}

fn fault(kind: FaultKind, at_s: f64, value: Option<f64>) -> FaultSpec {
    FaultSpec { at_s, for_s: None, robot: None, kind, what: None, value }
}

/// Takes model scans with a fault at a robot that sends no tilt readings. No row may lie elsewhere than
/// it was taken, beyond what a sweep in motion without readings is off by.
fn without_readings(scenario: &'static str, fault: FaultSpec, scans: usize) -> (Bench, Vec<Scan>) {
    without_readings_of(Dialect::Ut2004, scenario, fault, scans)
}

fn without_readings_of(
    dialect: Dialect,
    scenario: &'static str,
    fault: FaultSpec,
    scans: usize,
) -> (Bench, Vec<Scan>) {
    let setting = Setting { scenario, faults: vec![fault], ..Setting::new(dialect, false) };
    let mut bench = Bench::new(&setting, AcquisitionConfig::default());
    bench.calibrate();
    let scans: Vec<Scan> = (0..scans).map(|_| bench.take(SweepRequest::model())).collect();
    for scan in &scans {
        let errors = bench.tilt_errors_deg(scan);
        let worst = errors.iter().map(|error| error.abs()).fold(0.0, f64::max);
        assert!(worst <= 0.4, "{scenario}: {worst}° off, {errors:?}: {:?}", scan.remarks);
    }
    (bench, scans)
}

/// The station, where nothing lies ahead, on either kind of server.
const STATIONS: [(Dialect, &str); 2] =
    [(Dialect::Ut2004, "station"), (Dialect::Udk, "station_udk")];

fn tells(scan: &Scan, part: &str) -> bool {
    scan.remarks.iter().any(|remark| remark.contains(part))
}

#[test]
fn a_tilt_without_readings_that_sticks_before_its_law_is_found_files_no_false_row() {
    for (dialect, scenario) in STATIONS {
        for at_s in [1.0, 9.0, 15.0, 22.0] {
            let stuck = fault(FaultKind::TiltStuck, at_s, None);
            let (bench, scans) = without_readings_of(dialect, scenario, stuck, 2);
            let reach = bench.acquisition.control().reach();
            assert!(reach.is_narrowed(), "{scenario} {at_s}: {reach}: {:?}", scans[0].remarks);
            assert!(
                !scans[0].complete && tells(&scans[0], "rows are left out"),
                "{scenario} {at_s}: {:?}",
                scans[0].remarks
            );
        }
    }
}

#[test]
fn limits_narrower_than_told_before_the_law_is_found_leave_the_rows_within() {
    for (dialect, scenario) in STATIONS {
        for (at_s, limit_rad) in [(3.0, 0.1), (20.0, 0.2)] {
            let limit = fault(FaultKind::TiltLimits, at_s, Some(limit_rad));
            let (_, scans) = without_readings_of(dialect, scenario, limit, 2);
            let filed = scans[1].filed;
            assert!(filed >= 10, "{scenario} {limit_rad}: {filed}: {:?}", scans[1].remarks);
        }
    }
}

#[test]
fn a_tilt_without_readings_that_sticks_for_a_while_loses_the_rows_of_that_while() {
    for (dialect, scenario) in STATIONS {
        for (at_s, for_s) in [(40.0, 4.0), (55.0, 4.0), (55.0, 8.0), (60.0, 8.0), (55.0, 15.0)] {
            let stuck = FaultSpec { for_s: Some(for_s), ..fault(FaultKind::TiltStuck, at_s, None) };
            let (bench, scans) = without_readings_of(dialect, scenario, stuck, 1);
            let what = format!("{scenario}, {for_s} s from {at_s} s: {:?}", scans[0].remarks);
            assert!(!scans[0].complete && scans[0].filed >= 60, "{} {what}", scans[0].filed);
            assert!(tells(&scans[0], "rows are left out"), "{what}");
            assert!(!bench.acquisition.is_stuck(), "{what}");
        }
    }
}

#[test]
fn a_clean_slow_sweep_without_readings_loses_no_row() {
    for (dialect, scenario) in STATIONS {
        let setting = Setting { scenario, ..Setting::new(dialect, false) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        bench.calibrate();
        for _ in 0..2 {
            let scan = bench.take(SweepRequest::continuous());
            // Seventy, but for where the first line falls.
            assert!(scan.complete && scan.filed >= 69, "{scenario}: {}", scan.filed);
            assert!(!tells(&scan, "left out"), "{scenario}: {:?}", scan.remarks);
        }
    }
}

#[test]
fn a_limit_met_two_degrees_before_the_end_leaves_out_the_rows_beyond() {
    for (dialect, scenario) in STATIONS {
        let limit = fault(FaultKind::TiltLimits, 60.0, Some(0.4));
        let (_, scans) = without_readings_of(dialect, scenario, limit, 1);
        assert!(!scans[0].complete && scans[0].filed >= 190, "{scenario}: {}", scans[0].filed);
        assert!(tells(&scans[0], "rows are left out"), "{scenario}: {:?}", scans[0].remarks);
    }
}

#[test]
fn limits_met_on_the_way_to_the_first_row_leave_out_the_rows_beyond() {
    for (dialect, scenario) in STATIONS {
        for limit_rad in [0.25, 0.35] {
            let limit = fault(FaultKind::TiltLimits, 3.0, Some(limit_rad));
            let (_, scans) = without_readings_of(dialect, scenario, limit, 3);
            for scan in &scans {
                let what = format!("{scenario} {limit_rad}: {:?}", scan.remarks);
                assert!(scan.filed >= 100, "{} {what}", scan.filed);
            }
        }
    }
}

#[test]
fn a_tilt_found_stuck_by_the_laser_alone_files_nothing() {
    for (dialect, scenario) in STATIONS {
        let stuck = fault(FaultKind::TiltStuck, 40.0, None);
        let (bench, scans) = without_readings_of(dialect, scenario, stuck, 3);
        assert!(bench.acquisition.is_stuck(), "{scenario}: {:?}", scans[2].remarks);
        assert_eq!(scans[2].filed, 0, "{scenario}: {:?}", scans[2].remarks);
        assert!(tells(&scans[2], "no row of the profile can be reached"));
    }
}

#[test]
fn a_tilt_without_readings_that_never_turns_puts_no_row_into_a_scan() {
    // The hall of the station is open ahead, and the laser sees its walls alone.
    for scenario in ["box", "station"] {
        let (bench, scans) = without_readings(scenario, fault(FaultKind::TiltStuck, 1.0, None), 2);
        let reach = bench.acquisition.control().reach();
        assert!(reach.is_narrowed(), "{scenario}: {reach}: {:?}", scans[1].remarks);
        let filed = scans[1].filed;
        assert!(filed <= 2, "{scenario}: {filed} rows: {:?}", scans[1].remarks);
    }
}

#[test]
fn a_tilt_without_readings_that_sticks_leaves_the_rows_before() {
    let (bench, scans) = without_readings("box", fault(FaultKind::TiltStuck, 60.0, None), 3);
    assert!(scans[0].filed >= 30, "{} rows: {:?}", scans[0].filed, scans[0].remarks);
    assert!(bench.acquisition.is_stuck(), "{:?}", scans[2].remarks);
}

#[test]
fn limits_narrower_than_told_without_readings_leave_the_rows_within() {
    for scenario in ["box", "station"] {
        let limit = fault(FaultKind::TiltLimits, 55.0, Some(0.3));
        let (bench, scans) = without_readings(scenario, limit, 5);
        let limits = bench.acquisition.control().reach().limits().unwrap();
        assert!(limits.max_rad <= 0.301 || limits.min_rad >= -0.301, "{scenario}: {limits:?}");
        let filed: Vec<usize> = scans.iter().map(|scan| scan.filed).collect();
        // The sweeps that find an end keep what they had taken before, be it nothing.
        assert!(filed[4] >= 40, "{scenario}: {filed:?}: {:?}", scans[4].remarks);
    }
}

/// The number of rows that a remark tells, which ends in `says`.
fn rows_told(scan: &Scan, says: &str) -> Option<usize> {
    let remark = scan.remarks.iter().find(|remark| remark.contains(says))?;
    remark.split(says).next()?.split_whitespace().next_back()?.parse().ok()
}

#[test]
fn a_laser_that_stops_is_told_with_the_rows_that_were_filed() {
    let (_, scan) = scan_with(FaultKind::SensorLoss, Some("RangeScanner"), None);
    assert_eq!(rows_told(&scan, " rows taken"), Some(scan.filed), "{:?}", scan.remarks);
}

#[test]
fn a_line_to_the_server_that_becomes_slower_leaves_the_rows_before() {
    for late_s in [0.15, 0.5, 0.7, 0.9] {
        let late = fault(FaultKind::Delay, 55.0, Some(late_s));
        let (_, scans) = without_readings("box", late, 2);
        let scan = &scans[0];
        let told = |part: &str| scan.remarks.iter().any(|remark| remark.contains(part));
        assert!(scan.filed >= 30 && !scan.complete, "{late_s}: {} rows", scan.filed);
        assert!(told("rows are left out: messages began to come"), "{late_s}: {:?}", scan.remarks);
        // Later ones are taken at rest, as many rows as there is time for.
        assert!(scans[1].filed >= 30, "{late_s}: {} rows: {:?}", scans[1].filed, scans[1].remarks);
        assert!(scans[1].seconds() < 120.0, "{late_s}: {} s", scans[1].seconds());
    }
}

#[test]
fn a_clock_that_falls_back_a_little_puts_no_row_into_the_wrong_place() {
    // No jump that is told by its size: it looks as if the line had become slower.
    let back = fault(FaultKind::ClockJump, 55.0, Some(-0.7));
    let (_, scans) = without_readings("box", back, 1);
    assert!(scans[0].filed >= 30 && !scans[0].complete, "{} rows", scans[0].filed);
}

#[test]
fn messages_that_are_held_up_for_a_moment_cost_no_row() {
    for kind in [FaultKind::Stall, FaultKind::Delay] {
        let held = FaultSpec { for_s: Some(1.0), ..fault(kind, 55.0, Some(0.8)) };
        let (_, scans) = without_readings("box", held, 1);
        assert!(scans[0].complete, "{kind:?}: {:?}", scans[0].remarks);
        assert!(scans[0].filed >= 210, "{kind:?}: {} rows", scans[0].filed);
    }
}

#[test]
fn readings_out_of_order_hide_no_tilt_that_sticks_or_reaches_less() {
    for dialect in [Dialect::Ut2004, Dialect::Udk] {
        for (kind, value) in [(FaultKind::TiltStuck, None), (FaultKind::TiltLimits, Some(0.3))] {
            let what = if dialect == Dialect::Udk { "ASTA" } else { "MISSTA" };
            let late = FaultSpec {
                what: Some(what.to_owned()),
                ..fault(FaultKind::Reorder, 3.0, Some(1.0))
            };
            let faults = vec![late, fault(kind, 55.0, value)];
            let setting = Setting { faults, ..Setting::new(dialect, true) };
            let mut bench = Bench::new(&setting, AcquisitionConfig::default());
            bench.calibrate();
            let scan = bench.take(SweepRequest::model());
            assert!(!scan.complete && scan.filed >= 10, "{dialect:?} {kind:?}: {}", scan.filed);
            let worst = quantile(&bench.tilt_errors_deg(&scan), 1.0);
            assert!(worst <= 0.25, "{dialect:?} {kind:?}: {worst}");
            let told = |remark: &String| remark.contains("the tilt rests at");
            assert!(scan.remarks.iter().any(told), "{dialect:?} {kind:?}: {:?}", scan.remarks);
            assert!(bench.acquisition.control().reach().is_narrowed(), "{dialect:?} {kind:?}");
        }
    }
}

#[test]
fn readings_three_seconds_late_from_the_beginning_end_in_a_usable_scan() {
    for dialect in [Dialect::Ut2004, Dialect::Udk] {
        let what = if dialect == Dialect::Udk { "ASTA" } else { "MISSTA" };
        let late =
            FaultSpec { what: Some(what.to_owned()), ..fault(FaultKind::Delay, 1.0, Some(3.0)) };
        let setting = Setting { faults: vec![late], ..Setting::new(dialect, true) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        let report = bench.calibrate();
        let scan = bench.take(SweepRequest::model());
        assert!(scan.filed >= 15, "{dialect:?}: {}: {:?}", scan.filed, scan.remarks);
        assert!(scan.seconds() < 150.0, "{dialect:?}: {} s, {}", scan.seconds(), report.text);
        let worst = quantile(&bench.tilt_errors_deg(&scan), 0.99);
        assert!(worst <= 0.15, "{dialect:?}: {worst}, {}", report.text);
        let told = report.warning.is_some() || scan.remarks.iter().any(|r| r.contains("at rest"));
        assert!(told, "{dialect:?}: {} {:?}", report.text, scan.remarks);
    }
}
