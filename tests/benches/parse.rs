//! Reading a 181-beam laser line: the typed message of `protocol::parse`, beside the numbers alone
//! by nom's `double` and by the standard parser.
//!
//! `cargo bench --bench parse` first runs the three in turn, round by round, so that a machine that
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

const LINES: usize = 1000;
const ROUNDS: usize = 31;

/// Reads all lines and gives back a sum that depends on them.
type Reader = fn(&[Vec<u8>]) -> f64;

/// Laser lines as a UT2004 server writes them, `beams` ranges of 0.5–19.5 m.
fn laser_lines(beams: usize) -> Vec<Vec<u8>> {
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
             {{FOV 3.1415}} {{Range {}}}",
            ranges.join(",")
        )
        .into_bytes()
    };
    (0..LINES).map(line).collect()
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

fn by_message(lines: &[Vec<u8>]) -> f64 {
    lines.iter().map(|line| black_box(scan(line)).ranges_m[0]).sum()
}

fn by_nom_double(lines: &[Vec<u8>]) -> f64 {
    use nom::bytes::complete::tag;
    use nom::combinator::opt;
    use nom::error::Error;
    use nom::multi::fold_many0;
    use nom::number::complete::double;
    use nom::sequence::terminated;
    let sum = |line: &Vec<u8>| {
        let number = terminated(double::<&[u8], Error<&[u8]>>, opt(tag(&b","[..])));
        let mut numbers = fold_many0(number, || 0.0, |sum, value| sum + value);
        numbers.parse(list(line)).expect("all of it is numbers").1
    };
    lines.iter().map(sum).sum()
}

fn by_standard_parser(lines: &[Vec<u8>]) -> f64 {
    let sum = |line: &Vec<u8>| -> f64 {
        let text = std::str::from_utf8(list(line)).expect("digits are text");
        text.split(',').map(|number| number.parse::<f64>().expect("a number")).sum()
    };
    lines.iter().map(sum).sum()
}

fn every_number_is_bit_equal(lines: &[Vec<u8>]) {
    for line in lines {
        let text = std::str::from_utf8(list(line)).expect("digits are text");
        let expected = text.split(',').map(|number| number.parse::<f64>().expect("a number"));
        assert!(scan(line).ranges_m.into_iter().map(f64::to_bits).eq(expected.map(f64::to_bits)));
    }
    println!("{} numbers: each has the bits of the standard parser", lines.len() * 181);
}

/// Allocations for one line.
fn allocations(beams: usize) -> usize {
    let lines = laser_lines(beams);
    let region = Region::new(ALLOCATOR);
    black_box(parse(&lines[0]));
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

fn interleaved(lines: &[Vec<u8>]) {
    let octets: usize = lines.iter().map(Vec::len).sum();
    let runs: [(&str, Reader); 3] = [
        ("protocol::parse", by_message),
        ("nom double", by_nom_double),
        ("standard parser", by_standard_parser),
    ];
    let mut times = vec![Vec::new(); runs.len()];
    for round in 0..ROUNDS + 2 {
        for (times, (_, run)) in times.iter_mut().zip(runs) {
            let elapsed = time(|| run(black_box(lines)));
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
            octets as f64 / median / 1e6,
            median / lines.len() as f64 * 1e6,
            medians[1] / median,
        );
    }
}

fn main() {
    let lines = laser_lines(181);
    every_number_is_bit_equal(&lines);
    no_number_allocates();
    interleaved(&lines);

    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("laser_line");
    group.throughput(Throughput::Bytes(lines.iter().map(|line| line.len() as u64).sum()));
    group.bench_function("message", |b| b.iter(|| by_message(black_box(&lines))));
    group.bench_function("nom_double", |b| b.iter(|| by_nom_double(black_box(&lines))));
    group.bench_function("standard", |b| b.iter(|| by_standard_parser(black_box(&lines))));
    group.finish();
    criterion.final_summary();
}
