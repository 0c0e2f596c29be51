//! Whether the server's messages come when they are due.
//!
//! Messages that begin to come later than they did mean that the line became slower, or that the server
//! paused or runs slower: the stamps look alike. In the first case the server's clock has run on as it
//! did, in the others it has not, so that until one of them is ruled out nobody knows at which stamp a
//! command was obeyed. A message that is in time again rules out the pause.

use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The line of messages that came in time, drawn on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Punctuality {
    /// The newest messages that came in time.
    in_time: VecDeque<(Arrival, Stamp)>,
    /// Simulated seconds per session second; `None` while that is unknown.
    rate: Option<f64>,
    /// The first message since then that came late, and by how much the newest one does.
    late: Option<((Arrival, Stamp), Span)>,
    /// What messages come later by than they once did, as that is the rule by now.
    shifted: Span,
    /// Stamp of the last message before that began which is not yet ruled out.
    sure_until: Option<Stamp>,
}

/// What a message tells of the two clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Timeliness {
    /// It came when it was due.
    InTime,
    /// It came late, and nothing can be told from it yet.
    Late,
    /// It came late as others did for some time: from now on that is the rule, at this rate.
    LateAsARule { rate: f64 },
}

/// A message later than this is late: more than bursts, frames and a wireless line scatter.
const IN_TIME: Span = Span::from_millis(80);
/// Messages stamped within this belong to one burst.
const BURST: Span = Span::from_millis(50);
/// Messages in time looked back over. Within it a clock that runs slower by what passes for jitter loses
/// less than [`IN_TIME`], and a line that becomes slower by and by is told from it.
const LOOKS_BACK: Span = Span::from_millis(1_500);
/// What has been late for this long is the rule.
const BECOMES_RULE: Span = Span::from_millis(5_000);
/// Rates over that time that differ by less, as a share, are one.
const SAME_RATE: f64 = 0.05;

impl Punctuality {
    /// Takes note of a message stamped `stamp` that arrived `now`, not older than those before it; `rate`
    /// is what is known between the clocks, `None` as long as nothing is.
    pub(super) fn note(&mut self, stamp: Stamp, now: Arrival, rate: Option<f64>) -> Timeliness {
        let Some(before) = self.rate else {
            *self = Self { in_time: VecDeque::from([(now, stamp)]), rate, ..Self::default() };
            return Timeliness::InTime;
        };
        let lateness = self.expected(now).map_or(Span::ZERO, |expected| expected - stamp);
        let mut timeliness = Timeliness::InTime;
        let in_time = Span::from_seconds(IN_TIME.seconds() * before.max(1.0));
        if lateness > in_time {
            // Of a burst the first message has told all there is, however late the others are.
            if self.in_time.back().is_some_and(|&(_, newest)| stamp - newest < BURST) {
                return Timeliness::Late;
            }
            let (first, _) = *self.late.get_or_insert(((now, stamp), lateness));
            self.late = Some((first, lateness));
            self.sure_until = self.sure_until.or(self.in_time.back().map(|&(_, stamp)| stamp));
            if now - first.0 <= BECOMES_RULE {
                return Timeliness::Late;
            }
            // Those that are late among themselves tell a slower server, of which the rate tells all.
            let own_rate = (stamp - first.1).seconds() / (now - first.0).seconds();
            let goes_on = (own_rate / before - 1.0).abs() < SAME_RATE;
            let (rate, shifted) = match goes_on {
                true => (before, self.shifted + lateness),
                false => (own_rate, Span::ZERO),
            };
            (self.rate, self.shifted) = (Some(rate), shifted);
            self.in_time.clear();
            timeliness = Timeliness::LateAsARule { rate };
        } else {
            self.rate = rate.or(self.rate);
            if lateness + in_time < Span::ZERO {
                self.shifted = (self.shifted + lateness).max(Span::ZERO);
            }
        }
        self.late = None;
        if self.shifted <= IN_TIME {
            self.sure_until = None;
        }
        self.in_time.push_back((now, stamp));
        while self.in_time.front().is_some_and(|&(arrival, _)| now - arrival > LOOKS_BACK) {
            self.in_time.pop_front();
        }
        timeliness
    }

    /// The server's clock at `now`, if it has run on as it did when messages last came in time.
    pub(super) fn expected(&self, now: Arrival) -> Option<Stamp> {
        let runs_on = |&(arrival, stamp): &(Arrival, Stamp)| {
            stamp + Span::from_seconds((now - arrival).seconds() * self.rate.unwrap_or(1.0))
        };
        self.in_time.iter().map(runs_on).max()
    }

    /// By how much messages come later than they once did.
    pub(super) fn slower(&self) -> Span {
        self.shifted + self.late.map_or(Span::ZERO, |(_, lateness)| lateness)
    }

    /// The same as far as it is the rule by now.
    pub(super) fn shifted(&self) -> Span {
        self.shifted
    }

    /// For how long no message has come in time although some came.
    pub(super) fn late_for(&self, now: Arrival) -> Span {
        let as_a_rule = if self.shifted > IN_TIME { BECOMES_RULE } else { Span::ZERO };
        self.late.map_or(as_a_rule, |((since, _), _)| (now - since).max(as_a_rule))
    }

    /// The stamp until which it is known when commands were obeyed; `None` if it always is.
    pub(super) fn sure_until(&self) -> Option<Stamp> {
        self.sure_until
    }

    /// Takes what messages come late by for the rule, as when a calibration has measured with it.
    pub(super) fn forgive(&mut self) {
        self.shifted = Span::ZERO;
        if self.late.is_none() {
            self.sure_until = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five messages a second, each `late` by what its number gives.
    fn told(messages: u32, late: impl Fn(u32) -> f64) -> (Punctuality, Arrival) {
        let mut punctuality = Punctuality::default();
        let mut now = Arrival(0);
        for i in 0..messages {
            let sent = 0.2 * f64::from(i);
            now = Arrival::from_seconds(sent + late(i));
            let rate = (i > 12).then_some(1.0);
            punctuality.note(Stamp::from_seconds(100.0 + sent), now, rate);
        }
        (punctuality, now)
    }

    #[test]
    fn a_line_that_becomes_slower_is_noticed_at_once_and_jitter_is_not() {
        for late in [0.15, 0.5, 0.9] {
            let step = |i| if i < 50 { 0.01 } else { late } + 0.02 * f64::from(i % 3);
            let (soon, now) = told(53, step);
            assert_eq!(soon.sure_until(), Some(Stamp::from_seconds(109.8)));
            assert!(soon.late_for(now).seconds() > 0.3);
            assert!((soon.slower().seconds() - late).abs() < 0.07, "{late}");
            // Nor is it forgotten once it is the rule.
            let (later, now) = told(120, step);
            assert_eq!(later.sure_until(), Some(Stamp::from_seconds(109.8)));
            assert!(later.late_for(now) >= BECOMES_RULE);
            let (long_after, _) = told(2_000, step);
            assert!((long_after.slower().seconds() - late).abs() < 0.07, "{late}");
            assert!((later.slower().seconds() - late).abs() < 0.07, "{late}");
        }
        let (even, _) = told(200, |i| 0.06 * f64::from(i % 7) / 6.0);
        assert_eq!((even.sure_until(), even.slower()), (None, Span::ZERO));
    }

    #[test]
    fn what_becomes_slower_by_and_by_is_noticed_too() {
        let (ramp, _) = told(70, |i| 0.045 * f64::from(i.saturating_sub(50)).min(16.0));
        assert!(ramp.slower().seconds() > 0.5, "{:?}", ramp.slower());
        // A server that runs a little slower is none.
        let (drift, _) = told(300, |i| 0.006 * f64::from(i));
        assert_eq!(drift.sure_until(), None);
    }

    #[test]
    fn a_burst_that_comes_bit_by_bit_is_in_time() {
        // The second half of each is 10 ms later by its stamp and 190 ms by its arrival.
        let mut punctuality = Punctuality::default();
        for i in 0..200 {
            let sent = 0.2 * f64::from(i / 2) + 0.01 * f64::from(i % 2);
            let now = Arrival::from_seconds(sent + 0.18 * f64::from(i % 2));
            punctuality.note(Stamp::from_seconds(100.0 + sent), now, (i > 24).then_some(1.0));
            assert_eq!((punctuality.sure_until(), punctuality.slower()), (None, Span::ZERO), "{i}");
        }
    }

    #[test]
    fn messages_held_up_for_a_while_leave_nothing_in_doubt() {
        let held = |i: u32| if (50..60).contains(&i) { 0.2 * f64::from(60 - i) } else { 0.0 };
        let (held, _) = told(61, held);
        assert_eq!((held.sure_until(), held.slower()), (None, Span::ZERO));
        let recovered = |i: u32| if (50..120).contains(&i) { 0.7 } else { 0.0 };
        let (recovered, _) = told(125, recovered);
        assert_eq!((recovered.sure_until(), recovered.slower()), (None, Span::ZERO));
    }
}
