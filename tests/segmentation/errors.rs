//! Readings whose errors are not each their own, as those of real scanners.

use super::robustness::room;
use super::scanner::{Noise, Scan, Scanner, scan};
use super::world::{Random, World, pose};
use nalgebra::{Rotation3, Vector3};
use std::collections::BTreeMap;
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{ReadingErrors, SegmentationConfig, Segmenter};

/// Share of the cells of each true surface of 400 cells and more that its largest region covers, the
/// least of them, and the errors that were told.
fn least_cover(scan: &Scan, grid: &PointGrid) -> (f64, ReadingErrors) {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let result = segmenter.segment(grid);
    let mut shared: BTreeMap<usize, BTreeMap<u16, usize>> = BTreeMap::new();
    for (&truth, &label) in scan.truth.iter().zip(&result.labels) {
        *shared.entry(truth).or_default().entry(label).or_default() += 1;
    }
    let mut least = 1.0_f64;
    for (&truth, labels) in &shared {
        let all: usize = labels.values().sum();
        if truth != 0 && all >= 400 {
            let most = labels.iter().filter(|(label, _)| **label != 0).map(|(_, &n)| n).max();
            least = least.min(most.unwrap_or(0) as f64 / all as f64);
        }
    }
    (least, segmenter.errors())
}

/// The points where a scanner says they are whose readings were `ranges`.
fn told_by(scanner: &Scanner, ranges: &[f64]) -> PointGrid {
    let points = scanner.rays.iter().zip(ranges).map(|((origin, ray), &range)| {
        let p = origin + ray * range;
        [p.x as f32, p.y as f32, p.z as f32]
    });
    PointGrid::new(scanner.rows, scanner.columns, points.collect())
}

#[test]
fn tilts_that_are_off_are_told_from_ranges() {
    let nominal = Scanner::nodding(180, 91, [-40.0, 40.0], [60.0, -60.0], [0.0, 0.0]);
    for sigma_deg in [0.0_f64, 0.7] {
        // A tilt that swings about where it should be, and comes back within some ten rows.
        let (mut random, mut off, mut actual) = (Random(7), 0.0, nominal.clone());
        for row in actual.rays.chunks_mut(91) {
            off = 0.8 * off + 0.6 * sigma_deg.to_radians() * random.normal();
            let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), off);
            for (_, ray) in row {
                *ray = turn * *ray;
            }
        }
        let view = pose([0.0, 0.0, 1.0], 0.0, 0.0, 0.1);
        let scan = scan(&room(), &view, &actual, Noise::of(0.005), &mut random);
        let (least, errors) = least_cover(&scan, &told_by(&nominal, &scan.ranges));
        // Rows that are off together still part surfaces: only without them all are whole.
        assert!(sigma_deg > 0.0 || least > 0.8, "{least:.2}, {errors:?}");
        let told_deg = errors.angle_rad.to_degrees();
        assert!(
            told_deg >= 0.4 * sigma_deg && told_deg <= 1.5 * sigma_deg,
            "{sigma_deg}° taken for {told_deg:.2}°"
        );
    }
}

#[test]
fn depth_whose_errors_are_alike_over_pixels_leaves_walls_whole() {
    const REACH: isize = 4;
    let camera = Scanner::pinhole(180, 240, 500.0);
    let view = pose([0.0, 0.0, 1.0], 0.0, 0.1, 0.4);
    let exact = Noise { dropouts: 0.0, ..Noise::of(0.0) };
    let mut random = Random(3);
    let scan = scan(&room(), &view, &camera, exact, &mut random);
    let white: Vec<f64> = (0..180 * 240).map(|_| random.normal()).collect();
    let ranges: Vec<f64> = (0..180_isize * 240)
        .map(|cell| {
            let (row, column) = (cell / 240, cell % 240);
            let mut sum = 0.0;
            for r in row - REACH..=row + REACH {
                for c in column - REACH..=column + REACH {
                    let at = r.rem_euclid(180) * 240 + c.rem_euclid(240);
                    sum += white[at as usize];
                }
            }
            // Of unit variance, alike over nine pixels, and as a triangulating camera's over range.
            let error = sum / (2 * REACH + 1) as f64;
            let range = scan.ranges[cell as usize];
            range + 1.5e-3 * range * range * error
        })
        .collect();
    let (least, errors) = least_cover(&scan, &told_by(&camera, &ranges));
    assert!(least > 0.8, "{least:.2}, {errors:?}");
    assert!(errors.patch > 4.0 && errors.run > 2.0, "{errors:?}");
    let told = errors.noise.sigma_m(2.0) / 6e-3;
    assert!((0.5..1.6).contains(&told), "{told:.2} of the noise, {errors:?}");
}

#[test]
fn the_edges_of_a_stair_are_no_errors_that_readings_have_in_common() {
    let mut world = World::default();
    world.room([-1.5, -1.6, 6.0, 1.6], 3.4);
    for k in 0..9_u8 {
        let (x, z) = (1.5 + 0.28 * f64::from(k), 0.17 * f64::from(k));
        world.patch([x, -1.0, z], [0.0, 2.0, 0.0], [0.0, 0.0, 0.17]);
        world.patch([x, -1.0, z + 0.17], [0.28, 0.0, 0.0], [0.0, 2.0, 0.0]);
    }
    let scanner = Scanner::nodding(220, 131, [-25.0, 29.75], [65.0, -65.0], [0.0, 0.0]);
    let view = pose([0.0, 0.0, 0.8], 0.0, 0.0, 0.0);
    for (seed, sigma_m) in [(1, 0.003), (2, 0.003), (3, 0.01), (4, 0.02)] {
        let scan = scan(&world, &view, &scanner, Noise::of(sigma_m), &mut Random(seed));
        let mut segmenter = Segmenter::new(SegmentationConfig::default());
        segmenter.segment(&scan.grid);
        let errors = segmenter.errors();
        assert_eq!((errors.common, errors.inflation), (0.0, 1.0), "{sigma_m}: {errors:?}");
        let told = errors.noise.sigma_m(2.5) / sigma_m;
        assert!((0.9..1.2).contains(&told), "{sigma_m}: {told:.2} of the noise");
    }
}
