//! Perfect motion: the body follows its wheels without slip and lies on the ground beneath them.
//!
//! For tests of what stands above the physics. Walls and steps higher than a wheel can climb stop
//! it; an edge drops it.

use super::{Vehicle, VehicleState};
use crate::sim::catalogue::RobotClass;
use crate::sim::glam;
use crate::sim::physics::{Physics, RobotKey, STEP_S};
use crate::sim::spec::WheelSpec;
use crate::sim::world::World;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::dynamics::{RigidBodyBuilder, RigidBodyHandle};
use rapier3d_f64::geometry::ColliderBuilder;

/// The highest step that wheels take, as a part of their radius.
const STEP_SHARE: f64 = 0.6;

pub(crate) struct IdealVehicle {
    wheels: WheelSpec,
    origin_height_m: f64,
    half_length_m: f64,
    body: RigidBodyHandle,
    target_rps: [f64; 2],
    current_rps: [f64; 2],
    jammed: [bool; 2],
    state: VehicleState,
}

impl IdealVehicle {
    pub(crate) fn new(
        class: &RobotClass,
        key: RobotKey,
        physics: &mut Physics,
        world_from_robot: &Isometry3<f64>,
    ) -> Self {
        let bodies = &mut physics.bodies;
        let body = bodies.insert_body(
            RigidBodyBuilder::kinematic_position_based().pose(glam::pose(world_from_robot)),
        );
        for part in &class.part {
            let half = Vector3::from(part.size) / 2.0;
            let collider = ColliderBuilder::cuboid(half.x, half.y, half.z)
                .translation(glam::vector(&part.center.into()))
                .user_data(Physics::label(key));
            bodies.insert_collider(collider, Some(body));
        }
        Self {
            wheels: class.wheels.clone(),
            origin_height_m: class.origin_height_m(),
            half_length_m: class.extents_m()[0] / 2.0,
            body,
            target_rps: [0.0; 2],
            current_rps: [0.0; 2],
            jammed: [false; 2],
            state: VehicleState::at(*world_from_robot, class.wheel_centres().len()),
        }
    }

    /// The pose on the ground under plane position and heading, or `None` where the way is barred.
    fn on_ground(&self, world: &World, x: f64, y: f64, yaw: f64) -> Option<Isometry3<f64>> {
        let now = self.state.world_from_robot.translation.vector;
        let step = STEP_SHARE * self.wheels.radius_m;
        let (sin, cos) = yaw.sin_cos();
        let reach = [self.wheels.base_m / 2.0, self.wheels.separation_m / 2.0];
        let from = now.z - self.origin_height_m + self.wheels.radius_m + step;
        let mut heights = [0.0; 4];
        for (height, [ahead, left]) in
            heights.iter_mut().zip([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
        {
            let (forward, side) = (ahead * reach[0], left * reach[1]);
            let (px, py) = (x + cos * forward - sin * side, y + sin * forward + cos * side);
            *height = world.floor_height_m(px, py, from)?;
        }
        let floor = now.z - self.origin_height_m;
        let barred = heights.iter().any(|height| height - floor > step + 0.5 * reach[0]);
        (!barred).then(|| {
            let [fl, fr, rl, rr] = heights;
            let forward =
                Vector3::new(2.0 * reach[0] * cos, 2.0 * reach[0] * sin, (fl + fr - rl - rr) / 2.0);
            let left = Vector3::new(
                -2.0 * reach[1] * sin,
                2.0 * reach[1] * cos,
                (fl + rl - fr - rr) / 2.0,
            );
            let up = forward.cross(&left).normalize();
            let ahead = forward.normalize();
            let axes = Matrix3::from_columns(&[ahead, up.cross(&ahead), up]);
            let mean = (fl + fr + rl + rr) / 4.0;
            let origin = Vector3::new(x, y, mean) + up * self.origin_height_m;
            Isometry3::from_parts(
                Translation3::from(origin),
                UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes)),
            )
        })
    }

    /// Whether something stands in the way of the hull within this step.
    fn free_ahead(&self, world: &World, motion: &Vector3<f64>) -> bool {
        let length = motion.norm();
        if length < 1e-9 {
            return true;
        }
        let origin = Point3::from(self.state.world_from_robot.translation.vector);
        world.cast_ray(&origin, &(motion / length), self.half_length_m + length).is_none()
    }
}

impl Vehicle for IdealVehicle {
    fn drive(&mut self, spin_rps: [f64; 2]) {
        let most = self.wheels.max_spin_rps;
        self.target_rps = spin_rps.map(|spin| spin.clamp(-most, most));
    }

    fn jam(&mut self, jammed: [bool; 2]) {
        self.jammed = jammed;
    }

    fn before_step(&mut self, physics: &mut Physics, world: &World) {
        let change = self.wheels.max_spin_change_rps2 * STEP_S;
        for side in 0..2 {
            let aim = if self.jammed[side] { 0.0 } else { self.target_rps[side] };
            let gap = aim - self.current_rps[side];
            self.current_rps[side] += gap.clamp(-change, change);
        }
        let [left, right] = self.current_rps.map(|spin| spin * self.wheels.radius_m * STEP_S);
        let before = self.state.world_from_robot;
        let ahead = before.rotation * Vector3::x();
        let yaw = ahead.y.atan2(ahead.x);
        let turn = (right - left) / self.wheels.separation_m;
        let way = (left + right) / 2.0;
        let (sin, cos) = (yaw + turn / 2.0).sin_cos();
        let motion = Vector3::new(way * cos, way * sin, 0.0);
        // The point of the ground between the wheels moves; the origin above it leans with the body.
        let foot =
            before.translation.vector - before.rotation * Vector3::z() * self.origin_height_m;
        let flat = foot + motion;
        let next = self
            .free_ahead(world, &motion)
            .then(|| self.on_ground(world, flat.x, flat.y, yaw + turn))
            .flatten();
        for (number, angle) in self.state.wheel_angles_rad.iter_mut().enumerate() {
            *angle += self.current_rps[number % 2] * STEP_S;
        }
        let after = next.unwrap_or(before);
        self.state.velocity_mps = (after.translation.vector - before.translation.vector) / STEP_S;
        self.state.angular_rps =
            (after.rotation * before.rotation.inverse()).scaled_axis() / STEP_S;
        self.state.world_from_robot = after;
        physics.bodies.bodies[self.body].set_next_kinematic_position(glam::pose(&after));
    }

    fn after_step(&mut self, _physics: &Physics) {}

    fn state(&self) -> &VehicleState {
        &self.state
    }

    fn place(&mut self, physics: &mut Physics, world_from_robot: &Isometry3<f64>) {
        self.state.world_from_robot = *world_from_robot;
        physics.bodies.bodies[self.body].set_position(glam::pose(world_from_robot), true);
    }

    fn shove(&mut self, _physics: &mut Physics, _change_mps: &Vector3<f64>) {}

    fn remove(&mut self, physics: &mut Physics) {
        physics.bodies.remove_body(self.body);
    }
}
