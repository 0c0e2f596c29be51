//! Exploration of whole worlds.

use super::closed_loop::{Robot, start_pose};
use super::edges::draw;
use super::world::{Laser, Solid, World, coarse_tilts};
use rand_core::Rng;
use rand_pcg::Pcg32;
use std::f64::consts::{FRAC_PI_2, PI};

fn room() -> World {
    World::default()
        .with(Solid::block([-12.0, -12.0, -2.0], [12.0, 12.0, 0.0]))
        .with(Solid::block([-5.2, -4.2, 0.0], [-5.0, 4.2, 2.5]))
        .with(Solid::block([5.0, -4.2, 0.0], [5.2, 4.2, 2.5]))
        .with(Solid::block([-5.2, -4.2, 0.0], [5.2, -4.0, 2.5]))
        .with(Solid::block([-5.2, 4.0, 0.0], [5.2, 4.2, 2.5]))
        .with(Solid::block([-1.0, -4.0, 0.0], [-0.8, 1.5, 2.5]))
        .with(Solid::block([-1.0, 2.4, 0.0], [-0.8, 4.0, 2.5]))
        .with(Solid::block([2.0, -2.0, 0.0], [3.0, -1.0, 0.4]))
}

#[test]
fn a_room_is_explored_to_the_end() {
    let mut robot = Robot::new(
        room(),
        start_pose(-3.0, -2.0, 0.3),
        vec![-1.57, 0.0, 1.57, 3.1],
        coarse_tilts(29.75, 0.34),
        Laser::exact(),
    );
    robot.start(1.3);
    let mut rounds = 0;
    while rounds < 40 && robot.explore_once() {
        rounds += 1;
    }
    assert!(robot.violations.is_empty(), "{:#?}", robot.violations);
    let seen = |x: f64, y: f64| robot.grid.class_at(x, y).is_drivable();
    assert!(
        seen(-4.5, -3.5) && seen(4.5, 3.5) && seen(4.5, -3.5) && seen(0.0, 0.0),
        "after {} sweeps: {:#?}\n{}",
        robot.sweeps,
        robot.events,
        draw(&robot.grid.coarse(2))
    );
    assert!(rounds < 40, "ends by itself");
}

#[test]
fn no_goal_is_chosen_whose_sweep_would_not_be_over_in_time() {
    let start = start_pose(-3.0, -2.0, 0.3);
    let mut robot = Robot::new(room(), start, vec![0.0], coarse_tilts(29.75, 0.34), Laser::exact());
    robot.start(1.3);
    let free_s = robot.next_goal_s(None).expect("the room is not explored");
    let hurried_s = robot.next_goal_s(Some(0.8 * free_s));
    assert!(hurried_s.is_none_or(|seconds| seconds <= 0.8 * free_s), "{hurried_s:?} of {free_s}");
    assert_eq!(robot.next_goal_s(Some(1.0)), None);
}

/// Random numbers for building worlds.
struct Dice(Pcg32);

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * f64::from(self.0.next_u32()) / f64::from(u32::MAX)
    }

    fn chance(&mut self, share: f64) -> bool {
        self.between(0.0, 1.0) < share
    }
}

/// A hall of 12 × 9 m on a platform: walls or edges on its sides, a partition with a door, boxes,
/// poles, low beams, kerbs, pits, and a ramp to ground one metre above or below.
fn random_world(seed: u64) -> World {
    let mut dice = Dice(Pcg32::new(seed, 77));
    let (x1, y1) = (12.0, 9.0);
    // The slab is built of strips so that a pit can be left out.
    let pit = dice.chance(0.6).then(|| {
        let (x, y) = (dice.between(4.0, 9.0), dice.between(3.0, 6.5));
        (x, y, x + dice.between(0.4, 1.5), y + dice.between(0.4, 1.5))
    });
    let mut world = World::default();
    match pit {
        None => world = world.with(Solid::block([0.0, 0.0, -3.0], [x1, y1, 0.0])),
        Some((px0, py0, px1, py1)) => {
            for (low, high) in [
                ([0.0, 0.0], [px0, y1]),
                ([px1, 0.0], [x1, y1]),
                ([px0, 0.0], [px1, py0]),
                ([px0, py1], [px1, y1]),
            ] {
                world = world.with(Solid::block([low[0], low[1], -3.0], [high[0], high[1], 0.0]));
            }
        }
    }
    if dice.chance(0.7) {
        world = world.with(Solid::block([-15.0, -15.0, -4.0], [30.0, 30.0, -1.3]));
    }
    let sides = [
        ([-0.2, -0.2, 0.0], [x1 + 0.2, 0.0, 2.5]),
        ([-0.2, y1, 0.0], [x1 + 0.2, y1 + 0.2, 2.5]),
        ([-0.2, -0.2, 0.0], [0.0, y1 + 0.2, 2.5]),
    ];
    for (low, high) in sides {
        if dice.chance(0.6) {
            world = world.with(Solid::block(low, high));
        }
    }
    // East: a ramp of at most 18° up or down, with ground beyond it.
    let rise = if dice.chance(0.5) { 0.8 } else { -1.0 };
    let ramp_y = dice.between(1.5, 6.5);
    world = world
        .with(Solid::ramp([x1, ramp_y], [x1 + 3.2, ramp_y + 1.8], 0.0, rise))
        .with(Solid::block([x1 + 3.2, ramp_y - 2.0, -3.0], [x1 + 7.0, ramp_y + 3.0, rise]));
    if dice.chance(0.7) {
        let (x, door) = (dice.between(3.5, 8.0), dice.between(1.0, 7.0));
        let wide = dice.between(0.85, 1.2);
        world = world
            .with(Solid::block([x, 0.0, 0.0], [x + 0.15, door, 2.5]))
            .with(Solid::block([x, door + wide, 0.0], [x + 0.15, y1, 2.5]));
    }
    for _ in 0..4 {
        let (x, y) = (dice.between(2.8, 11.0), dice.between(0.5, 8.0));
        let yaw = dice.between(0.0, 3.0);
        let height = dice.between(0.08, 1.5);
        let (long, wide) = (dice.between(0.1, 1.2), dice.between(0.1, 0.8));
        let block = Solid::block([x, y, 0.0], [x + long, y + wide, height]);
        world = world.with(block.turned(yaw, [x, y]));
    }
    for _ in 0..3 {
        let (x, y) = (dice.between(2.8, 11.5), dice.between(0.5, 8.5));
        world = world.with(Solid::pole(x, y, dice.between(0.03, 0.2), 2.5));
    }
    if dice.chance(0.5) {
        let (x, y, z) = (dice.between(4.0, 10.0), dice.between(1.0, 6.0), dice.between(0.4, 0.65));
        world = world.with(Solid::block([x, y, z], [x + 0.8, y + 1.6, z + 0.05]));
    }
    if dice.chance(0.5) {
        let y = dice.between(3.0, 7.0);
        world = world.with(Solid::block([2.8, y, -1.0], [6.0, y + 0.1, dice.between(0.08, 0.16)]));
    }
    world
}

/// Explores a random world; returns what to print.
fn explore_random(seed: u64) -> (Robot, usize, f64) {
    let mut dice = Dice(Pcg32::new(seed, 78));
    let start = start_pose(1.3, dice.between(1.3, 7.7), dice.between(-3.0, 3.0));
    let pans = if dice.chance(0.5) { vec![0.0] } else { vec![-FRAC_PI_2, 0.0, FRAC_PI_2, PI] };
    let steepest = if dice.chance(0.5) { 29.75 } else { 55.0 };
    let laser = Laser::noisy(if dice.chance(0.5) { 0.0 } else { 0.01 }, seed);
    let mut robot =
        Robot::new(random_world(seed), start, pans, coarse_tilts(steepest, 0.34), laser);
    robot.start(1.3);
    let mut rounds = 0;
    while rounds < 80 && robot.explore_once() {
        rounds += 1;
    }
    let coverage = robot.coverage();
    (robot, rounds, coverage)
}

/// What each of twenty random sites comes to, one with `SEED=N`, its map with `DRAW=N`.
#[test]
#[ignore = "a campaign of five minutes"]
fn campaign() {
    let only = std::env::var("SEED").ok().and_then(|v| v.parse::<u64>().ok());
    let many = std::env::var("SEEDS").ok().and_then(|v| v.parse::<u64>().ok()).unwrap_or(20);
    let mut falls = 0;
    for seed in 0..many {
        if only.is_some_and(|only| only != seed) {
            continue;
        }
        let (robot, rounds, coverage) = explore_random(seed);
        println!(
            "seed {seed}: rounds {rounds} sweeps {} driven {:.0} m, {:.0} s, coverage {coverage:.3}, falls {}, touches {}, events {}, pans {}, steepest {:.0}",
            robot.sweeps,
            robot.driven,
            robot.seconds,
            robot.falls,
            robot.touches,
            robot.events.len(),
            robot.pans.len(),
            robot.tilts[0].to_degrees(),
        );
        for violation in &robot.violations {
            println!("   {violation}");
        }
        if std::env::var("DRAW").is_ok_and(|v| v == seed.to_string()) {
            let zoom = std::env::var("ZOOM").ok().and_then(|v| v.parse().ok()).unwrap_or(3);
            println!("{}", draw(&robot.grid.coarse(zoom)));
            for event in &robot.events {
                println!("E {event}");
            }
        }
        falls += robot.falls;
    }
    assert_eq!(falls, 0, "no fall is worth any coverage");
}
