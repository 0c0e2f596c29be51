//! Where seen ground ends and the unknown begins.

use crate::terrain::{CellClass, CellIndex, Grid};
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

/// A connected stretch of drivable ground beside unknown ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frontier {
    /// The cell of the stretch that is nearest to its middle.
    pub cell: CellIndex,
    /// Centre of that cell in the map.
    pub at: Point2<f64>,
    /// Number of cells.
    pub cells: usize,
    /// Of those, cells that the robot's centre can be driven to.
    pub reachable: usize,
    /// Whether it borders suspected edges rather than plain unknown ground.
    pub suspect: bool,
}

/// All frontiers of at least `least_cells` cells, in the order of their first cells.
pub(super) fn frontiers(grid: &Grid, least_cells: usize) -> Vec<Frontier> {
    let cells = grid.cells();
    let (width, height) = (grid.width(), grid.height());
    let beside = |at: usize| {
        let (x, y) = (at % width, at / width);
        [
            (x > 0).then(|| at - 1),
            (x + 1 < width).then_some(at + 1),
            (y > 0).then(|| at.wrapping_sub(width)),
            (y + 1 < height).then_some(at + width),
        ]
    };
    // 1 borders the unknown, 2 borders a suspected edge; taken cells become 0 again.
    let mut kind = vec![0_u8; cells.len()];
    for at in 0..cells.len() {
        if !cells[at].class.is_drivable() {
            continue;
        }
        for other in beside(at) {
            let class = other.map_or(CellClass::Unknown, |other| cells[other].class);
            kind[at] = match class {
                CellClass::Unknown | CellClass::FlatFree => 1,
                CellClass::Suspect if kind[at] == 0 => 2,
                _ => kind[at],
            };
        }
    }
    let mut found = Vec::new();
    let mut members = Vec::new();
    for first in 0..cells.len() {
        let this = kind[first];
        if this == 0 {
            continue;
        }
        members.clear();
        members.push(first);
        kind[first] = 0;
        let mut next = 0;
        while next < members.len() {
            let at = members[next];
            next += 1;
            let (x, y) = (at % width, at / width);
            for near_y in y.saturating_sub(1)..(y + 2).min(height) {
                for near_x in x.saturating_sub(1)..(x + 2).min(width) {
                    let near = near_y * width + near_x;
                    if kind[near] == this {
                        kind[near] = 0;
                        members.push(near);
                    }
                }
            }
        }
        if members.len() >= least_cells {
            found.push(summary(grid, &members, this == 2));
        }
    }
    found
}

fn summary(grid: &Grid, members: &[usize], suspect: bool) -> Frontier {
    let count = members.len() as f64;
    let (mut x, mut y) = (0.0, 0.0);
    for &at in members {
        let cell = grid.cell_at(at);
        x += f64::from(cell.x) / count;
        y += f64::from(cell.y) / count;
    }
    let off = |cell: CellIndex| (f64::from(cell.x) - x).hypot(f64::from(cell.y) - y);
    let cell = members
        .iter()
        .map(|&at| grid.cell_at(at))
        .min_by(|a, b| off(*a).total_cmp(&off(*b)).then(a.cmp(b)))
        .expect("a frontier has at least its first cell");
    Frontier {
        cell,
        at: grid.centre(cell),
        cells: members.len(),
        reachable: members.iter().filter(|&&at| grid.cells()[at].reachable).count(),
        suspect,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::GridCell;

    fn grid(rows: &[&str]) -> Grid {
        let width = rows[0].len();
        let cells = rows
            .iter()
            .flat_map(|row| row.chars())
            .map(|c| GridCell {
                class: match c {
                    '.' => CellClass::Free,
                    '#' => CellClass::Occupied,
                    'D' => CellClass::DropOff,
                    '?' => CellClass::Suspect,
                    _ => CellClass::Unknown,
                },
                ..GridCell::default()
            })
            .collect();
        Grid::from_cells(0.05, CellIndex::default(), width, cells)
    }

    #[test]
    fn frontiers_lie_between_seen_and_unknown_ground_only() {
        let found = frontiers(
            &grid(&[
                "##########",
                "#...  ...#",
                "#...  ...#",
                "#........D",
                "###....??#",
                "  ########",
            ]),
            1,
        );
        let kinds: Vec<_> = found.iter().map(|f| (f.cells, f.suspect)).collect();
        // Around the unknown patch: two on each side and two below; above the suspected edge: two.
        assert_eq!(kinds, [(6, false), (3, true)], "{found:?}");
    }
}
