//! Loops that must not be closed.

use super::drive::{Drive, step};
use super::world::World;
use nalgebra::{Isometry3, Vector6};
use usar_agent::mapping::{MapperConfig, OdometryNoise};

/// Two rooms that are alike to the last cupboard, 9 m apart, and nothing between them to be seen.
fn twin_rooms() -> World {
    let mut world = World::default();
    for x in [0.0, 9.0] {
        world.room((x - 3.0, x + 4.0), (-3.0, 3.0), 2.5);
        world.block((x + 2.0, 1.5), (0.6, 0.8, 0.9), 0.4);
        world.block((x + 1.5, -1.8), (1.2, 0.5, 1.8), 0.0);
    }
    world
}

/// From one room into its twin, with odometry that leaves the way open by a metre. Where a scan shows little
/// of what is expected, a motion several times worse than told is tried too, and that the room is the first
/// one again explains all that is seen.
#[test]
fn a_closure_onto_a_twin_of_the_place_is_refused() {
    let world = twin_rooms();
    let noise = OdometryNoise { fixed_m: 1.0, ..OdometryNoise::default() };
    for seed in 0..5 {
        let config = MapperConfig { odometry: noise, ..MapperConfig::default() };
        let mut drive = Drive::begin(&world, config, Isometry3::identity(), 200 + seed);
        let away = Vector6::new(0.4, -0.3, 0.0, 0.0, 0.0, 0.01);
        drive.slide(&step(9.0, 0.0, 0.0), &away);
        for _ in 0..3 {
            let report = drive.look();
            assert!(!report.loop_closed, "seed {seed}: {report:?}");
            drive.slide(&step(0.0, 0.0, 5.0), &Vector6::zeros());
        }
        assert_eq!(drive.wrong, 0, "seed {seed}");
        let (metres, _) = drive.error();
        assert!(metres < 0.7, "seed {seed}: {metres}");
    }
}
