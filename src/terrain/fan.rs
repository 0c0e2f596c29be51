//! Rows of one range image that a tilting laser took under one pan: the columns in which ground is
//! sought.

use crate::scan::{RangeImage, Return};
use crate::terrain::config::RobotShape;
use nalgebra::{Isometry3, Point3, Vector3};

/// Rows whose pans differ by less than this belong to one fan.
const SAME_PAN_RAD: f64 = 0.01;

/// What one beam of a fan gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Sample {
    /// A point in the map frame.
    Hit {
        /// The point.
        p: Point3<f64>,
        /// Horizontal distance from the sensor, metres.
        away_m: f64,
    },
    /// Fired, and nothing came back.
    Nothing,
    /// No reading, or a reading of the robot itself.
    Missing,
}

/// One row: where the sensor was and how it looked, in the map frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct FanRow {
    pub origin: Point3<f64>,
    pub forward: Vector3<f64>,
    pub left: Vector3<f64>,
}

impl FanRow {
    pub fn direction(&self, (sin, cos): (f64, f64)) -> Vector3<f64> {
        self.forward * cos + self.left * sin
    }
}

/// Rows of one pan, from the one that looks down most to the one that looks up most.
pub(super) struct Fan {
    pub rows: Vec<FanRow>,
    /// Sine and cosine of each column's bearing.
    pub columns: Vec<(f64, f64)>,
    /// Row by row.
    pub samples: Vec<Sample>,
    pub max_range_m: f64,
}

impl Fan {
    pub fn sample(&self, row: usize, column: usize) -> &Sample {
        &self.samples[row * self.columns.len() + column]
    }

    /// Whether two rows were taken from nearly one place with nearly one pan, so that their columns
    /// lie one above the other.
    pub fn aligned(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.rows[a], &self.rows[b]);
        (a.origin - b.origin).norm() < 0.3 && a.left.dot(&b.left) > 0.9998
    }
}

/// The plane on which the robot stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct FloorPlane {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
}

impl FloorPlane {
    pub fn under(world_from_robot: &Isometry3<f64>, shape: &RobotShape) -> Self {
        Self {
            point: world_from_robot * Point3::new(0.0, 0.0, -shape.base_above_floor_m),
            normal: world_from_robot * Vector3::z(),
        }
    }

    /// Rise per metre along a horizontal direction.
    pub fn slope(&self, along: &Vector3<f64>) -> f64 {
        -(self.normal.x * along.x + self.normal.y * along.y) / self.normal.z.max(0.2)
    }

    pub fn z_at(&self, x: f64, y: f64) -> f64 {
        let from = Vector3::new(x - self.point.x, y - self.point.y, 0.0);
        self.point.z + self.slope(&from)
    }
}

/// Splits an image into its fans, with every point in the map frame.
///
/// Points within the robot's own body are dropped: real scanners see parts of their carrier.
pub(super) fn fans(
    image: &RangeImage,
    world_from_robot: &Isometry3<f64>,
    shape: &RobotShape,
) -> Vec<Fan> {
    let mut order: Vec<(f64, f64, usize)> = image
        .rows()
        .iter()
        .enumerate()
        .filter(|(_, row)| row.stamp.is_some())
        .map(|(index, row)| {
            let left = row.scan_from_sensor * Vector3::y();
            let forward = row.scan_from_sensor * Vector3::x();
            ((-left.x).atan2(left.y), forward.z, index)
        })
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
    let columns: Vec<(f64, f64)> =
        image.bearings_rad.iter().map(|bearing| bearing.sin_cos()).collect();
    let mut fans = Vec::new();
    let mut start = 0;
    for end in 1..=order.len() {
        if end < order.len() && order[end].0 - order[end - 1].0 < SAME_PAN_RAD {
            continue;
        }
        let rows = &mut order[start..end];
        rows.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.2.cmp(&b.2)));
        fans.push(fan(image, world_from_robot, shape, rows, &columns));
        start = end;
    }
    fans
}

fn fan(
    image: &RangeImage,
    world_from_robot: &Isometry3<f64>,
    shape: &RobotShape,
    order: &[(f64, f64, usize)],
    columns: &[(f64, f64)],
) -> Fan {
    let robot_from_world = world_from_robot.inverse();
    let world_from_scan = world_from_robot * image.robot_from_scan;
    let mut rows = Vec::with_capacity(order.len());
    let mut samples = Vec::with_capacity(order.len() * columns.len());
    for &(_, _, index) in order {
        let world_from_sensor = world_from_scan * image.rows()[index].scan_from_sensor;
        let row = FanRow {
            origin: Point3::from(world_from_sensor.translation.vector),
            forward: world_from_sensor * Vector3::x(),
            left: world_from_sensor * Vector3::y(),
        };
        for (column, &bearing) in columns.iter().enumerate() {
            samples.push(match image.at(index, column) {
                Return::Missing => Sample::Missing,
                Return::Nothing => Sample::Nothing,
                Return::Hit(range) => {
                    let ray = row.direction(bearing) * range;
                    let p = row.origin + ray;
                    // Only near points can be on the robot; the test costs a transform.
                    let own = range < 1.0 && within_body(&(robot_from_world * p), shape);
                    if own {
                        Sample::Missing
                    } else {
                        Sample::Hit { p, away_m: ray.x.hypot(ray.y) }
                    }
                }
            });
        }
        rows.push(row);
    }
    Fan { rows, columns: columns.to_vec(), samples, max_range_m: image.max_range_m }
}

fn within_body(p_robot: &Point3<f64>, shape: &RobotShape) -> bool {
    let above_floor_m = p_robot.z + shape.base_above_floor_m;
    p_robot.x.abs() < 0.5 * shape.length_m + 0.02
        && p_robot.y.abs() < 0.5 * shape.width_m + 0.02
        && above_floor_m > shape.max_step_m.max(0.04)
        && above_floor_m < shape.height_m + shape.clearance_m
}
