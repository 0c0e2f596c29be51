//! The paper's comparison of figures 6 to 10: one mission mapped in three dimensions, and the same
//! mission mapped by 2D scan matching from the level line of each sweep.

use crate::driver::simulated::SimulatedMission;
use crate::export::canvas::Canvas;
use crate::export::map_picture::{Overlay, draw};
use crate::files::scenario::LoadedScenario;
use crate::mapping::planar::{PLANAR_CELL_M, PlanarMapper, PlanarScan};
use crate::scan::{RangeImage, Return};
use crate::sim::BoxSpec;
use crate::terrain::{CellClass, CellIndex, Grid, GridCell};
use anyhow::{Context, Result};
use nalgebra::{Isometry2, Isometry3, Point2, Point3, Vector3};
use serde::Serialize;

/// Greatest angle to the level of the line that stands for a fixed level laser.
const LEVEL_RAD: f64 = 0.06;
/// Beams that hit nothing are drawn free this far.
const FREE_M: f64 = 8.0;
/// Tenths of log-odds above which a planar cell is an obstacle, and below which it is free.
const OCCUPIED: i16 = 5;
const FREE: i16 = -3;
/// Height above the start's floor of what a level laser at the robot's height cannot see.
const LOW_FROM_M: f64 = 0.08;
const LOW_TO_M: f64 = 0.45;
/// Floors and platforms are no obstacles, however low.
const LARGEST_OBSTACLE_M2: f64 = 6.0;
/// Share of an object's seen footprint that decides.
const PRESENT_SHARE: f64 = 0.3;
/// Cells of a footprint that must have been seen for the object to count.
const FEWEST_SEEN: usize = 12;

/// How an object of the world stands in a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Verdict {
    /// A ramp as ground with its slope, an obstacle as an obstacle.
    Present,
    /// A ramp as level nothing, an obstacle as free space.
    Missing,
    /// A ramp as an obstacle.
    FalselySolid,
    /// Too little of its place was seen.
    NotSeen,
}

/// One object in both maps.
#[derive(Clone, Debug, Serialize)]
struct Judged {
    name: String,
    ramp: bool,
    in_3d: Verdict,
    in_2d: Verdict,
}

/// The comparison in figures.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    scenario: String,
    seed: u64,
    sweeps: usize,
    matched: usize,
    /// Error of the pose at the last sweep, metres and degrees.
    error_3d: (f64, f64),
    error_2d: (f64, f64),
    objects: Vec<Judged>,
}

/// What a run gives.
pub struct Outcome {
    /// Both maps judged.
    pub comparison: Comparison,
    /// The 2D grid on the robot's level as the 3D terrain projects it.
    pub map_3d: Canvas,
    /// The map of the 2D baseline.
    pub map_2d: Canvas,
}

/// Runs the scenario and maps it in both ways.
///
/// # Errors
///
/// A scenario whose parts do not fit.
pub fn compare(loaded: LoadedScenario) -> Result<Outcome> {
    let objects = objects(&loaded);
    let (name, seed) = (loaded.name.clone(), loaded.files.scenario.seed);
    let mut mission = SimulatedMission::new(loaded, std::io::sink())?;
    let mut flat: Option<Flat> = None;
    let mut reckoned: Option<Isometry3<f64>> = None;
    while mission.step()? {
        let Some(running) = mission.agent().running() else { continue };
        let belief = running.belief();
        let now = belief.world_from_robot();
        if let Some((keyframe, image)) = belief.last_sweep() {
            let flat = flat.get_or_insert_with(|| Flat::new(&reckoned.unwrap_or(now)));
            if flat.sweeps <= keyframe {
                flat.take(keyframe, image, &reckoned.unwrap_or(now), &now);
                if let Some(truth) = mission.truth() {
                    flat.errors = (
                        apart(&planar(&truth.world_from_robot), &planar(&now)),
                        apart(&planar(&truth.world_from_robot), flat.mapper.world_from_robot()),
                    );
                }
            }
        }
        reckoned = Some(now);
    }
    let running = mission.agent().running().context("the mission ended before it began")?;
    let grid = running.belief().grid();
    let flat = flat.context("the mission ended before its first sweep")?;
    let plain = flat.grid();
    let objects = objects
        .into_iter()
        .map(|object| Judged {
            in_3d: object.judge(&grid),
            in_2d: object.judge(&plain),
            ramp: object.ramp,
            name: object.name,
        })
        .collect();
    let title = |what: &str| Overlay { title: format!("{name}: {what}"), ..Overlay::default() };
    Ok(Outcome {
        map_3d: draw(&grid, &title("ground and obstacles from 3D")),
        map_2d: draw(&plain, &title("2D scan matching, level lines of the same mission")),
        comparison: Comparison {
            scenario: name,
            seed,
            sweeps: flat.sweeps,
            matched: flat.matched,
            error_3d: flat.errors.0,
            error_2d: flat.errors.1,
            objects,
        },
    })
}

/// The 2D baseline as the mission feeds it.
struct Flat {
    mapper: PlanarMapper,
    /// Pose of the 3D belief right after the last sweep: dead reckoning starts from it.
    anchor: Isometry3<f64>,
    sweeps: usize,
    matched: usize,
    errors: ((f64, f64), (f64, f64)),
}

impl Flat {
    fn new(start: &Isometry3<f64>) -> Self {
        Self {
            mapper: PlanarMapper::new(planar(start)),
            anchor: *start,
            sweeps: 0,
            matched: 0,
            errors: ((0.0, 0.0), (0.0, 0.0)),
        }
    }

    /// Takes a sweep made where dead reckoning was at `reckoned`; `corrected` is where the 3D map put
    /// the robot then, from which dead reckoning goes on.
    fn take(
        &mut self,
        keyframe: usize,
        image: &RangeImage,
        reckoned: &Isometry3<f64>,
        corrected: &Isometry3<f64>,
    ) {
        let motion = planar(&self.anchor).inverse() * planar(reckoned);
        self.mapper.observe(&motion, &level_line(image));
        self.matched += usize::from(self.mapper.matched());
        self.anchor = *corrected;
        self.sweeps = keyframe + 1;
    }

    fn grid(&self) -> Grid {
        let cells: Vec<_> = self.mapper.cells().collect();
        let low = cells
            .iter()
            .fold((i32::MAX, i32::MAX), |low, ((x, y), _)| (low.0.min(*x), low.1.min(*y)));
        let high = cells
            .iter()
            .fold((i32::MIN, i32::MIN), |high, ((x, y), _)| (high.0.max(*x), high.1.max(*y)));
        let width = (high.0 - low.0 + 1) as usize;
        let height = (high.1 - low.1 + 1) as usize;
        let mut grid = vec![GridCell::default(); width * height];
        for ((x, y), odds) in cells {
            let class = match odds {
                odds if odds >= OCCUPIED => CellClass::Occupied,
                odds if odds <= FREE => CellClass::FlatFree,
                _ => CellClass::Unknown,
            };
            grid[(y - low.1) as usize * width + (x - low.0) as usize].class = class;
        }
        Grid::from_cells(PLANAR_CELL_M, CellIndex { x: low.0, y: low.1 }, width, grid)
    }
}

fn planar(pose: &Isometry3<f64>) -> Isometry2<f64> {
    Isometry2::new(pose.translation.vector.xy(), pose.rotation.euler_angles().2)
}

fn apart(truth: &Isometry2<f64>, estimate: &Isometry2<f64>) -> (f64, f64) {
    let error = truth.inverse() * estimate;
    (error.translation.vector.norm(), error.rotation.angle().to_degrees().abs())
}

/// The row of a sweep that is nearest to level, in the robot's frame; empty where none is near.
fn level_line(image: &RangeImage) -> PlanarScan {
    let middle = image.columns() / 2;
    let place = |row: usize, column: usize, range_m: f64| {
        image.robot_from_scan * image.point_at(row, column, range_m)
    };
    let elevation = |row: usize| {
        let ray: Vector3<f64> = place(row, middle, 1.0) - place(row, middle, 0.0);
        ray.z.asin().abs()
    };
    let rows = 0..image.rows().len();
    let Some(row) = rows.min_by(|a, b| elevation(*a).total_cmp(&elevation(*b))) else {
        return PlanarScan::default();
    };
    if elevation(row) > LEVEL_RAD {
        return PlanarScan::default();
    }
    let flat = |p: Point3<f64>| p.xy();
    let mut scan = PlanarScan { origin: flat(place(row, middle, 0.0)), ..PlanarScan::default() };
    for column in 0..image.columns() {
        match image.at(row, column) {
            Return::Hit(range_m) => scan.hits.push(flat(place(row, column, range_m))),
            Return::Nothing => {
                let range_m = image.max_range_m.min(FREE_M);
                scan.misses.push(flat(place(row, column, range_m)));
            }
            Return::Missing => {}
        }
    }
    scan
}

/// A ramp or a low obstacle of the true world.
struct Object {
    name: String,
    ramp: bool,
    spec: BoxSpec,
}

fn objects(loaded: &LoadedScenario) -> Vec<Object> {
    let map = &loaded.files.map;
    let floor_m = map.starts.first().map_or(0.0, |start| {
        // The highest box top below the start is what it stands on.
        let [x, y, z] = start.position;
        let below = map.boxes.iter().filter(|spec| covers(spec, &Point2::new(x, y)));
        let tops = below.map(top).filter(|top| *top <= z + 0.05);
        tops.fold(f64::NEG_INFINITY, f64::max)
    });
    let low = |spec: &&BoxSpec| {
        let height = top(spec) - floor_m;
        let bottom = spec.center[2] - 0.5 * spec.size[2] - floor_m;
        (LOW_FROM_M..LOW_TO_M).contains(&height)
            && bottom < 0.05
            && spec.size[0] * spec.size[1] < LARGEST_OBSTACLE_M2
    };
    let named =
        |spec: &BoxSpec, ramp: bool| Object { name: spec.name.clone(), ramp, spec: spec.clone() };
    map.wedges
        .iter()
        .map(|spec| named(spec, true))
        .chain(map.boxes.iter().filter(low).map(|spec| named(spec, false)))
        .collect()
}

fn top(spec: &BoxSpec) -> f64 {
    spec.center[2] + 0.5 * spec.size[2]
}

/// Whether a place lies within a box seen from above.
fn covers(spec: &BoxSpec, place: &Point2<f64>) -> bool {
    let local = Isometry2::new(
        nalgebra::Vector2::new(spec.center[0], spec.center[1]),
        spec.rpy_deg[2].to_radians(),
    )
    .inverse()
        * place;
    local.x.abs() <= 0.5 * spec.size[0] && local.y.abs() <= 0.5 * spec.size[1]
}

impl Object {
    fn judge(&self, grid: &Grid) -> Verdict {
        let seen: Vec<&GridCell> = grid
            .iter()
            .filter(|(cell, _)| covers(&self.spec, &grid.centre(*cell)))
            .map(|(_, cell)| cell)
            .filter(|cell| cell.class != CellClass::Unknown)
            .collect();
        if seen.len() < FEWEST_SEEN {
            return Verdict::NotSeen;
        }
        let share = |is: &dyn Fn(&GridCell) -> bool| {
            seen.iter().filter(|&&cell| is(cell)).count() as f64 / seen.len() as f64
        };
        let solid = share(&|cell: &GridCell| {
            matches!(cell.class, CellClass::Occupied | CellClass::TooSteep | CellClass::DropOff)
        });
        if !self.ramp {
            return if solid >= PRESENT_SHARE { Verdict::Present } else { Verdict::Missing };
        }
        // Ground that climbs by as much as the ramp does over what was seen of it.
        let slope = self.spec.size[2] / self.spec.size[0];
        let climbing = share(&|cell: &GridCell| {
            cell.class.is_drivable() && f64::from(cell.slope) > 0.5 * slope
        });
        if climbing >= PRESENT_SHARE {
            Verdict::Present
        } else if solid >= PRESENT_SHARE {
            Verdict::FalselySolid
        } else {
            Verdict::Missing
        }
    }
}

impl Comparison {
    /// The comparison for people.
    pub fn text(&self) -> String {
        use std::fmt::Write;
        let mut out = format!(
            "{}, seed {}: {} sweeps, {} of them matched in 2D\n\
             pose at the last sweep: 3D {:.3} m {:.2}°, 2D {:.3} m {:.2}°\n",
            self.scenario,
            self.seed,
            self.sweeps,
            self.matched,
            self.error_3d.0,
            self.error_3d.1,
            self.error_2d.0,
            self.error_2d.1
        );
        for (ramp, title) in [(true, "ramps"), (false, "low obstacles")] {
            let of_kind = || self.objects.iter().filter(move |object| object.ramp == ramp);
            let count = |pick: fn(&Judged) -> Verdict, verdict: Verdict| {
                of_kind().filter(|object| pick(object) == verdict).count()
            };
            for (name, pick) in [
                ("3D", (|object: &Judged| object.in_3d) as fn(&Judged) -> Verdict),
                ("2D", (|object: &Judged| object.in_2d) as fn(&Judged) -> Verdict),
            ] {
                let _ = writeln!(
                    out,
                    "{title:>14} in {name}: {} present, {} missing, {} falsely solid, {} not seen",
                    count(pick, Verdict::Present),
                    count(pick, Verdict::Missing),
                    count(pick, Verdict::FalselySolid),
                    count(pick, Verdict::NotSeen),
                );
            }
        }
        out
    }
}
