//! Sparse, unevenly spaced fans of rows, as a robot takes them of the ground ahead of it.

use super::scanner::{Noise, Scan, Scanner, scan};
use super::world::{Random, World, pose};
use nalgebra::{Point3, Rotation3, Vector3};
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{
    PlanePatch, Segmentation, SegmentationConfig, Segmenter, Shape, Surface,
};

const COLUMNS: usize = 131;
/// What each row's tilt is off by, a standard deviation.
const TILT_SIGMA_DEG: f64 = 0.05;
/// Noise of the ranges.
const SIGMA_M: f64 = 0.002;

/// A few rows of the walls, then denser ones of the ground.
pub const GROUND_DEG: [f64; 43] = [
    -13.1, -11.5, -9.3, -7.2, -5.6, -4.1, -2.5, -0.4, 1.2, 2.4, 3.7, 4.3, 4.55, 4.83, 5.07, 5.35,
    5.73, 6.16, 6.78, 7.36, 8.16, 8.96, 9.93, 11.41, 12.5, 13.28, 13.72, 14.1, 14.66, 15.13, 15.71,
    16.48, 17.17, 18.0, 19.01, 19.9, 20.82, 21.47, 22.53, 24.63, 26.27, 28.4, 30.03,
];

/// Rows of 131 beams of 1° at the given tilts.
fn fan(tilts_deg: &[f64]) -> Scanner {
    let mut rays = Vec::new();
    for tilt_deg in tilts_deg {
        let tilt = Rotation3::from_axis_angle(&Vector3::y_axis(), tilt_deg.to_radians());
        for column in 0..COLUMNS {
            let (sin, cos) = (65.0 - column as f64).to_radians().sin_cos();
            rays.push((Point3::origin(), tilt * Vector3::new(cos, sin, 0.0)));
        }
    }
    Scanner { rows: tilts_deg.len(), columns: COLUMNS, rays }
}

/// A scan from `height_m` above the ground whose rows are each off by an angle of their own, as the
/// scanner tells it.
pub fn fan_over(world: &World, tilts_deg: &[f64], height_m: f64, seed: u64) -> (Scan, PointGrid) {
    let nominal = fan(tilts_deg);
    let (mut random, mut actual) = (Random(seed), nominal.clone());
    for row in actual.rays.chunks_mut(COLUMNS) {
        let off = TILT_SIGMA_DEG.to_radians() * random.normal();
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), off);
        for (_, ray) in row {
            *ray = turn * *ray;
        }
    }
    let noise = Noise { dropouts: 0.0, ..Noise::of(SIGMA_M) };
    let view = pose([0.0, 0.0, height_m], 0.0, 0.0, 0.0);
    let scan = scan(world, &view, &actual, noise, &mut random);
    let points = nominal.rays.iter().zip(&scan.ranges).map(|((origin, ray), &range)| {
        let p = origin + ray * range;
        [p.x as f32, p.y as f32, p.z as f32]
    });
    let grid = PointGrid::new(nominal.rows, COLUMNS, points.collect())
        .with_row_sigmas(vec![TILT_SIGMA_DEG.to_radians() as f32; nominal.rows]);
    (scan, grid)
}

/// The planes of a result, with what it says of them.
pub fn planes(result: &Segmentation) -> Vec<(&Surface, &PlanePatch)> {
    let planes = result.surfaces.iter().filter_map(|surface| match &surface.shape {
        Shape::Plane(patch) => Some((surface, patch)),
        _ => None,
    });
    planes.collect()
}

/// A hall with a slab of 8 cm on its floor, ahead to the right.
fn slab() -> World {
    let mut world = World::default();
    world.room([-2.0, -4.0, 9.0, 5.0], 60.0);
    world.standing(3.1, -0.6, [2.4, 2.2, 0.08], 0.2);
    world
}

#[test]
fn noise_is_told_within_the_rows_of_an_uneven_fan() {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    for seed in 0..8 {
        let (_, grid) = fan_over(&slab(), &GROUND_DEG, 0.6, seed);
        segmenter.segment(&grid);
        let errors = segmenter.errors();
        let told = errors.noise.sigma_m(3.0) / SIGMA_M;
        assert!((0.75..1.3).contains(&told), "{seed}: {told:.2} of the noise");
        // What is known of the tilts is not asked of the ranges again.
        assert!(errors.angle_rad == 0.0 && errors.patch == 1.0, "{seed}: {errors:?}");
    }
}

#[test]
fn a_slab_of_8_cm_is_not_the_floor_beside_it() {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    for seed in 0..8 {
        let (_, grid) = fan_over(&slab(), &GROUND_DEG, 0.6, seed);
        let planes = planes(segmenter.segment(&grid));
        for height_m in [0.0, 0.08] {
            let found = planes.iter().any(|(surface, patch)| {
                let plane = patch.plane();
                let offset = plane.offset_m + 0.6 - height_m;
                let tilt = plane.normal.xy().norm();
                surface.points > 400 && offset.abs() < 0.005 && tilt < 0.005
            });
            assert!(found, "{seed}: none at {height_m} m");
        }
    }
}

/// Rows from the ceiling to the ground.
fn wide_deg() -> Vec<f64> {
    (0..40).map(|row| -20.0 + 1.0 * f64::from(row) + 0.3 * f64::from(row % 3)).collect()
}

/// The surfaces that have most of the cells of a true one, as far as these have a label.
fn most_of<'a>(scan: &Scan, result: &'a Segmentation, solid: usize) -> Vec<&'a Surface> {
    let cells_of = |surface: &Surface, of_solid: bool| {
        let labels = scan.truth.iter().zip(&result.labels);
        labels.filter(|(t, l)| **l == surface.id && (**t == solid || !of_solid)).count()
    };
    let is_most = |surface: &&Surface| 2 * cells_of(surface, true) > cells_of(surface, false);
    result.surfaces.iter().filter(is_most).collect()
}

#[test]
fn a_column_a_few_beams_wide_is_no_plane() {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    for (distance, seed) in [3.0, 5.0, 7.0, 9.0, 12.0, 14.0].into_iter().zip(0..) {
        let mut world = World::default();
        world.room([-2.0, -8.0, 22.0, 8.0], 60.0);
        world.drum([distance, 0.3, 0.0], [0.0, 0.0, 1.0], 0.25, 6.0);
        let column = world.solids.len() - 2;
        let (scan, grid) = fan_over(&world, &wide_deg(), 0.6, seed);
        let result = segmenter.segment(&grid);
        for surface in most_of(&scan, result, column) {
            let is_plane = matches!(surface.shape, Shape::Plane(_));
            assert!(!is_plane, "{distance} m: {} points are a plane", surface.points);
        }
    }
}

#[test]
fn a_wall_seen_edge_on_by_one_beam_is_no_plane() {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let mut world = World::default();
    world.room([-2.0, -4.0, 9.0, 5.0], 60.0);
    // The end of a thin wall: its side is seen at less than a degree.
    world.standing(4.0, 0.0, [4.0, 0.1, 2.0], 0.012);
    let (_, grid) = fan_over(&world, &wide_deg(), 0.6, 1);
    for (surface, patch) in planes(segmenter.segment(&grid)) {
        let plane = patch.plane();
        let cosine = plane.offset_m.abs() / surface.centroid.coords.norm();
        assert!(cosine > 0.05, "{} points under a cosine of {cosine:.3}", surface.points);
        assert!(surface.rms_m < 0.03, "{} points of rms {:.3} m", surface.points, surface.rms_m);
    }
}

#[test]
fn what_lies_far_behind_a_wall_at_the_end_of_the_fan_is_none_of_it() {
    let mut world = World::default();
    world.patch([14.0, -20.0, -5.0], [0.0, 40.0, 0.0], [0.0, 0.0, 15.0]);
    let (scan, grid) = fan_over(&world, &wide_deg(), 0.6, 5);
    let mut points = grid.points().to_vec();
    let behind = [10, 11, 60, 61, 62, 110];
    for cell in behind {
        points[cell] = points[cell].map(|v| 1.09 * v);
    }
    let rows = grid.rows();
    let grid =
        PointGrid::new(rows, COLUMNS, points).with_row_sigmas(vec![0.16_f32.to_radians(); rows]);
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let result = segmenter.segment(&grid);
    let wall = most_of(&scan, result, 1);
    assert!(wall.iter().all(|surface| surface.rms_m < 0.05), "{:.3} m", wall[0].rms_m);
    assert!(behind.iter().all(|&cell| result.labels[cell] == 0));
}
