//! The shapes a world is made of: exact ray intersections, and their twins for contact.
//!
//! Boxes, wedges, cylinders and spheres are intersected in closed form here. The library's own ray
//! cast on cylinders and convex hulls iterates to a tolerance, which a simulated laser would show.

use super::glam;
use nalgebra::{Point3, Vector3};
use parry3d_f64::query::{Ray, RayCast};
use parry3d_f64::shape::{SharedShape, TriMesh};
use rapier3d_f64::math::{Pose, Rotation, Vector};
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

/// A shape in its own frame, centred on the origin.
#[derive(Clone, Debug)]
pub enum Solid {
    /// A box by its half extents in metres.
    Box(Vector3<f64>),
    /// A ramp that fills the lower half of a box with these half extents and rises along +x.
    Wedge(Vector3<f64>),
    /// A cylinder along z.
    Cylinder {
        /// Radius in metres.
        radius_m: f64,
        /// Half of the height in metres.
        half_height_m: f64,
    },
    /// A ball by its radius in metres.
    Sphere(f64),
    /// Triangles, hit from both sides.
    Mesh(Arc<TriMesh>),
}

/// A crossing of a ray with a surface: distance along the ray and the surface's outward normal.
pub type Crossing = (f64, Vector3<f64>);

/// Below this component a direction counts as parallel to a plane.
const PARALLEL: f64 = 1e-12;

impl Solid {
    /// The first crossing within `max_m` of a ray of unit direction, in the solid's frame.
    ///
    /// From within a solid the crossing is at distance 0 and its normal is against the ray.
    pub fn cast(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        max_m: f64,
    ) -> Option<Crossing> {
        if let Self::Mesh(mesh) = self {
            let ray = Ray::new(glam::point(origin), glam::vector(direction));
            let hit = mesh.cast_local_ray_and_get_normal(&ray, max_m, true)?;
            let normal = glam::from_vector(hit.normal);
            // A triangle has two faces; the one that was hit looks against the ray.
            let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
            return Some((hit.time_of_impact, normal));
        }
        let [entry, exit] = self.interval(origin, direction)?;
        if exit.0 < 0.0 || entry.0 > max_m {
            None
        } else if entry.0 < 0.0 {
            Some((0.0, -direction))
        } else {
            Some(entry)
        }
    }

    /// Where a whole line enters and leaves a convex solid; `None` for a miss and for meshes.
    pub fn interval(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
    ) -> Option<[Crossing; 2]> {
        match self {
            Self::Box(half) => clip(&box_planes(half), origin, direction),
            Self::Wedge(half) => {
                let mut planes = box_planes(half).to_vec();
                planes.push(wedge_slope(half));
                clip(&planes, origin, direction)
            }
            Self::Cylinder { radius_m, half_height_m } => {
                let caps = [(Vector3::z(), *half_height_m), (-Vector3::z(), *half_height_m)];
                let side = quadric_interval(origin, direction, *radius_m, 2)?;
                intersect(side, clip_or_all(&caps, origin, direction)?)
            }
            Self::Sphere(radius_m) => quadric_interval(origin, direction, *radius_m, 3),
            Self::Mesh(_) => None,
        }
    }

    /// The shape for the physics library, with its pose in the solid's frame.
    pub(crate) fn contact_shape(&self) -> (SharedShape, Pose) {
        let here = Pose::identity();
        match self {
            Self::Box(half) => (SharedShape::cuboid(half.x, half.y, half.z), here),
            Self::Wedge(half) => {
                let corners: Vec<Vector> = wedge_corners(half).iter().map(glam::vector).collect();
                let hull = SharedShape::convex_hull(&corners)
                    .expect("six corners of a wedge with positive extents span a volume");
                (hull, here)
            }
            Self::Cylinder { radius_m, half_height_m } => {
                // The library's cylinders stand along y.
                let upright = Rotation::from_axis_angle(Vector::X, FRAC_PI_2);
                (SharedShape::cylinder(*half_height_m, *radius_m), Pose::from_rotation(upright))
            }
            Self::Sphere(radius_m) => (SharedShape::ball(*radius_m), here),
            Self::Mesh(mesh) => (SharedShape(mesh.clone()), here),
        }
    }
}

/// The corners of a wedge: four at the bottom, two at the top of its +x end.
pub(crate) fn wedge_corners(half: &Vector3<f64>) -> [Vector3<f64>; 6] {
    let [x, y, z] = [half.x, half.y, half.z];
    [
        Vector3::new(-x, -y, -z),
        Vector3::new(-x, y, -z),
        Vector3::new(x, -y, -z),
        Vector3::new(x, y, -z),
        Vector3::new(x, -y, z),
        Vector3::new(x, y, z),
    ]
}

type Face = (Vector3<f64>, f64);

fn box_planes(half: &Vector3<f64>) -> [Face; 6] {
    [
        (Vector3::x(), half.x),
        (-Vector3::x(), half.x),
        (Vector3::y(), half.y),
        (-Vector3::y(), half.y),
        (Vector3::z(), half.z),
        (-Vector3::z(), half.z),
    ]
}

fn wedge_slope(half: &Vector3<f64>) -> Face {
    // Through the whole lower -x edge and the upper +x edge, which is through the centre.
    (Vector3::new(-half.z, 0.0, half.x).normalize(), 0.0)
}

/// The part of a line behind every face, as entry and exit.
fn clip(faces: &[Face], origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<[Crossing; 2]> {
    clip_or_all(faces, origin, direction)
}

fn clip_or_all(
    faces: &[Face],
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
) -> Option<[Crossing; 2]> {
    let mut entry = (f64::NEG_INFINITY, -direction);
    let mut exit = (f64::INFINITY, *direction);
    for (normal, offset) in faces {
        let height = normal.dot(&origin.coords) - offset;
        let slope = normal.dot(direction);
        if slope.abs() < PARALLEL {
            if height > 0.0 {
                return None;
            }
        } else if slope < 0.0 {
            let at = -height / slope;
            if at > entry.0 {
                entry = (at, *normal);
            }
        } else {
            let at = -height / slope;
            if at < exit.0 {
                exit = (at, *normal);
            }
        }
    }
    (entry.0 <= exit.0).then_some([entry, exit])
}

fn intersect(a: [Crossing; 2], b: [Crossing; 2]) -> Option<[Crossing; 2]> {
    let entry = if a[0].0 >= b[0].0 { a[0] } else { b[0] };
    let exit = if a[1].0 <= b[1].0 { a[1] } else { b[1] };
    (entry.0 <= exit.0).then_some([entry, exit])
}

/// The part of a line within a sphere (3 `dimensions`) or an endless cylinder along z (2).
fn quadric_interval(
    origin: &Point3<f64>,
    direction: &Vector3<f64>,
    radius: f64,
    dimensions: usize,
) -> Option<[Crossing; 2]> {
    let flat = |v: &Vector3<f64>| {
        let mut v = *v;
        if dimensions == 2 {
            v.z = 0.0;
        }
        v
    };
    let (o, d) = (flat(&origin.coords), flat(direction));
    let a = d.norm_squared();
    if a < PARALLEL * PARALLEL {
        let whole = [(f64::NEG_INFINITY, -direction), (f64::INFINITY, *direction)];
        return (o.norm_squared() <= radius * radius).then_some(whole);
    }
    // The foot of the perpendicular first: the discriminant of the textbook form loses digits when
    // the origin is many radii away.
    let foot = -o.dot(&d) / a;
    let miss = o + d * foot;
    let inside = radius * radius - miss.norm_squared();
    if inside < 0.0 {
        return None;
    }
    let half_chord = (inside / a).sqrt();
    let at = |t: f64| (t, (o + d * t) / radius);
    Some([at(foot - half_chord), at(foot + half_chord)])
}

#[cfg(test)]
mod tests {
    use super::super::noise::Noise;
    use super::*;

    fn solids() -> Vec<Solid> {
        vec![
            Solid::Box(Vector3::new(1.0, 0.5, 0.3)),
            Solid::Wedge(Vector3::new(1.0, 0.7, 0.4)),
            Solid::Cylinder { radius_m: 0.6, half_height_m: 0.9 },
            Solid::Sphere(0.8),
        ]
    }

    fn random_unit(noise: &mut Noise) -> Vector3<f64> {
        Vector3::new(noise.normal(), noise.normal(), noise.normal()).normalize()
    }

    #[test]
    fn crossings_agree_with_the_physics_library() {
        let mut noise = Noise::new(11, 0);
        for solid in solids() {
            let (shape, offset) = solid.contact_shape();
            let (mut hits, mut disputed) = (0, 0);
            for _ in 0..2000 {
                let origin = Point3::from(random_unit(&mut noise) * 3.0);
                let aim = Vector3::new(noise.normal(), noise.normal(), noise.normal()) * 0.5;
                let direction = (aim - origin.coords).normalize();
                let ours = solid.cast(&origin, &direction, 20.0);
                let ray = Ray::new(glam::point(&origin), glam::vector(&direction));
                let theirs = shape.cast_ray_and_get_normal(&offset, &ray, 20.0, true);
                match (ours, theirs) {
                    (Some((range, normal)), Some(hit)) => {
                        hits += 1;
                        let grazing = normal.dot(&direction).abs() < 0.02;
                        let gap = (range - hit.time_of_impact).abs();
                        assert!(grazing || gap < 1e-5, "{solid:?}: {range} {gap}");
                    }
                    (None, None) => {}
                    // The library's iteration loses or finds a ray that grazes an edge.
                    _ => disputed += 1,
                }
            }
            assert!(disputed <= 4, "{solid:?}: {disputed} rays hit one caster only");
            assert!(hits > 500, "{solid:?} was hit {hits} times only");
        }
    }

    #[test]
    fn normals_point_outwards_and_points_lie_on_the_surface() {
        let mut noise = Noise::new(5, 0);
        for solid in solids() {
            for _ in 0..500 {
                let origin = Point3::from(random_unit(&mut noise) * 4.0);
                let direction = (-origin.coords + random_unit(&mut noise) * 0.3).normalize();
                let Some((range, normal)) = solid.cast(&origin, &direction, 20.0) else { continue };
                assert!(normal.dot(&direction) <= 1e-9);
                assert!((normal.norm() - 1.0).abs() < 1e-9);
                let on_surface = origin + direction * range;
                let out = solid.interval(&(on_surface + normal * 1e-6), &normal);
                assert!(out.is_none_or(|[_, exit]| exit.0 < 1e-9), "{solid:?}");
            }
        }
    }

    #[test]
    fn a_ray_from_within_a_solid_hits_at_once() {
        for solid in solids() {
            let hit = solid.cast(&Point3::new(0.1, 0.0, -0.05), &Vector3::y(), 10.0);
            assert_eq!(hit, Some((0.0, -Vector3::y())), "{solid:?}");
        }
    }
}
