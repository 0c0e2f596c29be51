//! `RangeScanner` and `IRScanner`: one line of ranges.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// `SEN {Time t} {Type RangeScanner} {Name n} {Resolution r} {FOV f} {Range d1,d2,…,dN}`.
///
/// Beam 1 is the **rightmost**. UT2004 writes ranges with 4 decimals and stamps the line with the
/// instant of the cast, one burst before the other lines; UDK writes 2 decimals, truncated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeScanner {
    /// When the rays were cast.
    pub time: Option<Stamp>,
    /// The sensor's name.
    pub name: String,
    /// Angle between beams, truncated to 4 decimals: too coarse to rebuild the beams with. Use
    /// the field of view and the number of beams.
    pub resolution_rad: Option<f64>,
    /// Angle from the first beam to the last.
    pub fov_rad: Option<f64>,
    /// Metres along each beam, from right to left.
    pub ranges_m: Vec<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl RangeScanner {
    pub(super) fn read(fields: &mut Fields<'_>) -> Result<Self, Problem> {
        let ranges_m = fields.list("Range");
        Ok(Self {
            ranges_m: fields.require("Range", ranges_m)?,
            time: fields.time(),
            name: fields.name(),
            resolution_rad: fields.number("Resolution"),
            fov_rad: fields.number("FOV"),
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, kind: &str, dialect: Dialect) {
        let (time_decimals, range_decimals) = match dialect {
            Dialect::Ut2004 => (2, 4),
            Dialect::Udk => (4, 2),
        };
        w.time(self.time, time_decimals).text("Type", kind).text_unless_empty("Name", &self.name);
        w.optional_number("Resolution", self.resolution_rad, 4);
        w.optional_number("FOV", self.fov_rad, 4);
        w.list("Range", &self.ranges_m, range_decimals).extra(&self.extra);
    }
}

/// `RangeScanner3D` or `3DRangeScanner` (UT2004): `{Resolution h,v} {FOV h,v} {Range …}`.
///
/// The order of its points is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeScanner3d {
    /// When the rays were cast.
    pub time: Option<Stamp>,
    /// The type as the server spells it.
    pub type_name: String,
    /// The sensor's name.
    pub name: String,
    /// Horizontal and vertical angle between rays.
    pub resolution_rad: Option<[f64; 2]>,
    /// Horizontal and vertical field of view.
    pub fov_rad: Option<[f64; 2]>,
    /// Metres along each ray.
    pub ranges_m: Vec<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl RangeScanner3d {
    pub(super) fn read(fields: &mut Fields<'_>, type_name: String) -> Result<Self, Problem> {
        let ranges_m = fields.list("Range");
        Ok(Self {
            ranges_m: fields.require("Range", ranges_m)?,
            time: fields.time(),
            type_name,
            name: fields.name(),
            resolution_rad: fields.vector("Resolution"),
            fov_rad: fields.vector("FOV"),
            extra: fields.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        w.time(self.time, 2).text("Type", &self.type_name).text_unless_empty("Name", &self.name);
        if let Some(resolution) = &self.resolution_rad {
            w.list("Resolution", resolution, 4);
        }
        if let Some(fov) = &self.fov_rad {
            w.list("FOV", fov, 4);
        }
        w.list("Range", &self.ranges_m, 4).extra(&self.extra);
    }
}
