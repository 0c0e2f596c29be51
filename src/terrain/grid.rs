//! The 2D grid that navigation, exploration and export read: one level, seen from above.

use super::lattice::CellIndex;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// What a cell is to the robot, on the level it stands on.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum CellClass {
    /// Nothing is known of its ground.
    #[default]
    Unknown,
    /// Seen ground, flat enough and clear up to the robot's height.
    Free,
    /// Taken for ground because the robot stood there.
    Assumed,
    /// Something stands there, or hangs lower than the robot is high, or a step leads up.
    Occupied,
    /// Seen ground that is steeper or rougher than the robot may drive.
    TooSteep,
    /// Ground is missing or lies lower than any slope the robot may drive leads.
    DropOff,
    /// Ground was due here and did not show; a ramp is not excluded, an edge is likely.
    Suspect,
    /// Seen ground of another level.
    OtherLevel,
    /// Free of obstacles at the height of a fixed laser; nothing is known of its ground.
    FlatFree,
}

impl CellClass {
    /// Whether the robot may have its wheels here.
    pub fn is_drivable(self) -> bool {
        matches!(self, Self::Free | Self::Assumed)
    }

    /// Whether this is a drop-off, proven or likely.
    pub fn is_edge(self) -> bool {
        matches!(self, Self::DropOff | Self::Suspect)
    }
}

/// The three values of the common occupancy map formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trinary {
    /// Drivable ground.
    Free,
    /// Obstacle, drop-off or too steep.
    Occupied,
    /// Not known.
    Unknown,
}

/// One cell of a [`Grid`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GridCell {
    /// What the cell is.
    pub class: CellClass,
    /// Height of its ground in metres; NaN where there is none on this level.
    pub height_m: f32,
    /// Slope of the ground, rise per metre; zero where unknown.
    pub slope: f32,
    /// Radius of the largest disc about the centre that keeps all margins, metres, at most
    /// [`Grid::MAX_ROOM_M`]; zero or less where nothing fits.
    pub room_m: f32,
    /// The same for obstacles and edges alone: what would be there if all unknown ground were good.
    pub hard_room_m: f32,
    /// Whether ground was measured so close by that no hole that matters can hide here. Drivable
    /// ground that is not sure is not driven on before it was seen more closely.
    pub sure: bool,
    /// Whether the robot can be driven here from where it stands, as far as its inscribed circle says.
    pub reachable: bool,
    /// Whether the cell holds something high enough to hide the ground behind it.
    pub opaque: bool,
}

impl Default for GridCell {
    fn default() -> Self {
        Self {
            class: CellClass::Unknown,
            height_m: f32::NAN,
            slope: 0.0,
            room_m: 0.0,
            hard_room_m: 0.0,
            sure: false,
            reachable: false,
            opaque: false,
        }
    }
}

/// The terrain on the robot's level, as cells in rows along x, the lowest y first.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    pub(super) cell_m: f64,
    pub(super) low: CellIndex,
    pub(super) width: usize,
    pub(super) cells: Vec<GridCell>,
    pub(super) robot: CellIndex,
    pub(super) inscribed_m: f64,
    pub(super) sure_m: f64,
}

impl Grid {
    /// Room is not measured beyond this: farther away nothing slows the robot down.
    pub const MAX_ROOM_M: f64 = 1.5;
    /// Near its own place the robot may move with as little room as it has there.
    const START_M: f64 = 0.6;

    /// A grid of given cells: `width` cells along x per row, the first row at `low`.
    ///
    /// For tests and tools; the agent's grids come from [`super::Terrain::project`].
    ///
    /// # Panics
    ///
    /// When the cells do not fill whole rows.
    pub fn from_cells(cell_m: f64, low: CellIndex, width: usize, cells: Vec<GridCell>) -> Self {
        assert!(width > 0 && cells.len().is_multiple_of(width), "cells must fill whole rows");
        Self { cell_m, low, width, cells, robot: low, inscribed_m: 0.0, sure_m: 0.18 }
    }

    /// Side of a cell in metres.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Cells along x.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Cells along y.
    pub fn height(&self) -> usize {
        self.cells.len() / self.width.max(1)
    }

    /// The cell with the lowest indices.
    pub fn low(&self) -> CellIndex {
        self.low
    }

    /// The cell in which the robot stood when the grid was made.
    pub fn robot(&self) -> CellIndex {
        self.robot
    }

    /// All cells, row by row from the lowest y, each row from the lowest x.
    pub fn cells(&self) -> &[GridCell] {
        &self.cells
    }

    /// All cells with their indices, in the same order.
    pub fn iter(&self) -> impl Iterator<Item = (CellIndex, &GridCell)> + '_ {
        self.cells.iter().enumerate().map(|(index, cell)| (self.cell_at(index), cell))
    }

    /// Place of a cell in [`Grid::cells`], if it lies in the grid.
    pub fn index(&self, cell: CellIndex) -> Option<usize> {
        let (x, y) = (cell.x - self.low.x, cell.y - self.low.y);
        (x >= 0 && y >= 0 && (x as usize) < self.width && (y as usize) < self.height())
            .then(|| y as usize * self.width + x as usize)
    }

    /// The cell at a place of [`Grid::cells`].
    pub fn cell_at(&self, index: usize) -> CellIndex {
        CellIndex {
            x: self.low.x + (index % self.width) as i32,
            y: self.low.y + (index / self.width) as i32,
        }
    }

    /// The cell that holds a point of the map.
    pub fn cell_of(&self, x_m: f64, y_m: f64) -> CellIndex {
        CellIndex::at(x_m, y_m, self.cell_m)
    }

    /// Centre of a cell in the map.
    pub fn centre(&self, cell: CellIndex) -> Point2<f64> {
        Point2::from(cell.centre_m(self.cell_m))
    }

    /// A cell; outside the grid everything is unknown.
    pub fn get(&self, cell: CellIndex) -> GridCell {
        self.index(cell).map(|index| self.cells[index]).unwrap_or_default()
    }

    /// What lies at a point of the map.
    pub fn class_at(&self, x_m: f64, y_m: f64) -> CellClass {
        self.get(self.cell_of(x_m, y_m)).class
    }

    /// Room at a point of the map; none outside the grid.
    pub fn room_at(&self, x_m: f64, y_m: f64) -> f64 {
        f64::from(self.get(self.cell_of(x_m, y_m)).room_m)
    }

    /// Height of the ground at a point, if there is any on this level.
    pub fn height_at(&self, x_m: f64, y_m: f64) -> Option<f64> {
        let height_m = self.get(self.cell_of(x_m, y_m)).height_m;
        height_m.is_finite().then(|| f64::from(height_m))
    }

    /// Room that the robot's centre needs in a cell, metres: its inscribed circle, except close to
    /// where it stands now, where it may leave with as little as it has.
    pub fn needed_room_m(&self, cell: CellIndex) -> f64 {
        let start = self.get(self.robot);
        let (dx, dy) = (f64::from(cell.x - self.robot.x), f64::from(cell.y - self.robot.y));
        let away_m = dx.hypot(dy) * self.cell_m;
        if away_m <= Self::START_M {
            self.inscribed_m.min(f64::from(start.room_m) - 0.5 * self.cell_m).max(0.0)
        } else {
            self.inscribed_m
        }
    }

    /// Makes drivable ground sure about a point at which ground was measured since the grid was made.
    pub fn confirm(&mut self, x_m: f64, y_m: f64) {
        let low = self.cell_of(x_m - self.sure_m, y_m - self.sure_m);
        let high = self.cell_of(x_m + self.sure_m, y_m + self.sure_m);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = CellIndex { x, y };
                let centre = self.centre(cell);
                let within = (centre.x - x_m).hypot(centre.y - y_m) <= self.sure_m;
                if let Some(index) = self.index(cell)
                    && within
                    && self.cells[index].class.is_drivable()
                {
                    self.cells[index].sure = true;
                }
            }
        }
    }

    /// Whether the robot's centre may be in a cell, as far as its inscribed circle says.
    pub fn fits(&self, cell: CellIndex) -> bool {
        let here = self.get(cell);
        here.class.is_drivable() && f64::from(here.room_m) >= self.needed_room_m(cell)
    }

    /// Whether the robot would fit in a drivable cell if all unknown ground about it were good.
    pub fn could_fit(&self, cell: CellIndex) -> bool {
        let here = self.get(cell);
        here.class.is_drivable() && f64::from(here.hard_room_m) >= self.inscribed_m
    }

    /// The grid with `factor` × `factor` cells made one, for files with larger cells. What is worst
    /// in a block wins: drop-off, obstacle, too steep, suspect; then free ground, then unknown.
    #[must_use]
    pub fn coarse(&self, factor: usize) -> Self {
        let factor = factor.max(1) as i32;
        let low = CellIndex { x: self.low.x.div_euclid(factor), y: self.low.y.div_euclid(factor) };
        let high_x = (self.low.x + self.width as i32 - 1).div_euclid(factor);
        let high_y = (self.low.y + self.height() as i32 - 1).div_euclid(factor);
        let width = (high_x - low.x + 1).max(0) as usize;
        let mut cells = vec![GridCell::default(); width * (high_y - low.y + 1).max(0) as usize];
        for (cell, fine) in self.iter() {
            let x = (cell.x.div_euclid(factor) - low.x) as usize;
            let y = (cell.y.div_euclid(factor) - low.y) as usize;
            let coarse = &mut cells[y * width + x];
            let reachable = coarse.reachable || fine.reachable;
            let opaque = coarse.opaque || fine.opaque;
            if severity(fine.class) > severity(coarse.class) {
                *coarse = *fine;
            }
            (coarse.reachable, coarse.opaque) = (reachable, opaque);
        }
        Self {
            cell_m: self.cell_m * f64::from(factor),
            low,
            width: width.max(1),
            cells,
            robot: CellIndex {
                x: self.robot.x.div_euclid(factor),
                y: self.robot.y.div_euclid(factor),
            },
            inscribed_m: self.inscribed_m,
            sure_m: self.sure_m,
        }
    }

    /// The grid as free, occupied and unknown, in the order of [`Grid::cells`]. A suspected edge
    /// stays unknown; a proven drop-off is occupied, so that no reader of the map drives there.
    pub fn trinary(&self) -> impl Iterator<Item = Trinary> + '_ {
        self.cells.iter().map(|cell| match cell.class {
            CellClass::Free | CellClass::Assumed | CellClass::FlatFree => Trinary::Free,
            CellClass::Occupied | CellClass::TooSteep | CellClass::DropOff => Trinary::Occupied,
            CellClass::Unknown | CellClass::Suspect | CellClass::OtherLevel => Trinary::Unknown,
        })
    }
}

fn severity(class: CellClass) -> u8 {
    match class {
        CellClass::Unknown => 0,
        CellClass::FlatFree => 1,
        CellClass::OtherLevel => 2,
        CellClass::Assumed => 3,
        CellClass::Free => 4,
        CellClass::Suspect => 5,
        CellClass::TooSteep => 6,
        CellClass::Occupied => 7,
        CellClass::DropOff => 8,
    }
}
