//! Headings that slip, robots that lean where odometry knows level ground only, and turns that lead to what looks
//! like what was seen before.

use super::real_scan::observed;
use super::slips::{HEIGHT_M, along, end_off_m};
use crate::segmentation::scanner::{Noise, Scanner, scan};
use crate::segmentation::world::{Random, World, pose};
use nalgebra::{Isometry3, Translation3, Vector3};
use usar_agent::mapping::perturbation::pose_error;
use usar_agent::mapping::{Mapper, MapperConfig, MotionSource};
use usar_agent::segmentation::{SegmentationConfig, Segmenter};

fn turn(degrees: f64) -> Isometry3<f64> {
    Isometry3::new(Vector3::zeros(), Vector3::z() * degrees.to_radians())
}

/// A room with things in it, and a way through it along an arc.
fn furnished() -> (World, Vec<(f64, f64, f64)>) {
    let mut world = World::default();
    world.room([-1.0, -3.0, 7.0, 4.0], 2.8);
    world.standing(3.2, -1.6, [0.8, 0.5, 0.9], 0.4);
    world.standing(5.6, 1.4, [0.6, 1.1, 0.7], -0.2);
    world.standing(1.2, 2.9, [1.4, 0.5, 1.9], 0.0);
    world.standing(4.6, 3.4, [0.5, 0.4, 1.2], 0.1);
    world.drum([2.6, 1.9, 0.0], [0.0, 0.0, 1.0], 0.25, 2.8);
    let way = (0..10).map(|step| {
        let heading_deg = 9.0 * f64::from(step);
        let (sin, cos) = heading_deg.to_radians().sin_cos();
        (2.6 * sin, 2.6 * (1.0 - cos) - 1.0, heading_deg)
    });
    (world, way.collect())
}

/// The wheels tell of a way and of a turn that was none, or the other way round; what there is to see where the
/// robot would look then was not seen before, so that nothing speaks against it.
#[test]
fn a_heading_that_slips_is_found() {
    let (world, way) = furnished();
    let seen = along(&world, &way);
    for degrees in [-120.0, -75.0, -50.0, 50.0, 60.0, 75.0, 130.0] {
        for at in 1..seen.len() {
            let off_m = end_off_m(&seen, at, &turn(degrees));
            assert!(off_m < 0.02, "{degrees}°, step {at}: {off_m} m off");
        }
    }
}

/// The same before the way: the robot drives elsewhere than the wheels tell.
#[test]
fn a_heading_that_slips_before_the_way_is_found() {
    let (world, way) = furnished();
    let seen = along(&world, &way);
    for degrees in [-75.0, 60.0, 75.0] {
        for at in 1..seen.len() {
            let motion = seen[at - 1].1.inverse() * seen[at].1;
            let slip = motion.inverse() * turn(degrees) * motion;
            let off_m = end_off_m(&seen, at, &slip);
            assert!(off_m < 0.02, "{degrees}°, step {at}: {off_m} m off");
        }
    }
}

/// Wheels count on level ground whatever it is: in one step the robot rolls or pitches by as much as a ramp, a
/// kerb under one wheel or a rut makes it.
#[test]
fn a_lean_that_odometry_knows_nothing_of_is_found() {
    let (world, way) = furnished();
    let scanner = Scanner::paper();
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    for (roll_deg, pitch_deg) in [(8.0, 0.0), (0.0, -10.0), (-12.0, 0.0), (7.0, 9.0)] {
        for at in [2, 5, 8] {
            let mut random = Random(3);
            let mut mapper: Option<Mapper> = None;
            for (step, &(x, y, yaw_deg)) in way.iter().enumerate() {
                let [roll, pitch] = if step == at { [roll_deg, pitch_deg] } else { [0.0; 2] };
                let stands = |[roll, pitch]: [f64; 2]| {
                    let [roll, pitch, yaw] = [roll, pitch, yaw_deg].map(f64::to_radians);
                    pose([x, y, HEIGHT_M], roll, pitch, yaw)
                };
                let (truth, level) = (stands([roll, pitch]), stands([0.0; 2]));
                let grid = scan(&world, &truth, &scanner, Noise::of(0.007), &mut random).grid;
                let seen = observed(&mut segmenter, &grid);
                if let (Some(mapper), Some(&(x, y, yaw_deg))) =
                    (&mut mapper, way.get(step.wrapping_sub(1)))
                {
                    let before = pose([x, y, HEIGHT_M], 0.0, 0.0, yaw_deg.to_radians());
                    mapper.predict(&(before.inverse() * level), MotionSource::Wheels);
                }
                let mapper =
                    mapper.get_or_insert_with(|| Mapper::new(MapperConfig::default(), truth));
                mapper.observe(&seen);
                let off = pose_error(&mapper.world_from_robot(), &truth);
                let (off_m, off_rad) =
                    (off.fixed_rows::<3>(0).norm(), off.fixed_rows::<3>(3).norm());
                assert!(
                    off_m < 0.01 && off_rad < 0.003,
                    "{roll_deg}°, {pitch_deg}° at {at}, scan {step}: {off_m} m, {off_rad} rad"
                );
            }
        }
    }
}

/// Where two corridors cross, `wide_m` from wall to wall, and all four arms are alike.
fn crossing(wide_m: f64, long_m: f64) -> World {
    let mut world = World::default();
    let half_m = 0.5 * wide_m;
    for yaw in [0.0, 0.5, 1.0, 1.5].map(|half_turns| half_turns * std::f64::consts::PI) {
        let arm = Isometry3::new(Vector3::zeros(), Vector3::z() * yaw);
        let mut patch = |at: [f64; 3], u: [f64; 3], v: [f64; 3]| {
            let turned = |axis: [f64; 3]| (arm.rotation * Vector3::from(axis)).into();
            world.patch(turned(at), turned(u), turned(v));
        };
        let (along, up) = ([long_m, 0.0, 0.0], [0.0, 0.0, 2.6]);
        for z in [0.0, 2.6] {
            patch([half_m, -half_m, z], along, [0.0, wide_m, 0.0]);
        }
        patch([half_m, half_m, 0.0], along, up);
        patch([half_m, -half_m, 0.0], along, up);
        patch([half_m + long_m, -half_m, 0.0], [0.0, wide_m, 0.0], up);
        // A door in the same place of each, that tells how far along it is.
        patch([half_m + 0.4 * long_m, half_m - 0.1, 0.0], [0.9, 0.0, 0.0], [0.0, 0.0, 2.0]);
    }
    for z in [0.0, 2.6] {
        world.patch([-half_m, -half_m, z], [wide_m, 0.0, 0.0], [0.0, wide_m, 0.0]);
    }
    world
}

/// A robot in the midst of a crossing turns, and what it sees then is what it saw before. Its wheels are right.
#[test]
fn a_turn_among_like_arms_is_believed() {
    for (wide_m, long_m) in [(1.6, 4.0), (2.2, 5.0), (3.0, 4.0), (4.0, 2.5)] {
        let world = crossing(wide_m, long_m);
        for turn_deg in [90.0, 180.0, -90.0] {
            let turned = turn(turn_deg);
            let mut way = vec![(-1.5, 0.02, 0.0), (-0.7, 0.01, 1.0), (0.0, 0.0, 0.0)];
            way.push((0.0, 0.0, turn_deg));
            way.extend([0.5, 1.1, 1.7].map(|x| {
                let at = turned * Translation3::new(x, 0.0, 0.0);
                (at.translation.x, at.translation.y, turn_deg + 1.0)
            }));
            let seen = along(&world, &way);
            let off_m = end_off_m(&seen, 0, &Isometry3::identity());
            assert!(off_m < 0.05, "{wide_m} m, {turn_deg}°: {off_m} m off");
        }
    }
}
