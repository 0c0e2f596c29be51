//! `PCL` and `LineLaser`: points instead of ranges (UDK).

use crate::protocol::encode::{LineWriter, joined};
use crate::protocol::fields::Fields;
use crate::protocol::problem::{Problem, ProblemKind};
use crate::protocol::{Segment, number, text};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// Points in the sensor's frame, in a segment without a key.
///
/// ```text
/// rotating  SEN {Time t} {Type PCL} {Name n} {x,y,z;x,y,z;…}       2 decimals
/// arrays    SEN {Time t} {Type PCL}{Name n}{x,y,z x,y,z …}         4 decimals
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PointCloud {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Metres.
    pub points: Vec<[f64; 3]>,
    /// Whether points are separated by `;` (the rotating scanner) or by blanks (the arrays).
    pub rotating: bool,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

fn points<'a>(list: impl Iterator<Item = &'a [u8]>) -> Result<Vec<[f64; 3]>, Problem> {
    let bad = |text: &[u8]| Problem::new(ProblemKind::NotANumber("points".to_owned()), 0, text);
    list.map(|point| number::array(point).map_err(|_| bad(point))).collect()
}

impl PointCloud {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let (time, name) = (fields.time(), fields.name());
        let Some(list) = fields.take_first() else {
            return Ok(Self { time, name, ..Self::default() });
        };
        let rotating = list.body.contains(&b';');
        let points = if rotating {
            let parts = list.body.split(|octet| *octet == b';').map(text::trim);
            points(parts.filter(|part| !part.is_empty()))?
        } else {
            points(text::words(list.body))?
        };
        Ok(Self { time, name, points, rotating, extra: fields.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "PCL");
        let (decimals, separator) = if self.rotating { (2, ";") } else { (4, " ") };
        let list: Vec<_> = self.points.iter().map(|point| joined(point, decimals)).collect();
        let mut body = list.join(separator);
        if self.rotating && list.len() == 1 {
            // One point alone would read as the other form.
            body.push(';');
        }
        if self.rotating {
            w.text_unless_empty("Name", &self.name);
        } else if !self.name.is_empty() {
            w.tight().text("Name", &self.name).tight();
        }
        if !self.points.is_empty() {
            w.bare(&body);
        }
        w.extra(&self.extra);
    }
}

/// `SEN {Type LineLaser} {Name n} {Location x,y,z} … {Points [x,y,z][x,y,z]…}`, world frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LineLaser {
    /// Not sent by default.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Metres, world frame, 3 decimals.
    pub location: Option<[f64; 3]>,
    /// Metres, world frame, 3 decimals.
    pub points: Vec<[f64; 3]>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl LineLaser {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let list = fields.take("Points").unwrap_or_default();
        let parts = list.split(|octet| matches!(octet, b'[' | b']')).map(text::trim);
        Ok(Self {
            time: fields.time(),
            name: fields.name(),
            location: fields.vector("Location"),
            points: points(parts.filter(|part| !part.is_empty()))?,
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "LineLaser").text_unless_empty("Name", &self.name);
        if let Some(location) = &self.location {
            w.list("Location", location, 3);
        }
        let list: String =
            self.points.iter().map(|point| format!("[{}]", joined(point, 3))).collect();
        w.text("Points", &list).extra(&self.extra);
    }
}
