//! Wheels that slip once, by as much as the world repeats itself by: the treads of a stair, the doors of a
//! corridor; and robots that are carried back to where they were. The scans are cast, for what a surface shows
//! of itself decides what it may be taken for.

use super::real_scan::observed;
use super::world::{rng, uniform};
use crate::segmentation::scanner::{Noise, Scanner, scan};
use crate::segmentation::world::{Random, World, pose};
use nalgebra::{Isometry3, Translation3};
use usar_agent::mapping::perturbation::pose_error;
use usar_agent::mapping::{Landmark, Mapper, MapperConfig, MotionSource, ScanObservations};
use usar_agent::segmentation::{SegmentationConfig, Segmenter};

pub(super) const HEIGHT_M: f64 = 0.6;

/// A stair up to a landing, in a hall.
fn stair(tread_m: f64) -> World {
    let mut world = World::default();
    world.room([-2.5, -2.2, 9.5, 2.8], 3.2);
    for step in 0..7 {
        let (x, z) = (3.2 + tread_m * f64::from(step), 0.16 * f64::from(step));
        let tread_m = if step < 6 { tread_m } else { 1.8 };
        world.patch([x, -0.9, z], [0.0, 1.7, 0.0], [0.0, 0.0, 0.16]);
        world.patch([x, -0.9, z + 0.16], [tread_m, 0.0, 0.0], [0.0, 1.7, 0.0]);
    }
    world
}

/// A corridor with recessed doors on both sides, all alike, and a cupboard.
fn corridor() -> World {
    let (mut world, half_m, recess_m, height_m) = (World::default(), 1.1, 0.2, 2.4);
    world.patch([-3.0, -1.3, 0.0], [15.0, 0.0, 0.0], [0.0, 2.6, 0.0]);
    world.patch([-3.0, -1.3, height_m], [15.0, 0.0, 0.0], [0.0, 2.6, 0.0]);
    for end in [-3.0, 12.0] {
        world.patch([end, -1.3, 0.0], [0.0, 2.6, 0.0], [0.0, 0.0, height_m]);
    }
    let up = [0.0, 0.0, height_m];
    for (door, side) in (0..6).flat_map(|door| [(door, 1.0), (door, -1.0)]) {
        let x = -3.0 + 2.5 * f64::from(door);
        world.patch([x, side * half_m, 0.0], [1.6, 0.0, 0.0], up);
        world.patch([x + 1.6, side * (half_m + recess_m), 0.0], [0.9, 0.0, 0.0], up);
        for jamb in [x + 1.6, x + 2.5] {
            world.patch([jamb, side * half_m, 0.0], [0.0, side * recess_m, 0.0], up);
        }
    }
    world.standing(7.4, 0.8, [0.5, 0.4, 1.2], 0.0);
    world
}

/// What a robot sees, and from where.
pub(super) type Seen = (ScanObservations, Isometry3<f64>);

/// What a robot sees along a way, and its true poses.
pub(super) fn along(world: &World, way: &[(f64, f64, f64)]) -> Vec<Seen> {
    let scanner = Scanner::paper();
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let mut random = Random(7);
    let mut see = |&(x, y, yaw_deg): &(f64, f64, f64)| {
        let at = pose([x, y, HEIGHT_M], 0.0, 0.0, f64::to_radians(yaw_deg));
        let grid = scan(world, &at, &scanner, Noise::of(0.007), &mut random).grid;
        (observed(&mut segmenter, &grid), at)
    };
    way.iter().map(&mut see).collect()
}

/// A slip over the ground.
fn by([x, y]: [f64; 2]) -> Isometry3<f64> {
    Isometry3::translation(x, y, 0.0)
}

/// How far off the end of a way is when wheels are right to a few millimetres but for a slip in one step.
pub(super) fn end_off_m(seen: &[Seen], at: usize, slip: &Isometry3<f64>) -> f64 {
    let mut rng = rng(at as u64);
    let mut mapper = Mapper::new(MapperConfig::default(), seen[0].1);
    mapper.observe(&seen[0].0);
    for (step, pair) in seen.windows(2).enumerate() {
        let slipped = if step + 1 == at { *slip } else { Isometry3::identity() };
        let mut stray = || 0.006 * (uniform(&mut rng) - 0.5);
        let error = Translation3::new(stray(), stray(), 0.0) * slipped;
        mapper.predict(&(pair[0].1.inverse() * pair[1].1 * error), MotionSource::Wheels);
        mapper.observe(&pair[1].0);
    }
    let end = seen.last().expect("a way has an end").1;
    pose_error(&mapper.world_from_robot(), &end).fixed_rows::<3>(0).norm()
}

/// Ends of all ways with one slip of `slip_m` that are off by more than 5 cm: the step and the direction.
/// What is seen after the last step cannot mend anything, and little speaks against what it says alone.
fn astray(seen: &[Seen], slip_m: f64) -> Vec<(usize, [f64; 2], f64)> {
    let directions = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];
    let slips = directions.map(|way| way.map(|axis| slip_m * axis));
    let ways = (1..seen.len() - 1).flat_map(|at| slips.map(|slip| (at, slip)));
    let ends = ways.map(|(at, slip)| (at, slip, end_off_m(seen, at, &by(slip))));
    ends.filter(|end| end.2 > 0.05).collect()
}

#[test]
fn a_slip_by_a_tread_along_a_stair_is_found() {
    let tread_m = 0.28;
    let way = [
        (-1.4, 0.1, 0.0),
        (-0.9, 0.1, 6.0),
        (-0.4, 0.2, -5.0),
        (0.2, 0.1, 3.0),
        (0.7, 0.1, -8.0),
        (1.2, 0.0, 5.0),
        (0.8, 0.0, -12.0),
    ];
    let seen = along(&stair(tread_m), &way);
    for slip_m in [tread_m, 0.7 * tread_m, 2.0 * tread_m] {
        let astray = astray(&seen, slip_m);
        assert!(astray.is_empty(), "{slip_m}: {astray:?}");
    }
}

#[test]
fn odometry_that_leaps_by_hundreds_of_metres_loses_no_pose_before_it() {
    let seen = along(
        &stair(0.28),
        &[(-1.4, 0.1, 0.0), (-0.9, 0.1, 6.0), (-0.4, 0.2, -5.0), (0.2, 0.1, 3.0)],
    );
    for leap_m in [30.0, 600.0, 1000.0] {
        let mut mapper = Mapper::new(MapperConfig::default(), seen[0].1);
        mapper.observe(&seen[0].0);
        for (step, pair) in seen.windows(2).enumerate() {
            let leap = Translation3::new(if step == 1 { leap_m } else { 0.0 }, 0.0, 0.0);
            mapper.predict(&(pair[0].1.inverse() * pair[1].1 * leap), MotionSource::Wheels);
            mapper.observe(&pair[1].0);
        }
        let poses = mapper.keyframes();
        let is_told = |pose: &Isometry3<f64>| pose.to_homogeneous().iter().all(|x| x.is_finite());
        assert!(poses.len() == 4 && poses.iter().all(is_told), "{leap_m}: {poses:?}");
        let off_m = pose_error(&poses[1], &seen[1].1).fixed_rows::<3>(0).norm();
        assert!(off_m < 0.01, "{leap_m}: {off_m} m");
    }
}

/// A hall with a stair, shelves and tables, and a robot that turns its side to the stair.
#[test]
fn a_slip_beside_a_stair_is_found() {
    let mut world = World::default();
    world.room([0.0, -4.0, 12.0, 4.0], 5.0);
    for step in 0..12 {
        let (x, z) = (6.0 + 0.28 * f64::from(step), 0.17 * f64::from(step));
        world.patch([x, 0.0, z], [0.0, 2.0, 0.0], [0.0, 0.0, 0.17]);
        world.patch([x, 0.0, z + 0.17], [0.28, 0.0, 0.0], [0.0, 2.0, 0.0]);
    }
    for board in 0..4 {
        let z = 0.4 + 0.45 * f64::from(board);
        world.block(&pose([3.0, -3.6, z + 0.015], 0.0, 0.0, 0.0), [2.4, 0.5, 0.03]);
    }
    for table in 0..3 {
        let x = 8.0 + 1.3 * f64::from(table);
        world.block(&pose([x, -2.5, 0.74], 0.0, 0.0, 0.0), [0.9, 0.7, 0.04]);
    }
    world.standing(4.2, 2.8, [0.8, 0.8, 0.9], 1.05);
    let ahead = (0..10).map(|k| (1.0 + 0.389 * f64::from(k), 1.0, 0.0));
    let turned = (1..5).map(|k| (4.5, 1.0, -22.5 * f64::from(k)));
    let aside = (1..8).map(|k| (4.5, 1.0 - 0.357 * f64::from(k), -90.0));
    let seen = along(&world, &ahead.chain(turned).chain(aside).collect::<Vec<_>>());
    for at in 14..18 {
        for slip in [[0.28, 0.0], [-0.28, 0.0], [-0.6, 0.0], [0.0, 0.28]] {
            let off_m = end_off_m(&seen, at, &by(slip));
            assert!(off_m < 0.05, "{slip:?} at {at}: {off_m} m");
        }
    }
}

/// As many faces of equal boxes fit one box farther on; that the last ones are missing there tells.
#[test]
fn a_slip_along_an_aisle_of_equal_boxes_is_found() {
    let mut world = World::default();
    world.room([0.0, -3.0, 16.0, 3.0], 3.5);
    for (k, y) in (0..11).flat_map(|k| [(k, 1.7), (k, -1.7)]) {
        world.standing(2.5 + 1.1 * f64::from(k), y, [0.6, 0.6, 0.9], 0.0);
    }
    let way: Vec<_> = (0..9).map(|k| (1.0 + 0.45 * f64::from(k), 0.0, 0.0)).collect();
    let seen = along(&world, &way);
    for at in 3..7 {
        for slip_m in [-0.7, 0.4, 0.55] {
            let off_m = end_off_m(&seen, at, &by([slip_m, 0.0]));
            assert!(off_m < 0.05, "{slip_m} m at {at}: {off_m} m");
        }
    }
}

#[test]
fn a_slip_along_a_corridor_of_equal_doors_is_found() {
    let way = [0.0, 0.7, 1.4, 2.1, 2.8, 3.5, 4.2].map(|x| (x, 0.1, 2.0 * x - 4.0));
    let seen = along(&corridor(), &way);
    let astray = astray(&seen, 0.3);
    assert!(astray.is_empty(), "{astray:?}");
}

/// A bare ring of corridors round a block.
fn ring() -> World {
    let mut world = World::default();
    world.room([-1.5, -1.5, 14.5, 9.5], 2.6);
    let corners = [[1.5, 1.2], [11.5, 1.2], [11.5, 6.8], [1.5, 6.8]];
    for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        world.patch(
            [from[0], from[1], 0.0],
            [to[0] - from[0], to[1] - from[1], 0.0],
            [0.0, 0.0, 2.6],
        );
    }
    world.standing(6.0, -1.2, [0.5, 0.4, 1.0], 0.0);
    world
}

/// A scan that was found where it fits stays there, though the next motion agrees better with where odometry
/// had it.
#[test]
fn odometry_that_errs_to_and_fro_takes_no_scan_from_where_it_fits() {
    let seen = along(&ring(), &[0.0, 1.0, 2.0].map(|x| (x, 0.0, 0.0)));
    let told =
        |x: f64, y: f64, yaw_deg: f64| pose([x, y, HEIGHT_M], 0.0, 0.0, yaw_deg.to_radians());
    for aside in [-1.0, 1.0] {
        for err_m in [0.25, 0.3, 0.35, 0.4] {
            let way = [
                told(0.0, 0.0, 0.0),
                told(0.97, aside * err_m, -aside * 5.4),
                told(1.8, -aside * 0.66 * err_m, aside * 3.4),
            ];
            let mut mapper = Mapper::new(MapperConfig::default(), seen[0].1);
            mapper.observe(&seen[0].0);
            for (step, pair) in way.windows(2).enumerate() {
                mapper.predict(&(pair[0].inverse() * pair[1]), MotionSource::Wheels);
                mapper.observe(&seen[step + 1].0);
            }
            for (keyframe, (_, truth)) in mapper.keyframes().iter().zip(&seen) {
                let off_m = pose_error(keyframe, truth).fixed_rows::<3>(0).norm();
                assert!(off_m < 0.02, "{err_m} m to {aside}: {off_m} m off");
            }
        }
    }
}

/// Where odometry tells of a step of 0.3 m the robot is carried to where it was before, and goes on.
#[test]
fn a_robot_that_is_carried_back_is_known_where_it_is_set_down() {
    let way = [-1.4, -0.9, -0.4, 0.1, 0.7, 1.2, 1.7, 2.1].map(|x| (x, 0.1, 4.0 * x));
    let seen = along(&stair(0.28), &way);
    // From farther on, where only treads are near, a tread beside itself fits as well.
    let last = seen.len() - 1;
    for back in 0..4 {
        let mut mapper = Mapper::new(MapperConfig::default(), seen[0].1);
        mapper.observe(&seen[0].0);
        let steps = (1..seen.len()).map(|to| (to - 1, to)).chain([(last, back), (back, back + 1)]);
        for (from, to) in steps {
            let motion = seen[from].1.inverse() * seen[to].1;
            let is_carried = from == last;
            let told = if is_carried { Isometry3::translation(0.3, 0.0, 0.0) } else { motion };
            mapper.predict(&told, MotionSource::Wheels);
            mapper.observe(&seen[to].0);
        }
        let off = pose_error(&mapper.world_from_robot(), &seen[back + 1].1);
        assert!(off.fixed_rows::<3>(0).norm() < 0.02, "back to {back}: {off}");
    }
}

/// From afar a plank is part of the floor that it lies on; from near it is a surface of its own, as near to that
/// floor as wheels leave the height open.
#[test]
fn a_floor_is_not_taken_for_the_plank_on_it() {
    let scanner = Scanner::paper();
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    for (plank, size, back_m) in [
        ([1.7, 0.4], [0.5, 1.6, 0.018], 1.5),
        ([1.5, 0.4], [0.3, 1.0, 0.015], 4.5),
        ([1.5, 0.4], [0.3, 1.0, 0.03], 2.5),
        ([1.7, 0.4], [0.5, 1.6, 0.04], 3.6),
        ([1.7, 0.4], [0.5, 1.6, 0.08], 3.6),
    ] {
        let mut world = World::default();
        world.room([-7.0, -4.0, 6.0, 4.0], 60.0);
        world.standing(plank[0], plank[1], size, 0.3);
        world.standing(2.6, -1.6, [0.8, 0.6, 0.9], 0.3);
        let mut random = Random(5);
        let mut see = |x: f64, y: f64, yaw_rad: f64| {
            let at = pose([x, y, HEIGHT_M], 0.0, 0.0, yaw_rad);
            let grid = scan(&world, &at, &scanner, Noise::of(0.002), &mut random).grid;
            (observed(&mut segmenter, &grid), at)
        };
        let (near, far) = (see(0.0, 0.0, 0.0), see(-back_m, 0.2, 0.05));
        for up in [-0.5, 0.5, 0.8, 1.0, 1.2] {
            let up_m = up * size[2];
            let mut mapper = Mapper::new(MapperConfig::default(), near.1);
            mapper.observe(&near.0);
            let is_plank =
                |it: &Landmark| it.normal().z > 0.9 && (it.origin().z - size[2]).abs() < 0.003;
            assert!(mapper.landmarks().iter().any(is_plank), "the plank is mapped");
            let error = Translation3::new(0.002, -0.003, up_m);
            mapper.predict(&(near.1.inverse() * far.1 * error), MotionSource::Wheels);
            mapper.observe(&far.0);
            let off_m = mapper.world_from_robot().translation.z - far.1.translation.z;
            assert!(off_m.abs() < 0.004, "{size:?}, {up_m}: {off_m} m");
        }
    }
}
