//! What holds for any octets: run by the fuzz targets, and over their corpus by the ordinary tests.

use usar_agent::protocol::capture::Capture;
use usar_agent::protocol::{
    Dialect, Framed, LineSplitter, encode_command, encode_message, parse, parse_command,
};

const DIALECTS: [Dialect; 2] = [Dialect::Ut2004, Dialect::Udk];

/// Problems of one line: those that are noted, and the reason why it is unknown.
const MOST_PROBLEMS: usize = 17;

/// Nothing panics, problems are bounded, and whatever was read is written as one line.
///
/// That a message reads back as itself holds only on the decimal grid and for segments in a
/// server's order; properties test it there.
#[allow(dead_code, reason = "each fuzz target includes this file and uses one function")]
pub fn line(line: &[u8]) {
    let message = parse(line);
    let command = parse_command(line);
    assert!(message.problems.len() <= MOST_PROBLEMS);
    assert!(command.problems.len() <= MOST_PROBLEMS);
    Dialect::of_line(line);
    for dialect in DIALECTS {
        parse(one_line(&encode_message(&message.message, dialect)));
        parse_command(one_line(&encode_command(&command.command, dialect)));
    }
    capture(line);
}

/// The cut does not matter, and lines beyond the bound do not stop the next ones.
///
/// The first four octets are the bound and the cuts, the rest is the stream.
#[allow(dead_code, reason = "each fuzz target includes this file and uses one function")]
pub fn stream(input: &[u8]) {
    let Some((&[bound, cuts @ ..], stream)) = input.split_first_chunk::<4>() else { return };
    let bound = 1 + usize::from(bound);
    let mut cuts = cuts.map(|cut| usize::from(cut) * (stream.len() + 1) / 256);
    cuts.sort_unstable();
    let [a, b, c] = cuts;
    let pieces = [&stream[..a], &stream[a..b], &stream[b..c], &stream[c..]];
    let whole = lines(bound, &[stream]);
    assert_eq!(lines(bound, &pieces), whole);
    for line in whole.iter().flatten() {
        parse(line);
        parse_command(line);
    }
    capture(stream);
}

/// All lines of a stream, `None` for one beyond the bound.
fn lines(bound: usize, pieces: &[&[u8]]) -> Vec<Option<Vec<u8>>> {
    let own = |framed: Framed<'_>| match framed {
        Framed::Line(line) => Some(line.to_vec()),
        Framed::Overlong(_) => None,
    };
    let mut splitter = LineSplitter::new(bound);
    let mut lines = Vec::new();
    for piece in pieces {
        splitter.push(piece);
        while let Some(framed) = splitter.next_line() {
            lines.push(own(framed));
        }
    }
    lines.extend(splitter.finish().map(own));
    lines
}

/// Every octet that can be seen stands in a line or in a remark.
fn capture(text: &[u8]) {
    let visible = |octets: &[u8]| octets.iter().filter(|octet| **octet > b' ').count();
    let capture = Capture::read(text);
    let in_lines: usize = capture.lines.iter().map(|line| visible(&line.octets)).sum();
    let in_remarks: usize = capture
        .remarks
        .iter()
        .map(|remark| remark.text.chars().filter(|character| *character > ' ').count())
        .sum();
    assert_eq!(in_lines + in_remarks, visible(text));
}

fn one_line(written: &[u8]) -> &[u8] {
    let line = written.strip_suffix(b"\r\n").expect("a line ends with CR LF");
    assert!(!line.iter().any(|octet| matches!(octet, b'\r' | b'\n')));
    line
}
