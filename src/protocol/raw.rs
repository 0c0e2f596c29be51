//! A line as it stood on the wire: verb and ordered segments, nothing interpreted, nothing lost.

use super::problem::Problem;
use super::{grammar, number, text};
use serde::{Deserialize, Serialize};

/// The text between one pair of braces, outer blanks removed.
///
/// The first word is the key and the rest the value; inner blanks stand as they arrived. A keyless
/// list, such as the poses of a start-pose reply, is read with [`Segment::body`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment(String);

impl Segment {
    /// `{key value}`, or `{key}` if the value is empty.
    pub fn new(key: &str, value: &str) -> Self {
        Self(if value.is_empty() { key.to_owned() } else { format!("{key} {value}") })
    }

    /// The segment whose whole text is `body`.
    pub fn from_body(body: &str) -> Self {
        Self(body.trim_matches([' ', '\t']).to_owned())
    }

    pub(super) fn from_wire(body: &[u8]) -> Self {
        Self(text::from_wire(body))
    }

    /// All text between the braces.
    pub fn body(&self) -> &str {
        &self.0
    }

    /// The first word; empty in `{}`.
    pub fn key(&self) -> &str {
        self.0.split([' ', '\t']).next().unwrap_or_default()
    }

    /// What follows the first word; empty in `{None}`.
    pub fn value(&self) -> &str {
        self.0[self.key().len()..].trim_matches([' ', '\t'])
    }

    /// Whether the key is `key`, upper and lower case being equal.
    pub fn is(&self, key: &str) -> bool {
        self.key().eq_ignore_ascii_case(key)
    }
}

/// A whole line, owned: what an unknown message or command is kept as.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RawLine {
    /// The text before the first brace.
    pub verb: String,
    /// All segments in wire order, repeated keys included.
    pub segments: Vec<Segment>,
}

impl RawLine {
    /// Cuts one line (without its line end); damage is added to `problems`.
    pub fn parse(line: &[u8], problems: &mut Vec<Problem>) -> Self {
        let mut segments = Vec::new();
        let verb = grammar::split(line, problems, |body| {
            segments.push(Segment::from_wire(body.text));
        });
        Self { verb: text::from_wire(verb), segments }
    }

    /// Whether the verb is `verb`, upper and lower case being equal.
    pub fn is(&self, verb: &str) -> bool {
        self.verb.eq_ignore_ascii_case(verb)
    }

    /// The value of the first segment with this key, in any case.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.segments.iter().find(|segment| segment.is(key)).map(Segment::value)
    }

    /// The values of all segments with this key, in any case and in wire order.
    pub fn get_all<'a>(&'a self, key: &'a str) -> impl Iterator<Item = &'a str> {
        self.segments.iter().filter(move |segment| segment.is(key)).map(Segment::value)
    }

    /// The first segment with this key as a number.
    pub fn number(&self, key: &str) -> Option<f64> {
        let mut wire = Vec::new();
        text::push_wire(&mut wire, self.get(key)?);
        number::whole(&wire)
    }

    /// The line with CR LF; one blank stands before each segment.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        text::push_wire(&mut out, &self.verb);
        for segment in &self.segments {
            out.extend_from_slice(if out.is_empty() { b"{" } else { b" {" });
            text::push_wire(&mut out, segment.body());
            out.push(b'}');
        }
        out.extend_from_slice(b"\r\n");
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(line: &str) -> RawLine {
        RawLine::parse(line.as_bytes(), &mut Vec::new())
    }

    #[test]
    fn keys_are_found_in_any_case_and_the_first_wins() {
        let line = raw("sta {Type x} {ID 7} {id 8} {Mem two  words}");
        assert!(line.is("STA"));
        assert_eq!(line.get("Id"), Some("7"));
        assert_eq!(line.get_all("iD").collect::<Vec<_>>(), ["7", "8"]);
        assert_eq!(line.get("MEM"), Some("two  words"));
        assert_eq!(line.number("id"), Some(7.0));
    }

    #[test]
    fn keyless_lists_and_lines_without_a_verb_are_kept_whole() {
        let line = raw("{End}");
        assert_eq!((line.verb.as_str(), line.segments[0].body()), ("", "End"));
        assert_eq!(line.encode(), b"{End}\r\n");
        let points = raw("SEN {1.0,2.0,0.5 1.0,2.1,0.5}");
        assert_eq!(points.segments[0].body(), "1.0,2.0,0.5 1.0,2.1,0.5");
    }
}
