//! Scans that are odd, and the same scan in other orders.

use super::campaign::judge;
use super::scanner::{Noise, Scanner, scan};
use super::scenes::scene;
use super::world::{Random, World, pose};
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{Method, SegmentationConfig, Segmenter, Shape};

fn methods() -> [Segmenter; 2] {
    [Method::Sticks, Method::Paper].map(|method| {
        Segmenter::new(SegmentationConfig { method, ..SegmentationConfig::default() })
    })
}

/// A box-shaped room of 6 x 4 x 2.5 m, seen from its middle.
pub fn room() -> World {
    let mut world = World::default();
    world.room([-2.0, -2.0, 4.0, 2.0], 2.5);
    world
}

#[test]
fn grids_without_a_surface_are_ordinary_results() {
    for mut segmenter in methods() {
        for (rows, columns) in [(0, 0), (0, 5), (5, 0), (1, 1), (1, 40), (40, 1), (2, 2), (60, 50)]
        {
            for point in [[f32::NAN; 3], [0.0; 3], [f32::INFINITY; 3], [2.0, 1.0, 0.5]] {
                let grid = PointGrid::new(rows, columns, vec![point; rows * columns]);
                let result = segmenter.segment(&grid);
                assert_eq!(result.labels.len(), rows * columns);
                assert!(
                    result.surfaces.iter().all(|s| s.rms_m.is_finite() && s.rms_m < 0.01),
                    "{rows} x {columns} of {point:?}: {:?}",
                    result.surfaces
                );
            }
        }
    }
}

#[test]
fn a_wall_without_any_noise_is_one_plane() {
    for mut segmenter in methods() {
        let mut world = World::default();
        world.patch([3.0, -4.0, -3.0], [0.0, 8.0, 0.0], [0.0, 0.0, 6.0]);
        let scanner = Scanner::nodding(80, 60, [-10.0, 10.0], [30.0, -30.0], [0.0, 0.0]);
        let noise = Noise { dropouts: 0.0, ..Noise::of(0.0) };
        let scan = scan(&world, &pose([0.0; 3], 0.0, 0.0, 0.0), &scanner, noise, &mut Random(1));
        let result = segmenter.segment(&scan.grid);
        assert_eq!(result.surfaces.len(), 1);
        assert_eq!(result.surfaces[0].points, 80 * 60);
        let Shape::Plane(patch) = &result.surfaces[0].shape else { panic!("no plane") };
        assert!((patch.plane().offset_m.abs() - 3.0).abs() < 1e-4);
        assert!(result.surfaces[0].rms_m < 1e-4);
    }
}

#[test]
fn the_order_of_rows_and_columns_does_not_matter() {
    let scene = scene(4);
    let paper = Scanner::nodding(140, 91, [-25.0, 29.0], [60.0, -60.0], [0.0, 0.0]);
    let mut counts = Vec::new();
    for flips in 0..8 {
        let scanner = paper.reordered(flips & 1 != 0, flips & 2 != 0, flips & 4 != 0);
        let scan = scan(&scene.world, &scene.pose, &scanner, Noise::of(0.01), &mut Random(flips));
        let mut segmenter = Segmenter::new(SegmentationConfig::default());
        let (score, _) = judge(&scan, &scene.world, segmenter.segment(&scan.grid));
        counts.push(score.correct);
        assert!(score.correct + 2 >= score.truths, "order {flips}: {score:?}");
    }
    let spread = counts.iter().max().unwrap() - counts.iter().min().unwrap();
    assert!(spread <= 2, "{counts:?}: the noise of each order is another, the scene is not");
}

#[test]
fn missing_rows_columns_and_scattered_drop_outs_leave_the_room_whole() {
    let scanner = Scanner::nodding(180, 91, [-30.0, 30.0], [60.0, -60.0], [0.0, 0.0]);
    let view = pose([0.0, 0.0, 1.0], 0.0, 0.0, 0.1);
    type Gone = fn(usize, usize, &mut Random) -> bool;
    // A region is 8-connected, so a missing line cuts what it crosses, and ten rows hold at most four.
    let holes: [(&str, usize, Gone); 4] = [
        ("one row", 10, |row, _, _| row == 70),
        ("every tenth row", 18 * 4, |row, _, _| row % 10 == 3),
        ("one column", 10, |_, column, _| column == 40),
        ("a fifth of all", 10, |_, _, random| random.between(0.0, 1.0) < 0.2),
    ];
    for (name, most, gone) in holes {
        let mut random = Random(5);
        let scan = scan(&room(), &view, &scanner, Noise::of(0.01), &mut random);
        let points = scan.grid.points().iter().enumerate().map(|(i, &point)| {
            if gone(i / 91, i % 91, &mut random) { [f32::NAN; 3] } else { point }
        });
        let grid = PointGrid::new(180, 91, points.collect());
        let mut segmenter = Segmenter::new(SegmentationConfig::default());
        let result = segmenter.segment(&grid);
        let labelled = result.labels.iter().filter(|&&label| label != 0).count();
        let valid = grid.points().iter().filter(|p| p[0].is_finite()).count();
        assert!(labelled * 100 >= valid * 97, "{name}: {labelled} of {valid}");
        // Floor, ceiling, the wall ahead and two sides.
        let large = result.surfaces.iter().filter(|s| s.points > 150).count();
        assert!((5..=most).contains(&large), "{name}: {large} surfaces");
        assert!(result.surfaces.iter().all(|s| matches!(s.shape, Shape::Plane(_))), "{name}");
    }
}

#[test]
fn readings_at_the_limit_are_no_surface() {
    let mut world = World::default();
    world.patch([-1.0, -3.0, -0.6], [8.0, 0.0, 0.0], [0.0, 6.0, 0.0]);
    let scanner = Scanner::nodding(160, 91, [-25.0, 30.0], [60.0, -60.0], [0.0, 0.0]);
    let scan =
        scan(&world, &pose([0.0; 3], 0.0, 0.0, 0.0), &scanner, Noise::of(0.01), &mut Random(3));
    let points = scan.grid.points().iter().zip(&scanner.rays).map(|(&point, (_, ray))| {
        if point[0].is_finite() { point } else { (ray * 20.0).map(|v| v as f32).into() }
    });
    let grid = PointGrid::new(160, 91, points.collect());
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let result = segmenter.segment(&grid);
    assert_eq!(result.surfaces.len(), 1, "{:?}", result.surfaces);
    for (label, truth) in result.labels.iter().zip(&scan.truth) {
        assert!(*label == 0 || *truth != 0, "a reading at the limit has a label");
    }
}

#[test]
fn noise_from_one_to_thirty_millimetres_needs_no_setting() {
    let scanner = Scanner::nodding(180, 91, [-30.0, 30.0], [60.0, -60.0], [0.0, 0.0]);
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    for sigma_mm in [1.0, 3.0, 10.0, 30.0] {
        let view = pose([0.0, 0.0, 1.0], 0.12, -0.1, 0.2);
        let noise = Noise::of(sigma_mm * 1e-3);
        let scan = scan(&room(), &view, &scanner, noise, &mut Random(11));
        let (score, typed) = judge(&scan, &room(), segmenter.segment(&scan.grid));
        assert_eq!(
            (score.correct, typed),
            (score.truths, score.truths),
            "{sigma_mm} mm: {score:?}"
        );
        let told = segmenter.noise().sigma_m(2.5) * 1e3;
        assert!((told / sigma_mm - 1.0).abs() < 0.15, "{sigma_mm} mm taken for {told:.1} mm");
    }
}
