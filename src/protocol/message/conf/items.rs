//! Configurations of sensors, cameras and grippers.

use super::spelled;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::problem::Problem;
use crate::protocol::{Dialect, Segment};
use serde::{Deserialize, Serialize};

/// `{Name n} {MaxRange r} {MinRange r} {Resolution a} {Fov a} {Paning b} {Tilting b}`; UDK: `Panning`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RangeScannerConf {
    /// The sensor's name.
    pub name: String,
    /// Metres.
    pub max_range_m: Option<f64>,
    /// Metres.
    pub min_range_m: Option<f64>,
    /// Radians between beams, truncated.
    pub resolution_rad: Option<f64>,
    /// Radians from the first beam to the last.
    pub fov_rad: Option<f64>,
    /// Whether the beams are spread in yaw.
    pub panning: Option<bool>,
    /// Whether the beams are spread in pitch.
    pub tilting: Option<bool>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl RangeScannerConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        Ok(Self {
            name: group.name(),
            max_range_m: group.number("MaxRange"),
            min_range_m: group.number("MinRange"),
            resolution_rad: group.number("Resolution"),
            fov_rad: group.number("Fov"),
            panning: group.flag("Paning").or_else(|| group.flag("Panning")),
            tilting: group.flag("Tilting"),
            extra: group.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        w.text("Name", &self.name).optional_number("MaxRange", self.max_range_m, 4);
        w.optional_number("MinRange", self.min_range_m, 4);
        w.optional_number("Resolution", self.resolution_rad, 4);
        w.optional_number("Fov", self.fov_rad, 4);
        for (key, flag) in
            [(spelled(dialect, "Paning", "Panning"), self.panning), ("Tilting", self.tilting)]
        {
            if let Some(flag) = flag {
                w.server_flag(key, flag);
            }
        }
        w.extra(&self.extra);
    }
}

/// `{Name n} {MaxRange r} {MinRange r} {BeamAngle a}`; UDK adds a scan interval and its ray cone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SonarConf {
    /// The sensor's name.
    pub name: String,
    /// Metres.
    pub max_range_m: Option<f64>,
    /// Metres.
    pub min_range_m: Option<f64>,
    /// UDK: seconds between lines.
    pub scan_interval_s: Option<f64>,
    /// Opening of the beam, radians.
    pub beam_angle_rad: Option<f64>,
    /// UDK: echoes further off the surface normal are ignored, radians.
    pub max_incidence_rad: Option<f64>,
    /// UDK: rays in each cone.
    pub traces_per_cone: Option<i64>,
    /// UDK: cones round the axis.
    pub cones: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl SonarConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        Ok(Self {
            name: group.name(),
            max_range_m: group.number("MaxRange"),
            min_range_m: group.number("MinRange"),
            scan_interval_s: group.number("ScanInterval"),
            beam_angle_rad: group.number("BeamAngle"),
            max_incidence_rad: group.number("maxAngleOfIncidence"),
            traces_per_cone: group.integer("tracesPerCone"),
            cones: group.integer("numberOfCones"),
            extra: group.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        w.text("Name", &self.name).optional_number("MaxRange", self.max_range_m, 4);
        w.optional_number("MinRange", self.min_range_m, 4);
        w.optional_number("ScanInterval", self.scan_interval_s, 4);
        w.optional_number(spelled(dialect, "BeamAngle", "beamAngle"), self.beam_angle_rad, 4);
        w.optional_number("maxAngleOfIncidence", self.max_incidence_rad, 4);
        w.optional_integer("tracesPerCone", self.traces_per_cone);
        w.optional_integer("numberOfCones", self.cones).extra(&self.extra);
    }
}

/// `{Name n} {MaxRange r} {HorizontalFOV a} {VerticalFOV a}` (UT2004).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct VictSensorConf {
    /// The sensor's name.
    pub name: String,
    /// Metres.
    pub max_range_m: Option<f64>,
    /// Radians.
    pub horizontal_fov_rad: Option<f64>,
    /// Radians.
    pub vertical_fov_rad: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl VictSensorConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        Ok(Self {
            name: group.name(),
            max_range_m: group.number("MaxRange"),
            horizontal_fov_rad: group.number("HorizontalFOV"),
            vertical_fov_rad: group.number("VerticalFOV"),
            extra: group.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, _: Dialect) {
        w.text("Name", &self.name).optional_number("MaxRange", self.max_range_m, 4);
        w.optional_number("HorizontalFOV", self.horizontal_fov_rad, 4);
        w.optional_number("VerticalFOV", self.vertical_fov_rad, 4).extra(&self.extra);
    }
}

/// `{Name n} {CameraDefFov a} {CameraMinFov a} {CameraMaxFov a} {CameraFov a}`; UDK puts the
/// camera's tile in the shared picture before these and leaves out the blanks.
///
/// The angles are **radians in UT2004 and degrees in UDK**, as they stand on the wire.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraConf {
    /// The camera's name.
    pub name: String,
    /// UDK: left and upper edge of the tile, pixels.
    pub tile_offset: Option<[i64; 2]>,
    /// UDK: width and height of the tile, pixels.
    pub tile_size: Option<[i64; 2]>,
    /// Field of view at the start, in the dialect's unit.
    pub default_fov: Option<f64>,
    /// Smallest field of view, in the dialect's unit.
    pub min_fov: Option<f64>,
    /// Largest field of view, in the dialect's unit.
    pub max_fov: Option<f64>,
    /// Present field of view, in the dialect's unit.
    pub fov: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

fn pixels(group: &mut Fields<'_>, x: &str, y: &str) -> Option<[i64; 2]> {
    if !(group.has(x) && group.has(y)) {
        return None;
    }
    Some([group.integer(x)?, group.integer(y)?])
}

impl CameraConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        Ok(Self {
            name: group.name(),
            tile_offset: pixels(group, "TextureOffsetX", "TextureOffsetY"),
            tile_size: pixels(group, "TextureResolutionX", "TextureResolutionY"),
            default_fov: group.number("CameraDefFov"),
            min_fov: group.number("CameraMinFov"),
            max_fov: group.number("CameraMaxFov"),
            fov: group.number("CameraFov"),
            extra: group.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        w.text("Name", &self.name);
        for (keys, pair) in [
            (["TextureOffsetX", "TextureOffsetY"], self.tile_offset),
            (["TextureResolutionX", "TextureResolutionY"], self.tile_size),
        ] {
            if let Some([x, y]) = pair {
                w.tight().integer(keys[0], x).tight().integer(keys[1], y);
            }
        }
        for (key, angle) in [
            ("CameraDefFov", self.default_fov),
            ("CameraMinFov", self.min_fov),
            ("CameraMaxFov", self.max_fov),
            ("CameraFov", self.fov),
        ] {
            if let Some(angle) = angle {
                if dialect == Dialect::Udk {
                    w.tight();
                }
                w.number(key, angle, 4);
            }
        }
        w.extra(&self.extra);
    }
}

/// `{Name g} {Opcode GRIP} {MaxVal 1} {MinVal 0} {Opcode Close} …` (UDK); UT2004 gives the name alone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GripperConf {
    /// The gripper's name.
    pub name: String,
    /// Each opcode with its largest and smallest value, if it takes one.
    pub opcodes: Vec<(String, Option<[i64; 2]>)>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl GripperConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        let name = group.name();
        let groups = group.groups("Opcode");
        let opcodes = group.read_groups(groups, |opcode| {
            let name = opcode.text("Opcode").unwrap_or_default();
            Ok((name, pixels(opcode, "MaxVal", "MinVal")))
        });
        Ok(Self { name, opcodes, extra: group.rest() })
    }

    pub(super) fn write(&self, w: &mut LineWriter, _: Dialect) {
        w.text("Name", &self.name);
        for (opcode, bounds) in &self.opcodes {
            w.text("Opcode", opcode);
            if let Some([max, min]) = bounds {
                w.integer("MaxVal", *max).integer("MinVal", *min);
            }
        }
        w.extra(&self.extra);
    }
}

/// `{Name n}` with what the simpler items tell of themselves; anything else is in `extra`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ItemConf {
    /// The item's name.
    pub name: String,
    /// Seconds between lines.
    pub scan_interval_s: Option<f64>,
    /// Encoder: radians of one tick, truncated.
    pub resolution_rad: Option<f64>,
    /// Odometry (UT2004): radians of one step of the wheel encoder.
    pub encoder_resolution_rad: Option<f64>,
    /// Touch (UDK): metres.
    pub diameter_m: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl ItemConf {
    pub(super) fn read(group: &mut Fields<'_>) -> Result<Self, Problem> {
        Ok(Self {
            name: group.name(),
            scan_interval_s: group.number("ScanInterval"),
            resolution_rad: group.number("Resolution"),
            encoder_resolution_rad: group.number("EncoderResolution"),
            diameter_m: group.number("Diameter"),
            extra: group.rest(),
        })
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        // UT2004 prints the interval with 4 decimals for odometry and 2 for INS, GPS and the like.
        let short = dialect == Dialect::Ut2004 && self.encoder_resolution_rad.is_none();
        w.text("Name", &self.name);
        w.optional_number("ScanInterval", self.scan_interval_s, if short { 2 } else { 4 });
        w.optional_number("Resolution", self.resolution_rad, 4);
        w.optional_number("EncoderResolution", self.encoder_resolution_rad, 4);
        w.optional_number("Diameter", self.diameter_m, 4).extra(&self.extra);
    }
}
