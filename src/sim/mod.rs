//! The stand-in simulator: world, vehicle, sensors and the session that speaks the protocol.
//!
//! It shares nothing with the estimator but the protocol, the mathematics and the clock types: a
//! simulator that used the estimator's code would agree with its mistakes.

mod camera;
mod catalogue;
mod file_check;
mod glam;
mod map_file;
mod mesh;
mod noise;
mod pan_tilt;
mod physics;
mod scenario;
mod sensor;
pub mod server;
mod session;
mod solid;
mod spec;
mod surroundings;
mod truth;
mod vehicle;
mod victim;
mod wire;
mod world;

pub use camera::{Picture, Screen, View};
pub use catalogue::{RobotCatalogue, RobotClass, WireFacts};
pub use file_check::{SpecError, Violation};
pub use map_file::{
    BoxSpec, CylinderSpec, FalseAlarmSpec, MapFile, MeshSpec, PortalSpec, SphereSpec, StartSpec,
    TagSpec, VictimSpec, VictimStatus,
};
pub use mesh::{MeshError, MeshObject, read_mesh};
pub use noise::Noise;
pub use physics::{Other, RobotKey, STEP_NANOS, STEP_S, Touching};
pub use scenario::{
    FaultKind, FaultSpec, NoiseSpec, Phase, PhaseName, RobotSpec, Scenario, Timing,
};
pub use session::{ConnectionId, Session};
pub use solid::{Crossing, Solid};
pub use spec::{Layout, PanTiltSpec, PartSpec, SensorKind, SensorSpec, WheelSpec};
pub use truth::{CastTruth, Truth};
pub use vehicle::Motion;
pub use victim::{BodyPart, Posture};
pub use world::{
    FalseAlarm, Hit, Object, ObjectId, ObjectKind, Portal, SolidSpan, Start, Tag, Victim, World,
    WorldError,
};
