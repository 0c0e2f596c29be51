//! What a sweep from a pose would newly see: rays over a coarse copy of the grid.

use super::memory::Looks;
use crate::navigation::Pose2;
use crate::terrain::{CellClass, CellIndex, Grid};
use std::f64::consts::TAU;

/// Side of a view cell in terrain cells.
pub(super) const COARSE: i32 = 4;
/// Sectors in which gain is summed, to find the best heading.
pub(super) const SECTORS: usize = 24;
/// Rays cast from a pose.
const RAYS: usize = 180;
/// Unknown ground beyond this much unknown ground says nothing: what hides it is unknown, too.
const PEEK_M: f64 = 2.5;
/// Depth of the strip behind the border of the unknown that a sweep should have shown.
const STRIP_M: f64 = 0.5;
/// Worth of seeing a piece of ground closely that was only seen sparsely, against unknown ground.
const SPARSE: f64 = 0.5;
/// A suspected edge shows whether it is a ramp from this near only.
const SUSPECT_M: f64 = 1.6;

/// Unknown ground between the robot's ground and ground it could use but not get to counts this many
/// times: it opens all that lies behind.
const BRIDGE: u16 = 20;
/// How near to both sides such ground lies, in view cells: the margins of both keep the robot off it.
const BRIDGE_REACH: i32 = 3;

/// A view cell: how much of it is unknown or suspect, and whether rays end or lose the level here.
#[derive(Clone, Copy, Debug, Default)]
struct ViewCell {
    /// Cells of unknown ground, 0 to COARSE².
    unknown: u8,
    /// How many times each of them counts.
    factor: u16,
    /// Cells of suspected edges.
    suspect: u8,
    /// Cells of ground that was seen, but not closely enough to drive on.
    sparse: u8,
    /// Something high stands here.
    opaque: bool,
    /// Half of it or more is drop-off: what lies beyond belongs to another level.
    edge: bool,
}

/// A coarse copy of a grid for casting rays, with the discount of what was looked at in vain.
pub(super) struct ViewMap {
    low: CellIndex,
    width: i32,
    height: i32,
    cell_m: f64,
    fine_m2: f64,
    cells: Vec<ViewCell>,
    /// Share of a ray's worth that enters the unknown through this cell.
    worth: Vec<f32>,
    stamps: Vec<u32>,
    stamp: u32,
}

/// Gain by sector: square metres that a sweep would newly see.
pub(super) struct Gain {
    pub sectors: [f64; SECTORS],
}

impl Gain {
    /// The heading whose field of view holds most, and how much that is in square metres.
    pub fn best(&self, field_of_view_rad: f64, towards_rad: f64) -> (f64, f64) {
        let sector_rad = TAU / SECTORS as f64;
        let wide = ((field_of_view_rad / sector_rad).round() as usize).clamp(1, SECTORS);
        let mut best: Option<(f64, f64, f64)> = None;
        for start in 0..SECTORS {
            let sum_m2: f64 = (0..wide).map(|k| self.sectors[(start + k) % SECTORS]).sum();
            let yaw_rad = crate::geometry::wrap_pi(sector_rad * (start as f64 + 0.5 * wide as f64));
            let turn_rad = crate::geometry::wrap_pi(yaw_rad - towards_rad).abs();
            // Of headings that see as much, the one that needs least turning.
            if best.is_none_or(|(most, _, least)| {
                sum_m2 > most + 1e-9 || (sum_m2 > most - 1e-9 && turn_rad < least - 1e-9)
            }) {
                best = Some((sum_m2, yaw_rad, turn_rad));
            }
        }
        best.map_or((towards_rad, 0.0), |(sum_m2, yaw_rad, _)| (yaw_rad, sum_m2))
    }
}

impl ViewMap {
    pub fn new(grid: &Grid, looks: &Looks) -> Self {
        let low =
            CellIndex { x: grid.low().x.div_euclid(COARSE), y: grid.low().y.div_euclid(COARSE) };
        let high_x = (grid.low().x + grid.width() as i32).div_euclid(COARSE);
        let high_y = (grid.low().y + grid.height() as i32).div_euclid(COARSE);
        // A rim of unknown all round: the grid ends where nothing was seen yet.
        let low = CellIndex { x: low.x - 1, y: low.y - 1 };
        let (width, height) = (high_x - low.x + 2, high_y - low.y + 2);
        let full = (COARSE * COARSE) as u8;
        let blank = ViewCell { unknown: full, factor: 1, ..ViewCell::default() };
        let mut cells = vec![blank; (width * height) as usize];
        let (mut near, mut apart) = (vec![false; cells.len()], vec![false; cells.len()]);
        let mut edges = vec![0_u8; cells.len()];
        for (cell, value) in grid.iter() {
            let x = cell.x.div_euclid(COARSE) - low.x;
            let y = cell.y.div_euclid(COARSE) - low.y;
            let at = (y * width + x) as usize;
            near[at] |= value.reachable;
            apart[at] |= !value.reachable && grid.could_fit(cell);
            match value.class {
                CellClass::Unknown | CellClass::FlatFree => continue,
                CellClass::Suspect => cells[at].suspect += 1,
                CellClass::DropOff => edges[at] += 1,
                CellClass::Occupied => cells[at].opaque |= value.opaque,
                CellClass::Free | CellClass::Assumed => {
                    cells[at].sparse += u8::from(!value.sure);
                }
                CellClass::TooSteep | CellClass::OtherLevel => {}
            }
            cells[at].unknown -= 1;
        }
        for (cell, edges) in cells.iter_mut().zip(edges) {
            cell.edge = edges >= full / 4;
        }
        mark_bridges(&mut cells, &near, &apart, width);
        let worth = (0..cells.len())
            .map(|at| {
                let (x, y) = (at as i32 % width + low.x, at as i32 / width + low.y);
                looks.worth(CellIndex { x, y })
            })
            .collect();
        Self {
            low,
            width,
            height,
            cell_m: grid.cell_m() * f64::from(COARSE),
            fine_m2: grid.cell_m() * grid.cell_m(),
            stamps: vec![0; cells.len()],
            stamp: 0,
            cells,
            worth,
        }
    }

    fn index(&self, x: i32, y: i32) -> Option<usize> {
        let (x, y) = (x - self.low.x, y - self.low.y);
        (x >= 0 && y >= 0 && x < self.width && y < self.height)
            .then(|| (y * self.width + x) as usize)
    }

    /// Unknown square metres within a square of `reach_m` about a point: no view can gain more.
    pub fn unknown_sums(&self) -> UnknownSums {
        let stride = self.width as usize + 1;
        let mut sums = vec![0_u32; stride * (self.height as usize + 1)];
        for y in 0..self.height as usize {
            let mut row = 0;
            for x in 0..self.width as usize {
                let cell = &self.cells[y * self.width as usize + x];
                row += u32::from(cell.unknown) * u32::from(cell.factor)
                    + 2 * u32::from(cell.suspect) * u32::from(cell.factor)
                    + u32::from(cell.sparse);
                sums[(y + 1) * stride + x + 1] = sums[y * stride + x + 1] + row;
            }
        }
        UnknownSums { sums, stride }
    }

    /// Upper bound of what any view from a point can gain, square metres. Beyond the map's rim
    /// everything is unknown.
    pub fn bound_m2(&self, sums: &UnknownSums, x_m: f64, y_m: f64, reach_m: f64) -> f64 {
        let low_x = ((x_m - reach_m) / self.cell_m).floor() as i32 - self.low.x;
        let low_y = ((y_m - reach_m) / self.cell_m).floor() as i32 - self.low.y;
        let high_x = ((x_m + reach_m) / self.cell_m).floor() as i32 - self.low.x + 1;
        let high_y = ((y_m + reach_m) / self.cell_m).floor() as i32 - self.low.y + 1;
        let clip_x = |x: i32| x.clamp(0, self.width) as usize;
        let clip_y = |y: i32| y.clamp(0, self.height) as usize;
        let (x0, x1, y0, y1) = (clip_x(low_x), clip_x(high_x), clip_y(low_y), clip_y(high_y));
        let inside = sums.sums[y1 * sums.stride + x1] + sums.sums[y0 * sums.stride + x0]
            - sums.sums[y0 * sums.stride + x1]
            - sums.sums[y1 * sums.stride + x0];
        let outside = i64::from(high_x - low_x) * i64::from(high_y - low_y)
            - (x1 - x0) as i64 * (y1 - y0) as i64;
        (f64::from(inside) + outside as f64 * f64::from(COARSE * COARSE)) * self.fine_m2
    }

    /// Casts rays from a pose and sums what they would newly see.
    pub fn gain(&mut self, x_m: f64, y_m: f64, blind_m: f64, close_m: f64, range_m: f64) -> Gain {
        self.stamp += 1;
        let mut gain = Gain { sectors: [0.0; SECTORS] };
        for ray in 0..RAYS {
            let angle_rad = TAU * (ray as f64 + 0.5) / RAYS as f64;
            let sector = ray * SECTORS / RAYS;
            self.cast(x_m, y_m, angle_rad, range_m, |map, at, seen| {
                if map.stamps[at] == map.stamp {
                    return;
                }
                let cell = map.cells[at];
                let mut fresh = 0.0;
                if seen.away_m >= blind_m {
                    fresh += f64::from(cell.unknown);
                    if seen.away_m <= SUSPECT_M {
                        fresh += 2.0 * f64::from(cell.suspect) * f64::from(map.worth[at]);
                    }
                    fresh *= f64::from(cell.factor);
                    if seen.away_m <= close_m {
                        fresh += SPARSE * f64::from(cell.sparse) * f64::from(map.worth[at]);
                    }
                }
                if fresh > 0.0 {
                    map.stamps[at] = map.stamp;
                    gain.sectors[sector] += fresh * seen.worth * map.fine_m2;
                }
            });
        }
        gain
    }

    /// The border cells of the unknown that a sweep from `pose` should have shown and did not, and
    /// the suspected edges it stood before, as view cells.
    pub fn looked_at(
        &mut self,
        pose: &Pose2,
        field_of_view_rad: f64,
        blind_m: f64,
        close_m: f64,
        range_m: f64,
    ) -> Vec<CellIndex> {
        self.stamp += 1;
        let mut looked = Vec::new();
        for ray in 0..RAYS {
            let off_rad = field_of_view_rad * ((ray as f64 + 0.5) / RAYS as f64 - 0.5);
            self.cast(pose.x_m, pose.y_m, pose.yaw_rad + off_rad, range_m, |map, at, seen| {
                let cell = map.cells[at];
                let border = cell.unknown > 0 && seen.unknown_m <= STRIP_M;
                let suspect = cell.suspect > 0 && seen.away_m <= SUSPECT_M;
                let sparse = cell.sparse > 0 && seen.away_m <= 0.8 * close_m;
                if (border || suspect || sparse)
                    && seen.away_m >= blind_m
                    && map.stamps[at] != map.stamp
                {
                    map.stamps[at] = map.stamp;
                    let (x, y) = (at as i32 % map.width, at as i32 / map.width);
                    looked.push(CellIndex { x: x + map.low.x, y: y + map.low.y });
                }
            });
        }
        looked.sort_unstable();
        looked
    }

    /// Walks a ray until something hides what lies behind, calling `visit` for each view cell.
    fn cast(
        &mut self,
        x_m: f64,
        y_m: f64,
        angle_rad: f64,
        range_m: f64,
        mut visit: impl FnMut(&mut Self, usize, &Seen),
    ) {
        let (sin, cos) = angle_rad.sin_cos();
        let step_m = 0.5 * self.cell_m;
        let mut seen = Seen { away_m: 0.0, unknown_m: 0.0, worth: 1.0 };
        let mut before = None;
        let full = f64::from(COARSE * COARSE);
        while seen.away_m < range_m {
            seen.away_m += step_m;
            let x = ((x_m + cos * seen.away_m) / self.cell_m).floor() as i32;
            let y = ((y_m + sin * seen.away_m) / self.cell_m).floor() as i32;
            let Some(at) = self.index(x, y) else { return };
            let cell = self.cells[at];
            seen.unknown_m += step_m * f64::from(cell.unknown) / full;
            if seen.unknown_m > PEEK_M {
                return;
            }
            if before != Some(at) {
                before = Some(at);
                if cell.unknown > 0 && seen.unknown_m <= STRIP_M {
                    seen.worth = seen.worth.min(f64::from(self.worth[at]));
                }
                visit(self, at, &seen);
                if cell.opaque || cell.edge {
                    return;
                }
            }
        }
    }
}

/// Raises the factor of unknown cells that lie between reachable ground and ground apart from it.
fn mark_bridges(cells: &mut [ViewCell], near: &[bool], apart: &[bool], width: i32) {
    let height = cells.len() as i32 / width;
    let any = |flags: &[bool], x: i32, y: i32| {
        (y - BRIDGE_REACH..=y + BRIDGE_REACH).any(|y| {
            (x - BRIDGE_REACH..=x + BRIDGE_REACH).any(|x| {
                x >= 0 && y >= 0 && x < width && y < height && flags[(y * width + x) as usize]
            })
        })
    };
    for (at, cell) in cells.iter_mut().enumerate() {
        let (x, y) = (at as i32 % width, at as i32 / width);
        let open = cell.unknown > 0 || cell.suspect > 0;
        if open && any(apart, x, y) && any(near, x, y) {
            cell.factor = BRIDGE;
        }
    }
}

/// How far a ray has come.
struct Seen {
    away_m: f64,
    /// Unknown ground it passed.
    unknown_m: f64,
    /// What is left of its worth after looks in vain.
    worth: f64,
}

/// Sums of unknown cells over rectangles.
pub(super) struct UnknownSums {
    sums: Vec<u32>,
    stride: usize,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::GridCell;

    /// A known disc of 2 m about the origin, a wall on its right edge.
    fn disc() -> Grid {
        let cells = (0..200 * 200)
            .map(|index| {
                let (x, y): (i32, i32) = (index % 200 - 100, index / 200 - 100);
                let away_m = 0.05 * f64::from(x).hypot(f64::from(y));
                let wall = x == 30 && y.abs() < 26;
                GridCell {
                    class: match away_m {
                        _ if wall => CellClass::Occupied,
                        away_m if away_m < 2.0 && x < 30 => CellClass::Free,
                        _ => CellClass::Unknown,
                    },
                    opaque: wall,
                    room_m: 1.0,
                    sure: true,
                    ..GridCell::default()
                }
            })
            .collect();
        Grid::from_cells(0.05, CellIndex { x: -100, y: -100 }, 200, cells)
    }

    #[test]
    fn the_best_heading_turns_away_from_the_wall() {
        let mut map = ViewMap::new(&disc(), &Looks::default());
        let gain = map.gain(0.0, 0.0, 1.0, 3.0, 8.0);
        let (yaw_rad, gain_m2) = gain.best(std::f64::consts::PI, 0.0);
        assert!(yaw_rad.abs() > 2.5, "heading {yaw_rad}");
        assert!(gain_m2 > 10.0, "gain {gain_m2}");
        let sums = map.unknown_sums();
        let total: f64 = gain.sectors.iter().sum();
        assert!(map.bound_m2(&sums, 0.0, 0.0, 8.0) >= total);
    }

    #[test]
    fn nothing_is_gained_through_a_wall() {
        let mut map = ViewMap::new(&disc(), &Looks::default());
        let gain = map.gain(1.2, 0.0, 0.0, 3.0, 8.0);
        assert!(gain.sectors[0] + gain.sectors[SECTORS - 1] < 0.05, "{:?}", gain.sectors);
    }

    #[test]
    fn what_was_looked_at_in_vain_is_worth_less_each_time() {
        let grid = disc();
        let mut looks = Looks::default();
        let mut before = f64::INFINITY;
        for _ in 0..4 {
            let mut map = ViewMap::new(&grid, &looks);
            let total: f64 = map.gain(0.0, 0.0, 1.0, 3.0, 8.0).sectors.iter().sum();
            assert!(total < 0.6 * before, "{total} after {before}");
            before = total;
            let looked = map.looked_at(&Pose2::default(), TAU, 1.0, 3.0, 6.0);
            looks.note(&looked);
        }
    }
}
