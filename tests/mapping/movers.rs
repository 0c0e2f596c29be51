//! Things that move while the robot does.

use super::drive::{Drive, step};
use super::world::World;
use nalgebra::{Isometry3, Vector6};
use usar_agent::mapping::{MapperConfig, OdometryNoise};

/// A corridor without an end in sight, and a cart in it whose near face is so far along it.
fn corridor(cart_m: f64, end_m: f64) -> World {
    let mut world = World::default();
    world.room((-4.0, end_m), (-1.2, 1.2), 2.5);
    world.block((cart_m + 0.4, 0.3), (0.8, 0.6, 0.9), 0.0);
    world
}

/// How far off the robot ends that drives 0.4 m at a time while the cart is where `cart_m` has it.
fn drive(cart_m: impl Fn(usize) -> f64, end_m: f64, step_m: f64) -> f64 {
    let worlds: Vec<World> = (0..16).map(|scan| corridor(cart_m(scan), end_m)).collect();
    let config = MapperConfig::default();
    let mut drive = Drive::begin(&worlds[0], config, Isometry3::identity(), 5);
    for world in &worlds[1..] {
        drive.world = world;
        drive.go(&step(step_m, 0.0, 0.0), &OdometryNoise::default());
    }
    drive.error().0
}

/// All faces of a cart agree with a robot that slips as fast as the cart drives; nothing else tells of the way
/// along a corridor but odometry, which then is what errs least.
#[test]
fn a_cart_that_drives_ahead_does_not_take_the_robot_along() {
    // Odometry alone errs by some centimetres in 6 m.
    let alike = drive(|scan| 2.0 + 0.4 * scan as f64, 60.0, 0.4);
    let started = drive(|scan| 3.0 + 0.4 * scan.saturating_sub(4) as f64, 60.0, 0.4);
    let slower = drive(|scan| 2.0 + 0.2 * scan as f64, 60.0, 0.4);
    assert!(alike < 0.3 && started < 0.3 && slower < 0.3, "{alike} {started} {slower} m");
}

/// The corridor's end is seen, which no cart outweighs.
#[test]
fn a_cart_before_the_end_of_a_corridor_leaves_the_robot_where_the_end_has_it() {
    let off_m = drive(|scan| 2.0 + 0.4 * scan as f64, 13.0, 0.4);
    assert!(off_m < 0.01, "{off_m} m");
}

/// What has moved is let go: nothing stands where it was.
#[test]
fn what_has_moved_is_no_part_of_the_map_any_more() {
    let worlds = [corridor(2.0, 13.0), corridor(2.5, 13.0)];
    let mut drive = Drive::begin(&worlds[0], MapperConfig::default(), Isometry3::identity(), 5);
    drive.world = &worlds[1];
    drive.slide(&step(0.4, 0.0, 0.0), &Vector6::zeros());
    drive.look();
    let at = |m: f64| {
        let landmarks = drive.mapper.landmarks().iter();
        let mut fronts = landmarks.filter(|landmark| {
            !landmark.gone && landmark.normal().x < -0.9 && (landmark.origin().x - m).abs() < 0.05
        });
        fronts.next().is_some()
    };
    assert!(!at(2.0) && at(2.5));
}

/// Four rooms in a row, alike but for a table in each, with open doors between them.
fn rooms() -> World {
    let mut world = World::default();
    world.room((0.0, 16.0), (-2.5, 2.5), 2.6);
    for x in [4.0, 8.0, 12.0] {
        for y in [-1.475, 1.475] {
            world.block((x, y), (0.12, 2.05, 2.6), 0.0);
        }
        world.wall((x - 0.06, 0.45), (x - 0.06, -0.45), 2.05, 2.6);
        world.wall((x + 0.06, -0.45), (x + 0.06, 0.45), 2.05, 2.6);
    }
    for (x, y, length) in [(1.0, 1.9, 0.8), (6.6, -1.8, 1.2), (9.8, 1.6, 0.6), (15.0, -2.0, 1.0)] {
        world.block((x, y), (length, 0.6, 0.75), 0.1 * x);
    }
    world
}

/// How far off the robot ends that drives through worlds by odometry that is right to some millimetres.
fn through(worlds: &[(World, Isometry3<f64>)], seed: u64) -> f64 {
    let mut drive = Drive::begin(&worlds[0].0, MapperConfig::default(), worlds[0].1, seed);
    for (world, target) in &worlds[1..] {
        drive.world = world;
        drive.steer_to(*target, &OdometryNoise::default());
    }
    drive.error().0
}

/// What a crate hid is no reason to take the robot for carried into the room before.
#[test]
fn a_crate_that_is_taken_away_leaves_the_robot_in_its_room() {
    let seen = |scan: usize| {
        let mut world = rooms();
        if (14..20).contains(&scan) {
            let pushed = scan as f64 - 14.0;
            world.block((11.2 - 0.35 * pushed, 0.3 - 0.1 * pushed), (0.9, 0.9, 1.5), 0.2 * pushed);
        }
        (world, step(0.8 + 0.4 * scan as f64, 0.0, 4.0 * (scan % 3) as f64))
    };
    let worlds: Vec<_> = (0..31).map(seen).collect();
    for seed in 0..3 {
        let off_m = through(&worlds, seed);
        assert!(off_m < 0.02, "{seed}: {off_m} m");
    }
}

/// Nor is a door's leaf, through which the next room is seen once it has swung open.
#[test]
fn doors_that_swing_open_leave_the_robot_in_its_room() {
    let seen = |door: usize, angle_deg: f64, x: f64| {
        let mut world = rooms();
        for other in 1..4 {
            let degrees = match other.cmp(&door) {
                std::cmp::Ordering::Less => 100.0,
                std::cmp::Ordering::Equal => angle_deg,
                std::cmp::Ordering::Greater => 0.0,
            };
            let (sin, cos) = f64::to_radians(degrees).sin_cos();
            let hinge = (4.0 * other as f64 - 0.1, -0.45);
            world.block(
                (hinge.0 - 0.45 * sin, hinge.1 + 0.45 * cos),
                (0.04, 0.9, 2.0),
                degrees.to_radians(),
            );
        }
        (world, step(4.0 * door as f64 + x, 0.05, 0.0))
    };
    let mut worlds = Vec::new();
    for door in 1..4 {
        worlds.extend((0..4).map(|k| seen(door, 0.0, -3.2 + 0.4 * f64::from(k))));
        worlds.extend([0.0, 35.0, 70.0, 100.0].map(|degrees| seen(door, degrees, -1.7)));
        worlds.extend((0..5).map(|k| seen(door, 100.0, -1.3 + 0.4 * f64::from(k))));
    }
    for seed in 0..3 {
        let off_m = through(&worlds, seed);
        assert!(off_m < 0.05, "{seed}: {off_m} m");
    }
}

/// A robot that drove through all rooms and back is set down in another of them, where it stood that is sure to be
/// wrong, and more than one room is not.
#[test]
fn a_robot_that_is_set_down_among_mapped_rooms_finds_the_one() {
    let world = rooms();
    let there = (0..37).map(|k| step(0.8 + 0.4 * f64::from(k), 0.05, 0.0));
    let turned = (1..9).map(|k| step(15.2, 0.05, 22.5 * f64::from(k)));
    let back = (1..33).map(|k| step(15.2 - 0.4 * f64::from(k), 0.0, 180.0));
    let way: Vec<_> = there.chain(turned).chain(back).collect();
    for (seed, x) in [10.4, 14.4].into_iter().enumerate() {
        let mut drive = Drive::begin(&world, MapperConfig::default(), way[0], seed as u64);
        for target in &way[1..] {
            drive.steer_to(*target, &OdometryNoise::default());
        }
        let before_m = drive.error().0;
        assert!(before_m < 0.02, "{x}: {before_m} m before");
        drive.slide(&Isometry3::identity(), &Vector6::zeros());
        drive.truth = step(x, 0.0, 180.0);
        drive.look();
        for k in 1..6 {
            drive.steer_to(step(x - 0.4 * f64::from(k), 0.0, 180.0), &OdometryNoise::default());
        }
        let off_m = drive.error().0;
        assert!(off_m < 0.05, "{x}: {off_m} m");
    }
}

/// A cupboard that is put before a wall of a bare room is not that wall, however far off it would have the robot.
#[test]
fn a_cupboard_that_comes_before_a_wall_is_not_the_wall() {
    let room = |depth_m: Option<f64>| {
        let mut world = World::default();
        world.room((0.0, 5.0), (-2.0, 2.0), 2.6);
        if let Some(depth_m) = depth_m {
            world.block((5.0 - 0.5 * depth_m, 0.0), (depth_m, 2.2, 2.3), 0.0);
        }
        world
    };
    for (depth_m, turn_deg) in [(0.15, 0.0), (0.15, 20.0), (0.3, 20.0), (0.5, 20.0)] {
        let seen = |scan: usize| {
            let at = step(1.6, 0.1, turn_deg * scan as f64);
            (room((scan >= 18).then_some(depth_m)), at)
        };
        let worlds: Vec<_> = (0..24).map(seen).collect();
        for seed in 0..3 {
            for end in 18..24 {
                let off_m = through(&worlds[..=end], seed);
                assert!(off_m < 0.02, "{depth_m} m, {turn_deg} deg, {seed}: {off_m} m at {end}");
            }
        }
    }
}

/// Encoders that are dead tell of rest whatever the robot does.
#[test]
fn odometry_that_always_tells_of_rest_is_found_out() {
    let world = rooms();
    let mut drive = Drive::begin(&world, MapperConfig::default(), step(0.8, 0.0, 0.0), 5);
    for turn_deg in [8.0, -12.0, 4.0, -10.0, 16.0, -6.0, 0.0, 10.0, -10.0] {
        let moved = Vector6::new(0.7, 0.0, 0.0, 0.0, 0.0, f64::to_radians(turn_deg));
        drive.slide(&Isometry3::identity(), &moved);
        drive.look();
        let off_m = drive.error().0;
        assert!(off_m < 0.05, "at {}: {off_m} m", drive.truth.translation);
    }
}
