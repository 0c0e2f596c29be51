//! `RangeImager`: depth images in strips.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::{Problem, ProblemKind};
use crate::protocol::{Dialect, Segment, number, text};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// A strip of a depth image, or the head alone while the sensor is idle.
///
/// ```text
/// UT2004  SEN {Time t} {Type RangeImager} {Name n} {Frames 10} [{Frame k}] {Resolution 0.0174} {FOV 3.1415} {Range …}
/// UDK     SEN {Time t} {Type RangeImager} {Name n} {Resolution 320,240} {FOV h,v} {Frames 20} {Frame k} {Range d,d,…,d,}
/// ```
///
/// UDK: 20 strips of 12 rows × 320 columns, rows from the top, columns from the left, depths along
/// the optical axis. Its ranges are written without the leading zero of the fraction, so `3.5` is
/// 3.05 m; they are converted here, and back.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeImager {
    /// When the rays were cast.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// UDK: columns and rows. UT2004: radians between rays.
    pub resolution: Vec<f64>,
    /// Radians: horizontal and vertical (UDK), or one value (UT2004).
    pub fov_rad: Vec<f64>,
    /// Strips in the whole image; 0 while idle.
    pub frames: Option<i64>,
    /// Which strip this is, from 0.
    pub frame: Option<i64>,
    /// Metres; absent while idle.
    pub ranges_m: Option<Vec<f64>>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl RangeImager {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let time = fields.time();
        let name = fields.name();
        let resolution = fields.list("Resolution").unwrap_or_default();
        // Two values mean an image size and thereby UDK's way of writing fractions.
        let ranges_m = if resolution.len() == 2 {
            read_hundredths(fields)?
        } else {
            match fields.list("Range") {
                None if fields.has("Range") => Some(fields.require("Range", None)?),
                ranges => ranges,
            }
        };
        Ok(Self {
            time,
            name,
            resolution,
            fov_rad: fields.list("FOV").unwrap_or_default(),
            frames: fields.integer("Frames"),
            frame: fields.integer("Frame"),
            ranges_m,
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        let time_decimals = match dialect {
            Dialect::Ut2004 => 2,
            Dialect::Udk => 4,
        };
        w.time(self.time, time_decimals).text("Type", "RangeImager");
        w.text_unless_empty("Name", &self.name);
        let image = self.resolution.len() == 2;
        if !image {
            self.write_frames(w);
        }
        if !self.resolution.is_empty() {
            w.list("Resolution", &self.resolution, if image { 0 } else { 4 });
        }
        if !self.fov_rad.is_empty() {
            w.list("FOV", &self.fov_rad, 4);
        }
        if image {
            self.write_frames(w);
        }
        match &self.ranges_m {
            Some(ranges) if image => {
                w.text("Range", &hundredths(ranges));
            }
            Some(ranges) => {
                w.list("Range", ranges, 4);
            }
            None => {}
        }
        w.extra(&self.extra);
    }

    fn write_frames(&self, w: &mut LineWriter) {
        w.optional_integer("Frames", self.frames).optional_integer("Frame", self.frame);
    }
}

/// Reads `3.5,12.40,` as 3.05 and 12.40.
fn read_hundredths(fields: &mut Fields<'_>) -> Result<Option<Vec<f64>>, Problem> {
    let Some(list) = fields.take("Range") else { return Ok(None) };
    let list = text::trim(list);
    let list = list.strip_suffix(b",").unwrap_or(list);
    if list.is_empty() {
        return Ok(Some(Vec::new()));
    }
    let mut ranges = Vec::with_capacity(list.len() / 4 + 1);
    for word in list.split(|octet| *octet == b',').map(text::trim) {
        let dot = word.iter().position(|octet| *octet == b'.').unwrap_or(word.len());
        let value = match &word[dot..] {
            [b'.', digit @ b'0'..=b'9'] => {
                let hundredths = u32::from(digit - b'0');
                let whole = number::integer(&word[..dot]);
                whole.map(|metres| (metres as f64 * 100.0 + f64::from(hundredths)) / 100.0)
            }
            _ => number::whole(word),
        };
        let bad = || Problem::new(ProblemKind::NotANumber("Range".to_owned()), 0, word);
        ranges.push(value.ok_or_else(bad)?);
    }
    Ok(Some(ranges))
}

/// Writes 3.05 and 12.40 as `3.5,12.40,`.
fn hundredths(ranges_m: &[f64]) -> String {
    let mut out = String::new();
    for range in ranges_m {
        let steps = (range * 100.0).round() as i64;
        out.push_str(&format!("{}.{},", steps / 100, steps % 100));
    }
    out
}
