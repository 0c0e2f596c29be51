//! What a robot's sensors can meet: the world, and the bodies of the other robots.

use super::physics::RobotKey;
use super::solid::Solid;
use super::world::{ObjectId, World};
use nalgebra::{Isometry3, Point3, Vector3};
use std::sync::Arc;

/// A robot's body as others see it.
#[derive(Clone, Debug)]
pub(crate) struct RobotBody {
    pub(crate) key: RobotKey,
    pub(crate) world_from_robot: Isometry3<f64>,
    pub(crate) solids: Arc<Vec<(Isometry3<f64>, Solid)>>,
    /// Radius in metres about the origin within which all of the body lies.
    pub(crate) radius_m: f64,
}

/// What a ray met first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Seen {
    pub(crate) range_m: f64,
    pub(crate) normal: Vector3<f64>,
    /// The object of the map, or `None` for a robot.
    pub(crate) object: Option<ObjectId>,
}

/// The world without the robot that looks: a server ignores a sensor's owner.
#[derive(Clone, Copy)]
pub(crate) struct Surroundings<'a> {
    pub(crate) world: &'a World,
    pub(crate) bodies: &'a [RobotBody],
    pub(crate) own: RobotKey,
}

impl Surroundings<'_> {
    /// The nearest surface within `max_m` along a ray of unit direction.
    pub(crate) fn cast(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        max_m: f64,
    ) -> Option<Seen> {
        let mut nearest = self.world.cast_ray(origin, direction, max_m).map(|hit| Seen {
            range_m: hit.range_m,
            normal: hit.normal,
            object: Some(hit.object),
        });
        for body in self.bodies.iter().filter(|body| body.key != self.own) {
            let reach = nearest.map_or(max_m, |seen| seen.range_m);
            if let Some((range_m, normal)) = body.cast(origin, direction, reach) {
                nearest = Some(Seen { range_m, normal, object: None });
            }
        }
        nearest
    }
}

impl RobotBody {
    fn cast(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        max_m: f64,
    ) -> Option<(f64, Vector3<f64>)> {
        let to_centre = self.world_from_robot.translation.vector - origin.coords;
        let along = to_centre.dot(direction);
        let aside_squared = to_centre.norm_squared() - along * along;
        if along < -self.radius_m
            || along > max_m + self.radius_m
            || aside_squared > self.radius_m * self.radius_m
        {
            return None;
        }
        let mut nearest: Option<(f64, Vector3<f64>)> = None;
        for (robot_from_part, solid) in self.solids.iter() {
            let place = self.world_from_robot * robot_from_part;
            let reach = nearest.map_or(max_m, |(range, _)| range);
            let local_origin = place.inverse_transform_point(origin);
            let local_direction = place.inverse_transform_vector(direction);
            if let Some((range, normal)) = solid.cast(&local_origin, &local_direction, reach) {
                nearest = Some((range, place.rotation * normal));
            }
        }
        nearest
    }
}
