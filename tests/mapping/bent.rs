//! Surfaces that are no planes: scans of them, segmented, after odometry that is right.
//!
//! Facets of a bend lie where the sensor stands, so those of two scans look as if nothing had moved. Odometry
//! that is right must not be overruled by them.

use super::real_scan::observed;
use crate::segmentation::scanner::{Noise, Scanner, scan};
use crate::segmentation::world::{Random, Solid, World};
use nalgebra::{Isometry3, Point3, Vector3};
use usar_agent::mapping::perturbation::pose_error;
use usar_agent::mapping::{Mapper, MapperConfig, MotionSource};
use usar_agent::segmentation::{SegmentationConfig, Segmenter};

/// Greatest errors on a way, in metres and radians, with odometry that is exact.
fn greatest_errors(world: &World, way: &[Isometry3<f64>], scanner: &Scanner) -> (f64, f64) {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let mut random = Random(0xBE27);
    let mut mapper = Mapper::new(MapperConfig::default(), way[0]);
    let (mut farthest_m, mut farthest_rad) = (0.0_f64, 0.0_f64);
    for (k, pose) in way.iter().enumerate() {
        if k > 0 {
            mapper.predict(&(way[k - 1].inverse() * pose), MotionSource::Wheels);
        }
        let scan = scan(world, pose, scanner, Noise::of(0.01), &mut random);
        mapper.observe(&observed(&mut segmenter, &scan.grid));
        let error = pose_error(&mapper.world_from_robot(), pose);
        farthest_m = farthest_m.max(error.fixed_rows::<3>(0).norm());
        farthest_rad = farthest_rad.max(error.fixed_rows::<3>(3).norm());
    }
    (farthest_m, farthest_rad)
}

fn coarse() -> Scanner {
    Scanner::nodding(110, 66, [-25.0, 29.75], [65.0, -65.0], [0.0, 0.0])
}

fn floor_and_ceiling(half_m: f64, height_m: f64) -> World {
    let mut world = World::default();
    for z in [0.0, height_m] {
        let size = 2.0 * half_m;
        world.patch([-half_m, -half_m, z], [size, 0.0, 0.0], [0.0, size, 0.0]);
    }
    world
}

fn at(x: f64, y: f64, yaw: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::new(x, y, 0.6), Vector3::z() * yaw)
}

/// Twenty planes where the wall was cut took the robot metres along with them; a floor and a ceiling, each
/// linearised a little off, turned it by 30° by themselves.
#[test]
fn a_round_room_leaves_the_heading_to_odometry() {
    let mut world = floor_and_ceiling(8.0, 3.0);
    let (foot, axis) = (Point3::new(0.0, 0.0, 0.0), Vector3::z());
    world.solids.push(Solid::Tube { foot, axis, radius: 8.0, length: 3.0 });
    let way: Vec<Isometry3<f64>> = (0..24)
        .map(|k| 10_f64.to_radians() * f64::from(k))
        .map(|a| at(3.0 * a.cos(), 3.0 * a.sin(), a + std::f64::consts::FRAC_PI_2))
        .collect();
    let (off_m, off_rad) = greatest_errors(&world, &way, &coarse());
    assert!(off_m < 0.1 && off_rad < 0.03, "{off_m} m, {off_rad} rad");
}

/// A corridor that bends by a radius of 100 m: facets, not cylinders. They took the robot 5.3 m back in 7.5 m.
#[test]
fn a_corridor_that_bends_does_not_hold_the_robot_back() {
    let radius = 100.0;
    let mut world = floor_and_ceiling(120.0, 2.6);
    let (foot, axis) = (Point3::new(0.0, 0.0, 0.0), Vector3::z());
    // The inner wall is seen from without; the outer one is made of chords, a hand's breadth each.
    world.solids.push(Solid::Tube { foot, axis, radius: radius - 1.0, length: 2.6 });
    let edge = |k: i32| {
        let a = 0.1 * f64::from(k) / radius;
        [(radius + 1.0) * a.cos(), (radius + 1.0) * a.sin()]
    };
    for k in -60..400 {
        let ([x0, y0], [x1, y1]) = (edge(k), edge(k + 1));
        world.patch([x0, y0, 0.0], [x1 - x0, y1 - y0, 0.0], [0.0, 0.0, 2.6]);
    }
    let way: Vec<Isometry3<f64>> = (0..16)
        .map(|k| 0.5 * f64::from(k) / radius)
        .map(|a| at(radius * a.cos(), radius * a.sin(), a + std::f64::consts::FRAC_PI_2))
        .collect();
    let (off_m, _) = greatest_errors(&world, &way, &coarse());
    assert!(off_m < 0.25, "{off_m} m");
}

/// Panels whose joints are 2 mm off a plane: pieces of them, cut where noise had it, took the robot half a metre back.
#[test]
fn a_corridor_of_uneven_panels_does_not_hold_the_robot_back() {
    let mut world = World::default();
    for z in [0.0, 2.6] {
        world.patch([-5.0, -2.0, z], [45.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    }
    let mut random = Random(3);
    for side in [-1.0, 1.0] {
        let mut y = side * (1.0 + 0.002 * random.normal());
        for k in 0..32 {
            let (x, next) = (-5.0 + 1.25 * f64::from(k), side * (1.0 + 0.002 * random.normal()));
            world.patch([x, y, 0.0], [1.25, next - y, 0.0], [0.0, 0.0, 2.6]);
            y = next;
        }
    }
    let way: Vec<Isometry3<f64>> = (0..25)
        .map(f64::from)
        .map(|k| at(0.5 * k, 0.05 * k.sin(), 0.05 * (0.8 * k).sin()))
        .collect();
    let (off_m, off_rad) = greatest_errors(&world, &way, &Scanner::paper());
    assert!(off_m < 0.1 && off_rad < 0.01, "{off_m} m, {off_rad} rad");
}
