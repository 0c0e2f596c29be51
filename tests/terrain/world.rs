//! Small analytic worlds of convex solids, and a tilting laser that looks at them. Written for these
//! tests alone: the stand-in simulator and the terrain share none of it.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand_core::Rng;
use rand_pcg::Pcg32;
use usar_agent::scan::{ImageRow, LaserLine, RangeImage};
use usar_agent::time::Stamp;

/// A convex solid: the points `p` with `n · p <= d` for all its faces.
#[derive(Clone, Debug)]
pub struct Solid {
    faces: Vec<(Vector3<f64>, f64)>,
}

impl Solid {
    /// An upright box from one corner to the other.
    pub fn block(low: [f64; 3], high: [f64; 3]) -> Self {
        let mut faces = Vec::new();
        for axis in 0..3 {
            let mut n = Vector3::zeros();
            n[axis] = 1.0;
            faces.push((n, high[axis]));
            faces.push((-n, -low[axis]));
        }
        Self { faces }
    }

    /// An upright prism with eight sides about (x, y).
    pub fn pole(x: f64, y: f64, radius: f64, top: f64) -> Self {
        let mut faces = vec![(Vector3::z(), top), (-Vector3::z(), 1.0)];
        for side in 0..8 {
            let angle = f64::from(side) * std::f64::consts::FRAC_PI_4;
            let n = Vector3::new(angle.cos(), angle.sin(), 0.0);
            faces.push((n, n.x * x + n.y * y + radius));
        }
        Self { faces }
    }

    /// A ramp over the rectangle `low..high` whose top runs from height `z0` at low x to `z1` at
    /// high x; its underside lies at z = -2.
    pub fn ramp(low: [f64; 2], high: [f64; 2], z0: f64, z1: f64) -> Self {
        let mut solid = Self::block([low[0], low[1], -2.0], [high[0], high[1], z0.max(z1)]);
        let slope = (z1 - z0) / (high[0] - low[0]);
        let n = Vector3::new(-slope, 0.0, 1.0);
        solid.faces.push((n, z0 - slope * low[0]));
        solid
    }

    /// The solid turned by `yaw` about the vertical axis through `centre`.
    #[must_use]
    pub fn turned(mut self, yaw: f64, centre: [f64; 2]) -> Self {
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, yaw);
        let c = Vector3::new(centre[0], centre[1], 0.0);
        for (n, d) in &mut self.faces {
            let turned = turn * *n;
            *d += turned.dot(&c) - n.dot(&c);
            *n = turned;
        }
        self
    }

    /// Distance along the ray to the solid's surface, for rays that start outside.
    fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
        for (n, d) in &self.faces {
            let (height, closing) = (n.dot(&origin.coords) - d, n.dot(direction));
            if closing.abs() < 1e-12 {
                if height > 0.0 {
                    return None;
                }
                continue;
            }
            let t = -height / closing;
            if closing < 0.0 {
                enter = enter.max(t);
            } else {
                leave = leave.min(t);
            }
            if enter > leave {
                return None;
            }
        }
        (enter > 0.0).then_some(enter)
    }
}

/// Solids, of which some do not answer the laser.
#[derive(Clone, Debug, Default)]
pub struct World {
    solids: Vec<Solid>,
    /// Rays through these come back from nowhere: glass, black water.
    mute: Vec<Solid>,
}

impl World {
    #[must_use]
    pub fn with(mut self, solid: Solid) -> Self {
        self.solids.push(solid);
        self
    }

    #[must_use]
    pub fn with_mute(mut self, solid: Solid) -> Self {
        self.mute.push(solid);
        self
    }

    pub fn cast(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let nearest = |solids: &[Solid]| {
            solids
                .iter()
                .filter_map(|solid| solid.cast(origin, direction))
                .fold(f64::INFINITY, f64::min)
        };
        let (hard, mute) = (nearest(&self.solids), nearest(&self.mute));
        (hard.is_finite() && hard < mute).then_some(hard)
    }

    /// Whether a point lies inside a solid.
    pub fn is_inside(&self, p: &Point3<f64>) -> bool {
        self.solids.iter().any(|solid| solid.faces.iter().all(|(n, d)| n.dot(&p.coords) <= *d))
    }

    /// Height of the highest surface below `(x, y, from_z)`, if any.
    pub fn floor_below(&self, x: f64, y: f64, from_z: f64) -> Option<f64> {
        self.cast(&Point3::new(x, y, from_z), &-Vector3::z()).map(|range| from_z - range)
    }
}

/// Height of the laser above the floor and its place ahead of the robot's middle.
pub const SENSOR_HEIGHT: f64 = 0.6;
pub const SENSOR_AHEAD: f64 = 0.10;
/// Height of `base_link` above the floor, as `RobotShape` has it by default.
pub const BASE_HEIGHT: f64 = 0.13;

/// A robot pose on level floor of height `z`.
pub fn pose(x: f64, y: f64, z: f64, yaw: f64) -> Isometry3<f64> {
    tilted_pose(x, y, z, yaw, 0.0, 0.0)
}

/// A robot pose whose wheels meet the floor at height `z` below its middle.
pub fn tilted_pose(x: f64, y: f64, z: f64, yaw: f64, pitch: f64, roll: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_euler_angles(roll, pitch, yaw);
    let up = turn * Vector3::new(0.0, 0.0, BASE_HEIGHT);
    Isometry3::from_parts(Translation3::new(x + up.x, y + up.y, z + up.z), turn)
}

/// Tilts (down positive) whose rings on level ground lie at most `ring` apart out to 8 m, from the
/// nearest that `steepest_deg` sees, and a few that look up.
pub fn coarse_tilts(steepest_deg: f64, ring: f64) -> Vec<f64> {
    let mut tilts = Vec::new();
    let mut away = SENSOR_HEIGHT / steepest_deg.to_radians().tan();
    while away < 8.0 {
        tilts.push((SENSOR_HEIGHT / away).atan());
        away += ring;
    }
    for up_deg in [-1.5, 0.0, 1.5, 3.0, -6.0, -12.0] {
        tilts.push(f64::to_radians(up_deg));
    }
    tilts
}

/// The paper's 220 rows.
pub fn paper_tilts() -> Vec<f64> {
    (0..220).map(|row| (-25.0 + 0.25 * f64::from(row)).to_radians()).collect()
}

/// The laser: noise of its ranges (standard deviation, metres) and its generator.
pub struct Laser {
    pub sigma: f64,
    pub random: Pcg32,
    pub max_range: f64,
}

impl Laser {
    pub fn exact() -> Self {
        Self::noisy(0.0, 1)
    }

    pub fn noisy(sigma: f64, seed: u64) -> Self {
        Self { sigma, random: Pcg32::new(seed, 0x5ca1_ab1e), max_range: 20.0 }
    }

    fn uniform(&mut self) -> f64 {
        f64::from(self.random.next_u32()) / f64::from(u32::MAX)
    }

    /// Roughly normal with unit variance: the sum of twelve uniform values.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    /// One line from a sensor pose.
    pub fn line(&mut self, world: &World, world_from_sensor: &Isometry3<f64>) -> LaserLine {
        let mut line = LaserLine {
            stamp: Stamp::from_seconds(1.0),
            first_bearing_rad: -std::f64::consts::FRAC_PI_2,
            bearing_step_rad: 1.0_f64.to_radians(),
            min_range_m: 0.1,
            max_range_m: self.max_range,
            phantom_m: None,
            ranges_m: Vec::new(),
        };
        let origin = Point3::from(world_from_sensor.translation.vector);
        for beam in 0..181 {
            let direction = world_from_sensor * line.direction(beam);
            let range = match world.cast(&origin, &direction) {
                Some(range) if range < self.max_range => range + self.sigma * self.normal(),
                _ => self.max_range,
            };
            line.ranges_m.push(range);
        }
        line
    }

    /// A sweep over `pans` × `tilts` from a robot pose.
    pub fn sweep(
        &mut self,
        world: &World,
        world_from_robot: &Isometry3<f64>,
        pans: &[f64],
        tilts: &[f64],
    ) -> RangeImage {
        let robot_from_scan = robot_from_scan();
        let bearings = (0..181).map(|beam| f64::from(beam - 90).to_radians()).collect();
        let mut image = RangeImage::new(robot_from_scan, bearings, self.max_range);
        for &pan in pans {
            for &tilt in tilts {
                let scan_from_sensor = scan_from_sensor(pan, tilt);
                let world_from_sensor = world_from_robot * robot_from_scan * scan_from_sensor;
                let line = self.line(world, &world_from_sensor);
                let row = ImageRow {
                    tilt_rad: tilt,
                    tilt_sigma_rad: 0.0,
                    scan_from_sensor,
                    stamp: Some(line.stamp),
                };
                image.push_line(row, &line);
            }
        }
        image
    }
}

pub fn robot_from_scan() -> Isometry3<f64> {
    Isometry3::translation(SENSOR_AHEAD, 0.0, SENSOR_HEIGHT - BASE_HEIGHT)
}

pub fn scan_from_sensor(pan: f64, tilt: f64) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pan)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt);
    Isometry3::from_parts(Translation3::identity(), turn)
}
