//! The layered map of what can be driven on: ground, obstacles, overhangs and drop-offs.
//!
//! [`Terrain`] takes in range images ([`Terrain::integrate`]) and, for robots with a fixed laser,
//! single lines ([`Terrain::integrate_line`]). Per cell it keeps a short list of surfaces (height,
//! variance, how seen), the heights at which something was hit or looked through, and signs of
//! missing ground. [`Terrain::project`] reads it from where the robot stands: the level it is on,
//! as the 2D [`Grid`] that navigation and exploration work with.
//!
//! What was not seen is unknown, and unknown ground is never driven on.

mod column;
mod config;
mod distance;
mod fan;
mod fill;
mod grid;
mod ground;
mod lattice;
mod level;
mod project;
mod rays;
mod slit;
mod surface;

pub use config::{RobotShape, TRIED_M, TerrainConfig};
pub use grid::{CellClass, Grid, GridCell, Trinary};
pub use lattice::CellIndex;
pub use surface::{Seen, Surface, Void};

use crate::scan::{ImageRow, LaserLine, RangeImage, Return};
use fan::{Fan, FloorPlane, Sample};
use lattice::Lattice;
use nalgebra::{Isometry3, Point2, Point3, Vector3};
use rays::RayWindow;
use serde::{Deserialize, Serialize};
use surface::Observation;

/// Flat log-odds, in tenths, that a laser line adds where it ends and takes where it passes.
const FLAT_HIT: i8 = 9;
const FLAT_PASS: i8 = -4;

/// The terrain as far as it was seen. See the module for what it holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Terrain {
    config: TerrainConfig,
    shape: RobotShape,
    lattice: Lattice,
    /// Number of images and lines taken in.
    scans: u32,
}

/// What one image told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Integrated {
    /// Beams that returned a point.
    pub points: usize,
    /// Points that were read as ground.
    pub ground_points: usize,
    /// Columns in which ground that was due did not show.
    pub missing_ground: usize,
}

impl Terrain {
    /// An empty terrain for a robot of the given shape.
    pub fn new(config: TerrainConfig, shape: RobotShape) -> Self {
        Self { config, shape, lattice: Lattice::default(), scans: 0 }
    }

    /// The configuration in force.
    pub fn config(&self) -> &TerrainConfig {
        &self.config
    }

    /// The robot this terrain is judged for.
    pub fn shape(&self) -> &RobotShape {
        &self.shape
    }

    /// Number of images and lines taken in so far.
    pub fn scans(&self) -> u32 {
        self.scans
    }

    /// Takes the disc of `radius_m` about the robot for ground, at the height of its wheels.
    ///
    /// For the place where the robot starts: it stands there, so there is ground, though its laser
    /// never sees it. The ground is marked [`Seen::Assumed`] until it is measured, and does not
    /// count as explored.
    pub fn assume(&mut self, world_from_robot: &Isometry3<f64>, radius_m: f64) {
        self.assume_where(world_from_robot, radius_m, |_| true);
    }

    /// The same for the part of the disc that is `open` to where the robot stands.
    pub fn assume_where(
        &mut self,
        world_from_robot: &Isometry3<f64>,
        radius_m: f64,
        open: impl Fn(&Point2<f64>) -> bool,
    ) {
        let floor = FloorPlane::under(world_from_robot, &self.shape);
        self.stand_on(&floor, radius_m, Seen::Assumed, |x, y| open(&Point2::new(x, y)));
    }

    /// Takes a sector ahead of the robot for ground, `half_angle_rad` to either side of its heading and
    /// out to `radius_m`: the gap between the robot and the nearest ground that its laser can see.
    pub fn assume_ahead(
        &mut self,
        world_from_robot: &Isometry3<f64>,
        radius_m: f64,
        half_angle_rad: f64,
    ) {
        let floor = FloorPlane::under(world_from_robot, &self.shape);
        let robot_from_world = world_from_robot.inverse();
        self.stand_on(&floor, radius_m, Seen::Assumed, |x, y| {
            let p = robot_from_world * Point3::new(x, y, floor.z_at(x, y));
            p.y.atan2(p.x).abs() <= half_angle_rad
        });
    }

    /// Takes the hull's own footprint for ground: the robot stands on it ([`Seen::Driven`]).
    ///
    /// Call it along the way; it keeps the robot's own track drivable where the laser could not look,
    /// and makes sure what was only interpolated.
    pub fn drive_over(&mut self, world_from_robot: &Isometry3<f64>) {
        let floor = FloorPlane::under(world_from_robot, &self.shape);
        let robot_from_world = world_from_robot.inverse();
        let (half_length_m, half_width_m) = (0.5 * self.shape.length_m, 0.5 * self.shape.width_m);
        let radius_m = self.shape.circumscribed_radius_m();
        self.stand_on(&floor, radius_m, Seen::Driven, |x, y| {
            let p = robot_from_world * Point3::new(x, y, floor.z_at(x, y));
            p.x.abs() <= half_length_m && p.y.abs() <= half_width_m
        });
    }

    fn stand_on(
        &mut self,
        floor: &FloorPlane,
        radius_m: f64,
        seen: Seen,
        within: impl Fn(f64, f64) -> bool,
    ) {
        let cell_m = self.config.cell_m;
        let low = CellIndex::at(floor.point.x - radius_m, floor.point.y - radius_m, cell_m);
        let high = CellIndex::at(floor.point.x + radius_m, floor.point.y + radius_m, cell_m);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = CellIndex { x, y };
                let [cx, cy] = cell.centre_m(cell_m);
                let away_m = (cx - floor.point.x).hypot(cy - floor.point.y);
                if away_m > radius_m || !within(cx, cy) {
                    continue;
                }
                self.lattice.ground_mut(cell).observe(&Observation {
                    z_m: floor.z_at(cx, cy),
                    sigma_m: 0.05,
                    distance_m: away_m,
                    seen,
                    scan: self.scans,
                });
            }
        }
    }

    /// Takes in a range image that was taken with the robot at `world_from_robot`.
    ///
    /// Costs one pass over the points and one over the cells that their rays cross; the cost grows
    /// with the space that is seen, not with the map.
    pub fn integrate(
        &mut self,
        image: &RangeImage,
        world_from_robot: &Isometry3<f64>,
    ) -> Integrated {
        self.scans += 1;
        let floor = FloorPlane::under(world_from_robot, &self.shape);
        let fans = fan::fans(image, world_from_robot, &self.shape);
        let mut window = self.window(&fans, &floor);
        let mut told = Integrated::default();
        for fan in &fans {
            let mut labels = ground::label(fan, &floor, &self.config, &self.shape, |p, sigma_m| {
                self.ground_is_known(p, sigma_m)
            });
            slit::find(fan, &floor, &self.config, &self.shape, &mut labels);
            self.observe_ground(fan, &labels, &mut told);
            self.trace(fan, &labels, &floor, &mut window);
            told.missing_ground += labels.missing.len();
            for missing in &labels.missing {
                self.mark_missing(missing);
            }
        }
        window.apply(&mut self.lattice, self.scans);
        told
    }

    /// Whether ground at nearly this height is known in the cell of `p` or within two cells of it.
    fn ground_is_known(&self, p: &Point3<f64>, sigma_m: f64) -> bool {
        let cell = CellIndex::at(p.x, p.y, self.config.cell_m);
        let near = [(0, 0), (-2, 0), (2, 0), (0, -2), (0, 2)];
        near.into_iter().any(|(dx, dy)| {
            let cell = CellIndex { x: cell.x + dx, y: cell.y + dy };
            self.lattice.ground(cell).is_some_and(|ground| {
                ground
                    .nearest(p.z, 0.5 * self.shape.max_step_m + 2.0 * sigma_m)
                    .is_some_and(|surface| surface.seen >= Seen::Interpolated)
            })
        })
    }

    fn window(&self, fans: &[Fan], floor: &FloorPlane) -> RayWindow {
        let cell_m = self.config.cell_m;
        let centre = CellIndex::at(floor.point.x, floor.point.y, cell_m);
        let reach = (self.config.carve_range_m / cell_m).ceil() as i32;
        let (mut low, mut high) = (centre, centre);
        let mut include = |p: &Point3<f64>| {
            let cell = CellIndex::at(p.x, p.y, cell_m);
            (low.x, low.y) = (low.x.min(cell.x), low.y.min(cell.y));
            (high.x, high.y) = (high.x.max(cell.x), high.y.max(cell.y));
        };
        for fan in fans {
            for (index, sample) in fan.samples.iter().enumerate() {
                match sample {
                    Sample::Hit { p, .. } => include(p),
                    Sample::Nothing => {
                        let row = &fan.rows[index / fan.columns.len()];
                        let ray = row.direction(fan.columns[index % fan.columns.len()]);
                        include(&(row.origin + ray * self.config.carve_range_m));
                    }
                    Sample::Missing => {}
                }
            }
        }
        // A point far away must not make the window larger than what rays may clear or hit usefully.
        let far = reach * 2;
        let low = CellIndex { x: low.x.max(centre.x - far), y: low.y.max(centre.y - far) };
        let high = CellIndex { x: high.x.min(centre.x + far), y: high.y.min(centre.y + far) };
        RayWindow::new(low, high, cell_m, floor.point.z)
    }

    fn observe_ground(&mut self, fan: &Fan, labels: &ground::Labels, told: &mut Integrated) {
        let (cell_m, scan) = (self.config.cell_m, self.scans);
        for (sample, ground) in fan.samples.iter().zip(&labels.ground) {
            let Sample::Hit { p, away_m } = sample else { continue };
            told.points += 1;
            if !ground {
                continue;
            }
            told.ground_points += 1;
            self.lattice.ground_mut(CellIndex::at(p.x, p.y, cell_m)).observe(&Observation {
                z_m: p.z,
                sigma_m: self.config.height_sigma_at(*away_m),
                distance_m: *away_m,
                seen: Seen::Measured,
                scan,
            });
        }
        let lattice = &mut self.lattice;
        let config = &self.config;
        fill::fill(fan, labels, config, &self.shape, |cell, z_m, away_m| {
            lattice.ground_mut(cell).observe(&Observation {
                z_m,
                sigma_m: 1.5 * config.height_sigma_at(away_m),
                distance_m: away_m,
                seen: Seen::Interpolated,
                scan,
            });
        });
    }

    /// Notes hits and passes of a fan's rays.
    fn trace(
        &self,
        fan: &Fan,
        labels: &ground::Labels,
        floor: &FloorPlane,
        window: &mut RayWindow,
    ) {
        let columns = fan.columns.len();
        // Nothing above the robot's highest part concerns it; one bin more for the ceiling's edge.
        let ceiling_m = self.shape.height_m + self.shape.clearance_m + 0.3;
        for (at, sample) in fan.samples.iter().enumerate() {
            let row = &fan.rows[at / columns];
            let ray = row.direction(fan.columns[at % columns]);
            let (range_m, limit_m) = match sample {
                Sample::Missing => continue,
                Sample::Hit { p, away_m } => {
                    if !self.is_doubtful(f64::from(labels.above_m[at]), *away_m) {
                        window.hit(p);
                    }
                    ((p - row.origin).norm(), self.config.carve_range_m)
                }
                Sample::Nothing => {
                    // Beyond the floor's height a return was due: without one the ray ends there.
                    let x = row.origin.x + ray.x;
                    let y = row.origin.y + ray.y;
                    let over_m = row.origin.z - floor.z_at(row.origin.x, row.origin.y);
                    let closing = over_m - (row.origin.z + ray.z - floor.z_at(x, y));
                    let due_m = if closing > 1e-6 { over_m / closing } else { f64::INFINITY };
                    (fan.max_range_m.min(due_m), self.config.carve_range_m)
                }
            };
            // The ceiling follows the slope the robot stands on, but not below its own level.
            let rise_m = floor.slope(&Vector3::new(ray.x, ray.y, 0.0)).max(0.0) * range_m;
            let top_m = floor.point.z + ceiling_m + rise_m;
            window.pass(&row.origin, &ray, range_m.min(limit_m), top_m);
        }
    }

    /// Whether a far point so near to the ground before it that attitude noise may have raised it
    /// must not count as an obstacle.
    fn is_doubtful(&self, above_m: f64, away_m: f64) -> bool {
        let noise_m = 2.5 * self.config.height_sigma_at(away_m);
        away_m > 0.5 * self.config.ground_range_m
            && above_m.abs() < self.shape.max_step_m.max(0.05) + noise_m
    }

    fn mark_missing(&mut self, missing: &ground::Missing) {
        let void = if missing.proven { Void::Proven } else { Void::Suspected };
        let cell_m = self.config.cell_m;
        let stretch = missing.to - missing.from;
        let steps = (2.0 * stretch.norm() / cell_m).ceil().max(1.0) as u32;
        let first = CellIndex::at(missing.from.x, missing.from.y, cell_m);
        for step in 0..=steps {
            let p = missing.from + stretch * (f64::from(step) / f64::from(steps));
            let cell = CellIndex::at(p.x, p.y, cell_m);
            if cell != first || stretch.norm() < cell_m {
                self.lattice.ground_mut(cell).mark_void(p.z, void);
            }
        }
    }

    /// Takes in a single laser line as flat occupancy (2D mode): for recordings and for robots whose
    /// laser cannot tilt. It never makes ground, unless [`TerrainConfig::flat_floor`] says so.
    ///
    /// Beams that leave the horizontal by more than 5° are left out, as they end on floor or ceiling.
    pub fn integrate_line(&mut self, line: &LaserLine, world_from_sensor: &Isometry3<f64>) {
        self.scans += 1;
        let cell_m = self.config.cell_m;
        let origin = Point3::from(world_from_sensor.translation.vector);
        for beam in 0..line.len() {
            let ray = world_from_sensor * line.direction(beam);
            if ray.z.abs() > 0.087 {
                continue;
            }
            let (range_m, ended) = match line.classify(beam) {
                Return::Hit(range_m) => (range_m, true),
                Return::Nothing => (line.max_range_m.min(self.config.carve_range_m), false),
                Return::Missing => continue,
            };
            let end = origin + ray * range_m;
            let end_cell = CellIndex::at(end.x, end.y, cell_m);
            let steps = (2.0 * range_m / cell_m).ceil().max(1.0) as u32;
            let mut before = end_cell;
            for step in 0..steps {
                let p = origin + (end - origin) * (f64::from(step) / f64::from(steps));
                let cell = CellIndex::at(p.x, p.y, cell_m);
                if cell != before && cell != end_cell {
                    self.add_flat(cell, FLAT_PASS);
                }
                before = cell;
            }
            if ended {
                self.add_flat(end_cell, FLAT_HIT);
            }
        }
    }

    fn add_flat(&mut self, cell: CellIndex, tenths: i8) {
        let (chunk, place) = lattice::split(cell);
        self.lattice.chunk_or_new(chunk).add_flat(place, tenths);
    }

    /// Takes in one line of a parked, tilted laser: the guard line that sweeps the ground while the
    /// robot drives. Its points count as ground where they lie on the plane the robot stands on or on
    /// ground known before; what stands above is an obstacle.
    pub fn integrate_guard_line(
        &mut self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        world_from_robot: &Isometry3<f64>,
    ) -> Integrated {
        let bearings_rad = (0..line.len()).map(|beam| line.bearing_rad(beam)).collect();
        let mut image = RangeImage::new(*robot_from_sensor, bearings_rad, line.max_range_m);
        let row = ImageRow {
            tilt_rad: 0.0,
            tilt_sigma_rad: 0.0,
            scan_from_sensor: Isometry3::identity(),
            stamp: Some(line.stamp),
        };
        image.push_line(row, line);
        self.integrate(&image, world_from_robot)
    }

    /// Forgets everything, assumed ground too: for drawing anew what earlier poses got wrong.
    pub fn clear(&mut self) {
        self.lattice = Lattice::default();
        self.scans = 0;
    }

    /// The surfaces known in a cell, of all levels, in no order.
    pub fn surfaces(&self, cell: CellIndex) -> &[Surface] {
        self.lattice.ground(cell).map_or(&[], |ground| ground.surfaces())
    }

    /// The sign of missing ground in a cell, with the height at which ground was due.
    pub fn void(&self, cell: CellIndex) -> Option<(Void, f64)> {
        self.lattice
            .ground(cell)
            .filter(|ground| ground.void != Void::None)
            .map(|ground| (ground.void, f64::from(ground.void_z_m)))
    }

    /// Whether anything was hit between two heights of the map frame above a cell, and not looked
    /// through since.
    pub fn is_occupied_between(&self, cell: CellIndex, low_m: f64, high_m: f64) -> bool {
        self.lattice.occupied_between(cell, low_m, high_m)
    }

    /// Cells in which ground was measured from at most [`TerrainConfig::coverage_range_m`] away, with
    /// the height: what coverage counts by.
    pub fn measured_ground(&self) -> impl Iterator<Item = (CellIndex, f64)> + '_ {
        let reach_m = self.config.coverage_range_m as f32;
        self.lattice.chunks().iter().flat_map(move |chunk| {
            chunk.ground.iter().enumerate().flat_map(move |(place, ground)| {
                let cell = CellIndex {
                    x: chunk.x * lattice::CHUNK + place as i32 % lattice::CHUNK,
                    y: chunk.y * lattice::CHUNK + place as i32 / lattice::CHUNK,
                };
                ground
                    .surfaces()
                    .iter()
                    .filter(move |surface| surface.seen_from_m <= reach_m)
                    .map(move |surface| (cell, f64::from(surface.z_m)))
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ground_assumed_ahead_ends_at_the_sides_of_the_sector() {
        let mut terrain = Terrain::new(TerrainConfig::default(), RobotShape::default());
        let left = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.5);
        let pose = Isometry3::from_parts(nalgebra::Translation3::new(1.0, 2.0, 0.2), left);
        terrain.assume(&pose, 0.3);
        terrain.assume_ahead(&pose, 0.8, 0.6);
        let grid = terrain.project(&pose);
        let class = |bearing: f64, away_m: f64| {
            let p = pose * Point3::new(away_m * bearing.cos(), away_m * bearing.sin(), 0.0);
            grid.class_at(p.x, p.y)
        };
        assert_eq!(class(0.0, 0.7), CellClass::Assumed);
        assert_eq!(class(0.5, 0.7), CellClass::Assumed);
        assert_eq!(class(0.8, 0.7), CellClass::Unknown);
        assert_eq!(class(0.0, 0.95), CellClass::Unknown);
        assert_eq!(class(std::f64::consts::PI, 0.7), CellClass::Unknown);
    }

    fn level_terrain() -> (Terrain, Isometry3<f64>) {
        let mut terrain = Terrain::new(TerrainConfig::default(), RobotShape::default());
        let pose = Isometry3::translation(0.0, 0.0, terrain.shape.base_above_floor_m);
        terrain.assume(&pose, 2.0);
        (terrain, pose)
    }

    /// One image hits what stands 0.3 m high over a cell.
    fn hit(terrain: &mut Terrain, cell: CellIndex) {
        let (chunk, place) = lattice::split(cell);
        terrain.lattice.chunk_or_new(chunk).update_column(place, column::bin_of(0.3), 1, 0);
    }

    #[test]
    fn a_lone_point_is_no_obstacle_but_two_are_and_so_is_one_seen_twice() {
        let (alone, beside, twice) =
            (CellIndex { x: 20, y: 0 }, CellIndex { x: 0, y: 20 }, CellIndex { x: -20, y: 0 });
        let (mut terrain, pose) = level_terrain();
        for cell in [alone, beside, CellIndex { x: 1, y: 20 }, twice, twice] {
            hit(&mut terrain, cell);
        }
        let grid = terrain.project(&pose);
        assert!(grid.get(alone).class.is_drivable());
        assert_eq!(grid.get(beside).class, CellClass::Occupied);
        assert_eq!(grid.get(twice).class, CellClass::Occupied);
    }

    #[test]
    fn blank_cells_are_ground_where_both_sides_lie_in_one_line() {
        let class_of_blank = |slope: f64, rise_m: f64| {
            let (mut terrain, pose) = level_terrain();
            let blank = 12..14;
            for (x, y) in (-16..30).flat_map(|x| (-16..16).map(move |y| (x, y))) {
                let cell = CellIndex { x, y };
                *terrain.lattice.ground_mut(cell) = surface::GroundCell::default();
                let beyond_m = if x >= blank.end { rise_m } else { 0.0 };
                if !blank.contains(&x) {
                    terrain.lattice.ground_mut(cell).observe(&Observation {
                        z_m: slope * 0.05 * f64::from(x) + beyond_m,
                        sigma_m: 0.01,
                        distance_m: 1.0,
                        seen: Seen::Measured,
                        scan: 1,
                    });
                }
            }
            terrain.project(&pose).get(CellIndex { x: 12, y: 0 }).class
        };
        assert_eq!(class_of_blank(0.0, 0.0), CellClass::Free);
        assert_eq!(class_of_blank(0.3, 0.0), CellClass::Free);
        assert_eq!(class_of_blank(0.0, 0.05), CellClass::Unknown);
        assert_eq!(class_of_blank(0.0, -0.05), CellClass::Unknown);
    }

    #[test]
    fn ground_is_too_steep_but_under_the_robot_that_stands_on_it() {
        let (mut terrain, pose) = level_terrain();
        for x in -16..16 {
            for y in -16..16 {
                let cell = CellIndex { x, y };
                *terrain.lattice.ground_mut(cell) = surface::GroundCell::default();
                terrain.lattice.ground_mut(cell).observe(&Observation {
                    z_m: 0.03 * f64::from(x),
                    sigma_m: 0.01,
                    distance_m: 1.0,
                    seen: Seen::Measured,
                    scan: 1,
                });
            }
        }
        let grid = terrain.project(&pose);
        let half_cells = (0.5 * terrain.shape.length_m / grid.cell_m()) as i32;
        assert_eq!(grid.get(CellIndex { x: 0, y: 0 }).class, CellClass::Free);
        assert_eq!(grid.get(CellIndex { x: half_cells, y: 0 }).class, CellClass::Free);
        assert_eq!(grid.get(CellIndex { x: half_cells + 3, y: 0 }).class, CellClass::TooSteep);
        assert_eq!(grid.get(CellIndex { x: 0, y: half_cells + 3 }).class, CellClass::TooSteep);
    }
}
