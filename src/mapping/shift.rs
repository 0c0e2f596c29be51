//! How far apart two explanations put the robot.

use super::belief::Belief;
use nalgebra::Vector3;

/// Standard deviation of a plane's tilt above which its turning says nothing of the robot's: pairs turn small
/// facets as they please.
const LOOSE_RAD: f64 = 0.03;

/// How far apart two beliefs have the robot beside planes of both: not in the world, for what a loop
/// closes may move the one or the other there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Shift {
    /// Greatest difference of the distances to planes that stand more or less upright, in metres.
    level_m: f64,
    /// The same for those that lie: floors and ceilings.
    up_m: f64,
    /// Greatest angle between the directions of a plane's normal, seen by the robot.
    turn_rad: f64,
}

impl Shift {
    /// Between two beliefs over the same planes, beside `planes`, as positions in either.
    pub(super) fn between(a: &Belief, b: &Belief, planes: impl Iterator<Item = usize>) -> Self {
        let mut shift = Self::default();
        for plane in planes {
            let seen = |belief: &Belief| {
                let plane_from_robot = belief.planes[plane].inverse() * belief.world_from_robot;
                let normal = plane_from_robot.rotation.inverse() * Vector3::z();
                (plane_from_robot.translation.z, normal)
            };
            let ((distance, normal), (other_distance, other_normal)) = (seen(a), seen(b));
            let up = a.planes[plane].rotation * Vector3::z();
            let is_loose = a.tilt_variance(plane) > LOOSE_RAD * LOOSE_RAD;
            let gap = if is_loose {
                // A turn of its own would reach the robot by its whole distance: what counts is its middle.
                let middle = |belief: &Belief| {
                    let robot = belief.world_from_robot.translation.vector;
                    robot - belief.planes[plane].translation.vector
                };
                up.dot(&(middle(a) - middle(b)))
            } else {
                distance - other_distance
            };
            let greatest = if a.lies(plane) { &mut shift.up_m } else { &mut shift.level_m };
            *greatest = greatest.max(gap.abs());
            if !is_loose {
                shift.turn_rad = shift.turn_rad.max(normal.angle(&other_normal));
            }
        }
        shift
    }

    /// Whether any part is larger than it may be.
    pub(super) fn exceeds(&self, level_m: f64, up_m: f64, turn_rad: f64) -> bool {
        self.level_m > level_m || self.up_m > up_m || self.turn_rad > turn_rad
    }
}
