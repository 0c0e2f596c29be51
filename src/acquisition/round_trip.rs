//! How long a question to the server takes to be answered.
//!
//! Stamps tell the way of messages from the server only as far as they begin to come later; of a line
//! that has been slow from the start they tell nothing, nor of one that becomes slower bit by bit, which
//! looks like a server whose time runs slower. An answer tells: a command sent with the question is
//! obeyed before the answer is sent, so that it is in force by the stamp that the clock's lower bound
//! shows when the answer arrives.

use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// A question that was answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Trip {
    sent: Arrival,
    /// The clock's lower bound when the question was sent.
    stamp: Stamp,
    took: Span,
}

/// Questions and answers, one at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RoundTrips {
    /// The question under way, and the clock's lower bound when it was sent.
    asked: Option<(Arrival, Stamp)>,
    unanswered: u32,
    kept: VecDeque<Trip>,
    /// When the calibration was begun that is under way, or was the last.
    calibrated_from: Arrival,
    /// What answers took while the times of commands were measured.
    usual: Option<Span>,
}

/// Questions are asked this often.
const EVERY: Span = Span::from_millis(1_000);
/// An answer that takes longer is not waited for any more; longer than any delay that is reckoned with.
const ANSWERED_WITHIN: Span = Span::from_millis(6_000);
/// A server that answers none of so many is not asked any more.
const MUTE: u32 = 3;
/// Trips kept: those of a long sweep at rest.
const KEPT: usize = 600;
/// The newest trips, which tell how slow the line is now.
const NEWEST: usize = 3;
/// Added to the longest of them, for the frames of a server and the wait for its next one.
const SPARE: Span = Span::from_millis(30);
/// More than is usual by this is no server's frame.
const OTHER: Span = Span::from_millis(60);
/// Trips of a calibration whose shortest differ by more than this, and by more than half of what they
/// scatter by, are of a line that changed meanwhile.
const CHANGED: Span = Span::from_millis(80);

impl RoundTrips {
    /// Whether a question is due.
    pub(super) fn is_due(&self, now: Arrival) -> bool {
        let given_up = self.kept.is_empty() && self.unanswered >= MUTE;
        match (self.asked, self.kept.back()) {
            _ if given_up => false,
            (Some((sent, _)), _) => now - sent > ANSWERED_WITHIN,
            (None, Some(last)) => now - last.sent >= EVERY,
            (None, None) => true,
        }
    }

    /// Takes note that a question is sent, the clock's lower bound being `stamp`.
    pub(super) fn ask(&mut self, stamp: Stamp, now: Arrival) {
        self.unanswered += u32::from(self.asked.is_some());
        self.asked = Some((now, stamp));
    }

    /// Takes note of the answer.
    pub(super) fn answered(&mut self, now: Arrival) {
        let Some((sent, stamp)) = self.asked.take() else { return };
        self.unanswered = 0;
        self.kept.push_back(Trip { sent, stamp, took: now - sent });
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
    }

    /// Stamps from before a jump of the server's clock are void, what the line took is not.
    pub(super) fn forget_times(&mut self) {
        for trip in &mut self.kept {
            trip.stamp = Stamp(i64::MIN);
        }
        if let Some((_, stamp)) = &mut self.asked {
            *stamp = Stamp(i64::MIN);
        }
    }

    /// Whether the first question is still to be answered.
    pub(super) fn awaits_first(&self, now: Arrival) -> bool {
        let waits = |(sent, _): (Arrival, Stamp)| now - sent <= ANSWERED_WITHIN;
        self.kept.is_empty() && self.unanswered == 0 && self.asked.is_some_and(waits)
    }

    /// Whether an answer is under way, or would be if the server gave any.
    pub(super) fn is_waiting(&self, now: Arrival) -> bool {
        let mute = self.kept.is_empty() && self.unanswered >= MUTE;
        mute || self.asked.is_some_and(|(sent, _)| now - sent <= ANSWERED_WITHIN)
    }

    /// Whether an answer is waited for that should come.
    pub(super) fn awaits(&self) -> bool {
        self.asked.is_some() && !self.kept.is_empty()
    }

    /// A bound on the time from sending a command until it is in force, by what answers take now.
    pub(super) fn bound(&self, now: Arrival) -> Span {
        let newest = self.kept.iter().rev().take(NEWEST).map(|trip| trip.took);
        let under_way = self.asked.map(|(sent, _)| (now - sent).min(ANSWERED_WITHIN));
        newest.chain(under_way).max().map_or(Span::ZERO, |longest| longest + SPARE)
    }

    /// What a command takes to be obeyed as a rule; `None` as long as nothing was answered.
    pub(super) fn middle(&self) -> Option<Span> {
        let mut newest: Vec<Span> =
            self.kept.iter().rev().take(NEWEST).map(|trip| trip.took).collect();
        newest.sort();
        newest.get(newest.len() / 2).copied()
    }

    /// Begins to measure what is usual.
    pub(super) fn begin_calibration(&mut self, now: Arrival) {
        self.calibrated_from = now;
    }

    fn of_calibration(&self) -> Vec<Span> {
        let since = self.kept.iter().filter(|trip| trip.sent >= self.calibrated_from);
        since.map(|trip| trip.took).collect()
    }

    /// The shortest and the longest trip since the calibration was begun, one that was held up left out;
    /// `None` if nothing was answered.
    pub(super) fn calibrated_span(&self) -> Option<(Span, Span)> {
        let mut took = self.of_calibration();
        took.sort();
        let longest = match took.len() {
            0 => return None,
            count @ 1..=4 => took[count - 1],
            count => took[count - 2],
        };
        Some((took[0], longest))
    }

    /// Whether the line became slower or faster since the calibration was begun.
    pub(super) fn changed_meanwhile(&self) -> bool {
        let took = self.of_calibration();
        let spread = |half: &[Span]| {
            let (least, most) = (half.iter().min()?, half.iter().max()?);
            Some((*least, *most - *least))
        };
        let (first, second) = took.split_at(took.len() / 2);
        let (Some((a, scatter_a)), Some((b, scatter_b))) = (spread(first), spread(second)) else {
            return false;
        };
        let change = if a > b { a - b } else { b - a };
        change > CHANGED && change + change > scatter_a.min(scatter_b)
    }

    /// What answers took since then is what they usually take.
    pub(super) fn calibrated(&mut self) {
        self.usual = self.calibrated_span().map(|(_, longest)| longest);
    }

    /// Whether one trip took longer than is usual.
    fn is_slow(&self, trip: &Trip) -> bool {
        self.usual.is_some_and(|usual| trip.took > usual + OTHER)
    }

    /// By how much answers take longer than is usual, if that is no moment's.
    pub(super) fn slower_by(&self) -> Span {
        let Some(usual) = self.usual.filter(|_| self.sure_until().is_some()) else {
            return Span::ZERO;
        };
        self.bound(Arrival(0)) - SPARE - usual
    }

    /// By how much a command takes longer to be obeyed than is usual, as a rule.
    pub(super) fn later_by(&self) -> Span {
        let usual = self.usual.filter(|_| self.sure_until().is_some());
        let later = self.middle().zip(usual).map_or(Span::ZERO, |(middle, usual)| middle - usual);
        later.max(Span::ZERO)
    }

    /// The stamp until which commands were obeyed as fast as is usual; `None` if they are.
    pub(super) fn sure_until(&self) -> Option<Stamp> {
        let mut newest = self.kept.iter().rev();
        let slow = newest.by_ref().take_while(|trip| self.is_slow(trip)).count();
        (slow >= 2).then(|| {
            let before = self.kept.len() - slow;
            before.checked_sub(1).map_or(Stamp(i64::MIN), |at| self.kept[at].stamp)
        })
    }

    /// Whether the line is as slow as it was some seconds ago.
    pub(super) fn is_steady(&self) -> bool {
        let least = |skipped: usize| {
            let trips = self.kept.iter().rev().skip(skipped).take(NEWEST).map(|trip| trip.took);
            if self.kept.len() < skipped + NEWEST { None } else { trips.min() }
        };
        let (Some(now), Some(before)) = (least(0), least(NEWEST)) else { return false };
        now - before < OTHER && before - now < OTHER
    }

    /// By how much a command that mattered at `stamp` may have been obeyed later than usual, as far as
    /// that was no moment's.
    pub(super) fn excess_at(&self, stamp: Stamp) -> Span {
        let Some(usual) = self.usual else { return Span::ZERO };
        let after = self.kept.partition_point(|trip| trip.stamp < stamp);
        let newest = self.kept.len().saturating_sub(1);
        let around = self.kept.range(after.min(newest)..).take(2).map(|trip| trip.took);
        around.min().map_or(Span::ZERO, |took| (took - usual).max(Span::ZERO))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A question a second, each answered after what its number gives.
    fn told(trips: &mut RoundTrips, numbers: std::ops::Range<u32>, took_s: impl Fn(u32) -> f64) {
        for i in numbers {
            let now = Arrival::from_seconds(f64::from(i));
            assert!(trips.is_due(now), "{i}");
            trips.ask(Stamp::from_seconds(100.0 + f64::from(i)), now);
            trips.answered(now + Span::from_seconds(took_s(i)));
        }
    }

    fn calibrated(took_s: f64) -> RoundTrips {
        let mut trips = RoundTrips::default();
        told(&mut trips, 0..20, |i| took_s + 0.01 * f64::from(i % 3));
        assert!(!trips.changed_meanwhile());
        trips.calibrated();
        trips
    }

    #[test]
    fn a_line_that_is_slow_from_the_start_is_measured() {
        let trips = calibrated(0.9);
        assert!(trips.bound(Arrival(0)) >= Span::from_millis(900));
        assert_eq!((trips.sure_until(), trips.slower_by()), (None, Span::ZERO));
        assert_eq!(trips.calibrated_span().map(|(least, _)| least), Some(Span::from_millis(900)));
    }

    #[test]
    fn a_line_that_becomes_slower_by_and_by_is_noticed() {
        let mut trips = calibrated(0.02);
        told(&mut trips, 20..40, |i| 0.02 + 0.025 * f64::from(i - 19));
        let until = trips.sure_until().unwrap();
        assert!(until <= Stamp::from_seconds(123.0) && until >= Stamp::from_seconds(121.0));
        assert!(trips.slower_by() > Span::from_millis(400) && !trips.is_steady());
        assert!(trips.excess_at(Stamp::from_seconds(130.0)) > Span::from_millis(200));
        assert_eq!(trips.excess_at(Stamp::from_seconds(110.0)), Span::ZERO);
        told(&mut trips, 40..46, |_| 0.5);
        assert!(trips.is_steady());
    }

    #[test]
    fn an_answer_that_is_held_up_for_a_moment_leaves_nothing_in_doubt() {
        let mut trips = calibrated(0.02);
        told(&mut trips, 20..30, |i| if i == 25 { 0.9 } else { 0.02 });
        assert_eq!(trips.sure_until(), None);
        assert_eq!(trips.excess_at(Stamp::from_seconds(124.5)), Span::ZERO);
    }

    #[test]
    fn a_line_that_changes_during_the_calibration_is_told() {
        let mut trips = RoundTrips::default();
        told(&mut trips, 0..20, |i| 0.02 + 0.025 * f64::from(i));
        assert!(trips.changed_meanwhile());
        let mut scattered = RoundTrips::default();
        told(&mut scattered, 0..20, |i| 0.1 + 0.8 * f64::from(i * 7 % 11) / 11.0);
        assert!(!scattered.changed_meanwhile());
    }

    #[test]
    fn a_server_that_never_answers_is_left_alone() {
        let mut trips = RoundTrips::default();
        let mut asked = 0;
        for i in 0..100 {
            let now = Arrival::from_seconds(f64::from(i));
            if trips.is_due(now) {
                trips.ask(Stamp(0), now);
                asked += 1;
            }
            assert_eq!(trips.awaits_first(now), i <= 6, "{i}");
        }
        assert_eq!((asked, trips.middle()), (4, None));
    }
}
