//! Worlds for segmentation tests: analytic surfaces, traced exactly, with the truth beside the scan.
//!
//! Written apart from `usar_agent::sim`, on purpose: tests of the estimator need truth by surface,
//! and need it from code that shares nothing with what they test.

use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// A small seeded generator (SplitMix64).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in `[low, high)`.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub fn below(&mut self, count: usize) -> usize {
        (self.next() % count as u64) as usize
    }

    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.between(0.0, 1.0).max(1e-300).ln()).sqrt();
        radius * self.between(0.0, TAU).cos()
    }
}

/// Kind of a true surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    Plane,
    Cylinder,
    Sphere,
}

/// A true surface.
#[derive(Clone, Debug)]
pub enum Solid {
    /// A planar patch `origin + s u + t v`, `0 <= s, t <= 1`; half of it, `t <= s`, if `triangle`.
    Patch {
        origin: Point3<f64>,
        u: Vector3<f64>,
        v: Vector3<f64>,
        triangle: bool,
    },
    /// A disc.
    Disc {
        centre: Point3<f64>,
        normal: Vector3<f64>,
        radius: f64,
    },
    /// The side of a cylinder from `foot` along unit `axis` for `length`.
    Tube {
        foot: Point3<f64>,
        axis: Vector3<f64>,
        radius: f64,
        length: f64,
    },
    Ball {
        centre: Point3<f64>,
        radius: f64,
    },
}

impl Solid {
    pub fn kind(&self) -> Kind {
        match self {
            Solid::Patch { .. } | Solid::Disc { .. } => Kind::Plane,
            Solid::Tube { .. } => Kind::Cylinder,
            Solid::Ball { .. } => Kind::Sphere,
        }
    }

    /// Distance along the ray, unbounded (`infinite`) or of the solid itself.
    pub fn hit(&self, from: &Point3<f64>, ray: &Vector3<f64>, infinite: bool) -> Option<f64> {
        let near = |t: f64| t.is_finite() && t > 1e-3;
        match self {
            Solid::Patch { origin, u, v, triangle } => {
                let normal = u.cross(v);
                let t = (origin - from).dot(&normal) / ray.dot(&normal);
                let d = from + ray * t - origin;
                let (a, b) = (d.dot(u) / u.norm_squared(), d.dot(v) / v.norm_squared());
                let unit = 0.0..=1.0;
                let inside = unit.contains(&a) && unit.contains(&b) && !(*triangle && b > a);
                (near(t) && (infinite || inside)).then_some(t)
            }
            Solid::Disc { centre, normal, radius } => {
                let t = (centre - from).dot(normal) / ray.dot(normal);
                let inside = (from + ray * t - centre).norm() <= *radius;
                (near(t) && (infinite || inside)).then_some(t)
            }
            Solid::Tube { foot, axis, radius, length } => {
                let across = |v: Vector3<f64>| v - axis * axis.dot(&v);
                let (o, d) = (across(from - foot), across(*ray));
                let (a, b) = (d.norm_squared(), o.dot(&d));
                let root = b * b - a * (o.norm_squared() - radius * radius);
                // From within the ray meets the far side.
                let leaves = if o.norm_squared() < radius * radius { 1.0 } else { -1.0 };
                let t = (-b + leaves * root.sqrt()) / a;
                let height = axis.dot(&(from + ray * t - foot));
                (near(t) && (infinite || (0.0..=*length).contains(&height))).then_some(t)
            }
            Solid::Ball { centre, radius } => {
                let o = from - centre;
                let b = o.dot(ray);
                let root = b * b - (o.norm_squared() - radius * radius);
                let leaves = if o.norm_squared() < radius * radius { 1.0 } else { -1.0 };
                let t = -b + leaves * root.sqrt();
                near(t).then_some(t)
            }
        }
    }
}

/// True surfaces; a surface's id is its index plus one.
#[derive(Clone, Debug, Default)]
pub struct World {
    pub solids: Vec<Solid>,
}

impl World {
    pub fn patch(&mut self, origin: [f64; 3], u: [f64; 3], v: [f64; 3]) {
        let (u, v) = (Vector3::from(u), Vector3::from(v));
        self.solids.push(Solid::Patch { origin: Point3::from(origin), u, v, triangle: false });
    }

    /// A box: centre, size and orientation; its five sides above the ground and the one below.
    pub fn block(&mut self, pose: &Isometry3<f64>, size: [f64; 3]) {
        let size = Vector3::from(size);
        for axis in 0..3 {
            let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
            for side in [-0.5, 0.5] {
                let mut corner = -0.5 * size;
                corner[axis] = side * size[axis];
                let (mut u, mut v) = (Vector3::zeros(), Vector3::zeros());
                u[i] = size[i];
                v[j] = size[j];
                self.solids.push(Solid::Patch {
                    origin: pose * Point3::from(corner),
                    u: pose * u,
                    v: pose * v,
                    triangle: false,
                });
            }
        }
    }

    /// A box standing on the ground.
    pub fn standing(&mut self, x: f64, y: f64, size: [f64; 3], yaw: f64) {
        let pose = Isometry3::new(Vector3::new(x, y, 0.5 * size[2]), Vector3::z() * yaw);
        self.block(&pose, size);
    }

    /// A wedge that rises along its +x from the ground to `height`.
    pub fn ramp(&mut self, x: f64, y: f64, [length, width, height]: [f64; 3], yaw: f64) {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw);
        let (ex, ey, ez) = (turn * Vector3::x(), turn * Vector3::y(), Vector3::z());
        let origin = Point3::new(x, y, 0.0);
        let mut push = |origin, u, v, triangle| {
            self.solids.push(Solid::Patch { origin, u, v, triangle });
        };
        push(origin, ex * length + ez * height, ey * width, false);
        push(origin + ex * length, ey * width, ez * height, false);
        push(origin, ex * length, ez * height, true);
        push(origin + ey * width, ex * length, ez * height, true);
    }

    /// A cylinder with its two lids.
    pub fn drum(&mut self, foot: [f64; 3], axis: [f64; 3], radius: f64, length: f64) {
        let (foot, axis) = (Point3::from(foot), Vector3::from(axis).normalize());
        self.solids.push(Solid::Tube { foot, axis, radius, length });
        for centre in [foot, foot + axis * length] {
            self.solids.push(Solid::Disc { centre, normal: axis, radius });
        }
    }

    pub fn ball(&mut self, centre: [f64; 3], radius: f64) {
        self.solids.push(Solid::Ball { centre: Point3::from(centre), radius });
    }

    /// Floor and walls, and a ceiling if `height` is below 50 m.
    pub fn room(&mut self, [x0, y0, x1, y1]: [f64; 4], height: f64) {
        let (dx, dy, wall) = (x1 - x0, y1 - y0, height.min(4.0));
        self.patch([x0, y0, 0.0], [dx, 0.0, 0.0], [0.0, dy, 0.0]);
        if height < 50.0 {
            self.patch([x0, y0, height], [dx, 0.0, 0.0], [0.0, dy, 0.0]);
        }
        self.patch([x1, y0, 0.0], [0.0, dy, 0.0], [0.0, 0.0, wall]);
        self.patch([x0, y0, 0.0], [0.0, dy, 0.0], [0.0, 0.0, wall]);
        self.patch([x0, y1, 0.0], [dx, 0.0, 0.0], [0.0, 0.0, wall]);
        self.patch([x0, y0, 0.0], [dx, 0.0, 0.0], [0.0, 0.0, wall]);
    }

    /// The first surface along a ray: its distance and id.
    pub fn trace(&self, from: &Point3<f64>, ray: &Vector3<f64>) -> Option<(f64, usize)> {
        self.solids
            .iter()
            .enumerate()
            .filter_map(|(i, solid)| Some((solid.hit(from, ray, false)?, i + 1)))
            .min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// A pose from position and roll, pitch, yaw.
pub fn pose(position: [f64; 3], roll: f64, pitch: f64, yaw: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Vector3::from(position).into(),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}
