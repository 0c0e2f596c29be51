//! The writer of lines: it formats, and never rounds a value that lies on the wire's decimal grid.

use super::raw::Segment;
use super::text;
use super::wire::WirePose;
use crate::time::Stamp;
use std::io::Write;

const NANOS_PER_SECOND: u64 = 1_000_000_000;

/// One line being written.
#[derive(Debug)]
pub(super) struct LineWriter {
    out: Vec<u8>,
    tight: bool,
}

impl LineWriter {
    pub(super) fn new(verb: &str) -> Self {
        let mut out = Vec::with_capacity(128);
        text::push_wire(&mut out, verb);
        Self { out, tight: false }
    }

    /// Leaves out the blank before the next segment, as the UDK server does in places.
    pub(super) fn tight(&mut self) -> &mut Self {
        self.tight = true;
        self
    }

    fn open(&mut self) {
        if !std::mem::take(&mut self.tight) && !self.out.is_empty() {
            self.out.push(b' ');
        }
        self.out.push(b'{');
    }

    fn formatted(&mut self, text: std::fmt::Arguments<'_>) {
        self.out.write_fmt(text).expect("a Vec takes all bytes");
    }

    /// `{body}` as it stands.
    pub(super) fn bare(&mut self, body: &str) -> &mut Self {
        self.open();
        text::push_wire(&mut self.out, body);
        self.out.push(b'}');
        self
    }

    /// `{body` without its closing brace, as the UDK server writes in one place.
    pub(super) fn unclosed(&mut self, body: &str) -> &mut Self {
        self.open();
        text::push_wire(&mut self.out, body);
        self
    }

    /// `{key value}`, the value written by `value`.
    fn segment(&mut self, key: &str, value: impl FnOnce(&mut Self)) -> &mut Self {
        self.open();
        text::push_wire(&mut self.out, key);
        self.out.push(b' ');
        value(self);
        self.out.push(b'}');
        self
    }

    pub(super) fn text(&mut self, key: &str, value: &str) -> &mut Self {
        self.segment(key, |w| text::push_wire(&mut w.out, value))
    }

    /// `{key value}` unless the value is empty.
    pub(super) fn text_unless_empty(&mut self, key: &str, value: &str) -> &mut Self {
        if value.is_empty() { self } else { self.text(key, value) }
    }

    pub(super) fn optional_text(&mut self, key: &str, value: Option<&str>) -> &mut Self {
        match value {
            Some(value) => self.text(key, value),
            None => self,
        }
    }

    pub(super) fn integer(&mut self, key: &str, value: i64) -> &mut Self {
        self.segment(key, |w| w.formatted(format_args!("{value}")))
    }

    pub(super) fn optional_integer(&mut self, key: &str, value: Option<i64>) -> &mut Self {
        match value {
            Some(value) => self.integer(key, value),
            None => self,
        }
    }

    /// A bool as servers write it.
    pub(super) fn server_flag(&mut self, key: &str, value: bool) -> &mut Self {
        self.text(key, if value { "True" } else { "False" })
    }

    /// A bool as clients must write it: the UDK server knows only lower-case `true`.
    pub(super) fn client_flag(&mut self, key: &str, value: bool) -> &mut Self {
        self.text(key, if value { "true" } else { "false" })
    }

    pub(super) fn number(&mut self, key: &str, value: f64, decimals: usize) -> &mut Self {
        self.segment(key, |w| w.formatted(format_args!("{value:.decimals$}")))
    }

    pub(super) fn optional_number(
        &mut self,
        key: &str,
        value: Option<f64>,
        decimals: usize,
    ) -> &mut Self {
        match value {
            Some(value) => self.number(key, value, decimals),
            None => self,
        }
    }

    /// The shortest decimal that reads back as the same value, never with an exponent.
    pub(super) fn shortest(&mut self, key: &str, value: f64) -> &mut Self {
        self.segment(key, |w| w.formatted(format_args!("{value}")))
    }

    /// As [`Self::shortest`], with a decimal point in any case.
    pub(super) fn real(&mut self, key: &str, value: f64) -> &mut Self {
        if value.fract() == 0.0 { self.number(key, value, 1) } else { self.shortest(key, value) }
    }

    pub(super) fn list(&mut self, key: &str, values: &[f64], decimals: usize) -> &mut Self {
        self.segment(key, |w| w.push_list(values, decimals))
    }

    /// Numbers separated by commas, each the shortest that reads back as the same value.
    pub(super) fn shortest_list(&mut self, key: &str, values: &[f64]) -> &mut Self {
        self.segment(key, |w| {
            for (index, value) in values.iter().enumerate() {
                w.formatted(format_args!("{}{value}", if index > 0 { "," } else { "" }));
            }
        })
    }

    fn push_list(&mut self, values: &[f64], decimals: usize) {
        for (index, value) in values.iter().enumerate() {
            if index > 0 {
                self.out.push(b',');
            }
            self.formatted(format_args!("{value:.decimals$}"));
        }
    }

    /// `{Location …} {Orientation …}`.
    pub(super) fn pose(&mut self, pose: &WirePose, decimals: usize) -> &mut Self {
        self.list("Location", &pose.location, decimals).list(
            "Orientation",
            &pose.orientation,
            decimals,
        )
    }

    /// `{Time t}` if there is one, rounded half up to `decimals` (at most 9).
    pub(super) fn time(&mut self, time: Option<Stamp>, decimals: u32) -> &mut Self {
        let Some(Stamp(nanos)) = time else { return self };
        let unit = NANOS_PER_SECOND / 10_u64.pow(decimals);
        let steps = (nanos.unsigned_abs() + unit / 2) / unit;
        let per_second = NANOS_PER_SECOND / unit;
        let (seconds, fraction) = (steps / per_second, steps % per_second);
        let sign = if nanos < 0 { "-" } else { "" };
        let width = decimals as usize;
        self.segment("Time", |w| w.formatted(format_args!("{sign}{seconds}.{fraction:0width$}")))
    }

    /// A compound segment: `{key value key value …}` from texts that hold no blanks.
    pub(super) fn compound(&mut self, pairs: &[(&str, &str)]) -> &mut Self {
        let body: Vec<_> = pairs.iter().map(|(key, value)| format!("{key} {value}")).collect();
        self.bare(&body.join(" "))
    }

    pub(super) fn extra(&mut self, segments: &[Segment]) -> &mut Self {
        for segment in segments {
            self.bare(segment.body());
        }
        self
    }

    /// The line with CR LF.
    pub(super) fn finish(mut self) -> Vec<u8> {
        self.out.extend_from_slice(b"\r\n");
        self.out
    }
}

/// Numbers separated by commas with a fixed count of decimals.
pub(super) fn joined(values: &[f64], decimals: usize) -> String {
    let mut out = String::new();
    for (index, value) in values.iter().enumerate() {
        if index > 0 {
            out.push(',');
        }
        out.push_str(&format!("{value:.decimals$}"));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(write: impl FnOnce(&mut LineWriter)) -> String {
        let mut writer = LineWriter::new("X");
        write(&mut writer);
        String::from_utf8(writer.finish()).unwrap()
    }

    #[test]
    fn times_have_the_decimals_asked_for_and_no_float_error() {
        let time = Some(Stamp::from_seconds(5085.82));
        assert_eq!(
            written(|w| {
                w.time(time, 2);
            }),
            "X {Time 5085.82}\r\n"
        );
        assert_eq!(
            written(|w| {
                w.time(time, 4);
            }),
            "X {Time 5085.8200}\r\n"
        );
        assert_eq!(
            written(|w| {
                w.time(Some(Stamp(-1_500_000_000)), 1);
            }),
            "X {Time -1.5}\r\n"
        );
        assert_eq!(
            written(|w| {
                w.time(None, 2);
            }),
            "X\r\n"
        );
    }

    #[test]
    fn client_numbers_have_a_point_and_no_exponent() {
        assert_eq!(
            written(|w| {
                w.real("Left", 1.0);
            }),
            "X {Left 1.0}\r\n"
        );
        assert_eq!(
            written(|w| {
                w.real("Left", -0.35);
            }),
            "X {Left -0.35}\r\n"
        );
        let tiny = written(|w| {
            w.real("Left", 1e-7);
        });
        assert_eq!(tiny, "X {Left 0.0000001}\r\n");
    }
}
