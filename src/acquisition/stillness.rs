//! Whether a tilt that sends no readings moves at all, told by what its laser sees.
//!
//! While the servo law says that the tilt turns, successive lines that agree within the range noise
//! are evidence that it does not. How much evidence depends on what is seen: the range to a surface
//! that stands across the ray does not change to first order. A surface whose perpendicular lies at
//! the tilt `c` is seen at `r(θ) ∝ 1 / cos(θ − c)`, so that for the worst `c` the change over a travel
//! `Δ` is about `Δ²/12`. Only travels over which every surface would have changed visibly are proof;
//! smaller ones are a doubt, where the surface that was in sight before, and an upright one, would
//! have changed. Beams to the side may follow a wall along which the range is the same under all
//! tilts, so only those within about the robot's own width count.
//!
//! Where those see nothing, the floor tells: lines that are all the same, and that would look through
//! it if the tilt had turned, are proof. Short of that such lines are doubted, for nothing vouches for
//! their tilt. What changes while the robot drives says nothing about the tilt.

mod agreement;
mod run;
mod whole;

use crate::scan::LaserLine;
use crate::time::{Span, Stamp};
use agreement::{Agreement, Facing, Seen, agreement, facing};
use run::Run;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use whole::Whole;

/// Watches lines beside the tilts that the servo law gives them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct StillWatch {
    run: Option<Run>,
    /// Lines alike from side to side.
    whole: Option<Whole>,
    /// The newest lines, oldest first.
    recent: VecDeque<Seen>,
    /// What the last two changes say of the surface in sight.
    facings: [Option<Facing>; 2],
    /// The last tilt, by the law, that was seen to be reached.
    reached_rad: Option<f64>,
    /// Lines that should have changed and did not.
    doubted: Vec<Doubt>,
    /// Least and greatest tilt by the law during such a run, where the newest line ended it.
    came_free: Option<(f64, f64)>,
}

/// Lines that should have changed and did not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Doubt {
    /// Casting of the first and of the last of them.
    first: Stamp,
    last: Stamp,
    /// How far the law had the tilt turn meanwhile, in radians: so far it may have fallen behind.
    travel_rad: f64,
}

/// What is expected of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Expected {
    /// Its tilt if the servo law is right, in radians.
    pub tilt_rad: f64,
    /// What the law's times may be wrong by, either way: what it says of less than that after the
    /// first line of a run, and before the last, is not held against the tilt.
    pub unsure: Span,
    /// Least and greatest tilt by the law as far as its times may be wrong.
    pub span_rad: (f64, f64),
    /// Where the law may have had it so long after the line before, by what was commanded since.
    pub before_rad: Option<f64>,
    /// The tilt that looks level.
    pub level_rad: f64,
    /// How high the laser stands above the floor, in metres, where that is known.
    pub height_m: Option<f64>,
    /// Whether the robot stood still since the line before.
    pub stood: bool,
}

impl Expected {
    /// By a law whose times are known.
    #[cfg(test)]
    fn sure(tilt_rad: f64, stood: bool) -> Self {
        let span_rad = (tilt_rad, tilt_rad);
        let unsure = Span::ZERO;
        Self { tilt_rad, unsure, span_rad, before_rad: None, level_rad: 0.0, height_m: None, stood }
    }
}

/// A tilt that does not turn although it was told to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Unmoved {
    /// Lines cast from here on were taken at rest.
    pub since: Stamp,
    /// From here on it may have been slowing down, more than its law says.
    pub slows_from: Stamp,
    /// The last tilt that it was seen to reach.
    pub rest_rad: f64,
    /// Which way it was told to turn: the sign of the angle.
    pub towards: f64,
    /// How far the law says that it should have turned, in radians.
    pub travel_rad: f64,
    /// Lines that agree.
    pub lines: u32,
}

impl Unmoved {
    /// What was found, in words for an operator; `rows` are left out for it.
    pub(super) fn remark(&self, rows: usize) -> String {
        format!(
            "the laser saw the same in {} lines while the tilt should have turned by {:.1}°: it was last \
             seen to turn at {:.2}°, {rows} rows are left out",
            self.lines,
            self.travel_rad.to_degrees(),
            self.rest_rad.to_degrees()
        )
    }
}

/// What rows that are merely doubted are left out with, in words for an operator.
pub(super) fn doubt_remark(rows: usize) -> Option<String> {
    (rows > 0).then(|| {
        format!("{rows} rows are left out: they look alike though the tilt should have turned")
    })
}

/// The proof must last: a command may be obeyed later than the law supposes.
const LASTS: Span = Span::from_millis(1_000);
const LASTING_LINES: u32 = 3;
/// Lines looked back over for the beginning of a run.
const RECENT: usize = 16;
/// Doubted runs kept.
const DOUBTS: usize = 64;

impl StillWatch {
    /// Forgets all lines, as after a jump of the clock.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Begins anew with the newest line, taken to have been cast at `tilt_rad`.
    pub(super) fn restart_at(&mut self, tilt_rad: f64) {
        self.run = None;
        self.close_whole();
        let facing = self.steepest_facing();
        if let Some(seen) = self.recent.back_mut() {
            seen.tilt_rad = tilt_rad;
            seen.span_rad = (tilt_rad, tilt_rad);
            self.reached_rad = Some(tilt_rad);
            let mut run = Run::changed(seen.clone(), facing);
            // It has rested there for long, so that its time is not in doubt.
            run.tilts_rad.push(tilt_rad);
            self.run = Some(run);
        }
    }

    /// Takes in a line cast at `cast`; `None` is expected of it where something better than the law
    /// tells the tilt, or nothing does.
    pub(super) fn note(&mut self, line: &LaserLine, cast: Stamp, expected: Option<&Expected>) {
        self.came_free = None;
        let Some(expected) = expected else {
            self.close_run();
            self.close_whole();
            self.recent.clear();
            return;
        };
        // A line out of order says nothing of what the tilt does now.
        if self.recent.back().is_some_and(|latest| latest.cast >= cast) {
            return;
        }
        self.widen_newest(expected);
        let seen = Seen {
            line: line.clone(),
            cast,
            tilt_rad: expected.tilt_rad,
            span_rad: expected.span_rad,
        };
        if !expected.stood {
            // From elsewhere all looks different, whatever the tilt does.
            self.close_run();
            self.close_whole();
            self.recent.clear();
        }
        let doubt = match &mut self.whole {
            Some(whole) => whole.extend(&seen, &self.recent, expected),
            whole @ None => {
                *whole = Some(Whole::begin(seen.clone(), Vec::new()));
                None
            }
        };
        self.add_doubt(doubt);
        let with_first =
            self.run.as_ref().map_or(Agreement::Unknown, |run| agreement(&run.first.line, line));
        if !self.run.as_mut().is_some_and(|run| run.extend(&seen, with_first, expected)) {
            if with_first == Agreement::Different {
                self.came_free = self.run.as_ref().filter(|run| run.is_doubtful()).map(Run::tilts);
                self.run = self.run.take().filter(|run| !run.is_harmless(seen.tilt_rad));
            }
            self.close_run();
            self.run = Some(match with_first {
                Agreement::Different => self.run_after_change(&seen),
                _ => Run::unchanged(seen.clone(), self.reached_rad),
            });
        }
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(seen);
    }

    /// A command that was sent on the newest line may have been obeyed before it was cast, as far as times
    /// are unsure.
    fn widen_newest(&mut self, expected: &Expected) {
        let (Some(newest), Some(tilt_rad)) = (self.recent.back_mut(), expected.before_rad) else {
            return;
        };
        newest.widen(tilt_rad);
        if let Some(whole) = self.whole.as_mut().filter(|whole| whole.first.cast == newest.cast) {
            whole.first.widen(tilt_rad);
        }
    }

    /// A run that begins with a line which differs from those before it.
    fn run_after_change(&mut self, seen: &Seen) -> Run {
        if let Some(latest) = self.recent.back()
            && let Some(facing) = facing(latest, seen)
        {
            self.facings = [self.facings[1], Some(facing)];
        }
        let mut run = Run::changed(seen.clone(), self.steepest_facing());
        // A slow change may have been over some lines before it was told from the noise. What a tilt has
        // left behind does not come into sight again, so that a line alone that differs is no change.
        let agrees = |earlier: &Seen| {
            let agreement = agreement(&earlier.line, &seen.line);
            matches!(agreement, Agreement::Same { .. } | Agreement::Blind { .. })
        };
        let mut odd = false;
        for earlier in self.recent.iter().rev() {
            let agrees = agrees(earlier);
            if agrees {
                run.since = earlier.cast;
            } else if odd {
                break;
            }
            if agrees || !odd {
                run.before_rad = Some(earlier.tilt_rad);
            }
            odd = !agrees;
        }
        self.reached_rad = run.before_rad.or(self.reached_rad);
        run
    }

    fn steepest_facing(&self) -> Option<Facing> {
        let steeper = |a: &Facing, b: &Facing| a.slope.abs().total_cmp(&b.slope.abs());
        self.facings.iter().flatten().copied().max_by(steeper)
    }

    /// Least and greatest tilt by the law of lines that should have changed and did not, if the newest
    /// line is the first that did.
    pub(super) fn came_free(&self) -> Option<(f64, f64)> {
        self.came_free
    }

    /// The tilt, if by all that is seen it does not turn.
    pub(super) fn unmoved(&self, latency: Span) -> Option<Unmoved> {
        let run = self.run.as_ref()?;
        let (since, lines) = run.proven?;
        let lasts = run.last - since >= LASTS + latency && run.lines - lines >= LASTING_LINES;
        lasts.then(|| Unmoved {
            since: run.since,
            slows_from: run.since,
            rest_rad: run.rest_rad(),
            towards: run.towards(),
            travel_rad: run.travel_rad(),
            lines: run.lines,
        })
    }

    /// Whether what is seen would have changed for any surface, be it only since a moment.
    pub(super) fn suspects(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.proven.is_some())
    }

    /// Whether a line cast later than `stamp` differs from the one before it.
    pub(super) fn changed_since(&self, stamp: Stamp) -> bool {
        self.run.as_ref().is_some_and(|run| run.before_rad.is_some() && run.first.cast > stamp)
    }

    /// Whether the newest lines are alike, and the next will tell whether they should be.
    pub(super) fn is_undecided(&self) -> bool {
        self.whole.as_ref().is_some_and(Whole::is_undecided)
    }

    /// When the newest line was cast.
    pub(super) fn newest(&self) -> Option<Stamp> {
        self.recent.back().map(|seen| seen.cast)
    }

    /// Whether a line cast at `cast`, or within `slowing` after it, belongs to lines that should have
    /// changed and did not, or was cast while the tilt made up for the way by which it had fallen behind,
    /// for which it needs `catches_up`.
    pub(super) fn doubts(
        &self,
        cast: Stamp,
        slowing: Span,
        catches_up: impl Fn(f64) -> Span,
    ) -> bool {
        let run = self.run.as_ref().filter(|run| run.is_doubtful()).map(Run::doubt);
        let open = run.into_iter().chain(self.whole.as_ref().and_then(Whole::open_doubt));
        let within = |doubt: Doubt| {
            doubt.first <= cast + slowing && cast <= doubt.last + catches_up(doubt.travel_rad)
        };
        self.doubted.iter().copied().chain(open).any(within)
    }

    fn close_run(&mut self) {
        let run = self.run.take().filter(Run::is_doubtful);
        self.add_doubt(run.map(|run| run.doubt()));
    }

    fn close_whole(&mut self) {
        let whole = self.whole.take();
        self.add_doubt(whole.and_then(|whole| whole.open_doubt()));
    }

    fn add_doubt(&mut self, doubt: Option<Doubt>) {
        let Some(doubt) = doubt else { return };
        if self.doubted.len() == DOUBTS {
            self.doubted.remove(0);
        }
        self.doubted.push(doubt);
    }
}

#[cfg(test)]
mod tests {
    use super::super::testbed::{World, head, line_at};
    use super::*;
    use crate::robot::HeadPose;
    use proptest::prelude::*;

    /// Lines every 0.2 s: what is seen at one tilt, what the law says in the other, in degrees.
    fn watched(world: &World, tilts_deg: &[(f64, f64)]) -> StillWatch {
        let mut watch = StillWatch::default();
        for (i, &(truth, law)) in tilts_deg.iter().enumerate() {
            let noise = 1.0 + 1e-4 * (i as f64 * 12.9898).sin();
            let pose = HeadPose::tilted(truth.to_radians());
            let mut line = line_at(world, &head(None, None), pose, noise);
            for (beam, range) in line.ranges_m.iter_mut().enumerate() {
                *range *= 1.0 + 9e-4 * ((7 * i + 13 * beam) as f64 * 78.233).sin();
            }
            let cast = Stamp::from_seconds(100.0 + 0.2 * i as f64);
            line.stamp = cast;
            let height_m = Some(0.33 - world.ground_z);
            let tilt_rad = law.to_radians();
            let expected = Expected { height_m, ..Expected::sure(tilt_rad, true) };
            watch.note(&line, cast, Some(&expected));
        }
        watch
    }

    fn steps(from_deg: f64, step_deg: f64, count: usize) -> impl Iterator<Item = f64> {
        (0..count).map(move |i| from_deg + step_deg * i as f64)
    }

    #[test]
    fn a_tilt_that_stops_is_found_out_where_it_stopped() {
        let moves = steps(-5.0, 0.5, 20).map(|tilt| (tilt, tilt));
        let stops = steps(5.0, 0.5, 40).map(|tilt| (4.6, tilt));
        let watch = watched(&World::default(), &moves.chain(stops).collect::<Vec<_>>());
        let unmoved = watch.unmoved(Span::ZERO).unwrap();
        // Where it stopped, or short of it, never beyond. Of an upright wall the range changes by a
        // quarter of a percent from 2.5° to 4.6°, which three beams do not tell from noise.
        assert!((1.5..=4.6).contains(&unmoved.rest_rad.to_degrees()), "{unmoved:?}");
        assert!(unmoved.towards > 0.0 && unmoved.since >= Stamp::from_seconds(102.5));
        assert!(
            watch.doubts(unmoved.since, Span::ZERO, |_| Span::ZERO)
                && !watch.doubts(Stamp::from_seconds(102.3), Span::ZERO, |_| Span::ZERO)
        );
    }

    #[test]
    fn a_tilt_that_stops_over_ground_is_found_out_to_half_a_degree() {
        let moves = steps(6.0, 0.25, 40).map(|tilt| (tilt, tilt));
        let stops = steps(16.0, 0.25, 90).map(|tilt| (16.0, tilt));
        let watch = watched(&World::default(), &moves.chain(stops).collect::<Vec<_>>());
        let rest_deg = watch.unmoved(Span::ZERO).unwrap().rest_rad.to_degrees();
        assert!((15.5..=16.0).contains(&rest_deg), "{rest_deg}");
    }

    #[test]
    fn something_that_passes_by_a_tilt_at_rest_is_no_turn() {
        let moves = steps(6.0, 0.25, 40).map(|tilt| (tilt, tilt));
        let stops = steps(16.0, 0.25, 90).enumerate();
        let stops = stops.map(|(i, tilt)| (if i == 5 { 17.0 } else { 16.0 }, tilt));
        let watch = watched(&World::default(), &moves.chain(stops).collect::<Vec<_>>());
        let rest_deg = watch.unmoved(Span::ZERO).unwrap().rest_rad.to_degrees();
        assert!((15.5..=16.0).contains(&rest_deg), "{rest_deg}");
    }

    #[test]
    fn a_limit_met_on_a_jump_is_not_taken_for_one_on_the_way_back() {
        // Told from 10° to 30° within two lines, met a limit at 17°, and then was told back in steps.
        let jump = [(10.0, 10.0), (10.0, 10.0), (15.0, 25.0), (17.0, 30.0)];
        let back = steps(30.0, -0.25, 52).map(|tilt| (17.0, tilt));
        let watch = watched(&World::default(), &jump.into_iter().chain(back).collect::<Vec<_>>());
        let unmoved = watch.unmoved(Span::ZERO).unwrap();
        assert!(unmoved.towards > 0.0, "{unmoved:?}");
    }

    #[test]
    fn the_last_rows_of_a_tilt_that_stops_over_ground_are_doubted() {
        let moves = steps(10.0, 0.25, 40).map(|tilt| (tilt, tilt));
        let stops = steps(20.0, 0.25, 6).map(|tilt| (20.0, tilt));
        let watch = watched(&World::default(), &moves.chain(stops).collect::<Vec<_>>());
        assert_eq!(watch.unmoved(Span::ZERO), None, "five quarters of a degree prove nothing");
        let doubted: Vec<bool> = (0..46)
            .map(|i| {
                watch.doubts(Stamp::from_seconds(100.0 + 0.2 * f64::from(i)), Span::ZERO, |_| {
                    Span::ZERO
                })
            })
            .collect();
        assert!(doubted[..40].iter().all(|doubted| !doubted), "{doubted:?}");
        assert!(doubted[40..].iter().all(|&doubted| doubted), "{doubted:?}");
    }

    #[test]
    fn an_empty_view_and_a_corridor_tell_nothing() {
        let law: Vec<(f64, f64)> = steps(-20.0, 1.0, 40).map(|tilt| (0.0, tilt)).collect();
        let nothing = World { ground_z: -100.0, ceiling_z: 100.0, room: [100.0, 100.0] };
        let corridor = World { room: [100.0, 1.2], ..World::default() };
        for world in [nothing, corridor] {
            let watch = watched(&world, &law);
            assert!(watch.unmoved(Span::ZERO).is_none() && !watch.suspects());
        }
    }

    #[test]
    fn a_tilt_stuck_in_an_empty_hall_is_found_out_where_the_floor_should_be_seen() {
        // Walls to both sides, nothing ahead within the laser's reach; told from -20° to 30°.
        let hall = World { ground_z: -0.15, ceiling_z: 100.0, room: [100.0, 2.0] };
        let down: Vec<(f64, f64)> = steps(-20.0, 0.5, 100).map(|tilt| (0.0, tilt)).collect();
        let watch = watched(&hall, &down);
        assert!(watch.unmoved(Span::ZERO).is_some());
        // Upwards nothing tells, so that none of it is believed.
        let up: Vec<(f64, f64)> = steps(-25.0, 0.5, 50).map(|tilt| (0.0, tilt)).collect();
        let watch = watched(&hall, &up);
        assert_eq!(watch.unmoved(Span::ZERO), None);
        assert!(watch.doubts(Stamp::from_seconds(105.0), Span::ZERO, |_| Span::ZERO));
        // One that does turn sees the floor come and go.
        let moving: Vec<(f64, f64)> = steps(0.0, 0.5, 60).map(|tilt| (tilt, tilt)).collect();
        let watch = watched(&hall, &moving);
        assert!(
            !watch.suspects()
                && !watch.doubts(Stamp::from_seconds(109.0), Span::ZERO, |_| Span::ZERO)
        );
    }

    #[test]
    fn what_changes_because_the_robot_drives_is_no_turn_of_the_tilt() {
        let mut watch = StillWatch::default();
        let expected = Expected::sure;
        let line = |tilt_rad| {
            line_at(&World::default(), &head(None, None), HeadPose::tilted(tilt_rad), 1.0)
        };
        let mut at = 100.0;
        let mut note = |line: &LaserLine, expected: &Expected| {
            at += 0.2;
            watch.note(line, Stamp::from_seconds(at), Some(expected));
        };
        for i in 0..6 {
            let tilt_rad = 0.25 + 0.01 * f64::from(i);
            note(&line(tilt_rad), &expected(tilt_rad, true));
        }
        // Told to turn on from 0.3 to 0.5 while it drives; then it stands, and is told back.
        for i in 0..20 {
            note(&line(0.3), &expected(0.3 + 0.01 * f64::from(i), false));
        }
        for i in 0..50 {
            note(&line(0.3), &expected(0.5 - 0.006 * f64::from(i), true));
        }
        let unmoved = watch.unmoved(Span::ZERO).unwrap();
        assert!(unmoved.rest_rad < 0.31 && unmoved.towards > 0.0, "{unmoved:?}");
    }

    #[test]
    fn a_jump_from_one_side_of_level_to_the_other_sees_the_same_wall() {
        let jump = [(-8.0, -8.0), (8.0, 8.0), (8.0, 8.0), (8.0, 8.0), (8.0, 8.0), (8.0, 8.0)];
        let far = World { ground_z: -9.0, ceiling_z: 9.0, room: [6.0, 40.0] };
        let again: Vec<_> = jump.iter().cycle().take(36).copied().collect();
        assert!(!watched(&far, &again).suspects());
    }

    #[test]
    fn a_near_wall_seen_by_a_laser_above_the_axle_is_no_sign_of_a_stuck_tilt() {
        // The laser comes forward as it tilts down, so that the nearest tilt is not the level one.
        let near = World { ground_z: -0.1, ceiling_z: 1.0, room: [2.070, 4.621] };
        let moving: Vec<_> = steps(-22.06, 0.5, 60).map(|tilt| (tilt, tilt)).collect();
        let watch = watched(&near, &moving);
        let rows = (0..60).map(|i| Stamp::from_seconds(100.0 + 0.2 * f64::from(i)));
        let doubted: Vec<Stamp> =
            rows.filter(|&row| watch.doubts(row, Span::ZERO, |_| Span::ZERO)).collect();
        assert_eq!(doubted, []);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn no_room_makes_a_moving_tilt_look_stuck(
            front in 0.8..18.0f64, side in 0.45..9.0f64, ceiling in 1.0..9.0f64, ground in 0.1..2.0f64,
            from in -30.0..30.0f64, step in prop::sample::select(vec![-2.0, -0.5, -0.25, 0.25, 0.5, 2.0])
        ) {
            let world = World { ground_z: -ground, ceiling_z: ceiling, room: [front, side] };
            let tilts: Vec<_> = steps(from, step, 60).map(|t| (t, t)).take_while(|t| t.0.abs() < 60.0).collect();
            let watch = watched(&world, &tilts);
            prop_assert!(!watch.suspects());
            // Farther away fewer than three of these beams, 3° apart, hit what is straight ahead, nor do they up to
            // the far corners of a room so narrow that those beside the middle one hit its sides before.
            let farthest = front.hypot(ceiling.max(ground));
            let sees_ahead = front < 6.5 && farthest * 3_f64.to_radians().tan() < side;
            let doubted = (0..tilts.len() * usize::from(sees_ahead))
                .filter(|&i| watch.doubts(Stamp::from_seconds(100.0 + 0.2 * i as f64), Span::ZERO, |_| Span::ZERO))
                .count();
            prop_assert_eq!(doubted, 0);
        }
    }
}
