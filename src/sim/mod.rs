//! The stand-in simulator: world, vehicle, sensors and the session that speaks the protocol.
//!
//! It shares nothing with the estimator but the protocol, the mathematics and the clock types: a
//! simulator that used the estimator's code would agree with its mistakes.

mod glam;
mod map_file;
mod mesh;
mod noise;
mod solid;
mod victim;
mod world;

pub use map_file::{
    BoxSpec, CylinderSpec, FalseAlarmSpec, MapFile, MeshSpec, PortalSpec, SpecError, SphereSpec,
    StartSpec, TagSpec, VictimSpec, VictimStatus, Violation,
};
pub use mesh::{MeshError, MeshObject, read_mesh};
pub use noise::Noise;
pub use solid::{Crossing, Solid};
pub use victim::{BodyPart, Posture};
pub use world::{
    FalseAlarm, Hit, Object, ObjectId, ObjectKind, Portal, SolidSpan, Start, Tag, Victim, World,
    WorldError,
};
