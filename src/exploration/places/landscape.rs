//! The known ground as a landscape, whose height is the distance from obstacles and walls, flooded from its tops down.

use super::walls::Walls;
use crate::terrain::{CellClass, CellIndex, Grid};
use nalgebra::{Point2, Vector2};
use std::collections::{BTreeMap, BTreeSet};

/// Widest passage that counts as a doorway, in metres: a double door.
const WIDEST_DOORWAY_M: f64 = 1.8;
/// Obstacles that extend less than this along each axis, and less than the second along both together, are
/// furniture: the corner of two walls that are half seen is none.
const FURNITURE_M: f64 = 2.5;
const CORNER_M: f64 = 3.6;
/// Width of the widest place of a room, at least: what is narrower is a gap beside one.
const NARROWEST_ROOM_M: f64 = 0.9;
/// A doorway is narrower than this share of the widest place of the rooms on both sides. A door of 0.9 m
/// has two thirds of the circle that fits before it into a corridor of 1.2 m; beside two doors that face
/// each other the corridor itself has no less than three quarters of the circle between them.
const NARROWING: f64 = 0.72;
/// Beyond a doorway, on both sides of the wall that it is in, the ground is wider by this much, in metres:
/// what merely stands beside the wall of a corridor is passed along that wall.
const OPENS_M: f64 = 0.8;
/// How far from the middle of a doorway that shows, in metres: walls differ in thickness.
const THROUGH_M: [f64; 3] = [0.4, 0.6, 0.8];
/// Cosine of the angle between the directions to both jambs, at most.
const OPPOSITE: f64 = -0.7;
/// A jamb is no farther than this many times the distance of the nearer one.
const ABOUT_AS_NEAR: f64 = 1.3;
/// Narrowest passage that counts as a doorway, in metres: what is left between points of a wall is none.
const NARROWEST_DOORWAY_M: f64 = 0.4;

/// How many cells beside a wall the ground is looked for that it bounds.
const BESIDE_CELLS: i32 = 5;

/// Where two rooms meet.
pub(super) struct Meeting {
    pub labels: (u32, u32),
    pub middle: Point2<f64>,
    pub width_m: f64,
}

/// Floods that have met; numbers from 1.
struct Floods {
    parents: Vec<u32>,
    /// Greatest distance from obstacles of each.
    peaks: Vec<u32>,
    /// Those that met in a doorway.
    apart: Vec<(u32, u32)>,
}

impl Floods {
    fn rise(&mut self, peak: u32) -> u32 {
        let label = self.parents.len() as u32;
        self.parents.push(label);
        self.peaks.push(peak);
        label
    }

    fn root(&mut self, mut label: u32) -> u32 {
        while self.parents[label as usize] != label {
            let above = self.parents[label as usize];
            self.parents[label as usize] = self.parents[above as usize];
            label = above;
        }
        label
    }

    /// Whether two roots met in a doorway: where else they meet it is narrower still.
    fn are_apart(&mut self, a: u32, b: u32) -> bool {
        (0..self.apart.len()).any(|k| {
            let (c, d) = self.apart[k];
            let met = (self.root(c), self.root(d));
            met == (a, b) || met == (b, a)
        })
    }

    fn lower_peak(&self, a: u32, b: u32) -> u32 {
        self.peaks[a as usize].min(self.peaks[b as usize])
    }

    /// The higher one takes the other in, of equal ones the first.
    fn join(&mut self, a: u32, b: u32) {
        let higher = |label: u32| (self.peaks[label as usize], std::cmp::Reverse(label));
        let (keep, gone) = if higher(a) > higher(b) { (a, b) } else { (b, a) };
        self.parents[gone as usize] = keep;
    }
}

fn is_ground(class: CellClass) -> bool {
    class.is_drivable() || class == CellClass::FlatFree
}

/// Height of the known ground nearest to a cell, no farther than [`BESIDE_CELLS`] along each axis.
fn ground_beside(grid: &Grid, cell: CellIndex) -> Option<f64> {
    let about = -BESIDE_CELLS..=BESIDE_CELLS;
    let near = about.clone().flat_map(|dy| about.clone().map(move |dx| (dx, dy)));
    near.map(|(dx, dy)| (dx * dx + dy * dy, grid.get(CellIndex { x: cell.x + dx, y: cell.y + dy })))
        .filter(|(_, cell)| is_ground(cell.class) && cell.height_m.is_finite())
        .min_by_key(|(squared, _)| *squared)
        .map(|(_, cell)| f64::from(cell.height_m))
}

/// The grid as ground and what bounds it.
pub(super) struct Ground<'a> {
    pub grid: &'a Grid,
    /// Whether a cell is known ground.
    free: Vec<bool>,
    /// Distance to the nearest obstacle or edge in tenths of a cell (chamfer 10, 14).
    clear: Vec<u32>,
    /// The same to the nearest cell that is no known ground.
    pub inside: Vec<u32>,
}

impl<'a> Ground<'a> {
    pub fn of(grid: &'a Grid, walls: &Walls) -> Self {
        let mut free: Vec<bool> = grid.cells().iter().map(|cell| is_ground(cell.class)).collect();
        let bound = |class: CellClass| {
            matches!(class, CellClass::Occupied | CellClass::TooSteep | CellClass::DropOff)
        };
        let mut clear: Vec<u32> =
            grid.cells().iter().map(|cell| if bound(cell.class) { 0 } else { u32::MAX }).collect();
        for column in walls.columns() {
            let cell = grid.cell_of(column.at.x, column.at.y);
            let (Some(index), Some(ground_m)) = (grid.index(cell), ground_beside(grid, cell))
            else {
                continue;
            };
            if column.bounds(ground_m) {
                (clear[index], free[index]) = (0, false);
            }
        }
        let inside = free.iter().map(|&free| if free { u32::MAX } else { 0 }).collect();
        let mut ground = Self { grid, free, clear, inside };
        ground.forget_furniture();
        measure(&mut ground.clear, grid);
        measure(&mut ground.inside, grid);
        ground
    }

    /// What stands free and is short bounds no room: columns, benches, people.
    fn forget_furniture(&mut self) {
        let cells_of = |metres: f64| (metres / self.grid.cell_m()) as i32;
        let (reach, corner) = (cells_of(FURNITURE_M), cells_of(CORNER_M));
        let mut seen = vec![false; self.clear.len()];
        for start in 0..self.clear.len() {
            if seen[start] || self.clear[start] > 0 {
                continue;
            }
            seen[start] = true;
            let mut piece = vec![start];
            let mut at = 0;
            while let Some(&index) = piece.get(at) {
                at += 1;
                for next in self.around(index) {
                    if !seen[next] && self.clear[next] == 0 {
                        seen[next] = true;
                        piece.push(next);
                    }
                }
            }
            let cells: Vec<CellIndex> = piece.iter().map(|&i| self.grid.cell_at(i)).collect();
            let span = |of: fn(&CellIndex) -> i32| {
                let (low, high) = (cells.iter().map(of).min(), cells.iter().map(of).max());
                high.unwrap_or(0) - low.unwrap_or(0)
            };
            let (along_x, along_y) = (span(|cell| cell.x), span(|cell| cell.y));
            if along_x.max(along_y) < reach && along_x + along_y < corner {
                for index in piece {
                    self.clear[index] = u32::MAX;
                }
            }
        }
    }

    /// The eight neighbours of a cell and those one farther: walls are seen with gaps.
    fn around(&self, index: usize) -> Vec<usize> {
        let (width, height) = (self.grid.width() as i64, self.grid.height() as i64);
        let (x, y) = (index as i64 % width, index as i64 / width);
        let mut found = Vec::with_capacity(24);
        for ny in (y - 2).max(0)..=(y + 2).min(height - 1) {
            for nx in (x - 2).max(0)..=(x + 2).min(width - 1) {
                found.push((ny * width + nx) as usize);
            }
        }
        found
    }

    fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> + '_ {
        let (width, height) = (self.grid.width() as i64, self.grid.height() as i64);
        let (x, y) = (index as i64 % width, index as i64 / width);
        [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter_map(move |(dx, dy)| {
            let (nx, ny) = (x + dx, y + dy);
            ((0..width).contains(&nx) && (0..height).contains(&ny))
                .then_some((ny * width + nx) as usize)
        })
    }

    /// Labels from 1 for rooms, 0 where there is no ground: the ground is flooded from the places with
    /// most room around them down, and where two floods meet they are one unless it is narrow there.
    pub fn flood(&self) -> Vec<u32> {
        let mut order: Vec<usize> = (0..self.free.len()).filter(|&i| self.free[i]).collect();
        order.sort_by_key(|&i| (std::cmp::Reverse(self.clear[i]), i));
        let mut floods = Floods { parents: vec![0], peaks: vec![0], apart: Vec::new() };
        let mut labels = vec![0; self.free.len()];
        for index in order {
            let clear = self.clear[index];
            let beside = self.neighbours(index).filter(|&next| labels[next] > 0);
            // What has most room around it is where the cell belongs; of equal ones the first.
            let own = beside.max_by_key(|&next| (self.clear[next], usize::MAX - next));
            labels[index] = match own {
                Some(next) => floods.root(labels[next]),
                None => floods.rise(clear),
            };
            for next in self.neighbours(index).filter(|&next| labels[next] > 0) {
                let (own, other) = (floods.root(labels[index]), floods.root(labels[next]));
                if own == other || floods.are_apart(own, other) {
                    continue;
                }
                if self.is_doorway(index, floods.lower_peak(own, other)) {
                    floods.apart.push((own, other));
                } else {
                    floods.join(own, other);
                }
            }
        }
        labels.iter_mut().for_each(|label| *label = floods.root(*label));
        labels
    }

    /// Whether two rooms, of which the narrower one's widest place is so far from obstacles, meet in a
    /// doorway at the middle of a pass.
    fn is_doorway(&self, index: usize, peak: u32) -> bool {
        let width_m = 2.0 * self.metres(self.clear[index]);
        width_m <= WIDEST_DOORWAY_M
            && 2.0 * self.metres(peak) >= NARROWEST_ROOM_M
            && f64::from(self.clear[index]) < NARROWING * f64::from(peak)
            && self.across(index).is_some_and(|across| {
                let through = Vector2::new(-across.y, across.x);
                [through, -through]
                    .iter()
                    .all(|ahead| self.opens(index, ahead, &across, width_m + OPENS_M))
            })
    }

    /// The direction from jamb to jamb of a pass, from the nearest obstacle to one about as near on the other
    /// side.
    fn across(&self, index: usize) -> Option<Vector2<f64>> {
        let middle = self.grid.cell_at(index);
        let reach =
            (ABOUT_AS_NEAR * self.metres(self.clear[index]) / self.grid.cell_m()).ceil() as i32;
        let mut near: Vec<(i32, Vector2<f64>)> = Vec::new();
        for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
            let cell = CellIndex { x: middle.x + dx, y: middle.y + dy };
            let is_bound = self.grid.index(cell).is_some_and(|i| self.clear[i] == 0);
            if is_bound && dx * dx + dy * dy <= reach * reach {
                near.push((dx * dx + dy * dy, Vector2::new(f64::from(dx), f64::from(dy))));
            }
        }
        let first = near.iter().min_by_key(|(square, _)| *square)?.1;
        let cosine = |other: &Vector2<f64>| first.normalize().dot(&other.normalize());
        let opposite = near.iter().map(|(_, other)| other);
        let opposite = opposite.min_by(|a, b| cosine(a).total_cmp(&cosine(b)))?;
        (cosine(opposite) < OPPOSITE).then(|| (first - opposite).normalize())
    }

    /// Whether known ground soon is so wide beyond a pass.
    fn opens(
        &self,
        index: usize,
        ahead: &Vector2<f64>,
        across: &Vector2<f64>,
        least_m: f64,
    ) -> bool {
        let cell_m = self.grid.cell_m();
        let middle = self.grid.centre(self.grid.cell_at(index));
        let is_free = |at: Point2<f64>| {
            let cell = self.grid.cell_of(at.x, at.y);
            self.grid.index(cell).is_some_and(|i| self.free[i] && self.clear[i] > 0)
        };
        let free_m = |from: Point2<f64>, along: Vector2<f64>| {
            let steps = (least_m / cell_m).ceil() as usize;
            let clear = (1..=steps).take_while(|&n| is_free(from + along * (n as f64 * cell_m)));
            clear.count() as f64 * cell_m
        };
        THROUGH_M.iter().any(|&away_m| {
            let beyond = middle + ahead * away_m;
            is_free(beyond) && free_m(beyond, *across) + free_m(beyond, -across) >= least_m
        })
    }

    fn metres(&self, clear: u32) -> f64 {
        f64::from(clear.min(1_000_000)) * 0.1 * self.grid.cell_m()
    }

    /// Where the rooms of these labels meet in doorways, in the order of the labels.
    pub fn meetings(&self, labels: &[u32]) -> Vec<Meeting> {
        let mut borders: BTreeMap<(u32, u32), BTreeSet<usize>> = BTreeMap::new();
        for index in (0..labels.len()).filter(|&i| labels[i] > 0) {
            for next in self.neighbours(index) {
                if labels[next] > labels[index] {
                    borders.entry((labels[index], labels[next])).or_default().insert(index);
                }
            }
        }
        borders
            .into_iter()
            .flat_map(|(pair, border)| self.pieces(border).into_iter().map(move |p| (pair, p)))
            .map(|(labels, piece)| self.meeting(labels, &piece))
            .filter(|meeting| meeting.width_m >= NARROWEST_DOORWAY_M)
            .collect()
    }

    /// Connected pieces of a border, cells apart by less than a pillar counting as connected.
    fn pieces(&self, mut border: BTreeSet<usize>) -> Vec<Vec<usize>> {
        let reach = 0.3 / self.grid.cell_m();
        let near = |a: usize, b: usize| {
            let (a, b) = (self.grid.cell_at(a), self.grid.cell_at(b));
            f64::from(a.x - b.x).hypot(f64::from(a.y - b.y)) <= reach
        };
        let mut pieces = Vec::new();
        while let Some(first) = border.pop_first() {
            let mut piece = vec![first];
            let mut at = 0;
            while let Some(&index) = piece.get(at) {
                at += 1;
                let joined: Vec<usize> =
                    border.iter().copied().filter(|&other| near(index, other)).collect();
                for other in joined {
                    border.remove(&other);
                    piece.push(other);
                }
            }
            pieces.push(piece);
        }
        pieces
    }

    /// A doorway is as wide as the clear space about its narrowest line: twice the greatest distance to
    /// what bounds it.
    fn meeting(&self, labels: (u32, u32), piece: &[usize]) -> Meeting {
        let widest = piece.iter().copied().max_by_key(|&i| (self.clear[i], usize::MAX - i));
        let widest = widest.expect("pieces are not empty");
        Meeting {
            labels,
            middle: self.grid.centre(self.grid.cell_at(widest)),
            width_m: 2.0 * self.metres(self.clear[widest]),
        }
    }
}

/// Fills in chamfer distances from the cells that have zero, in two passes.
fn measure(away: &mut [u32], grid: &Grid) {
    let (width, height) = (grid.width() as i64, grid.height() as i64);
    let back = [(-1, 0, 10), (0, -1, 10), (-1, -1, 14), (1, -1, 14)];
    for forward in [true, false] {
        for step in 0..width * height {
            let index = if forward { step } else { width * height - 1 - step };
            let (x, y) = (index % width, index / width);
            for (dx, dy, cost) in back {
                let (nx, ny) = if forward { (x + dx, y + dy) } else { (x - dx, y - dy) };
                if (0..width).contains(&nx) && (0..height).contains(&ny) {
                    let other = away[(ny * width + nx) as usize].saturating_add(cost);
                    let here = &mut away[index as usize];
                    *here = (*here).min(other);
                }
            }
        }
    }
}
