//! Lines of a laser that does not tilt, laid over an earlier one: between them the robot went where both fit.
//!
//! Lines are held against key lines that were taken near by and looked the same way, the oldest first, so that
//! errors do not add up from line to line and a robot that comes back takes up where it was; an alignment
//! takes the place of all motion since its key line.

use super::belief::Belief;
use super::lines::Passing;
use crate::geometry::wrap_pi;
use crate::mapping::line_alignment::{Alignment, LevelLine};
use crate::mapping::{Motion, MotionSource};
use crate::scan::{LaserLine, Return};
use nalgebra::{Isometry2, Isometry3, Matrix3, Matrix6, Point2, Point3, Translation3, Vector3};
use nalgebra::{UnitQuaternion, Vector2};
use serde::{Deserialize, Serialize};

/// Beams that leave the level by more than this end on floor or ceiling, and so do those of a robot that
/// leans by more: sine.
const LEVEL_SINE: f64 = 0.05;
/// A robot that has moved by less since the last alignment learns nothing from another.
const MOVED_M: f64 = 0.1;
const MOVED_RAD: f64 = 0.05;
/// A key line is of use up to this far from it and turned by so much, and another is taken when less of the
/// best one is seen.
const KEY_M: f64 = 2.0;
const KEY_RAD: f64 = 0.7;
const KEY_SHARE: f64 = 0.75;
/// Key lines that a line is held against at most, and those that are kept.
const TRIES: usize = 3;
const MOST_KEYS: usize = 80;
/// What a robot is off by beside a key line at most, however long its way since: it was corrected on it.
const MOST_M: f64 = 0.3;
const MOST_RAD: f64 = 0.15;
/// Gate on the squared Mahalanobis distance of an alignment from what was reckoned: 99.9 % of χ² with three
/// degrees of freedom.
const GATE: f64 = 16.266;
/// By how much the time at which rays were cast is unknown, in seconds: a robot under way is elsewhere by
/// then.
pub(super) const LATE_S: f64 = 0.05;

/// The components of a pose's error that level lines tell: x, y, turn.
const TOLD: [usize; 3] = [0, 1, 5];

/// The line that others are held against.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Key {
    line: LevelLine,
    /// The mapper's motion when it was taken, and where the robot was on the leg.
    mark: Motion,
    begin_from_key: Isometry3<f64>,
    /// What odometry alone has told since.
    since: Motion,
}

/// Holds lines against each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct LineAligner {
    /// In the order in which they were taken.
    keys: Vec<Key>,
    /// Where the robot was on the leg when a line was last held against the key.
    last: Isometry3<f64>,
}

impl LineAligner {
    /// Takes in what odometry tells.
    pub(super) fn moved(&mut self, before_from_after: &Isometry3<f64>, source: MotionSource) {
        for key in &mut self.keys {
            key.since.append(before_from_after, source);
        }
    }

    /// Forgets the key lines: the robot is known otherwise, or elsewhere.
    pub(super) fn restart(&mut self) {
        self.keys.clear();
    }
}

impl Belief {
    /// Holds a level line, taken where dead reckoning has the robot `passing`, against key lines, and corrects
    /// dead reckoning by what they tell. Returns where on the leg it was taken.
    pub(super) fn align_line(
        &mut self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        passing: &Passing,
    ) -> Isometry3<f64> {
        let begin_from_robot = &passing.keyframe_from_robot;
        let world_from_sensor = self.keyframe_pose() * begin_from_robot * robot_from_sensor;
        if (world_from_sensor.rotation * Vector3::z()).xy().norm() > LEVEL_SINE {
            // What it sees is no section of what it saw before.
            return *begin_from_robot;
        }
        let way = self.aligner.last.inverse() * begin_from_robot;
        let has_moved = way.translation.vector.norm() > MOVED_M || way.rotation.angle() > MOVED_RAD;
        if !self.aligner.keys.is_empty() && !has_moved {
            return *begin_from_robot;
        }
        let seen = level_line(line, robot_from_sensor);
        let found = self.aligned(&seen, passing);
        let at = found
            .as_ref()
            .map_or(*begin_from_robot, |found| self.go_on_from(begin_from_robot, found));
        self.aligner.last = at;
        if found.is_none_or(|found| found.alignment.share < KEY_SHARE) {
            // The key line stands where the robot is by now: so far odometry has told the motion.
            let now_from_then = self.leg.begin_from_robot().inverse() * at;
            if self.aligner.keys.len() == MOST_KEYS {
                self.aligner.keys.remove(0);
            }
            self.aligner.keys.push(Key {
                line: level_line(line, &(now_from_then * robot_from_sensor)),
                mark: *self.mapper.motion(),
                begin_from_key: self.leg.begin_from_robot(),
                since: Motion::default(),
            });
        }
        at
    }

    /// The alignment with one of the key lines near by.
    fn aligned(&self, line: &LevelLine, passing: &Passing) -> Option<Found> {
        let begin_from_robot = &passing.keyframe_from_robot;
        let noise = &self.mapper.config().odometry;
        let keys = self.aligner.keys.iter().enumerate();
        let near = keys.filter_map(|(number, key)| {
            let reckoned = key.begin_from_key.inverse() * begin_from_robot;
            is_near(&reckoned).then_some((number, key, reckoned))
        });
        let mut found: Vec<Found> = near
            .take(TRIES)
            .filter_map(|(number, key, reckoned)| {
                let mut covariance = noise.covariance(&key.since);
                bound(&mut covariance, passing);
                let told = planar(&reckoned);
                let alignment = key.line.align(line, &told, &level_part(&covariance))?;
                // Height, roll and pitch stay as they were reckoned.
                let turn =
                    wrap_pi(alignment.first_from_second.rotation.angle() - told.rotation.angle());
                let gap = alignment.first_from_second.translation.vector - told.translation.vector;
                let gap = Vector3::new(gap.x, gap.y, turn);
                let expected = level_part(&covariance) + alignment.covariance;
                if gap.dot(&expected.cholesky()?.solve(&gap)) > GATE {
                    // Lines that fit elsewhere are of something else: shelves look alike.
                    return None;
                }
                let turned = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
                let shift = alignment.first_from_second.translation.vector;
                let place = Translation3::new(shift.x, shift.y, reckoned.translation.z);
                let key_from_robot = Isometry3::from_parts(place, turned * reckoned.rotation);
                Some(Found { number, alignment, key_from_robot, covariance })
            })
            .collect();
        // The oldest of which most is seen.
        let most = found.iter().map(|found| found.alignment.share).fold(0.0, f64::max);
        let best = found.iter().position(|found| found.alignment.share >= most.min(KEY_SHARE))?;
        Some(found.swap_remove(best))
    }

    /// Puts an alignment in place of what was reckoned since its key line; where the line was taken then.
    fn go_on_from(&mut self, begin_from_robot: &Isometry3<f64>, found: &Found) -> Isometry3<f64> {
        let since_line = begin_from_robot.inverse() * self.leg.begin_from_robot();
        let covariance = with_level_part(found.covariance, &found.alignment.covariance);
        let key = &self.aligner.keys[found.number];
        let (mark, begin_from_key) = (key.mark, key.begin_from_key);
        self.mapper.replace_since(&mark, &(found.key_from_robot * since_line), &covariance);
        let at = begin_from_key * found.key_from_robot;
        self.put_on_leg(begin_from_robot, &at);
        at
    }

    /// Puts the robot `at` a place on the leg where it was `reckoned` to be, and with it where it has been since.
    pub(super) fn put_on_leg(&mut self, reckoned: &Isometry3<f64>, at: &Isometry3<f64>) {
        let correction = at * reckoned.inverse();
        for (_, pose) in &mut self.history {
            *pose = correction * *pose;
        }
        let now = correction * self.leg.begin_from_robot();
        self.leg.correct(&now);
    }
}

/// A line beside a key line.
struct Found {
    /// Place of the key line in the list.
    number: usize,
    alignment: Alignment,
    key_from_robot: Isometry3<f64>,
    /// What odometry may be off by in the frame of the key line.
    covariance: Matrix6<f64>,
}

fn is_near(key_from_robot: &Isometry3<f64>) -> bool {
    key_from_robot.translation.vector.norm() < KEY_M && key_from_robot.rotation.angle() < KEY_RAD
}

/// Bounds what odometry may be off by over the ground, and adds what rays of a robot under way are.
fn bound(covariance: &mut Matrix6<f64>, passing: &Passing) {
    let late = [passing.speed_mps, passing.speed_mps, passing.turn_rps].map(|rate| LATE_S * rate);
    let most = [MOST_M, MOST_M, MOST_RAD];
    let scale = |component: usize, most: f64| {
        (most / covariance[(component, component)].max(1e-12).sqrt()).min(1.0)
    };
    let scales: Vec<f64> = TOLD.iter().zip(most).map(|(&c, most)| scale(c, most)).collect();
    for (component, scale) in TOLD.into_iter().zip(scales) {
        for other in 0..6 {
            covariance[(component, other)] *= scale;
            covariance[(other, component)] *= scale;
        }
    }
    for (component, late) in TOLD.into_iter().zip(late) {
        covariance[(component, component)] += late * late;
    }
}

/// A covariance with what is told over the ground in place of what it said of that.
pub(super) fn with_level_part(mut covariance: Matrix6<f64>, told: &Matrix3<f64>) -> Matrix6<f64> {
    for (i, row) in TOLD.into_iter().enumerate() {
        covariance.row_mut(row).fill(0.0);
        covariance.column_mut(row).fill(0.0);
        for (j, column) in TOLD.into_iter().enumerate().take(i + 1) {
            covariance[(row, column)] = told[(i, j)];
            covariance[(column, row)] = told[(i, j)];
        }
    }
    covariance
}

/// What a covariance says of x, y and turn.
pub(super) fn level_part(covariance: &Matrix6<f64>) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| covariance[(TOLD[i], TOLD[j])])
}

fn planar(pose: &Isometry3<f64>) -> Isometry2<f64> {
    let ahead = pose.rotation * Vector3::x();
    Isometry2::new(Vector2::new(pose.translation.x, pose.translation.y), ahead.y.atan2(ahead.x))
}

/// A line's points in the robot's frame.
fn level_line(line: &LaserLine, robot_from_sensor: &Isometry3<f64>) -> LevelLine {
    let ends: Vec<Option<Point2<f64>>> = (0..line.len())
        .map(|beam| match line.classify(beam) {
            Return::Hit(range_m) => {
                let p = robot_from_sensor * Point3::from(line.direction(beam).scale(range_m));
                Some(p.xy())
            }
            Return::Nothing | Return::Missing => None,
        })
        .collect();
    LevelLine::new(&ends)
}
