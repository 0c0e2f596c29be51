//! What each cell of a grid costs one robot to drive over.

use crate::terrain::{CellClass, CellIndex, Grid, RobotShape};
use serde::{Deserialize, Serialize};

/// What makes one path better than another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlanConfig {
    /// Room beyond which more is worth nothing, in metres. [0.1, 1.5]
    pub comfortable_room_m: f64,
    /// How many times dearer a metre is where the robot barely fits. [1, 10]
    pub tight_factor: f64,
    /// How many times dearer a metre is on the steepest drivable slope. [1, 10]
    pub steep_factor: f64,
    /// How many times dearer a metre is on ground that was only assumed. [1, 10]
    pub assumed_factor: f64,
}

impl Default for PlanConfig {
    fn default() -> Self {
        Self { comfortable_room_m: 0.55, tight_factor: 4.0, steep_factor: 2.5, assumed_factor: 1.2 }
    }
}
/// A unit of cost: a straight step on the best ground costs [`BEST`] × [`STRAIGHT`].
pub(super) const STRAIGHT: u32 = 10;
pub(super) const DIAGONAL: u32 = 14;
pub(super) const BEST: u32 = 8;
/// Dearest weight of a cell; with it no edge is longer than the ring of buckets.
pub(super) const DEAREST: u32 = 60;

/// Weight of each cell of a grid for one robot: what a step into it costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CostMap {
    pub(super) cell_m: f64,
    pub(super) low: CellIndex,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Weight in eighths; zero where the robot does not fit.
    pub(super) weights: Vec<u8>,
}

impl CostMap {
    /// Weighs every cell of `grid`.
    pub fn new(grid: &Grid, shape: &RobotShape, config: &PlanConfig) -> Self {
        let needed_m = shape.inscribed_radius_m();
        let spare_m = (config.comfortable_room_m - needed_m).max(1e-3);
        let steepest = shape.max_slope_rad.tan().max(1e-3);
        let best = f64::from(BEST);
        let weigh = |(cell, here): (CellIndex, &crate::terrain::GridCell)| {
            if !here.class.is_drivable() {
                return 0;
            }
            let room_m = f64::from(here.room_m);
            if room_m < needed_m && !grid.fits(cell) {
                return 0;
            }
            let tight = 1.0 - ((room_m - needed_m) / spare_m).clamp(0.0, 1.0);
            let steep = (f64::from(here.slope) / steepest).min(1.0);
            let assumed =
                if here.class == CellClass::Assumed { config.assumed_factor } else { 1.0 };
            let factor = assumed
                * (1.0 + (config.tight_factor - 1.0) * tight * tight)
                * (1.0 + (config.steep_factor - 1.0) * steep * steep);
            (factor * best).round().clamp(best, f64::from(DEAREST)) as u8
        };
        Self {
            cell_m: grid.cell_m(),
            low: grid.low(),
            width: grid.width(),
            height: grid.height(),
            weights: grid.iter().map(weigh).collect(),
        }
    }

    /// A cost map of given weights in eighths (8 is best, 0 blocked), row by row; for tests and
    /// benchmarks.
    ///
    /// # Panics
    ///
    /// When the weights do not fill whole rows, or one is between 1 and 7 or above 60.
    pub fn from_weights(cell_m: f64, low: CellIndex, width: usize, weights: Vec<u8>) -> Self {
        assert!(width > 0 && weights.len().is_multiple_of(width), "weights must fill whole rows");
        assert!(
            weights.iter().all(|&w| w == 0 || (BEST..=DEAREST).contains(&u32::from(w))),
            "a weight is 0 or {BEST} to {DEAREST}"
        );
        let height = weights.len() / width;
        Self { cell_m, low, width, height, weights }
    }

    pub(super) fn index(&self, cell: CellIndex) -> Option<usize> {
        let (x, y) = (cell.x - self.low.x, cell.y - self.low.y);
        (x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height)
            .then(|| y as usize * self.width + x as usize)
    }

    pub(super) fn cell_at(&self, index: usize) -> CellIndex {
        CellIndex {
            x: self.low.x + (index % self.width) as i32,
            y: self.low.y + (index / self.width) as i32,
        }
    }

    /// Makes open cells within `radius_m` of a cell as dear as cells get: the robot's rectangle did not
    /// get past there though its inscribed circle fits.
    pub fn shun(&mut self, centre: CellIndex, radius_m: f64) {
        let reach = (radius_m / self.cell_m.max(0.01)).ceil() as i32;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                if f64::from(dx).hypot(f64::from(dy)) * self.cell_m > radius_m {
                    continue;
                }
                let cell = CellIndex { x: centre.x + dx, y: centre.y + dy };
                if let Some(index) = self.index(cell)
                    && self.weights[index] > 0
                {
                    self.weights[index] = DEAREST as u8;
                }
            }
        }
    }

    /// Whether the robot's centre may be in a cell.
    pub fn is_open(&self, cell: CellIndex) -> bool {
        self.index(cell).is_some_and(|index| self.weights[index] > 0)
    }

    /// Weight of a cell in eighths; zero where blocked.
    pub fn weight(&self, cell: CellIndex) -> u32 {
        self.index(cell).map_or(0, |index| u32::from(self.weights[index]))
    }

    /// Metres of best ground that are as dear as `cost`.
    pub(super) fn metres(&self, cost: u32) -> f64 {
        f64::from(cost) * self.cell_m / f64::from(BEST * STRAIGHT)
    }

    /// Calls `visit(beside, cost of the step)` for each open neighbour. A diagonal step needs both
    /// cells it squeezes between.
    #[inline]
    pub(super) fn steps(&self, at: usize, mut visit: impl FnMut(usize, u32)) {
        let (x, y) = (at % self.width, at / self.width);
        let (left, right) = (x > 0, x + 1 < self.width);
        let (down, up) = (y > 0, y + 1 < self.height);
        let weight = |index: usize| u32::from(self.weights[index]);
        let west = if left { weight(at - 1) } else { 0 };
        let east = if right { weight(at + 1) } else { 0 };
        let south = if down { weight(at - self.width) } else { 0 };
        let north = if up { weight(at + self.width) } else { 0 };
        if west > 0 {
            visit(at - 1, STRAIGHT * west);
        }
        if east > 0 {
            visit(at + 1, STRAIGHT * east);
        }
        if south > 0 {
            visit(at - self.width, STRAIGHT * south);
        }
        if north > 0 {
            visit(at + self.width, STRAIGHT * north);
        }
        let mut diagonal = |open: bool, index: usize| {
            if open && self.weights[index] > 0 {
                visit(index, DIAGONAL * weight(index));
            }
        };
        if south > 0 && west > 0 {
            diagonal(true, at - self.width - 1);
        }
        if south > 0 && east > 0 {
            diagonal(true, at - self.width + 1);
        }
        if north > 0 && west > 0 {
            diagonal(true, at + self.width - 1);
        }
        if north > 0 && east > 0 {
            diagonal(true, at + self.width + 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shunned_cells_become_dear_and_closed_ones_stay_closed() {
        let low = CellIndex { x: -2, y: -2 };
        let mut weights = vec![BEST as u8; 25];
        weights[13] = 0;
        let mut costs = CostMap::from_weights(0.1, low, 5, weights);
        costs.shun(CellIndex { x: 0, y: 0 }, 0.1);
        assert_eq!(costs.weight(CellIndex { x: 0, y: 0 }), DEAREST);
        assert_eq!(costs.weight(CellIndex { x: -1, y: 0 }), DEAREST);
        assert_eq!(costs.weight(CellIndex { x: 1, y: 0 }), 0);
        assert_eq!(costs.weight(CellIndex { x: 1, y: 1 }), BEST);
        costs.shun(CellIndex { x: 50, y: 50 }, 0.3);
    }
}
