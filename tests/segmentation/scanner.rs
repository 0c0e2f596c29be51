//! Scanners of several geometries over a test world.

use super::world::{Random, World};
use nalgebra::{Isometry3, Point3, Rotation3, Vector3};
use usar_agent::scan::PointGrid;

/// Where each cell of a scan looks from and to, in the scan frame.
#[derive(Clone, Debug)]
pub struct Scanner {
    pub rows: usize,
    pub columns: usize,
    pub rays: Vec<(Point3<f64>, Vector3<f64>)>,
}

impl Scanner {
    /// A laser that nods about its y axis, mounted `lever_m` ahead of and above the axis.
    pub fn nodding(
        rows: usize,
        columns: usize,
        tilts_deg: [f64; 2],
        bearings_deg: [f64; 2],
        lever_m: [f64; 2],
    ) -> Self {
        let angle = |[first, last]: [f64; 2], i: usize, n: usize| {
            (first + (last - first) * i as f64 / (n - 1) as f64).to_radians()
        };
        let mut rays = Vec::new();
        for row in 0..rows {
            let tilt = Rotation3::from_axis_angle(&Vector3::y_axis(), angle(tilts_deg, row, rows));
            let origin = Point3::from(tilt * Vector3::new(lever_m[0], 0.0, lever_m[1]));
            for column in 0..columns {
                let (sin, cos) = angle(bearings_deg, column, columns).sin_cos();
                rays.push((origin, tilt * Vector3::new(cos, sin, 0.0)));
            }
        }
        Self { rows, columns, rays }
    }

    /// The paper's scanner in simulation: 220 tilts of 0.25°, the central 131 beams of 1°.
    pub fn paper() -> Self {
        Self::nodding(220, 131, [-25.0, 29.75], [65.0, -65.0], [0.0, 0.0])
    }

    /// A camera with square pixels.
    pub fn pinhole(rows: usize, columns: usize, focal_px: f64) -> Self {
        let mut rays = Vec::new();
        for row in 0..rows {
            for column in 0..columns {
                let left = (0.5 * (columns - 1) as f64 - column as f64) / focal_px;
                let up = (0.5 * (rows - 1) as f64 - row as f64) / focal_px;
                rays.push((Point3::origin(), Vector3::new(1.0, left, up).normalize()));
            }
        }
        Self { rows, columns, rays }
    }

    /// The same scanner with its rows, its columns or both in the other order, or transposed.
    pub fn reordered(&self, flip_rows: bool, flip_columns: bool, transpose: bool) -> Self {
        let (rows, columns) =
            if transpose { (self.columns, self.rows) } else { (self.rows, self.columns) };
        let mut rays = Vec::new();
        for i in 0..rows {
            for j in 0..columns {
                let (mut row, mut column) = if transpose { (j, i) } else { (i, j) };
                if flip_rows {
                    row = self.rows - 1 - row;
                }
                if flip_columns {
                    column = self.columns - 1 - column;
                }
                rays.push(self.rays[row * self.columns + column]);
            }
        }
        Self { rows, columns, rays }
    }
}

/// Noise of a scan.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    pub sigma_m: f64,
    /// Further noise in proportion to the range.
    pub relative: f64,
    pub dropouts: f64,
    pub max_range_m: f64,
}

impl Noise {
    pub fn of(sigma_m: f64) -> Self {
        Self { sigma_m, relative: 0.0, dropouts: 0.002, max_range_m: 20.0 }
    }

    pub fn sigma_at(&self, range: f64) -> f64 {
        self.sigma_m.hypot(self.relative * range)
    }
}

/// A scan with its truth.
#[derive(Clone, Debug)]
pub struct Scan {
    pub grid: PointGrid,
    /// Id of the surface that each cell hit, 0 for none.
    pub truth: Vec<usize>,
    pub pose: Isometry3<f64>,
    pub scanner: Scanner,
    pub ranges: Vec<f64>,
}

/// Scans a world from a pose.
pub fn scan(
    world: &World,
    pose: &Isometry3<f64>,
    scanner: &Scanner,
    noise: Noise,
    random: &mut Random,
) -> Scan {
    let mut points = Vec::new();
    let mut truth = Vec::new();
    let mut ranges = Vec::new();
    for (origin, ray) in &scanner.rays {
        let hit = world
            .trace(&(pose * origin), &(pose * ray))
            .filter(|hit| hit.0 <= noise.max_range_m && random.between(0.0, 1.0) >= noise.dropouts);
        let Some((range, id)) = hit else {
            points.push([f32::NAN; 3]);
            truth.push(0);
            ranges.push(f64::NAN);
            continue;
        };
        let measured = range + noise.sigma_at(range) * random.normal();
        let p = origin + ray * measured;
        points.push([p.x as f32, p.y as f32, p.z as f32]);
        truth.push(id);
        ranges.push(measured);
    }
    let grid = PointGrid::new(scanner.rows, scanner.columns, points);
    Scan { grid, truth, pose: *pose, scanner: scanner.clone(), ranges }
}

impl Scan {
    /// The best that a segmenter could do who knew all surfaces: each cell goes to the surface, out
    /// of those within one cell of it, that explains its range best.
    pub fn oracle(&self, world: &World) -> Vec<usize> {
        let (rows, columns) = (self.scanner.rows, self.scanner.columns);
        (0..rows * columns)
            .map(|cell| {
                if self.truth[cell] == 0 {
                    return 0;
                }
                let (row, column) = (cell / columns, cell % columns);
                let (origin, ray) = &self.scanner.rays[cell];
                let mut best = (f64::INFINITY, self.truth[cell]);
                for r in row.saturating_sub(1)..=(row + 1).min(rows - 1) {
                    for c in column.saturating_sub(1)..=(column + 1).min(columns - 1) {
                        let id = self.truth[r * columns + c];
                        if id == 0 {
                            continue;
                        }
                        let solid = &world.solids[id - 1];
                        let hit = solid.hit(&(self.pose * origin), &(self.pose * ray), true);
                        let error = hit.map_or(f64::INFINITY, |t| (t - self.ranges[cell]).abs());
                        if error < best.0 {
                            best = (error, id);
                        }
                    }
                }
                best.1
            })
            .collect()
    }
}
