//! The walls that bound rooms, as the planes of the map tell them: a grid knows a wall only where its foot was
//! seen, a plane goes on behind what stands before it, and is open where its doorways are.

use crate::mapping::{Landmark, MASK_CELL_M};
use nalgebra::{Point2, Point3, Vector3};
use std::collections::BTreeMap;

/// The rise of a normal above which a surface is no wall.
const UPRIGHT: f64 = 0.1;
/// The part of a wall that bounds a room, over the ground in metres: a bench ends below it, the lintel of a
/// doorway begins over it.
const BAND_M: (f64, f64) = (0.5, 1.6);
/// How much of the band a surface covers where it is a wall, in metres.
const COVERED_M: f64 = 0.5;

/// Directions in which what a wall hides is told apart.
const DIRECTIONS: usize = 720;

/// What of the map's planes stands upright.
#[derive(Clone, Debug, Default)]
pub struct Walls {
    columns: Vec<Column>,
}

/// An upright strip of a plane, as wide as a cell of its mask.
#[derive(Clone, Debug)]
pub(super) struct Column {
    pub(super) at: Point2<f64>,
    /// Where its seen cells are, in metres.
    heights_m: Vec<f64>,
}

impl Walls {
    /// The upright ones of these landmarks that are still there.
    pub fn of<'a>(landmarks: impl IntoIterator<Item = &'a Landmark>) -> Self {
        let there = landmarks.into_iter().filter(|landmark| !landmark.gone);
        let upright = there.filter(|landmark| landmark.normal().z.abs() < UPRIGHT);
        Self { columns: upright.flat_map(columns).collect() }
    }

    pub(super) fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// Where a wall on ground of some height hides what is around a place, up to so many metres away: whether it
    /// hides a point over the ground.
    pub fn hide(
        &self,
        from: Point2<f64>,
        ground_m: f64,
        within_m: f64,
    ) -> impl Fn(&Point2<f64>) -> bool + use<> {
        let direction = move |to: &Point2<f64>| {
            let away = to - from;
            let turns = away.y.atan2(away.x) / std::f64::consts::TAU;
            ((turns.rem_euclid(1.0) * DIRECTIONS as f64) as usize % DIRECTIONS, away.norm())
        };
        let mut clear_m = [f64::INFINITY; DIRECTIONS];
        for column in self.columns.iter().filter(|column| column.bounds(ground_m)) {
            let (middle, away_m) = direction(&column.at);
            if away_m > within_m {
                continue;
            }
            let half_rad = (MASK_CELL_M / away_m.max(MASK_CELL_M)).asin();
            let half = (half_rad / std::f64::consts::TAU * DIRECTIONS as f64).ceil() as usize;
            for beside in 0..=2 * half {
                let at = &mut clear_m[(middle + DIRECTIONS + beside - half) % DIRECTIONS];
                *at = at.min(away_m);
            }
        }
        move |to| {
            let (direction, away_m) = direction(to);
            away_m > clear_m[direction]
        }
    }
}

impl Column {
    /// Whether it bounds what stands on ground of this height.
    pub(super) fn bounds(&self, ground_m: f64) -> bool {
        let band = ground_m + BAND_M.0..ground_m + BAND_M.1;
        let covered = self.heights_m.iter().filter(|height| band.contains(height)).count();
        covered as f64 * MASK_CELL_M >= COVERED_M
    }
}

fn columns(landmark: &Landmark) -> Vec<Column> {
    let along = landmark.normal().cross(&Vector3::z());
    let mut columns: BTreeMap<i64, Column> = BTreeMap::new();
    let is_open = |cell: &Point2<f64>| landmark.openings.iter().any(|opening| opening.holds(cell));
    for cell in landmark.mask.cells().filter(|cell| !is_open(cell)) {
        let p = landmark.world_from_plane * Point3::new(cell.x, cell.y, 0.0);
        let key = (along.dot(&p.coords) / MASK_CELL_M).floor() as i64;
        let new = || Column { at: p.xy(), heights_m: Vec::new() };
        columns.entry(key).or_insert_with(new).heights_m.push(p.z);
    }
    columns.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall from (1, -1) to (1, 1), as high as told.
    fn wall(high_m: f64) -> Walls {
        let steps = (2.0 / MASK_CELL_M) as i32;
        let heights_m: Vec<f64> =
            (0..).map(|k| MASK_CELL_M * f64::from(k)).take_while(|z| *z < high_m).collect();
        let at = |step: i32| Point2::new(1.0, MASK_CELL_M * f64::from(step) - 1.0);
        let columns = (0..=steps).map(|step| Column { at: at(step), heights_m: heights_m.clone() });
        Walls { columns: columns.collect() }
    }

    #[test]
    fn a_wall_hides_what_is_behind_it() {
        let hidden = wall(2.0).hide(Point2::new(-0.5, 0.1), 0.0, 4.0);
        for degrees in 0..360 {
            let (sin, cos) = f64::from(degrees).to_radians().sin_cos();
            for away_m in [0.5, 1.2, 2.5, 3.9] {
                let p = Point2::new(-0.5 + away_m * cos, 0.1 + away_m * sin);
                let crosses_at_m = 0.1 + 1.5 * sin / cos;
                let is_behind = cos > 0.0 && p.x > 1.0 && crosses_at_m.abs() < 1.0;
                // Beside the wall's ends by a cell either is right.
                if (crosses_at_m.abs() - 1.0).abs() > 2.0 * MASK_CELL_M {
                    assert_eq!(hidden(&p), is_behind, "{degrees}°, {away_m} m");
                }
            }
        }
    }

    #[test]
    fn what_is_low_or_far_or_on_another_storey_hides_nothing() {
        let behind = Point2::new(1.5, 0.0);
        assert!(!wall(0.6).hide(Point2::origin(), 0.0, 4.0)(&behind));
        assert!(!wall(2.0).hide(Point2::origin(), 3.0, 4.0)(&behind));
        assert!(!wall(2.0).hide(Point2::origin(), 0.0, 0.9)(&behind));
        assert!(wall(2.0).hide(Point2::origin(), 0.0, 1.6)(&behind));
    }
}
