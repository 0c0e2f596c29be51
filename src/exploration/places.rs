//! Rooms and doorways, found in the free space of the map and between its planes: who looks at it thinks in
//! rooms.
//!
//! The known ground is a landscape whose height is the distance from obstacles and from walls, which the grid
//! shows where their feet were seen and the upright planes wherever they were seen. Rooms are its hills: where
//! two meet in a pass that is no wider than a doorway, and the ground widens on both sides of it as it does
//! on both sides of a wall, that is a doorway and links them. Elsewhere they are one room: a corridor is a
//! ridge, however narrow and cluttered. Rooms keep their identity from one map to the next by the ground
//! that they share, doorways by where they are.

mod landscape;
mod walls;

pub use walls::Walls;

use crate::terrain::{CellIndex, Grid};
use landscape::{Ground, Meeting};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Least ground of a room in m².
const LEAST_ROOM_M2: f64 = 3.0;
/// A doorway whose middle moved by less, as a map is corrected or shows more of it, is the same.
const SAME_DOORWAY_M: f64 = 0.5;

/// A room, hall or corridor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Room {
    /// Identity, kept from map to map and never used again.
    pub id: u32,
    /// Known ground in m².
    pub area_m2: f64,
    /// A place within it, as far from its walls and from what is unknown as any.
    pub middle: Point2<f64>,
    /// Cells of its ground, in order.
    #[serde(skip)]
    cells: Vec<CellIndex>,
}

/// A passage between two rooms.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Doorway {
    /// Identity among the doorways, kept from map to map and never used again.
    pub id: u32,
    /// The rooms it links, the lesser identity first.
    pub rooms: (u32, u32),
    /// Its middle.
    pub middle: Point2<f64>,
    /// Clear width in metres.
    pub width_m: f64,
}

/// Rooms, doorways and their links.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Places {
    /// By identity.
    pub rooms: Vec<Room>,
    /// By identity.
    pub doorways: Vec<Doorway>,
    next_id: u32,
    next_doorway_id: u32,
}

impl Default for Places {
    fn default() -> Self {
        Self { rooms: Vec::new(), doorways: Vec::new(), next_id: 1, next_doorway_id: 1 }
    }
}

impl Places {
    /// The places of a grid between walls; rooms that share most ground with one of `self` keep its identity,
    /// doorways that are where one was theirs.
    pub fn renewed(&self, grid: &Grid, walls: &Walls) -> Self {
        let ground = Ground::of(grid, walls);
        let labels = ground.flood();
        let doorways = ground.meetings(&labels);
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
        let mut places = Self {
            next_id: self.next_id,
            next_doorway_id: self.next_doorway_id,
            ..Self::default()
        };
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
                places.next_id - 1
            });
            taken.insert(id);
            id_of.insert(*label, id);
            let middle =
                indices.iter().copied().max_by_key(|&i| (ground.inside[i], usize::MAX - i));
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
            let id = self.old_doorway(&meeting.middle, &places.doorways).unwrap_or_else(|| {
                places.next_doorway_id += 1;
                places.next_doorway_id - 1
            });
            places.doorways.push(Doorway {
                id,
                rooms: (a.min(b), a.max(b)),
                middle: meeting.middle,
                width_m: meeting.width_m,
            });
        }
        places.doorways.sort_by_key(|doorway| doorway.id);
        places
    }

    /// The identity of the old doorway that is nearest to a place and none of those `taken`.
    fn old_doorway(&self, middle: &Point2<f64>, taken: &[Doorway]) -> Option<u32> {
        self.doorways
            .iter()
            .filter(|old| taken.iter().all(|doorway| doorway.id != old.id))
            .map(|old| ((old.middle - middle).norm(), old.id))
            .filter(|(apart_m, _)| *apart_m < SAME_DOORWAY_M)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, id)| id)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{Landmark, LandmarkId, MASK_CELL_M, Opening, PlaneMask};
    use crate::terrain::{CellClass, GridCell};
    use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

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
                height_m: if c == '.' { 0.0 } else { f32::NAN },
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
        let places = Places::default().renewed(&plan(&TWO_ROOMS), &Walls::default());
        assert_eq!(places.rooms.len(), 2, "{places:?}");
        assert_eq!(places.doorways.len(), 1, "{places:?}");
        let doorway = &places.doorways[0];
        assert_eq!(places.renewed(&plan(&TWO_ROOMS), &Walls::default()).doorways[0].id, doorway.id);
        // Elsewhere in the same wall it is another one.
        let mut moved = TWO_ROOMS;
        moved[1..6].rotate_left(3);
        let moved = places.renewed(&plan(&moved), &Walls::default());
        assert_eq!(moved.doorways.len(), 1, "{moved:?}");
        assert_ne!(moved.doorways[0].id, doorway.id);
        assert_eq!(doorway.rooms, (places.rooms[0].id, places.rooms[1].id));
        assert!((doorway.width_m - 1.0).abs() < 0.25, "{doorway:?}");
        assert!((doorway.middle - Point2::new(4.75, 2.5)).norm() < 0.5, "{doorway:?}");
        assert!(places.rooms.iter().all(|room| (room.area_m2 - 16.25).abs() < 1.0), "{places:?}");
    }

    /// Upright squares of a plane along y, from `y_m` on, each covered over some heights.
    fn wall(x_m: f64, spans: &[(f64, f64, f64, f64)]) -> Landmark {
        let world_from_plane = Isometry3::from_parts(
            Translation3::new(x_m, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2),
        );
        let mut mask = PlaneMask::default();
        for &(from_m, to_m, low_m, high_m) in spans {
            let steps = |low: f64, high: f64| {
                let count = ((high - low) / MASK_CELL_M).round() as i32;
                (0..count).map(move |k| low + (f64::from(k) + 0.5) * MASK_CELL_M)
            };
            for y_m in steps(from_m, to_m) {
                steps(low_m, high_m).for_each(|z_m| mask.insert(&Point2::new(-z_m, y_m)));
            }
        }
        Landmark {
            id: LandmarkId(0),
            world_from_plane,
            covariance: Matrix3::identity(),
            hull: Vec::new(),
            points: mask.count(),
            mask,
            rms_m: 0.0,
            sightings: 1,
            first_keyframe: 0,
            last_keyframe: 0,
            gone: false,
            openings: Vec::new(),
        }
    }

    #[test]
    fn a_wall_whose_foot_was_not_seen_divides_rooms_and_its_doorway_links_them() {
        // The dividing wall stands behind benches that hide where it meets the floor: unknown there, and beside
        // its doorway the grid is as open as in it.
        let hidden = TWO_ROOMS.map(|row| row.replace(".#.", "..."));
        let rows: Vec<&str> = hidden.iter().map(String::as_str).collect();
        let grid = plan(&rows);
        let alone = Places::default().renewed(&grid, &Walls::default());
        assert_eq!((alone.rooms.len(), alone.doorways.len()), (1, 0), "{alone:?}");
        // Up to the ceiling, over the doorway its lintel from 1.9 m on.
        let spans = [(0.0, 2.0, 0.5, 2.5), (2.0, 3.0, 1.9, 2.5), (3.0, 5.0, 0.5, 2.5)];
        let places = Places::default().renewed(&grid, &Walls::of(&[wall(4.75, &spans)]));
        assert_eq!((places.rooms.len(), places.doorways.len()), (2, 1), "{places:?}");
        let doorway = &places.doorways[0];
        assert!((doorway.width_m - 1.0).abs() < 0.25, "{doorway:?}");
        assert!((doorway.middle - Point2::new(4.75, 2.5)).norm() < 0.5, "{doorway:?}");
        // A door that was shut when the wall was seen, and open later, is one.
        let mut shut = wall(4.75, &[(0.0, 5.0, 0.5, 2.5)]);
        let closed = Places::default().renewed(&grid, &Walls::of([&shut]));
        assert_eq!((closed.rooms.len(), closed.doorways.len()), (2, 0), "{closed:?}");
        shut.openings.push(Opening { centre: Point2::new(-1.0, 2.5), radius_m: 0.6 });
        let opened = Places::default().renewed(&grid, &Walls::of([&shut]));
        assert_eq!((opened.rooms.len(), opened.doorways.len()), (2, 1), "{opened:?}");
        // A back that ends at a bench's height, and what hangs from the ceiling, divide nothing.
        for (low_m, high_m) in [(0.0, 0.8), (1.9, 2.6)] {
            let across = wall(4.75, &[(0.0, 5.0, low_m, high_m)]);
            let places = Places::default().renewed(&grid, &Walls::of(&[across]));
            assert_eq!(places.rooms.len(), 1, "{low_m} to {high_m} m: {places:?}");
        }
    }

    #[test]
    fn a_room_keeps_its_identity_when_the_map_grows() {
        let half: Vec<String> = TWO_ROOMS.iter().map(|row| format!("{:19}", &row[..10])).collect();
        let half: Vec<&str> = half.iter().map(String::as_str).collect();
        let before = Places::default().renewed(&plan(&half), &Walls::default());
        assert_eq!(before.rooms.len(), 1, "{before:?}");
        let after = before.renewed(&plan(&TWO_ROOMS), &Walls::default());
        assert_eq!(after.rooms.len(), 2);
        let kept = after.rooms.iter().find(|room| room.id == before.rooms[0].id);
        assert!(kept.is_some_and(|room| room.middle.x < 4.5), "{after:?}");
    }

    #[test]
    fn a_table_divides_no_room() {
        let mut rows = TWO_ROOMS.map(|row| row.replace(".#.", "..."));
        rows[4] = "#.....####........#".into();
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let places = Places::default().renewed(&plan(&rows), &Walls::default());
        assert_eq!((places.rooms.len(), places.doorways.len()), (1, 0), "{places:?}");
    }

    /// Who drives through sees the far half of each room: corners of two walls, none of them long.
    #[test]
    fn rooms_that_are_seen_ahead_only_have_their_doorways() {
        let rows = [
            "     ####     ####",
            "     ...#     ...#",
            " .......# .......#",
            " .......# .......#",
            "..................",
            "..................",
            " .......# .......#",
            " .......# .......#",
            "     ...#     ...#",
            "     ####     ####",
        ];
        let places = Places::default().renewed(&plan(&rows), &Walls::default());
        assert_eq!((places.rooms.len(), places.doorways.len()), (2, 1), "{places:?}");
    }

    #[test]
    fn an_office_has_a_corridor_and_its_rooms_and_their_doors() {
        // A corridor of 1.5 m with two rooms above and three below, and a locker that stands in it.
        let rows = [
            "#########################",
            "#...........#...........#",
            "#...........#...........#",
            "#...........#...........#",
            "#...........#...........#",
            "#####..###########..#####",
            "#..............#........#",
            "#.......................#",
            "#.......................#",
            "###..######..#######..###",
            "#.......#.......#.......#",
            "#.......#.......#.......#",
            "#.......#.......#.......#",
            "#.......#.......#.......#",
            "#########################",
        ];
        let places = Places::default().renewed(&plan(&rows), &Walls::default());
        assert_eq!((places.rooms.len(), places.doorways.len()), (6, 5), "{places:?}");
        let corridor = places.rooms.iter().max_by(|a, b| a.area_m2.total_cmp(&b.area_m2));
        let corridor = corridor.map(|room| room.id).unwrap();
        for doorway in &places.doorways {
            let (a, b) = doorway.rooms;
            assert!(a == corridor || b == corridor, "{doorway:?}");
            assert!((doorway.width_m - 1.0).abs() < 0.25, "{doorway:?}");
        }
    }

    #[test]
    fn a_gap_between_points_of_a_wall_is_no_doorway() {
        let mut grid = plan(
            &TWO_ROOMS.map(
                |row| {
                    if row.as_bytes()[9] == b'.' { "#........#........#" } else { row }
                },
            ),
        );
        let gaps: Vec<usize> = (0..grid.cells().len())
            .filter(|&i| {
                let cell = grid.cell_at(i);
                (45..50).contains(&cell.x) && (20..22).contains(&cell.y)
            })
            .collect();
        let mut cells = grid.cells().to_vec();
        for index in gaps {
            cells[index].class = CellClass::Free;
        }
        grid = Grid::from_cells(0.1, CellIndex { x: 0, y: 0 }, grid.width(), cells);
        let places = Places::default().renewed(&grid, &Walls::default());
        assert_eq!((places.rooms.len(), places.doorways.len()), (2, 0), "{places:?}");
    }

    #[test]
    fn a_wide_opening_is_no_doorway() {
        let mut rows = TWO_ROOMS;
        for row in &mut rows[1..9] {
            *row = "#.................#";
        }
        rows[1] = TWO_ROOMS[1];
        let places = Places::default().renewed(&plan(&rows), &Walls::default());
        assert_eq!((places.rooms.len(), places.doorways.len()), (1, 0), "{places:?}");
    }
}
