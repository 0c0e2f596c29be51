//! Wavefront OBJ: `v` and `f` lines, objects by `o` or `g`; all else is passed over.

use super::{MeshError, MeshObject, fan, number};
use std::collections::BTreeMap;

pub(super) fn read(bytes: &[u8]) -> Result<Vec<MeshObject>, MeshError> {
    let text = String::from_utf8_lossy(bytes);
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    let mut faces: Vec<(String, Vec<Vec<u32>>)> = vec![(String::new(), Vec::new())];
    for (at, line) in text.lines().enumerate() {
        let line_number = at + 1;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.first().copied() {
            Some("v") => vertices.push([
                number(&words, 1, line_number)?,
                number(&words, 2, line_number)?,
                number(&words, 3, line_number)?,
            ]),
            Some("o" | "g") => {
                let name = words[1..].join(" ");
                // `o` followed by `g` of the same object must not split it into two.
                if faces.last().is_some_and(|(_, faces)| faces.is_empty()) {
                    faces.pop();
                }
                faces.push((name, Vec::new()));
            }
            Some("f") => {
                let corners: Result<Vec<u32>, MeshError> =
                    words[1..].iter().map(|w| corner(w, vertices.len(), line_number)).collect();
                let corners = corners?;
                if corners.len() < 3 {
                    return Err(MeshError::Syntax {
                        line: line_number,
                        expected: "a face of three corners or more",
                        found: line.to_owned(),
                    });
                }
                faces.last_mut().expect("there is always an object").1.push(corners);
            }
            _ => {}
        }
    }
    Ok(faces.into_iter().map(|(name, faces)| compact(name, &faces, &vertices)).collect())
}

/// `7`, `7/1`, `7//2`, `7/1/2`; 1-based, negative counts from the latest vertex.
fn corner(word: &str, count: usize, line: usize) -> Result<u32, MeshError> {
    let first = word.split('/').next().unwrap_or_default();
    let index: i64 = first.parse().map_err(|_| MeshError::Syntax {
        line,
        expected: "a corner index",
        found: word.to_owned(),
    })?;
    let resolved = if index < 0 { count as i64 + index } else { index - 1 };
    if (0..count as i64).contains(&resolved) {
        Ok(resolved as u32)
    } else {
        Err(MeshError::Corner { index, count })
    }
}

/// The object with only the vertices its own faces use, in order of first use.
fn compact(name: String, faces: &[Vec<u32>], all: &[[f64; 3]]) -> MeshObject {
    let mut object = MeshObject { name, ..MeshObject::default() };
    let mut kept: BTreeMap<u32, u32> = BTreeMap::new();
    for corners in faces {
        let local: Vec<u32> = corners
            .iter()
            .map(|&corner| {
                *kept.entry(corner).or_insert_with(|| {
                    object.vertices.push(all[corner as usize]);
                    object.vertices.len() as u32 - 1
                })
            })
            .collect();
        object.triangles.extend(fan(&local));
    }
    object
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO: &str = "# two objects\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\no floor\ng floor_part\n\
                       f 1/1/1 2//1 3 4\no roof\nv 0 0 2\nv 1 0 2\nv 0 1 2\nusemtl red\nf -3 -2 -1\n";

    #[test]
    fn objects_keep_their_names_and_their_own_corners() {
        let objects = read(TWO.as_bytes()).unwrap();
        assert_eq!(objects.len(), 2);
        assert_eq!(objects[0].name, "floor_part");
        assert_eq!(objects[0].triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(objects[1].name, "roof");
        assert_eq!(objects[1].vertices[0], [0.0, 0.0, 2.0]);
        assert_eq!(objects[1].triangles, [[0, 1, 2]]);
    }

    #[test]
    fn a_corner_that_does_not_exist_is_named() {
        let error = read(b"v 0 0 0\nf 1 2 3\n").unwrap_err();
        assert_eq!(error, MeshError::Corner { index: 2, count: 1 });
    }
}
