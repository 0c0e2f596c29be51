//! Reading a 181-beam laser line: the typed message of `protocol::parse`, beside the numbers alone
//! by nom's `double`, by the standard parser and by a careful loop for fixed decimals.
//!
//! All read the same text, one buffer of lines as it comes from a socket.
//! `cargo bench --bench parse` first runs the four in turn, round by round, so that a machine that
//! slows down slows all of them, and prints medians and ratios; then Criterion's own statistics.
//! Before any of it, every number is compared bit by bit with the standard parser and allocations
//! are counted.

use criterion::{Criterion, Throughput};
use nom::Parser;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::hint::black_box;
use std::time::{Duration, Instant};
use usar_agent::protocol::message::{Sen, sen::RangeScanner};
use usar_agent::protocol::{Message, parse};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const LINES: usize = 4000;
const ROUNDS: usize = 31;

/// Reads all lines of a text and gives back a sum that depends on them.
type Reader = fn(&[u8]) -> f64;

/// `count` laser lines as a UT2004 server writes them, `beams` ranges of 0.5–19.5 m.
fn laser_lines(count: usize, beams: usize) -> Vec<u8> {
    let mut state = 12_345_u64;
    let mut range = || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        format!("{:.4}", 0.5 + (state >> 40) as f64 / f64::from(1 << 24) * 19.0)
    };
    let line = |index: usize| {
        let ranges: Vec<_> = (0..beams).map(|_| range()).collect();
        let time = 395.38 + index as f64 * 0.2;
        format!(
            "SEN {{Time {time:.2}}} {{Type RangeScanner}} {{Name Scanner1}} {{Resolution 0.0174}} \
             {{FOV 3.1415}} {{Range {}}}\r\n",
            ranges.join(",")
        )
    };
    (0..count).map(line).collect::<String>().into_bytes()
}

/// The lines of a text without their ends.
fn lines(text: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut from = 0;
    memchr::memchr_iter(b'\n', text).map(move |end| {
        let line = &text[from..end - 1];
        from = end + 1;
        line
    })
}

fn scan(line: &[u8]) -> RangeScanner {
    match parse(line).message {
        Message::Sen(Sen::RangeScanner(scan)) => scan,
        other => panic!("a laser line was read as {other:?}"),
    }
}

/// The text between `{Range ` and its brace.
fn list(line: &[u8]) -> &[u8] {
    let start = memchr::memmem::find(line, b"{Range ").expect("every line has ranges") + 7;
    &line[start..line.len() - 1]
}

fn by_message(text: &[u8]) -> f64 {
    lines(text).map(|line| black_box(scan(line)).ranges_m[0]).sum()
}

fn by_nom_double(text: &[u8]) -> f64 {
    use nom::bytes::complete::tag;
    use nom::combinator::opt;
    use nom::error::Error;
    use nom::multi::fold_many0;
    use nom::number::complete::double;
    use nom::sequence::terminated;
    let sum = |line| {
        let number = terminated(double::<&[u8], Error<&[u8]>>, opt(tag(&b","[..])));
        let mut numbers = fold_many0(number, || 0.0, |sum, value| sum + value);
        numbers.parse(list(line)).expect("all of it is numbers").1
    };
    lines(text).map(sum).sum()
}

fn by_standard_parser(text: &[u8]) -> f64 {
    let sum = |line| -> f64 {
        let text = std::str::from_utf8(list(line)).expect("digits are text");
        text.split(',').map(|number| number.parse::<f64>().expect("a number")).sum()
    };
    lines(text).map(sum).sum()
}

/// Digits and points octet by octet: what a careful loop reaches that knows the form and makes no
/// message.
fn by_fixed_decimals(text: &[u8]) -> f64 {
    const POWERS: [f64; 8] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7];
    let sum = |line| {
        let (mut sum, mut mantissa, mut decimals, mut behind_point) = (0.0, 0_u64, 0, 0);
        for octet in list(line) {
            let digit = octet.wrapping_sub(b'0');
            if digit < 10 {
                mantissa = mantissa * 10 + u64::from(digit);
                decimals += behind_point;
            } else if *octet == b'.' {
                behind_point = 1;
            } else {
                sum += mantissa as f64 / POWERS[decimals & 7];
                (mantissa, decimals, behind_point) = (0, 0, 0);
            }
        }
        sum + mantissa as f64 / POWERS[decimals & 7]
    };
    lines(text).map(sum).sum::<f64>()
}

fn every_number_is_bit_equal(text: &[u8]) {
    let mut count = 0;
    for line in lines(text) {
        let text = std::str::from_utf8(list(line)).expect("digits are text");
        let expected = text.split(',').map(|number| number.parse::<f64>().expect("a number"));
        let ranges_m = scan(line).ranges_m;
        count += ranges_m.len();
        assert!(ranges_m.into_iter().map(f64::to_bits).eq(expected.map(f64::to_bits)));
    }
    println!("{count} numbers: each has the bits of the standard parser");
}

/// Allocations for one line.
fn allocations(beams: usize) -> usize {
    let text = laser_lines(1, beams);
    let region = Region::new(ALLOCATOR);
    black_box(parse(text.trim_ascii_end()));
    region.change().allocations
}

fn no_number_allocates() {
    let [few, many] = [181, 3620].map(allocations);
    println!("allocations: {few} for a line of 181 beams, {many} for one of 3620");
    assert_eq!(few, many, "allocations must not grow with the number of beams");
}

#[expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
fn time(run: impl FnOnce() -> f64) -> Duration {
    let start = Instant::now();
    black_box(run());
    start.elapsed()
}

fn interleaved(text: &[u8]) {
    let runs: [(&str, Reader); 4] = [
        ("protocol::parse", by_message),
        ("nom double", by_nom_double),
        ("standard parser", by_standard_parser),
        ("fixed decimals", by_fixed_decimals),
    ];
    let mut times = vec![Vec::new(); runs.len()];
    for round in 0..ROUNDS + 2 {
        for (times, (_, run)) in times.iter_mut().zip(runs) {
            let elapsed = time(|| run(black_box(text)));
            if round >= 2 {
                times.push(elapsed.as_secs_f64());
            }
        }
    }
    let medians: Vec<f64> = times
        .iter_mut()
        .map(|times| {
            times.sort_by(f64::total_cmp);
            times[times.len() / 2]
        })
        .collect();
    for ((name, _), median) in runs.iter().zip(&medians) {
        println!(
            "{name:16} {:7.1} MB/s {:6.2} µs/line, {:.2} × nom double",
            text.len() as f64 / median / 1e6,
            median / LINES as f64 * 1e6,
            medians[1] / median,
        );
    }
}

fn main() {
    let text = laser_lines(LINES, 181);
    every_number_is_bit_equal(&text);
    no_number_allocates();
    interleaved(&text);

    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("laser_line");
    group.throughput(Throughput::Bytes(text.len() as u64));
    group.bench_function("message", |b| b.iter(|| by_message(black_box(&text))));
    group.bench_function("nom_double", |b| b.iter(|| by_nom_double(black_box(&text))));
    group.bench_function("standard", |b| b.iter(|| by_standard_parser(black_box(&text))));
    group.bench_function("fixed_decimals", |b| b.iter(|| by_fixed_decimals(black_box(&text))));
    group.finish();
    criterion.final_summary();
}
