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
    /// By how much the law misses the next reading, in radians, as far as that matters here: most half
    /// way between two readings, nothing at them.
    pub miss_rad: f64,
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
/// What a reading errs by besides the steps it is printed in.
const READING_SIGMA_RAD: f64 = 1e-4;
/// Standard deviation of the time at which a command is obeyed, and most of it: frames of a server.
const OBEYED_SIGMA_S: f64 = 0.01;
const MOST_SHIFT_S: f64 = 0.04;
/// Steps of the search for that time, and over what its slope is told.
const DATING_STEPS: usize = 3;
const SLOPE_STEP_S: f64 = 1e-3;
/// A shift that leaves more of a miss than this does not explain it.
const EXPLAINED: f64 = 0.5;
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
        if at + 1 == self.readings.len() {
            self.date_commands();
        }
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
        let (state, miss_rad) = match (before, next) {
            (Some(a), Some(b)) => self.between(a, b, stamp),
            (Some(a), None) => (self.run_on(a, stamp)?, 0.0),
            (None, Some(b)) if self.law.is_none() => (ServoState::at_rest(b.angle_rad), 0.0),
            (None, _) => {
                self.law?;
                (self.modelled(stamp), 0.0)
            }
        };
        let ServoState { angle_rad, rate_rad_s } = state;
        Some(AxisEstimate { angle_rad, rate_rad_s, support, miss_rad })
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

    /// The state between two readings, and what of the law's miss of the second matters there.
    fn between(&self, a: &AxisReading, b: &AxisReading, stamp: Stamp) -> (ServoState, f64) {
        let whole = (b.stamp - a.stamp).seconds().max(1e-9);
        let share = (stamp - a.stamp).seconds() / whole;
        let way = b.angle_rad - a.angle_rad;
        let straight = ServoState { angle_rad: a.angle_rad + share * way, rate_rad_s: way / whole };
        if self.law.is_none() {
            return (straight, 0.0);
        }
        let start = self.state_at_reading(a);
        let miss = b.angle_rad - self.propagate(start, a.stamp, b.stamp).angle_rad;
        let matters = 4.0 * share * (1.0 - share) * miss;
        // A law that misses by much of the way was given commands at the wrong times: its curve is
        // worth less than the straight line.
        if miss.abs() > (MISSED_SHARE * way.abs()).max(a.half_width_rad + b.half_width_rad) {
            return (straight, matters);
        }
        let here = self.propagate(start, a.stamp, stamp);
        let angle_rad = here.angle_rad + share * miss;
        (ServoState { angle_rad, rate_rad_s: here.rate_rad_s + miss / whole }, matters)
    }

    /// Takes the commands between the two newest readings to have been obeyed when the law, run on from
    /// the first, meets the second. Servers obey at the next of their frames, which nothing but the
    /// joint's way tells; a spring that was pushed 10 ms sooner than thought is elsewhere by much more
    /// than a reading errs.
    fn date_commands(&mut self) {
        let [.., a, b] = self.readings[..] else { return };
        let first = self.commands.partition_point(|&(stamp, _)| stamp <= a.stamp);
        let end = self.commands.partition_point(|&(stamp, _)| stamp < b.stamp);
        if self.law.is_none() || first >= end {
            return;
        }
        let start = self.state_at_reading(&a);
        let told: Vec<Stamp> = self.commands[first..end].iter().map(|&(stamp, _)| stamp).collect();
        let earliest = first.checked_sub(1).map(|before| self.commands[before].0);
        let latest = self.commands.get(end).map(|&(stamp, _)| stamp);
        let mut miss_at = |shift_s: f64| {
            for (command, &told) in self.commands[first..end].iter_mut().zip(&told) {
                let stamp = told + Span::from_seconds(shift_s);
                let stamp = earliest.map_or(stamp, |earliest| stamp.max(earliest));
                command.0 = latest.map_or(stamp, |latest| stamp.min(latest));
            }
            b.angle_rad - self.propagate(start, a.stamp, b.stamp).angle_rad
        };
        let unshifted = miss_at(0.0);
        let (mut shift_s, mut miss) = (0.0, unshifted);
        let sigma_rad = READING_SIGMA_RAD + a.half_width_rad + b.half_width_rad;
        for _ in 0..DATING_STEPS {
            let slope = (miss - miss_at(shift_s + SLOPE_STEP_S)) / SLOPE_STEP_S;
            // The most likely shift, by the reading and by what commands are early or late as a rule.
            let weight = slope / (slope * slope + (sigma_rad / OBEYED_SIGMA_S).powi(2));
            shift_s = (weight * (miss + slope * shift_s)).clamp(-MOST_SHIFT_S, MOST_SHIFT_S);
            miss = miss_at(shift_s);
        }
        if miss.abs() > EXPLAINED * unshifted.abs() {
            miss_at(0.0);
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

    #[test]
    fn commands_are_dated_by_what_the_joint_did() {
        let law = ServoLaw::Spring { frequency_rad_s: 16.5, damping: 0.6 };
        let mut truth = AxisTrack::new(Some(law), None, 0.0);
        let mut told = truth.clone();
        let mut worst = [0.0_f64; 2];
        let mut blind = told.clone();
        for k in 0..40 {
            let t = 0.2 * f64::from(k);
            // Obeyed up to 15 ms before or after it is thought to be, sweeping up and down.
            let jitter = 0.015 * f64::from((k * 7) % 11 - 5) / 5.0;
            let demand = Demand::Angle(0.3 * (0.4 * f64::from(k)).sin());
            truth.demand(s(t + 0.03 + jitter), demand);
            told.demand(s(t + 0.03), demand);
            blind.demand(s(t + 0.03), demand);
            for read_at in [t + 0.06, t + 0.16] {
                told.read(reading(read_at, truth.estimate(s(read_at)).unwrap().angle_rad));
            }
        }
        for k in 3..79 {
            let at = s(0.1 * f64::from(k) + 0.01);
            let angle_rad = truth.estimate(at).unwrap().angle_rad;
            for (worst, track) in worst.iter_mut().zip([&told, &blind]) {
                let estimate = track.estimate(at).unwrap();
                *worst = worst.max((estimate.angle_rad - angle_rad).abs());
            }
            let estimate = told.estimate(at).unwrap();
            let sigma = 2e-4_f64.hypot(estimate.miss_rad);
            assert!((estimate.angle_rad - angle_rad).abs() < 3.0 * sigma, "{k}: {estimate:?}");
        }
        assert!(worst[0] < 6e-4 && worst[1] > 8e-3, "{worst:?}");
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
