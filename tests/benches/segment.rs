//! Segmentation of one scan by both structures, for several sizes of the grid.
//!
//! `cargo bench --bench segment`. Before the times, allocations of the second and later scans are
//! counted: there are none.

#[path = "../segmentation/scanner.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod scanner;
#[path = "../segmentation/scenes.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod scenes;
#[path = "../segmentation/world.rs"]
#[allow(dead_code, reason = "shared with the tests, which use all of it")]
mod world;

use criterion::{BenchmarkId, Criterion, Throughput};
use scanner::{Noise, Scanner, scan};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use std::alloc::System;
use std::hint::black_box;
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{Method, SegmentationConfig, Segmenter};
use world::Random;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

fn grid(rows: usize, columns: usize) -> PointGrid {
    let scene = scenes::scene(0);
    let scanner = Scanner::nodding(rows, columns, [-25.0, 29.75], [65.0, -65.0], [0.0, 0.0]);
    scan(&scene.world, &scene.pose, &scanner, Noise::of(0.01), &mut Random(1)).grid
}

fn segmenter(method: Method) -> Segmenter {
    Segmenter::new(SegmentationConfig { method, ..SegmentationConfig::default() })
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let mut group = criterion.benchmark_group("segment");
    for (rows, columns) in [(110, 66), (220, 131), (440, 262), (880, 524)] {
        let grid = grid(rows, columns);
        group.throughput(Throughput::Elements((rows * columns) as u64));
        for (name, method) in [("sticks", Method::Sticks), ("paper", Method::Paper)] {
            let mut segmenter = segmenter(method);
            segmenter.segment(&grid);
            let region = Region::new(ALLOCATOR);
            segmenter.segment(&grid);
            println!("{name} {rows} x {columns}: {} allocations", region.change().allocations);
            let id = BenchmarkId::new(name, format!("{rows}x{columns}"));
            group.bench_with_input(id, &grid, |bench, grid| {
                bench.iter(|| black_box(segmenter.segment(grid)).surfaces.len());
            });
        }
    }
    group.finish();
    criterion.final_summary();
}
