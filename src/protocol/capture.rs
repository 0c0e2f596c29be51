//! Server lines out of captured text: what a client printed while it was connected.
//!
//! Such text is the server's stream cut where the client's reads cut it, each piece printed with a
//! line feed of its own, and the client's remarks in between. The pieces are put together again; the
//! remarks are counted and kept apart. No octet is lost: each stands in a line or in a remark.
//!
//! Where the server's CR LF survived beside the printed LF, it alone ends a line. Where it did not
//! (a text editor, a shell), a line ends when its braces are balanced and no further segment
//! follows. What cannot be told for certain is decided so:
//!
//! - text that begins with a server's verb, or with any upper-case word and a brace, begins a line;
//! - a client's own command (`DRIVE {…}`) is a remark;
//! - inside a line, text without braces goes on with the line unless it reads like a sentence: two
//!   lower-case words after its first, or any word in the middle of a number.

use super::splitter::MAX_LINE_OCTETS;
use super::text;
use serde::{Deserialize, Serialize};

/// Captured text, sorted.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// Server lines in order, each whole as far as the text allows.
    pub lines: Vec<CapturedLine>,
    /// Everything else that is not blank, in order.
    pub remarks: Vec<Remark>,
}

/// One line of the server.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CapturedLine {
    /// The text line on which it begins, from 1.
    pub text_line: usize,
    /// The line without its end, ready for [`parse`](super::parse).
    pub octets: Vec<u8>,
    /// How many pieces it was put together from.
    pub pieces: usize,
}

/// Text that is no part of a server line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Remark {
    /// The text line on which it stands, from 1.
    pub text_line: usize,
    /// The remark without its line end.
    pub text: String,
}

impl Capture {
    /// Sorts captured text.
    pub fn read(captured: &[u8]) -> Self {
        let pieces = pieces(captured);
        let mut reader = Reader {
            capture: Self::default(),
            pending: None,
            ends_survived: pieces.iter().any(|piece| piece.cr)
                && pieces.iter().any(|piece| !piece.cr && !piece.octets.is_empty()),
        };
        for piece in pieces {
            reader.take(piece);
        }
        reader.flush();
        reader.capture
    }

    /// How many lines had been cut.
    pub fn rejoined(&self) -> usize {
        self.lines.iter().filter(|line| line.pieces > 1).count()
    }
}

/// Text up to a line feed.
struct Piece<'a> {
    text_line: usize,
    octets: &'a [u8],
    /// Whether a carriage return stood before the line feed.
    cr: bool,
}

fn pieces(captured: &[u8]) -> Vec<Piece<'_>> {
    let end = if captured.contains(&b'\n') { b'\n' } else { b'\r' };
    let rows = captured.split(|octet| *octet == end).enumerate();
    rows.map(|(index, row)| {
        let cr = row.last() == Some(&b'\r');
        let octets = if cr { &row[..row.len() - 1] } else { row };
        let octets = octets.strip_prefix(b"\r").unwrap_or(octets);
        Piece { text_line: index + 1, octets, cr }
    })
    .collect()
}

struct Reader {
    capture: Capture,
    pending: Option<CapturedLine>,
    /// Whether CR LF ends lines of the server and LF alone does not.
    ends_survived: bool,
}

impl Reader {
    fn take(&mut self, piece: Piece<'_>) {
        if let Some(mut line) = self.pending.take() {
            let length = line.octets.len() + piece.octets.len();
            if goes_on(&line.octets, piece.octets) && length <= MAX_LINE_OCTETS {
                line.octets.extend_from_slice(piece.octets);
                line.pieces += usize::from(!piece.octets.is_empty());
                self.settle(line, &piece);
                return;
            }
            if is_remark(&line.octets, piece.octets) {
                self.remark(piece.text_line, piece.octets);
                self.pending = Some(line);
                return;
            }
            self.emit(line);
        }
        let (before, rest) = split_prefix(piece.octets);
        self.remark(piece.text_line, before);
        if rest.is_empty() {
            return;
        }
        let line = CapturedLine { text_line: piece.text_line, octets: rest.to_vec(), pieces: 1 };
        self.settle(line, &piece);
    }

    /// Emits a line that has ended, or keeps it for what follows.
    fn settle(&mut self, line: CapturedLine, piece: &Piece<'_>) {
        if self.ends_survived && piece.cr { self.emit(line) } else { self.pending = Some(line) }
    }

    fn flush(&mut self) {
        if let Some(line) = self.pending.take() {
            self.emit(line);
        }
    }

    fn emit(&mut self, line: CapturedLine) {
        if verb_end(&line.octets).is_some() {
            self.capture.lines.push(line);
        } else {
            self.remark(line.text_line, &line.octets);
        }
    }

    fn remark(&mut self, text_line: usize, octets: &[u8]) {
        if !text::trim(octets).is_empty() {
            self.capture.remarks.push(Remark { text_line, text: text::from_wire(octets) });
        }
    }
}

const SERVER_VERBS: [&[u8]; 11] =
    [b"SEN", b"STA", b"MISSTA", b"ASTA", b"NFO", b"GEO", b"CONF", b"RES", b"EFF", b"DIE", b"MIS"];

/// A client that prints what it sends prints these.
const CLIENT_VERBS: [&[u8]; 20] = [
    b"INIT",
    b"DRIVE",
    b"MULTIDRIVE",
    b"MISPKG",
    b"ACT",
    b"SET",
    b"GETGEO",
    b"GETCONF",
    b"GETSTARTPOSES",
    b"GETPATHNODES",
    b"GETCLOSESTPATHNODE",
    b"TRACE",
    b"CAMERA",
    b"PAUSE",
    b"CONTROL",
    b"MOVE",
    b"GOTO",
    b"TEST",
    b"GETSS",
    b"GETOBS",
];

/// Where the verb of a server's line ends, if `octets` begin one.
fn verb_end(octets: &[u8]) -> Option<usize> {
    let end = octets.iter().take_while(|octet| octet.is_ascii_uppercase()).count();
    let (verb, after) = octets.split_at(end);
    let brace = text::trim(after).first() == Some(&b'{');
    let known = SERVER_VERBS.contains(&verb);
    let bare = known && text::trim(after).is_empty();
    (end >= 2 && (brace || bare) && !CLIENT_VERBS.contains(&verb)).then_some(end)
}

/// Whether `octets` may be the first part of a server's verb, cut off.
fn begins_verb(octets: &[u8]) -> bool {
    !octets.is_empty() && SERVER_VERBS.iter().any(|verb| verb.starts_with(octets))
}

/// Cuts a remark off the front of a server's line: `data: SEN {…}`.
fn split_prefix(octets: &[u8]) -> (&[u8], &[u8]) {
    let trimmed = octets.trim_ascii_start();
    if verb_end(trimmed).is_some() || begins_verb(trimmed) {
        return octets.split_at(octets.len() - trimmed.len());
    }
    let brace = memchr::memchr(b'{', octets).unwrap_or(octets.len());
    let words = octets[..brace].iter().enumerate().filter(|(at, octet)| {
        octet.is_ascii_uppercase() && *at > 0 && !octets[at - 1].is_ascii_alphanumeric()
    });
    for (at, _) in words {
        if let Some(end) = verb_end(&octets[at..])
            && SERVER_VERBS.contains(&&octets[at..at + end])
        {
            return octets.split_at(at);
        }
    }
    (octets, &[])
}

/// Whether a line's last segment is open.
fn is_open(line: &[u8]) -> bool {
    matches!(line.iter().rev().find(|octet| matches!(octet, b'{' | b'}')), Some(b'{'))
}

/// Whether `piece` is the next part of `line`.
fn goes_on(line: &[u8], piece: &[u8]) -> bool {
    let next = text::trim(piece);
    if next.is_empty() {
        return true;
    }
    if verb_end(line).is_none() || !line.contains(&b'{') {
        // A verb that was cut: the two together must begin a line, or still be able to.
        let mut joined = line.to_vec();
        joined.extend_from_slice(piece);
        return verb_end(&joined).is_some() || begins_verb(&joined);
    }
    if !is_open(line) {
        return next.starts_with(b"{");
    }
    match piece.iter().find(|octet| matches!(octet, b'{' | b'}')) {
        Some(brace) => *brace == b'}',
        None => !is_sentence(line, piece),
    }
}

/// Whether `piece`, printed while `line` was open, is a remark and the line goes on after it.
fn is_remark(line: &[u8], piece: &[u8]) -> bool {
    let (_, rest) = split_prefix(piece);
    rest.is_empty() && (is_open(line) || verb_end(line).is_none())
}

/// Whether `piece`, printed while a segment of `line` was open, can be no part of that segment.
fn is_sentence(line: &[u8], piece: &[u8]) -> bool {
    let is_list = |word: &[u8]| {
        word.iter().all(|octet| octet.is_ascii_digit() || matches!(octet, b'.' | b',' | b'-'))
    };
    let last = line.rsplit(|octet| matches!(octet, b' ' | b'\t')).next().unwrap_or_default();
    let letters = |word: &[u8]| word.iter().filter(|octet| octet.is_ascii_alphabetic()).count();
    if !last.is_empty() && is_list(last) && !piece.starts_with(b" ") {
        return text::words(piece).any(|word| letters(word) > 1);
    }
    // Keys and names are capitalised; the first word may be the end of one.
    let lower = |word: &&[u8]| letters(word) > 1 && word[0].is_ascii_lowercase();
    text::words(piece).skip(1).filter(lower).count() > 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn lines(captured: &str) -> Vec<String> {
        let capture = Capture::read(captured.as_bytes());
        capture.lines.iter().map(|line| text::from_wire(&line.octets)).collect()
    }

    fn remarks(captured: &str) -> Vec<String> {
        Capture::read(captured.as_bytes()).remarks.into_iter().map(|remark| remark.text).collect()
    }

    #[test]
    fn pieces_are_joined_and_remarks_kept_apart_when_line_ends_survived() {
        let captured = "attempting to connect\nNFO {Level x}\r\n\nSEN {Type Sonar} {Name \n\
                        sending a drive message\nF1 Range 2.5}\r\nSEN {Range 1.0,2.\n5,3.0}\r\n\n";
        assert_eq!(
            lines(captured),
            ["NFO {Level x}", "SEN {Type Sonar} {Name F1 Range 2.5}", "SEN {Range 1.0,2.5,3.0}"]
        );
        assert_eq!(remarks(captured), ["attempting to connect", "sending a drive message"]);
        assert_eq!(Capture::read(captured.as_bytes()).rejoined(), 2);
    }

    #[test]
    fn without_carriage_returns_balanced_braces_end_a_line() {
        let captured = "SEN {Time 1.0} {Type\n Odometry}\n {Pose 1,2,3}\nSTA {Time 2.0}\ndone\n";
        assert_eq!(
            lines(captured),
            ["SEN {Time 1.0} {Type Odometry} {Pose 1,2,3}", "STA {Time 2.0}"]
        );
        assert_eq!(remarks(captured), ["done"]);
    }

    #[test]
    fn a_verb_may_be_cut_and_a_remark_may_stand_before_it() {
        assert_eq!(lines("S\nEN {A 1}\r\n\nMISS\nTA {B 2}\r\n"), ["SEN {A 1}", "MISSTA {B 2}"]);
        assert_eq!(lines("received: STA {A 1}\nDRIVE {Left 1.0}\n"), ["STA {A 1}"]);
        assert_eq!(
            remarks("received: STA {A 1}\nDRIVE {Left 1.0}\n"),
            ["received: ", "DRIVE {Left 1.0}"]
        );
    }

    #[test]
    fn a_line_that_never_ends_is_handed_out_as_it_is() {
        assert_eq!(lines("SEN {Range 1.0,2.\nSEN {A 1}\n"), ["SEN {Range 1.0,2.", "SEN {A 1}"]);
    }

    proptest! {
        #[test]
        fn a_cut_stream_gives_the_lines_of_the_uncut_one(
            ranges in proptest::collection::vec(0_u32..99_999, 1..40),
            cuts in proptest::collection::vec(1_usize..400, 0..12),
        ) {
            let list: Vec<_> = ranges.iter().map(|r| format!("{:.4}", f64::from(*r) / 1e4)).collect();
            let sent = [
                "NFO {Gametype BotDeathMatch} {Level DM-USAR_yellow_250} {TimeLimit 0}".to_owned(),
                format!("SEN {{Time 5086.04}} {{Type RangeScanner}} {{Range {}}}", list.join(",")),
                "SEN {Type Encoder} {Name ECLeft Tick -26} {Name ECRight Tick -26}".to_owned(),
            ];
            let stream: String = sent.iter().map(|line| format!("{line}\r\n")).collect();
            let mut printed = String::new();
            for (at, octet) in stream.chars().enumerate() {
                if cuts.contains(&at) {
                    printed.push('\n');
                }
                printed.push(octet);
            }
            printed.push('\n');
            prop_assert_eq!(lines(&printed), sent);
            prop_assert!(remarks(&printed).is_empty());
        }

        #[test]
        fn no_octet_is_lost(captured in "([a-zA-Z{} 0-9.\\r\\n]|SEN |STA \\{|\\r\\n){0,80}") {
            let capture = Capture::read(captured.as_bytes());
            let visible = |octets: &[u8]| octets.iter().filter(|o| !o.is_ascii_whitespace()).count();
            let kept: usize = capture.lines.iter().map(|line| visible(&line.octets)).sum::<usize>()
                + capture.remarks.iter().map(|remark| visible(remark.text.as_bytes())).sum::<usize>();
            prop_assert_eq!(kept, visible(captured.as_bytes()));
        }
    }
}
