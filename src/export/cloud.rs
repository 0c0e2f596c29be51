//! Points of a map as an unorganised PCD 0.7 cloud.

use nalgebra::Point3;
use std::collections::BTreeMap;

/// Thins points to one in each cube of side `cell_m`: the mean of those in it. The order is that of
/// the cubes.
pub fn thinned(points: impl IntoIterator<Item = Point3<f64>>, cell_m: f64) -> Vec<Point3<f64>> {
    let mut cubes: BTreeMap<[i64; 3], (Point3<f64>, f64)> = BTreeMap::new();
    for point in points {
        let key = [point.x, point.y, point.z].map(|v| (v / cell_m).floor() as i64);
        let (sum, count) = cubes.entry(key).or_insert((Point3::origin(), 0.0));
        *sum += point.coords;
        *count += 1.0;
    }
    cubes.into_values().map(|(sum, count)| Point3::from(sum.coords / count)).collect()
}

/// The points as a binary PCD file: x, y, z in metres, single precision.
pub fn pcd(points: &[Point3<f64>]) -> Vec<u8> {
    let count = points.len();
    let mut bytes = format!(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\n\
         TYPE F F F\nCOUNT 1 1 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {count}\nDATA binary\n"
    )
    .into_bytes();
    for point in points {
        for value in [point.x, point.y, point.z] {
            bytes.extend_from_slice(&(value as f32).to_le_bytes());
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_one_cube_become_their_mean() {
        let points = [
            Point3::new(0.01, 0.01, 0.0),
            Point3::new(0.03, 0.01, 0.0),
            Point3::new(-0.01, 0.01, 0.0),
        ];
        let thin = thinned(points, 0.05);
        assert_eq!(thin.len(), 2);
        assert!((thin[1] - Point3::new(0.02, 0.01, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn the_file_is_header_and_twelve_bytes_a_point() {
        let bytes = pcd(&[Point3::new(1.0, 2.0, -3.0); 2]);
        let text = String::from_utf8_lossy(&bytes);
        assert!(text.contains("WIDTH 2\nHEIGHT 1\n"));
        let data = bytes.windows(12).position(|w| w == b"DATA binary\n").unwrap() + 12;
        assert_eq!(bytes.len() - data, 24);
        assert_eq!(bytes[data..data + 4], 1.0_f32.to_le_bytes());
    }
}
