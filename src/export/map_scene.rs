//! The parts of 3D pictures of maps: patches, paths, the robot.

use super::canvas::Colour;
use super::scene3d::Scene;
use crate::mapping::{Landmark, MASK_CELL_M, PlaneMask};
use nalgebra::{Isometry3, Point2, Point3, Vector3};

/// Colour of a surface by its height above the floor and by how it lies: floors grey-green, ceilings
/// pale, walls from blue (low) over yellow to red (high).
pub fn surface_colour(normal: &Vector3<f64>, height_m: f64) -> Colour {
    if normal.z > 0.9 {
        return Colour::rgb(168, 180, 160);
    }
    if normal.z < -0.9 {
        return Colour::rgb(215, 215, 225);
    }
    let stops = [
        (0.0, Colour::rgb(70, 110, 190)),
        (0.8, Colour::rgb(90, 170, 170)),
        (1.6, Colour::rgb(220, 190, 90)),
        (3.0, Colour::rgb(200, 90, 60)),
    ];
    let above = stops.iter().position(|(height, _)| *height >= height_m);
    match above {
        Some(0) => stops[0].1,
        Some(i) => {
            let (low, high) = (stops[i - 1], stops[i]);
            low.1.mixed(high.1, (height_m - low.0) / (high.0 - low.0))
        }
        None => stops[stops.len() - 1].1,
    }
}

/// Adds a patch as the cells that were really hit, so that doorways are open; a landmark without a
/// mask is drawn as its hull.
pub fn add_landmark(scene: &mut Scene, landmark: &Landmark, colour: Colour) {
    let hull: Vec<Point3<f64>> = landmark.hull_points().collect();
    if landmark.mask.is_empty() {
        scene.polygon(&hull, colour);
        scene.outline(&hull, 1.0, colour.scaled(0.55));
        return;
    }
    for rectangle in mask_rectangles(&landmark.mask) {
        let corners = rectangle.map(|p| landmark.world_from_plane * Point3::new(p.x, p.y, 0.0));
        scene.polygon(&corners, colour);
    }
    let place = |p: &Point2<f64>| landmark.world_from_plane * Point3::new(p.x, p.y, 0.0);
    for (from, to) in landmark.mask.boundary() {
        scene.path(&[place(&from), place(&to)], 0.8, colour.scaled(0.6));
    }
}

/// The cells of a mask as rectangles, runs along x joined and equal runs joined along y.
pub fn mask_rectangles(mask: &PlaneMask) -> Vec<[Point2<f64>; 4]> {
    // Cell indices, from the centres.
    let index = |coordinate: f64| (coordinate / MASK_CELL_M).floor() as i64;
    let mut cells: Vec<(i64, i64)> = mask.cells().map(|c| (index(c.y), index(c.x))).collect();
    cells.sort_unstable();
    // (first x, last x) → rows that have exactly this run, as (first y, last y) still open.
    let mut open: Vec<(i64, i64, i64)> = Vec::new();
    let mut done: Vec<(i64, i64, i64, i64)> = Vec::new();
    let mut at = 0;
    while at < cells.len() {
        let y = cells[at].0;
        let mut runs: Vec<(i64, i64)> = Vec::new();
        while at < cells.len() && cells[at].0 == y {
            let x = cells[at].1;
            match runs.last_mut() {
                Some(run) if run.1 + 1 == x => run.1 = x,
                _ => runs.push((x, x)),
            }
            at += 1;
        }
        let next_row = cells.get(at).map(|cell| cell.0);
        let mut kept = Vec::new();
        for (first, last, since) in open.drain(..) {
            if runs.contains(&(first, last)) {
                kept.push((first, last, since));
            } else {
                done.push((first, last, since, y - 1));
            }
        }
        for &(first, last) in &runs {
            if !kept.iter().any(|run| (run.0, run.1) == (first, last)) {
                kept.push((first, last, y));
            }
        }
        if next_row == Some(y + 1) {
            open = kept;
        } else {
            done.extend(kept.into_iter().map(|(first, last, since)| (first, last, since, y)));
        }
    }
    done.into_iter()
        .map(|(x0, x1, y0, y1)| {
            let edge = |cell: i64| cell as f64 * MASK_CELL_M;
            let (left, right, bottom, top) = (edge(x0), edge(x1 + 1), edge(y0), edge(y1 + 1));
            [(left, bottom), (right, bottom), (right, top), (left, top)]
                .map(|(x, y)| Point2::new(x, y))
        })
        .collect()
}

/// Adds a path as a line `width` pixels wide, lifted a little off the floor.
pub fn add_path<'a>(
    scene: &mut Scene,
    poses: impl IntoIterator<Item = &'a Isometry3<f64>>,
    width: f64,
    colour: Colour,
) {
    let points: Vec<Point3<f64>> = poses
        .into_iter()
        .map(|pose| Point3::from(pose.translation.vector + Vector3::new(0.0, 0.0, 0.03)))
        .collect();
    scene.path(&points, width, colour);
}

/// Adds a robot as a body of the given length, width and height with a mark at its front.
pub fn add_robot(scene: &mut Scene, pose: &Isometry3<f64>, size_m: &Vector3<f64>, colour: Colour) {
    let lifted = pose * Isometry3::translation(0.0, 0.0, 0.5 * size_m.z + 0.02);
    scene.block(&lifted, size_m, colour);
    let nose = lifted * Isometry3::translation(0.55 * size_m.x, 0.0, 0.0);
    scene.block(
        &nose,
        &Vector3::new(0.15 * size_m.x, 0.4 * size_m.y, 0.5 * size_m.z),
        Colour::BLACK,
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn rectangles_cover_each_cell_once(cells in prop::collection::btree_set((-12..12_i32, -9..9_i32), 0..120)) {
            let mut mask = PlaneMask::default();
            for (x, y) in &cells {
                mask.insert(&Point2::new((f64::from(*x) + 0.5) * MASK_CELL_M, (f64::from(*y) + 0.5) * MASK_CELL_M));
            }
            let mut covered = Vec::new();
            for [low, _, high, _] in mask_rectangles(&mask) {
                let cell = |coordinate: f64| (coordinate / MASK_CELL_M).round() as i32;
                for y in cell(low.y)..cell(high.y) {
                    for x in cell(low.x)..cell(high.x) {
                        covered.push((x, y));
                    }
                }
            }
            covered.sort_unstable();
            let expected: Vec<_> = cells.into_iter().collect();
            prop_assert_eq!(covered, expected);
        }
    }
}
