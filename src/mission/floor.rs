//! How high the robot stands: no message tells it, a sweep does.

use crate::scan::{RangeImage, Return};
use nalgebra::{Point3, Unit, Vector3};
use std::collections::BTreeMap;

/// Floor is looked for within this of the robot, in metres; a rig that sees no ground so near looks
/// farther.
const REACHES_M: [f64; 4] = [1.5, 3.0, 5.0, 8.0];
/// How far from where it is supposed the floor may lie, in metres: classes are known to some centimetres, and
/// what lies lower is the ground below an edge that the robot faces.
const OFF_M: f64 = 0.12;
/// Depths are counted in steps of this, in metres.
const STEP_M: f64 = 0.01;
/// Depths to either side of the commonest that are the same floor, in steps.
const SPREAD: i64 = 4;
/// Points at one depth that make a floor, and how many times the average depth's they must be: a wall
/// has as many at every depth.
const ENOUGH: usize = 50;
const TIMES_THE_REST: f64 = 4.0;

/// How a robot stands whose floor is measured.
pub(super) struct Stand<'a> {
    /// The vertical in the robot's frame.
    pub(super) up: Unit<Vector3<f64>>,
    /// How high the origin is supposed to stand when all contacts touch level ground, in metres.
    pub(super) supposed_m: f64,
    /// Where the wheels touch the ground, in the robot's frame.
    pub(super) contacts: &'a [Point3<f64>],
}

/// How high the robot's origin stands above level ground in metres, from what a sweep saw of the floor nearby;
/// `None` where too little was seen of it where it may lie.
///
/// The commonest depth and the median about it: walls and boxes spread over all depths, the floor does not. A robot
/// on a slope stands along the floor's normal, one that leans on something along the vertical: the floor is taken
/// along the direction in which more of it lies at one depth.
pub(super) fn stands_at_m(image: &RangeImage, stand: &Stand<'_>) -> Option<f64> {
    REACHES_M.iter().find_map(|reach_m| {
        let directions = [Vector3::z_axis(), stand.up];
        let floors = directions.iter().filter_map(|along| {
            let lowest_m = lowest_m(along, stand.contacts);
            let supposed_m = stand.supposed_m * along.z + lowest_m;
            let (depth_m, points) = floor_along(image, along, supposed_m, *reach_m)?;
            Some(((depth_m - lowest_m) / along.z, points))
        });
        // Of equals the first: along both it is the same.
        let best = floors.reduce(|best, next| if next.1 > best.1 { next } else { best });
        best.map(|(height_m, _)| height_m)
    })
}

/// How much lower than the origin's foot the lowest contact lies, along a direction in which the robot stands tilted:
/// that one touches the floor, on a board or beside one.
fn lowest_m(up: &Unit<Vector3<f64>>, contacts: &[Point3<f64>]) -> f64 {
    let lever_m = |contact: &Point3<f64>| -(up.x * contact.x + up.y * contact.y);
    contacts.iter().map(lever_m).fold(0.0, f64::max)
}

/// How far the floor lies below the origin along a direction, and how many points it has.
fn floor_along(
    image: &RangeImage,
    up: &Unit<Vector3<f64>>,
    supposed_m: f64,
    reach_m: f64,
) -> Option<(f64, usize)> {
    let mut counts: BTreeMap<i64, usize> = BTreeMap::new();
    let mut depths: Vec<f64> = Vec::new();
    for row in 0..image.rows().len() {
        for column in 0..image.columns() {
            let Return::Hit(range) = image.at(row, column) else { continue };
            let p = image.robot_from_scan * image.point_at(row, column, range);
            let depth_m = -up.dot(&p.coords);
            let beside_m = (p.coords.norm_squared() - depth_m * depth_m).max(0.0).sqrt();
            if beside_m < reach_m {
                *counts.entry((depth_m / STEP_M).floor() as i64).or_default() += 1;
                depths.push(depth_m);
            }
        }
    }
    let middle_m = |step: i64| (step as f64 + 0.5) * STEP_M;
    let may_be = |step: &i64| (middle_m(*step) - supposed_m).abs() < OFF_M;
    let (commonest, count) = counts
        .iter()
        .filter(|(step, _)| may_be(step))
        .max_by_key(|(step, count)| (**count, std::cmp::Reverse(**step)))?;
    // Noise spreads the floor itself over a few depths. What no row sees is no rest.
    let others = counts.iter().filter(|(step, _)| (*step - commonest).abs() > SPREAD);
    let (rest, steps) = others.fold((0, 0), |(rest, steps), (_, count)| (rest + count, steps + 1));
    if *count < ENOUGH || ((*count * steps) as f64) < TIMES_THE_REST * rest as f64 {
        return None;
    }
    depths.retain(|depth| (depth - middle_m(*commonest)).abs() <= 2.0 * STEP_M);
    depths.sort_by(f64::total_cmp);
    Some((depths[depths.len() / 2], depths.len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{ImageRow, LaserLine};
    use crate::time::Stamp;
    use nalgebra::{Isometry3, UnitQuaternion, Vector3};

    /// What a laser 0.6 m above a floor sees between two tilts, with a wall `wall_m` ahead.
    fn image(tilts_deg: std::ops::Range<i32>, wall_m: f64) -> RangeImage {
        let robot_from_scan = Isometry3::translation(0.0, 0.0, 0.42);
        let bearings: Vec<f64> = (-60..=60).map(|deg| f64::from(deg).to_radians()).collect();
        let mut image = RangeImage::new(robot_from_scan, bearings.clone(), 20.0);
        for quarter in tilts_deg.start * 4..tilts_deg.end * 4 {
            let tilt_rad = (f64::from(quarter) / 4.0).to_radians();
            let tilted = UnitQuaternion::from_scaled_axis(Vector3::y() * tilt_rad);
            let ranges_m = bearings
                .iter()
                .map(|bearing| {
                    let ray = tilted * Vector3::new(bearing.cos(), bearing.sin(), 0.0);
                    let wall = wall_m / ray.x;
                    let floor = if ray.z < 0.0 { 0.6 / -ray.z } else { f64::INFINITY };
                    wall.min(floor).min(20.0)
                })
                .collect();
            let line = LaserLine {
                stamp: Stamp::default(),
                first_bearing_rad: bearings[0],
                bearing_step_rad: 1_f64.to_radians(),
                min_range_m: 0.1,
                max_range_m: 20.0,
                phantom_m: None,
                ranges_m,
            };
            let row = ImageRow {
                tilt_rad,
                tilt_sigma_rad: 0.0,
                scan_from_sensor: Isometry3::from_parts(Default::default(), tilted),
                stamp: None,
            };
            image.push_line(row, &line);
        }
        image
    }

    fn level(supposed_m: f64) -> Stand<'static> {
        Stand { up: Vector3::z_axis(), supposed_m, contacts: &[] }
    }

    #[test]
    fn the_floor_is_found_near_or_far() {
        for (tilts, wall_m) in [(-25..30, 6.0), (-9..9, 12.0), (-25..30, 2.0)] {
            let height_m = stands_at_m(&image(tilts.clone(), wall_m), &level(0.14));
            let height_m = height_m.expect("floor is in sight");
            assert!((height_m - 0.18).abs() < 0.01, "{tilts:?}: {height_m}");
        }
    }

    #[test]
    fn a_wall_is_no_floor() {
        for wall_m in [0.8, 0.9, 1.0, 2.0] {
            assert_eq!(stands_at_m(&image(-9..9, wall_m), &level(0.14)), None, "{wall_m}");
        }
        // So near that no row meets the floor before it.
        assert_eq!(stands_at_m(&image(-25..30, 0.9), &level(0.14)), None);
    }

    #[test]
    fn the_ground_below_an_edge_is_not_what_the_robot_stands_on() {
        // All that is in sight lies 0.18 m below the origin, of a robot that is half as high or less.
        for supposed_m in [0.0, 0.05, 0.5] {
            assert_eq!(stands_at_m(&image(-25..30, 6.0), &level(supposed_m)), None, "{supposed_m}");
        }
    }

    #[test]
    fn a_robot_that_leans_measures_along_the_vertical_and_one_on_a_slope_along_its_normal() {
        let contacts: Vec<Point3<f64>> = [(0.15, 0.2), (0.15, -0.2), (-0.15, 0.2), (-0.15, -0.2)]
            .map(|(x, y)| Point3::new(x, y, -0.18))
            .to_vec();
        let tilted = UnitQuaternion::from_scaled_axis(Vector3::y() * 0.1);
        let leaning = Stand {
            up: Unit::new_normalize(tilted.inverse() * Vector3::z()),
            supposed_m: 0.15,
            contacts: &contacts,
        };
        // The same floor as a robot sees it that has pitched about its own middle.
        let mut seen = image(-25..30, 6.0);
        seen.robot_from_scan =
            Isometry3::from_parts(Default::default(), tilted.inverse()) * seen.robot_from_scan;
        let height_m = stands_at_m(&seen, &leaning).expect("floor is in sight");
        let expected_m = (0.18 - 0.15 * 0.1_f64.sin()) / 0.1_f64.cos();
        assert!((height_m - expected_m).abs() < 0.005, "{height_m} for {expected_m}");
        // On a slope the floor lies along the robot, wherever the vertical is.
        let height_m = stands_at_m(&image(-25..30, 6.0), &leaning).expect("floor is in sight");
        assert!((height_m - 0.18).abs() < 0.005, "{height_m}");
    }
}
