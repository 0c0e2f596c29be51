//! What holds for every message, every command and every octet string.

use super::strategies::{command, message};
use proptest::prelude::*;
use usar_agent::protocol::{
    Dialect, LineSplitter, encode_command, encode_message, parse, parse_command,
};

const DIALECTS: [Dialect; 2] = [Dialect::Ut2004, Dialect::Udk];

fn dialect() -> impl Strategy<Value = Dialect> {
    prop::sample::select(&DIALECTS[..])
}

fn without_end(line: &[u8]) -> &[u8] {
    line.strip_suffix(b"\r\n").expect("lines end with CR LF")
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_message_on_the_decimal_grid_reads_back_as_itself(
        (dialect, message) in dialect().prop_flat_map(|d| (Just(d), message(d)))
    ) {
        let line = encode_message(&message, dialect);
        let parsed = parse(without_end(&line));
        prop_assert_eq!(&parsed.problems, &[], "{}", String::from_utf8_lossy(&line));
        prop_assert_eq!(&parsed.message, &message, "{}", String::from_utf8_lossy(&line));
        prop_assert_eq!(encode_message(&parsed.message, dialect), line);
    }

    #[test]
    fn a_command_reads_back_as_itself(
        (dialect, command) in dialect().prop_flat_map(|d| (Just(d), command(d)))
    ) {
        let line = encode_command(&command, dialect);
        let parsed = parse_command(without_end(&line));
        prop_assert_eq!(&parsed.problems, &[], "{}", String::from_utf8_lossy(&line));
        prop_assert_eq!(&parsed.command, &command, "{}", String::from_utf8_lossy(&line));
    }

    #[test]
    fn a_message_survives_serialisation(
        message in dialect().prop_flat_map(message)
    ) {
        let stored = postcard::to_allocvec(&message).unwrap();
        prop_assert_eq!(postcard::from_bytes::<usar_agent::protocol::Message>(&stored).unwrap(), message);
    }

    #[test]
    fn keys_are_read_in_any_case(message in message(Dialect::Udk)) {
        // Keys only: values are names, and a verb's case is its own test.
        let line = encode_message(&message, Dialect::Udk);
        let swapped = swap_case_of_keys(without_end(&line));
        if !matches!(message, usar_agent::protocol::Message::Unknown(_)) {
            prop_assert_eq!(parse(&swapped).problems, []);
        }
    }
}

/// Each segment's first word with upper and lower case swapped.
fn swap_case_of_keys(line: &[u8]) -> Vec<u8> {
    let mut in_key = false;
    let mut swapped = Vec::new();
    for octet in line {
        in_key = *octet == b'{' || (in_key && *octet != b' ' && *octet != b'}');
        swapped.push(match octet {
            b'a'..=b'z' | b'A'..=b'Z' if in_key => octet ^ 0x20,
            octet => *octet,
        });
    }
    swapped
}

#[test]
fn every_message_written_is_found_again_in_a_stream_cut_anywhere() {
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let stream_of = proptest::collection::vec(message(Dialect::Ut2004), 1..8);
    let cuts = proptest::collection::vec(0_usize..4000, 0..12);
    runner
        .run(&(stream_of, cuts), |(messages, mut cuts)| {
            let stream: Vec<u8> =
                messages.iter().flat_map(|it| encode_message(it, Dialect::Ut2004)).collect();
            cuts.retain(|cut| *cut < stream.len());
            cuts.push(stream.len());
            cuts.sort_unstable();
            let mut splitter = LineSplitter::default();
            let mut read = Vec::new();
            let mut from = 0;
            for cut in cuts {
                splitter.push(&stream[from..cut]);
                from = cut;
                while let Some(usar_agent::protocol::Framed::Line(line)) = splitter.next_line() {
                    read.push(parse(line).message);
                }
            }
            prop_assert_eq!(read, messages);
            Ok(())
        })
        .unwrap();
}
