//! A scanner that speaks only when it is asked (`SET … {Opcode Scan}`).

use super::bench::{Bench, Setting, near, quantile};
use usar_agent::acquisition::{AcquisitionConfig, Profile, QuarterDegrees, Scan, SweepRequest};
use usar_agent::protocol::Dialect;
use usar_agent::sim::SensorSpec;

fn scanner(dialect: Dialect) -> SensorSpec {
    let unit = match dialect {
        Dialect::Ut2004 => "CameraPanTilt",
        Dialect::Udk => "PanTilt",
    };
    let text = r#"
        type = "RangeScanner"
        name = "Scanner1"
        mount = "UNIT_Link2"
        position = [0.05, 0.0, 0.04]
        min_range_m = 0.1
        max_range_m = 20.0
        fov_deg = 180.0
        resolution_deg = 1.0
        interval_s = 0.0
        "#;
    toml::from_str(&text.replace("UNIT", unit)).unwrap()
}

/// Error of each row against the true tilt: an answer is stamped when it is cast.
fn asked_errors_deg(bench: &Bench, scan: &Scan) -> Vec<f64> {
    let rows = scan.image.rows().iter();
    rows.filter_map(|row| {
        let stamp = row.stamp?;
        let cast = bench.casts.iter().find(|cast| near(cast.cast_at, stamp))?;
        Some((row.tilt_rad - cast.tilt_rad).to_degrees())
    })
    .collect()
}

#[test]
fn each_row_is_asked_for_once_the_tilt_rests() {
    for dialect in [Dialect::Ut2004, Dialect::Udk] {
        let setting = Setting { scanner: Some(scanner(dialect)), ..Setting::new(dialect, true) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        let tilts = (0..20).map(|i| QuarterDegrees(2 * i)).collect();
        let profile = Profile { name: "asked".to_owned(), tilts };
        let paper = SweepRequest::paper(bench.acquisition.config());
        let scan = bench.take(SweepRequest { profile, ..paper });
        assert!(scan.complete && scan.filed == 20, "{dialect:?}: {:?}", scan.remarks);
        let errors = asked_errors_deg(&bench, &scan);
        assert!(errors.len() == 20 && quantile(&errors, 1.0) <= 0.0125, "{dialect:?}: {errors:?}");
        let asked = bench.sent.iter().filter(|line| line.contains("{Opcode Scan}")).count();
        assert!((20..=24).contains(&asked), "{dialect:?}: {asked} times");
        assert!(scan.seconds() < 20.0 * 1.6, "{dialect:?}: {} s", scan.seconds());
    }
}

#[test]
fn a_scanner_that_speaks_only_when_asked_is_swept_in_motion_too() {
    for dialect in [Dialect::Ut2004, Dialect::Udk] {
        let setting = Setting { scanner: Some(scanner(dialect)), ..Setting::new(dialect, true) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        let report = bench.calibrate();
        assert!(bench.acquisition.is_calibrated(), "{dialect:?}: {}", report.text);
        let tilts = (0..100).map(QuarterDegrees).collect();
        let profile = Profile { name: "asked in motion".to_owned(), tilts };
        let scan = bench.take(SweepRequest::flowing(profile));
        assert!(scan.complete && scan.filed >= 95, "{dialect:?}: {:?}", scan.remarks);
        // A fifth of a second a row, and the way to the first.
        assert!(scan.seconds() < 100.0 * 0.2 * 1.15, "{dialect:?}: {} s", scan.seconds());
        let errors = asked_errors_deg(&bench, &scan);
        let (median, p99) = (quantile(&errors, 0.5), quantile(&errors, 0.99));
        assert!(median <= 0.05 && p99 <= 0.15, "{dialect:?}: {median}°, {p99}°");
    }
}
