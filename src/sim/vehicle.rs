//! How a robot moves: on wheels with motors, friction and contacts, or as the commands say.

mod ideal;
mod rigid;
#[cfg(test)]
mod tests;

use super::catalogue::RobotClass;
use super::physics::{Physics, RobotKey, Touching};
use super::world::World;
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

pub(crate) use ideal::IdealVehicle;
pub(crate) use rigid::RigidVehicle;

/// Which vehicle model a scenario uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Motion {
    /// Rigid bodies: wheels slip, robots tip and fall.
    #[default]
    Rigid,
    /// The body goes where the wheels' turning says, without slip, along the ground.
    Ideal,
}

/// Where a robot is and what it feels after a step.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct VehicleState {
    /// Pose of the robot's origin.
    pub(crate) world_from_robot: Isometry3<f64>,
    /// Velocity of the origin in the world, in m/s.
    pub(crate) velocity_mps: Vector3<f64>,
    /// Angular velocity in the world, in rad/s.
    pub(crate) angular_rps: Vector3<f64>,
    /// How far each driven wheel has turned since the spawn, positive forwards, in radians: front
    /// left, front right, rear left, rear right, or left, right.
    pub(crate) wheel_angles_rad: Vec<f64>,
    /// What the body presses against.
    pub(crate) body_touches: Vec<Touching>,
    /// What the wheels press against.
    pub(crate) wheel_touches: Vec<Touching>,
}

impl VehicleState {
    fn at(world_from_robot: Isometry3<f64>, wheels: usize) -> Self {
        Self {
            world_from_robot,
            velocity_mps: Vector3::zeros(),
            angular_rps: Vector3::zeros(),
            wheel_angles_rad: vec![0.0; wheels],
            body_touches: Vec::new(),
            wheel_touches: Vec::new(),
        }
    }

    /// Velocity of the body's point that is now at `point_world`, in the world.
    pub(crate) fn velocity_at(&self, point_world: &nalgebra::Point3<f64>) -> Vector3<f64> {
        let arm = point_world.coords - self.world_from_robot.translation.vector;
        self.velocity_mps + self.angular_rps.cross(&arm)
    }
}

/// A robot's body in the physics world.
pub(crate) trait Vehicle: Send {
    /// Sets the wheel spins that the motors aim at, left and right, forward positive, in rad/s.
    fn drive(&mut self, spin_rps: [f64; 2]);

    /// Blocks or frees the wheels of the sides.
    fn jam(&mut self, jammed: [bool; 2]);

    /// Work before the physics step.
    fn before_step(&mut self, physics: &mut Physics, world: &World);

    /// Reads the outcome of the physics step.
    fn after_step(&mut self, physics: &Physics);

    /// State after the last step.
    fn state(&self) -> &VehicleState;

    /// Puts the robot, at rest, somewhere else.
    fn place(&mut self, physics: &mut Physics, world_from_robot: &Isometry3<f64>);

    /// Changes the body's velocity at once, by `change_mps` in the world.
    fn shove(&mut self, physics: &mut Physics, change_mps: &Vector3<f64>);

    /// Takes the robot out of the world.
    fn remove(&mut self, physics: &mut Physics);
}

/// A new robot of `class` at a pose.
pub(crate) fn spawn(
    motion: Motion,
    class: &RobotClass,
    key: RobotKey,
    physics: &mut Physics,
    world_from_robot: &Isometry3<f64>,
) -> Box<dyn Vehicle> {
    match motion {
        Motion::Rigid => Box::new(RigidVehicle::new(class, key, physics, world_from_robot)),
        Motion::Ideal => Box::new(IdealVehicle::new(class, key, physics, world_from_robot)),
    }
}
