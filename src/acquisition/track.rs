use super::servo::{ServoLaw, ServoState};
use crate::geometry::AngleSpan;
use crate::robot::Demand;
use crate::time::{Span, Stamp};
use serde::{Deserialize, Serialize};

/// A joint's own report of where it was.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisReading {
    /// When, by the server's stamp.
    pub stamp: Stamp,
    /// Core angle in radians.
    pub angle_rad: f64,
    /// The true angle lies within this of it: servers cut and quantise what they print.
    pub half_width_rad: f64,
}

/// Where a joint was, as far as commands, servo law and readings tell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisEstimate {
    /// Core angle in radians.
    pub angle_rad: f64,
    /// Rate in radians per second.
    pub rate_rad_s: f64,
    /// Time to the nearest reading that supports it; `None` if the model alone gave it.
    pub support: Option<Span>,
}

/// What the readings say about a joint that ought to rest at its target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Verdict {
    /// A reading of that time shows the joint at its target.
    Confirmed,
    /// A reading of that time shows it elsewhere.
    Contradicted {
        /// The angle read, in radians.
        angle_rad: f64,
    },
    /// There is no reading of that time.
    Unverified,
}

/// One joint over time: what it was told, and what it reported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisTrack {
    law: Option<ServoLaw>,
    limits: Option<AngleSpan>,
    /// State of the model before the first command kept.
    start: ServoState,
    commands: Vec<(Stamp, Demand)>,
    readings: Vec<AxisReading>,
}

/// Commands and readings older than this are folded into the start: longer than any sweep.
const KEPT: Span = Span::from_millis(300_000);
/// Share of the way between two readings by which the law may miss the second.
const MISSED_SHARE: f64 = 0.3;
/// Folding is done in batches, so that a reading costs no shifting of the whole list.
const FOLD_AT: usize = 4_096;

impl AxisTrack {
    /// A joint at rest at `angle_rad`, following `law` where one is known, between `limits`.
    pub fn new(law: Option<ServoLaw>, limits: Option<AngleSpan>, angle_rad: f64) -> Self {
        let start = ServoState::at_rest(angle_rad);
        Self { law, limits, start, commands: Vec::new(), readings: Vec::new() }
    }

    /// The servo law in use.
    pub fn law(&self) -> Option<ServoLaw> {
        self.law
    }

    /// Replaces the servo law, as after an identification; past and future follow the new one.
    pub fn set_law(&mut self, law: ServoLaw) {
        self.law = Some(law);
    }

    /// The angles that the joint reaches, as far as is known.
    pub fn limits(&self) -> Option<AngleSpan> {
        self.limits
    }

    /// Takes over what the joint was found to reach. With `rests_rad` it is taken to rest there now,
    /// whatever it was told before; without, its readings tell where it is.
    pub fn limit(&mut self, limits: Option<AngleSpan>, rests_rad: Option<f64>) {
        self.limits = limits;
        if let Some(angle_rad) = rests_rad {
            self.start = ServoState::at_rest(angle_rad);
            self.commands.clear();
        }
        for at in 0..self.commands.len() {
            self.commands[at].1 = self.clamped(self.commands[at].1);
        }
    }

    /// Takes note of a demand in force from `stamp` on. A demand earlier than one already noted
    /// counts from the later of the two: commands are obeyed in order.
    pub fn demand(&mut self, stamp: Stamp, demand: Demand) {
        let stamp = self.commands.last().map_or(stamp, |&(last, _)| last.max(stamp));
        self.commands.push((stamp, self.clamped(demand)));
        if self.commands.len() > FOLD_AT {
            self.fold(stamp - KEPT);
        }
    }

    /// Takes note of a reading, in whatever order readings arrive.
    pub fn read(&mut self, reading: AxisReading) {
        let at = self.readings.partition_point(|r| r.stamp <= reading.stamp);
        self.readings.insert(at, reading);
        if self.readings.len() > FOLD_AT {
            let before = reading.stamp - KEPT;
            self.readings.retain(|r| r.stamp >= before);
        }
    }

    /// Forgets all commands and readings, as after a jump of the server's clock; the joint is taken
    /// to rest where the model or the last reading left it.
    pub fn forget_times(&mut self) {
        let last = self.commands.last().map_or(Stamp(i64::MIN), |&(stamp, _)| stamp);
        let settled = match self.readings.last() {
            Some(reading) => reading.angle_rad,
            None => self.target_rad().unwrap_or_else(|| self.modelled(last).angle_rad),
        };
        self.start = ServoState::at_rest(settled);
        self.commands.clear();
        self.readings.clear();
    }

    /// The angle last demanded, if the last demand was an angle; the start if there was none.
    pub fn target_rad(&self) -> Option<f64> {
        match self.commands.last() {
            None => Some(self.start.angle_rad),
            Some(&(_, Demand::Angle(angle))) => Some(angle),
            Some(&(_, Demand::Rate(_))) => None,
        }
    }

    /// The stamp of the newest reading.
    pub fn last_reading(&self) -> Option<&AxisReading> {
        self.readings.last()
    }

    /// The readings kept, in order of their stamps.
    pub fn readings(&self) -> &[AxisReading] {
        &self.readings
    }

    /// The commands kept, with the stamps from which on they are in force.
    pub fn commands(&self) -> &[(Stamp, Demand)] {
        &self.commands
    }

    /// Where the joint was at `stamp`.
    ///
    /// Between two readings the servo law draws the curve and its miss of the second is spread
    /// evenly over the time between; after the last reading the law runs on from it. Without a law
    /// the readings are joined by straight lines. `None` if neither law nor reading says anything.
    pub fn estimate(&self, stamp: Stamp) -> Option<AxisEstimate> {
        let after = self.readings.partition_point(|r| r.stamp <= stamp);
        let before = after.checked_sub(1).map(|i| &self.readings[i]);
        let next = self.readings.get(after);
        let support = [before, next]
            .into_iter()
            .flatten()
            .map(|r| if r.stamp > stamp { r.stamp - stamp } else { stamp - r.stamp })
            .min();
        let state = match (before, next) {
            (Some(a), Some(b)) => self.between(a, b, stamp),
            (Some(a), None) => self.run_on(a, stamp)?,
            (None, Some(b)) if self.law.is_none() => ServoState::at_rest(b.angle_rad),
            (None, _) => {
                self.law?;
                self.modelled(stamp)
            }
        };
        Some(AxisEstimate { angle_rad: state.angle_rad, rate_rad_s: state.rate_rad_s, support })
    }

    /// How far the joint can still be from `target_rad` at `stamp`, in radians: the estimate's
    /// distance, or without any knowledge the whole span of the link.
    pub fn error_bound_rad(&self, target_rad: f64, stamp: Stamp) -> f64 {
        let estimate = self.estimate(stamp).map(|e| (e.angle_rad - target_rad).abs());
        let width = self.limits.map_or(std::f64::consts::PI, |l| l.max_rad - l.min_rad);
        estimate.unwrap_or(width)
    }

    /// Whether the readings of the time from `settled` to `until` show the joint at `target_rad`.
    ///
    /// The last of those readings decides. A reading agrees when its interval of quantisation meets
    /// the tolerance.
    pub fn verdict(
        &self,
        target_rad: f64,
        tolerance_rad: f64,
        settled: Stamp,
        until: Stamp,
    ) -> Verdict {
        let end = self.readings.partition_point(|r| r.stamp <= until);
        match end.checked_sub(1).map(|i| &self.readings[i]).filter(|r| r.stamp >= settled) {
            None => Verdict::Unverified,
            Some(r) if agrees(r, target_rad, tolerance_rad) => Verdict::Confirmed,
            Some(r) => Verdict::Contradicted { angle_rad: r.angle_rad },
        }
    }

    /// Whether a joint of unknown law is seen to rest: the readings from `since` to `until` end in at
    /// least `count` that agree with `target_rad` and span at least `span`. One alone may have caught
    /// a swinging joint on its way through.
    pub fn rests(
        &self,
        target_rad: f64,
        tolerance_rad: f64,
        (since, until): (Stamp, Stamp),
        (count, span): (usize, Span),
    ) -> bool {
        let begin = self.readings.partition_point(|r| r.stamp < since);
        let end = self.readings.partition_point(|r| r.stamp <= until).max(begin);
        let read = &self.readings[begin..end];
        let agreeing =
            read.iter().rev().take_while(|r| agrees(r, target_rad, tolerance_rad)).count();
        let resting = &read[read.len() - agreeing..];
        match (resting.first(), resting.last()) {
            (Some(first), Some(last)) => agreeing >= count && last.stamp - first.stamp >= span,
            _ => false,
        }
    }

    /// Whether the readings up to `latest` show the joint moving: the newest, if it is fresh, differs
    /// from the one at least a burst or two before it.
    pub fn moves(&self, latest: Option<Stamp>) -> bool {
        const FRESH: Span = Span::from_millis(1_000);
        const APART: Span = Span::from_millis(350);
        let (Some(newest), Some(latest)) = (self.readings.last(), latest) else { return false };
        let earlier = self.readings.iter().rev().find(|r| newest.stamp - r.stamp >= APART);
        latest - newest.stamp <= FRESH
            && earlier.is_some_and(|r| {
                let resolution = r.half_width_rad + newest.half_width_rad;
                (r.angle_rad - newest.angle_rad).abs() > resolution
            })
    }

    fn clamped(&self, demand: Demand) -> Demand {
        match (demand, self.limits) {
            (Demand::Angle(angle), Some(limits)) => Demand::Angle(limits.clamp(angle)),
            _ => demand,
        }
    }

    /// The model alone, from the start through all commands.
    fn modelled(&self, stamp: Stamp) -> ServoState {
        let Some(&(first, _)) = self.commands.first() else { return self.start };
        self.propagate(self.start, first, stamp)
    }

    /// The state at `to`, given the state at `from`, under the commands in force between.
    fn propagate(&self, state: ServoState, from: Stamp, to: Stamp) -> ServoState {
        let Some(law) = self.law else { return state };
        let first = self.commands.partition_point(|&(stamp, _)| stamp <= from);
        let mut state = state;
        let mut at = from;
        let mut demand = first.checked_sub(1).map(|i| self.commands[i].1);
        for &(stamp, next) in self.commands[first..].iter().take_while(|&&(stamp, _)| stamp < to) {
            state = self.step(law, state, demand, stamp - at);
            (at, demand) = (stamp, Some(next));
        }
        // Over no time at all the angle stays and the rate becomes the law's.
        if to >= at { self.step(law, state, demand, to - at) } else { state }
    }

    fn step(
        &self,
        law: ServoLaw,
        state: ServoState,
        demand: Option<Demand>,
        dt: Span,
    ) -> ServoState {
        let Some(demand) = demand else { return state };
        let moved = law.advance(state, demand, dt.seconds());
        match self.limits {
            Some(limits) if !limits.contains(moved.angle_rad) => {
                ServoState::at_rest(limits.clamp(moved.angle_rad))
            }
            _ => moved,
        }
    }

    fn between(&self, a: &AxisReading, b: &AxisReading, stamp: Stamp) -> ServoState {
        let share = (stamp - a.stamp).seconds() / (b.stamp - a.stamp).seconds().max(1e-9);
        if self.law.is_none() {
            let slope = (b.angle_rad - a.angle_rad) / (b.stamp - a.stamp).seconds().max(1e-9);
            let angle_rad = a.angle_rad + share * (b.angle_rad - a.angle_rad);
            return ServoState { angle_rad, rate_rad_s: slope };
        }
        let start = self.state_at_reading(a);
        let miss = b.angle_rad - self.propagate(start, a.stamp, b.stamp).angle_rad;
        // A law that misses by much of the way was given commands at the wrong times: its curve is
        // worth less than the straight line.
        let way = (b.angle_rad - a.angle_rad).abs();
        if miss.abs() > (MISSED_SHARE * way).max(a.half_width_rad + b.half_width_rad) {
            let rate_rad_s = (b.angle_rad - a.angle_rad) / (b.stamp - a.stamp).seconds().max(1e-9);
            let angle_rad = a.angle_rad + share * (b.angle_rad - a.angle_rad);
            return ServoState { angle_rad, rate_rad_s };
        }
        let here = self.propagate(start, a.stamp, stamp);
        let rate_of_miss = miss / (b.stamp - a.stamp).seconds().max(1e-9);
        ServoState {
            angle_rad: here.angle_rad + share * miss,
            rate_rad_s: here.rate_rad_s + rate_of_miss,
        }
    }

    fn run_on(&self, a: &AxisReading, stamp: Stamp) -> Option<ServoState> {
        if self.law.is_some() {
            return Some(self.propagate(self.state_at_reading(a), a.stamp, stamp));
        }
        // Without a law a command in force after the reading may have moved the joint anywhere.
        let told_since = self.commands.last().is_some_and(|&(told, _)| told > a.stamp);
        (!told_since).then(|| ServoState::at_rest(a.angle_rad))
    }

    /// A reading gives the angle; the rate, which only a spring carries on, is the model's.
    fn state_at_reading(&self, reading: &AxisReading) -> ServoState {
        let rate_rad_s = match self.law {
            Some(ServoLaw::Spring { .. }) => self.modelled(reading.stamp).rate_rad_s,
            Some(ServoLaw::Hinge { .. }) | None => 0.0,
        };
        ServoState { angle_rad: reading.angle_rad, rate_rad_s }
    }

    fn fold(&mut self, before: Stamp) {
        let keep_from = self.commands.partition_point(|&(stamp, _)| stamp < before);
        if let Some(&(stamp, _)) = self.commands.get(keep_from) {
            self.start = self.modelled(stamp);
            self.commands.drain(..keep_from);
        }
    }
}

fn agrees(reading: &AxisReading, target_rad: f64, tolerance_rad: f64) -> bool {
    (reading.angle_rad - target_rad).abs() <= tolerance_rad + reading.half_width_rad
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn s(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    fn reading(seconds: f64, angle_rad: f64) -> AxisReading {
        AxisReading { stamp: s(seconds), angle_rad, half_width_rad: 1e-4 }
    }

    #[test]
    fn late_and_disordered_readings_are_sorted_by_their_stamps() {
        let mut track = AxisTrack::new(None, None, 0.0);
        for t in [1.0, 0.4, 0.8, 0.6] {
            track.read(reading(t, t));
        }
        let estimate = track.estimate(s(0.7)).unwrap();
        assert!((estimate.angle_rad - 0.7).abs() < 1e-12);
        assert_eq!(track.last_reading().map(|r| r.stamp), Some(s(1.0)));
    }

    #[test]
    fn without_law_and_reading_nothing_is_claimed() {
        let mut track = AxisTrack::new(None, None, 0.0);
        assert_eq!(track.estimate(s(1.0)), None);
        track.read(reading(1.0, 0.1));
        track.demand(s(1.1), Demand::Angle(0.5));
        assert_eq!(track.estimate(s(2.0)), None, "the command may have moved it anywhere");
    }

    #[test]
    fn a_demand_beyond_the_limit_is_modelled_at_the_limit() {
        let limits = AngleSpan::new(-0.2, 0.2);
        let mut track = AxisTrack::new(Some(ServoLaw::hinge(1.0)), Some(limits), 0.0);
        track.demand(s(0.0), Demand::Angle(0.5));
        assert!((track.estimate(s(5.0)).unwrap().angle_rad - 0.2).abs() < 1e-9);
        track.demand(s(5.0), Demand::Rate(-1.0));
        assert_eq!(track.estimate(s(9.0)).unwrap().angle_rad, -0.2);
    }

    #[test]
    fn the_last_reading_before_the_line_decides() {
        let mut track = AxisTrack::new(None, None, 0.0);
        track.read(reading(1.0, 0.05));
        track.read(reading(1.2, 0.1));
        let verdict = |until| track.verdict(0.1, 1e-3, s(0.9), s(until));
        assert_eq!(verdict(1.1), Verdict::Contradicted { angle_rad: 0.05 });
        assert_eq!(verdict(1.3), Verdict::Confirmed);
        assert_eq!(verdict(0.95), Verdict::Unverified);
        let rests = |until, count| track.rests(0.1, 1e-3, (s(0.0), s(until)), (count, Span::ZERO));
        assert!(rests(2.0, 1) && !rests(2.0, 2));
        assert!(!rests(0.5, 1), "no reading so early");
    }

    proptest! {
        #[test]
        fn the_model_follows_the_servo_through_many_commands(
            steps in prop::collection::vec((0.05..0.4f64, -0.3..0.3f64), 1..12), ask in 0.0..4.0f64,
            read_every in prop::option::of(0.1..0.3f64)
        ) {
            let law = ServoLaw::hinge(0.17);
            let mut track = AxisTrack::new(Some(law), None, 0.0);
            let mut truth = vec![(0.0, ServoState::default(), Demand::Angle(0.0))];
            let mut t = 0.0;
            for (pause, target) in steps {
                let &(since, state, demand) = truth.last().unwrap();
                t += pause;
                truth.push((t, law.advance(state, demand, t - since), Demand::Angle(target)));
                track.demand(s(t), Demand::Angle(target));
            }
            let at = |time: f64| {
                let &(since, state, demand) = truth.iter().rev().find(|row| row.0 <= time).unwrap();
                law.advance(state, demand, time - since).angle_rad
            };
            if let Some(every) = read_every {
                for i in 0..12 {
                    let time = f64::from(i) * every;
                    track.read(reading(time, at(time)));
                }
            }
            prop_assert!((track.estimate(s(ask)).unwrap().angle_rad - at(ask)).abs() < 1e-6);
        }
    }
}
