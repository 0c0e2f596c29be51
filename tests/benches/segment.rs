//! Segmentation of one scan by both structures, for several sizes of the grid.
//!
//! `cargo bench --bench segment`. Before the times, allocations of the second and later scans are
//! counted: there are none. First comes a table of the stages, medians over scans of one size.

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
use std::time::Instant;
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

/// Median times of the stages over repeated scans, in milliseconds, and of the whole.
#[expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
fn stages(segmenter: &mut Segmenter, grid: &PointGrid) -> ([f64; 6], f64) {
    const RUNS: usize = 101;
    let mut spent: [Vec<f64>; 7] = std::array::from_fn(|_| Vec::with_capacity(RUNS));
    for _ in 0..RUNS {
        let start = Instant::now();
        let mut last = start;
        segmenter.segment_observed(grid, &mut |stage| {
            let now = Instant::now();
            spent[stage as usize].push(1e3 * (now - last).as_secs_f64());
            last = now;
        });
        spent[6].push(1e3 * start.elapsed().as_secs_f64());
    }
    let medians = spent.map(|mut times| *times.select_nth_unstable_by(RUNS / 2, f64::total_cmp).1);
    ([0, 1, 2, 3, 4, 5].map(|stage| medians[stage]), medians[6])
}

/// Prints the table of the stages.
fn print_stages() {
    println!(
        "ms                   residual morphology     fill    split      fit     hull    total"
    );
    for (rows, columns) in [(220, 131), (880, 524)] {
        let grid = grid(rows, columns);
        for (name, method) in [("sticks", Method::Sticks), ("paper", Method::Paper)] {
            let (stages, total) = stages(&mut segmenter(method), &grid);
            let [residual, morphology, fill, split, fit, hull] = stages;
            println!(
                "{name:<7} {rows:>4} x {columns:<4} {residual:>10.3} {morphology:>10.3} {fill:>8.3} \
                 {split:>8.3} {fit:>8.3} {hull:>8.3} {total:>8.3}"
            );
        }
    }
}

fn main() {
    print_stages();
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
