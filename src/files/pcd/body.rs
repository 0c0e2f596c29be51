//! The points behind a PCD header, in its three encodings.

use super::{Encoding, Field, Header, Kind, PcdError, lzf};
use std::io::Write as _;

pub(super) fn read_points(header: &Header, body: &[u8]) -> Result<Vec<[f32; 3]>, PcdError> {
    match header.encoding {
        Encoding::Ascii => read_ascii(header, body),
        Encoding::Binary => read_binary(header, body),
        Encoding::BinaryCompressed => read_compressed(header, body),
    }
}

/// Fails unless `body` has the bytes that the header calls for, so that nothing larger than the
/// file is ever allocated.
fn check_length(header: &Header, body: &[u8], expected: usize) -> Result<(), PcdError> {
    if body.len() < expected {
        let encoding = header.encoding.name();
        return Err(PcdError::Truncated { encoding, expected, found: body.len() });
    }
    Ok(())
}

/// Bytes of all points without compression; more than any file where the product overflows.
fn announced_bytes(header: &Header) -> usize {
    header.points().saturating_mul(header.record_bytes)
}

fn read_ascii(header: &Header, body: &[u8]) -> Result<Vec<[f32; 3]>, PcdError> {
    // A value takes a digit and a separator, but for the last, which may end the file.
    let values = header.points().saturating_mul(header.record_values);
    check_length(header, body, values.saturating_mul(2).saturating_sub(1))?;
    let fields = header.record_values;
    let wanted = header.xyz.map(|i| header.fields[i].index);
    let mut words = body.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
    let mut points = Vec::with_capacity(header.points());
    for point in 0..header.points() {
        let mut xyz = [f32::NAN; 3];
        for field in 0..fields {
            let word = words.next().unwrap_or_default();
            let wrong = || PcdError::Text {
                point,
                field,
                fields,
                found: String::from_utf8_lossy(word).chars().take(40).collect(),
            };
            if word.is_empty() {
                return Err(wrong());
            }
            if let Some(axis) = wanted.iter().position(|&index| index == field) {
                let number = std::str::from_utf8(word).ok().and_then(|text| text.parse().ok());
                xyz[axis] = number.ok_or_else(wrong)?;
            }
        }
        points.push(xyz);
    }
    Ok(points)
}

fn read_binary(header: &Header, body: &[u8]) -> Result<Vec<[f32; 3]>, PcdError> {
    let length = announced_bytes(header);
    check_length(header, body, length)?;
    let fields = header.xyz.map(|i| &header.fields[i]);
    Ok(body[..length]
        .chunks_exact(header.record_bytes.max(1))
        .map(|record| fields.map(|field| value(&record[field.offset..], field)))
        .collect())
}

fn read_compressed(header: &Header, body: &[u8]) -> Result<Vec<[f32; 3]>, PcdError> {
    check_length(header, body, 8)?;
    let size = |at: usize| {
        u32::from_le_bytes([body[at], body[at + 1], body[at + 2], body[at + 3]]) as usize
    };
    let (packed, unpacked) = (size(0), size(4));
    check_length(header, body, 8 + packed)?;
    let block = &body[8..8 + packed];
    if unpacked != announced_bytes(header) {
        return Err(PcdError::Compressed {
            reason: "the uncompressed size is not that of the announced points",
            at: 0,
            length: packed,
        });
    }
    let columns = lzf::decompress(block, unpacked)
        .map_err(|(reason, at)| PcdError::Compressed { reason, at, length: packed })?;
    let points = header.points();
    let fields = header.xyz.map(|i| &header.fields[i]);
    // Field after field: the values of one field of all points stand together.
    let at = |field: &Field, point: usize| {
        value(&columns[field.offset * points + point * field.size..], field)
    };
    Ok((0..points).map(|point| fields.map(|field| at(field, point))).collect())
}

/// The value at the beginning of `bytes`, as the 32-bit float nearest to it.
fn value(bytes: &[u8], field: &Field) -> f32 {
    let mut raw = [0_u8; 8];
    raw[..field.size].copy_from_slice(&bytes[..field.size]);
    let unsigned = u64::from_le_bytes(raw);
    match (field.kind, field.size) {
        (Kind::Float, 4) => f32::from_bits(unsigned as u32),
        (Kind::Float, _) => f64::from_bits(unsigned) as f32,
        (Kind::Unsigned, _) => unsigned as f32,
        (Kind::Signed, size) => {
            let shift = 64 - 8 * size as u32;
            (((unsigned << shift) as i64) >> shift) as f32
        }
    }
}

pub(super) fn write_points(points: &[[f32; 3]], encoding: Encoding, bytes: &mut Vec<u8>) {
    match encoding {
        Encoding::Ascii => {
            for [x, y, z] in points {
                if [x, y, z].iter().all(|v| v.is_finite()) {
                    writeln!(bytes, "{x} {y} {z}").expect("writing to memory does not fail");
                } else {
                    bytes.extend_from_slice(b"nan nan nan\n");
                }
            }
        }
        Encoding::Binary => {
            bytes.extend(points.iter().flatten().flat_map(|value| value.to_le_bytes()));
        }
        Encoding::BinaryCompressed => {
            let columns: Vec<u8> = (0..3)
                .flat_map(|axis| points.iter().flat_map(move |point| point[axis].to_le_bytes()))
                .collect();
            let packed = lzf::compress(&columns);
            for size in [packed.len(), columns.len()] {
                let size = u32::try_from(size).expect("a grid of less than 4 GiB");
                bytes.extend_from_slice(&size.to_le_bytes());
            }
            bytes.extend_from_slice(&packed);
        }
    }
}
