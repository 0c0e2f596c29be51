//! PCD 0.7: organised clouds in and out.
//!
//! A header of text lines (`FIELDS x y z`, `SIZE`, `TYPE`, `COUNT`, `WIDTH`, `HEIGHT`, `VIEWPOINT`,
//! `POINTS`, `DATA`) is followed by the points: as text (`ascii`), record after record in little
//! endian (`binary`), or field after field and then LZF-compressed behind two 32-bit sizes
//! (`binary_compressed`). Fields other than x, y and z are passed over.
//!
//! A header can claim any size; every claim is held against the bytes that are there before
//! anything is allocated.

mod body;
mod lzf;

use crate::scan::PointGrid;
use std::fmt::Write as _;

/// Longest header that is looked at, in bytes: an honest one has a few hundred.
const MAX_HEADER_BYTES: usize = 64 * 1024;

/// Why a file is not a PCD cloud that can be used.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PcdError {
    /// The header does not come to its `DATA` line.
    #[error("no DATA line within the first {searched} bytes: not a PCD file")]
    NoData {
        /// How many bytes were searched.
        searched: usize,
    },
    /// A header line that every PCD file has is absent.
    #[error("the header has no {key} line")]
    Missing {
        /// The key of the line.
        key: &'static str,
    },
    /// A header line says something that it cannot say.
    #[error("header line {line}: {key} is `{found}`, expected {expected}")]
    Header {
        /// Line number, from 1.
        line: usize,
        /// The key of the line.
        key: String,
        /// What stands there.
        found: String,
        /// What may stand there.
        expected: String,
    },
    /// One of x, y, z is not among the fields.
    #[error("no field `{name}` among FIELDS {fields}")]
    NoField {
        /// The missing field.
        name: &'static str,
        /// The fields that there are.
        fields: String,
    },
    /// Two header lines contradict one another.
    #[error("WIDTH {width} x HEIGHT {height} is not POINTS {points}")]
    Size {
        /// Value of `WIDTH`.
        width: usize,
        /// Value of `HEIGHT`.
        height: usize,
        /// Value of `POINTS`.
        points: usize,
    },
    /// Fewer bytes follow the header than it announces.
    #[error("truncated: {expected} bytes of {encoding} data announced, {found} found")]
    Truncated {
        /// The encoding named by `DATA`.
        encoding: &'static str,
        /// Least number of bytes that the header calls for.
        expected: usize,
        /// Number of bytes after the header.
        found: usize,
    },
    /// A text record is short or holds something that is no number.
    #[error("point {point}: `{found}` where field {field} of {fields} should be")]
    Text {
        /// Index of the point, from 0.
        point: usize,
        /// Index of the value in its record, from 0.
        field: usize,
        /// Values in a record.
        fields: usize,
        /// What stands there; empty at the end of the data.
        found: String,
    },
    /// The compressed block does not decompress to what the header announces.
    #[error("compressed data: {reason} at byte {at} of {length}")]
    Compressed {
        /// What is wrong.
        reason: &'static str,
        /// Where in the compressed block.
        at: usize,
        /// Length of the compressed block in bytes.
        length: usize,
    },
    /// The cloud is a list of points, not a grid.
    #[error(
        "the cloud is not organised: HEIGHT is {height} and WIDTH {width}, expected HEIGHT > 1 and WIDTH > 0"
    )]
    Unorganised {
        /// Value of `HEIGHT`.
        height: usize,
        /// Value of `WIDTH`.
        width: usize,
    },
}

/// A cloud as it stands in a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Points in a row.
    pub width: usize,
    /// Number of rows; 1 for a cloud without order.
    pub height: usize,
    /// Pose of the sensor when the cloud was taken: translation in metres, then quaternion w x y z.
    /// The points are in the sensor's frame already; this says where that frame was.
    pub viewpoint: [f64; 7],
    /// Points in metres, row by row; NaN where there was no return.
    pub points: Vec<[f32; 3]>,
}

impl Cloud {
    /// The cloud as a grid of `height` rows and `width` columns.
    ///
    /// # Errors
    ///
    /// [`PcdError::Unorganised`] when it has fewer than two rows, or no columns.
    pub fn into_grid(self) -> Result<PointGrid, PcdError> {
        if self.height < 2 || self.width == 0 {
            return Err(PcdError::Unorganised { height: self.height, width: self.width });
        }
        Ok(PointGrid::new(self.height, self.width, self.points))
    }
}

/// How the points are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Text, one point a line.
    Ascii,
    /// Little-endian records.
    Binary,
    /// Little-endian field by field, LZF-compressed.
    BinaryCompressed,
}

impl Encoding {
    fn name(self) -> &'static str {
        match self {
            Encoding::Ascii => "ascii",
            Encoding::Binary => "binary",
            Encoding::BinaryCompressed => "binary_compressed",
        }
    }
}

/// Type of one field's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Float,
    Signed,
    Unsigned,
}

/// One field of a record.
#[derive(Clone, Debug)]
struct Field {
    kind: Kind,
    /// Bytes of one value.
    size: usize,
    /// Values of this field in a record.
    count: usize,
    /// Byte at which the field begins in a record.
    offset: usize,
    /// Values before it in a record.
    index: usize,
}

/// What the header says, checked against itself.
#[derive(Clone, Debug)]
struct Header {
    width: usize,
    height: usize,
    viewpoint: [f64; 7],
    fields: Vec<Field>,
    /// Positions of x, y and z in `fields`.
    xyz: [usize; 3],
    record_bytes: usize,
    record_values: usize,
    encoding: Encoding,
    /// Where the data begin.
    body_at: usize,
}

impl Header {
    fn points(&self) -> usize {
        self.width * self.height
    }
}

/// Reads a PCD file that lies in memory. Bytes beyond the announced points are ignored.
///
/// # Errors
///
/// The first thing that is wrong, with what was found and what was expected.
pub fn read_pcd(bytes: &[u8]) -> Result<Cloud, PcdError> {
    let header = read_header(bytes)?;
    let points = body::read_points(&header, &bytes[header.body_at..])?;
    Ok(Cloud { width: header.width, height: header.height, viewpoint: header.viewpoint, points })
}

/// A header line as found: its number and the words after the key.
struct Line<'a> {
    number: usize,
    key: &'static str,
    words: Vec<&'a str>,
}

impl Line<'_> {
    fn error(&self, expected: impl Into<String>) -> PcdError {
        PcdError::Header {
            line: self.number,
            key: self.key.to_owned(),
            found: self.words.join(" ").chars().take(60).collect(),
            expected: expected.into(),
        }
    }

    fn number(&self) -> Result<usize, PcdError> {
        match self.words[..] {
            [word] => word.parse().map_err(|_| self.error("a whole number")),
            _ => Err(self.error("one whole number")),
        }
    }

    /// As many positive numbers as there are fields.
    fn sizes(&self, fields: usize, allowed: &[usize]) -> Result<Vec<usize>, PcdError> {
        if self.words.len() != fields {
            return Err(self.error(format!("{fields} numbers, one for each field")));
        }
        let numbers: Option<Vec<usize>> = self.words.iter().map(|word| word.parse().ok()).collect();
        numbers
            .filter(|all| allowed.is_empty() || all.iter().all(|n| allowed.contains(n)))
            .ok_or_else(|| self.error(format!("whole numbers{}", listed(allowed))))
    }
}

fn listed(allowed: &[usize]) -> String {
    if allowed.is_empty() {
        return String::new();
    }
    let all: Vec<String> = allowed.iter().map(ToString::to_string).collect();
    format!(" out of {}", all.join(", "))
}

const KEYS: [&str; 10] = [
    "VERSION",
    "FIELDS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
];

fn read_header(bytes: &[u8]) -> Result<Header, PcdError> {
    let (lines, body_at) = header_lines(bytes)?;
    let find = |key: &'static str| lines.iter().find(|line| line.key == key);
    let need = |key: &'static str| find(key).ok_or(PcdError::Missing { key });

    let names = need("FIELDS")?;
    let fields = read_fields(names, need("SIZE")?, need("TYPE")?, find("COUNT"))?;
    let position = |name: &'static str| {
        names.words.iter().position(|word| *word == name).ok_or_else(|| PcdError::NoField {
            name,
            fields: names.words.join(" ").chars().take(60).collect(),
        })
    };
    let xyz = [position("x")?, position("y")?, position("z")?];
    if let Some(field) = xyz.iter().map(|&i| &fields[i]).find(|field| field.count != 1) {
        let line = find("COUNT").expect("a count other than the default 1 was read from its line");
        return Err(line.error(format!("1 for x, y and z, not {}", field.count)));
    }

    let (width, height) = (need("WIDTH")?.number()?, need("HEIGHT")?.number()?);
    let points = find("POINTS").map_or(Ok(width.saturating_mul(height)), Line::number)?;
    if width.checked_mul(height) != Some(points) {
        return Err(PcdError::Size { width, height, points });
    }
    let data = need("DATA")?;
    let encoding = match data.words[..] {
        ["ascii"] => Encoding::Ascii,
        ["binary"] => Encoding::Binary,
        ["binary_compressed"] => Encoding::BinaryCompressed,
        _ => return Err(data.error("ascii, binary or binary_compressed")),
    };
    Ok(Header {
        width,
        height,
        viewpoint: find("VIEWPOINT").map_or(Ok([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), viewpoint)?,
        record_bytes: fields.iter().map(|field| field.size * field.count).sum(),
        record_values: fields.iter().map(|field| field.count).sum(),
        fields,
        xyz,
        encoding,
        body_at,
    })
}

/// The header cut into lines, and where the data begin. Unknown keys and comments are passed over.
fn header_lines(bytes: &[u8]) -> Result<(Vec<Line<'_>>, usize), PcdError> {
    let head = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    let mut lines: Vec<Line> = Vec::new();
    let mut at = 0;
    let mut number = 0;
    while at < head.len() {
        let end = memchr::memchr(b'\n', &head[at..]).map_or(head.len(), |length| at + length);
        number += 1;
        let text = std::str::from_utf8(&head[at..end]).unwrap_or_default();
        at = (end + 1).min(bytes.len());
        let mut words = text.split_ascii_whitespace();
        let Some(key) = words.next().and_then(|word| KEYS.into_iter().find(|key| *key == word))
        else {
            continue;
        };
        let line = Line { number, key, words: words.collect() };
        if lines.iter().any(|earlier| earlier.key == key) {
            return Err(line.error("given once"));
        }
        lines.push(line);
        if key == "DATA" {
            return Ok((lines, at));
        }
    }
    Err(PcdError::NoData { searched: head.len() })
}

fn read_fields(
    names: &Line,
    size: &Line,
    kind: &Line,
    count: Option<&Line>,
) -> Result<Vec<Field>, PcdError> {
    let number = names.words.len();
    let sizes = size.sizes(number, &[1, 2, 4, 8])?;
    let counts = count.map_or(Ok(vec![1; number]), |line| line.sizes(number, &[]))?;
    if kind.words.len() != number {
        return Err(kind.error(format!("{number} letters, one for each field")));
    }
    let mut fields = Vec::with_capacity(number);
    let (mut offset, mut index) = (0_usize, 0_usize);
    for i in 0..number {
        let kind = match (kind.words[i], sizes[i]) {
            ("F", 4 | 8) => Kind::Float,
            ("I", _) => Kind::Signed,
            ("U", _) => Kind::Unsigned,
            _ => return Err(kind.error("F (of size 4 or 8), I or U for each field")),
        };
        fields.push(Field { kind, size: sizes[i], count: counts[i], offset, index });
        let next = sizes[i].checked_mul(counts[i]).and_then(|bytes| offset.checked_add(bytes));
        let (Some(next_offset), Some(line)) = (next, count.or(Some(size))) else {
            return Err(size.error("records of a size that memory can hold"));
        };
        if next_offset > MAX_RECORD_BYTES {
            return Err(line.error(format!("records of at most {MAX_RECORD_BYTES} bytes")));
        }
        offset = next_offset;
        index += counts[i];
    }
    Ok(fields)
}

/// Longest record that is believed: feature descriptors have some thousand bytes a point.
const MAX_RECORD_BYTES: usize = 1 << 20;

fn viewpoint(line: &Line) -> Result<[f64; 7], PcdError> {
    let numbers: Option<Vec<f64>> = line.words.iter().map(|word| word.parse().ok()).collect();
    numbers
        .and_then(|all| <[f64; 7]>::try_from(all).ok())
        .ok_or_else(|| line.error("seven numbers: x y z and a quaternion w x y z"))
}

/// A grid as a PCD file with fields x, y, z of 32-bit floats; NaN for cells without a return.
pub fn write_pcd(grid: &PointGrid, encoding: Encoding) -> Vec<u8> {
    let (rows, columns) = (grid.rows(), grid.columns());
    let mut head = String::new();
    write!(
        head,
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\n\
         TYPE F F F\nCOUNT 1 1 1\nWIDTH {columns}\nHEIGHT {rows}\nVIEWPOINT 0 0 0 1 0 0 0\n\
         POINTS {}\nDATA {}\n",
        rows * columns,
        encoding.name()
    )
    .expect("writing to a string does not fail");
    let mut bytes = head.into_bytes();
    body::write_points(grid.points(), encoding, &mut bytes);
    bytes
}

#[cfg(test)]
mod tests;
