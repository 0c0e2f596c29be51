//! A chassis with wheels on revolute joints, each driven by a velocity motor of bounded torque.
//!
//! Wheels are bodies, not the library's ray-cast wheels: those climb kerbs that a wheel does not.
//! Left and right wheels skid when the robot turns, so that it turns slower than its odometry says:
//! four friction patches in a rectangle of track b and wheel base l turn at b²/(b² + l²) of the
//! ideal rate.

use super::{Vehicle, VehicleState};
use crate::sim::catalogue::RobotClass;
use crate::sim::glam;
use crate::sim::physics::{Physics, RobotKey, STEP_S};
use crate::sim::spec::{Layout, WheelSpec};
use crate::sim::world::World;
use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::dynamics::{
    CoefficientCombineRule, ImpulseJointHandle, JointAxis, MotorModel, RevoluteJointBuilder,
    RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d_f64::geometry::{ColliderBuilder, ColliderHandle};
use rapier3d_f64::math::{Rotation, Vector};
use std::f64::consts::{PI, TAU};

/// Gain of the velocity motors in 1/s: high enough that torque, not gain, is the limit.
const MOTOR_GAIN: f64 = 1e6;

/// Friction of the body's own surfaces, sheet metal that slides.
const BODY_FRICTION: f64 = 0.3;

/// A resting robot sleeps below this speed in m/s, after this many seconds.
const SLEEP_SPEED_MPS: f64 = 0.01;
const SLEEP_AFTER_S: f64 = 0.3;

struct Wheel {
    body: RigidBodyHandle,
    joint: ImpulseJointHandle,
    collider: ColliderHandle,
    side: usize,
}

pub(crate) struct RigidVehicle {
    key: RobotKey,
    wheels_spec: WheelSpec,
    chassis: RigidBodyHandle,
    body_colliders: Vec<ColliderHandle>,
    wheels: Vec<Wheel>,
    target_rps: [f64; 2],
    current_rps: [f64; 2],
    jammed: [bool; 2],
    state: VehicleState,
}

impl RigidVehicle {
    pub(crate) fn new(
        class: &RobotClass,
        key: RobotKey,
        physics: &mut Physics,
        world_from_robot: &Isometry3<f64>,
    ) -> Self {
        let label = Physics::label(key);
        let bodies = &mut physics.bodies;
        let chassis =
            bodies.insert_body(RigidBodyBuilder::dynamic().pose(glam::pose(world_from_robot)));
        let mut body_colliders = Vec::new();
        for part in &class.part {
            let half = Vector3::from(part.size) / 2.0;
            let collider = ColliderBuilder::cuboid(half.x, half.y, half.z)
                .translation(glam::vector(&part.center.into()))
                .mass(part.mass_kg)
                .friction(BODY_FRICTION)
                .user_data(label);
            body_colliders.push(bodies.insert_collider(collider, Some(chassis)));
        }
        if class.wheels.layout == Layout::TwoWheelsAndCaster {
            let radius = 0.6 * class.wheels.radius_m;
            let height = class.wheels.axle_z_m - class.wheels.radius_m + radius;
            let caster = ColliderBuilder::ball(radius)
                .translation(Vector::new(-class.wheels.base_m, 0.0, height))
                .mass(0.2)
                .friction(0.0)
                .friction_combine_rule(CoefficientCombineRule::Multiply)
                .user_data(label);
            bodies.insert_collider(caster, Some(chassis));
        }
        let mut wheels = Vec::new();
        for (number, centre) in class.wheel_centres().into_iter().enumerate() {
            let place = world_from_robot * nalgebra::Translation3::from(centre);
            let body = bodies.insert_body(RigidBodyBuilder::dynamic().pose(glam::pose(&place)));
            let tyre = ColliderBuilder::cylinder(class.wheels.width_m / 2.0, class.wheels.radius_m)
                .mass(class.wheels.mass_kg)
                .friction(class.wheels.friction)
                .friction_combine_rule(CoefficientCombineRule::Multiply)
                .user_data(label);
            let collider = bodies.insert_collider(tyre, Some(body));
            let mut joint = RevoluteJointBuilder::new(Vector::Y)
                .local_anchor1(glam::vector(&centre))
                .motor_model(MotorModel::AccelerationBased)
                .motor_velocity(0.0, MOTOR_GAIN)
                .motor_max_force(class.wheels.max_torque_nm)
                .build();
            joint.set_contacts_enabled(false);
            let joint = bodies.insert_impulse_joint(chassis, body, joint);
            wheels.push(Wheel { body, joint, collider, side: number % 2 });
        }
        let state = VehicleState::at(*world_from_robot, wheels.len());
        Self {
            key,
            wheels_spec: class.wheels.clone(),
            chassis,
            body_colliders,
            wheels,
            target_rps: [0.0; 2],
            current_rps: [0.0; 2],
            jammed: [false; 2],
            state,
        }
    }

    fn aim(&self) -> [f64; 2] {
        [0, 1].map(|side| if self.jammed[side] { 0.0 } else { self.target_rps[side] })
    }

    fn set_motors(&self, physics: &mut Physics) {
        for wheel in &self.wheels {
            let joint = physics
                .bodies
                .impulse_joints
                .get_mut(wheel.joint, true)
                .expect("joints live as long as the vehicle");
            let spin = self.current_rps[wheel.side];
            joint.data.set_motor_velocity(JointAxis::AngX, spin, MOTOR_GAIN);
        }
    }

    fn handles(&self) -> Vec<RigidBodyHandle> {
        std::iter::once(self.chassis).chain(self.wheels.iter().map(|wheel| wheel.body)).collect()
    }

    /// A robot that creeps must not fall asleep, one that is told to stand may.
    fn allow_sleep(&self, physics: &mut Physics, allowed: bool) {
        for handle in self.handles() {
            let activation = physics.bodies.bodies[handle].activation_mut();
            activation.normalized_linear_threshold = if allowed { SLEEP_SPEED_MPS } else { -1.0 };
            activation.time_until_sleep = SLEEP_AFTER_S;
        }
    }
}

impl Vehicle for RigidVehicle {
    fn drive(&mut self, spin_rps: [f64; 2]) {
        let most = self.wheels_spec.max_spin_rps;
        self.target_rps = spin_rps.map(|spin| spin.clamp(-most, most));
    }

    fn jam(&mut self, jammed: [bool; 2]) {
        self.jammed = jammed;
    }

    fn before_step(&mut self, physics: &mut Physics, _world: &World) {
        let aim = self.aim();
        if self.current_rps == aim {
            return;
        }
        let change = self.wheels_spec.max_spin_change_rps2 * STEP_S;
        for (current, aim) in self.current_rps.iter_mut().zip(aim) {
            *current += (aim - *current).clamp(-change, change);
        }
        self.set_motors(physics);
        self.allow_sleep(physics, self.current_rps == [0.0; 2]);
        physics.wake(self.chassis);
    }

    fn after_step(&mut self, physics: &Physics) {
        let body = &physics.bodies.bodies[self.chassis];
        if body.is_sleeping() {
            self.state.velocity_mps = Vector3::zeros();
            self.state.angular_rps = Vector3::zeros();
            return;
        }
        self.state.world_from_robot = glam::from_pose(body.position());
        self.state.angular_rps = glam::from_vector(body.angvel());
        let origin = body.translation();
        self.state.velocity_mps = glam::from_vector(body.velocity_at_point(origin));
        let upright = body.rotation().inverse();
        for (number, wheel) in self.wheels.iter().enumerate() {
            let turned = upright * *physics.bodies.bodies[wheel.body].rotation();
            let angle = axle_angle_rad(&turned);
            let known = self.state.wheel_angles_rad[number];
            let step = (angle - known + PI).rem_euclid(TAU) - PI;
            self.state.wheel_angles_rad[number] = known + step;
        }
        let touching = |colliders: &mut dyn Iterator<Item = ColliderHandle>| {
            colliders.flat_map(|collider| physics.touching(self.key, collider)).collect()
        };
        self.state.body_touches = touching(&mut self.body_colliders.iter().copied());
        self.state.wheel_touches = touching(&mut self.wheels.iter().map(|wheel| wheel.collider));
    }

    fn state(&self) -> &VehicleState {
        &self.state
    }

    fn place(&mut self, physics: &mut Physics, world_from_robot: &Isometry3<f64>) {
        let change = world_from_robot * self.state.world_from_robot.inverse();
        for handle in self.handles() {
            let body = &mut physics.bodies.bodies[handle];
            let moved = glam::pose(&(change * glam::from_pose(body.position())));
            body.set_position(moved, true);
            body.set_linvel(Vector::ZERO, true);
            body.set_angvel(Vector::ZERO, true);
        }
        self.state.world_from_robot = *world_from_robot;
    }

    fn shove(&mut self, physics: &mut Physics, change_mps: &Vector3<f64>) {
        for handle in self.handles() {
            let body = &mut physics.bodies.bodies[handle];
            body.set_linvel(body.linvel() + glam::vector(change_mps), true);
        }
    }

    fn remove(&mut self, physics: &mut Physics) {
        for handle in self.handles() {
            physics.bodies.remove_body(handle);
        }
    }
}

/// Angle in (-π, π] of a rotation about the axle, y; what little turns about other axes is solver
/// error of the joint.
fn axle_angle_rad(turned: &Rotation) -> f64 {
    let angle = 2.0 * turned.y.atan2(turned.w);
    (angle + PI).rem_euclid(TAU) - PI
}
