//! The object sensor (UDK): what the beams of a fan meet, by name.

use super::ranging::bearings_rad;
use super::{Carrier, Mounting};
use crate::protocol::Dialect;
use crate::protocol::WirePose;
use crate::protocol::message::sen::{self, SeenObject};
use crate::sim::pan_tilt::PanTilt;
use crate::sim::spec::SensorSpec;
use crate::sim::surroundings::Surroundings;
use crate::sim::wire;
use crate::sim::world::{Object, ObjectId, ObjectKind};
use nalgebra::{Point3, Vector3};

/// Recognises the map's objects; other robots hide what is behind them.
#[derive(Clone, Debug)]
pub(crate) struct ObjectSensor {
    pub(crate) mounting: Mounting,
    max_range_m: f64,
    bearings: Vec<f64>,
}

impl ObjectSensor {
    pub(crate) fn new(spec: &SensorSpec, units: &[PanTilt]) -> Self {
        let fov_rad = spec.fov_deg.unwrap_or(180.0).to_radians();
        let resolution_rad = spec.resolution_deg.unwrap_or(1.0).to_radians();
        Self {
            mounting: Mounting::new(spec, units),
            max_range_m: spec.max_range_m.unwrap_or(20.0),
            bearings: bearings_rad(Dialect::Udk, fov_rad, resolution_rad, spec.beams()),
        }
    }

    /// Every object that a beam meets, once, in the order of the beams from right to left.
    pub(crate) fn read(
        &self,
        carrier: &Carrier<'_>,
        surroundings: &Surroundings<'_>,
    ) -> sen::ObjectSensor {
        let world_from_sensor = carrier.world_from_sensor(&self.mounting);
        let origin = Point3::from(world_from_sensor.translation.vector);
        let mut met: Vec<ObjectId> = Vec::new();
        let mut objects = Vec::new();
        for bearing in &self.bearings {
            let (sin, cos) = bearing.sin_cos();
            let direction = world_from_sensor.rotation * Vector3::new(cos, sin, 0.0);
            let seen = surroundings.cast(&origin, &direction, self.max_range_m);
            let Some((range_m, id)) = seen.and_then(|seen| Some((seen.range_m, seen.object?)))
            else {
                continue;
            };
            if !met.contains(&id) {
                met.push(id);
                let hit = origin + direction * range_m;
                objects.push(described(surroundings.world.object(id), &hit));
            }
        }
        sen::ObjectSensor {
            time: None,
            name: self.mounting.name.clone(),
            objects,
            extra: Vec::new(),
        }
    }
}

fn described(object: &Object, hit: &Point3<f64>) -> SeenObject {
    let printed = |values: [f64; 3]| values.map(|value| wire::round(value, 4));
    let pose = wire::pose(&object.world_from_object);
    let material = match object.kind {
        ObjectKind::Structure => "Structure",
        ObjectKind::VictimPart { part, .. } if part.is_bare() => "Skin",
        ObjectKind::VictimPart { .. } => "Cloth",
    };
    SeenObject {
        tag: object.name.clone(),
        pose: WirePose { location: printed(pose.location), orientation: printed(pose.orientation) },
        hit: Some(printed(wire::point(hit))),
        material: Some(material.to_owned()),
    }
}
