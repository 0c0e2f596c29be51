//! Allocations in the steady state. A binary of its own with one test, as the counter sees all
//! threads.

#[path = "segmentation/scanner.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod scanner;
#[path = "segmentation/scenes.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod scenes;
#[path = "segmentation/world.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod world;

use scanner::{Noise, Scanner, scan};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{Method, SegmentationConfig, Segmenter};
use world::Random;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

#[test]
fn segmenting_scans_of_a_size_allocates_nothing_once_the_buffers_have_grown() {
    let grids: Vec<PointGrid> = (0..4)
        .map(|index| {
            let scene = scenes::scene(index);
            let noise = Noise::of(0.01);
            scan(&scene.world, &scene.pose, &Scanner::paper(), noise, &mut Random(index)).grid
        })
        .collect();
    for method in [Method::Sticks, Method::Paper] {
        let mut segmenter =
            Segmenter::new(SegmentationConfig { method, ..SegmentationConfig::default() });
        // Twice, as buffers are handed from one result to the next.
        for grid in grids.iter().chain(&grids) {
            segmenter.segment(grid);
        }
        let region = Region::new(ALLOCATOR);
        for grid in &grids {
            segmenter.segment(grid);
        }
        let change = region.change();
        assert_eq!(
            (change.allocations, change.reallocations),
            (0, 0),
            "{method:?}: {change:?} for {} scans",
            grids.len()
        );
    }
}
