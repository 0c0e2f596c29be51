use super::Pose2;
use crate::terrain::{CellClass, CellIndex, Grid, RobotShape, TRIED_M};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Part of the grid's edge margin that the hull itself must keep: the rest is for tracking errors.
const EDGE_SHARE: f64 = 0.7;

/// A hull nearer to an edge than this does not move on any ground that it can be told of, in metres.
const LEAST_GAP_M: f64 = 0.03;

/// The hull's rectangle, with what it keeps between itself and each kind of cell.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Footprint {
    half_length_m: f64,
    half_width_m: f64,
    circumscribed_m: f64,
    edge_margin_m: f64,
    margin_m: f64,
    /// Whether obstacles may come as close as the hull itself.
    squeezed: bool,
}

/// The first cell found that a footprint must not touch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Conflict {
    /// The cell.
    pub cell: CellIndex,
    /// What it is. Drivable ground is a conflict where it is not sure
    /// ([`GridCell::sure`](crate::terrain::GridCell::sure)): a closer look settles it.
    pub class: CellClass,
}

impl Conflict {
    /// Whether a touch at a creep does no harm: a wall, or ground that only stops the wheels.
    pub fn is_solid(&self) -> bool {
        matches!(self.class, CellClass::Occupied | CellClass::TooSteep)
    }

    /// Whether a sweep from here may make the way safe: the ground is unknown or not sure.
    pub fn needs_look(&self) -> bool {
        self.class.is_drivable()
            || matches!(self.class, CellClass::Unknown | CellClass::Suspect | CellClass::FlatFree)
    }
}

impl std::fmt::Display for Conflict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = match self.class {
            CellClass::Free | CellClass::Assumed => "ground seen too sparsely",
            CellClass::Unknown | CellClass::FlatFree => "ground never seen",
            CellClass::Occupied => "an obstacle",
            CellClass::TooSteep => "ground too steep",
            CellClass::DropOff => "a drop-off",
            CellClass::Suspect => "a suspected drop-off",
            CellClass::OtherLevel => "ground of another level",
        };
        write!(f, "{what} at cell ({}, {})", self.cell.x, self.cell.y)
    }
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
            squeezed: false,
        }
    }

    /// The same without any margin towards obstacles, for creeping out of a place where the robot stands
    /// closer to them than it meant to: a wall touched at a creep does no harm. Edges and unknown
    /// ground keep their margins.
    pub fn squeezed(&self) -> Self {
        Self { squeezed: true, ..self.clone() }
    }

    /// The nearest cell that the hull at `pose` would stand on or strike and must not; `None` where
    /// the pose is safe.
    pub fn conflict(&self, grid: &Grid, pose: &Pose2) -> Option<Conflict> {
        self.conflict_from(grid, pose, None)
    }

    /// The same for a robot that now stands at `standing`: what the map holds against the ground under
    /// its hull is wrong or does no harm, and must not keep it from leaving. Edges always count; where it
    /// stands closer to one than the margin, it may leave as long as it gets no closer.
    pub fn conflict_from(
        &self,
        grid: &Grid,
        pose: &Pose2,
        standing: Option<&Pose2>,
    ) -> Option<Conflict> {
        self.conflict_among(grid, pose, standing, |_, _| true)
    }

    /// The same among the cells that `counts` names by place and class.
    pub fn conflict_among(
        &self,
        grid: &Grid,
        pose: &Pose2,
        standing: Option<&Pose2>,
        counts: impl Fn(CellIndex, CellClass) -> bool,
    ) -> Option<Conflict> {
        // The room already holds every margin: with the whole circle inside it nothing can touch.
        let roomy = grid.room_at(pose.x_m, pose.y_m) >= self.circumscribed_m;
        let reach_m = self.circumscribed_m + if roomy { 0.0 } else { self.edge_margin_m };
        let low = grid.cell_of(pose.x_m - reach_m, pose.y_m - reach_m);
        let high = grid.cell_of(pose.x_m + reach_m, pose.y_m + reach_m);
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let half_cell_m = 0.5 * grid.cell_m();
        let mut nearest: Option<(f64, Conflict)> = None;
        // Distance from the standing hull to its nearest edge, once it is asked for.
        let mut edge_gap_m: Option<f64> = None;
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = CellIndex { x, y };
                let here = grid.get(cell);
                let class = here.class;
                if !counts(cell, class) {
                    continue;
                }
                // Ground that is not sure may lie beside the hull, not under it.
                let margin_m = match class {
                    _ if class.is_drivable() && here.sure => continue,
                    _ if class.is_drivable() => -half_cell_m,
                    _ if roomy => continue,
                    _ if class.is_edge() => self.edge_margin_m + half_cell_m,
                    CellClass::Occupied | CellClass::TooSteep if self.squeezed => 0.0,
                    _ => self.margin_m + half_cell_m,
                };
                let centre = grid.centre(cell);
                let (dx, dy) = (centre.x - pose.x_m, centre.y - pose.y_m);
                let ahead_m = (cos * dx + sin * dy).abs();
                let aside_m = (cos * dy - sin * dx).abs();
                let underneath = !class.is_edge()
                    && standing.is_some_and(|standing| {
                        let spare_m = if class == CellClass::Occupied { 0.0 } else { TRIED_M };
                        self.covers(standing, &centre, spare_m)
                    });
                let mut leaving = || {
                    let Some(standing) = standing.filter(|_| class.is_edge()) else { return false };
                    let had_m = *edge_gap_m.get_or_insert_with(|| self.edge_gap_m(grid, standing));
                    let gap_m = self.gap_m(pose, &centre);
                    gap_m > LEAST_GAP_M + half_cell_m && gap_m >= had_m - 1e-6
                };
                if ahead_m <= self.half_length_m + margin_m
                    && aside_m <= self.half_width_m + margin_m
                    && !underneath
                    && !leaving()
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

    /// Distance from the hull at `pose` to the centre of the nearest cell of an edge, within the margin.
    fn edge_gap_m(&self, grid: &Grid, pose: &Pose2) -> f64 {
        let reach_m = self.circumscribed_m + self.edge_margin_m;
        let low = grid.cell_of(pose.x_m - reach_m, pose.y_m - reach_m);
        let high = grid.cell_of(pose.x_m + reach_m, pose.y_m + reach_m);
        (low.y..=high.y)
            .flat_map(|y| (low.x..=high.x).map(move |x| CellIndex { x, y }))
            .filter(|cell| grid.get(*cell).class.is_edge())
            .map(|cell| self.gap_m(pose, &grid.centre(cell)))
            .fold(f64::INFINITY, f64::min)
    }

    /// Distance from the hull at `pose` to a point, in metres; zero within it.
    fn gap_m(&self, pose: &Pose2, point: &Point2<f64>) -> f64 {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let (dx, dy) = (point.x - pose.x_m, point.y - pose.y_m);
        let ahead_m = (cos * dx + sin * dy).abs() - self.half_length_m;
        let aside_m = (cos * dy - sin * dx).abs() - self.half_width_m;
        ahead_m.max(0.0).hypot(aside_m.max(0.0))
    }

    /// Whether the hull at `pose`, `spare_m` wider on each side, covers a point.
    fn covers(&self, pose: &Pose2, point: &Point2<f64>, spare_m: f64) -> bool {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let (dx, dy) = (point.x - pose.x_m, point.y - pose.y_m);
        (cos * dx + sin * dy).abs() <= self.half_length_m + spare_m
            && (cos * dy - sin * dx).abs() <= self.half_width_m + spare_m
    }

    /// What stands in the way of turning in place by `turn_rad`, judged every few degrees.
    pub fn turn_conflict(&self, grid: &Grid, pose: &Pose2, turn_rad: f64) -> Option<Conflict> {
        let steps = (turn_rad.abs() / 0.07).ceil().max(1.0) as u32;
        (1..=steps).find_map(|step| {
            let turned = pose.driven(0.0, turn_rad * f64::from(step) / f64::from(steps));
            self.conflict_from(grid, &turned, Some(pose))
        })
    }

    /// The turn that brings the heading round by `turn_rad`: the short way if it is free, else the
    /// long way round.
    ///
    /// # Errors
    ///
    /// What stands in the short way, when both are closed.
    pub fn free_turn_rad(&self, grid: &Grid, pose: &Pose2, turn_rad: f64) -> Result<f64, Conflict> {
        let Some(conflict) = self.turn_conflict(grid, pose, turn_rad) else {
            return Ok(turn_rad);
        };
        let other_rad = turn_rad - TAU.copysign(turn_rad);
        match self.turn_conflict(grid, pose, other_rad) {
            None => Ok(other_rad),
            Some(_) => Err(conflict),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::GridCell;

    #[test]
    fn a_robot_closer_to_an_edge_than_the_margin_may_leave_it_but_not_near_it() {
        // The edge begins 0.3 m to the left of the x axis: the margin to a hull 0.5 m wide is broken.
        let grid = beside(CellClass::Suspect);
        let shape = RobotShape { length_m: 0.5, width_m: 0.5, ..RobotShape::default() };
        let footprint = Footprint::new(&shape, 0.15);
        let standing = Pose2 { x_m: 0.5, y_m: 0.0, yaw_rad: 0.0 };
        assert!(footprint.conflict(&grid, &standing).is_some());
        let from = Some(&standing);
        assert_eq!(footprint.conflict_from(&grid, &standing.driven(0.2, 0.0), from), None);
        let away = Pose2 { y_m: -0.1, ..standing };
        assert_eq!(footprint.conflict_from(&grid, &away, from), None);
        let nearer = Pose2 { y_m: 0.02, ..standing };
        assert!(footprint.conflict_from(&grid, &nearer, from).is_some());
        // Turning brings a corner nearer.
        assert!(footprint.turn_conflict(&grid, &standing, 0.5).is_some());
    }

    /// Open ground with a row of cells of a class, its centres 0.325 m to the left of the x axis.
    fn beside(class: CellClass) -> Grid {
        let free = GridCell {
            class: CellClass::Free,
            height_m: 0.0,
            room_m: 0.2,
            sure: true,
            ..GridCell::default()
        };
        let cells = (0..40 * 40).map(|at| GridCell {
            class: if at / 40 == 26 { class } else { CellClass::Free },
            ..free
        });
        Grid::from_cells(0.05, CellIndex { x: -20, y: -20 }, 40, cells.collect())
    }

    #[test]
    fn what_lies_under_the_hull_does_not_hold_it_but_an_edge_does() {
        let shape = RobotShape { length_m: 0.5, width_m: 0.7, ..RobotShape::default() };
        let footprint = Footprint::new(&shape, 0.1);
        let here = Pose2::default();
        let ahead = here.driven(0.02, 0.0);
        // The row lies under the hull's left side, all along: only its part ahead is new.
        let grid = beside(CellClass::TooSteep);
        assert!(footprint.conflict(&grid, &here).is_some());
        assert_eq!(footprint.conflict_from(&grid, &here, Some(&here)), None);
        assert_eq!(footprint.conflict_from(&grid, &ahead, Some(&here)), None);
        let farther = here.driven(0.2, 0.0);
        assert!(footprint.conflict_from(&grid, &farther, Some(&here)).is_some());
        let edge = beside(CellClass::Suspect);
        assert!(footprint.conflict_from(&edge, &here, Some(&here)).is_some());
    }

    #[test]
    fn a_squeezed_hull_may_pass_a_wall_but_never_an_edge() {
        // The centres of the row lie 2.5 cm from the side of the hull.
        let shape = RobotShape { length_m: 0.5, width_m: 0.6, ..RobotShape::default() };
        let footprint = Footprint::new(&shape, 0.1);
        let pose = Pose2::default();
        assert!(footprint.conflict(&beside(CellClass::Occupied), &pose).is_some());
        assert_eq!(footprint.squeezed().conflict(&beside(CellClass::Occupied), &pose), None);
        for class in [CellClass::DropOff, CellClass::Suspect, CellClass::Unknown] {
            assert!(footprint.squeezed().conflict(&beside(class), &pose).is_some(), "{class:?}");
        }
    }
}
