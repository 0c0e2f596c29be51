//! The world as rays and wheels meet it: every surface of a map with its name.

use super::glam;
use super::map_file::{BoxSpec, MapFile, VictimStatus};
use super::mesh::{MeshError, read_mesh};
use super::solid::Solid;
use super::victim::{BodyPart, body};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy};
use parry3d_f64::query::Ray;
use parry3d_f64::shape::{TriMesh, TriMeshFlags};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Index of an object of a [`World`], in the order of the map file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ObjectId(pub u32);

/// What an object is, where that matters to a sensor or a score.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectKind {
    /// Floor, wall, furniture, rubble.
    Structure,
    /// One box of a victim's body.
    VictimPart {
        /// Index into [`World::victims`].
        victim: usize,
        /// Which part of the body.
        part: BodyPart,
    },
}

/// One rigid, immovable thing.
#[derive(Clone, Debug)]
pub struct Object {
    /// The map's name for it; an object of a triangle file keeps its own name.
    pub name: String,
    /// What it is.
    pub kind: ObjectKind,
    /// Its shape.
    pub solid: Solid,
    /// Where it stands.
    pub world_from_object: Isometry3<f64>,
    /// Coefficient of friction.
    pub friction: f64,
    /// Red, green, blue from 0 to 1, if the map gives them.
    pub colour: Option<[f64; 3]>,
}

/// What a ray met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance from the ray's origin in metres.
    pub range_m: f64,
    /// Outward unit normal of the surface, in the world.
    pub normal: Vector3<f64>,
    /// The object.
    pub object: ObjectId,
}

/// A stretch of a vertical line that lies within matter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidSpan {
    /// Lower end in metres.
    pub bottom_m: f64,
    /// Upper end in metres: what a wheel could stand on if the air above is high enough.
    pub top_m: f64,
    /// Outward normal of the surface at the upper end.
    pub top_normal: Vector3<f64>,
    /// The object at the upper end.
    pub top_object: ObjectId,
}

/// A person in the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Victim {
    /// The map's name.
    pub name: String,
    /// Alive or dead.
    pub status: VictimStatus,
    /// The point of the ground under the pelvis, heading as the map says.
    pub world_from_victim: Isometry3<f64>,
}

/// An invisible volume that the victim sensor takes for a body part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FalseAlarm {
    /// Centre.
    pub centre: Point3<f64>,
    /// Radius in metres.
    pub radius_m: f64,
    /// What it is taken for.
    pub part: BodyPart,
}

/// A radio tag as the map places it.
#[derive(Clone, Debug, PartialEq)]
pub struct Tag {
    /// Number.
    pub id: i64,
    /// Position.
    pub position: Point3<f64>,
    /// Memory.
    pub memory: String,
}

/// A named start pose of a robot's origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Name.
    pub name: String,
    /// Pose.
    pub world_from_robot: Isometry3<f64>,
}

/// A line on the ground that counts when crossed.
#[derive(Clone, Debug, PartialEq)]
pub struct Portal {
    /// Name.
    pub name: String,
    /// One end.
    pub from: Point3<f64>,
    /// The other end.
    pub to: Point3<f64>,
}

/// Why a world could not be built from a sound map.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WorldError {
    /// A triangle file was not handed over.
    #[error("mesh {0:?}: the file is missing")]
    MeshMissing(String),
    /// A triangle file is unsound.
    #[error("mesh {file:?}: {reason}")]
    Mesh {
        /// The file's name in the map.
        file: String,
        /// What is wrong with it.
        reason: MeshError,
    },
    /// The library refused the triangles.
    #[error("mesh {file:?} object {object:?}: {reason}")]
    Triangles {
        /// The file's name in the map.
        file: String,
        /// The object's name in the file.
        object: String,
        /// What the library said.
        reason: String,
    },
}

/// A map ready for rays and contact.
#[derive(Clone, Debug)]
pub struct World {
    name: String,
    bounds: [f64; 4],
    objects: Vec<Object>,
    boxes: Vec<Aabb>,
    tree: Bvh,
    starts: Vec<Start>,
    victims: Vec<Victim>,
    false_alarms: Vec<FalseAlarm>,
    tags: Vec<Tag>,
    portals: Vec<Portal>,
}

impl World {
    /// Builds the world of a map; `meshes` holds the bytes of the triangle files it names.
    pub fn new(map: &MapFile, meshes: &BTreeMap<String, Vec<u8>>) -> Result<Self, WorldError> {
        let mut objects = Vec::new();
        add_primitives(map, &mut objects);
        add_meshes(map, meshes, &mut objects)?;
        let victims = add_victims(map, &mut objects);
        let boxes: Vec<Aabb> = objects
            .iter()
            .map(|object| {
                let (shape, offset) = object.solid.contact_shape();
                shape.compute_aabb(&(glam::pose(&object.world_from_object) * offset))
            })
            .collect();
        Ok(Self {
            name: map.name.clone(),
            bounds: map.bounds,
            tree: Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes),
            objects,
            boxes,
            starts: map
                .starts
                .iter()
                .map(|start| Start {
                    name: start.name.clone(),
                    world_from_robot: placed(start.position, [0.0, 0.0, start.yaw_deg]),
                })
                .collect(),
            victims,
            false_alarms: map
                .false_alarms
                .iter()
                .map(|alarm| FalseAlarm {
                    centre: alarm.position.into(),
                    radius_m: alarm.radius,
                    part: alarm.part,
                })
                .collect(),
            tags: map
                .tags
                .iter()
                .map(|tag| Tag {
                    id: tag.id,
                    position: tag.position.into(),
                    memory: tag.memory.clone(),
                })
                .collect(),
            portals: map
                .portals
                .iter()
                .map(|portal| Portal {
                    name: portal.name.clone(),
                    from: portal.from.into(),
                    to: portal.to.into(),
                })
                .collect(),
        })
    }

    /// The map's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// x0, y0, x1, y1 in metres: what counts as the world when scoring.
    pub fn bounds(&self) -> [f64; 4] {
        self.bounds
    }

    /// Everything rigid, in the order of the map file.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The object that a hit names.
    pub fn object(&self, id: ObjectId) -> &Object {
        &self.objects[id.0 as usize]
    }

    /// Start poses in file order.
    pub fn starts(&self) -> &[Start] {
        &self.starts
    }

    /// The start pose of that name, without regard to case.
    pub fn start(&self, name: &str) -> Option<&Start> {
        self.starts.iter().find(|start| start.name.eq_ignore_ascii_case(name))
    }

    /// People in file order.
    pub fn victims(&self) -> &[Victim] {
        &self.victims
    }

    /// Volumes that only the victim sensor sees.
    pub fn false_alarms(&self) -> &[FalseAlarm] {
        &self.false_alarms
    }

    /// Radio tags in file order.
    pub fn tags(&self) -> &[Tag] {
        &self.tags
    }

    /// Portals in file order.
    pub fn portals(&self) -> &[Portal] {
        &self.portals
    }

    /// The nearest surface within `max_m` along a ray of unit `direction`.
    ///
    /// Of several objects at the same distance any one is reported, always the same one.
    pub fn cast_ray(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        max_m: f64,
    ) -> Option<Hit> {
        let ray = Ray::new(glam::point(origin), glam::vector(direction));
        let (leaf, _) = self.tree.cast_ray(&ray, max_m, |leaf, best| {
            Some(self.cast_object(leaf as usize, origin, direction, best.min(max_m))?.0)
        })?;
        let (range_m, normal) = self.cast_object(leaf as usize, origin, direction, max_m)?;
        Some(Hit { range_m, normal, object: ObjectId(leaf) })
    }

    /// How many objects the straight line between two points passes through.
    pub fn obstacles_between(&self, from: &Point3<f64>, to: &Point3<f64>) -> usize {
        let way = to - from;
        let length = way.norm();
        if length <= 0.0 {
            return 0;
        }
        let direction = way / length;
        let hits = (0..self.objects.len())
            .filter(|index| self.cast_object(*index, from, &direction, length).is_some());
        hits.count()
    }

    fn cast_object(
        &self,
        index: usize,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        max_m: f64,
    ) -> Option<(f64, Vector3<f64>)> {
        let object = &self.objects[index];
        let place = &object.world_from_object;
        let local_origin = place.inverse_transform_point(origin);
        let local_direction = place.inverse_transform_vector(direction);
        let (range, normal) = object.solid.cast(&local_origin, &local_direction, max_m)?;
        Some((range, place.rotation * normal))
    }

    /// Height of the first surface under (x, y, `from_z_m`), for a robot that stands there.
    pub fn floor_height_m(&self, x: f64, y: f64, from_z_m: f64) -> Option<f64> {
        const DEEP_ENOUGH_M: f64 = 1e4;
        let down = -Vector3::z();
        let hit = self.cast_ray(&Point3::new(x, y, from_z_m), &down, DEEP_ENOUGH_M)?;
        Some(from_z_m - hit.range_m)
    }

    /// All matter on the vertical line through (x, y), from the bottom up, overlaps united.
    ///
    /// Triangles count as closed bodies where the line crosses them an even number of times; an odd
    /// crossing is a sheet without thickness.
    pub fn solid_spans(&self, x: f64, y: f64) -> Vec<SolidSpan> {
        let mut spans = Vec::new();
        let line = Aabb::new(
            glam::vector(&Vector3::new(x, y, f64::MIN / 4.0)),
            glam::vector(&Vector3::new(x, y, f64::MAX / 4.0)),
        );
        for leaf in self.tree.intersect_aabb(&line) {
            self.spans_of(leaf, x, y, &mut spans);
        }
        spans.sort_by(|a, b| {
            a.bottom_m.total_cmp(&b.bottom_m).then(a.top_object.cmp(&b.top_object))
        });
        let mut united: Vec<SolidSpan> = Vec::new();
        for span in spans {
            match united.last_mut() {
                Some(last) if span.bottom_m <= last.top_m => {
                    if span.top_m > last.top_m {
                        *last = SolidSpan { bottom_m: last.bottom_m, ..span };
                    }
                }
                _ => united.push(span),
            }
        }
        united
    }

    fn spans_of(&self, leaf: u32, x: f64, y: f64, spans: &mut Vec<SolidSpan>) {
        let object = &self.objects[leaf as usize];
        let place = &object.world_from_object;
        let top_object = ObjectId(leaf);
        if matches!(object.solid, Solid::Mesh(_)) {
            let crossings = self.mesh_crossings(leaf, x, y);
            for pair in crossings.chunks(2) {
                let (top_m, top_normal) = pair[0];
                let bottom_m = pair.get(1).map_or(top_m, |(z, _)| *z);
                spans.push(SolidSpan { bottom_m, top_m, top_normal, top_object });
            }
            return;
        }
        let origin = place.inverse_transform_point(&Point3::new(x, y, 0.0));
        let down = place.inverse_transform_vector(&-Vector3::z());
        if let Some([entry, exit]) = object.solid.interval(&origin, &down) {
            spans.push(SolidSpan {
                bottom_m: -exit.0,
                top_m: -entry.0,
                top_normal: place.rotation * entry.1,
                top_object,
            });
        }
    }

    /// Heights at which a vertical line meets a mesh, from the top down.
    fn mesh_crossings(&self, leaf: u32, x: f64, y: f64) -> Vec<(f64, Vector3<f64>)> {
        const STEP_M: f64 = 1e-6;
        const MOST_CROSSINGS: usize = 64;
        let bounds = &self.boxes[leaf as usize];
        let mut from = bounds.maxs.z + STEP_M;
        let mut crossings = Vec::new();
        while crossings.len() < MOST_CROSSINGS {
            let origin = Point3::new(x, y, from);
            let reach = from - bounds.mins.z + STEP_M;
            let hit = self.cast_object(leaf as usize, &origin, &-Vector3::z(), reach);
            let Some((range, normal)) = hit else { break };
            crossings.push((from - range, normal));
            from -= range + STEP_M;
        }
        crossings
    }
}

/// A pose from a position in metres and roll, pitch, yaw in degrees.
pub(crate) fn placed(position: [f64; 3], rpy_deg: [f64; 3]) -> Isometry3<f64> {
    let [roll, pitch, yaw] = rpy_deg.map(f64::to_radians);
    Isometry3::from_parts(
        Translation3::from(Vector3::from(position)),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    )
}

fn add_primitives(map: &MapFile, objects: &mut Vec<Object>) {
    let kind = ObjectKind::Structure;
    let of_box = |item: &BoxSpec, solid: Solid| Object {
        name: item.name.clone(),
        kind,
        solid,
        world_from_object: placed(item.center, item.rpy_deg),
        friction: item.friction,
        colour: item.colour,
    };
    let half = |item: &BoxSpec| Vector3::from(item.size) / 2.0;
    objects.extend(map.boxes.iter().map(|item| of_box(item, Solid::Box(half(item)))));
    objects.extend(map.wedges.iter().map(|item| of_box(item, Solid::Wedge(half(item)))));
    objects.extend(map.cylinders.iter().map(|item| Object {
        name: item.name.clone(),
        kind,
        solid: Solid::Cylinder { radius_m: item.radius, half_height_m: item.height / 2.0 },
        world_from_object: placed(item.center, item.rpy_deg),
        friction: item.friction,
        colour: item.colour,
    }));
    objects.extend(map.spheres.iter().map(|item| Object {
        name: item.name.clone(),
        kind,
        solid: Solid::Sphere(item.radius),
        world_from_object: placed(item.center, [0.0; 3]),
        friction: item.friction,
        colour: item.colour,
    }));
}

fn add_meshes(
    map: &MapFile,
    meshes: &BTreeMap<String, Vec<u8>>,
    objects: &mut Vec<Object>,
) -> Result<(), WorldError> {
    for item in &map.meshes {
        let file = || item.file.clone();
        let bytes = meshes.get(&item.file).ok_or_else(|| WorldError::MeshMissing(file()))?;
        let parts = read_mesh(&item.file, bytes)
            .map_err(|reason| WorldError::Mesh { file: file(), reason })?;
        for (number, part) in parts.into_iter().enumerate() {
            let name = if part.name.is_empty() {
                format!("{}_{}", item.file, number + 1)
            } else {
                part.name
            };
            let corners = part
                .vertices
                .iter()
                .map(|corner| glam::vector(&(Vector3::from(*corner) * item.scale)))
                .collect();
            // Without corrected normals a wheel would trip over the seams between triangles.
            let flags = TriMeshFlags::FIX_INTERNAL_EDGES_TWO_SIDED;
            let mesh = TriMesh::with_flags(corners, part.triangles, flags).map_err(|error| {
                WorldError::Triangles {
                    file: file(),
                    object: name.clone(),
                    reason: error.to_string(),
                }
            })?;
            objects.push(Object {
                name,
                kind: ObjectKind::Structure,
                solid: Solid::Mesh(Arc::new(mesh)),
                world_from_object: placed(item.position, item.rpy_deg),
                friction: item.friction,
                colour: item.colour,
            });
        }
    }
    Ok(())
}

fn add_victims(map: &MapFile, objects: &mut Vec<Object>) -> Vec<Victim> {
    let mut victims = Vec::new();
    for (index, item) in map.victims.iter().enumerate() {
        let world_from_victim = placed(item.position, [0.0, 0.0, item.yaw_deg]);
        objects.extend(body(item.posture).into_iter().map(|part| Object {
            name: format!("{}/{}", item.name, part.part.name()),
            kind: ObjectKind::VictimPart { victim: index, part: part.part },
            solid: Solid::Box(part.half),
            world_from_object: world_from_victim * part.victim_from_box,
            friction: 0.8,
            colour: None,
        }));
        victims.push(Victim { name: item.name.clone(), status: item.status, world_from_victim });
    }
    victims
}

#[cfg(test)]
mod tests;
