//! What came over the link, counted.

use crate::protocol::{Message, Problem, ProblemKind};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Lines that are quoted, at most.
const QUOTES: usize = 3;

/// Bytes of a line that are quoted, at most.
const QUOTED_BYTES: usize = 60;

/// Share of lines of unknown types from which on they are warned of: servers send some that nobody
/// has described, and those mean nothing.
const MANY_UNKNOWN: f64 = 0.05;

/// What came over the link, counted.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tally {
    /// Lines read.
    pub lines: usize,
    /// Lines with damage.
    pub damaged: usize,
    /// Lines of a type that is not known, by their first word.
    pub unknown: BTreeMap<String, usize>,
    /// Damage, by kind.
    pub problems: BTreeMap<ProblemKind, usize>,
    /// The first few lines that were damaged or of an unknown type, quoted, with what is wrong.
    pub quoted: Vec<String>,
    pub(super) bad_in_a_row: usize,
}

impl Tally {
    pub(super) fn take(&mut self, line: &[u8], message: &Message, problems: &[Problem]) {
        self.lines += 1;
        let mut wrong: Vec<String> = Vec::new();
        if let Message::Unknown(raw) = message {
            *self.unknown.entry(raw.verb.clone()).or_default() += 1;
            wrong.push("unknown type".into());
        }
        let lost = !problems.is_empty();
        self.damaged += usize::from(lost);
        self.bad_in_a_row = if lost { self.bad_in_a_row + 1 } else { 0 };
        for problem in problems {
            *self.problems.entry(problem.kind.clone()).or_default() += 1;
            wrong.push(problem.kind.to_string());
        }
        if !wrong.is_empty() && self.quoted.len() < QUOTES {
            let start = String::from_utf8_lossy(&line[..line.len().min(QUOTED_BYTES)]);
            wrong.dedup();
            self.quoted.push(format!("`{}`: {}", start.escape_debug(), wrong.join(", ")));
        }
    }

    /// Lines of types that are not known.
    pub fn unknown_lines(&self) -> usize {
        self.unknown.values().sum()
    }

    /// What was wrong with the lines, if it is worth a warning.
    pub(super) fn warning(&self) -> Option<String> {
        let unknown = self.unknown_lines();
        let many = unknown as f64 > MANY_UNKNOWN * self.lines as f64;
        let first = self.quoted.first().filter(|_| self.damaged > 0 || many)?;
        Some(format!(
            "of {} lines from the server {} were damaged and {unknown} of an unknown type; the first: \
             {first}",
            self.lines, self.damaged
        ))
    }

    /// That nothing of what came was this protocol, if so.
    pub(super) fn gibberish(&self) -> Option<String> {
        let first = self.quoted.first().filter(|_| self.unknown_lines() == self.lines)?;
        Some(format!(
            "what speaks there is no USARSim server: {} lines came, none of a known type; the first: \
             {first}",
            self.lines
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::parse;

    fn tally(lines: &[&[u8]]) -> Tally {
        let mut tally = Tally::default();
        for line in lines {
            let parsed = parse(line);
            tally.take(line, &parsed.message, &parsed.problems);
        }
        tally
    }

    #[test]
    fn a_line_is_damaged_and_quoted_once_however_much_is_wrong_with_it() {
        let bad: &[u8] = b"SEN {Time 1.0} {Type Odometry} {Name O {Pose 0.0,0.x0,0.0} } x";
        let tally = tally(&[bad, b"STA {Time 1.00}", bad]);
        assert_eq!((tally.lines, tally.damaged, tally.quoted.len()), (3, 2, 2));
        assert!(tally.problems.values().sum::<usize>() > 2, "{:?}", tally.problems);
        let warning = tally.warning().unwrap();
        assert!(warning.starts_with("of 3 lines from the server 2 were damaged"), "{warning}");
        assert!(warning.contains("`SEN {Time 1.0}"), "{warning}");
        assert_eq!(tally.gibberish(), None);
    }

    #[test]
    fn good_lines_and_a_rare_unknown_type_are_no_warning() {
        let mut lines: Vec<&[u8]> = vec![b"STA {Time 1.00}"; 60];
        lines.push(b"NEWS {Time 1.00}");
        let tally = tally(&lines);
        assert_eq!((tally.unknown_lines(), tally.warning()), (1, None));
    }

    #[test]
    fn bytes_that_are_no_protocol_are_called_so() {
        let tally = tally(&[b"\x00\xff\x13{{", b"\x7fELF\x02"]);
        let text = tally.gibberish().unwrap();
        assert!(text.contains("no USARSim server: 2 lines") && text.contains("\\0"), "{text}");
    }
}
