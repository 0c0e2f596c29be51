//! Surfaces that do not hide what is behind them from everywhere: boards over boards, a free wall.

use super::real_scan::observed;
use crate::segmentation::scanner::{Noise, Scanner, scan};
use crate::segmentation::world::{Random, World, pose};
use nalgebra::Vector2;
use usar_agent::mapping::perturbation::pose_error;
use usar_agent::mapping::{Mapper, MapperConfig, MotionSource};
use usar_agent::segmentation::{SegmentationConfig, Segmenter};

const HEIGHT_M: f64 = 0.6;

/// A room that is its own image under half a turn, but for a rack of boards and four steps, with a free wall in
/// its middle.
fn hall() -> World {
    let mut world = World::default();
    world.room([-5.0, -4.0, 7.0, 4.0], 2.8);
    world.standing(1.0, -1.5, [0.04, 5.0, 2.2], 0.0);
    for board in 0..6 {
        let z = 0.28 + 0.35 * f64::from(board);
        world.patch([5.1, 1.1, z], [1.0, 0.0, 0.0], [0.0, 2.2, 0.0]);
    }
    for y in [1.05, 3.3] {
        world.standing(5.1, y, [0.05, 0.05, 2.2], 0.0);
    }
    for step in 0..4 {
        let (x, z) = (-4.5 + 0.3 * f64::from(step), 0.08 * f64::from(step));
        let tread_m = if step < 3 { 0.3 } else { 1.2 };
        world.patch([x, 2.5, z], [0.0, 1.2, 0.0], [0.0, 0.0, 0.08]);
        world.patch([x, 2.5, z + 0.08], [tread_m, 0.0, 0.0], [0.0, 1.2, 0.0]);
    }
    world
}

/// Poses about so far apart along corners, turning on the spot at each.
fn way() -> Vec<(f64, f64, f64)> {
    let corners: [(f64, f64); 10] = [
        (-3.0, -1.5),
        (-1.0, -2.0),
        (0.2, 1.6),
        (1.2, 2.0),
        (2.2, 1.2),
        (2.6, -1.5),
        (4.0, -1.5),
        (4.2, 1.5),
        (2.0, 2.2),
        (0.0, 1.8),
    ];
    let mut way: Vec<(f64, f64, f64)> = Vec::new();
    for pair in corners.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let leg = Vector2::new(to.0 - from.0, to.1 - from.1);
        let heading = leg.y.atan2(leg.x);
        if let Some(&(.., before)) = way.last() {
            let turn = (heading - before + 3.0 * std::f64::consts::PI) % std::f64::consts::TAU
                - std::f64::consts::PI;
            let count = (turn.abs() / 0.35) as usize + 1;
            let part = |k: usize| before + turn * k as f64 / count as f64;
            way.extend((1..count).map(|k| (from.0, from.1, part(k))));
        }
        let count = ((leg.norm() / 0.4) as usize).max(1);
        let at = |k: usize| k as f64 / count as f64;
        way.extend((0..count).map(|k| (from.0 + leg.x * at(k), from.1 + leg.y * at(k), heading)));
    }
    way
}

/// A board before another was no reason why that one should not have been seen from where it was.
#[test]
fn boards_seen_again_from_elsewhere_contradict_nothing() {
    let (world, scanner) = (hall(), Scanner::paper());
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let mut random = Random(11);
    let way = way().into_iter().map(|(x, y, yaw)| pose([x, y, HEIGHT_M], 0.0, 0.0, yaw));
    let poses: Vec<_> = way.collect();
    let mut mapper = Mapper::new(MapperConfig::default(), poses[0]);
    for (k, at) in poses.iter().enumerate() {
        if k > 0 {
            mapper.predict(&(poses[k - 1].inverse() * at), MotionSource::Wheels);
        }
        let grid = scan(&world, at, &scanner, Noise::of(0.005), &mut random).grid;
        mapper.observe(&observed(&mut segmenter, &grid));
        let off_m = pose_error(&mapper.world_from_robot(), at).fixed_rows::<3>(0).norm();
        assert!(off_m < 0.02, "scan {k}: {off_m} m");
    }
}
