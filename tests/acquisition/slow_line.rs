//! A line to the server that is slow, or becomes so: rows lie where they were taken, or are off by no more
//! than they tell.

use super::bench::{Bench, Setting};
use usar_agent::acquisition::{
    AcquisitionConfig, CalibrationReport, Profile, QuarterDegrees, Scan, SweepRequest,
};
use usar_agent::protocol::Dialect;
use usar_agent::sim::{FaultKind, FaultSpec};

const DIALECTS: [Dialect; 2] = [Dialect::Ut2004, Dialect::Udk];

/// Everything that the server sends comes so much later from then on, and until then if at all.
fn late(at_s: f64, for_s: Option<f64>, late_s: f64) -> FaultSpec {
    let kind = FaultKind::Delay;
    FaultSpec { at_s, for_s, robot: None, kind, what: None, value: Some(late_s) }
}

fn calibrated(setting: &Setting) -> (Bench, CalibrationReport) {
    let mut bench = Bench::new(setting, AcquisitionConfig::default());
    let report = bench.calibrate();
    (bench, report)
}

fn fan(bench: &Bench) -> SweepRequest {
    let view = bench.rig.ground_view().unwrap();
    SweepRequest::flowing(Profile::ground_fan(&view, &bench.acquisition.config().fan))
}

/// The worst row, in degrees and in the standard deviations that it tells.
fn worst(bench: &Bench, scan: &Scan) -> (f64, f64) {
    let rows = scan.image.rows().iter();
    let errors = rows.filter_map(|row| {
        let off_rad = (row.tilt_rad - bench.cast_of(row)?.tilt_rad).abs();
        Some((off_rad.to_degrees(), off_rad / row.tilt_sigma_rad))
    });
    errors.fold((0.0, 0.0), |worst, row| (row.0.max(worst.0), row.1.max(worst.1)))
}

#[test]
fn a_line_that_is_slow_from_the_start_is_measured_and_no_row_lies_elsewhere() {
    for (dialect, late_s) in [(DIALECTS[0], 1.0), (DIALECTS[0], 3.0), (DIALECTS[1], 2.0)] {
        let faults = vec![late(1.0, None, late_s)];
        let (mut bench, report) = calibrated(&Setting { faults, ..Setting::new(dialect, false) });
        assert!(report.warning.is_some(), "{dialect:?} {late_s}: {}", report.text);
        for request in [SweepRequest::model(), fan(&bench)] {
            let scan = bench.take(request);
            let (worst_deg, sigmas) = worst(&bench, &scan);
            assert!(scan.filed >= 15, "{dialect:?} {late_s}: {:?}", scan.remarks);
            assert!(
                worst_deg <= 0.3 && sigmas <= 3.0,
                "{dialect:?} {late_s}: {worst_deg}, {sigmas}"
            );
        }
    }
}

#[test]
fn at_rest_no_row_is_filed_before_a_slow_line_has_brought_the_command() {
    for dialect in DIALECTS {
        let setting =
            Setting { faults: vec![late(1.0, None, 1.0)], ..Setting::new(dialect, false) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        let profile =
            Profile { name: "at rest".into(), tilts: (0..20).map(QuarterDegrees).collect() };
        let paper = SweepRequest::paper(bench.acquisition.config());
        let scan = bench.take(SweepRequest { profile, ..paper });
        let (worst_deg, _) = worst(&bench, &scan);
        assert!(scan.filed == 20 && worst_deg <= 0.0125, "{dialect:?}: {worst_deg}");
    }
}

#[test]
fn a_line_that_becomes_slower_by_and_by_puts_no_row_elsewhere() {
    for dialect in DIALECTS {
        // 50 ms more every two seconds, which looks like a server that runs a little slower.
        let steps =
            (1..20).map(|i| late(48.0 + 2.0 * f64::from(i), Some(2.0), 0.05 * f64::from(i)));
        let faults = steps.chain([late(88.0, None, 1.0)]).collect();
        let (mut bench, _) = calibrated(&Setting { faults, ..Setting::new(dialect, false) });
        let mut told = false;
        for request in [SweepRequest::model(), fan(&bench), SweepRequest::model()] {
            let scan = bench.take(request);
            let (worst_deg, sigmas) = worst(&bench, &scan);
            assert!(scan.filed >= 10, "{dialect:?}: {:?}", scan.remarks);
            assert!(worst_deg <= 0.15 || sigmas <= 3.0, "{dialect:?}: {worst_deg}, {sigmas}");
            told |= scan.remarks.iter().any(|remark| remark.contains("later than they did"));
        }
        assert!(told && bench.acquisition.wants_calibration(), "{dialect:?}");
    }
}

#[test]
fn a_line_that_becomes_slower_while_readings_tell_leaves_rows_in_their_places() {
    for dialect in DIALECTS {
        let faults = vec![late(60.0, None, 0.5)];
        let (mut bench, _) = calibrated(&Setting { faults, ..Setting::new(dialect, true) });
        for request in [SweepRequest::model(), fan(&bench)] {
            let scan = bench.take(request);
            let (worst_deg, sigmas) = worst(&bench, &scan);
            assert!(worst_deg <= 0.15 || sigmas <= 4.0, "{dialect:?}: {worst_deg}, {sigmas}");
        }
    }
}

#[test]
fn what_a_slow_tilt_may_be_off_by_on_a_long_way_is_told() {
    let slow = Setting { tilt_speed_rad_s: Some(0.05), ..Setting::new(Dialect::Ut2004, false) };
    let (mut bench, report) = calibrated(&slow);
    assert!(bench.acquisition.is_calibrated(), "{}", report.text);
    for request in [SweepRequest::model(), fan(&bench)] {
        let scan = bench.take(request);
        let (worst_deg, sigmas) = worst(&bench, &scan);
        assert!(worst_deg <= 0.5 && sigmas <= 3.0, "{worst_deg}, {sigmas}: {:?}", scan.remarks);
    }
}
