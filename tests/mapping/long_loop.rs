//! A way of 300 m round a block of like rooms, and home.

use super::drive::{Drive, step};
use super::world::World;
use nalgebra::{Isometry3, Vector3};
use usar_agent::mapping::{MapperConfig, OdometryNoise};

/// Side of the corridor's middle line, a square.
const SIDE_M: f64 = 75.0;
/// Distance from room to room, and half the corridor's width.
const PITCH_M: f64 = 6.0;
const HALF_M: f64 = 1.2;
/// Metres between two scans.
const STEP_M: f64 = 3.0;

/// A corridor round a square with doors to like rooms on the outer side, 12 to each side of the square;
/// every fifth room has a cupboard, somewhere else in each, and the inner wall like pilasters.
fn block_of_like_rooms() -> World {
    let mut world = World::default();
    // Corners of the middle line, counterclockwise; each side as a frame with x along it.
    for side in 0..4 {
        let corner = [(0.0, 0.0), (SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M)][side];
        let (sin, cos) = [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)][side];
        let at = |x: f64, y: f64| (corner.0 + x * cos - y * sin, corner.1 + x * sin + y * cos);
        let mut pieces = Pieces { world: &mut world, at: &at };
        let first = 0.5 * (SIDE_M - 12.0 * PITCH_M);
        for (from, to) in [(-HALF_M, first), (SIDE_M - first, SIDE_M + HALF_M)] {
            pieces.floor((from, to), -HALF_M);
            pieces.wall((from, -HALF_M), (to, -HALF_M));
        }
        for room in 0..12 {
            let x = first + PITCH_M * f64::from(room);
            pieces.floor((x, x + PITCH_M), -HALF_M - 5.0);
            // The inner wall is seen from the right, where the corridor is.
            pieces.wall((x + PITCH_M, HALF_M), (x, HALF_M));
            // The outer wall with its door, both faces, and the room behind it.
            for (a, b) in [(0.0, 2.2), (3.4, PITCH_M)] {
                pieces.wall((x + a, -HALF_M), (x + b, -HALF_M));
                let (a, b) = (a.max(0.1), b.min(PITCH_M - 0.1));
                pieces.wall((x + b, -HALF_M - 0.1), (x + a, -HALF_M - 0.1));
            }
            pieces.wall((x + 0.1, -HALF_M - 0.1), (x + 0.1, -HALF_M - 5.0));
            pieces.wall((x + PITCH_M - 0.1, -HALF_M - 5.0), (x + PITCH_M - 0.1, -HALF_M - 0.1));
            pieces.wall((x + 0.1, -HALF_M - 5.0), (x + PITCH_M - 0.1, -HALF_M - 5.0));
            // A pilaster on the inner wall, and a cupboard in every fifth room.
            let yaw = sin.atan2(cos);
            pieces.world.block(at(x + 2.8, HALF_M - 0.1), (0.4, 0.2, 2.5), yaw);
            if room as usize % 5 == side {
                let cupboard = at(x + 1.5 + 0.25 * f64::from(room), -HALF_M - 4.0);
                pieces.world.block(cupboard, (1.2, 0.6, 1.6), yaw);
            }
        }
    }
    world
}

/// Walls and floors in the frame of one side, in pieces that the simulated scanner resolves.
struct Pieces<'a> {
    world: &'a mut World,
    at: &'a dyn Fn(f64, f64) -> (f64, f64),
}

impl Pieces<'_> {
    fn wall(&mut self, a: (f64, f64), b: (f64, f64)) {
        self.world.wall((self.at)(a.0, a.1), (self.at)(b.0, b.1), 0.0, 2.5);
    }

    /// Floor and ceiling from the inner wall down to `y`.
    fn floor(&mut self, x: (f64, f64), y: f64) {
        let (a, b) = ((self.at)(x.0, y), (self.at)(x.1, HALF_M));
        let sorted = |p: f64, q: f64| (p.min(q), p.max(q));
        for (z, from_above) in [(0.0, true), (2.5, false)] {
            self.world.level(sorted(a.0, b.0), sorted(a.1, b.1), z, from_above);
        }
    }
}

/// What one round leaves: errors before and after the start is seen again.
struct Round {
    before_m: f64,
    after_m: f64,
    after_rad: f64,
    nees: f64,
    right: usize,
    wrong: usize,
    landmarks: usize,
}

fn round(world: &World, seed: u64) -> Round {
    let noise = OdometryNoise::default();
    let start = Isometry3::new(Vector3::new(6.0, 0.0, 0.0), Vector3::zeros());
    let mut drive = Drive::begin(world, MapperConfig::default(), start, seed);
    let mut before_m = 0.0;
    let mut closed = false;
    // Once round, and 15 m of the way again.
    for side in 0..5 {
        let along = if side == 0 { SIDE_M - 6.0 } else { SIDE_M };
        let steps = if side == 4 { 6 } else { (along / STEP_M).round() as usize };
        for at in 0..steps {
            let turning = at + 1 == steps && side < 4;
            let report = drive.steer_to(drive.truth * step(STEP_M, 0.0, 0.0), &noise);
            closed |= report.loop_closed && side > 1;
            if !closed {
                before_m = drive.error().0;
            }
            if turning {
                for _ in 0..2 {
                    drive.steer_to(drive.truth * step(0.0, 0.0, 45.0), &noise);
                }
            }
        }
    }
    let (after_m, after_rad) = drive.error();
    let nees = drive.nees();
    let landmarks = drive.mapper.landmarks().len();
    Round { before_m, after_m, after_rad, nees, right: drive.right, wrong: drive.wrong, landmarks }
}

/// `tests/campaign/loop.sh`.
#[test]
#[ignore = "a campaign: tests/campaign/loop.sh"]
fn home_after_300_m_of_like_rooms() {
    let world = block_of_like_rooms();
    println!("seed   before, m  after, m  after, °    NEES  right  wrong  landmarks");
    for seed in 1..=5 {
        let Round { before_m, after_m, after_rad, nees, right, wrong, landmarks } =
            round(&world, seed);
        println!(
            "{seed:>4} {before_m:>11.3} {after_m:>9.3} {:>9.3} {nees:>7.2} {right:>6} {wrong:>6} {landmarks:>10}",
            after_rad.to_degrees()
        );
        // A ten-thousandth of the way; 99.9 % of χ² with six degrees of freedom.
        assert!(after_m < 0.03 && wrong == 0 && nees < 22.46, "seed {seed} did not come home");
    }
}
