//! When the laser's lines come, and what came out of order.

use super::CLOCK_JUMP;
use crate::scan::LaserLine;
use crate::time::{Arrival, Span, Stamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// When lines come, and how many beams they have.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::acquisition) struct LineRhythm {
    recent: VecDeque<Stamp>,
    last_arrival: Option<Arrival>,
    pub(super) lines: u64,
    beams: Option<usize>,
    other: Option<(usize, u32)>,
}

impl LineRhythm {
    /// The laser's interval until it is measured: the UT2004 timer and UDK's ScanInterval.
    const USUAL_INTERVAL: Span = Span::from_millis(200);
    const KEPT: usize = 16;
    /// Lines of another length that make it the usual one: a cut line comes alone.
    const CONVINCING: u32 = 3;

    pub(super) fn note(&mut self, line: &LaserLine, now: Arrival) {
        self.last_arrival = Some(now);
        self.lines += 1;
        // Stamps of another time than the clock's: lines that were under way when it jumped.
        let apart =
            |newest: Stamp| line.stamp - newest >= CLOCK_JUMP || newest - line.stamp >= CLOCK_JUMP;
        if self.newest().is_some_and(apart) {
            self.recent.clear();
        }
        // In order of the stamps: the interval is the laser's, not that of the arrivals.
        let at = self.recent.partition_point(|&stamp| stamp < line.stamp);
        if self.recent.get(at) != Some(&line.stamp) {
            self.recent.insert(at, line.stamp);
            if self.recent.len() > Self::KEPT {
                self.recent.pop_front();
            }
        }
        let beams = line.len();
        if self.beams.is_none_or(|usual| usual == beams) {
            self.beams = Some(beams);
            self.other = None;
            return;
        }
        let seen = self.other.filter(|&(other, _)| other == beams).map_or(1, |(_, n)| n + 1);
        self.other = Some((beams, seen));
        if seen >= Self::CONVINCING {
            self.beams = Some(beams);
            self.other = None;
        }
    }

    pub(super) fn forget_times(&mut self) {
        self.recent.clear();
    }

    /// Median time between lines.
    pub(in crate::acquisition) fn interval(&self) -> Span {
        let mut gaps: Vec<Span> =
            self.recent.iter().zip(self.recent.iter().skip(1)).map(|(a, b)| *b - *a).collect();
        gaps.sort();
        gaps.get(gaps.len() / 2).copied().unwrap_or(Self::USUAL_INTERVAL)
    }

    /// Whether a line has the length that lines of this scanner have.
    pub(in crate::acquisition) fn is_whole(&self, line: &LaserLine) -> bool {
        self.beams.is_none_or(|beams| beams == line.len()) && !line.is_empty()
    }

    /// The newest stamp of a line.
    pub(super) fn newest(&self) -> Option<Stamp> {
        self.recent.back().copied()
    }

    /// When the last line arrived.
    pub(in crate::acquisition) fn last_arrival(&self) -> Option<Arrival> {
        self.last_arrival
    }
}

/// Messages that arrived after others which were stamped later.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::acquisition) struct Disorder {
    /// Readings of the tilt.
    pub readings: u32,
    /// Lines of the laser.
    pub lines: u32,
    /// How far behind the newest line the latest of them came.
    pub lines_late: Span,
}

impl Disorder {
    /// Whether anything came out of order since `before`.
    pub(in crate::acquisition) fn grew_since(&self, before: &Self) -> bool {
        self.readings > before.readings || self.lines > before.lines
    }

    /// What came out of order since `before`, in words for an operator.
    pub(in crate::acquisition) fn remark_since(&self, before: &Self) -> Option<String> {
        self.grew_since(before).then(|| {
            format!(
                "{} readings of the tilt and {} lines came out of order: each counts by its own time",
                self.readings - before.readings,
                self.lines - before.lines
            )
        })
    }
}
