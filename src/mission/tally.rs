//! What came over the link, counted.

use crate::protocol::{Message, Problem, ProblemKind};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What came over the link, counted.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Lines read.
    pub lines: usize,
    /// Lines of a type that is not known, by their first word.
    pub unknown: BTreeMap<String, usize>,
    /// Damage, by kind.
    pub problems: BTreeMap<ProblemKind, usize>,
    /// The first few damaged places, quoted.
    pub quoted: Vec<String>,
    pub(super) bad_in_a_row: usize,
}

impl Tally {
    pub(super) fn take(&mut self, line: &[u8], message: &Message, problems: &[Problem]) {
        const QUOTES: usize = 3;
        self.lines += 1;
        if let Message::Unknown(raw) = message {
            *self.unknown.entry(raw.verb.clone()).or_default() += 1;
        }
        let lost = !problems.is_empty();
        self.bad_in_a_row = if lost { self.bad_in_a_row + 1 } else { 0 };
        for problem in problems {
            if self.quoted.len() < QUOTES {
                let start = String::from_utf8_lossy(&line[..line.len().min(60)]).into_owned();
                self.quoted.push(format!("{}: `{start}`", problem.kind));
            }
            *self.problems.entry(problem.kind.clone()).or_default() += 1;
        }
    }
}
