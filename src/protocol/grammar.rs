//! One line cut into its verb and segments, borrowed from the line.
//!
//! ```text
//! line    = verb *( *SP segment ) *SP
//! segment = "{" *SP [ key [ 1*SP value ] ] *SP "}"
//! ```
//!
//! Every octet string has a reading: damage is reported and the next brace resynchronises.

use super::problem::{Problem, ProblemKind, note};
use super::text;
use nom::IResult;
use nom::Parser;
use nom::character::complete::char as brace;
use nom::sequence::preceded;

/// The text of one segment without its braces and outer blanks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body<'a> {
    /// Octets from the beginning of the line to the opening brace.
    pub at: usize,
    pub text: &'a [u8],
    /// Whether the closing brace was there; if not, the text may have been cut anywhere.
    pub closed: bool,
}

/// Everything up to the next brace of either kind, or to the end.
fn up_to_brace(input: &[u8]) -> IResult<&[u8], &[u8]> {
    let end = memchr::memchr2(b'{', b'}', input).unwrap_or(input.len());
    Ok((&input[end..], &input[..end]))
}

/// An opening brace and the text after it.
fn opened(input: &[u8]) -> IResult<&[u8], &[u8]> {
    preceded(brace('{'), up_to_brace).parse(input)
}

/// Cuts `line` and returns its verb: the text before the first brace, trimmed.
///
/// Each segment goes to `segment` in order; a segment that is not closed ends at the next opening
/// brace or at the end of the line.
pub(super) fn split<'a>(
    line: &'a [u8],
    problems: &mut Vec<Problem>,
    mut segment: impl FnMut(Body<'a>),
) -> &'a [u8] {
    let (mut rest, before) = up_to_brace(line).unwrap_or((&[], line));
    let verb = text::trim(before);
    loop {
        let at = line.len() - rest.len();
        match opened(rest) {
            Ok((after, body)) => {
                let closed = after.first() == Some(&b'}');
                segment(Body { at, text: text::trim(body), closed });
                if closed {
                    rest = &after[1..];
                } else {
                    note(problems, Problem::new(ProblemKind::SegmentNotClosed, at, &line[at..]));
                    rest = after;
                }
            }
            Err(_) if rest.is_empty() => return verb,
            Err(_) => {
                note(problems, Problem::new(ProblemKind::StrayClose, at, rest));
                rest = &rest[1..];
            }
        }
        let (after, between) = up_to_brace(rest).unwrap_or((&[], rest));
        if !text::trim(between).is_empty() {
            let at = line.len() - rest.len();
            note(problems, Problem::new(ProblemKind::StrayText, at, text::trim(between)));
        }
        rest = after;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(line: &str) -> (String, Vec<String>, Vec<ProblemKind>) {
        let (mut problems, mut segments) = (Vec::new(), Vec::new());
        let verb =
            split(line.as_bytes(), &mut problems, |b| segments.push(text::from_wire(b.text)));
        (text::from_wire(verb), segments, problems.into_iter().map(|p| p.kind).collect())
    }

    #[test]
    fn blanks_are_free_round_braces_and_none_are_needed() {
        let (verb, segments, problems) = cut("Com2     {  With      88     }{        More  }    ");
        assert_eq!(verb, "Com2");
        assert_eq!(segments, ["With      88", "More"]);
        assert!(problems.is_empty());
        assert_eq!(cut("Com1{BasMan Rulez}{Hello 2}").1, ["BasMan Rulez", "Hello 2"]);
    }

    #[test]
    fn an_open_segment_ends_at_the_next_brace() {
        let (_, segments, problems) = cut("STA {Location 1,2,3 {Memory {text} {Rotation 0,0,0}");
        assert_eq!(segments, ["Location 1,2,3", "Memory", "text", "Rotation 0,0,0"]);
        assert_eq!(problems, [ProblemKind::SegmentNotClosed, ProblemKind::SegmentNotClosed]);
    }

    #[test]
    fn damage_is_reported_once_per_place() {
        assert_eq!(cut("SEN {A 1").2, [ProblemKind::SegmentNotClosed]);
        assert_eq!(cut("SEN {A 1}} x {B 2}").2, [ProblemKind::StrayClose, ProblemKind::StrayText]);
        assert_eq!(cut("").0, "");
    }
}
