//! Range images from clouds of a scanner that spins about its own z axis: each row is a cone, all columns of which
//! look equally far up, and not the plane of a laser that is tilted.
//!
//! A narrow sector of a cone is as good as a plane: the cloud is taken for as many tilting scans, side by side, as
//! it has sectors.

use super::{ImageRow, LaserLine, PointGrid, RangeImage};
use crate::time::Stamp;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

/// Width of a sector, in radians: at 30° down its middle is 0.03° off the plane through its sides.
const SECTOR_RAD: f64 = 0.1;
/// What the elevations in a row may differ by, in radians, and how much of its points may differ by more.
const LEVEL_RAD: f64 = 0.005;
const STRAY_SHARE: f64 = 0.1;
/// Share of the rows with points that must be cones.
const LEAST_ROWS: f64 = 0.8;

/// A cloud of cones: the elevation of each row and the azimuth of each column, in radians.
pub(super) struct Cones {
    rows_rad: Vec<Option<f64>>,
    columns_rad: Vec<Option<f64>>,
}

impl Cones {
    /// `None` for a cloud whose rows are no cones.
    pub(super) fn of(grid: &PointGrid) -> Option<Self> {
        let points_in = |row: usize| (0..grid.columns()).filter_map(move |c| grid.point(row, c));
        let (mut with_points, mut cones) = (0, 0);
        let mut rows_rad = Vec::with_capacity(grid.rows());
        for row in 0..grid.rows() {
            let mut elevations: Vec<f64> = points_in(row).map(|p| elevation_rad(&p)).collect();
            let Some(middle) = median(&mut elevations) else {
                rows_rad.push(None);
                continue;
            };
            with_points += 1;
            let stray = elevations.iter().filter(|it| (*it - middle).abs() > LEVEL_RAD).count();
            let is_cone = stray as f64 <= STRAY_SHARE * elevations.len() as f64;
            cones += usize::from(is_cone);
            rows_rad.push(is_cone.then_some(middle));
        }
        if cones == 0 || (cones as f64) < LEAST_ROWS * f64::from(with_points) {
            return None;
        }
        let columns_rad = (0..grid.columns()).map(|column| {
            let points = (0..grid.rows()).filter_map(|row| grid.point(row, column));
            // About a mean direction, that a column behind the scanner is not at both ends of the circle.
            let (sin, cos) = points.fold((0.0, 0.0), |(sin, cos), p| {
                let away_m = p.x.hypot(p.y).max(1e-6);
                (sin + p.y / away_m, cos + p.x / away_m)
            });
            (sin != 0.0 || cos != 0.0).then(|| f64::atan2(sin, cos))
        });
        let columns_rad = columns_rad.collect();
        Some(Self { rows_rad, columns_rad })
    }

    /// The image: a row for each row of the cloud in each of its sectors.
    pub(super) fn image(&self, grid: &PointGrid, beyond_m: f64) -> RangeImage {
        let mut columns: Vec<(f64, usize)> = (0..grid.columns())
            .filter_map(|column| Some((self.columns_rad[column]?, column)))
            .collect();
        columns.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut steps: Vec<f64> = columns.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        let pitch_rad = median(&mut steps).unwrap_or(SECTOR_RAD).max(1e-4);
        let beams = (SECTOR_RAD / pitch_rad).ceil().max(1.0) as usize;
        let first_rad = -0.5 * pitch_rad * (beams - 1) as f64;
        let bearings_rad: Vec<f64> =
            (0..beams).map(|beam| first_rad + pitch_rad * beam as f64).collect();
        let mut image = RangeImage::new(Isometry3::identity(), bearings_rad, beyond_m);
        for sector in sectors(&columns, pitch_rad, beams) {
            let pan_rad = sector[0].0 - first_rad;
            for (row, elevation_rad) in self.rows_rad.iter().enumerate() {
                let Some(elevation_rad) = *elevation_rad else { continue };
                let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pan_rad)
                    * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -elevation_rad);
                let of_row = ImageRow {
                    tilt_rad: -elevation_rad,
                    tilt_sigma_rad: 0.0,
                    scan_from_sensor: Isometry3::from_parts(Translation3::identity(), rotation),
                    stamp: Some(Stamp::default()),
                };
                let mut ranges_m = vec![f64::NAN; beams];
                for &(_, column) in sector {
                    let Some(p) = grid.point(row, column) else { continue };
                    let p = rotation.inverse() * p;
                    let beam = ((p.y.atan2(p.x) - first_rad) / pitch_rad).round();
                    let beam = beam.clamp(0.0, (beams - 1) as f64) as usize;
                    // The nearer of two points in one beam hides the other.
                    ranges_m[beam] = p.coords.norm().min(ranges_m[beam]);
                }
                let line = LaserLine {
                    stamp: Stamp::default(),
                    first_bearing_rad: first_rad,
                    bearing_step_rad: pitch_rad,
                    min_range_m: 0.0,
                    max_range_m: beyond_m,
                    phantom_m: None,
                    ranges_m,
                };
                image.push_line(of_row, &line);
            }
        }
        image
    }
}

/// Columns by azimuth in groups of at most so many that lie side by side.
fn sectors(columns: &[(f64, usize)], pitch_rad: f64, beams: usize) -> Vec<&[(f64, usize)]> {
    let beside = columns.chunk_by(|a, b| b.0 - a.0 < 1.5 * pitch_rad);
    beside.flat_map(|columns| columns.chunks(beams)).collect()
}

fn elevation_rad(p: &Point3<f64>) -> f64 {
    p.z.atan2(p.x.hypot(p.y))
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A spinning scanner 1 m above a floor, in the middle of a round room of 6 m: NaN for nothing.
    fn spun(whole_turn: bool) -> PointGrid {
        let (rows, columns) = (30, 180);
        let width_rad = if whole_turn { std::f64::consts::TAU } else { 2.0 };
        let mut points = Vec::new();
        for row in 0..rows {
            let elevation = 0.2 - 0.02 * f64::from(row);
            for column in 0..columns {
                let azimuth = width_rad * (f64::from(column) / f64::from(columns) - 0.5);
                let away =
                    if elevation < 0.0 { f64::min(6.0, -1.0 / elevation.tan()) } else { 6.0 };
                let p = [away * azimuth.cos(), away * azimuth.sin(), away * elevation.tan()];
                let hit = (row + column) % 11 != 0;
                points.push(if hit { p.map(|v| v as f32) } else { [f32::NAN; 3] });
            }
        }
        PointGrid::new(rows as usize, columns as usize, points)
    }

    #[test]
    fn every_point_of_a_spinning_scanner_is_in_the_image_where_it_was() {
        for whole_turn in [true, false] {
            let grid = spun(whole_turn);
            let image = Cones::of(&grid).expect("rows are cones").image(&grid, 1e4);
            let all = |rows: usize, columns: usize| {
                (0..rows).flat_map(move |row| (0..columns).map(move |column| (row, column)))
            };
            let seen: Vec<Point3<f64>> = all(image.rows().len(), image.columns())
                .filter_map(|(row, column)| image.point(row, column))
                .collect();
            let given: Vec<Point3<f64>> = all(grid.rows(), grid.columns())
                .filter_map(|(row, column)| grid.point(row, column))
                .collect();
            assert!(
                seen.len() as f64 > 0.97 * given.len() as f64,
                "{} {}",
                seen.len(),
                given.len()
            );
            for p in &given {
                let near = seen.iter().map(|q| (p - q).norm()).fold(f64::INFINITY, f64::min);
                assert!(near < 0.015 * p.coords.norm() + 0.01, "{p}: {near} m");
                let same_height = seen.iter().filter(|q| (p - *q).norm() < 0.3);
                let off_m = same_height.map(|q| (p.z - q.z).abs()).fold(f64::INFINITY, f64::min);
                assert!(off_m < 0.005, "{p}: {off_m} m higher or lower");
            }
        }
    }

    #[test]
    fn the_rows_of_a_tilting_laser_are_no_cones() {
        let mut points = Vec::new();
        for row in 0..30 {
            let tilt =
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.4 - 0.02 * f64::from(row));
            for column in 0..60 {
                let (sin, cos) = (0.04 * (f64::from(column) - 29.5)).sin_cos();
                points.push(
                    (tilt * Point3::new(4.0 * cos, 4.0 * sin, 0.0)).coords.map(|v| v as f32).into(),
                );
            }
        }
        assert!(Cones::of(&PointGrid::new(30, 60, points)).is_none());
    }
}
