use super::Pose2;
use crate::terrain::{CellClass, CellIndex, Grid, RobotShape};
use serde::{Deserialize, Serialize};

/// Part of the grid's edge margin that the hull itself must keep: the rest is for tracking errors.
const EDGE_SHARE: f64 = 0.7;

/// The hull's rectangle, with what it keeps between itself and each kind of cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Footprint {
    half_length_m: f64,
    half_width_m: f64,
    circumscribed_m: f64,
    edge_margin_m: f64,
    margin_m: f64,
}

/// The first cell found that a footprint must not touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Conflict {
    /// The cell.
    pub cell: CellIndex,
    /// What it is.
    pub class: CellClass,
}

impl Footprint {
    /// The footprint of a robot on grids made with the given edge margin
    /// ([`TerrainConfig::edge_margin_m`](crate::terrain::TerrainConfig::edge_margin_m)).
    pub fn new(shape: &RobotShape, edge_margin_m: f64) -> Self {
        Self {
            half_length_m: 0.5 * shape.length_m,
            half_width_m: 0.5 * shape.width_m,
            circumscribed_m: shape.circumscribed_radius_m(),
            edge_margin_m: EDGE_SHARE * edge_margin_m,
            margin_m: 0.01,
        }
    }

    /// The nearest cell that the hull at `pose` would stand on or strike and must not; `None` where
    /// the pose is safe.
    pub fn conflict(&self, grid: &Grid, pose: &Pose2) -> Option<Conflict> {
        // The room already holds every margin: with the whole circle inside it nothing can touch.
        if grid.room_at(pose.x_m, pose.y_m) >= self.circumscribed_m {
            return None;
        }
        let reach_m = self.circumscribed_m + self.edge_margin_m;
        let low = grid.cell_of(pose.x_m - reach_m, pose.y_m - reach_m);
        let high = grid.cell_of(pose.x_m + reach_m, pose.y_m + reach_m);
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let half_cell_m = 0.5 * grid.cell_m();
        let mut nearest: Option<(f64, Conflict)> = None;
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = CellIndex { x, y };
                let class = grid.get(cell).class;
                if class.is_drivable() {
                    continue;
                }
                let centre = grid.centre(cell);
                let (dx, dy) = (centre.x - pose.x_m, centre.y - pose.y_m);
                let ahead_m = (cos * dx + sin * dy).abs();
                let aside_m = (cos * dy - sin * dx).abs();
                let margin_m = if class.is_edge() { self.edge_margin_m } else { self.margin_m };
                if ahead_m - half_cell_m <= self.half_length_m + margin_m
                    && aside_m - half_cell_m <= self.half_width_m + margin_m
                {
                    let away_m = dx.hypot(dy);
                    if nearest.is_none_or(|(least_m, _)| away_m < least_m) {
                        nearest = Some((away_m, Conflict { cell, class }));
                    }
                }
            }
        }
        nearest.map(|(_, conflict)| conflict)
    }

    /// What stands in the way of turning in place by `turn_rad`, judged every few degrees.
    pub fn turn_conflict(&self, grid: &Grid, pose: &Pose2, turn_rad: f64) -> Option<Conflict> {
        if grid.room_at(pose.x_m, pose.y_m) >= self.circumscribed_m {
            return None;
        }
        let steps = (turn_rad.abs() / 0.07).ceil().max(1.0) as u32;
        (1..=steps).find_map(|step| {
            let turned = pose.driven(0.0, turn_rad * f64::from(step) / f64::from(steps));
            self.conflict(grid, &turned)
        })
    }
}
