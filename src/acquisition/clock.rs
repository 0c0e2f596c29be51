use super::punctuality::{Punctuality, Timeliness};
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// What a stamped message told about the simulator's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClockStep {
    /// The clock ran on as expected.
    Steady,
    /// The clock jumped by this much against the session's: what was known of it is void.
    Jumped(Span),
}

/// The map between the session's clock and the simulator's, kept so that it errs to the safe side.
///
/// A message stamped `s` that arrived at `a` proves that the simulator's clock stood at `s` or later
/// at `a`; how much later, by the latency of the line, it does not say. So each message gives a lower
/// bound, the best of the recent ones is kept, and an upper bound adds the configured latency.
/// The simulator may run faster or slower than the session (`usar sim --speed`, an overloaded
/// server), so the rate between the clocks is measured over the same window.
///
/// The scanner's stamps do not belong here: in UT2004 they lag a burst (protocol 6.1).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StampClock {
    window: VecDeque<(Arrival, Stamp)>,
    latest: Option<Stamp>,
    punctuality: Punctuality,
    /// Simulated seconds per session second, once measured.
    rate: Option<f64>,
}

/// Messages older than this say nothing about the present rate of an overloaded server.
const WINDOW: Span = Span::from_millis(5_000);
/// Bound on the number of messages in the window: ten a second for each of six kinds.
const WINDOW_MESSAGES: usize = 300;
/// Messages closer together than this arrived in one go: bursts are farther apart.
const TOGETHER: Span = Span::from_millis(20);
/// A shorter window measures arrival jitter, not the rate.
const RATE_BASELINE: Span = Span::from_millis(2_500);
/// Messages farther apart than this were held up; a server that is slowed down to a third still sends
/// more often.
const RATE_GAP: Span = Span::from_millis(1_500);
/// Rates this close to 1 are jitter.
const RATE_SNAP: f64 = 0.05;
/// A message this far ahead of the expected stamp, or behind the latest one, is a jump of the clock
/// and not a late line.
const JUMP: Span = Span::from_millis(3_000);

impl StampClock {
    /// A clock about which nothing is known yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes note of a message stamped `stamp` that arrived `now`.
    pub fn observe(&mut self, stamp: Stamp, now: Arrival) -> ClockStep {
        let mut step = ClockStep::Steady;
        if let (Some(latest), Some(expected)) = (self.latest, self.earliest(now))
            && (stamp - expected > JUMP || latest - stamp > JUMP)
        {
            step = ClockStep::Jumped(stamp - expected);
            self.window.clear();
            self.latest = None;
            self.rate = None;
            self.punctuality = Punctuality::default();
        }
        // A message that was held up tells nothing, and as the last of the window it would slow the
        // rate between the clocks.
        if self.latest.is_some_and(|latest| stamp < latest) {
            return step;
        }
        self.latest = Some(stamp);
        match self.punctuality.note(stamp, now, self.rate) {
            // As the first or last of the window it would be taken for another rate.
            Timeliness::Late => return step,
            Timeliness::LateAsARule { rate } => {
                self.window.clear();
                self.rate = Some(rate);
            }
            Timeliness::InTime => {}
        }
        // Of messages that arrive together the newest alone tells anything: the others were held up.
        let held_up =
            |&(arrival, sent): &(Arrival, Stamp)| now - arrival < TOGETHER && sent < stamp;
        while self.window.back().is_some_and(held_up) {
            self.window.pop_back();
        }
        self.window.push_back((now, stamp));
        while self.window.len() > WINDOW_MESSAGES || self.is_front_outdated(now) {
            self.window.pop_front();
        }
        self.rate = self.measured_rate().or(self.rate);
        step
    }

    /// Whether the oldest message says nothing any more. After a stall those before it still do, until
    /// those after it make a window of their own.
    fn is_front_outdated(&self, now: Arrival) -> bool {
        let (Some(&(oldest, _)), Some(&(next, _))) = (self.window.front(), self.window.get(1))
        else {
            return false;
        };
        let too_old = now - oldest > WINDOW + WINDOW + WINDOW;
        now - oldest > WINDOW && (now - next >= RATE_BASELINE || too_old)
    }

    /// The newest stamp seen.
    pub fn latest(&self) -> Option<Stamp> {
        self.latest
    }

    /// Simulated seconds per session second, 1 until measured otherwise.
    pub fn rate(&self) -> f64 {
        self.rate.unwrap_or(1.0)
    }

    /// The rate over the window; `None` if that is too short, or if a gap in it shows that messages were
    /// held up, which would look like a slow server.
    fn measured_rate(&self) -> Option<f64> {
        let (&(a0, s0), &(a1, s1)) = (self.window.front()?, self.window.back()?);
        let arrivals = self.window.iter().map(|&(arrival, _)| arrival);
        let gap = arrivals.clone().zip(arrivals.skip(1)).any(|(a, b)| b - a > RATE_GAP);
        if gap || a1 - a0 < RATE_BASELINE || s1 <= s0 {
            return None;
        }
        let rate = (s1 - s0).seconds() / (a1 - a0).seconds();
        Some(if (rate - 1.0).abs() < RATE_SNAP { 1.0 } else { rate.clamp(0.02, 50.0) })
    }

    /// The earliest stamp the simulator's clock can show at `now`, if it has not paused since messages
    /// came in time; `None` before the first message.
    pub fn earliest(&self, now: Arrival) -> Option<Stamp> {
        let rate = self.rate();
        let runs_on = |&(arrival, stamp): &(Arrival, Stamp)| {
            stamp + Span::from_seconds((now - arrival).seconds() * rate)
        };
        self.window.iter().map(runs_on).max().max(self.punctuality.expected(now))
    }

    /// By how much messages come later than they once did; zero where the server's time is known to run
    /// at another rate than the session's.
    pub fn slower_by(&self) -> Span {
        self.punctuality.slower()
    }

    /// The same as far as it has become the rule: before that [`Self::earliest`] has run on.
    pub fn slower_as_a_rule(&self) -> Span {
        self.punctuality.shifted()
    }

    /// For how long messages have been coming late.
    pub fn late_for(&self, now: Arrival) -> Span {
        self.punctuality.late_for(now)
    }

    /// Whether messages come as late as is the rule.
    pub fn is_regular(&self) -> bool {
        self.punctuality.slower() == self.punctuality.shifted()
    }

    /// The stamp until which it is known when commands were obeyed; `None` while messages are in time.
    pub fn sure_until(&self) -> Option<Stamp> {
        self.punctuality.sure_until()
    }

    /// What messages come later by from now on is no news: it has been measured.
    pub fn forgive(&mut self) {
        self.punctuality.forgive();
    }

    /// The latest stamp at which something sent at `now` is in force at the server, if neither way
    /// takes longer than `latency` of session time in all, server frame included.
    pub fn in_force_by(&self, now: Arrival, latency: Span) -> Option<Stamp> {
        let scaled = Span::from_seconds(latency.seconds() * self.rate().max(1.0));
        self.earliest(now).map(|stamp| stamp + scaled)
    }

    /// The session time that `span` of simulated time takes.
    pub fn arrival_span(&self, span: Span) -> Span {
        Span::from_seconds(span.seconds() / self.rate())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(seconds: f64) -> Arrival {
        Arrival::from_seconds(seconds)
    }

    #[test]
    fn a_late_message_does_not_move_the_bound_back() {
        let mut clock = StampClock::new();
        clock.observe(Stamp::from_seconds(100.0), at(1.0));
        clock.observe(Stamp::from_seconds(100.2), at(1.7));
        assert_eq!(clock.earliest(at(2.0)), Some(Stamp::from_seconds(101.0)));
    }

    #[test]
    fn messages_held_up_for_long_leave_bound_and_rate_alone() {
        let mut clock = StampClock::new();
        for i in 0..30 {
            let t = 0.2 * f64::from(i);
            clock.observe(Stamp::from_seconds(100.0 + t), at(t));
            clock.observe(Stamp::from_seconds(98.0 + t), at(t + 0.01));
        }
        assert!((clock.rate() - 1.0).abs() < 1e-12, "{}", clock.rate());
        assert_eq!(clock.earliest(at(6.0)), Some(Stamp::from_seconds(106.0)));
    }

    #[test]
    fn messages_that_begin_to_come_late_are_noticed_and_no_jitter_is() {
        for late in [0.6, 2.0] {
            let mut clock = StampClock::new();
            for i in 0..120 {
                let sent = 0.2 * f64::from(i);
                let now = sent + if i < 50 { 0.01 } else { late } + 0.01 * f64::from(i % 3);
                clock.observe(Stamp::from_seconds(100.0 + sent), at(now));
                if i < 50 {
                    assert_eq!(clock.slower_by(), Span::ZERO);
                }
            }
            let slower = clock.slower_by().seconds();
            assert!((slower - late).abs() < 0.05, "{slower} s of {late} s");
        }
    }

    #[test]
    fn a_stall_leaves_the_bound_where_it_was() {
        for lasts in [20, 40] {
            let mut clock = StampClock::new();
            for i in 0..150 {
                let sent = 0.2 * f64::from(i);
                // All of some seconds arrives at once.
                let ends = 30 + lasts;
                let now = if (30..ends).contains(&i) { 0.2 * f64::from(ends) } else { sent };
                clock.observe(Stamp::from_seconds(100.0 + sent), at(now));
                let earliest = clock.earliest(at(now)).unwrap().seconds();
                assert!((earliest - 100.0 - now).abs() < 0.01, "{earliest} at {now}");
            }
            assert_eq!((clock.slower_by(), clock.rate()), (Span::ZERO, 1.0));
        }
    }

    #[test]
    fn a_jump_of_the_clock_voids_what_was_known() {
        let mut clock = StampClock::new();
        for i in 0..10 {
            let t = 0.2 * f64::from(i);
            assert_eq!(clock.observe(Stamp::from_seconds(100.0 + t), at(t)), ClockStep::Steady);
        }
        let back = clock.observe(Stamp::from_seconds(50.0), at(2.0));
        assert!(matches!(back, ClockStep::Jumped(by) if by < Span::ZERO));
        assert_eq!(clock.earliest(at(2.1)), Some(Stamp::from_seconds(50.1)));
    }

    proptest! {
        #[test]
        fn the_bounds_enclose_the_simulators_clock(
            rate in prop::sample::select(vec![0.3, 1.0, 1.0, 4.0]),
            latencies in prop::collection::vec(0.0..0.04f64, 40), ask in 0.0..0.2f64
        ) {
            let mut clock = StampClock::new();
            let offset = 5000.0;
            let mut now = 0.0;
            for (i, latency) in latencies.iter().enumerate() {
                let sent = 0.2 * i as f64;
                now = sent + latency;
                clock.observe(Stamp::from_seconds(offset + sent * rate), at(now));
            }
            let asked = now + ask;
            let truth = offset + asked * rate;
            // The measured rate is off by the jitter of the window's two ends.
            let slack = 0.05 * rate;
            prop_assert!(clock.earliest(at(asked)).unwrap().seconds() <= truth + slack);
            let bound = clock.in_force_by(at(asked), Span::from_millis(40)).unwrap().seconds();
            prop_assert!(bound >= truth - slack, "{bound} {truth}");
        }
    }
}
