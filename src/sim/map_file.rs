//! Map files: the world as written in `maps/NAME.toml`.
//!
//! Metres, x forward, y left, z up, angles in degrees. A wire pose is (x, -y, -z).

use super::file_check::{Check, SpecError, read_toml};
use super::victim::{BodyPart, Posture};
use serde::{Deserialize, Serialize};

/// A map as written, checked by [`MapFile::parse`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    /// The map's name, which the greeting carries as the level.
    pub name: String,
    /// x0, y0, x1, y1 in metres: what counts as the world when scoring.
    pub bounds: [f64; 4],
    /// Boxes.
    #[serde(default, rename = "box")]
    pub boxes: Vec<BoxSpec>,
    /// Ramps that rise along their own +x.
    #[serde(default, rename = "wedge")]
    pub wedges: Vec<BoxSpec>,
    /// Cylinders, axis z before turning.
    #[serde(default, rename = "cylinder")]
    pub cylinders: Vec<CylinderSpec>,
    /// Balls.
    #[serde(default, rename = "sphere")]
    pub spheres: Vec<SphereSpec>,
    /// Triangle files beside the map file.
    #[serde(default, rename = "mesh")]
    pub meshes: Vec<MeshSpec>,
    /// Start poses in the order in which `GETSTARTPOSES` names them.
    #[serde(default, rename = "start")]
    pub starts: Vec<StartSpec>,
    /// People.
    #[serde(default, rename = "victim")]
    pub victims: Vec<VictimSpec>,
    /// Invisible volumes that the victim sensor takes for a body part.
    #[serde(default, rename = "false_alarm")]
    pub false_alarms: Vec<FalseAlarmSpec>,
    /// Radio tags.
    #[serde(default, rename = "rfid")]
    pub tags: Vec<TagSpec>,
    /// Doorways and crossings that count when driven through.
    #[serde(default, rename = "portal")]
    pub portals: Vec<PortalSpec>,
}

/// A box or a wedge.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoxSpec {
    /// Name that hits report; empty means the kind and its number.
    #[serde(default)]
    pub name: String,
    /// Centre in metres.
    pub center: [f64; 3],
    /// Full extents in metres, each > 0.
    pub size: [f64; 3],
    /// Roll, pitch, yaw in degrees, about x, then y, then z.
    #[serde(default)]
    pub rpy_deg: [f64; 3],
    /// Coefficient of friction, 0 to 2.
    #[serde(default = "default_friction")]
    pub friction: f64,
    /// Red, green, blue, 0 to 1, in camera pictures; absent means by kind.
    #[serde(default)]
    pub colour: Option<[f64; 3]>,
}

/// A cylinder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CylinderSpec {
    /// Name that hits report; empty means the kind and its number.
    #[serde(default)]
    pub name: String,
    /// Centre in metres.
    pub center: [f64; 3],
    /// Radius in metres, > 0.
    pub radius: f64,
    /// Height in metres, > 0.
    pub height: f64,
    /// Roll, pitch, yaw in degrees.
    #[serde(default)]
    pub rpy_deg: [f64; 3],
    /// Coefficient of friction, 0 to 2.
    #[serde(default = "default_friction")]
    pub friction: f64,
    /// Red, green, blue, 0 to 1, in camera pictures.
    #[serde(default)]
    pub colour: Option<[f64; 3]>,
}

/// A ball.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SphereSpec {
    /// Name that hits report; empty means the kind and its number.
    #[serde(default)]
    pub name: String,
    /// Centre in metres.
    pub center: [f64; 3],
    /// Radius in metres, > 0.
    pub radius: f64,
    /// Coefficient of friction, 0 to 2.
    #[serde(default = "default_friction")]
    pub friction: f64,
    /// Red, green, blue, 0 to 1, in camera pictures.
    #[serde(default)]
    pub colour: Option<[f64; 3]>,
}

/// A triangle file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshSpec {
    /// File beside the map file, ending in `.obj`, `.stl` or `.ply`.
    pub file: String,
    /// Where the file's origin lies, in metres.
    #[serde(default)]
    pub position: [f64; 3],
    /// Roll, pitch, yaw in degrees.
    #[serde(default)]
    pub rpy_deg: [f64; 3],
    /// Metres per unit of the file, > 0.
    #[serde(default = "default_scale")]
    pub scale: f64,
    /// Coefficient of friction, 0 to 2.
    #[serde(default = "default_friction")]
    pub friction: f64,
    /// Red, green, blue, 0 to 1, in camera pictures.
    #[serde(default)]
    pub colour: Option<[f64; 3]>,
}

/// A named pose at which robots may be spawned.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartSpec {
    /// Name, unique without regard to case.
    pub name: String,
    /// Position of the robot's origin in metres; a robot too tall for it is lifted onto the floor.
    pub position: [f64; 3],
    /// Heading in degrees, counter-clockwise.
    #[serde(default)]
    pub yaw_deg: f64,
}

/// Whether a victim lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VictimStatus {
    /// Alive.
    Alive,
    /// Dead.
    Dead,
}

/// A person.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VictimSpec {
    /// Name, unique.
    pub name: String,
    /// The point of the ground under the pelvis, in metres.
    pub position: [f64; 3],
    /// Direction in degrees from the feet to the head (lying) or in which the person looks (sitting).
    #[serde(default)]
    pub yaw_deg: f64,
    /// Alive or dead.
    pub status: VictimStatus,
    /// Lying on the ground or sitting on it.
    #[serde(default)]
    pub posture: Posture,
}

/// An invisible volume that the victim sensor takes for a body part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FalseAlarmSpec {
    /// Centre in metres.
    pub position: [f64; 3],
    /// Radius in metres, > 0.
    pub radius: f64,
    /// The body part it is reported as.
    pub part: BodyPart,
}

/// A radio tag.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TagSpec {
    /// Number, unique.
    pub id: i64,
    /// Position in metres.
    pub position: [f64; 3],
    /// What its memory holds at the start.
    #[serde(default)]
    pub memory: String,
}

/// A line on the ground that counts when a robot's centre crosses it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PortalSpec {
    /// Name, unique.
    pub name: String,
    /// One end, on the ground, in metres.
    pub from: [f64; 3],
    /// The other end.
    pub to: [f64; 3],
}

fn default_friction() -> f64 {
    0.8
}

fn default_scale() -> f64 {
    1.0
}

impl MapFile {
    /// Reads a map file's text; reports every violation at once.
    pub fn parse(text: &str) -> Result<Self, SpecError> {
        let mut map: Self = read_toml(text)?;
        map.name_the_nameless();
        let mut check = Check::default();
        map.check(&mut check);
        check.finish(map)
    }

    fn name_the_nameless(&mut self) {
        fn fill<'a>(kind: &str, names: impl Iterator<Item = &'a mut String>) {
            for (number, name) in names.enumerate() {
                if name.is_empty() {
                    *name = format!("{kind}_{}", number + 1);
                }
            }
        }
        fill("box", self.boxes.iter_mut().map(|item| &mut item.name));
        fill("wedge", self.wedges.iter_mut().map(|item| &mut item.name));
        fill("cylinder", self.cylinders.iter_mut().map(|item| &mut item.name));
        fill("sphere", self.spheres.iter_mut().map(|item| &mut item.name));
    }

    fn check(&self, check: &mut Check) {
        let [x0, y0, x1, y1] = self.bounds;
        check.finite(&self.bounds, "bounds");
        check.that(
            x0 < x1 && y0 < y1,
            "bounds",
            format_args!("expected x0 < x1 and y0 < y1, found {:?}", self.bounds),
        );
        check.that(!self.name.is_empty(), "name", "expected a name, found nothing");
        check.that(
            !self.name.contains(['{', '}', '\r', '\n']),
            "name",
            "expected no braces and no line ends, because the greeting carries it",
        );
        self.check_shapes(check);
        self.check_things(check);
    }

    fn check_shapes(&self, check: &mut Check) {
        for (kind, items) in [("box", &self.boxes), ("wedge", &self.wedges)] {
            for item in items {
                let place = format!("{kind} {:?}", item.name);
                check.finite(&item.center, format_args!("{place} center"));
                check.positive(&item.size, format_args!("{place} size"));
                check.finite(&item.rpy_deg, format_args!("{place} rpy_deg"));
                surface(check, &place, item.friction, item.colour);
            }
        }
        for item in &self.cylinders {
            let place = format!("cylinder {:?}", item.name);
            check.finite(&item.center, format_args!("{place} center"));
            check.positive(&[item.radius, item.height], format_args!("{place} radius and height"));
            check.finite(&item.rpy_deg, format_args!("{place} rpy_deg"));
            surface(check, &place, item.friction, item.colour);
        }
        for item in &self.spheres {
            let place = format!("sphere {:?}", item.name);
            check.finite(&item.center, format_args!("{place} center"));
            check.positive(&[item.radius], format_args!("{place} radius"));
            surface(check, &place, item.friction, item.colour);
        }
        for item in &self.meshes {
            let place = format!("mesh {:?}", item.file);
            check.that(!item.file.is_empty(), &place, "expected a file name, found nothing");
            check.finite(&item.position, format_args!("{place} position"));
            check.finite(&item.rpy_deg, format_args!("{place} rpy_deg"));
            check.positive(&[item.scale], format_args!("{place} scale"));
            surface(check, &place, item.friction, item.colour);
        }
    }

    fn check_things(&self, check: &mut Check) {
        for item in &self.starts {
            let place = format!("start {:?}", item.name);
            check.that(
                !item.name.is_empty() && !item.name.contains([' ', '{', '}', ',']),
                &place,
                "expected a name without blanks, commas and braces",
            );
            check.finite(&item.position, format_args!("{place} position"));
            check.finite(&[item.yaw_deg], format_args!("{place} yaw_deg"));
        }
        for item in &self.victims {
            let place = format!("victim {:?}", item.name);
            check.finite(&item.position, format_args!("{place} position"));
            check.finite(&[item.yaw_deg], format_args!("{place} yaw_deg"));
        }
        for (number, item) in self.false_alarms.iter().enumerate() {
            let place = format!("false_alarm {}", number + 1);
            check.finite(&item.position, format_args!("{place} position"));
            check.positive(&[item.radius], format_args!("{place} radius"));
        }
        for item in &self.tags {
            let place = format!("rfid {}", item.id);
            check.finite(&item.position, format_args!("{place} position"));
            check.that(
                !item.memory.contains(['{', '}', '\r', '\n']),
                format_args!("{place} memory"),
                "expected no braces and no line ends, because replies carry it",
            );
        }
        for item in &self.portals {
            let place = format!("portal {:?}", item.name);
            check.finite(&item.from, format_args!("{place} from"));
            check.finite(&item.to, format_args!("{place} to"));
            check.that(
                item.from[..2] != item.to[..2],
                &place,
                "expected two ends apart in the plane, found one point",
            );
        }
        check.unique(self.starts.iter().map(|item| item.name.as_str()), "start");
        check.unique(self.victims.iter().map(|item| item.name.as_str()), "victim");
        check.unique(self.portals.iter().map(|item| item.name.as_str()), "portal");
        let ids: Vec<String> = self.tags.iter().map(|item| item.id.to_string()).collect();
        check.unique(ids.iter().map(String::as_str), "rfid");
    }
}

fn surface(check: &mut Check, place: &str, friction: f64, colour: Option<[f64; 3]>) {
    check.that(
        (0.0..=2.0).contains(&friction),
        format_args!("{place} friction"),
        format_args!("expected 0 to 2, found {friction}"),
    );
    let channels = colour.unwrap_or_default();
    check.that(
        channels.iter().all(|channel| (0.0..=1.0).contains(channel)),
        format_args!("{place} colour"),
        format_args!("expected three numbers from 0 to 1, found {channels:?}"),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "name = \"m\"\nbounds = [-1.0, -1.0, 1.0, 1.0]\n";

    #[test]
    fn every_violation_is_reported_at_once() {
        let text = format!(
            "{HEAD}[[box]]\nname = \"a\"\ncenter = [0.0, 0.0, nan]\nsize = [1.0, -1.0, 1.0]\n\
             friction = 9.0\n[[start]]\nname = \"S\"\nposition = [0.0, 0.0, 0.0]\n\
             [[start]]\nname = \"s\"\nposition = [0.0, 0.0, 0.0]\n"
        );
        let Err(SpecError::Invalid(violations)) = MapFile::parse(&text) else {
            panic!("four violations");
        };
        let places: Vec<&str> = violations.iter().map(|v| v.place.as_str()).collect();
        assert_eq!(
            places,
            ["box \"a\" center", "box \"a\" size", "box \"a\" friction", "start \"s\""]
        );
    }

    #[test]
    fn an_unknown_key_is_an_error_that_names_its_line_and_the_nearest_key() {
        let text = format!("{HEAD}[[box]]\ncentre = [0.0, 0.0, 0.0]\nsize = [1.0, 1.0, 1.0]\n");
        let error = MapFile::parse(&text).unwrap_err();
        assert_eq!(error.to_string(), "line 4: unknown key `centre`; the nearest one is `center`");
    }

    #[test]
    fn nameless_shapes_are_named_by_kind_and_number() {
        let text = format!("{HEAD}[[sphere]]\ncenter = [0.0, 0.0, 0.0]\nradius = 1.0\n");
        assert_eq!(MapFile::parse(&text).unwrap().spheres[0].name, "sphere_1");
    }
}
