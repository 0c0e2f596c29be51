//! Bytes in, whole lines out.

use super::problem::{Problem, ProblemKind};
use serde::{Deserialize, Serialize};

/// The longest line that is read, in octets.
///
/// A frame of the depth camera has some 20 kB and nothing longer is documented; the bound keeps a
/// server that never ends a line from growing the buffer.
pub const MAX_LINE_OCTETS: usize = 256 * 1024;

/// Octets of an overlong line that are kept to be quoted.
const HEAD_OCTETS: usize = 60;

/// What [`LineSplitter::next_line`] found.
#[derive(Debug, PartialEq, Eq)]
pub enum Framed<'a> {
    /// A line without its line end, never empty.
    Line(&'a [u8]),
    /// A line beyond the bound; it was dropped up to its end, and reading goes on after it.
    Overlong(Problem),
}

/// Cuts a byte stream into lines at CR, LF, CR LF or LF CR; blank lines are skipped.
///
/// The result does not depend on how the stream was cut into reads. Memory is bounded by the line
/// bound and the size of one `push`, if the lines are taken after each.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LineSplitter {
    limit: usize,
    buffer: Vec<u8>,
    /// First octet not yet handed out.
    start: usize,
    /// Octets from `start` on that hold no line end.
    scanned: usize,
    /// Octets of the overlong line being dropped, beyond those still in the buffer.
    dropped: usize,
    head: Vec<u8>,
}

impl Default for LineSplitter {
    fn default() -> Self {
        Self::new(MAX_LINE_OCTETS)
    }
}

impl LineSplitter {
    /// A splitter that drops lines of more than `limit` octets, line end not counted.
    pub fn new(limit: usize) -> Self {
        Self { limit, buffer: Vec::new(), start: 0, scanned: 0, dropped: 0, head: Vec::new() }
    }

    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole line, or `None` until more bytes arrive.
    pub fn next_line(&mut self) -> Option<Framed<'_>> {
        loop {
            let unseen = self.start + self.scanned;
            let Some(offset) = memchr::memchr2(b'\r', b'\n', &self.buffer[unseen..]) else {
                self.scanned = self.buffer.len() - self.start;
                if self.scanned > self.limit {
                    self.drop_unfinished();
                }
                return None;
            };
            let (start, length) = (self.start, self.scanned + offset);
            self.start += length + 1;
            self.scanned = 0;
            if self.dropped + length > self.limit {
                self.keep_head(start, length);
                return Some(Framed::Overlong(self.overlong(length)));
            }
            if length > 0 {
                return Some(Framed::Line(&self.buffer[start..start + length]));
            }
        }
    }

    /// The unfinished rest at the end of the stream: a line without its end is damage, or the
    /// last words of a client that does not end lines. The caller decides.
    pub fn finish(&mut self) -> Option<Framed<'_>> {
        let (start, length) = (self.start, self.buffer.len() - self.start);
        self.start = self.buffer.len();
        self.scanned = 0;
        if self.dropped + length > self.limit {
            self.keep_head(start, length);
            return Some(Framed::Overlong(self.overlong(length)));
        }
        (length > 0).then(|| Framed::Line(&self.buffer[start..start + length]))
    }

    fn keep_head(&mut self, start: usize, length: usize) {
        let wanted = HEAD_OCTETS.saturating_sub(self.head.len()).min(length);
        self.head.extend_from_slice(&self.buffer[start..start + wanted]);
    }

    fn drop_unfinished(&mut self) {
        let length = self.scanned;
        self.keep_head(self.start, length);
        self.dropped += length;
        self.buffer.clear();
        self.start = 0;
        self.scanned = 0;
    }

    fn overlong(&mut self, length: usize) -> Problem {
        let length = std::mem::take(&mut self.dropped) + length;
        let head = std::mem::take(&mut self.head);
        Problem::new(ProblemKind::Overlong { length, limit: self.limit }, 0, &head)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, PartialEq)]
    enum Seen {
        Line(Vec<u8>),
        Overlong(Problem),
    }

    fn own(framed: Framed<'_>) -> Seen {
        match framed {
            Framed::Line(line) => Seen::Line(line.to_vec()),
            Framed::Overlong(problem) => Seen::Overlong(problem),
        }
    }

    fn lines(limit: usize, reads: &[&[u8]]) -> Vec<Seen> {
        let mut splitter = LineSplitter::new(limit);
        let mut seen = Vec::new();
        for read in reads {
            splitter.push(read);
            while let Some(framed) = splitter.next_line() {
                seen.push(own(framed));
            }
            assert!(splitter.buffer.len() <= limit + read.len());
        }
        seen.extend(splitter.finish().map(own));
        seen
    }

    #[test]
    fn all_four_line_ends_and_blank_lines_are_taken() {
        let seen = lines(99, &[b"a\r\nb\n\rc\nd\re\r", b"\n\r\n\r\nf"]);
        let expected: Vec<_> =
            ["a", "b", "c", "d", "e", "f"].map(|l| Seen::Line(l.into())).into_iter().collect();
        assert_eq!(seen, expected);
    }

    #[test]
    fn an_overlong_line_is_reported_with_its_length_and_the_next_one_is_read() {
        let seen = lines(4, &[b"12345678", b"9\nabcd\n", b"12345\n"]);
        let overlong = |length, head: &[u8]| {
            Seen::Overlong(Problem::new(ProblemKind::Overlong { length, limit: 4 }, 0, head))
        };
        let line = Seen::Line(b"abcd".to_vec());
        assert_eq!(seen, [overlong(9, b"123456789"), line, overlong(5, b"12345")]);
    }

    proptest! {
        #[test]
        fn the_cut_of_the_reads_does_not_matter(
            stream in proptest::collection::vec(prop_oneof![Just(b'a'), Just(b'\r'), Just(b'\n'), any::<u8>()], 0..200),
            cuts in proptest::collection::vec(0_usize..200, 0..6),
            limit in 1_usize..20,
        ) {
            let mut cuts: Vec<_> = cuts.into_iter().map(|cut| cut.min(stream.len())).collect();
            cuts.sort_unstable();
            let mut reads = Vec::new();
            let mut from = 0;
            for cut in cuts {
                reads.push(&stream[from..cut]);
                from = cut;
            }
            reads.push(&stream[from..]);
            prop_assert_eq!(lines(limit, &reads), lines(limit, &[&stream]));
        }
    }
}
