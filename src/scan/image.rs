use super::{LaserLine, PointGrid, Return};
use crate::time::Stamp;
use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

/// One row of a [`RangeImage`]: a laser line and where the sensor was when it was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageRow {
    /// Tilt under which the row is filed, in radians; negative looks up (core convention).
    pub tilt_rad: f64,
    /// Standard deviation of that tilt in radians, an error common to the whole row.
    pub tilt_sigma_rad: f64,
    /// Pose of the sensor in the scan frame when the row was taken.
    pub scan_from_sensor: Isometry3<f64>,
    /// Stamp of the line, or `None` where the row is a gap.
    pub stamp: Option<Stamp>,
}

/// Laser lines under successive tilts: an organised 3D scan.
///
/// Rows are in order of acquisition, columns in order of beams. A range is finite for a hit,
/// `+inf` where the beam was fired and nothing came back, NaN where there is no reading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RangeImage {
    /// Pose of the scan frame in the robot frame (`base_link`) at the time of the scan.
    pub robot_from_scan: Isometry3<f64>,
    /// Bearing of each column in radians, left positive.
    pub bearings_rad: Vec<f64>,
    /// Distance from which on the scanner reports no return, in metres.
    pub max_range_m: f64,
    rows: Vec<ImageRow>,
    ranges_m: Vec<f32>,
}

impl RangeImage {
    /// An image without rows.
    pub fn new(robot_from_scan: Isometry3<f64>, bearings_rad: Vec<f64>, max_range_m: f64) -> Self {
        Self { robot_from_scan, bearings_rad, max_range_m, rows: Vec::new(), ranges_m: Vec::new() }
    }

    /// Appends a line as the next row. A line with fewer beams than columns leaves the rest missing;
    /// beams beyond the last column are dropped.
    pub fn push_line(&mut self, row: ImageRow, line: &LaserLine) {
        for column in 0..self.columns() {
            let range = if column < line.len() { line.classify(column) } else { Return::Missing };
            self.ranges_m.push(match range {
                Return::Hit(range) => range as f32,
                Return::Nothing => f32::INFINITY,
                Return::Missing => f32::NAN,
            });
        }
        self.rows.push(row);
    }

    /// Appends a row of which no line could be had.
    pub fn push_gap(&mut self, row: ImageRow) {
        self.ranges_m.extend(std::iter::repeat_n(f32::NAN, self.columns()));
        self.rows.push(ImageRow { stamp: None, ..row });
    }

    /// The rows in order of acquisition.
    pub fn rows(&self) -> &[ImageRow] {
        &self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.bearings_rad.len()
    }

    /// What was measured at a row and column.
    pub fn at(&self, row: usize, column: usize) -> Return {
        let range = self.ranges_m[row * self.columns() + column];
        if range.is_nan() {
            Return::Missing
        } else if range.is_infinite() {
            Return::Nothing
        } else {
            Return::Hit(f64::from(range))
        }
    }

    /// Takes the reading of a row and column for none.
    pub fn forget(&mut self, row: usize, column: usize) {
        let at = row * self.columns() + column;
        self.ranges_m[at] = f32::NAN;
    }

    /// The point `range_m` along the beam of a row and column, in the scan frame.
    pub fn point_at(&self, row: usize, column: usize, range_m: f64) -> Point3<f64> {
        let (sin, cos) = self.bearings_rad[column].sin_cos();
        self.rows[row].scan_from_sensor * Point3::new(range_m * cos, range_m * sin, 0.0)
    }

    /// The measured point of a row and column in the scan frame, if the beam hit something.
    pub fn point(&self, row: usize, column: usize) -> Option<Point3<f64>> {
        match self.at(row, column) {
            Return::Hit(range) => Some(self.point_at(row, column, range)),
            Return::Nothing | Return::Missing => None,
        }
    }

    /// The columns `columns` of all rows, sorted by tilt, as points in the scan frame.
    ///
    /// Sorting undoes the order of acquisition: segmentation needs neighbours in angle, and a sweep
    /// may visit its tilts in any order. Rows of equal tilt keep their order.
    pub fn point_grid(&self, columns: std::ops::Range<usize>) -> PointGrid {
        let columns = columns.start.min(self.columns())..columns.end.min(self.columns());
        let mut order: Vec<usize> = (0..self.rows.len()).collect();
        order.sort_by(|&a, &b| self.rows[a].tilt_rad.total_cmp(&self.rows[b].tilt_rad));
        let sigmas = order.iter().map(|&row| self.rows[row].tilt_sigma_rad as f32).collect();
        let mut points = Vec::with_capacity(order.len() * columns.len());
        let mut ranges_m = Vec::with_capacity(points.capacity());
        for row in order {
            let first = row * self.columns();
            ranges_m.extend_from_slice(&self.ranges_m[first..][columns.clone()]);
            for column in columns.clone() {
                points.push(
                    self.point(row, column)
                        .map_or([f32::NAN; 3], |p| [p.x as f32, p.y as f32, p.z as f32]),
                );
            }
        }
        PointGrid::new(self.rows.len(), columns.len(), points)
            .with_row_sigmas(sigmas)
            .with_ranges(&ranges_m)
    }
}
