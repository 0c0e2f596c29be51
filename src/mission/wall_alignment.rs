//! Lines of a tilted laser on the way, laid over the walls of the map while no inertial unit tells of turns.
//!
//! The wheels of a skid-steered robot count turns that the ground gives them only in part, and how large that part is
//! changes with the way it drives. After some metres of that it is no longer known which room it is in, and it drives
//! by a map that has turned under it. Each line is held against what sweeps have mapped, so that only what no wall
//! shows is left to the wheels.

use super::alignment::{LATE_S, level_part, with_level_part};
use super::belief::Belief;
use super::lines::Passing;
use crate::mapping::wall_alignment::Walls;
use crate::mapping::{Motion, MotionSource};
use crate::scan::{LaserLine, Return};
use nalgebra::{Isometry3, Matrix3, Point3};
use serde::{Deserialize, Serialize};

/// A robot that has moved by less since the last line was held against the walls learns nothing from another.
const MOVED_M: f64 = 0.05;
const MOVED_RAD: f64 = 0.02;
/// What lies lower than this over the floor that the robot stands on may be floor, which goes with the robot, in
/// metres.
const OVER_FLOOR_M: f64 = 0.12;
/// Beams that are held against walls at most.
const MOST_BEAMS: usize = 200;
/// What walls tell is off by at least this much, however many points lie on them: metres and radians.
const LEAST_M: f64 = 0.02;
const LEAST_RAD: f64 = 0.01;

/// What lines have told since the last sweep.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct WallAligner {
    /// What odometry alone has told since.
    since: Motion,
    /// Where the robot was on the leg when a line was last held against the walls.
    last: Isometry3<f64>,
}

impl WallAligner {
    /// Takes in what odometry tells.
    pub(super) fn moved(&mut self, before_from_after: &Isometry3<f64>, source: MotionSource) {
        self.since.append(before_from_after, source);
    }
}

impl Belief {
    /// Holds a line, taken where dead reckoning has the robot `passing`, against the walls of the map, and corrects dead
    /// reckoning by what they tell. Returns where on the leg it was taken.
    pub(super) fn hold_against_walls(
        &mut self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        passing: &Passing,
    ) -> Isometry3<f64> {
        let begin_from_robot = passing.keyframe_from_robot;
        let way = self.walls.last.inverse() * begin_from_robot;
        let has_moved = way.translation.vector.norm() > MOVED_M || way.rotation.angle() > MOVED_RAD;
        if !has_moved || self.attitude().is_some() || self.mapper.is_empty() {
            return begin_from_robot;
        }
        let world_from_begin = self.keyframe_pose();
        let told = world_from_begin * begin_from_robot;
        // The covariance is that of the motion in the frame at the beginning.
        let noise = &self.mapper.config().odometry;
        let late =
            [passing.speed_mps, passing.speed_mps, passing.turn_rps].map(|rate| LATE_S * rate);
        let late = Matrix3::from_diagonal(&late.map(|late| late * late).into());
        let turned = level_turn(&world_from_begin);
        let reckoned = level_part(&noise.covariance(self.mapper.motion())) + late;
        let floor_m = -self.live.shape().base_above_floor_m;
        let mut points = beams(line, robot_from_sensor);
        points.retain(|point| point.z > floor_m + OVER_FLOOR_M);
        let eye = told * robot_from_sensor.translation.vector;
        let walls = Walls::of(self.mapper.landmarks(), &Point3::from(eye));
        let in_world = turned * reckoned * turned.transpose();
        self.walls.last = begin_from_robot;
        let Some(found) = walls.align(&points, &told, &in_world) else { return begin_from_robot };
        let least = Matrix3::from_diagonal(
            &[LEAST_M, LEAST_M, LEAST_RAD].map(|sigma| sigma * sigma).into(),
        );
        let known = turned.transpose() * found.covariance * turned + late + least;
        let covariance = with_level_part(noise.covariance(&self.walls.since), &known);
        let at = world_from_begin.inverse() * found.world_from_robot;
        self.put_on_leg(&begin_from_robot, &at);
        let now = self.leg.begin_from_robot();
        self.mapper.replace_since(&Motion::default(), &now, &covariance);
        self.walls.last = at;
        let (_, _, heading_rad) = self.world_from_robot().rotation.euler_angles();
        self.motion.settle_heading_on_way(heading_rad);
        at
    }
}

/// (x, y, heading) in the frame at the beginning of a leg, in the world's axes.
fn level_turn(world_from_begin: &Isometry3<f64>) -> Matrix3<f64> {
    let (_, _, heading_rad) = world_from_begin.rotation.euler_angles();
    let (sin, cos) = heading_rad.sin_cos();
    Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0)
}

/// What the beams of a line hit, in the robot's frame.
fn beams(line: &LaserLine, robot_from_sensor: &Isometry3<f64>) -> Vec<Point3<f64>> {
    let stride = line.len().div_ceil(MOST_BEAMS).max(1);
    (0..line.len())
        .step_by(stride)
        .filter_map(|beam| match line.classify(beam) {
            Return::Hit(range_m) => {
                Some(robot_from_sensor * Point3::from(line.direction(beam).scale(range_m)))
            }
            Return::Nothing | Return::Missing => None,
        })
        .collect()
}
