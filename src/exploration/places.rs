//! Rooms and doorways, found in the free space of the map: who looks at it thinks in rooms.
//!
//! A *core* is ground farther from any obstacle than half the widest doorway; cores large enough are
//! rooms. They grow back over the known ground all at once, and where two of them meet in a passage no
//! wider than a doorway, that is a doorway and links them. Where they meet in a wider one they are one
//! room, seen in parts. Rooms keep their identity from one map to the next by the ground they share.

use crate::terrain::{CellClass, CellIndex, Grid};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Widest passage that counts as a doorway, in metres: a double door.
const WIDEST_DOORWAY_M: f64 = 1.8;
/// Obstacles that extend less than this are furniture.
const FURNITURE_M: f64 = 2.5;
/// Least ground of a room in m².
const LEAST_ROOM_M2: f64 = 3.0;
/// Least core of a room in m²: what a bulge of a corridor has not.
const LEAST_CORE_M2: f64 = 0.25;

/// A room, hall or corridor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Room {
    /// Identity, kept from map to map and never used again.
    pub id: u32,
    /// Known ground in m².
    pub area_m2: f64,
    /// A place within it, as far from obstacles as any.
    pub middle: Point2<f64>,
    /// Cells of its ground, in order.
    #[serde(skip)]
    cells: Vec<CellIndex>,
}

/// A passage between two rooms.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Doorway {
    /// The rooms it links, the lesser identity first.
    pub rooms: (u32, u32),
    /// Its middle.
    pub middle: Point2<f64>,
    /// Clear width in metres.
    pub width_m: f64,
}

/// Rooms, doorways and their links.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Places {
    /// By identity.
    pub rooms: Vec<Room>,
    /// By the rooms they link.
    pub doorways: Vec<Doorway>,
    next_id: u32,
}

impl Places {
    /// The places of a grid; rooms that share most ground with one of `self` keep its identity.
    pub fn renewed(&self, grid: &Grid) -> Self {
        let ground = Ground::of(grid);
        let mut labels = ground.cores();
        ground.grow(&mut labels);
        let doorways = ground.join_wide(&mut labels);
        self.named(&ground, &labels, &doorways)
    }

    fn named(&self, ground: &Ground<'_>, labels: &[u32], meetings: &[Meeting]) -> Self {
        let grid = ground.grid;
        let mut by_label: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (index, &label) in labels.iter().enumerate().filter(|(_, label)| **label > 0) {
            by_label.entry(label).or_default().push(index);
        }
        let area = |cells: usize| cells as f64 * grid.cell_m() * grid.cell_m();
        by_label.retain(|_, cells| area(cells.len()) >= LEAST_ROOM_M2);
        let mut places = Self { next_id: self.next_id, ..Self::default() };
        let mut id_of = BTreeMap::new();
        let mut taken = BTreeSet::new();
        // The largest choose first.
        let mut order: Vec<(&u32, &Vec<usize>)> = by_label.iter().collect();
        order.sort_by_key(|(label, cells)| (std::cmp::Reverse(cells.len()), **label));
        for (label, indices) in order {
            let mut cells: Vec<CellIndex> = indices.iter().map(|&i| grid.cell_at(i)).collect();
            cells.sort_unstable();
            let id = self.heir_of(&cells, &taken).unwrap_or_else(|| {
                places.next_id += 1;
                places.next_id
            });
            taken.insert(id);
            id_of.insert(*label, id);
            let middle = indices.iter().copied().max_by_key(|&i| (ground.clear[i], usize::MAX - i));
            let middle = middle.map_or(cells[0], |i| grid.cell_at(i));
            let (area_m2, middle) = (area(cells.len()), grid.centre(middle));
            places.rooms.push(Room { id, area_m2, middle, cells });
        }
        places.rooms.sort_by_key(|room| room.id);
        for meeting in meetings {
            let (Some(&a), Some(&b)) = (id_of.get(&meeting.labels.0), id_of.get(&meeting.labels.1))
            else {
                continue;
            };
            places.doorways.push(Doorway {
                rooms: (a.min(b), a.max(b)),
                middle: meeting.middle,
                width_m: meeting.width_m,
            });
        }
        places.doorways.sort_by_key(|doorway| doorway.rooms);
        places
    }

    /// The identity of the old room that most of these cells belonged to.
    fn heir_of(&self, cells: &[CellIndex], taken: &BTreeSet<u32>) -> Option<u32> {
        let shared = |room: &Room| {
            cells.iter().filter(|cell| room.cells.binary_search(cell).is_ok()).count()
        };
        self.rooms
            .iter()
            .filter(|room| !taken.contains(&room.id))
            .map(|room| (shared(room), room))
            .filter(|(shared, room)| 2 * shared > room.cells.len().min(cells.len()))
            .max_by_key(|(shared, room)| (*shared, std::cmp::Reverse(room.id)))
            .map(|(_, room)| room.id)
    }
}

/// Where two rooms meet.
struct Meeting {
    labels: (u32, u32),
    middle: Point2<f64>,
    width_m: f64,
}

/// The grid as ground and what bounds it.
struct Ground<'a> {
    grid: &'a Grid,
    /// Whether a cell is known ground.
    free: Vec<bool>,
    /// Distance to the nearest obstacle or edge in tenths of a cell (chamfer 10, 14).
    clear: Vec<u32>,
}

impl<'a> Ground<'a> {
    fn of(grid: &'a Grid) -> Self {
        let free = grid
            .cells()
            .iter()
            .map(|cell| cell.class.is_drivable() || cell.class == CellClass::FlatFree)
            .collect();
        let bound = |class: CellClass| {
            matches!(class, CellClass::Occupied | CellClass::TooSteep | CellClass::DropOff)
        };
        let clear =
            grid.cells().iter().map(|cell| if bound(cell.class) { 0 } else { u32::MAX }).collect();
        let mut ground = Self { grid, free, clear };
        ground.forget_furniture();
        ground.measure();
        ground
    }

    /// What stands free and is short bounds no room: columns, benches, people.
    fn forget_furniture(&mut self) {
        let reach = (FURNITURE_M / self.grid.cell_m()) as i32;
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
            if span(|cell| cell.x).max(span(|cell| cell.y)) < reach {
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

    /// Chamfer distances, two passes.
    fn measure(&mut self) {
        let (width, height) = (self.grid.width() as i64, self.grid.height() as i64);
        let back = [(-1, 0, 10), (0, -1, 10), (-1, -1, 14), (1, -1, 14)];
        for forward in [true, false] {
            for step in 0..width * height {
                let index = if forward { step } else { width * height - 1 - step };
                let (x, y) = (index % width, index / width);
                for (dx, dy, cost) in back {
                    let (nx, ny) = if forward { (x + dx, y + dy) } else { (x - dx, y - dy) };
                    if (0..width).contains(&nx) && (0..height).contains(&ny) {
                        let other = self.clear[(ny * width + nx) as usize].saturating_add(cost);
                        let here = &mut self.clear[index as usize];
                        *here = (*here).min(other);
                    }
                }
            }
        }
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

    /// Labels from 1 for the cores that are large enough, 0 elsewhere.
    fn cores(&self) -> Vec<u32> {
        let limit = (10.0 * 0.5 * WIDEST_DOORWAY_M / self.grid.cell_m()) as u32;
        let core = |i: usize| self.free[i] && self.clear[i] > limit;
        let least = (LEAST_CORE_M2 / (self.grid.cell_m() * self.grid.cell_m())) as usize;
        let mut labels = vec![0; self.free.len()];
        let mut seen = vec![false; self.free.len()];
        let mut label = 0;
        for start in 0..self.free.len() {
            if seen[start] || !core(start) {
                continue;
            }
            seen[start] = true;
            let mut patch = vec![start];
            let mut at = 0;
            while let Some(&index) = patch.get(at) {
                at += 1;
                for next in self.neighbours(index) {
                    if !seen[next] && core(next) {
                        seen[next] = true;
                        patch.push(next);
                    }
                }
            }
            if patch.len() >= least {
                label += 1;
                for index in patch {
                    labels[index] = label;
                }
            }
        }
        labels
    }

    /// Grows the labels over the ground, those with most room around them first, so that they meet
    /// where it is narrowest.
    fn grow(&self, labels: &mut [u32]) {
        let deepest = self.clear.iter().filter(|d| **d < u32::MAX).max().copied().unwrap_or(0);
        let mut levels: Vec<VecDeque<usize>> = vec![VecDeque::new(); deepest as usize + 2];
        let level = |i: usize| (deepest + 1 - self.clear[i].min(deepest + 1)) as usize;
        for (index, _) in labels.iter().enumerate().filter(|(_, label)| **label > 0) {
            levels[level(index)].push_back(index);
        }
        let mut depth = 0;
        while depth < levels.len() {
            let Some(index) = levels[depth].pop_front() else {
                depth += 1;
                continue;
            };
            for next in self.neighbours(index) {
                if labels[next] == 0 && self.free[next] {
                    labels[next] = labels[index];
                    // Never back to a level that is done.
                    levels[level(next).max(depth)].push_back(next);
                }
            }
        }
    }

    /// Joins labels that meet in something wider than a doorway; gives the doorways that stay.
    fn join_wide(&self, labels: &mut [u32]) -> Vec<Meeting> {
        loop {
            let meetings = self.meetings(labels);
            let Some(wide) = meetings.iter().find(|meeting| meeting.width_m > WIDEST_DOORWAY_M)
            else {
                return meetings;
            };
            let (keep, gone) = wide.labels;
            labels.iter_mut().filter(|label| **label == gone).for_each(|label| *label = keep);
        }
    }

    fn meetings(&self, labels: &[u32]) -> Vec<Meeting> {
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
        let clear_m = f64::from(self.clear[widest].min(1_000_000)) * 0.1 * self.grid.cell_m();
        Meeting {
            labels,
            middle: self.grid.centre(self.grid.cell_at(widest)),
            width_m: 2.0 * clear_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::GridCell;

    /// A plan drawn in characters, half a metre each: `#` wall, `.` ground, blank unknown.
    fn plan(rows: &[&str]) -> Grid {
        let fine = 5;
        let width = rows[0].len() * fine;
        let cells = rows
            .iter()
            .rev()
            .flat_map(|row| std::iter::repeat_n(row, fine))
            .flat_map(|row| row.chars().flat_map(move |c| std::iter::repeat_n(c, fine)))
            .map(|c| GridCell {
                class: match c {
                    '#' => CellClass::Occupied,
                    '.' => CellClass::Free,
                    _ => CellClass::Unknown,
                },
                ..GridCell::default()
            })
            .collect();
        Grid::from_cells(0.1, CellIndex { x: 0, y: 0 }, width, cells)
    }

    const TWO_ROOMS: [&str; 10] = [
        "###################",
        "#........#........#",
        "#........#........#",
        "#........#........#",
        "#.................#",
        "#.................#",
        "#........#........#",
        "#........#........#",
        "#........#........#",
        "###################",
    ];

    #[test]
    fn a_doorway_links_two_rooms() {
        let places = Places::default().renewed(&plan(&TWO_ROOMS));
        assert_eq!(places.rooms.len(), 2, "{places:?}");
        assert_eq!(places.doorways.len(), 1, "{places:?}");
        let doorway = &places.doorways[0];
        assert_eq!(doorway.rooms, (places.rooms[0].id, places.rooms[1].id));
        assert!((doorway.width_m - 1.0).abs() < 0.25, "{doorway:?}");
        assert!((doorway.middle - Point2::new(4.75, 2.5)).norm() < 0.5, "{doorway:?}");
        assert!(places.rooms.iter().all(|room| (room.area_m2 - 16.25).abs() < 1.0), "{places:?}");
    }

    #[test]
    fn a_room_keeps_its_identity_when_the_map_grows() {
        let half: Vec<String> = TWO_ROOMS.iter().map(|row| format!("{:19}", &row[..10])).collect();
        let half: Vec<&str> = half.iter().map(String::as_str).collect();
        let before = Places::default().renewed(&plan(&half));
        assert_eq!(before.rooms.len(), 1, "{before:?}");
        let after = before.renewed(&plan(&TWO_ROOMS));
        assert_eq!(after.rooms.len(), 2);
        let kept = after.rooms.iter().find(|room| room.id == before.rooms[0].id);
        assert!(kept.is_some_and(|room| room.middle.x < 4.5), "{after:?}");
    }

    #[test]
    fn a_table_divides_no_room() {
        let mut rows = TWO_ROOMS.map(|row| row.replace(".#.", "..."));
        rows[4] = "#.....####........#".into();
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let places = Places::default().renewed(&plan(&rows));
        assert_eq!((places.rooms.len(), places.doorways.len()), (1, 0), "{places:?}");
    }

    #[test]
    fn a_wide_opening_is_no_doorway() {
        let mut rows = TWO_ROOMS;
        for row in &mut rows[1..9] {
            *row = "#.................#";
        }
        rows[1] = TWO_ROOMS[1];
        let places = Places::default().renewed(&plan(&rows));
        assert_eq!((places.rooms.len(), places.doorways.len()), (1, 0), "{places:?}");
    }
}
