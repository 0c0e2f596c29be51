//! What the agent did and why, in words, for the report, the log and the operator.

use crate::time::Arrival;
use serde::{Deserialize, Serialize};

/// Notes kept in memory; older ones were handed out long before.
const KEPT: usize = 4096;
/// Different warnings that are kept for the report.
const KEPT_WARNINGS: usize = 100;

/// Who a note is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// A step of the mission and its reason.
    Info,
    /// The mission goes on, but not as told.
    Warn,
    /// Something was lost.
    Error,
}

/// One sentence about one decision.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// When it was taken.
    pub arrival: Arrival,
    /// Who it is for.
    pub level: Level,
    /// The sentence.
    pub text: String,
}

/// The agent's diary. Numbers of notes never repeat, so a reader can ask for what is new to it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Journal {
    notes: Vec<Note>,
    dropped: usize,
    /// Each different warning once, the first of them.
    warnings: Vec<String>,
}

impl Journal {
    /// Adds a note.
    pub fn note(&mut self, arrival: Arrival, level: Level, text: impl Into<String>) {
        if self.notes.len() == KEPT {
            self.notes.drain(..KEPT / 2);
            self.dropped += KEPT / 2;
        }
        let text = text.into();
        let is_news = level >= Level::Warn
            && self.warnings.len() < KEPT_WARNINGS
            && !self.warnings.contains(&text);
        if is_news {
            self.warnings.push(text.clone());
        }
        self.notes.push(Note { arrival, level, text });
    }

    /// Each different warning and error once, in the order of their first time; a hundred at most.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Number of notes ever taken.
    pub fn len(&self) -> usize {
        self.dropped + self.notes.len()
    }

    /// Whether no note was ever taken.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The notes from number `first` on that are still kept.
    pub fn since(&self, first: usize) -> &[Note] {
        &self.notes[first.saturating_sub(self.dropped).min(self.notes.len())..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_keeps_up_misses_nothing() {
        let mut journal = Journal::default();
        let mut seen = 0;
        for i in 0..3 * KEPT {
            journal.note(Arrival(i as i64), Level::Info, "x");
            let new = journal.since(seen);
            assert_eq!(new.len(), 1);
            assert_eq!(new[0].arrival, Arrival(i as i64));
            seen = journal.len();
        }
        assert!(journal.since(0).len() <= KEPT);
    }
}
