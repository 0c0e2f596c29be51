//! Whole sweeps against the test bed.

use super::testbed::{Behaviour, Faults, Testbed, head};
use super::*;
use crate::geometry::AngleSpan;
use proptest::prelude::*;

fn fixture(behaviour: &Behaviour, law: Option<ServoLaw>) -> Acquisition {
    let speed = match behaviour.law {
        ServoLaw::Hinge { speed_rad_s, .. } => Some(speed_rad_s),
        ServoLaw::Spring { .. } => None,
    };
    Acquisition::new(&head(behaviour.limits, speed), law, AcquisitionConfig::default())
}

fn request(profile: Profile) -> SweepRequest {
    SweepRequest { profile, ..SweepRequest::paper(&AcquisitionConfig::default()) }
}

/// `count` rows of a quarter degree from `first` on.
fn rows(first: i32, count: i32) -> Profile {
    let tilts = (first..first + count).map(QuarterDegrees).collect();
    Profile { name: "test".into(), tilts }
}

/// Lets the clocks meet, then sweeps.
fn sweep(bed: &mut Testbed, acquisition: &mut Acquisition, profile: Profile) -> Scan {
    bed.run(acquisition, 1.0);
    let actions = acquisition.start(request(profile), bed.now());
    let at_once = bed.take(actions);
    at_once.or_else(|| bed.run(acquisition, 600.0)).expect("a sweep never hangs")
}

fn worst(errors: &[f64]) -> f64 {
    errors.iter().fold(0.0, |worst: f64, e| worst.max(e.abs()))
}

const TOLERANCE_DEG: f64 = 0.0125;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn no_row_is_filed_with_the_tilt_off_its_demanded_angle(
        speed in 0.05..1.0f64, gap_deg in 0.5..3.0f64, burst in 0.08..0.4f64, jitter in 0.0..0.1f64,
        cast_share in 0.0..1.0f64, line_lags: bool, readings: bool,
        up in 0.0..0.02f64, down in 0.0..0.015f64, frame in 0.005..0.033f64, seed: u64,
        first in -100..60i32, step in 1..24i32
    ) {
        // The law is the hinge's with another gap: the agent is told speed and gap, no more.
        let law = ServoLaw::Hinge { speed_rad_s: speed, gap_rad: gap_deg.to_radians() };
        let behaviour = Behaviour {
            law, burst_s: burst, jitter_s: jitter * burst, cast_share, line_lags, readings,
            up_s: up, down_s: down, frame_s: frame, ..Behaviour::default()
        };
        let mut acquisition = fixture(&behaviour, Some(law));
        let mut bed = Testbed::new(behaviour, Faults::default(), seed);
        let profile = Profile {
            name: "test".into(),
            tilts: (0..6).map(|i| QuarterDegrees(first + i * step)).collect(),
        };
        let scan = sweep(&mut bed, &mut acquisition, profile);
        prop_assert!(scan.complete, "{:?}", scan.remarks);
        let errors = bed.tilt_errors_deg(&scan);
        prop_assert_eq!(errors.len(), 6);
        prop_assert!(worst(&errors) <= TOLERANCE_DEG + 1e-9, "{:?}", errors);
    }

    #[test]
    fn a_spring_of_unknown_law_is_waited_for_by_its_readings(
        frequency in 8.0..40.0f64, damping in 0.15..2.0f64, seed: u64, step in 1..20i32
    ) {
        let behaviour = Behaviour {
            law: ServoLaw::Spring { frequency_rad_s: frequency, damping },
            burst_s: 0.1, line_lags: false, stamp_grid_s: 1e-4, reading_grid_rad: 1e-4,
            ..Behaviour::default()
        };
        let mut acquisition = fixture(&behaviour, None);
        let mut bed = Testbed::new(behaviour, Faults::default(), seed);
        let profile = Profile {
            name: "test".into(),
            tilts: (0..6).map(|i| QuarterDegrees(i * step)).collect(),
        };
        let scan = sweep(&mut bed, &mut acquisition, profile);
        prop_assert!(scan.complete, "{:?}", scan.remarks);
        // The reading's own grid comes on top of the tolerance.
        let bound = TOLERANCE_DEG + 2e-4_f64.to_degrees();
        prop_assert!(worst(&bed.tilt_errors_deg(&scan)) <= bound, "{:?}", bed.tilt_errors_deg(&scan));
    }
}

#[test]
fn the_next_sweep_runs_the_other_way() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let mut bed = Testbed::new(behaviour, Faults::default(), 3);
    let first = sweep(&mut bed, &mut acquisition, rows(-8, 6));
    let second = sweep(&mut bed, &mut acquisition, rows(-8, 6));
    assert!(first.complete && second.complete);
    assert_eq!(first.image.rows()[5].tilt_rad, second.image.rows()[0].tilt_rad);
    assert!(first.remarks.is_empty(), "{:?}", first.remarks);
}

#[test]
fn a_laser_that_stops_ends_the_sweep_with_what_there_is() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let faults = Faults { laser_stops_at_s: Some(12.0), ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 5);
    let scan = sweep(&mut bed, &mut acquisition, rows(-40, 40));
    assert!(!scan.complete && scan.filed >= 5, "{}", scan.filed);
    assert_eq!(scan.gaps, 3);
    assert!(scan.remarks[0].starts_with("the laser has been silent for"), "{:?}", scan.remarks);
    assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG);
    assert!(bed.now_s() < 60.0, "three rows of two waits each, then the end");
}

#[test]
fn a_tilt_that_sticks_ends_the_sweep_with_the_rows_before() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let faults = Faults { tilt_sticks_at_s: Some(14.0), ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 6);
    let scan = sweep(&mut bed, &mut acquisition, rows(-40, 60));
    assert!(!scan.complete && scan.filed >= 5);
    assert!(scan.remarks[0].contains("the tilt rests at"), "{:?}", scan.remarks);
    assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG + 0.012);
}

#[test]
fn limits_narrower_than_told_lose_the_rows_beyond_and_keep_the_rest() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let true_limits = Some(AngleSpan::new(-2.1_f64.to_radians(), 1.4_f64.to_radians()));
    let faults = Faults { true_limits, ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 7);
    let scan = sweep(&mut bed, &mut acquisition, rows(-20, 40));
    let mut filed: Vec<f64> = scan
        .image
        .rows()
        .iter()
        .filter(|row| row.stamp.is_some())
        .map(|row| row.tilt_rad.to_degrees())
        .collect();
    filed.sort_by(f64::total_cmp);
    assert_eq!(filed.len(), 14, "{filed:?}");
    assert!((filed[0] + 2.0).abs() < 1e-9 && (filed[13] - 1.25).abs() < 1e-9, "{filed:?}");
    assert!(scan.remarks[0].starts_with("the tilt rests at 1.4"), "{:?}", scan.remarks);
    assert!(scan.remarks[1].starts_with("the tilt rests at -2.1"), "{:?}", scan.remarks);
    assert_eq!(scan.gaps, 2);
    assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG + 0.012);
}

#[test]
fn a_line_that_becomes_slow_is_told_and_waited_for() {
    for readings in [true, false] {
        let behaviour = Behaviour { readings, ..Behaviour::default() };
        let mut acquisition = fixture(&behaviour, Some(behaviour.law));
        let mut bed = Testbed::new(behaviour, Faults::default(), 20);
        bed.run(&mut acquisition, 4.0);
        bed.faults.slower = Some((bed.now_s(), 2.0));
        bed.run(&mut acquisition, 9.0);
        let scan = sweep(&mut bed, &mut acquisition, rows(-8, 10));
        assert!(scan.complete, "{:?}", scan.remarks);
        let told = scan.remarks.iter().any(|r| r.contains("2.0 s later than they did"));
        assert!(told, "{:?}", scan.remarks);
        assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG, "readings {readings}");
    }
}

#[test]
fn a_sweep_of_ones_own_choice_gets_the_fine_rows_that_the_way_requires() {
    let behaviour = Behaviour::default();
    let acquisition = fixture(&behaviour, Some(behaviour.law));
    let head = acquisition.control().head().clone();
    let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: 1.5 };
    let with = |profile: Profile, distance_m: f64| {
        let mut interest = Interest::default();
        interest.require(distance_m);
        acquisition.with_required(profile, &view, &interest)
    };
    // Every quarter degree is fine enough where the sweep reaches, and missing where it does not.
    assert_eq!(with(Profile::paper_full(), 2.0).1, 0);
    let (profile, added) = with(Profile::paper_full(), 0.7);
    assert!(added > 2 && profile.len() == 220 + added);
    assert!(with(Profile::coarse(2.0), 1.5).1 > 0);
}

/// A head without readings, and what its laser makes of a fault.
fn unread(faults: Faults, seed: u64) -> (Testbed, Acquisition) {
    let behaviour = Behaviour { readings: false, ..Behaviour::default() };
    let acquisition = fixture(&behaviour, Some(behaviour.law));
    (Testbed::new(behaviour, faults, seed), acquisition)
}

#[test]
fn a_tilt_without_readings_that_sticks_is_seen_by_the_laser_and_its_rows_are_left_out() {
    let (mut bed, mut acquisition) =
        unread(Faults { tilt_sticks_at_s: Some(24.0), ..Faults::default() }, 15);
    let scan = sweep(&mut bed, &mut acquisition, rows(-40, 120));
    assert!(!scan.complete && (10..30).contains(&scan.filed), "{}: {:?}", scan.filed, scan.remarks);
    assert!(scan.remarks[0].starts_with("the laser saw the same in"), "{:?}", scan.remarks);
    assert!(scan.remarks.iter().any(|r| r.contains("it is stuck")), "{:?}", scan.remarks);
    let errors = bed.tilt_errors_deg(&scan);
    assert!(worst(&errors) <= TOLERANCE_DEG + 1e-9, "{errors:?}");
    assert!(acquisition.is_stuck() && bed.reaches.last().is_some_and(|r| r.stuck_rad().is_some()));
    assert!(bed.now_s() < 100.0, "the sweep goes not on for all its rows: {} s", bed.now_s());
    // Wherever it is parked now, no line of it guards.
    let actions = acquisition.park(HeadPose::tilted(0.3), bed.now());
    bed.take(actions);
    bed.run(&mut acquisition, 6.0);
    assert!(matches!(acquisition.parked(bed.now()), ParkState::Elsewhere { .. }));
}

#[test]
fn limits_narrower_than_told_are_found_without_readings_and_later_sweeps_keep_to_them() {
    let true_limits = Some(AngleSpan::new(-1.0, 8.3_f64.to_radians()));
    let (mut bed, mut acquisition) = unread(Faults { true_limits, ..Faults::default() }, 16);
    let scan = sweep(&mut bed, &mut acquisition, rows(-10, 100));
    assert!(!scan.complete && scan.filed >= 40, "{}: {:?}", scan.filed, scan.remarks);
    assert!(scan.remarks.iter().any(|r| r.contains("limit of the tilt")), "{:?}", scan.remarks);
    let errors = bed.tilt_errors_deg(&scan);
    assert!(worst(&errors) <= TOLERANCE_DEG + 1e-9, "{errors:?} {:?}", scan.remarks);
    let limits = acquisition.control().head().tilt().and_then(|axis| axis.limits).unwrap();
    assert!((7.9..8.31).contains(&limits.max_rad.to_degrees()), "{limits:?}");
    assert!(!acquisition.is_stuck() && bed.reaches.len() == 1, "{:?}", bed.reaches);
    let scan = sweep(&mut bed, &mut acquisition, rows(20, 40));
    assert!(scan.complete && scan.filed < 15, "{}: {:?}", scan.filed, scan.remarks);
    assert!(scan.remarks[0].starts_with("the tilt's limits cut"), "{:?}", scan.remarks);
    assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG + 1e-9);
}

#[test]
fn limits_that_readings_show_are_kept_to_and_given_up_when_readings_lie_beyond() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let true_limits = Some(AngleSpan::new(-1.0, 1.4_f64.to_radians()));
    let mut bed = Testbed::new(behaviour, Faults { true_limits, ..Faults::default() }, 17);
    sweep(&mut bed, &mut acquisition, rows(-4, 16));
    let limits = acquisition.control().reach().limits().unwrap();
    assert!((limits.max_rad.to_degrees() - 1.4).abs() < 0.05, "{limits:?}");
    bed.faults.true_limits = None;
    let told = acquisition.handle(
        &HeadEvent::Joints(crate::robot::HeadReading {
            stamp: acquisition.control().clock().latest().unwrap()
                + crate::time::Span::from_millis(1),
            pan: None,
            tilt: Some(crate::robot::JointAngle { angle_rad: 0.2, half_width_rad: 1e-4 }),
        }),
        bed.now(),
    );
    assert!(matches!(told.first(), Some(HeadAction::Reach(reach)) if !reach.is_narrowed()));
}

#[test]
fn a_tilt_without_readings_that_sticks_before_it_is_parked_is_not_called_parked() {
    let (mut bed, mut acquisition) =
        unread(Faults { tilt_sticks_at_s: Some(1.5), ..Faults::default() }, 18);
    bed.run(&mut acquisition, 1.0);
    let actions = acquisition.park(HeadPose::tilted(0.5), bed.now());
    bed.take(actions);
    for _ in 0..40 {
        bed.run(&mut acquisition, 0.4);
        let state = acquisition.parked(bed.now());
        let thinks = matches!(state, ParkState::Computed { pose, .. } if pose.tilt_rad > 0.3);
        assert!(!thinks, "{state:?} at {} s", bed.now_s());
    }
    assert!(bed.reaches.iter().any(Reach::is_narrowed), "{:?}", bed.reaches);
}

#[test]
fn a_nod_is_not_taken_where_no_reading_would_show_a_tilt_that_sticks() {
    let (mut bed, mut acquisition) = unread(Faults::default(), 19);
    bed.run(&mut acquisition, 1.0);
    acquisition.control.timing.calibrated = true;
    let head = acquisition.control().head().clone();
    let view = GroundView { head: &head, origin_height_m: 0.18, half_fov_rad: 1.5 };
    let terms = NodTerms { full_mps: 0.5, slow_mps: 0.1, sure_m: 9.0, guard_m: 1.0, stop_s: 4.0 };
    let refused = acquisition.choose_nod(&view, &Interest::default(), &terms);
    assert!(refused.is_err_and(|why| why.contains("no readings")));
}

#[test]
fn readings_that_come_late_leave_the_computed_wait_to_decide() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let faults = Faults { reading_delay_s: 5.0, ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 8);
    bed.run(&mut acquisition, 8.0);
    let scan = sweep(&mut bed, &mut acquisition, rows(-8, 10));
    assert!(scan.complete && scan.unverified == 10, "{:?}", scan.remarks);
    assert!(scan.remarks[0].starts_with("10 rows were filed on the computed waiting time"));
    assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG);
}

#[test]
fn readings_out_of_order_are_sorted_and_harmless() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let faults = Faults { swap_readings: true, ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 9);
    let scan = sweep(&mut bed, &mut acquisition, rows(-8, 10));
    assert!(scan.complete, "{:?}", scan.remarks);
    assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG);
}

#[test]
fn lost_lines_cost_time_and_no_rows() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let faults = Faults { drop_every: Some(2), ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 10);
    let scan = sweep(&mut bed, &mut acquisition, rows(-8, 10));
    assert!(scan.complete, "{:?}", scan.remarks);
}

#[test]
fn a_clock_that_jumps_begins_the_row_anew() {
    let behaviour = Behaviour::default();
    for jump in [-500.0, 500.0] {
        let mut acquisition = fixture(&behaviour, Some(behaviour.law));
        let faults = Faults { clock_jump: Some((5.0, jump)), ..Faults::default() };
        let mut bed = Testbed::new(behaviour.clone(), faults, 11);
        let scan = sweep(&mut bed, &mut acquisition, rows(-8, 10));
        assert!(scan.complete, "{:?}", scan.remarks);
        assert!(scan.remarks[0].contains("clock jumped"), "{:?}", scan.remarks);
        assert!(worst(&bed.tilt_errors_deg(&scan)) <= TOLERANCE_DEG);
    }
}

#[test]
fn a_silent_server_ends_the_sweep_with_a_reason() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let actions = acquisition.start(request(rows(-8, 4)), Arrival(0));
    assert!(actions.is_empty());
    let wakeup = acquisition.next_wakeup().unwrap();
    let actions = acquisition.handle(&HeadEvent::Tick, wakeup);
    let Some(HeadAction::Finished(scan)) = actions.first() else { panic!("{actions:?}") };
    assert!(!scan.complete && scan.remarks[0].contains("clock is unknown"));
    assert_eq!(acquisition.next_wakeup(), None);
}

#[test]
fn parking_is_verified_by_readings_and_computed_without() {
    for readings in [true, false] {
        let behaviour = Behaviour { readings, ..Behaviour::default() };
        let mut acquisition = fixture(&behaviour, Some(behaviour.law));
        let mut bed = Testbed::new(behaviour, Faults::default(), 12);
        bed.run(&mut acquisition, 1.0);
        assert_eq!(acquisition.parked(bed.now()), ParkState::NotParked);
        let actions = acquisition.park(HeadPose::tilted(0.3), bed.now());
        bed.take(actions);
        bed.run(&mut acquisition, 0.5);
        assert_eq!(acquisition.parked(bed.now()), ParkState::Moving);
        bed.run(&mut acquisition, 4.0);
        let state = acquisition.parked(bed.now());
        assert_eq!(matches!(state, ParkState::Verified { .. }), readings, "{state:?}");
        assert_eq!(matches!(state, ParkState::Computed { .. }), !readings, "{state:?}");
        assert!((bed.tilt_rad() - 0.3).abs() < 0.0044);
        let stamp = acquisition.control().clock().latest().unwrap();
        assert!(state.covers(stamp));
        assert!((acquisition.pose_at(stamp).unwrap().tilt_rad - 0.3).abs() < 0.005);
    }
}

#[test]
fn a_head_that_does_not_reach_its_parking_place_is_not_called_parked() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let faults = Faults { tilt_sticks_at_s: Some(1.5), ..Faults::default() };
    let mut bed = Testbed::new(behaviour, faults, 13);
    bed.run(&mut acquisition, 1.0);
    let actions = acquisition.park(HeadPose::tilted(0.5), bed.now());
    bed.take(actions);
    bed.run(&mut acquisition, 8.0);
    let state = acquisition.parked(bed.now());
    assert!(matches!(state, ParkState::Elsewhere { tilt_rad } if tilt_rad < 0.2), "{state:?}");
}

#[test]
fn an_acquisition_goes_on_from_its_snapshot() {
    let behaviour = Behaviour::default();
    let mut acquisition = fixture(&behaviour, Some(behaviour.law));
    let mut bed = Testbed::new(behaviour, Faults::default(), 14);
    bed.run(&mut acquisition, 1.0);
    let actions = acquisition.start(request(rows(-8, 10)), bed.now());
    bed.take(actions);
    bed.run(&mut acquisition, 3.0);
    let bytes = postcard::to_stdvec(&acquisition).unwrap();
    let mut restored: Acquisition = postcard::from_bytes(&bytes).unwrap();
    assert!(restored == acquisition, "a snapshot restores the value");
    assert!(bed.run(&mut restored, 60.0).unwrap().complete);
}
