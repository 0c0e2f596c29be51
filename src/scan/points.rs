//! Range images from organised clouds whose scanner nobody described.

use super::cones::Cones;
use super::{ImageRow, LaserLine, PointGrid, RangeImage};
use crate::time::Stamp;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// A row whose points leave its plane by more than this angle was not scanned in one plane.
const FLAT_RAD: f64 = 0.03;

/// Range that no scanner reaches: a cloud tells only what came back.
const BEYOND_M: f64 = 1e4;

impl RangeImage {
    /// The image of an organised cloud: each row is a plane through the viewpoint, which tilts about
    /// y, and its points lie at their bearings in that plane. Rows and columns may run either way.
    ///
    /// Columns get the median of their bearings, and a point the column that is nearest in bearing,
    /// so that scanners whose columns are not at one bearing in all rows are within half a column.
    /// A cell without a point is [`super::Return::Missing`]: the cloud does not tell whether a beam
    /// was fired there. Rows of fewer than three points, and rows that are no plane, are gaps.
    ///
    /// Where each row is a cone instead, as of a scanner that spins, it is a plane in each of many sectors.
    pub fn of_points(grid: &PointGrid) -> Self {
        if let Some(cones) = Cones::of(grid) {
            return cones.image(grid, BEYOND_M);
        }
        let poses: Vec<Option<Isometry3<f64>>> =
            (0..grid.rows()).map(|row| row_pose(grid, row)).collect();
        let bearing_in = |row: usize, column: usize| {
            let p = poses[row]?.inverse() * grid.point(row, column)?;
            Some(p.y.atan2(p.x))
        };
        let mut bearings_rad = Vec::new();
        for column in 0..grid.columns() {
            let mut seen: Vec<f64> =
                (0..grid.rows()).filter_map(|row| bearing_in(row, column)).collect();
            seen.sort_by(f64::total_cmp);
            bearings_rad.extend(seen.get(seen.len() / 2));
        }
        bearings_rad.sort_by(f64::total_cmp);
        let mut image = Self::new(Isometry3::identity(), bearings_rad.clone(), BEYOND_M);
        for (row, pose) in poses.iter().enumerate() {
            let forward = pose.unwrap_or_default() * Vector3::x();
            let of_row = ImageRow {
                tilt_rad: -forward.z.asin(),
                tilt_sigma_rad: 0.0,
                scan_from_sensor: pose.unwrap_or_default(),
                stamp: Some(Stamp::default()),
            };
            let Some(pose) = pose else {
                image.push_gap(of_row);
                continue;
            };
            let mut ranges_m = vec![f64::NAN; bearings_rad.len()];
            for column in 0..grid.columns() {
                let Some(p) = grid.point(row, column).map(|p| pose.inverse() * p) else { continue };
                let range_m = p.x.hypot(p.y);
                // The nearer of two points in one column hides the other.
                if let Some(place) = nearest(&bearings_rad, p.y.atan2(p.x)) {
                    ranges_m[place] = range_m.min(ranges_m[place]);
                }
            }
            let line = LaserLine {
                stamp: Stamp::default(),
                first_bearing_rad: bearings_rad.first().copied().unwrap_or_default(),
                bearing_step_rad: 0.0,
                min_range_m: 0.0,
                max_range_m: BEYOND_M,
                phantom_m: None,
                ranges_m,
            };
            image.push_line(of_row, &line);
        }
        image
    }
}

/// Place of the value nearest to `bearing_rad` among sorted ones.
fn nearest(bearings_rad: &[f64], bearing_rad: f64) -> Option<usize> {
    let after = bearings_rad.partition_point(|value| *value < bearing_rad);
    [after.checked_sub(1), Some(after)]
        .into_iter()
        .flatten()
        .filter(|place| *place < bearings_rad.len())
        .min_by(|a, b| {
            let off = |place: usize| (bearings_rad[place] - bearing_rad).abs();
            off(*a).total_cmp(&off(*b))
        })
}

/// Pose of the sensor in the cloud's frame for one row: z across the plane of its beams, y left.
fn row_pose(grid: &PointGrid, row: usize) -> Option<Isometry3<f64>> {
    let rays: Vec<Vector3<f64>> = (0..grid.columns())
        .filter_map(|column| grid.point(row, column)?.coords.try_normalize(1e-6))
        .collect();
    if rays.len() < 3 {
        return None;
    }
    let scatter: Matrix3<f64> = rays.iter().map(|ray| ray * ray.transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let normal: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
    let up = if normal.z < 0.0 { -normal } else { normal };
    let flat = rays.iter().map(|ray| ray.dot(&up).powi(2)).sum::<f64>() / rays.len() as f64;
    if flat.sqrt() > FLAT_RAD {
        return None;
    }
    let left = (Vector3::y() - up * up.y).try_normalize(1e-3)?;
    let forward = left.cross(&up);
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[forward, left, up]));
    Some(Isometry3::from_parts(
        Translation3::identity(),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    /// Points of a tilting laser in a room whose walls are bent, with the rows and columns in the
    /// order that is asked for.
    fn cloud(rows_down: bool, columns_left: bool) -> PointGrid {
        let mut points = Vec::new();
        for i in 0..40 {
            let row = f64::from(if rows_down { i } else { 39 - i });
            let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -0.4 + 0.025 * row);
            for k in 0..60 {
                let column = f64::from(if columns_left { k } else { 59 - k });
                let bearing = -1.2 + 0.04 * column;
                let range = 3.0 + (3.0 * bearing).sin() + 0.02 * row;
                let p = tilt * Point3::new(range * bearing.cos(), range * bearing.sin(), 0.0);
                let hit = (i + k) % 7 != 0;
                points.push(if hit { p.coords.map(|v| v as f32).into() } else { [f32::NAN; 3] });
            }
        }
        PointGrid::new(40, 60, points)
    }

    #[test]
    fn the_points_of_a_cloud_come_back_whichever_way_its_rows_and_columns_run() {
        for (rows_down, columns_left) in [(true, true), (true, false), (false, true)] {
            let grid = cloud(rows_down, columns_left);
            let image = RangeImage::of_points(&grid);
            assert_eq!((image.rows().len(), image.columns()), (40, 60));
            for row in 0..40 {
                for column in 0..60 {
                    let own = if columns_left { column } else { 59 - column };
                    let (point, again) = (grid.point(row, column), image.point(row, own));
                    assert_eq!(point.is_some(), again.is_some());
                    if let (Some(point), Some(again)) = (point, again) {
                        assert!((point - again).norm() < 1e-4, "{point} {again}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_row_that_is_neither_plane_nor_cone_is_a_gap() {
        // Nor a cone: every other point is higher.
        let cone = (0..30_u8).map(|i| {
            let (sin, cos) = (0.2 * f32::from(i)).sin_cos();
            [3.0 * cos, 3.0 * sin, 1.5 + 0.5 * f32::from(i % 2)]
        });
        let image = RangeImage::of_points(&PointGrid::new(1, 30, cone.collect()));
        assert!(image.rows()[0].stamp.is_none());
    }
}
