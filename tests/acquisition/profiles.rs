//! How long each profile takes, beside what laser and link allow, and how true its rows are.

use super::bench::{Bench, Setting, quantile};
use usar_agent::acquisition::{AcquisitionConfig, Profile, Scan, SweepRequest};
use usar_agent::protocol::Dialect;

/// Speed of the pan-tilt's links: what no profile can beat, in rad/s.
const LINK_RAD_S: f64 = 0.17;

const KINDS: [(&str, Dialect, bool); 4] = [
    ("UT2004, readings", Dialect::Ut2004, true),
    ("UT2004, none", Dialect::Ut2004, false),
    ("UDK, readings", Dialect::Udk, true),
    ("UDK, none", Dialect::Udk, false),
];

/// max(rows × laser interval, travel ÷ link speed); UDK's springs know no speed limit.
fn bound_s(scan: &Scan, dialect: Dialect) -> f64 {
    let tilts: Vec<f64> = scan.image.rows().iter().map(|row| row.tilt_rad).collect();
    let least = tilts.iter().copied().fold(f64::INFINITY, f64::min);
    let most = tilts.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let travel_s = match dialect {
        Dialect::Ut2004 => (most - least) / LINK_RAD_S,
        Dialect::Udk => 0.0,
    };
    travel_s.max(0.2 * tilts.len() as f64)
}

fn row(bench: &Bench, scan: &Scan, dialect: Dialect) -> String {
    let errors = bench.tilt_errors_deg(scan);
    let budget = &scan.budget;
    format!(
        "{:>5} | {:>7.1} | {:>7.1} | {:>5.2} | {:>6.3} | {:>6.3} | {:>6.1} | {:>6.1} | {:>6.1} | {:>6.1}",
        scan.filed,
        scan.seconds(),
        bound_s(scan, dialect),
        scan.seconds() / bound_s(scan, dialect),
        quantile(&errors, 0.5),
        quantile(&errors, 0.99),
        budget.moving_s,
        budget.servo_s,
        budget.laser_s,
        budget.idle_s,
    )
}

/// The table of the README: `tests/campaign/scans.sh` prints it.
#[test]
#[ignore = "a table to read, half an hour of simulated scanning: tests/campaign/scans.sh"]
fn table() {
    println!(
        "server           | profile    | rows  | seconds | bound   | ratio | median | p99 °  | \
         moving | servo  | laser  | idle"
    );
    for (name, dialect, readings) in KINDS {
        let mut bench = Bench::new(&Setting::new(dialect, readings), AcquisitionConfig::default());
        println!("{name}: {}", bench.calibrate().text);
        let paper = SweepRequest::paper(bench.acquisition.config());
        let view = bench.rig.ground_view().unwrap();
        let fan = Profile::ground_fan(&view, &bench.acquisition.config().fan);
        let profiles = [
            ("model", SweepRequest::model()),
            ("continuous", SweepRequest::continuous()),
            ("fan", SweepRequest::flowing(fan)),
            ("paper", paper),
        ];
        for (profile, request) in profiles {
            for _ in 0..2 {
                let scan = bench.take(request.clone());
                println!("{name:<16} | {profile:<10} | {}", row(&bench, &scan, dialect));
                for remark in &scan.remarks {
                    println!("  {remark}");
                }
            }
        }
    }
}

#[test]
fn the_model_profile_is_near_the_bound_and_true_on_every_server() {
    for (name, dialect, readings) in KINDS {
        let mut bench = Bench::new(&Setting::new(dialect, readings), AcquisitionConfig::default());
        let report = bench.calibrate();
        assert!(bench.acquisition.is_calibrated(), "{name}: {}", report.text);
        bench.take(SweepRequest::model());
        let scan = bench.take(SweepRequest::model());
        let errors = bench.tilt_errors_deg(&scan);
        let (median, p99) = (quantile(&errors, 0.5), quantile(&errors, 0.99));
        assert!(scan.complete && scan.filed >= 210, "{name}: {:?}", scan.remarks);
        let ratio = scan.seconds() / bound_s(&scan, dialect);
        assert!(ratio <= 1.15, "{name}: {ratio:.2} times the bound");
        assert!(median <= 0.05 && p99 <= 0.15, "{name}: {median:.3}°, {p99:.3}°");
    }
}

#[test]
fn rows_taken_fast_are_as_true_as_they_are_told_to_be() {
    for (name, dialect, readings) in KINDS {
        let mut bench = Bench::new(&Setting::new(dialect, readings), AcquisitionConfig::default());
        bench.calibrate();
        let view = bench.rig.ground_view().unwrap();
        let fan = Profile::ground_fan(&view, &bench.acquisition.config().fan);
        let (mut squares, mut rows) = (0.0, 0);
        for _ in 0..4 {
            // The server's frames lie elsewhere under each sweep.
            bench.run(0.37);
            let scan = bench.take(SweepRequest::flowing(fan.clone()));
            for row in scan.image.rows() {
                let Some(cast) = bench.cast_of(row) else { continue };
                squares += ((row.tilt_rad - cast.tilt_rad) / row.tilt_sigma_rad).powi(2);
                rows += 1;
            }
        }
        let mean_square = squares / f64::from(rows);
        assert!(rows > 60 && mean_square < 2.0, "{name}: {mean_square:.2} of 1 over {rows} rows");
    }
}
