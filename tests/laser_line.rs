//! Allocations for a laser line. A binary of its own with one test, as the counter sees all threads.

use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::hint::black_box;
use usar_agent::protocol::parse;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

fn line(beams: usize, range: &str) -> Vec<u8> {
    let ranges = vec![range; beams].join(",");
    format!(
        "SEN {{Time 2202.98}} {{Type RangeScanner}} {{Name Scanner1}} {{Resolution 0.0174}} \
         {{FOV 3.1415}} {{Range {ranges}}}"
    )
    .into_bytes()
}

#[test]
fn a_laser_line_allocates_as_often_with_twenty_times_the_beams() {
    // The second form is too long for the short way.
    for range in ["12.3456", "12.34567890123"] {
        let counts = [181, 3620].map(|beams| {
            let line = line(beams, range);
            let region = Region::new(ALLOCATOR);
            let parsed = black_box(parse(black_box(&line)));
            let change = region.change();
            assert!(parsed.problems.is_empty());
            (change.allocations, change.reallocations)
        });
        assert_eq!(counts[0], counts[1], "{range}");
        assert_eq!(counts[0].1, 0, "the list is made in its size");
    }
}
