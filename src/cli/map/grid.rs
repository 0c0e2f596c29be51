//! The 2D grid of organised scans at the poses that the mapper gave them.

use crate::exploration::{Places, Walls};
use crate::export::canvas::Canvas;
use crate::export::map_picture::{self, Overlay};
use crate::mapping::Landmark;
use crate::scan::RangeImage;
use crate::terrain::{Grid, RobotShape, Terrain, TerrainConfig};
use nalgebra::{Isometry3, Point2};

/// Height of the sensor above the floor where no scan shows the floor, in metres: the paper's robot's.
pub const SUPPOSED_HEIGHT_M: f64 = 0.6;

/// Surfaces this level and this far below the sensor are taken for the floor it stands on.
const LEVEL: f64 = 0.97;
const LEAST_BELOW_M: f64 = 0.1;
const MOST_BELOW_M: f64 = 3.0;

/// Farthest from the sensor that ground which it cannot see is assumed, in metres.
const MOST_ASSUMED_M: f64 = 2.0;

/// How far the sensor is above the floor at its first pose: above the greatest level surface that
/// lies below it and faces up. `None` where there is none.
pub fn sensor_above_floor(landmarks: &[Landmark], sensors: &[Isometry3<f64>]) -> Option<f64> {
    let eye = sensors.first()?.translation.vector;
    landmarks
        .iter()
        .map(|landmark| (landmark, landmark.plane()))
        .filter(|(_, plane)| plane.normal.z > LEVEL)
        .map(|(landmark, plane)| {
            let below_m = (plane.normal.dot(&eye) - plane.offset_m) / plane.normal.z;
            (landmark.area_m2(), below_m)
        })
        .filter(|(_, below_m)| (LEAST_BELOW_M..MOST_BELOW_M).contains(below_m))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, below_m)| below_m)
}

/// The grid on the level of the last scan, for a robot of the default shape that carries the sensor
/// `above_m` over the floor. Where it stood there was ground: the disc that the sensor cannot see into
/// is assumed, as far as no wall hides it. With it the rooms and doorways between these walls, which keep from scan to scan who
/// they are: a map of the first scans alone has most of them under the same numbers.
pub fn grid(
    images: &[&RangeImage],
    sensors: &[Isometry3<f64>],
    above_m: f64,
    walls: &Walls,
) -> (Grid, Places) {
    let shape = RobotShape {
        base_above_floor_m: above_m,
        height_m: RobotShape::default().height_m.max(above_m + 0.1),
        ..RobotShape::default()
    };
    let mut terrain = Terrain::new(TerrainConfig::default(), shape.clone());
    // Less often the larger the map is: to look for rooms costs as much as the whole of it.
    let (mut places, mut next) = (Places::default(), 0);
    for (number, (image, pose)) in images.iter().zip(sensors).enumerate() {
        let blind_m = nearest_ground(image, above_m).unwrap_or_default();
        let blind_m = blind_m.clamp(shape.circumscribed_radius_m(), MOST_ASSUMED_M);
        let at = pose.translation.vector;
        let hidden = walls.hide(Point2::new(at.x, at.y), at.z - above_m, blind_m);
        terrain.assume_where(pose, blind_m, |p| !hidden(p));
        terrain.integrate(image, pose);
        if number == next {
            places = places.renewed(&terrain.project(pose), walls);
            next += 1 + number / 4;
        }
    }
    let grid = terrain.project(&sensors.last().copied().unwrap_or_default());
    let places = places.renewed(&grid, walls);
    (grid, places)
}

/// Distance from the sensor to the nearest point at the floor's height.
fn nearest_ground(image: &RangeImage, above_m: f64) -> Option<f64> {
    const NEAR_FLOOR_M: f64 = 0.1;
    (0..image.rows().len())
        .flat_map(|row| (0..image.columns()).filter_map(move |column| image.point(row, column)))
        .filter(|p| (p.z + above_m).abs() < NEAR_FLOOR_M)
        .map(|p| p.x.hypot(p.y))
        .min_by(f64::total_cmp)
}

/// The grid for people, with rooms, doorways and the way of the sensor.
pub fn picture(grid: &Grid, places: Places, sensors: &[Isometry3<f64>], title: String) -> Canvas {
    let sweeps = sensors.iter().map(|pose| pose.translation.vector.xy().into()).collect();
    let trajectory = sensors.to_vec();
    map_picture::draw(grid, &Overlay { title, trajectory, sweeps, places, ..Overlay::default() })
}
