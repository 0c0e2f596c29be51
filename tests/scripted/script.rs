//! The script's text and its steps.

use std::path::Path;
use std::time::Duration;
use usar_agent::protocol::RawLine;

/// One step of a script.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    Send(String),
    Bytes(Vec<u8>),
    Cut(usize, String),
    Rest,
    Expect(RawLine),
    Answer(RawLine, String),
    Wait(Duration),
    Quiet(Duration),
    Stall(Option<Duration>),
    Close,
    Accept,
    Clock { start_cs: i64, step_cs: i64 },
    Tick,
    Repeat(usize, Vec<NumberedStep>),
}

/// A step and the line of the file on which it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct NumberedStep {
    pub line: usize,
    pub step: Step,
}

/// A script, read.
#[derive(Clone, Debug, PartialEq)]
pub struct Script {
    pub name: String,
    pub steps: Vec<NumberedStep>,
}

impl Script {
    /// Reads `scripts/NAME.script`; panics with file and line if it is not a script.
    pub fn load(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/scripted/scripts");
        let path = folder.join(name).with_extension("script");
        let text =
            std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        Self::parse(name, &text)
    }

    /// Reads a script's text.
    pub fn parse(name: &str, text: &str) -> Self {
        // Each open `repeat` holds its count and the steps before it.
        let mut open: Vec<(usize, usize, Vec<NumberedStep>)> = Vec::new();
        let mut steps = Vec::new();
        for (index, row) in text.lines().enumerate() {
            let line = index + 1;
            let row = row.trim();
            let (verb, rest) = row.split_once(' ').unwrap_or((row, ""));
            let fail = |why: &str| -> ! { panic!("{name}.script:{line}: {why}: {row}") };
            match verb {
                "" => {}
                _ if verb.starts_with('#') => {}
                "repeat" => {
                    let count = rest.parse().unwrap_or_else(|_| fail("expected a count"));
                    open.push((line, count, std::mem::take(&mut steps)));
                }
                "end" => {
                    let Some((line, count, before)) = open.pop() else { fail("nothing to end") };
                    let step = Step::Repeat(count, std::mem::replace(&mut steps, before));
                    steps.push(NumberedStep { line, step });
                }
                _ => {
                    let step = step(verb, rest).unwrap_or_else(|why| fail(&why));
                    steps.push(NumberedStep { line, step });
                }
            }
        }
        assert!(open.is_empty(), "{name}.script: a repeat without an end");
        Self { name: name.to_owned(), steps }
    }
}

fn step(verb: &str, rest: &str) -> Result<Step, String> {
    Ok(match verb {
        "send" => Step::Send(rest.to_owned()),
        "bytes" => Step::Bytes(unescaped(rest)?),
        "cut" => {
            let (count, line) = rest.split_once(' ').ok_or("expected a count and a line")?;
            Step::Cut(count.parse().map_err(|_| "expected a count")?, line.to_owned())
        }
        "rest" => Step::Rest,
        "expect" => Step::Expect(pattern(rest)),
        "answer" => {
            let (pattern_text, line) = rest.split_once("=>").ok_or("expected PATTERN => LINE")?;
            Step::Answer(pattern(pattern_text), line.trim().to_owned())
        }
        "wait" => Step::Wait(duration(rest)?),
        "quiet" => Step::Quiet(duration(rest)?),
        "stall" if rest.is_empty() => Step::Stall(None),
        "stall" => Step::Stall(Some(duration(rest)?)),
        "close" => Step::Close,
        "accept" => Step::Accept,
        "clock" => {
            let (start, step) = rest.split_once(' ').ok_or("expected a time and a step")?;
            let hundredths = |text: &str| -> Result<i64, String> {
                let seconds: f64 = text.parse().map_err(|_| format!("no time: {text}"))?;
                Ok((seconds * 100.0).round() as i64)
            };
            Step::Clock { start_cs: hundredths(start)?, step_cs: hundredths(step)? }
        }
        "tick" => Step::Tick,
        _ => return Err("no such step".to_owned()),
    })
}

fn pattern(text: &str) -> RawLine {
    RawLine::parse(text.as_bytes(), &mut Vec::new())
}

fn duration(text: &str) -> Result<Duration, String> {
    let millis = match text.strip_suffix("ms") {
        Some(millis) => millis.parse().ok(),
        None => text.strip_suffix('s').and_then(|s| s.parse::<u64>().ok()).map(|s| s * 1000),
    };
    millis.map(Duration::from_millis).ok_or(format!("expected a time such as 200ms or 2s: {text}"))
}

fn unescaped(text: &str) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let mut octets = text.bytes();
    while let Some(octet) = octets.next() {
        if octet != b'\\' {
            out.push(octet);
            continue;
        }
        out.push(match octets.next() {
            Some(b'r') => b'\r',
            Some(b'n') => b'\n',
            Some(b't') => b'\t',
            Some(b'\\') => b'\\',
            Some(b'x') => {
                let digits: String = octets.by_ref().take(2).map(char::from).collect();
                u8::from_str_radix(&digits, 16).map_err(|_| format!("no octet: \\x{digits}"))?
            }
            other => return Err(format!("no escape: {other:?}")),
        });
    }
    Ok(out)
}

/// Whether a client's line is what a pattern asks for.
pub fn matches(pattern: &RawLine, line: &RawLine) -> bool {
    line.is(&pattern.verb)
        && pattern.segments.iter().all(|wanted| {
            line.get_all(wanted.key())
                .any(|value| wanted.value().is_empty() || value == wanted.value())
        })
}

#[test]
fn scripts_are_read_step_by_step() {
    let script = Script::parse(
        "t",
        "# a comment\nsend STA {A 1}\nrepeat 2\n  bytes a\\r\\x41\n  wait 20ms\nend\nexpect DRIVE {Left}\nclose\n",
    );
    let steps: Vec<_> = script.steps.into_iter().map(|step| step.step).collect();
    let NumberedStep { step: inner, line } = match &steps[1] {
        Step::Repeat(2, inner) => inner[0].clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!((inner, line), (Step::Bytes(b"a\rA".to_vec()), 4));
    assert_eq!(steps[3], Step::Close);
}

#[test]
#[should_panic(expected = "t.script:2: expected a time such as 200ms or 2s: soon: wait soon")]
fn a_bad_step_is_named_with_its_line() {
    Script::parse("t", "tick\nwait soon\n");
}

#[test]
fn a_pattern_asks_for_keys_and_values_in_any_case() {
    let line = pattern("drive {Left 1.0} {Right -1.0}");
    assert!(matches(&pattern("DRIVE {left} {Right -1.0}"), &line));
    assert!(!matches(&pattern("DRIVE {Left 2.0}"), &line));
    assert!(!matches(&pattern("INIT"), &line));
}
