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
