//! What was wrong with a line: counted by the caller, quoted, and never fatal.

use super::text;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Octets of the line that a problem quotes, at most.
const QUOTE_OCTETS: usize = 60;

/// Problems that are noted for one line, at most: a line of braces alone is not worth more.
const MAX_PROBLEMS: usize = 16;

/// One thing that was wrong with a line; the rest of the line was read all the same.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// What was found and what was expected.
    pub kind: ProblemKind,
    /// Octets from the beginning of the line.
    pub at: usize,
    /// The damaged place, at most 60 octets of it.
    pub quote: String,
}

/// The ways in which a line can be damaged.
#[derive(
    Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, thiserror::Error,
)]
pub enum ProblemKind {
    /// The line was longer than the splitter's bound and was dropped.
    #[error("line of {length} bytes, at most {limit} are read")]
    Overlong {
        /// Octets that the line had up to its end.
        length: usize,
        /// The bound.
        limit: usize,
    },
    /// The stream ended in the middle of the line, which was dropped.
    #[error("the connection closed before the line ended")]
    Unfinished,
    /// A `{` without its `}`; the segment was ended at the next `{` or at the end of the line.
    #[error("segment is not closed")]
    SegmentNotClosed,
    /// A `}` without its `{`.
    #[error("closing brace without an opening one")]
    StrayClose,
    /// Text between segments or after the last one; it belongs to nothing and was left out.
    #[error("text outside of segments")]
    StrayText,
    /// A key that this type of message cannot do without.
    #[error("no segment `{0}`")]
    MissingKey(String),
    /// A value that should have been a number.
    #[error("value of `{0}` is not a number")]
    NotANumber(String),
    /// A value that should have been a whole number.
    #[error("value of `{0}` is not a whole number")]
    NotAnInteger(String),
    /// A value that should have been `True` or `False`.
    #[error("value of `{0}` is neither True nor False")]
    NotABool(String),
    /// A list of the wrong length.
    #[error("`{key}` holds {found} values, expected {expected}")]
    WrongCount {
        /// The segment's key.
        key: String,
        /// How many values it has.
        found: usize,
        /// How many it should have.
        expected: usize,
    },
}

impl Problem {
    /// A problem with a whole line, for whoever frames or replays lines.
    pub fn quoting(kind: ProblemKind, line: &[u8]) -> Self {
        Self::new(kind, 0, line)
    }

    /// A problem at offset `at`, quoting the beginning of `place`.
    pub(super) fn new(kind: ProblemKind, at: usize, place: &[u8]) -> Self {
        let quote = text::from_wire(&place[..place.len().min(QUOTE_OCTETS)]);
        Self { kind, at, quote }
    }
}

/// Adds a problem unless the line has enough of them.
pub(super) fn note(problems: &mut Vec<Problem>, problem: Problem) {
    if problems.len() < MAX_PROBLEMS {
        problems.push(problem);
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "byte {}: {}: `{}`", self.at, self.kind, self.quote.escape_default())
    }
}
