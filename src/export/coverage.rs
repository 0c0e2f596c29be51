//! Coverage: how much of the floor that the robot can be driven to has been explored.
//!
//! Truth side: floor cells of 0.10 m of the true map that the robot's footprint can be driven to.
//! Run side: the grid and the measured ground of the run's files. Neither is known to the agent.

use crate::sim::World;
use nalgebra::{Point2, Point3};
use std::collections::{BTreeMap, VecDeque};

/// Side of a floor cell, by definition.
pub const CELL_M: f64 = 0.10;

/// A measured ground point counts for cells within this distance of it, by definition.
const NEAR_GROUND_M: f64 = 0.30;

/// What the robot's body can pass, for the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passability {
    /// Radius of the circle that must find ground and air.
    pub radius_m: f64,
    /// Air that is needed above the ground.
    pub height_m: f64,
    /// Highest step.
    pub max_step_m: f64,
    /// Steepest slope, rise over run.
    pub max_slope: f64,
    /// Widest gap.
    pub max_gap_m: f64,
}

/// One floor cell: its place on the lattice and the height of its floor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FloorCell {
    /// Lattice index; the cell's centre is `(index + 0.5) * CELL_M`.
    pub x: i32,
    /// Lattice index.
    pub y: i32,
    /// Height of the floor in metres.
    pub z_m: f64,
}

impl FloorCell {
    /// Centre of the cell.
    pub fn centre(&self) -> Point2<f64> {
        Point2::new((f64::from(self.x) + 0.5) * CELL_M, (f64::from(self.y) + 0.5) * CELL_M)
    }
}

/// What a run knows, on its own lattice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Side of a cell in metres.
    pub cell_m: f64,
    /// Lower left corner of cell (0, 0) in metres.
    pub origin_m: [f64; 2],
    /// Cells along x.
    pub width: usize,
    /// Whether the grid calls a cell free or obstacle; rows along x, the lowest y first.
    pub known: Vec<bool>,
    /// Height of ground measured from at most 8 m; NaN for none.
    pub ground_m: Vec<f32>,
}

/// Floors under one cell, and which of them the walk has reached.
type Floors = BTreeMap<(i32, i32), Vec<f64>>;

/// The floor cells that the robot's footprint can be driven to from `start`, inside the world's
/// bounds: connected by steps it climbs, each with a disc of ground and air about it.
pub fn reachable(world: &World, robot: &Passability, start: &Point3<f64>) -> Vec<FloorCell> {
    let floors = floors_of(world, robot);
    let index = |v: f64| (v / CELL_M).floor() as i32;
    let origin = (index(start.x), index(start.y));
    let Some(first) = floor_near(&floors, origin, start.z, 1.0) else { return Vec::new() };
    let disc = disc_offsets(robot.radius_m);
    let mut visited: BTreeMap<(i32, i32, usize), ()> = BTreeMap::new();
    let mut covered: BTreeMap<(i32, i32, i64), f64> = BTreeMap::new();
    let mut queue = VecDeque::from([(origin, first)]);
    visited.insert((origin.0, origin.1, first), ());
    while let Some((at, level)) = queue.pop_front() {
        let z = floors[&at][level];
        let Some(footprint) = footprint(&floors, at, z, &disc, robot) else { continue };
        for (cell, height) in footprint {
            // Floors of one cell differ by more than the robot's height.
            covered.entry((cell.0, cell.1, (height / 0.2).round() as i64)).or_insert(height);
        }
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            let next = (at.0 + dx, at.1 + dy);
            let Some(level) = floor_near(&floors, next, z, step_m(robot, CELL_M)) else { continue };
            if visited.insert((next.0, next.1, level), ()).is_none() {
                queue.push_back((next, level));
            }
        }
    }
    covered.into_iter().map(|((x, y, _), z_m)| FloorCell { x, y, z_m }).collect()
}

/// Reachable and explored area in m².
pub fn coverage(reachable: &[FloorCell], evidence: &Evidence) -> (f64, f64) {
    let area = CELL_M * CELL_M;
    let explored = reachable.iter().filter(|cell| is_explored(cell, evidence)).count();
    (reachable.len() as f64 * area, explored as f64 * area)
}

/// Whether one floor cell is known to the grid and has measured ground near it.
pub fn is_explored(cell: &FloorCell, evidence: &Evidence) -> bool {
    // Heights of another level do not count; the run's own height error does not matter.
    const SAME_LEVEL_M: f64 = 0.4;
    if evidence.width == 0 {
        return false;
    }
    let height = evidence.known.len() / evidence.width;
    let centre = cell.centre();
    // Centres of floor cells lie on borders of the lattice: a hair to one side, whatever the origin was
    // rounded to on its way through a file.
    const HAIR: f64 = 1e-6;
    let place = |x: f64, y: f64| -> Option<usize> {
        let column = ((x - evidence.origin_m[0]) / evidence.cell_m + HAIR).floor();
        let row = ((y - evidence.origin_m[1]) / evidence.cell_m + HAIR).floor();
        (column >= 0.0
            && row >= 0.0
            && (column as usize) < evidence.width
            && (row as usize) < height)
            .then(|| row as usize * evidence.width + column as usize)
    };
    let half = 0.25 * CELL_M;
    let known = [(-half, -half), (half, -half), (-half, half), (half, half)]
        .iter()
        .any(|(dx, dy)| place(centre.x + dx, centre.y + dy).is_some_and(|i| evidence.known[i]));
    if !known {
        return false;
    }
    let reach = (NEAR_GROUND_M / evidence.cell_m).ceil() as i32;
    (-reach..=reach).any(|dy| {
        (-reach..=reach).any(|dx| {
            let (ox, oy) = (f64::from(dx) * evidence.cell_m, f64::from(dy) * evidence.cell_m);
            ox.hypot(oy) <= NEAR_GROUND_M
                && place(centre.x + ox, centre.y + oy).is_some_and(|i| {
                    (f64::from(evidence.ground_m[i]) - cell.z_m).abs() < SAME_LEVEL_M
                })
        })
    })
}

/// Height difference that is driven over between two places `apart_m` apart.
fn step_m(robot: &Passability, apart_m: f64) -> f64 {
    robot.max_step_m.max(robot.max_slope * apart_m) + 1e-6
}

/// All floors with air for the robot, cell by cell.
fn floors_of(world: &World, robot: &Passability) -> Floors {
    let [x0, y0, x1, y1] = world.bounds();
    let index = |v: f64| (v / CELL_M).floor() as i32;
    let mut floors = Floors::new();
    for y in index(y0)..=index(y1 - 1e-9) {
        for x in index(x0)..=index(x1 - 1e-9) {
            let cell = FloorCell { x, y, z_m: 0.0 };
            let centre = cell.centre();
            let spans = world.solid_spans(centre.x, centre.y);
            let mut heights = Vec::new();
            for (i, span) in spans.iter().enumerate() {
                let ceiling = spans.get(i + 1).map_or(f64::INFINITY, |above| above.bottom_m);
                if ceiling - span.top_m >= robot.height_m {
                    heights.push(span.top_m);
                }
            }
            if !heights.is_empty() {
                floors.insert((x, y), heights);
            }
        }
    }
    floors
}

fn floor_near(floors: &Floors, cell: (i32, i32), z: f64, within_m: f64) -> Option<usize> {
    let heights = floors.get(&cell)?;
    (0..heights.len())
        .filter(|&i| (heights[i] - z).abs() <= within_m)
        .min_by(|&a, &b| (heights[a] - z).abs().total_cmp(&(heights[b] - z).abs()))
}

fn disc_offsets(radius_m: f64) -> Vec<(i32, i32)> {
    let reach = (radius_m / CELL_M).floor() as i32;
    let mut offsets = Vec::new();
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            if f64::from(dx).hypot(f64::from(dy)) * CELL_M <= radius_m {
                offsets.push((dx, dy));
            }
        }
    }
    offsets
}

/// The cells under a disc about `at`, if the robot can be there: ground everywhere but in gaps that
/// it rolls across, no step that it does not climb, no slope that is too steep.
fn footprint(
    floors: &Floors,
    at: (i32, i32),
    z: f64,
    disc: &[(i32, i32)],
    robot: &Passability,
) -> Option<Vec<((i32, i32), f64)>> {
    let mut cells = Vec::with_capacity(disc.len());
    let mut missing = Vec::new();
    for &(dx, dy) in disc {
        let cell = (at.0 + dx, at.1 + dy);
        let apart_m = f64::from(dx).hypot(f64::from(dy)) * CELL_M;
        let within = robot.max_step_m + robot.max_slope * apart_m;
        match floor_near(floors, cell, z, within) {
            Some(level) => cells.push((cell, floors[&cell][level])),
            None => missing.push(cell),
        }
    }
    let widest = (robot.max_gap_m / CELL_M).floor() as i32;
    let is_missing = |cell: (i32, i32)| missing.contains(&cell);
    for &cell in &missing {
        let run = |dx: i32, dy: i32| {
            let mut length = 1;
            for sign in [1, -1] {
                let mut next = (cell.0 + sign * dx, cell.1 + sign * dy);
                while is_missing(next) {
                    length += 1;
                    next = (next.0 + sign * dx, next.1 + sign * dy);
                }
            }
            length
        };
        // A gap is as wide as it is narrow; something that stands in the way is no gap.
        let hole = floors.get(&cell).is_some_and(|f| f.iter().all(|height| *height < z));
        if !hole || run(1, 0).min(run(0, 1)) > widest {
            return None;
        }
    }
    (slope(&cells) <= robot.max_slope + 1e-6).then_some(cells)
}

/// Steepest rise over run of the plane through the cells' heights.
fn slope(cells: &[((i32, i32), f64)]) -> f64 {
    let n = cells.len() as f64;
    let mean = cells.iter().fold((0.0, 0.0, 0.0), |(x, y, z), ((cx, cy), cz)| {
        (x + f64::from(*cx) / n, y + f64::from(*cy) / n, z + cz / n)
    });
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for ((cx, cy), cz) in cells {
        let (x, y, z) =
            ((f64::from(*cx) - mean.0) * CELL_M, (f64::from(*cy) - mean.1) * CELL_M, cz - mean.2);
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xz += x * z;
        yz += y * z;
    }
    let determinant = xx * yy - xy * xy;
    if determinant.abs() < 1e-12 {
        return 0.0;
    }
    let (a, b) = ((xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant);
    a.hypot(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::MapFile;

    const ROBOT: Passability = Passability {
        radius_m: 0.25,
        height_m: 0.8,
        max_step_m: 0.06,
        max_slope: 0.38,
        max_gap_m: 0.1,
    };

    fn world(more: &str) -> World {
        let map = format!(
            "name = \"m\"\nbounds = [0.0, 0.0, 6.0, 4.0]\n\
             [[box]]\ncenter = [3.0, 2.0, -0.5]\nsize = [6.0, 4.0, 1.0]\n{more}"
        );
        World::new(&MapFile::parse(&map).unwrap(), &BTreeMap::new()).unwrap()
    }

    fn area(more: &str) -> f64 {
        let cells = reachable(&world(more), &ROBOT, &Point3::new(1.0, 2.0, 0.1));
        cells.len() as f64 * CELL_M * CELL_M
    }

    #[test]
    fn an_open_floor_is_reachable_up_to_what_the_disc_sweeps() {
        let open = area("");
        assert!(open > 0.95 * 24.0 && open <= 24.0, "{open}");
    }

    #[test]
    fn a_wall_halves_it_and_a_door_opens_it_again() {
        let wall = "[[box]]\ncenter = [3.05, 2.0, 1.0]\nsize = [0.1, 4.0, 2.0]\n";
        assert!(area(wall) < 0.55 * 24.0);
        let door = "[[box]]\ncenter = [3.05, 0.75, 1.0]\nsize = [0.1, 1.5, 2.0]\n\
                    [[box]]\ncenter = [3.05, 3.25, 1.0]\nsize = [0.1, 1.5, 2.0]\n";
        assert!(area(door) > 0.85 * 24.0);
    }

    #[test]
    fn a_kerb_of_fifteen_centimetres_is_a_border_and_one_of_five_is_not() {
        let kerb = |height: f64| {
            format!("[[box]]\ncenter = [4.5, 2.0, {}]\nsize = [3.0, 4.0, {height}]\n", 0.5 * height)
        };
        assert!(area(&kerb(0.15)) < 0.55 * 24.0);
        assert!(area(&kerb(0.05)) > 0.9 * 24.0);
    }

    #[test]
    fn explored_needs_both_the_grid_and_a_point_nearby() {
        let cell = FloorCell { x: 10, y: 10, z_m: 0.0 };
        let mut evidence = Evidence {
            cell_m: 0.05,
            origin_m: [0.0, 0.0],
            width: 60,
            known: vec![true; 3600],
            ground_m: vec![f32::NAN; 3600],
        };
        assert!(!is_explored(&cell, &evidence));
        evidence.ground_m[22 * 60 + 26] = 0.02;
        assert!(is_explored(&cell, &evidence));
        evidence.ground_m[22 * 60 + 26] = -1.0;
        assert!(!is_explored(&cell, &evidence));
        evidence.ground_m[22 * 60 + 26] = 0.02;
        evidence.known.fill(false);
        assert!(!is_explored(&cell, &evidence));
    }
}
