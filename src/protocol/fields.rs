//! Segments as a list of key and value from which a message takes what it knows.
//!
//! Compound segments, `{Name F1 Range 2.5}`, are taken apart here, so that a message reads both
//! dialects in the same way. What nobody takes is left over as the message's `extra` segments.

use super::grammar;
use super::number;
use super::problem::{Problem, ProblemKind, note};
use super::raw::Segment;
use super::text;
use super::wire::WirePose;
use crate::time::Stamp;

/// One key with its value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field<'a> {
    /// Octets from the beginning of the line.
    at: usize,
    key: &'a [u8],
    value: &'a [u8],
    /// Key and value as they stand in the segment; for a keyless list all of it.
    pub(super) body: &'a [u8],
    /// Whether the segment had its closing brace. One that had not may be cut in the middle of a
    /// number: nobody finds it, and it is kept as an extra segment.
    closed: bool,
}

/// The fields of a line, or of one repeated group in it, that nobody has taken yet.
#[derive(Debug, Default)]
pub(super) struct Fields<'a> {
    fields: Vec<Field<'a>>,
    pub(super) problems: Vec<Problem>,
}

impl<'a> Fields<'a> {
    /// Cuts `line`; returns the verb and the fields.
    pub(super) fn of_line(line: &'a [u8]) -> (&'a [u8], Self) {
        let mut fields = Vec::with_capacity(8);
        let mut problems = Vec::new();
        let verb = grammar::split(line, &mut problems, |body| push_segment(&mut fields, body));
        (verb, Self { fields, problems })
    }

    pub(super) fn len(&self) -> usize {
        self.fields.len()
    }

    fn position(&self, key: &str) -> Option<usize> {
        let key = key.as_bytes();
        self.fields.iter().position(|field| field.closed && field.key.eq_ignore_ascii_case(key))
    }

    /// Makes segments without a closing brace usable, for the one line that servers write so.
    pub(super) fn trust_unclosed(&mut self) {
        self.fields.iter_mut().for_each(|field| field.closed = true);
        self.problems.retain(|problem| problem.kind != ProblemKind::SegmentNotClosed);
    }

    pub(super) fn has(&self, key: &str) -> bool {
        self.position(key).is_some()
    }

    /// The value of a key without taking it.
    pub(super) fn peek(&self, key: &str) -> Option<&'a [u8]> {
        Some(self.fields[self.position(key)?].value)
    }

    /// Takes the first field with this key.
    pub(super) fn take(&mut self, key: &str) -> Option<&'a [u8]> {
        Some(self.fields.remove(self.position(key)?).value)
    }

    /// Takes the first field that is left, whatever its key.
    pub(super) fn take_first(&mut self) -> Option<Field<'a>> {
        let first = self.fields.iter().position(|field| field.closed)?;
        Some(self.fields.remove(first))
    }

    /// Takes everything that is left and whole, in wire order.
    pub(super) fn take_all(&mut self) -> Vec<Field<'a>> {
        let (whole, cut) = std::mem::take(&mut self.fields).into_iter().partition(|f| f.closed);
        self.fields = cut;
        whole
    }

    /// Takes every field that `wanted` accepts.
    pub(super) fn take_where<T>(
        &mut self,
        mut wanted: impl FnMut(&'a [u8], &'a [u8]) -> Option<T>,
    ) -> Vec<T> {
        let mut taken = Vec::new();
        self.fields.retain(|field| match wanted(field.key, field.value).filter(|_| field.closed) {
            Some(value) => {
                taken.push(value);
                false
            }
            None => true,
        });
        taken
    }

    /// Takes a value that `read` can make something of; another value is a problem and stays.
    fn take_as<T>(
        &mut self,
        key: &str,
        read: impl FnOnce(&'a [u8]) -> Result<T, ProblemKind>,
    ) -> Option<T> {
        let index = self.position(key)?;
        let field = self.fields[index];
        match read(field.value) {
            Ok(value) => {
                self.fields.remove(index);
                Some(value)
            }
            Err(kind) => {
                note(&mut self.problems, Problem::new(kind, field.at, field.body));
                None
            }
        }
    }

    pub(super) fn text(&mut self, key: &str) -> Option<String> {
        self.take(key).map(text::from_wire)
    }

    /// The item's name, or the empty string if the line has none.
    pub(super) fn name(&mut self) -> String {
        self.text("Name").unwrap_or_default()
    }

    pub(super) fn number(&mut self, key: &str) -> Option<f64> {
        let bad = || ProblemKind::NotANumber(key.to_owned());
        self.take_as(key, |value| number::whole(value).ok_or_else(bad))
    }

    pub(super) fn integer(&mut self, key: &str) -> Option<i64> {
        let bad = || ProblemKind::NotAnInteger(key.to_owned());
        self.take_as(key, |value| number::integer(value).ok_or_else(bad))
    }

    pub(super) fn flag(&mut self, key: &str) -> Option<bool> {
        let bad = || ProblemKind::NotABool(key.to_owned());
        self.take_as(key, |value| flag(value).ok_or_else(bad))
    }

    pub(super) fn vector<const N: usize>(&mut self, key: &str) -> Option<[f64; N]> {
        self.take_as(key, |value| {
            number::array(value).map_err(|found| match found {
                None => ProblemKind::NotANumber(key.to_owned()),
                Some(found) => ProblemKind::WrongCount { key: key.to_owned(), found, expected: N },
            })
        })
    }

    /// A client's number as the engine reads it: the longest number at the front, or 0. Anything
    /// but a whole number is noted all the same.
    pub(super) fn engine_number(&mut self, key: &str) -> Option<f64> {
        let bad = || ProblemKind::NotANumber(key.to_owned());
        let read = |value| number::whole(value).ok_or_else(bad);
        let value = self.peek(key)?;
        Some(self.take_as(key, read).unwrap_or_else(|| {
            self.take(key);
            number::engine_number(value)
        }))
    }

    /// A client's whole number as the engine reads it.
    pub(super) fn engine_integer(&mut self, key: &str) -> Option<i64> {
        self.engine_number(key).map(|value| value as i64)
    }

    /// A client's vector as the engine reads it: missing and unreadable parts are 0.
    pub(super) fn engine_vector<const N: usize>(&mut self, key: &str) -> Option<[f64; N]> {
        let value = self.peek(key)?;
        Some(self.vector(key).unwrap_or_else(|| {
            self.take(key);
            let mut parts = value.split(|octet| *octet == b',');
            [(); N].map(|()| parts.next().map_or(0.0, number::engine_number))
        }))
    }

    /// A list of any length, separated by commas.
    pub(super) fn list(&mut self, key: &str) -> Option<Vec<f64>> {
        self.take_as(key, |value| {
            let mut values = Vec::with_capacity(memchr::memchr_iter(b',', value).count() + 1);
            let whole = number::list(value, &mut values);
            if whole { Ok(values) } else { Err(ProblemKind::NotANumber(key.to_owned())) }
        })
    }

    pub(super) fn time(&mut self) -> Option<Stamp> {
        self.number("Time").map(Stamp::from_seconds)
    }

    /// `Location` and `Orientation` together; a lone one is left where it is.
    pub(super) fn pose(&mut self) -> Option<WirePose> {
        if !(self.has("Location") && self.has("Orientation")) {
            return None;
        }
        Some(WirePose {
            location: self.vector("Location")?,
            orientation: self.vector("Orientation")?,
        })
    }

    /// `value`, or the reason why the message cannot be had without it.
    ///
    /// If the key was there with a bad value, that problem has been noted already and is the reason.
    pub(super) fn require<T>(&mut self, key: &str, value: Option<T>) -> Result<T, Problem> {
        value.ok_or_else(|| match self.has(key).then(|| self.problems.pop()).flatten() {
            Some(problem) => problem,
            None => Problem::new(ProblemKind::MissingKey(key.to_owned()), 0, &[]),
        })
    }

    /// Takes everything from the first `leader` on, as one group for each `leader`.
    pub(super) fn groups(&mut self, leader: &str) -> Vec<Fields<'a>> {
        let Some(start) = self.position(leader) else { return Vec::new() };
        let mut groups: Vec<Fields<'a>> = Vec::new();
        for field in self.fields.drain(start..) {
            if field.closed && field.key.eq_ignore_ascii_case(leader.as_bytes()) {
                groups.push(Fields::default());
            }
            if let Some(group) = groups.last_mut() {
                group.fields.push(field);
            }
        }
        groups
    }

    /// As [`Fields::groups`]; fields without any leader make one nameless group if `key` is there.
    pub(super) fn groups_or_all(&mut self, leader: &str, key: &str) -> Vec<Fields<'a>> {
        if !self.has(leader) && self.has(key) {
            return vec![Fields { fields: std::mem::take(&mut self.fields), problems: Vec::new() }];
        }
        self.groups(leader)
    }

    /// Puts back what a group had left, and its problems.
    pub(super) fn absorb(&mut self, group: Fields<'a>) {
        self.fields.extend(group.fields);
        for problem in group.problems {
            note(&mut self.problems, problem);
        }
    }

    /// Reads each group with `read`; a group without its essentials is kept as extra segments.
    pub(super) fn read_groups<T>(
        &mut self,
        groups: Vec<Fields<'a>>,
        mut read: impl FnMut(&mut Fields<'a>) -> Result<T, Problem>,
    ) -> Vec<T> {
        let mut items = Vec::with_capacity(groups.len());
        for mut group in groups {
            let before = group.fields.clone();
            match read(&mut group) {
                Ok(item) => items.push(item),
                Err(problem) => {
                    note(&mut group.problems, problem);
                    group.fields = before;
                }
            }
            self.absorb(group);
        }
        items
    }

    /// All that is left, in wire order.
    pub(super) fn rest(&mut self) -> Vec<Segment> {
        self.fields.drain(..).map(|field| Segment::from_wire(field.body)).collect()
    }
}

/// `true` or `false` in any case; servers write `True`, clients `true`.
pub(super) fn flag(value: &[u8]) -> Option<bool> {
    if value.eq_ignore_ascii_case(b"true") {
        Some(true)
    } else if value.eq_ignore_ascii_case(b"false") {
        Some(false)
    } else {
        None
    }
}

/// Adds a segment as one field, or a compound segment as one field per name and value pair.
///
/// Compound segments begin with `Name` and hold an even number of words, at least four: a lone
/// `{Name two words}` is a name with a blank in it.
fn push_segment<'a>(fields: &mut Vec<Field<'a>>, body: grammar::Body<'a>) {
    let (key, value) = text::split_word(body.text);
    let field = Field { at: body.at, key, value, body: body.text, closed: body.closed };
    if !key.eq_ignore_ascii_case(b"Name") {
        fields.push(field);
        return;
    }
    let words = text::words(value).count();
    if words < 3 || words.is_multiple_of(2) {
        fields.push(field);
        return;
    }
    let mut rest = body.text;
    while !rest.is_empty() {
        let (key, after) = text::split_word(rest);
        let (value, after) = split_value(after);
        let length = value.as_ptr_range().end as usize - rest.as_ptr() as usize;
        fields.push(Field { key, value, body: &rest[..length], ..field });
        rest = after;
    }
}

/// The next word, and the words after it as long as a comma ties them together.
fn split_value(text: &[u8]) -> (&[u8], &[u8]) {
    let (mut value, mut after) = text::split_word(text);
    while value.ends_with(b",") && !after.is_empty() {
        let (next, rest) = text::split_word(after);
        let length = text.len() - after.len() + next.len();
        value = &text[..length];
        after = rest;
    }
    (value, after)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(line: &str) -> Vec<(String, String)> {
        let (_, fields) = Fields::of_line(line.as_bytes());
        let own = |field: &Field<'_>| (text::from_wire(field.key), text::from_wire(field.value));
        fields.fields.iter().map(own).collect()
    }

    fn pairs(expected: &[(&str, &str)]) -> Vec<(String, String)> {
        expected.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect()
    }

    #[test]
    fn compound_segments_are_taken_apart_pair_by_pair() {
        assert_eq!(
            keys("GEO {Type Sonar} {Name F1 Location 0.1,0.2,0 Orientation 0,0,0 Mount HARD}"),
            pairs(&[
                ("Type", "Sonar"),
                ("Name", "F1"),
                ("Location", "0.1,0.2,0"),
                ("Orientation", "0,0,0"),
                ("Mount", "HARD"),
            ])
        );
        assert_eq!(
            keys("SEN {Name Touch Touch False}"),
            pairs(&[("Name", "Touch"), ("Touch", "False")])
        );
    }

    #[test]
    fn a_name_with_blanks_is_no_compound() {
        assert_eq!(keys("SEN {Name two words}"), pairs(&[("Name", "two words")]));
    }

    #[test]
    fn groups_begin_at_each_leader_and_what_they_leave_comes_back() {
        let (_, mut fields) = Fields::of_line(b"X {A 1} {ID 7} {Mem a} {ID 8} {Odd} {Mem b}");
        let groups = fields.groups("id");
        let tags = fields.read_groups(groups, |group| {
            let id = group.text("ID");
            Ok((group.require("ID", id)?, group.text("Mem")))
        });
        let tag = |id: &str, mem: &str| (id.to_owned(), Some(mem.to_owned()));
        assert_eq!(tags, [tag("7", "a"), tag("8", "b")]);
        assert_eq!(fields.rest(), [Segment::new("A", "1"), Segment::new("Odd", "")]);
    }

    #[test]
    fn a_value_that_may_be_cut_is_not_used_but_kept() {
        let (_, mut fields) = Fields::of_line(b"SEN {Name S} {Range 2.1951,2.19");
        assert_eq!(fields.list("Range"), None);
        assert_eq!(fields.problems[0].kind, ProblemKind::SegmentNotClosed);
        fields.take("Name");
        assert_eq!(fields.rest(), [Segment::new("Range", "2.1951,2.19")]);
    }

    #[test]
    fn a_bad_value_is_reported_once_and_the_segment_is_kept() {
        let (_, mut fields) = Fields::of_line(b"X {Battery full}");
        assert_eq!(fields.integer("Battery"), None);
        assert_eq!(fields.problems[0].kind, ProblemKind::NotAnInteger("Battery".to_owned()));
        assert_eq!(fields.rest(), [Segment::new("Battery", "full")]);
    }
}
