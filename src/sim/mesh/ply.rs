//! PLY 1.0, ascii and binary little endian: element `vertex` with x, y, z and element `face` with
//! one list of corner indices. Other elements and properties are passed over.

use super::{MeshError, MeshObject, fan};

pub(super) fn read(bytes: &[u8]) -> Result<Vec<MeshObject>, MeshError> {
    let header = Header::read(bytes)?;
    let mut source = Source { header: &header, rest: &bytes[header.length..], words: Vec::new() };
    if header.ascii {
        let text = std::str::from_utf8(source.rest).map_err(|_| {
            MeshError::Unsupported("an ascii PLY holds bytes that are no text".into())
        })?;
        source.words = text.split_ascii_whitespace().rev().collect();
    }
    let mut object = MeshObject::default();
    for element in &header.elements {
        for _ in 0..element.count {
            let mut position = [0.0; 3];
            for property in &element.properties {
                match &property.list_count {
                    None => {
                        let value = source.next(&property.kind)?;
                        if let Some(axis) = ["x", "y", "z"].iter().position(|n| *n == property.name)
                        {
                            position[axis] = value;
                        }
                    }
                    Some(count_kind) => {
                        let count = source.next(count_kind)? as usize;
                        let mut corners = Vec::with_capacity(count.min(64));
                        for _ in 0..count {
                            corners.push(source.next(&property.kind)? as i64);
                        }
                        if element.name == "face" && property.name.starts_with("vertex_ind") {
                            add_face(&mut object, &corners)?;
                        }
                    }
                }
            }
            if element.name == "vertex" {
                object.vertices.push(position);
            }
        }
    }
    Ok(vec![object])
}

fn add_face(object: &mut MeshObject, corners: &[i64]) -> Result<(), MeshError> {
    let count = object.vertices.len();
    let known: Result<Vec<u32>, MeshError> = corners
        .iter()
        .map(|&index| {
            if (0..count as i64).contains(&index) {
                Ok(index as u32)
            } else {
                Err(MeshError::Corner { index, count })
            }
        })
        .collect();
    object.triangles.extend(fan(&known?));
    Ok(())
}

struct Property {
    name: String,
    kind: String,
    list_count: Option<String>,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

struct Header {
    ascii: bool,
    elements: Vec<Element>,
    length: usize,
}

impl Header {
    fn read(bytes: &[u8]) -> Result<Self, MeshError> {
        let mut header = Self { ascii: true, elements: Vec::new(), length: 0 };
        for (at, raw) in bytes.split_inclusive(|b| *b == b'\n').enumerate() {
            header.length += raw.len();
            let line = String::from_utf8_lossy(raw).trim().to_owned();
            let words: Vec<&str> = line.split_whitespace().collect();
            let syntax =
                |expected| MeshError::Syntax { line: at + 1, expected, found: line.clone() };
            match words.as_slice() {
                ["ply"] if at == 0 => {}
                _ if at == 0 => return Err(syntax("ply")),
                ["format", "ascii", _] => header.ascii = true,
                ["format", "binary_little_endian", _] => header.ascii = false,
                ["format", ..] => {
                    return Err(MeshError::Unsupported(format!(
                        "expected format ascii or binary_little_endian, found {line:?}"
                    )));
                }
                ["element", name, count] => header.elements.push(Element {
                    name: (*name).to_owned(),
                    count: count.parse().map_err(|_| syntax("a count"))?,
                    properties: Vec::new(),
                }),
                ["property", rest @ ..] => {
                    let element =
                        header.elements.last_mut().ok_or_else(|| syntax("an element first"))?;
                    element.properties.push(match rest {
                        ["list", count, kind, name] => Property {
                            name: (*name).to_owned(),
                            kind: (*kind).to_owned(),
                            list_count: Some((*count).to_owned()),
                        },
                        [kind, name] => Property {
                            name: (*name).to_owned(),
                            kind: (*kind).to_owned(),
                            list_count: None,
                        },
                        _ => return Err(syntax("property TYPE NAME")),
                    });
                }
                ["end_header"] => return header.checked(),
                _ => {}
            }
        }
        Err(MeshError::Unsupported("expected end_header, found the end of the file".into()))
    }

    /// An element without properties would cost no bytes, so its count could be any number.
    fn checked(self) -> Result<Self, MeshError> {
        match self.elements.iter().find(|element| element.properties.is_empty()) {
            Some(bare) => Err(MeshError::Unsupported(format!(
                "expected properties in element {:?}, found none",
                bare.name
            ))),
            None => Ok(self),
        }
    }
}

struct Source<'a> {
    header: &'a Header,
    rest: &'a [u8],
    /// Words of an ascii body, last one first.
    words: Vec<&'a str>,
}

impl Source<'_> {
    fn next(&mut self, kind: &str) -> Result<f64, MeshError> {
        if self.header.ascii {
            let word = self.words.pop().unwrap_or_default();
            return word
                .parse()
                .map_err(|_| MeshError::Unsupported(format!("expected a number, found {word:?}")));
        }
        let size = match kind {
            "char" | "int8" | "uchar" | "uint8" => 1,
            "short" | "int16" | "ushort" | "uint16" => 2,
            "int" | "int32" | "uint" | "uint32" | "float" | "float32" => 4,
            "double" | "float64" => 8,
            _ => return Err(MeshError::Unsupported(format!("unknown property type {kind:?}"))),
        };
        let Some((raw, rest)) = self.rest.split_at_checked(size) else {
            return Err(MeshError::Truncated { expected: size, found: self.rest.len() });
        };
        self.rest = rest;
        let mut word = [0_u8; 8];
        word[..size].copy_from_slice(raw);
        let [a, b, c, d, ..] = word;
        Ok(match kind {
            "char" | "int8" => f64::from(a as i8),
            "uchar" | "uint8" => f64::from(a),
            "short" | "int16" => f64::from(i16::from_le_bytes([a, b])),
            "ushort" | "uint16" => f64::from(u16::from_le_bytes([a, b])),
            "int" | "int32" => f64::from(i32::from_le_bytes([a, b, c, d])),
            "uint" | "uint32" => f64::from(u32::from_le_bytes([a, b, c, d])),
            "float" | "float32" => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => f64::from_le_bytes(word),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                          property uchar red\nelement face 1\nproperty list uchar int vertex_indices\n\
                          end_header\n";

    #[test]
    fn ascii_and_binary_give_the_same_square() {
        let ascii = format!(
            "ply\nformat ascii 1.0\n{HEADER}0 0 0 9\n1 0 0 9\n1 1 0.5 9\n0 1 0.5 9\n4 0 1 2 3\n"
        );
        let from_ascii = read(ascii.as_bytes()).unwrap();
        let mut binary = format!("ply\nformat binary_little_endian 1.0\n{HEADER}").into_bytes();
        for v in [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, 0.5]] {
            v.iter().for_each(|x| binary.extend(x.to_le_bytes()));
            binary.push(9);
        }
        binary.push(4);
        (0..4_i32).for_each(|i| binary.extend(i.to_le_bytes()));
        let from_binary = read(&binary).unwrap();
        assert_eq!(from_ascii, from_binary);
        assert_eq!(from_ascii[0].triangles, [[0, 1, 2], [0, 2, 3]]);
        let cut = &binary[..binary.len() - 3];
        assert!(matches!(read(cut), Err(MeshError::Truncated { .. })));
    }
}
