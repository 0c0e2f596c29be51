//! `GPS` and `AltitudeSensor`.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::{Problem, ProblemKind};
use crate::protocol::{Segment, number, text};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// A latitude or longitude: `39,8.0341,N`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GeoCoordinate {
    /// Whole degrees.
    pub degrees: i64,
    /// Minutes of arc, 4 decimals.
    pub minutes: f64,
    /// `N`, `S`, `E` or `W`.
    pub hemisphere: char,
}

/// `SEN {Type GPS} {Name n} [{Latitude d,m,N} {Longitude d,m,W}] {Fix i} {Satellites i}`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gps {
    /// When the line was written, if the server says.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Absent without a fix.
    pub latitude: Option<GeoCoordinate>,
    /// Absent without a fix.
    pub longitude: Option<GeoCoordinate>,
    /// 1 with a position, 0 without.
    pub fix: Option<i64>,
    /// Satellites in view; at least 4 are needed for a fix.
    pub satellites: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Gps {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        Ok(Self {
            time: fields.time(),
            name: fields.name(),
            latitude: read_coordinate(fields, "Latitude")?,
            longitude: read_coordinate(fields, "Longitude")?,
            fix: fields.integer("Fix"),
            satellites: fields.integer("Satellites"),
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "GPS").text_unless_empty("Name", &self.name);
        for (key, coordinate) in [("Latitude", &self.latitude), ("Longitude", &self.longitude)] {
            if let Some(GeoCoordinate { degrees, minutes, hemisphere }) = coordinate {
                w.text(key, &format!("{degrees},{minutes:.4},{hemisphere}"));
            }
        }
        w.optional_integer("Fix", self.fix).optional_integer("Satellites", self.satellites);
        w.extra(&self.extra);
    }
}

fn read_coordinate(fields: &mut Fields<'_>, key: &str) -> Result<Option<GeoCoordinate>, Problem> {
    let Some(value) = fields.take(key) else { return Ok(None) };
    let mut parts = value.split(|octet| *octet == b',').map(text::trim);
    let coordinate = (|| {
        let coordinate = GeoCoordinate {
            degrees: number::integer(parts.next()?)?,
            minutes: number::whole(parts.next()?)?,
            hemisphere: char::from(*parts.next()?.first()?),
        };
        parts.next().is_none().then_some(coordinate)
    })();
    match coordinate {
        Some(coordinate) => Ok(Some(coordinate)),
        None => Err(Problem::new(ProblemKind::NotANumber(key.to_owned()), 0, value)),
    }
}

/// `SEN {Type AltitudeSensor} {Name n} {relativeAltitude h} {absoluteAltitude h}` (UDK), metres up.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Altitude {
    /// When the line was written.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Metres above the start.
    pub relative_m: Option<f64>,
    /// Metres; starts at 111.
    pub absolute_m: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Altitude {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            time: fields.time(),
            name: fields.name(),
            relative_m: fields.number("relativeAltitude"),
            absolute_m: fields.number("absoluteAltitude"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 4).text("Type", "AltitudeSensor").text_unless_empty("Name", &self.name);
        w.optional_number("relativeAltitude", self.relative_m, 4);
        w.optional_number("absoluteAltitude", self.absolute_m, 4).extra(&self.extra);
    }
}
