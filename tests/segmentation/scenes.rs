//! Random worlds of several characters. They are not the benchmark's three scenes.

use super::world::{Random, World, pose};
use nalgebra::Isometry3;
use std::f64::consts::PI;

/// A world and where it is scanned from.
pub struct Scene {
    pub name: &'static str,
    pub world: World,
    pub pose: Isometry3<f64>,
}

/// The `index`-th random scene.
pub fn scene(index: u64) -> Scene {
    let mut random = Random(0x5EED_0000 + index);
    let tilt = if index.is_multiple_of(5) { 0.15 } else { 0.0 };
    let attitude = (random.between(-tilt, tilt), random.between(-tilt, tilt));
    let (name, world, height) = match index % 4 {
        0 => ("office", office(&mut random), random.between(0.45, 1.0)),
        1 => ("stairs", stairs(&mut random), random.between(0.5, 0.9)),
        2 => ("platform", platform(&mut random), random.between(0.5, 0.8)),
        _ => ("rubble", rubble(&mut random), random.between(0.6, 1.2)),
    };
    let yaw = random.between(-0.4, 0.4);
    Scene { name, world, pose: pose([0.0, 0.0, height], attitude.0, attitude.1, yaw) }
}

/// A place ahead of the sensor, and its distance.
fn ahead(random: &mut Random, near: f64, far: f64) -> (f64, f64, f64) {
    let (distance, bearing) = (random.between(near, far), random.between(-0.9, 0.9));
    (distance * bearing.cos(), distance * bearing.sin(), distance)
}

fn office(random: &mut Random) -> World {
    let mut world = World::default();
    let (width, depth) = (random.between(2.0, 4.0), random.between(4.0, 9.0));
    world.room([-1.5, -width, depth, width], random.between(2.3, 3.2));
    for _ in 0..2 + random.below(4) {
        let (x, y, _) = ahead(random, 1.6, depth.min(5.5));
        let size = [random.between(0.3, 1.2), random.between(0.3, 1.2), random.between(0.25, 1.6)];
        world.standing(x, y, size, random.between(0.0, PI));
    }
    // A table: a slab on thin legs.
    let (x, y, _) = ahead(random, 2.0, 4.0);
    let top = random.between(0.6, 0.8);
    world.block(&pose([x, y, top], 0.0, 0.0, random.between(0.0, PI)), [1.2, 0.7, 0.04]);
    for _ in 0..1 + random.below(2) {
        let (x, y, _) = ahead(random, 1.8, 5.0);
        world.drum([x, y, 0.0], [0.0, 0.0, 1.0], random.between(0.12, 0.35), 2.6);
    }
    if random.below(2) == 0 {
        let (x, y, _) = ahead(random, 1.8, 4.0);
        let radius = random.between(0.2, 0.45);
        world.ball([x, y, radius], radius);
    }
    world
}

fn stairs(random: &mut Random) -> World {
    let mut world = World::default();
    let width = random.between(1.2, 2.5);
    world.room([-1.5, -width, random.between(9.0, 16.0), width], 3.5);
    let (mut x, mut z) = (random.between(1.8, 3.0), 0.0);
    let (rise, tread) = (random.between(0.12, 0.2), random.between(0.26, 0.4));
    for _ in 0..3 + random.below(3) {
        world.patch([x, -width, z], [0.0, 2.0 * width, 0.0], [0.0, 0.0, rise]);
        z += rise;
        world.patch([x, -width, z], [tread, 0.0, 0.0], [0.0, 2.0 * width, 0.0]);
        x += tread;
    }
    world.patch([x, -width, z], [4.0, 0.0, 0.0], [0.0, 2.0 * width, 0.0]);
    let side = if random.below(2) == 0 { 1.0 } else { -1.0 };
    world.drum([x + 0.8, 0.4 * side, z], [0.0, 0.0, 1.0], random.between(0.12, 0.25), 2.0);
    world.standing(random.between(1.2, 1.6), -0.7 * width * side, [0.4, 0.4, 0.5], 0.4);
    world
}

fn platform(random: &mut Random) -> World {
    let mut world = World::default();
    let edge = random.between(1.5, 3.0);
    let drop = random.between(0.6, 1.1);
    // The platform, its edge, the track bed below with two rails, the far platform.
    world.patch([-3.0, -8.0, 0.0], [edge + 3.0, 0.0, 0.0], [0.0, 16.0, 0.0]);
    world.patch([edge, -8.0, -drop], [3.2, 0.0, 0.0], [0.0, 16.0, 0.0]);
    for rail in [0.8, 2.24] {
        let centre = pose([edge + rail, 0.0, 0.075 - drop], 0.0, 0.0, 0.0);
        world.block(&centre, [0.07, 16.0, 0.15]);
    }
    world.patch([edge + 3.2, -8.0, -drop], [0.0, 16.0, 0.0], [0.0, 0.0, drop]);
    world.patch([edge + 3.2, -8.0, 0.0], [4.0, 0.0, 0.0], [0.0, 16.0, 0.0]);
    world.patch([edge + 7.2, -8.0, 0.0], [0.0, 16.0, 0.0], [0.0, 0.0, 4.5]);
    for k in 0..2 + random.below(2) {
        let y = -4.0 + 3.0 * k as f64 + random.between(-0.5, 0.5);
        world.drum([edge + 4.2, y, 0.0], [0.0, 0.0, 1.0], random.between(0.2, 0.4), 4.0);
    }
    world.ramp(edge + 3.4, random.between(-3.0, 1.0), [2.4, 1.2, 0.4], random.between(-0.3, 0.3));
    world.standing(0.9, random.between(1.2, 2.0), [0.6, 0.9, 0.5], random.between(0.0, PI));
    world.standing(edge + 5.0, random.between(1.0, 4.0), [1.4, 1.8, 2.2], 0.1);
    world
}

fn rubble(random: &mut Random) -> World {
    let mut world = World::default();
    world.patch([-10.0, -14.0, 0.0], [34.0, 0.0, 0.0], [0.0, 28.0, 0.0]);
    world.patch([-10.0, random.between(4.0, 7.0), 0.0], [30.0, 0.0, 0.0], [0.0, 0.0, 3.5]);
    for _ in 0..5 + random.below(4) {
        let (x, y, distance) = ahead(random, 1.8, 9.0);
        let grow = 0.5 + distance / 6.0;
        let size = [0.3, 0.4, 0.5].map(|s: f64| s * grow * random.between(0.7, 1.8));
        let turn = [0.5, 0.5, PI].map(|a| random.between(-a, a));
        world.block(&pose([x, y, 0.3 * grow], turn[0], turn[1], turn[2]), size);
    }
    for _ in 0..2 + random.below(2) {
        // Drums and pipes, lying and leaning.
        let (x, y, distance) = ahead(random, 2.2, 8.0);
        let axis = [random.between(-1.0, 1.0), random.between(-1.0, 1.0), random.between(0.0, 0.6)];
        let radius = random.between(0.12, 0.3) * (0.6 + distance / 6.0);
        world.drum([x, y, radius], axis, radius, random.between(0.8, 2.5));
    }
    let (x, y, distance) = ahead(random, 2.0, 7.0);
    let radius = random.between(0.15, 0.3) * (0.7 + distance / 5.0);
    world.ball([x, y, radius], radius);
    world
}
