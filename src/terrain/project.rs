//! From layered terrain to the 2D grid of the level on which the robot stands.
//!
//! The level is what can be reached from the robot's own ground by going from cell to cell without
//! a step higher than it climbs and without bumping its head. All else is judged against the height
//! of the nearest ground of that level.

use super::Terrain;
use super::config::TRIED_M;
use super::distance::distances;
use super::fan::FloorPlane;
use super::grid::{CellClass, Grid, GridCell};
use super::lattice::CellIndex;
use super::level::Level;
use nalgebra::{Isometry3, Vector3};

impl Terrain {
    /// The grid of the level on which the robot stands at `world_from_robot`.
    ///
    /// Covers all that was ever seen. Costs a few passes over those cells.
    pub fn project(&self, world_from_robot: &Isometry3<f64>) -> Grid {
        let floor = FloorPlane::under(world_from_robot, &self.shape);
        let robot = CellIndex::at(floor.point.x, floor.point.y, self.config.cell_m);
        let (low, high) =
            self.lattice.bounds().unwrap_or((robot, CellIndex { x: robot.x + 1, y: robot.y + 1 }));
        let mut level = Level::new(self, low, high);
        level.flood(robot, floor.point.z);
        level.spread_heights(floor.point.z);
        let mut grid = Grid {
            cell_m: self.config.cell_m,
            low,
            width: level.width,
            cells: level.classify(),
            robot,
            inscribed_m: self.shape.inscribed_radius_m(),
            sure_m: 0.5 * self.config.sure_gap_m,
        };
        self.allow_stand(&mut grid, world_from_robot);
        level.mark_sure(&mut grid);
        self.measure_room(&mut grid);
        mark_reachable(&mut grid);
        grid
    }

    /// Ground under the robot's own hull is not too steep: it stands there. What was read of it on
    /// the way there under a tilted body must not keep the robot from leaving.
    fn allow_stand(&self, grid: &mut Grid, world_from_robot: &Isometry3<f64>) {
        let (half_length_m, half_width_m) =
            (0.5 * self.shape.length_m + TRIED_M, 0.5 * self.shape.width_m + TRIED_M);
        let centre = world_from_robot.translation.vector;
        let ahead = (world_from_robot.rotation * Vector3::x()).xy().normalize();
        let reach_m = half_length_m.hypot(half_width_m);
        let low = grid.cell_of(centre.x - reach_m, centre.y - reach_m);
        let high = grid.cell_of(centre.x + reach_m, centre.y + reach_m);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = CellIndex { x, y };
                let from = grid.centre(cell).coords - centre.xy();
                let (along_m, aside_m) = (ahead.dot(&from).abs(), ahead.perp(&from).abs());
                if let Some(index) = grid.index(cell)
                    && grid.cells[index].class == CellClass::TooSteep
                    && along_m <= half_length_m
                    && aside_m <= half_width_m
                {
                    grid.cells[index].class = CellClass::Free;
                }
            }
        }
    }

    fn measure_room(&self, grid: &mut Grid) {
        let (cell_m, config) = (grid.cell_m, &self.config);
        let cap = (Grid::MAX_ROOM_M / cell_m) as f32 + 8.0;
        let away_m = |is_seed: &dyn Fn(&GridCell) -> bool, margin_m: f64| -> Vec<f32> {
            let seeds: Vec<bool> = grid.cells.iter().map(is_seed).collect();
            // A seed may begin half a cell before its centre.
            let lost_m = (margin_m + 0.5 * cell_m) as f32;
            let away = distances(&seeds, grid.width, cap);
            away.into_iter().map(|away| away * cell_m as f32 - lost_m).collect()
        };
        let obstacles = away_m(
            &|cell| matches!(cell.class, CellClass::Occupied | CellClass::TooSteep),
            config.obstacle_margin_m,
        );
        let edges = away_m(&|cell| cell.class.is_edge(), config.edge_margin_m);
        let flat_floor = config.flat_floor;
        let unknown = away_m(
            &move |cell| match cell.class {
                CellClass::Unknown | CellClass::OtherLevel => true,
                CellClass::FlatFree => !flat_floor,
                _ => false,
            },
            config.unknown_margin_m,
        );
        let sparse = away_m(&|cell| cell.class.is_drivable() && !cell.sure, 0.0);
        let (width, height) = (grid.width, grid.height());
        for (at, cell) in grid.cells.iter_mut().enumerate() {
            // What lies outside the grid is unknown too.
            let (x, y) = (at % width, at / width);
            let border = x.min(y).min(width - 1 - x).min(height - 1 - y) + 1;
            let border_m = border as f64 * cell_m - 0.5 * cell_m - config.unknown_margin_m;
            let clamp = |room_m: f64| room_m.clamp(-1.0, Grid::MAX_ROOM_M) as f32;
            let hard_m = f64::from(obstacles[at].min(edges[at]));
            cell.hard_room_m = clamp(hard_m);
            let soft_m = f64::from(unknown[at].min(sparse[at]));
            cell.room_m = clamp(hard_m.min(soft_m).min(border_m));
        }
    }
}

fn mark_reachable(grid: &mut Grid) {
    let Some(start) = grid.index(grid.robot) else { return };
    if !grid.fits(grid.robot) {
        return;
    }
    let mut open = vec![start];
    grid.cells[start].reachable = true;
    while let Some(at) = open.pop() {
        let cell = grid.cell_at(at);
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let beside = CellIndex { x: cell.x + dx, y: cell.y + dy };
            if let Some(index) = grid.index(beside)
                && !grid.cells[index].reachable
                && grid.fits(beside)
            {
                grid.cells[index].reachable = true;
                open.push(index);
            }
        }
    }
}
