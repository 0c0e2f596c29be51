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
