//! The rigid-body world: every object of a map as a fixed collider, robots as bodies on joints.

use super::glam;
use super::world::{ObjectId, World};
use nalgebra::{Point3, Vector3};
use rapier3d_f64::dynamics::{FrictionModel, RigidBodyHandle};
use rapier3d_f64::geometry::{ColliderBuilder, ColliderHandle};
use rapier3d_f64::math::Vector;
use rapier3d_f64::pipeline::PhysicsWorld;

/// Length of one physics step in nanoseconds.
pub const STEP_NANOS: i64 = 5_000_000;

/// Length of one physics step in seconds.
pub const STEP_S: f64 = 0.005;

pub(crate) const GRAVITY_MPS2: f64 = 9.81;

/// Identifies a robot in one session; never used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RobotKey(pub u32);

/// What a robot's body touches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Other {
    /// A part of the map.
    Object(ObjectId),
    /// Another robot.
    Robot(RobotKey),
}

/// One pair of surfaces pressed together during the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touching {
    /// What is touched.
    pub other: Other,
    /// Where, in the world.
    pub point: Point3<f64>,
    /// Unit direction in which the robot is pushed, in the world.
    pub push: Vector3<f64>,
}

/// Colliders of robots carry this bit and the robot's key; those of the map their object's index.
const ROBOT_BIT: u128 = 1 << 64;

/// All bodies of a session.
pub(crate) struct Physics {
    pub(super) bodies: PhysicsWorld,
}

impl Physics {
    /// The colliders of a map, in file order.
    pub(crate) fn new(world: &World) -> Self {
        let mut bodies = PhysicsWorld::new();
        bodies.gravity = Vector::new(0.0, 0.0, -GRAVITY_MPS2);
        let parameters = &mut bodies.integration_parameters;
        parameters.dt = STEP_S;
        // One friction constraint per contact point: the quicker model turns a skid-steered robot
        // 5 % slower than friction on four patches does.
        parameters.friction_model = FrictionModel::Coulomb;
        // With fewer passes a braked robot creeps down a ramp (7 mm/s at 20° with one pass), and tyres
        // lose grip on the edge of a kerb.
        parameters.num_internal_stabilization_iterations = 4;
        // With one pass the wheels of a robot that drives straight turn up to 0.04 rad/s apart, whatever
        // its speed: its odometry bends, where the recorded robot's wheels agree to a tick.
        parameters.num_internal_pgs_iterations = 2;
        // Recycled contacts stay up to 5 cm behind a rolling wheel: on a kerb that decides whether
        // the wheel climbs.
        parameters.contact_recycling = false;
        for (index, object) in world.objects().iter().enumerate() {
            let (shape, offset) = object.solid.contact_shape();
            let collider = ColliderBuilder::new(shape)
                .position(glam::pose(&object.world_from_object) * offset)
                .friction(object.friction)
                .user_data(index as u128);
            bodies.insert_collider(collider, None);
        }
        Self { bodies }
    }

    /// Advances every body by [`STEP_S`].
    pub(crate) fn step(&mut self) {
        self.bodies.step();
    }

    /// The label of a robot's colliders.
    pub(super) fn label(key: RobotKey) -> u128 {
        ROBOT_BIT | u128::from(key.0)
    }

    /// What the collider pressed against during the last step, except the robot's own parts.
    pub(super) fn touching(&self, key: RobotKey, collider: ColliderHandle) -> Vec<Touching> {
        let mut found = Vec::new();
        for pair in self.bodies.narrow_phase.contact_pairs_with(collider) {
            if pair.total_impulse_magnitude() <= 0.0 {
                continue;
            }
            let mine_first = pair.collider1 == collider;
            let other = if mine_first { pair.collider2 } else { pair.collider1 };
            let label = self.bodies.colliders[other].user_data;
            if label == Self::label(key) {
                continue;
            }
            let Some((manifold, contact)) = pair.find_deepest_contact() else { continue };
            // The library's normal points from the first collider to the second.
            let push =
                glam::from_vector(manifold.data.normal) * if mine_first { -1.0 } else { 1.0 };
            let local = if mine_first { contact.local_p1 } else { contact.local_p2 };
            let place = self.bodies.colliders[collider].position();
            found.push(Touching {
                other: other_of(label),
                point: glam::from_vector(place.transform_point(local)).into(),
                push,
            });
        }
        // The library keeps pairs in the order of its own graph.
        found.sort_by(|a, b| a.other.cmp(&b.other).then(a.point.x.total_cmp(&b.point.x)));
        found
    }

    /// Lets a body and all that hangs on it move again.
    pub(super) fn wake(&mut self, body: RigidBodyHandle) {
        self.bodies.wake_up(body, true);
    }
}

fn other_of(label: u128) -> Other {
    if label & ROBOT_BIT == 0 {
        Other::Object(ObjectId(label as u32))
    } else {
        Other::Robot(RobotKey((label & u128::from(u32::MAX)) as u32))
    }
}
