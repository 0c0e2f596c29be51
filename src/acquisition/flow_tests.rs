//! Sweeps in motion against the test bed: how long they take, and how far off their rows are.

use super::testbed::{Behaviour, Faults, Testbed, World, books_balance, head};
use super::*;
use crate::geometry::AngleSpan;
use proptest::prelude::*;

/// UT2004 as it speaks: bursts of 0.2 s with jitter, lines a burst behind.
fn ut2004(readings: bool) -> Behaviour {
    Behaviour { readings, ..Behaviour::default() }
}

/// UDK as it speaks: no lag, finer stamps, a spring.
fn udk(readings: bool) -> Behaviour {
    Behaviour {
        law: ServoLaw::Spring { frequency_rad_s: 12.0, damping: 0.7 },
        line_lags: false,
        stamp_grid_s: 1e-4,
        jitter_s: 0.015,
        readings,
        ..Behaviour::default()
    }
}

fn calibrated(bed: &mut Testbed) -> Acquisition {
    let (speed, law) = match bed.behaviour.law {
        ServoLaw::Hinge { speed_rad_s, .. } => (Some(speed_rad_s), Some(ServoLaw::hinge(0.17))),
        ServoLaw::Spring { .. } => (None, None),
    };
    let config = AcquisitionConfig::default();
    let mut acquisition = Acquisition::new(&head(bed.behaviour.limits, speed), law, config);
    bed.run(&mut acquisition, 3.0);
    let actions = acquisition.calibrate(bed.now());
    bed.take(actions);
    bed.run_until(&mut acquisition, 60.0, |bed| !bed.calibrations.is_empty());
    acquisition
}

fn take(bed: &mut Testbed, acquisition: &mut Acquisition, request: SweepRequest) -> Scan {
    let actions = acquisition.start(request, bed.now());
    let at_once = bed.take(actions);
    at_once.or_else(|| bed.run(acquisition, 600.0)).expect("a sweep never hangs")
}

fn quantile(errors: &[f64], share: f64) -> f64 {
    let mut sorted: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * share).round() as usize]
}

/// The dialects with and without readings.
fn kinds() -> [(&'static str, Behaviour); 4] {
    [
        ("UT2004 with readings", ut2004(true)),
        ("UT2004 without", ut2004(false)),
        ("UDK with readings", udk(true)),
        ("UDK without", udk(false)),
    ]
}

#[test]
fn a_full_sweep_in_motion_is_near_the_lasers_own_bound_and_true_to_a_tenth_of_a_degree() {
    for (name, behaviour) in kinds() {
        let mut bed = Testbed::new(behaviour, Faults::default(), 21);
        let mut acquisition = calibrated(&mut bed);
        assert!(acquisition.is_calibrated(), "{name}: {}", bed.calibrations[0].text);
        // The first sweep begins a long way off; the second runs back from where the first ended.
        for begun_at_its_end in [false, true] {
            let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
            assert!(scan.complete && scan.remarks.is_empty(), "{name}: {:?}", scan.remarks);
            assert!((214..=226).contains(&scan.filed), "{name}: {} rows", scan.filed);
            let errors = bed.tilt_errors_deg(&scan);
            assert!(quantile(&errors, 0.5) < 0.05, "{name}: {}", quantile(&errors, 0.5));
            assert!(quantile(&errors, 0.99) < 0.15, "{name}: {}", quantile(&errors, 0.99));
            let bound_s = 220.0 * 0.2;
            let allowed = if begun_at_its_end { 1.05 } else { 1.15 };
            assert!(scan.seconds() < allowed * bound_s, "{name}: {} s", scan.seconds());
        }
    }
}

#[test]
fn every_set_point_in_motion_lies_on_the_grid_of_quarter_degrees() {
    let mut bed = Testbed::new(ut2004(true), Faults::default(), 22);
    let mut acquisition = calibrated(&mut bed);
    take(&mut bed, &mut acquisition, SweepRequest::flowing(Profile::coarse(1.0)));
    for (_, demand) in acquisition.control().tilt.commands() {
        let Demand::Angle(angle) = demand else { panic!("no rate was asked for") };
        let quarters = angle / QUARTER_DEGREE_RAD;
        assert!((quarters - quarters.round()).abs() < 1e-9, "{}°", angle.to_degrees());
    }
}

/// The second of two continuous scans, with the paper's rows, in its time, at the right tilts.
fn the_papers_scan(name: &str, behaviour: Behaviour, seed: u64) -> Scan {
    let mut bed = Testbed::new(behaviour, Faults::default(), seed);
    let mut acquisition = calibrated(&mut bed);
    take(&mut bed, &mut acquisition, SweepRequest::continuous());
    let scan = take(&mut bed, &mut acquisition, SweepRequest::continuous());
    assert!((69..=70).contains(&scan.filed), "{name}: {} rows", scan.filed);
    assert!((19.0..21.0).contains(&scan.seconds()), "{name}: {} s", scan.seconds());
    let errors = bed.tilt_errors_deg(&scan);
    assert!(quantile(&errors, 0.99) < 0.15, "{name}: {}", quantile(&errors, 0.99));
    scan
}

#[test]
fn the_continuous_profile_takes_the_papers_seventy_rows_in_nineteen_seconds() {
    for (name, behaviour) in [("with readings", ut2004(true)), ("without", ut2004(false))] {
        the_papers_scan(name, behaviour, 23);
    }
}

#[test]
fn without_rates_the_continuous_profile_follows_a_ramp_to_the_same_seventy_rows() {
    for (name, behaviour) in [("with readings", udk(true)), ("without", udk(false))] {
        let scan = the_papers_scan(name, behaviour, 24);
        // Of a constant rate: from row to row by the time between them, not in jerks.
        let rows = scan.image.rows();
        for pair in rows.windows(2).skip(2) {
            let seconds = (pair[1].stamp.unwrap() - pair[0].stamp.unwrap()).seconds();
            let rate = (pair[1].tilt_rad - pair[0].tilt_rad).abs() / seconds;
            assert!((rate - 0.05).abs() < 0.015, "{name}: {rate} rad/s");
        }
    }
}

#[test]
fn lines_and_readings_out_of_order_find_their_places_in_a_sweep_in_motion() {
    let faults = Faults { swap_readings: true, swap_lines_from_s: Some(40.0), ..Faults::default() };
    let mut bed = Testbed::new(ut2004(true), faults, 32);
    let mut acquisition = calibrated(&mut bed);
    assert!(acquisition.is_calibrated(), "{}", bed.calibrations[0].text);
    let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
    assert!(scan.complete && scan.filed >= 210, "{} rows: {:?}", scan.filed, scan.remarks);
    assert!(scan.image.rows().is_sorted_by_key(|row| row.stamp), "rows in order of time");
    assert!(quantile(&bed.tilt_errors_deg(&scan), 0.99) < 0.15);
    assert!(scan.remarks.iter().any(|r| r.contains("out of order")), "{:?}", scan.remarks);
}

#[test]
fn the_error_told_with_a_scan_covers_the_error_made() {
    for (name, behaviour) in kinds() {
        let mut bed = Testbed::new(behaviour, Faults::default(), 25);
        let mut acquisition = calibrated(&mut bed);
        for profile in [Profile::coarse(0.5), Profile::coarse(2.0)] {
            let scan = take(&mut bed, &mut acquisition, SweepRequest::flowing(profile));
            let errors = bed.tilt_errors_deg(&scan);
            let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
            let told = scan.errors.tilt_row_rad.to_degrees();
            assert!(rms < 2.0 * told, "{name}: {rms}° made, {told}° told");
            assert!(told < 0.2, "{name}: {told}°");
        }
    }
}

#[test]
fn an_uncalibrated_head_takes_the_rows_at_rest() {
    let behaviour = ut2004(true);
    let config = AcquisitionConfig::default();
    let law = Some(behaviour.law);
    let mut acquisition = Acquisition::new(&head(behaviour.limits, Some(0.17)), law, config);
    let mut bed = Testbed::new(behaviour, Faults::default(), 26);
    bed.run(&mut acquisition, 1.0);
    let profile = Profile { name: "few".into(), tilts: (0..5).map(QuarterDegrees).collect() };
    let scan = take(&mut bed, &mut acquisition, SweepRequest::flowing(profile));
    assert!(scan.complete && scan.image.rows()[0].tilt_rad == 0.0);
}

#[test]
fn a_tilt_that_sticks_in_motion_ends_the_sweep_with_the_rows_before() {
    let faults = Faults { tilt_sticks_at_s: Some(40.0), ..Faults::default() };
    let mut bed = Testbed::new(ut2004(true), faults, 27);
    let mut acquisition = calibrated(&mut bed);
    let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
    assert!(!scan.complete && scan.filed > 20, "{} rows", scan.filed);
    assert!(scan.remarks[0].contains("the tilt rests at"), "{:?}", scan.remarks);
    assert!(quantile(&bed.tilt_errors_deg(&scan), 0.99) < 0.15);
}

#[test]
fn a_tilt_without_readings_that_sticks_in_motion_ends_the_sweep_with_the_rows_before() {
    for (name, behaviour) in [("UT2004", ut2004(false)), ("UDK", udk(false))] {
        let mut bed = Testbed::new(behaviour, Faults::default(), 33);
        let mut acquisition = calibrated(&mut bed);
        bed.faults.tilt_sticks_at_s = Some(bed.now_s() + 15.0);
        let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
        assert!(!scan.complete && scan.filed > 20, "{name}: {}: {:?}", scan.filed, scan.remarks);
        assert!(scan.remarks[0].contains("last seen to turn at"), "{name}: {:?}", scan.remarks);
        let told = scan.remarks.iter().any(|r| r.contains("it is stuck"));
        assert!(told, "{name}: {:?}", scan.remarks);
        let errors = bed.tilt_errors_deg(&scan);
        assert!(quantile(&errors, 1.0) < 0.3, "{name}: {errors:?}");
        assert!(acquisition.is_stuck());
    }
}

#[test]
fn limits_narrower_than_told_are_found_in_motion_without_readings() {
    // A joint that met its limit on a jump got at least to where it was before the times could be off:
    // 0.25 s at full speed are 2.4°, and a spring may have got nowhere, from the 6° to 14° of the
    // calibration here.
    for (name, behaviour, surely) in [("UT2004", ut2004(false), 0.25), ("UDK", udk(false), 0.1)] {
        let mut bed = Testbed::new(behaviour, Faults::default(), 34);
        let mut acquisition = calibrated(&mut bed);
        bed.faults.true_limits = Some(AngleSpan::new(-0.2, 0.3));
        // One sweep after another meets an end, some of them at once; a later one keeps to both.
        let mut complete = None;
        for _ in 0..6 {
            let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
            let errors = bed.tilt_errors_deg(&scan);
            let worst = errors.iter().map(|error| error.abs()).fold(0.0, f64::max);
            assert!(worst < 0.3, "{name}: {errors:?}: {:?}", scan.remarks);
            if scan.complete {
                complete = Some(scan);
                break;
            }
        }
        let scan = complete.unwrap();
        assert!(scan.filed > 80, "{name}: {}, {:?}", scan.filed, scan.remarks);
        let limits = acquisition.control().reach().limits().unwrap();
        assert!((-0.201..-0.1).contains(&limits.min_rad), "{name}: {limits:?}");
        assert!((surely..0.301).contains(&limits.max_rad), "{name}: {limits:?}");
    }
}

#[test]
fn lines_held_up_by_a_stall_do_not_make_the_tilt_look_stuck() {
    let mut bed = Testbed::new(ut2004(true), Faults::default(), 35);
    let mut acquisition = calibrated(&mut bed);
    bed.faults.stall = Some((bed.now_s() + 15.0, 3.6));
    let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
    assert!(scan.complete && scan.filed > 150, "{} rows: {:?}", scan.filed, scan.remarks);
    assert!(!scan.remarks.iter().any(|r| r.contains("rests at")), "{:?}", scan.remarks);
    assert!(quantile(&bed.tilt_errors_deg(&scan), 0.99) < 0.15);
}

#[test]
fn a_sweep_begun_while_lines_are_held_up_does_not_take_them_for_a_tilt_at_rest() {
    let mut bed = Testbed::new(ut2004(true), Faults::default(), 40);
    let mut acquisition = calibrated(&mut bed);
    bed.faults.stall = Some((bed.now_s() + 15.0, 6.0));
    let cut = take(&mut bed, &mut acquisition, SweepRequest::model());
    assert!(!cut.complete, "the laser is silent for longer than it is waited for");
    let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
    // Lines that arrived together are no rows: nothing turned between them.
    assert!(scan.complete && scan.filed > 150, "{} rows: {:?}", scan.filed, scan.remarks);
    assert!(bed.reaches.is_empty(), "{:?}", bed.reaches);
    assert!(quantile(&bed.tilt_errors_deg(&scan), 0.99) < 0.15);
}

#[test]
fn a_clock_that_jumps_in_motion_keeps_the_rows_before_it() {
    for jump in [-500.0, 500.0] {
        let mut bed = Testbed::new(ut2004(true), Faults::default(), 36);
        let mut acquisition = calibrated(&mut bed);
        bed.faults.clock_jump = Some((bed.now_s() + 20.0, jump));
        let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
        assert!(!scan.complete && scan.filed > 40, "{} rows: {:?}", scan.filed, scan.remarks);
        assert!(scan.remarks[0].contains("clock jumped"), "{:?}", scan.remarks);
        assert!(quantile(&bed.tilt_errors_deg(&scan), 0.99) < 0.15);
        // Nothing of the time before is left to disturb the next one.
        let again = take(&mut bed, &mut acquisition, SweepRequest::model());
        assert!(again.complete && again.remarks.is_empty(), "{:?}", again.remarks);
        assert!(quantile(&bed.tilt_errors_deg(&again), 0.99) < 0.15);
    }
}

#[test]
fn a_slow_line_is_measured_waited_for_and_told() {
    for (name, readings) in [("with readings", true), ("without", false)] {
        // 150 ms either way.
        let behaviour = Behaviour { up_s: 0.15, down_s: 0.15, ..ut2004(readings) };
        let mut bed = Testbed::new(behaviour, Faults::default(), 37);
        let mut acquisition = calibrated(&mut bed);
        let report = bed.calibrations[0].clone();
        assert!(acquisition.is_calibrated(), "{name}: {}", report.text);
        let warning = report.warning.expect("a delay that long is told");
        assert!(warning.contains("the line to the server is slow"), "{warning}");
        let rest = SweepRequest {
            profile: Profile { name: "few".into(), tilts: (0..6).map(QuarterDegrees).collect() },
            ..SweepRequest::paper(acquisition.config())
        };
        let scan = take(&mut bed, &mut acquisition, rest);
        let worst_deg = quantile(&bed.tilt_errors_deg(&scan), 1.0);
        assert!(scan.complete && worst_deg <= 0.0125 + 1e-9, "{name}: {worst_deg}");
        let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
        assert!(scan.complete, "{name}: {:?}", scan.remarks);
        let off = quantile(&bed.tilt_errors_deg(&scan), 0.99);
        assert!(off < 0.15, "{name}: {off}");
    }
    // A quick line without readings: how commands and lines lie to one another is no time to obey.
    let mut bed = Testbed::new(ut2004(false), Faults::default(), 38);
    calibrated(&mut bed);
    let report = &bed.calibrations[0];
    assert!(report.text.contains("less lag of lines") && report.warning.is_none(), "{report:?}");
}

#[test]
fn the_time_of_a_sweep_in_motion_is_booked_by_what_it_is_spent_on() {
    let mut bed = Testbed::new(ut2004(true), Faults::default(), 39);
    let mut acquisition = calibrated(&mut bed);
    let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
    let budget = scan.budget;
    // 55° at 0.17 rad/s take 5.6 s, and the way to the first row up to 3; the rest waits for lines.
    assert!((5.0..10.0).contains(&budget.moving_s), "{budget}");
    assert!(budget.laser_s > 30.0 && budget.idle_s < 2.0, "{budget}");
    let scan = take(&mut bed, &mut acquisition, SweepRequest::continuous());
    assert!(scan.budget.moving_s > 17.0 && scan.budget.laser_s < 1.0, "{}", scan.budget);
}

#[test]
fn a_sweep_that_is_stopped_books_its_time_to_the_end() {
    let paper = SweepRequest::paper(&AcquisitionConfig::default());
    for request in [SweepRequest::model(), SweepRequest::continuous(), paper] {
        for after_s in [0.03, 1.0, 7.3] {
            let mut bed = Testbed::new(ut2004(true), Faults::default(), 41);
            let mut acquisition = calibrated(&mut bed);
            let actions = acquisition.start(request.clone(), bed.now());
            bed.take(actions);
            bed.run(&mut acquisition, after_s);
            // Nothing has come of the row under way.
            let scan = acquisition.stop_sweep("enough", bed.now()).unwrap();
            assert!((scan.seconds() - after_s).abs() < 0.01, "{}", scan.seconds());
            books_balance(&scan);
        }
    }
}

#[test]
fn limits_narrower_than_told_on_both_sides_leave_a_usable_partial_scan() {
    for (name, behaviour) in [("UT2004", ut2004(false)), ("UDK", udk(false))] {
        let mut bed = Testbed::new(behaviour, Faults::default(), 43);
        let mut acquisition = calibrated(&mut bed);
        bed.faults.true_limits = Some(AngleSpan::new(-0.297, 0.297));
        let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
        assert!(scan.filed >= 60, "{name}: {} rows: {:?}", scan.filed, scan.remarks);
        let worst = quantile(&bed.tilt_errors_deg(&scan), 1.0);
        assert!(worst < 0.3, "{name}: {worst}: {:?}", scan.remarks);
        let told = |part: &str| scan.remarks.iter().any(|remark| remark.contains(part));
        assert!(told("that is the limit of the tilt") && told("begun anew"), "{:?}", scan.remarks);
    }
}

#[test]
fn a_limit_that_comes_to_be_while_the_tilt_is_beyond_it_is_found_and_not_taken_for_a_stuck_joint() {
    for (name, behaviour) in [("UT2004", ut2004(false)), ("UDK", udk(false))] {
        let mut bed = Testbed::new(behaviour, Faults::default(), 44);
        let mut acquisition = calibrated(&mut bed);
        let actions = acquisition.park(HeadPose::tilted(0.75), bed.now());
        bed.take(actions);
        bed.run(&mut acquisition, 8.0);
        bed.faults.true_limits = Some(AngleSpan::new(-0.297, 0.297));
        let tilts = (60..260).rev().map(QuarterDegrees).collect();
        let fan = Profile { name: "fan".into(), tilts };
        for _ in 0..3 {
            let scan = take(&mut bed, &mut acquisition, SweepRequest::flowing(fan.clone()));
            let worst = bed.tilt_errors_deg(&scan).iter().map(|e| e.abs()).fold(0.0, f64::max);
            assert!(worst < 0.3, "{name}: {worst}: {:?}", scan.remarks);
        }
        assert!(!acquisition.is_stuck(), "{name}: {:?}", bed.reaches);
        let limits = acquisition.control().reach().limits().unwrap();
        assert!((0.1..0.31).contains(&limits.max_rad), "{name}: {limits:?}");
    }
}

#[test]
fn readings_out_of_order_do_not_keep_a_sweep_waiting_for_a_tilt_at_its_limit() {
    let mut bed = Testbed::new(ut2004(true), Faults::default(), 45);
    let mut acquisition = calibrated(&mut bed);
    bed.faults.true_limits = Some(AngleSpan::new(-0.35, 0.35));
    bed.faults.swap_readings = true;
    bed.faults.reading_delay_s = 0.3;
    let tilts = (60..260).rev().map(QuarterDegrees).collect();
    let fan = Profile { name: "fan".into(), tilts };
    let scan = take(&mut bed, &mut acquisition, SweepRequest::flowing(fan));
    assert!(scan.seconds() < 60.0, "{}: {:?}", scan.seconds(), scan.remarks);
    assert!(scan.remarks.iter().any(|r| r.contains("rests at")), "{:?}", scan.remarks);
}

#[test]
fn a_laser_that_stops_in_motion_ends_the_sweep_with_the_rows_before() {
    let faults = Faults { laser_stops_at_s: Some(40.0), ..Faults::default() };
    let mut bed = Testbed::new(ut2004(true), faults, 28);
    let mut acquisition = calibrated(&mut bed);
    let scan = take(&mut bed, &mut acquisition, SweepRequest::model());
    assert!(!scan.complete && scan.filed > 20, "{} rows", scan.filed);
    assert!(scan.remarks[0].contains("the laser has been silent"), "{:?}", scan.remarks);
}

#[test]
fn late_readings_in_motion_are_waited_for_and_told() {
    let faults = Faults { reading_delay_s: 2.0, swap_readings: true, ..Faults::default() };
    let mut bed = Testbed::new(ut2004(true), faults, 29);
    let mut acquisition = calibrated(&mut bed);
    let scan = take(&mut bed, &mut acquisition, SweepRequest::flowing(Profile::coarse(0.5)));
    assert!(scan.complete, "{:?}", scan.remarks);
    assert!(quantile(&bed.tilt_errors_deg(&scan), 0.99) < 0.15);
    let told = |part: &str| scan.remarks.iter().any(|remark| remark.contains(part));
    assert!(told("readings came late") && told("out of order"), "{:?}", scan.remarks);
}

#[test]
fn a_room_that_tells_nothing_leaves_the_lag_unknown_and_says_so() {
    let behaviour = ut2004(false);
    let mut bed = Testbed::new(behaviour, Faults::default(), 30);
    // Nothing within the scanner's reach.
    bed.world = World { ground_z: -100.0, ceiling_z: 100.0, room: [100.0, 100.0] };
    let acquisition = calibrated(&mut bed);
    assert!(!acquisition.is_calibrated());
    let text = &bed.calibrations[0].text;
    assert!(text.ends_with("scans are taken with the tilt at rest"), "{text}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]
    #[test]
    fn any_link_is_calibrated_and_its_rows_are_true(
        speed in 0.08..0.6f64, gap_deg in 1.2..2.8f64, burst in 0.12..0.3f64, share in 0.0..1.0f64,
        line_lags: bool, readings: bool, up in 0.0..0.03f64, down in 0.0..0.03f64, seed: u64
    ) {
        let behaviour = Behaviour {
            law: ServoLaw::Hinge { speed_rad_s: speed, gap_rad: gap_deg.to_radians() },
            burst_s: burst, jitter_s: 0.1 * burst, cast_share: share, line_lags, readings,
            up_s: up, down_s: down, ..Behaviour::default()
        };
        let mut bed = Testbed::new(behaviour, Faults::default(), seed);
        let mut acquisition = calibrated(&mut bed);
        prop_assert!(acquisition.is_calibrated(), "{}", bed.calibrations[0].text);
        let profile = Profile {
            name: "part".into(),
            tilts: (-20..40).map(QuarterDegrees).collect(),
        };
        let scan = take(&mut bed, &mut acquisition, SweepRequest::flowing(profile));
        prop_assert!(scan.complete, "{:?}", scan.remarks);
        let errors = bed.tilt_errors_deg(&scan);
        prop_assert!(quantile(&errors, 0.5) < 0.05, "{}", quantile(&errors, 0.5));
        prop_assert!(quantile(&errors, 0.99) < 0.15, "{}", quantile(&errors, 0.99));
    }
}
