//! A world of rectangles and what a tilting scanner makes of them: plane observations with the exact
//! noise that their covariance states, occlusion and field of view included, without points.

use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point2, Point3, SymmetricEigen, UnitQuaternion, Vector3, Vector6,
};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use usar_agent::geometry::convex_hull;
use usar_agent::mapping::perturbation::perturbed_plane;
use usar_agent::mapping::{Observation, PlaneMask, ScanErrors, ScanObservations};

/// A one-sided rectangle: its frame's z is the side that can be seen.
#[derive(Clone, Debug)]
pub struct Rectangle {
    pub frame: Isometry3<f64>,
    pub half_x_m: f64,
    pub half_y_m: f64,
    /// The frame's axes in the world.
    axes: [Vector3<f64>; 3],
}

impl Rectangle {
    /// A rectangle around `centre` with its normal along `normal` and its x axis along `along`.
    pub fn new(
        centre: [f64; 3],
        normal: Vector3<f64>,
        along: Vector3<f64>,
        size: (f64, f64),
    ) -> Self {
        let z = normal.normalize();
        let x = (along - z * along.dot(&z)).normalize();
        let rotation = nalgebra::Rotation3::from_basis_unchecked(&[x, z.cross(&x), z]);
        Self {
            frame: Isometry3::from_parts(
                Vector3::from(centre).into(),
                UnitQuaternion::from_rotation_matrix(&rotation),
            ),
            half_x_m: 0.5 * size.0,
            half_y_m: 0.5 * size.1,
            axes: [x, z.cross(&x), z],
        }
    }
}

/// Rectangles, and the scanner that looks at them.
#[derive(Clone, Debug, Default)]
pub struct World {
    pub rectangles: Vec<Rectangle>,
}

/// Height of the scanner above the robot's origin.
pub const SENSOR_HEIGHT_M: f64 = 0.6;
/// Where the wheels touch the ground: the robot frame lies on it.
const WHEELS: [[f64; 3]; 4] =
    [[0.13, 0.2, 0.0], [0.13, -0.2, 0.0], [-0.13, 0.2, 0.0], [-0.13, -0.2, 0.0]];
const MAX_RANGE_M: f64 = 20.0;
const RANGE_SIGMA_M: f64 = 0.01;

impl World {
    /// A wall as a vertical rectangle over the ground line `a`–`b`, seen from its left side.
    pub fn wall(&mut self, a: (f64, f64), b: (f64, f64), low: f64, high: f64) {
        let along = Vector3::new(b.0 - a.0, b.1 - a.1, 0.0);
        let centre = [0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1), 0.5 * (low + high)];
        let normal = Vector3::z().cross(&along);
        self.rectangles.push(Rectangle::new(centre, normal, along, (along.norm(), high - low)));
    }

    /// A level rectangle at height `z`, seen from above or from below.
    pub fn level(&mut self, x: (f64, f64), y: (f64, f64), z: f64, from_above: bool) {
        let centre = [0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1), z];
        let normal = if from_above { Vector3::z() } else { -Vector3::z() };
        let size = (x.1 - x.0, y.1 - y.0);
        self.rectangles.push(Rectangle::new(centre, normal, Vector3::x(), size));
    }

    /// Four walls seen from inside, floor and ceiling.
    pub fn room(&mut self, x: (f64, f64), y: (f64, f64), height: f64) {
        self.level(x, y, 0.0, true);
        self.level(x, y, height, false);
        let corners = [(x.0, y.0), (x.1, y.0), (x.1, y.1), (x.0, y.1)];
        for i in 0..4 {
            self.wall(corners[i], corners[(i + 1) % 4], 0.0, height);
        }
    }

    /// A box on the floor seen from outside.
    pub fn block(&mut self, centre: (f64, f64), size: (f64, f64, f64), yaw: f64) {
        let turn = |x: f64, y: f64| {
            let (sin, cos) = yaw.sin_cos();
            (centre.0 + x * cos - y * sin, centre.1 + x * sin + y * cos)
        };
        let (hx, hy) = (0.5 * size.0, 0.5 * size.1);
        let corners = [turn(-hx, -hy), turn(-hx, hy), turn(hx, hy), turn(hx, -hy)];
        for i in 0..4 {
            self.wall(corners[i], corners[(i + 1) % 4], 0.0, size.2);
        }
        self.rectangles.push(Rectangle::new(
            [centre.0, centre.1, size.2],
            Vector3::z(),
            Vector3::new(yaw.cos(), yaw.sin(), 0.0),
            (size.0, size.1),
        ));
    }

    /// Whether two rectangles lie in one plane and face the same way: pieces of one surface.
    pub fn coplanar(&self, a: usize, b: usize) -> bool {
        let gap = self.rectangles[a].frame.inverse() * self.rectangles[b].frame;
        (gap.rotation * Vector3::z()).z > 1.0 - 1e-12 && gap.translation.vector.z.abs() < 1e-6
    }

    /// Whether a rectangle other than `skip` cuts the way from `origin` to `target`.
    fn blocked(&self, origin: &Point3<f64>, target: &Point3<f64>, skip: usize) -> bool {
        let ray = target - origin;
        self.rectangles.iter().enumerate().any(|(i, rectangle)| {
            let [x, y, z] = &rectangle.axes;
            let across = z.dot(&ray);
            if i == skip || across.abs() < 1e-12 {
                return false;
            }
            let from = origin.coords - rectangle.frame.translation.vector;
            let t = -z.dot(&from) / across;
            let hit = from + ray * t;
            (1e-6..0.999).contains(&t)
                && x.dot(&hit).abs() <= rectangle.half_x_m
                && y.dot(&hit).abs() <= rectangle.half_y_m
        })
    }

    /// What a scan from `world_from_robot` shows, with the rectangle behind each observation. Noise
    /// is drawn from each observation's own covariance; `rng` of `None` makes none.
    pub fn observe(
        &self,
        world_from_robot: &Isometry3<f64>,
        mut rng: Option<&mut Pcg64>,
    ) -> (ScanObservations, Vec<usize>) {
        let robot_from_scan = Isometry3::translation(0.0, 0.0, SENSOR_HEIGHT_M);
        let world_from_scan = world_from_robot * robot_from_scan;
        let robot_from_world = world_from_robot.inverse();
        let mut observations = Vec::new();
        let mut truth = Vec::new();
        for (index, rectangle) in self.rectangles.iter().enumerate() {
            if let Some(mut observation) =
                self.patch(index, rectangle, &world_from_scan, &robot_from_world)
            {
                if let Some(rng) = rng.as_deref_mut() {
                    let error = drawn3(rng, &observation.covariance);
                    observation.robot_from_plane =
                        perturbed_plane(&observation.robot_from_plane, &error);
                }
                observations.push(observation);
                truth.push(index);
            }
        }
        (
            ScanObservations {
                observations,
                curves: Vec::new(),
                robot_from_scan,
                errors: ScanErrors::default(),
                contacts: WHEELS.map(Point3::from).to_vec(),
            },
            truth,
        )
    }

    fn patch(
        &self,
        index: usize,
        rectangle: &Rectangle,
        world_from_scan: &Isometry3<f64>,
        robot_from_world: &Isometry3<f64>,
    ) -> Option<Observation> {
        let eye = Point3::from(world_from_scan.translation.vector);
        let local_eye = rectangle.frame.inverse_transform_point(&eye);
        if local_eye.z < 0.05 {
            return None;
        }
        let mut seen: Vec<(Point2<f64>, f64)> = Vec::new();
        let steps = |half: f64| ((2.0 * half / 0.2).ceil() as i32).clamp(4, 40);
        let (nx, ny) = (steps(rectangle.half_x_m), steps(rectangle.half_y_m));
        let pitch =
            (2.0 * rectangle.half_x_m / f64::from(nx), 2.0 * rectangle.half_y_m / f64::from(ny));
        let cell = pitch.0 * pitch.1;
        for i in 0..nx {
            for j in 0..ny {
                let x = rectangle.half_x_m * ((2.0 * f64::from(i) + 1.0) / f64::from(nx) - 1.0);
                let y = rectangle.half_y_m * ((2.0 * f64::from(j) + 1.0) / f64::from(ny) - 1.0);
                let world = rectangle.frame * Point3::new(x, y, 0.0);
                let ray = world_from_scan.inverse_transform_point(&world).coords;
                let range = ray.norm();
                let bearing = ray.y.atan2(ray.x.hypot(ray.z) * ray.x.signum());
                let tilt = (-ray.z).atan2(ray.x);
                let within = range < MAX_RANGE_M
                    && bearing.abs() < 65_f64.to_radians()
                    && (-25_f64.to_radians()..30_f64.to_radians()).contains(&tilt);
                if within && !self.blocked(&eye, &world, index) {
                    // Beams that hit the cell: its solid angle over that of a beam (1° × 0.25°).
                    let facing = local_eye.z / range;
                    let beams = cell * facing / (range * range) / (0.017_45 * 0.004_36);
                    seen.push((Point2::new(x, y), beams));
                }
            }
        }
        let beams: f64 = seen.iter().map(|(_, beams)| beams).sum();
        if seen.len() < 4 || beams < 40.0 {
            return None;
        }
        Self::fitted(rectangle, &seen, pitch, beams, robot_from_world)
    }

    /// The observation that a least-squares fit of those points would give, without its noise.
    fn fitted(
        rectangle: &Rectangle,
        seen: &[(Point2<f64>, f64)],
        pitch: (f64, f64),
        beams: f64,
        robot_from_world: &Isometry3<f64>,
    ) -> Option<Observation> {
        let mean = seen.iter().map(|(p, w)| p.coords * *w).sum::<nalgebra::Vector2<f64>>() / beams;
        let scatter: nalgebra::Matrix2<f64> =
            seen.iter().map(|(p, w)| (p.coords - mean) * (p.coords - mean).transpose() * *w).sum();
        let eigen = SymmetricEigen::new(scatter);
        let greater = eigen.eigenvalues.imax();
        let axis = eigen.eigenvectors.column(greater);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * axis[1].atan2(axis[0]));
        let local = Isometry3::from_parts(Vector3::new(mean.x, mean.y, 0.0).into(), turn);
        let hull: Vec<Point2<f64>> =
            seen.iter().map(|(p, _)| (local.inverse() * Point3::new(p.x, p.y, 0.0)).xy()).collect();
        let mut mask = PlaneMask::default();
        // A real scan's mask has no holes between its beams.
        let across = |pitch: f64| {
            let steps = (pitch / 0.05).ceil();
            (0..=steps as i32).map(move |k| pitch * (f64::from(k) / steps - 0.5))
        };
        for (p, _) in seen {
            for dx in across(pitch.0) {
                for dy in across(pitch.1) {
                    mask.insert(&(local.inverse() * Point3::new(p.x + dx, p.y + dy, 0.0)).xy());
                }
            }
        }
        let hull = convex_hull(&hull);
        let variance = RANGE_SIGMA_M * RANGE_SIGMA_M;
        let least = eigen.eigenvalues[1 - greater].max(1e-9);
        let covariance = Matrix3::from_diagonal(&Vector3::new(
            variance / beams,
            variance / eigen.eigenvalues[greater],
            variance / least,
        ));
        (!hull.is_empty() && covariance[(2, 2)] < 0.05 * 0.05).then(|| Observation {
            robot_from_plane: robot_from_world * rectangle.frame * local,
            covariance,
            hull,
            mask,
            points: beams as usize,
            rms_m: 0.003,
        })
    }
}

/// A seeded generator.
pub fn rng(seed: u64) -> Pcg64 {
    Pcg64::seed_from_u64(seed)
}

/// A number that is uniform in 0..1.
pub fn uniform(rng: &mut Pcg64) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// A standard normal number (Box and Muller).
pub fn normal(rng: &mut Pcg64) -> f64 {
    let (u, v) = (uniform(rng).max(1e-300), uniform(rng));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// A vector drawn from a covariance.
pub fn drawn6(rng: &mut Pcg64, covariance: &Matrix6<f64>) -> Vector6<f64> {
    let root = covariance.cholesky().expect("a covariance").l();
    root * Vector6::from_fn(|_, _| normal(rng))
}

fn drawn3(rng: &mut Pcg64, covariance: &Matrix3<f64>) -> Vector3<f64> {
    let root = covariance.cholesky().expect("a covariance").l();
    root * Vector3::from_fn(|_, _| normal(rng))
}

/// A furnished room, which leaves no direction open.
pub fn furnished_room() -> World {
    let mut world = World::default();
    world.room((-3.0, 11.0), (-5.0, 5.0), 3.0);
    world.block((4.0, -2.5), (1.0, 0.8, 0.9), 0.5);
    world.block((7.5, 2.0), (0.8, 1.6, 1.3), -0.3);
    world.block((2.5, 3.0), (0.7, 0.7, 0.6), 0.2);
    world.block((8.5, -3.0), (1.4, 0.8, 1.8), 1.2);
    world
}
