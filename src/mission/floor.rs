//! How high the robot stands: no message tells it, a sweep does.

use crate::scan::{RangeImage, Return};
use nalgebra::{Point3, Unit, Vector3};

/// Floor is looked for within this of the robot, in metres; a rig that sees no ground so near looks
/// farther.
const REACHES_M: [f64; 3] = [3.0, 5.0, 8.0];
/// Depth below the origin up to which it is looked for, in metres.
const DEEPEST_M: f64 = 0.8;
/// Depths are counted in steps of this, in metres.
const STEP_M: f64 = 0.01;
/// Depths to either side of the commonest that are the same floor, in steps.
const SPREAD: usize = 4;
/// Points at one depth that make a floor, and how many times the average depth's they must be: a wall
/// has as many at every depth.
const ENOUGH: usize = 50;
const TIMES_THE_REST: f64 = 4.0;

/// How far the floor lies below the robot's origin in metres, from what a sweep saw of it nearby, where `up` is
/// the vertical in the robot's frame; `None` where too little was seen.
///
/// The commonest depth and the median about it: walls and boxes spread over all depths, the floor
/// does not.
pub(super) fn floor_below_m(image: &RangeImage, up: &Unit<Vector3<f64>>) -> Option<f64> {
    REACHES_M.iter().find_map(|reach_m| floor_within(image, up, *reach_m))
}

/// How high the robot's origin would stand if all of these contacts, given in its frame, touched the floor, where it
/// stands `depth_m` above it and tilted: the lowest of them touches it, on a board or beside one.
pub(super) fn height_on_level_m(
    depth_m: f64,
    up: &Unit<Vector3<f64>>,
    contacts: &[Point3<f64>],
) -> f64 {
    let lever_m = |contact: &Point3<f64>| -(up.x * contact.x + up.y * contact.y);
    let lowest_m = contacts.iter().map(lever_m).fold(0.0, f64::max);
    (depth_m - lowest_m) / up.z
}

fn floor_within(image: &RangeImage, up: &Unit<Vector3<f64>>, reach_m: f64) -> Option<f64> {
    let mut depths: Vec<f64> = Vec::new();
    for row in 0..image.rows().len() {
        for column in 0..image.columns() {
            let Return::Hit(range) = image.at(row, column) else { continue };
            let p = image.robot_from_scan * image.point_at(row, column, range);
            let depth_m = -up.dot(&p.coords);
            let beside_m = (p.coords.norm_squared() - depth_m * depth_m).max(0.0).sqrt();
            if beside_m < reach_m && (0.0..DEEPEST_M).contains(&depth_m) {
                depths.push(depth_m);
            }
        }
    }
    let mut counts = vec![0_usize; (DEEPEST_M / STEP_M) as usize + 1];
    for depth in &depths {
        counts[(depth / STEP_M) as usize] += 1;
    }
    let (commonest, count) = counts
        .iter()
        .enumerate()
        .max_by_key(|(index, count)| (**count, std::cmp::Reverse(*index)))?;
    // Noise spreads the floor itself over a few depths.
    let is_floor = |index: usize| index.abs_diff(commonest) <= SPREAD;
    let others = counts.iter().enumerate().filter(|(index, _)| !is_floor(*index));
    let (rest, steps) = others.fold((0, 0), |(rest, steps), (_, count)| (rest + count, steps + 1));
    if *count < ENOUGH || (*count * steps) as f64 <= TIMES_THE_REST * rest as f64 {
        return None;
    }
    let middle_m = (commonest as f64 + 0.5) * STEP_M;
    depths.retain(|depth| (depth - middle_m).abs() <= 2.0 * STEP_M);
    depths.sort_by(f64::total_cmp);
    Some(depths[depths.len() / 2])
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

    #[test]
    fn the_floor_is_found_near_or_far() {
        for (tilts, wall_m) in [(-25..30, 6.0), (-9..9, 12.0), (-25..30, 2.0)] {
            let height_m = floor_below_m(&image(tilts.clone(), wall_m), &Vector3::z_axis())
                .expect("floor is in sight");
            assert!((height_m - 0.18).abs() < 0.01, "{tilts:?}: {height_m}");
        }
    }

    #[test]
    fn a_wall_is_no_floor() {
        assert_eq!(floor_below_m(&image(-9..9, 2.0), &Vector3::z_axis()), None);
    }
}
