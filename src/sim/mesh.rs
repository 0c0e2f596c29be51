//! Triangle files as bytes (OBJ, STL, PLY) to named objects.

mod obj;
mod ply;
mod stl;

/// One named object of a triangle file, in the file's own units and axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshObject {
    /// The object's name in the file, empty where the format or the file gives none.
    pub name: String,
    /// Corners.
    pub vertices: Vec<[f64; 3]>,
    /// Corner indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Why a triangle file could not be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// The name's ending tells no format.
    #[error("expected a file ending in .obj, .stl or .ply, found {0:?}")]
    UnknownFormat(String),
    /// A line or field of a text format makes no sense.
    #[error("line {line}: expected {expected}, found {found:?}")]
    Syntax {
        /// 1-based line number.
        line: usize,
        /// What should have stood there.
        expected: &'static str,
        /// What stood there.
        found: String,
    },
    /// A binary file ends before its own counts say.
    #[error("expected {expected} bytes, found {found}")]
    Truncated {
        /// Bytes that the header announces.
        expected: usize,
        /// Bytes there are.
        found: usize,
    },
    /// A face names a corner that does not exist.
    #[error("a face names corner {index} of {count}")]
    Corner {
        /// The index as resolved.
        index: i64,
        /// How many corners there are.
        count: usize,
    },
    /// The header asks for something this reader does not know.
    #[error("{0}")]
    Unsupported(String),
    /// Nothing in the file has a surface.
    #[error("expected triangles, found none")]
    Empty,
}

/// Reads the triangles of a file whose `name` tells its format.
///
/// Degenerate triangles are dropped, polygons are cut into fans.
pub fn read_mesh(name: &str, bytes: &[u8]) -> Result<Vec<MeshObject>, MeshError> {
    let ending = name.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
    let mut objects = match ending.as_deref() {
        Some("obj") => obj::read(bytes)?,
        Some("stl") => stl::read(bytes)?,
        Some("ply") => ply::read(bytes)?,
        _ => return Err(MeshError::UnknownFormat(name.to_owned())),
    };
    for object in &mut objects {
        let vertices = &object.vertices;
        object.triangles.retain(|corners| double_area(vertices, corners) > 1e-12);
    }
    objects.retain(|object| !object.triangles.is_empty());
    if objects.is_empty() { Err(MeshError::Empty) } else { Ok(objects) }
}

fn double_area(vertices: &[[f64; 3]], corners: &[u32; 3]) -> f64 {
    let [a, b, c] = corners.map(|i| nalgebra::Vector3::from(vertices[i as usize]));
    (b - a).cross(&(c - a)).norm()
}

/// Cuts a convex polygon into the triangles of a fan.
fn fan(corners: &[u32]) -> impl Iterator<Item = [u32; 3]> + '_ {
    corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]])
}

/// The number at `index` of a text line.
fn number(words: &[&str], index: usize, line: usize) -> Result<f64, MeshError> {
    let word = words.get(index).copied().unwrap_or_default();
    word.parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(|| MeshError::Syntax {
        line,
        expected: "a finite number",
        found: word.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_ending_is_refused_by_name() {
        let error = read_mesh("debris.fbx", b"").unwrap_err();
        assert_eq!(error, MeshError::UnknownFormat("debris.fbx".to_owned()));
    }

    #[test]
    fn a_file_without_a_surface_is_an_error() {
        assert_eq!(
            read_mesh("a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"),
            Err(MeshError::Empty)
        );
    }
}
