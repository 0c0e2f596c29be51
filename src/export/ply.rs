//! Polygons as ASCII PLY, one face a polygon, a colour per vertex.

use nalgebra::Point3;
use std::fmt::Write;

/// A flat polygon and its colour.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// Vertices in order around the polygon, in metres.
    pub vertices: Vec<Point3<f64>>,
    /// Red, green, blue.
    pub colour: [u8; 3],
}

/// The polygons as a PLY text; those with fewer than three vertices are left out.
pub fn format(polygons: &[Polygon]) -> String {
    let faces: Vec<&Polygon> = polygons.iter().filter(|p| p.vertices.len() >= 3).collect();
    let vertices: usize = faces.iter().map(|p| p.vertices.len()).sum();
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        faces.len()
    );
    for polygon in &faces {
        let [r, g, b] = polygon.colour;
        for p in &polygon.vertices {
            writeln!(text, "{:.4} {:.4} {:.4} {r} {g} {b}", p.x, p.y, p.z)
                .expect("writing to a String cannot fail");
        }
    }
    let mut first = 0;
    for polygon in &faces {
        write!(text, "{}", polygon.vertices.len()).expect("writing to a String cannot fail");
        for index in first..first + polygon.vertices.len() {
            write!(text, " {index}").expect("writing to a String cannot fail");
        }
        text.push('\n');
        first += polygon.vertices.len();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_index_their_own_vertices() {
        let triangle = |x: f64| Polygon {
            vertices: vec![
                Point3::new(x, 0.0, 0.0),
                Point3::new(x, 1.0, 0.0),
                Point3::new(x, 0.0, 1.0),
            ],
            colour: [1, 2, 3],
        };
        let empty = Polygon { vertices: Vec::new(), colour: [0; 3] };
        let text = format(&[triangle(0.0), empty, triangle(5.0)]);
        assert!(text.contains("element vertex 6\n") && text.contains("element face 2\n"));
        assert!(text.ends_with("3 0 1 2\n3 3 4 5\n"));
    }
}
