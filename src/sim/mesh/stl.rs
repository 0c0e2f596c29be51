//! STL, text and binary. The text form names its solids; the binary form is one nameless object.

use super::{MeshError, MeshObject, number};

const HEADER: usize = 84;
const FACET: usize = 50;

pub(super) fn read(bytes: &[u8]) -> Result<Vec<MeshObject>, MeshError> {
    // Binary files may begin with "solid" too, so their own facet count decides.
    match announced_length(bytes) {
        Some(expected) if expected == bytes.len() => Ok(vec![binary(bytes)]),
        _ if bytes.trim_ascii_start().starts_with(b"solid") => text(bytes),
        Some(expected) => Err(MeshError::Truncated { expected, found: bytes.len() }),
        None => Err(MeshError::Truncated { expected: HEADER, found: bytes.len() }),
    }
}

fn announced_length(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(80..HEADER)?.try_into().ok().map(u32::from_le_bytes)?;
    Some(HEADER + count as usize * FACET)
}

fn binary(bytes: &[u8]) -> MeshObject {
    let mut object = MeshObject::default();
    for facet in bytes[HEADER..].chunks_exact(FACET) {
        let first = object.vertices.len() as u32;
        for corner in facet[12..48].chunks_exact(12) {
            let coordinate = |axis: usize| {
                let raw = &corner[4 * axis..4 * axis + 4];
                f64::from(f32::from_le_bytes([raw[0], raw[1], raw[2], raw[3]]))
            };
            object.vertices.push([coordinate(0), coordinate(1), coordinate(2)]);
        }
        object.triangles.push([first, first + 1, first + 2]);
    }
    object
}

fn text(bytes: &[u8]) -> Result<Vec<MeshObject>, MeshError> {
    let text = String::from_utf8_lossy(bytes);
    let mut objects: Vec<MeshObject> = Vec::new();
    for (at, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.first().copied() {
            Some("solid") => {
                objects.push(MeshObject { name: words[1..].join(" "), ..MeshObject::default() });
            }
            Some("vertex") => {
                let corner = [
                    number(&words, 1, at + 1)?,
                    number(&words, 2, at + 1)?,
                    number(&words, 3, at + 1)?,
                ];
                if let Some(object) = objects.last_mut() {
                    object.vertices.push(corner);
                }
            }
            _ => {}
        }
    }
    for object in &mut objects {
        let count = object.vertices.len() as u32 / 3;
        object.triangles = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    }
    Ok(objects)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_binary_give_the_same_triangle() {
        let text = b"solid wall\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 2 0 0\n\
                     vertex 0 1.5 0\nendloop\nendfacet\nendsolid wall\n";
        let from_text = read(text).unwrap();
        let mut bytes = vec![b' '; 80];
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend([0_u8; 12]);
        for value in [0.0_f32, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.5, 0.0] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([0_u8; 2]);
        let from_binary = read(&bytes).unwrap();
        assert_eq!(from_text[0].name, "wall");
        assert_eq!(from_text[0].vertices, from_binary[0].vertices);
        assert_eq!(from_text[0].triangles, from_binary[0].triangles);
    }

    #[test]
    fn a_binary_file_cut_short_says_both_lengths() {
        let mut bytes = vec![0_u8; 84];
        bytes[80] = 2;
        assert_eq!(read(&bytes), Err(MeshError::Truncated { expected: 184, found: 84 }));
    }
}
