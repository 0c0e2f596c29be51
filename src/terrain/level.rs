//! The level that a robot can reach, cell by cell.

use super::Terrain;
use super::column::{BINS, bin_of, bits};
use super::distance::distances;
use super::grid::{CellClass, Grid, GridCell};
use super::lattice::{CHUNK, CellIndex, Chunk};
use super::surface::{Seen, Surface, Void};
use std::collections::VecDeque;

/// Step between two cells of which one is only assumed: its height is a guess.
const ASSUMED_STEP_M: f64 = 0.15;
/// A ray that passes this much lower than the level could lie proves that the level ends.
const PASSED_BELOW_M: f64 = 0.15;
/// How far from the level such a proof still belongs to its edge.
const EDGE_REACH_M: f64 = 1.5;
/// Ground on both sides of cells that nothing was read of lies in one line but for this: what is between is
/// then taken to do so, too. A change of level in there may be the far side of a slit.
const LEVEL_STRIDE_M: f64 = 0.025;
/// Cells from which the line of the ground before a stride is told.
const TREND_CELLS: isize = 3;
/// An obstacle that reaches from here up hides the ground behind it.
const OPAQUE_FROM_M: f64 = 0.30;
/// Flat log-odds, in tenths, from which a cell counts as occupied or free in 2D mode.
const FLAT_OCCUPIED: i8 = 8;
const FLAT_FREE: i8 = -8;

/// Steps to the eight cells around one.
const NEIGHBOURS: [(isize, isize); 8] =
    [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)];

/// Work arrays over the cells of the grid.
pub(super) struct Level<'a> {
    terrain: &'a Terrain,
    low: CellIndex,
    pub width: usize,
    height: usize,
    chunks: Vec<Option<&'a Chunk>>,
    /// Surface of the level in each cell; NaN where there is none.
    z_m: Vec<f32>,
    seen: Vec<Seen>,
    /// Ground that the level's robot would hit its head or hull over.
    blocked: Vec<bool>,
    /// Height of the nearest ground of the level, and the cells to it.
    near_z_m: Vec<f32>,
    away: Vec<u16>,
}

impl<'a> Level<'a> {
    pub fn new(terrain: &'a Terrain, low: CellIndex, high: CellIndex) -> Self {
        let (width, height) = ((high.x - low.x) as usize, (high.y - low.y) as usize);
        let across = width.div_ceil(CHUNK as usize);
        let chunks = (0..across * height.div_ceil(CHUNK as usize))
            .map(|index| {
                let (x, y) = ((index % across) as i32, (index / across) as i32);
                terrain.lattice.chunk((low.x.div_euclid(CHUNK) + x, low.y.div_euclid(CHUNK) + y))
            })
            .collect();
        let cells = width * height;
        Self {
            terrain,
            low,
            width,
            height,
            chunks,
            z_m: vec![f32::NAN; cells],
            seen: vec![Seen::Assumed; cells],
            blocked: vec![false; cells],
            near_z_m: vec![f32::NAN; cells],
            away: vec![u16::MAX; cells],
        }
    }

    fn chunk(&self, at: usize) -> Option<(&'a Chunk, usize)> {
        let (x, y) = (at % self.width, at / self.width);
        let side = CHUNK as usize;
        let chunk = self.chunks[(y / side) * self.width.div_ceil(side) + x / side]?;
        Some((chunk, (y % side) * side + x % side))
    }

    fn surfaces(&self, at: usize) -> &'a [Surface] {
        self.chunk(at).map_or(&[], |(chunk, place)| chunk.ground[place].surfaces())
    }

    /// Whether something was hit between two heights above the ground at `z_m`.
    fn hit_between(&self, at: usize, low_m: f64, high_m: f64) -> bool {
        let Some((chunk, place)) = self.chunk(at) else { return false };
        let low = bin_of(low_m);
        chunk.occupied(place, low) & bits(0, bin_of(high_m) - low) != 0
    }

    /// Whether the robot's body over ground at `z_m` would touch something.
    ///
    /// One point of one image, with nothing above, below or beside it, is no thing: a ray that grazed
    /// an edge, or a moment's tilt of the body. Whatever stands there shows again from nearer by, and
    /// the guard line asks no map.
    fn is_obstructed(&self, at: usize, z_m: f64) -> bool {
        let shape = &self.terrain.shape;
        let Some((chunk, place)) = self.chunk(at) else { return false };
        // Half a bin up: a bin counts from its centre, or floor noise would fill the lowest one.
        let low_m = z_m + shape.max_step_m + 0.5 * super::column::BIN_M;
        let high_m = z_m + shape.height_m + shape.clearance_m;
        let low = bin_of(low_m);
        let band = bits(0, bin_of(high_m) - low);
        let hit = chunk.occupied(place, low) & band;
        if hit == 0 {
            return false;
        }
        hit.count_ones() > 1
            || chunk.confirmed(place, low) & band != 0
            || NEIGHBOURS.iter().any(|&(dx, dy)| {
                self.beside(at, dx, dy)
                    .is_some_and(|beside| self.hit_between(beside, low_m, high_m))
            })
    }

    fn beside(&self, at: usize, dx: isize, dy: isize) -> Option<usize> {
        let x = (at % self.width).checked_add_signed(dx)?;
        let y = (at / self.width).checked_add_signed(dy)?;
        (x < self.width && y < self.height).then(|| y * self.width + x)
    }

    /// Spreads from the robot's own ground over all that can be stepped onto.
    pub fn flood(&mut self, robot: CellIndex, floor_z_m: f64) {
        let mut open = VecDeque::new();
        let reach = (self.terrain.shape.inscribed_radius_m() / self.terrain.config.cell_m) as i32;
        // The robot's centre may stand over a cell that no ray has met: its hull gives the start.
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let cell = CellIndex { x: robot.x + dx, y: robot.y + dy };
                let (x, y) = (cell.x - self.low.x, cell.y - self.low.y);
                if x < 0 || y < 0 || x as usize >= self.width || y as usize >= self.height {
                    continue;
                }
                let at = y as usize * self.width + x as usize;
                let nearest = self.chunk(at).and_then(|(chunk, place)| {
                    chunk.ground[place].nearest(floor_z_m, ASSUMED_STEP_M)
                });
                if let Some(surface) = nearest {
                    self.stand(at, surface.z_m, surface.seen, &mut open);
                }
            }
        }
        while let Some(at) = open.pop_front() {
            for (dx, dy) in NEIGHBOURS {
                self.step(at, dx, dy, &mut open);
            }
        }
    }

    fn stand(&mut self, at: usize, z_m: f32, seen: Seen, open: &mut VecDeque<usize>) {
        if !self.z_m[at].is_nan() || self.blocked[at] {
            return;
        }
        if self.is_obstructed(at, f64::from(z_m)) {
            self.blocked[at] = true;
            return;
        }
        self.z_m[at] = z_m;
        self.seen[at] = seen;
        open.push_back(at);
    }

    fn step(&mut self, at: usize, dx: isize, dy: isize, open: &mut VecDeque<usize>) {
        let Some(beside) = self.beside(at, dx, dy) else { return };
        if !self.z_m[beside].is_nan() || self.blocked[beside] {
            return;
        }
        if let Some((z_m, seen)) = self.surface_from(at, beside, 1.0) {
            self.stand(beside, z_m, seen, open);
        } else if dx == 0 || dy == 0 {
            self.stride(at, beside, dx, dy, open);
        }
    }

    /// The surface of `beside` that can be stepped onto from the level's ground in `at`.
    fn surface_from(&self, at: usize, beside: usize, factor: f64) -> Option<(f32, Seen)> {
        let from_m = f64::from(self.z_m[at]);
        let max_step_m = factor * self.terrain.shape.max_step_m;
        self.surfaces(beside)
            .iter()
            .map(|surface| ((f64::from(surface.z_m) - from_m).abs(), surface))
            .filter(|(rise_m, surface)| {
                let guessed = |seen: Seen| matches!(seen, Seen::Assumed | Seen::Driven);
                let assumed = guessed(surface.seen) || guessed(self.seen[at]);
                let noise_m = (2.0 * f64::from(surface.sigma_m)).min(0.03);
                *rise_m <= if assumed { ASSUMED_STEP_M } else { max_step_m + noise_m }
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, surface)| (surface.z_m, surface.seen))
    }

    /// Rolls across cells without any reading where they are fewer than the gap that a wheel rolls
    /// over and the ground goes on in line: nothing that could stop the robot fits in there, provided
    /// nothing was seen missing.
    fn stride(
        &mut self,
        at: usize,
        beside: usize,
        dx: isize,
        dy: isize,
        open: &mut VecDeque<usize>,
    ) {
        let widest = (self.terrain.shape.max_gap_m / self.terrain.config.cell_m + 1e-6) as isize;
        if widest < 1 || !self.is_blank(beside) {
            return;
        }
        for gap in 1..=widest {
            let Some(far) = self.beside(at, dx * (gap + 1), dy * (gap + 1)) else { return };
            let landing = if self.z_m[far].is_nan() {
                self.surface_from(at, far, 1.0).map(|(z_m, _)| z_m)
            } else {
                Some(self.z_m[far])
            };
            let trend_m = self.trend_m(at, -dx, -dy) * (gap + 1) as f32;
            let in_line = |z_m: &f32| {
                let rise_m = z_m - self.z_m[at];
                f64::from(rise_m.abs().min((rise_m - trend_m).abs())) <= LEVEL_STRIDE_M
            };
            if let Some(z_m) = landing.filter(in_line) {
                for inner in 1..=gap {
                    if let Some(between) = self.beside(at, dx * inner, dy * inner) {
                        let part = inner as f32 / (gap + 1) as f32;
                        let level_m = self.z_m[at] + (z_m - self.z_m[at]) * part;
                        self.stand(between, level_m, Seen::Interpolated, open);
                    }
                }
                return;
            }
            if !self.is_blank(far) {
                return;
            }
        }
    }

    /// By how much the level's ground rises per cell on the way to a cell from those in a direction.
    fn trend_m(&self, at: usize, dx: isize, dy: isize) -> f32 {
        let mut trend_m = 0.0;
        for cells in 1..=TREND_CELLS {
            let Some(beside) = self.beside(at, dx * cells, dy * cells) else { break };
            if self.z_m[beside].is_nan() {
                break;
            }
            trend_m = (self.z_m[at] - self.z_m[beside]) / cells as f32;
        }
        trend_m
    }

    fn is_blank(&self, at: usize) -> bool {
        self.z_m[at].is_nan()
            && !self.blocked[at]
            && self.chunk(at).is_none_or(|(chunk, place)| {
                let ground = &chunk.ground[place];
                ground.surfaces().is_empty() && ground.void == Void::None
            })
    }

    /// Gives every cell the height of the nearest ground of the level.
    pub fn spread_heights(&mut self, floor_z_m: f64) {
        let mut open = VecDeque::new();
        for at in 0..self.z_m.len() {
            if !self.z_m[at].is_nan() {
                self.near_z_m[at] = self.z_m[at];
                self.away[at] = 0;
                open.push_back(at);
            }
        }
        if open.is_empty() {
            self.near_z_m.fill(floor_z_m as f32);
            self.away.fill(0);
            return;
        }
        while let Some(at) = open.pop_front() {
            for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                if let Some(beside) = self.beside(at, dx, dy)
                    && self.away[beside] == u16::MAX
                {
                    self.away[beside] = self.away[at].saturating_add(1).min(u16::MAX - 1);
                    self.near_z_m[beside] = self.near_z_m[at];
                    open.push_back(beside);
                }
            }
        }
    }

    pub fn classify(&self) -> Vec<GridCell> {
        (0..self.z_m.len()).map(|at| self.classify_cell(at)).collect()
    }

    fn classify_cell(&self, at: usize) -> GridCell {
        let near_m = f64::from(self.near_z_m[at]);
        let mut cell = GridCell { class: self.class(at, near_m), ..GridCell::default() };
        if !self.z_m[at].is_nan() {
            cell.height_m = self.z_m[at];
            cell.slope = self.slope(at) as f32;
            if f64::from(cell.slope) > self.steepest() {
                cell.class = CellClass::TooSteep;
            }
        }
        if cell.class == CellClass::Occupied {
            let top_m = near_m + self.terrain.shape.height_m + 0.3;
            cell.opaque = self.hit_between(at, near_m + OPAQUE_FROM_M, top_m);
        }
        cell
    }

    /// The steepest fitted slope that still counts as drivable: the limit, and what noise adds.
    fn steepest(&self) -> f64 {
        1.1 * self.terrain.shape.max_slope_rad.tan() + 0.02
    }

    /// Ground is sure where a measured point of the level is near enough.
    pub fn mark_sure(&self, grid: &mut Grid) {
        let flat = self.terrain.config.flat_floor;
        let seeds: Vec<bool> = (0..self.z_m.len())
            .map(|at| match flat {
                true => grid.cells[at].class.is_drivable(),
                false => !self.z_m[at].is_nan() && self.seen[at] != Seen::Interpolated,
            })
            .collect();
        let reach = (grid.sure_m / grid.cell_m) as f32 + 1e-3;
        let away = distances(&seeds, grid.width, reach + 1.0);
        for (cell, away) in grid.cells.iter_mut().zip(away) {
            cell.sure = away <= reach && cell.class.is_drivable();
        }
    }

    fn class(&self, at: usize, near_m: f64) -> CellClass {
        if !self.z_m[at].is_nan() {
            return if self.seen[at] == Seen::Assumed {
                CellClass::Assumed
            } else {
                CellClass::Free
            };
        }
        if self.blocked[at] {
            return CellClass::Occupied;
        }
        let Some((chunk, place)) = self.chunk(at) else { return CellClass::Unknown };
        let shape = &self.terrain.shape;
        let away_m = f64::from(self.away[at]) * self.terrain.config.cell_m;
        let ground = &chunk.ground[place];
        let clear = ground
            .surfaces()
            .iter()
            .filter(|surface| !self.is_obstructed(at, f64::from(surface.z_m)))
            .map(|surface| f64::from(surface.z_m))
            .min_by(|a, b| (a - near_m).abs().total_cmp(&(b - near_m).abs()));
        if let Some(z_m) = clear {
            let rise_m = z_m - near_m;
            let lead_m = shape.max_slope_rad.tan() * away_m + shape.max_step_m;
            return if rise_m.abs() <= 0.10 + 0.05 * away_m && away_m > 0.3 {
                CellClass::Free
            } else if rise_m < -lead_m && away_m <= EDGE_REACH_M {
                CellClass::DropOff
            } else if rise_m > lead_m && self.is_obstructed(at, near_m) {
                CellClass::Occupied
            } else {
                CellClass::OtherLevel
            };
        }
        if self.is_obstructed(at, near_m) {
            return CellClass::Occupied;
        }
        if away_m <= EDGE_REACH_M && self.is_passed_below(chunk, place, near_m, away_m) {
            return CellClass::DropOff;
        }
        match ground.void {
            Void::Proven => return CellClass::DropOff,
            Void::Suspected => return CellClass::Suspect,
            Void::None => {}
        }
        match chunk.flat(place) {
            FLAT_OCCUPIED.. => CellClass::Occupied,
            ..=FLAT_FREE if self.terrain.config.flat_floor => CellClass::Assumed,
            ..=FLAT_FREE => CellClass::FlatFree,
            _ => CellClass::Unknown,
        }
    }

    /// Whether a ray went through the cell lower than any drivable slope from the level's nearest
    /// ground could lie.
    fn is_passed_below(&self, chunk: &Chunk, place: usize, near_m: f64, away_m: f64) -> bool {
        let slope = self.terrain.shape.max_slope_rad.tan();
        let lowest_m = near_m - slope * away_m - PASSED_BELOW_M;
        let first = bin_of(lowest_m) - BINS;
        chunk.passed(place, first) != 0
    }

    /// Slope of the plane through the level's ground in the 5 × 5 cells about a cell.
    ///
    /// A step of height h in the middle shows as a slope of 0.3 h per cell side: with cells of
    /// 0.05 m the limit of 22° is one of 0.08 m steps, too.
    fn slope(&self, at: usize) -> f64 {
        let (x0, y0) = (at % self.width, at / self.width);
        let (mut n, mut sx, mut sy, mut sz) = (0.0_f64, 0.0, 0.0, 0.0);
        let (mut sxx, mut sxy, mut syy, mut sxz, mut syz) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let centre_m = self.z_m[at];
        for y in y0.saturating_sub(2)..(y0 + 3).min(self.height) {
            for x in x0.saturating_sub(2)..(x0 + 3).min(self.width) {
                let beside = y * self.width + x;
                let z = self.z_m[beside] - centre_m;
                if z.is_nan() || matches!(self.seen[beside], Seen::Assumed | Seen::Driven) {
                    continue;
                }
                let (dx, dy, z) = (x as f64 - x0 as f64, y as f64 - y0 as f64, f64::from(z));
                n += 1.0;
                sx += dx;
                sy += dy;
                sz += z;
                sxx += dx * dx;
                sxy += dx * dy;
                syy += dy * dy;
                sxz += dx * z;
                syz += dy * z;
            }
        }
        if n < 6.0 {
            return 0.0;
        }
        let (cxx, cxy, cyy) = (sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n);
        let (cxz, cyz) = (sxz - sx * sz / n, syz - sy * sz / n);
        let determinant = cxx * cyy - cxy * cxy;
        if determinant < 1e-6 {
            return 0.0;
        }
        let along_x = (cxz * cyy - cyz * cxy) / determinant;
        let along_y = (cyz * cxx - cxz * cxy) / determinant;
        along_x.hypot(along_y) / self.terrain.config.cell_m
    }
}
