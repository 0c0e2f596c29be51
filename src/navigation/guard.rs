use crate::scan::{LaserLine, Return};
use crate::terrain::{CellClass, CellIndex, Grid, RobotShape};
use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};

/// Farther out the beams lie too far apart, and the line's height is too uncertain, to confirm ground.
const CONFIRMED_M: f64 = 3.0;

/// How the guard line is judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuardConfig {
    /// What the corridor is wider than the hull on each side, in metres. [0, 0.5]
    pub side_margin_m: f64,
    /// Standard deviation of the body's attitude while it drives, in radians. [0, 0.1]
    pub attitude_sigma_rad: f64,
    /// Widest stretch of the line across the corridor that may go unread, in metres. [0, 0.5]
    pub unread_m: f64,
}

impl Default for GuardConfig {
    fn default() -> Self {
        Self { side_margin_m: 0.08, attitude_sigma_rad: 0.006, unread_m: 0.12 }
    }
}

/// Watches the line that a parked laser draws on the ground ahead.
///
/// Pure: the caller parks the tilt so that the line meets level ground beyond the braking distance,
/// and stops the robot on any verdict but [`GuardVerdict::Clear`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Guard {
    config: GuardConfig,
    half_width_m: f64,
    front_m: f64,
    floor_z_robot_m: f64,
    max_step_m: f64,
    height_m: f64,
}

/// What the guard line says about the corridor ahead. Places are in the robot frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum GuardVerdict {
    /// Nothing new across the corridor.
    Clear {
        /// Least distance ahead of `base_link` at which ground was confirmed, metres; `None` where
        /// all that was seen are obstacles and edges known before.
        ahead_m: Option<f64>,
    },
    /// Something stands on the ground, or the ground rises by more than the robot climbs.
    Obstacle {
        /// Metres ahead of `base_link`.
        ahead_m: f64,
        /// Metres to the left.
        left_m: f64,
        /// Height above the expected ground, metres.
        rise_m: f64,
    },
    /// The ground lies lower than expected, or did not return.
    DropOff {
        /// Metres ahead of `base_link` at which ground was expected.
        ahead_m: f64,
        /// Metres to the left.
        left_m: f64,
        /// Depth below the expected ground, metres; `None` where nothing returned.
        depth_m: Option<f64>,
    },
    /// The line cannot tell: too few of its beams meet the ground, or too many went unread.
    Blind {
        /// Widest unread stretch across the corridor, metres.
        unread_m: f64,
    },
}

impl std::fmt::Display for GuardVerdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let side = |left_m: f64| match left_m {
            left_m if left_m < -0.05 => format!(", {:.2} m right", -left_m),
            left_m if left_m > 0.05 => format!(", {left_m:.2} m left"),
            _ => String::new(),
        };
        match *self {
            Self::Clear { ahead_m: Some(ahead_m) } => {
                write!(f, "ground confirmed {ahead_m:.2} m ahead")
            }
            Self::Clear { ahead_m: None } => write!(f, "nothing new ahead"),
            Self::Obstacle { ahead_m, left_m, rise_m } => {
                write!(f, "something {rise_m:.2} m high {ahead_m:.2} m ahead{}", side(left_m))
            }
            Self::DropOff { ahead_m, left_m, depth_m: Some(depth_m) } => {
                write!(f, "ground {depth_m:.2} m lower {ahead_m:.2} m ahead{}", side(left_m))
            }
            Self::DropOff { ahead_m, left_m, depth_m: None } => {
                write!(f, "no ground {ahead_m:.2} m ahead{}", side(left_m))
            }
            Self::Blind { unread_m } => write!(f, "{unread_m:.2} m of the way unread"),
        }
    }
}

impl GuardVerdict {
    /// Whether the robot may go on.
    pub fn is_clear(&self) -> bool {
        matches!(self, Self::Clear { .. })
    }
}

impl Guard {
    /// A guard for a robot of the given shape.
    pub fn new(config: GuardConfig, shape: &RobotShape) -> Self {
        Self {
            half_width_m: 0.5 * shape.width_m + config.side_margin_m,
            front_m: 0.5 * shape.length_m,
            floor_z_robot_m: -shape.base_above_floor_m,
            max_step_m: shape.max_step_m,
            height_m: shape.height_m + shape.clearance_m,
            config,
        }
    }

    /// Judges one line taken with the sensor at `robot_from_sensor`.
    ///
    /// `known`, the robot's pose and the grid, excuses what is no news: ground that is not level but
    /// known to be drivable (the foot of a ramp would stop the robot for ever), and obstacles and
    /// edges where the grid already says that nothing may be driven.
    pub fn judge(
        &self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        known: Option<(&Isometry3<f64>, &Grid)>,
    ) -> GuardVerdict {
        let origin = Point3::from(robot_from_sensor.translation.vector);
        let known = Known { known };
        let mut obstacle: Option<GuardVerdict> = None;
        let mut drop: Option<GuardVerdict> = None;
        let mut confirmed_m = f64::INFINITY;
        // Left bounds of the corridor that was read, in order from right to left.
        let mut read: Vec<f64> = vec![-self.half_width_m];
        for beam in 0..line.len() {
            let ray = robot_from_sensor * line.direction(beam);
            let due_m = if ray.z < -0.02 {
                (origin.z - self.floor_z_robot_m) / -ray.z
            } else {
                f64::INFINITY
            };
            let due = origin + ray * due_m;
            let in_corridor =
                due_m.is_finite() && due.x > self.front_m && due.y.abs() <= self.half_width_m;
            let seen = match line.classify(beam) {
                Return::Missing => continue,
                Return::Nothing => {
                    if in_corridor {
                        read.push(due.y);
                        if !known.is_closed(&due) {
                            let found = GuardVerdict::DropOff {
                                ahead_m: due.x,
                                left_m: due.y,
                                depth_m: None,
                            };
                            drop = nearer(drop, found);
                        }
                    }
                    continue;
                }
                Return::Hit(range_m) => origin + ray * range_m,
            };
            let rise_m = seen.z - self.floor_z_robot_m;
            let away_m = (seen - origin).norm();
            let tolerance_m =
                self.max_step_m + 0.01 + 3.0 * self.config.attitude_sigma_rad * away_m;
            if rise_m.abs() > tolerance_m && known.is_ground(&seen, tolerance_m) {
                if in_corridor {
                    confirmed_m = confirmed_m.min(seen.x);
                }
            } else if rise_m > tolerance_m {
                let in_way = seen.x > 0.0
                    && seen.y.abs() <= self.half_width_m
                    && rise_m < self.height_m
                    && (due_m.is_finite() || away_m < 2.0);
                if in_way && !known.is_closed(&seen) {
                    let found = GuardVerdict::Obstacle { ahead_m: seen.x, left_m: seen.y, rise_m };
                    obstacle = nearer(obstacle, found);
                }
            } else if in_corridor && rise_m < -tolerance_m {
                if !known.is_closed(&due) && !known.is_mapped(&seen, tolerance_m) {
                    let depth_m = Some(-rise_m);
                    let found = GuardVerdict::DropOff { ahead_m: due.x, left_m: due.y, depth_m };
                    drop = nearer(drop, found);
                }
            } else if in_corridor {
                confirmed_m = confirmed_m.min(seen.x);
            }
            if in_corridor {
                read.push(due.y);
            }
        }
        if let Some(verdict) = drop.or(obstacle) {
            return verdict;
        }
        read.push(self.half_width_m);
        read.sort_by(f64::total_cmp);
        let unread_m = read.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        if unread_m > self.config.unread_m {
            return GuardVerdict::Blind { unread_m };
        }
        GuardVerdict::Clear { ahead_m: confirmed_m.is_finite().then_some(confirmed_m) }
    }
}

impl Guard {
    /// Makes the ground that a guard line met sure in `grid`, where it lies as the grid has it. Call
    /// it for every line taken while driving: the robot then rolls only over what its own line has
    /// swept, or a sweep has seen closely.
    pub fn confirm(
        &self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
        world_from_robot: &Isometry3<f64>,
        grid: &mut Grid,
    ) {
        let world_from_sensor = world_from_robot * robot_from_sensor;
        let origin = Point3::from(world_from_sensor.translation.vector);
        for beam in 0..line.len() {
            let Return::Hit(range_m) = line.classify(beam) else { continue };
            let p = origin + world_from_sensor * line.direction(beam) * range_m;
            let met = range_m <= CONFIRMED_M
                && grid
                    .height_at(p.x, p.y)
                    .is_some_and(|height_m| (p.z - height_m).abs() <= self.level_m(range_m));
            if met {
                grid.confirm(p.x, p.y);
            }
        }
    }
}

impl Guard {
    /// Where a line taken with the sensor at `robot_from_sensor` met ground that is level with what the
    /// wheels stand on, in the robot frame.
    pub fn level_ground(
        &self,
        line: &LaserLine,
        robot_from_sensor: &Isometry3<f64>,
    ) -> impl Iterator<Item = Point3<f64>> {
        let origin = Point3::from(robot_from_sensor.translation.vector);
        (0..line.len()).filter_map(move |beam| {
            let Return::Hit(range_m) = line.classify(beam) else { return None };
            let p = origin + robot_from_sensor * line.direction(beam) * range_m;
            let level = (p.z - self.floor_z_robot_m).abs() <= self.level_m(range_m);
            (range_m <= CONFIRMED_M && level).then_some(p)
        })
    }

    /// How far from level ground may measure at `range_m`, in metres.
    fn level_m(&self, range_m: f64) -> f64 {
        0.5 * self.max_step_m + 3.0 * self.config.attitude_sigma_rad * range_m
    }
}

/// The nearer of two findings of one kind; of equal ones the first.
fn nearer(before: Option<GuardVerdict>, found: GuardVerdict) -> Option<GuardVerdict> {
    let ahead = |verdict: &GuardVerdict| match *verdict {
        GuardVerdict::Obstacle { ahead_m, .. } | GuardVerdict::DropOff { ahead_m, .. } => ahead_m,
        GuardVerdict::Clear { .. } | GuardVerdict::Blind { .. } => f64::INFINITY,
    };
    match before {
        Some(before) if ahead(&before) <= ahead(&found) => Some(before),
        _ => Some(found),
    }
}

/// What the grid already says.
struct Known<'a> {
    known: Option<(&'a Isometry3<f64>, &'a Grid)>,
}

impl Known<'_> {
    /// Pose errors move what is known by as much.
    const SLACK_M: f64 = 0.10;

    /// Whether a point lies on ground that is known to be drivable, at its height.
    fn is_ground(&self, p_robot: &Point3<f64>, tolerance_m: f64) -> bool {
        self.is_mapped(p_robot, tolerance_m)
            && self.known.is_some_and(|(world_from_robot, grid)| {
                let p = world_from_robot * p_robot;
                grid.class_at(p.x, p.y).is_drivable()
            })
    }

    /// Whether the grid holds a surface of this level at a point's height, drivable or not. To a robot
    /// that leans, as with one side on a ramp, level ground lies too low, and is no news.
    fn is_mapped(&self, p_robot: &Point3<f64>, tolerance_m: f64) -> bool {
        self.known.is_some_and(|(world_from_robot, grid)| {
            let p = world_from_robot * p_robot;
            let height_m = grid.height_at(p.x, p.y);
            height_m.is_some_and(|height_m| (p.z - height_m).abs() <= tolerance_m)
        })
    }

    /// Whether a point lies at or close to a cell that is known and may not be driven on. Unknown
    /// ground does not count: what is seen there is news.
    fn is_closed(&self, p_robot: &Point3<f64>) -> bool {
        self.known.is_some_and(|(world_from_robot, grid)| {
            let p = world_from_robot * p_robot;
            let low = grid.cell_of(p.x - Self::SLACK_M, p.y - Self::SLACK_M);
            let high = grid.cell_of(p.x + Self::SLACK_M, p.y + Self::SLACK_M);
            (low.y..=high.y).any(|y| {
                (low.x..=high.x).any(|x| {
                    matches!(
                        grid.get(CellIndex { x, y }).class,
                        CellClass::Occupied
                            | CellClass::TooSteep
                            | CellClass::DropOff
                            | CellClass::Suspect
                            | CellClass::OtherLevel
                    )
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::GridCell;
    use crate::time::Stamp;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    /// A line taken 0.6 m above the floor with a tilt of 26° down; `range(due, left)` gives each
    /// beam's range from what level ground predicts and where it meets it.
    fn judged(range: impl Fn(f64, f64) -> f64) -> GuardVerdict {
        judged_on(range, None)
    }

    fn judged_on(
        range: impl Fn(f64, f64) -> f64,
        known: Option<(&Isometry3<f64>, &Grid)>,
    ) -> GuardVerdict {
        let shape = RobotShape::default();
        let height_m = 0.6;
        let robot_from_sensor = Isometry3::from_parts(
            Translation3::new(0.1, 0.0, height_m - shape.base_above_floor_m),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 26_f64.to_radians()),
        );
        let mut line = LaserLine {
            stamp: Stamp(0),
            first_bearing_rad: -std::f64::consts::FRAC_PI_2,
            bearing_step_rad: 1_f64.to_radians(),
            min_range_m: 0.1,
            max_range_m: 20.0,
            phantom_m: None,
            ranges_m: Vec::new(),
        };
        for beam in 0..181 {
            let ray = robot_from_sensor * line.direction(beam);
            let due_m = if ray.z < -1e-6 { height_m / -ray.z } else { 99.0 };
            line.ranges_m.push(range(due_m.min(20.0), ray.y * due_m));
        }
        Guard::new(GuardConfig::default(), &shape).judge(&line, &robot_from_sensor, known)
    }

    #[test]
    fn level_ground_is_clear_within_noise() {
        let verdict = judged(|due_m, left_m| due_m + 0.02 * (37.0 * left_m).sin());
        assert!(verdict.is_clear(), "{verdict:?}");
    }

    #[test]
    fn longer_and_missing_returns_in_the_corridor_are_drop_offs() {
        let gap = |left_m: f64| (-0.1..0.1).contains(&left_m);
        let longer = judged(|due_m, left_m| if gap(left_m) { due_m * 2.6 } else { due_m });
        assert!(
            matches!(longer, GuardVerdict::DropOff { depth_m: Some(depth), .. } if depth > 0.8),
            "{longer:?}"
        );
        let missing = judged(|due_m, left_m| if gap(left_m) { 20.0 } else { due_m });
        assert!(matches!(missing, GuardVerdict::DropOff { depth_m: None, .. }), "{missing:?}");
        let outside = judged(|due_m, left_m| if left_m > 0.6 { 20.0 } else { due_m });
        assert!(outside.is_clear(), "an edge beside the corridor: {outside:?}");
    }

    #[test]
    fn shorter_returns_in_the_corridor_are_obstacles() {
        let verdict = judged(|due_m, left_m| if left_m > 0.2 { 0.7 * due_m } else { due_m });
        assert!(matches!(verdict, GuardVerdict::Obstacle { left_m, .. } if left_m > 0.1));
        let beside = judged(|due_m, left_m| if left_m > 0.9 { 0.7 * due_m } else { due_m });
        assert!(beside.is_clear(), "{beside:?}");
    }

    #[test]
    fn unread_beams_are_not_taken_for_ground() {
        let verdict = judged(|due_m, left_m| if left_m.abs() < 0.1 { f64::NAN } else { due_m });
        assert!(matches!(verdict, GuardVerdict::Blind { .. }), "{verdict:?}");
        let one = judged(|due_m, left_m| if left_m.abs() < 0.015 { f64::NAN } else { due_m });
        assert!(one.is_clear(), "one lost beam: {one:?}");
    }

    #[test]
    fn a_surface_that_the_map_holds_at_its_height_is_no_drop_off() {
        let shape = RobotShape::default();
        let floor_m = -0.25;
        let world_from_robot = Isometry3::translation(0.0, 0.0, shape.base_above_floor_m);
        // Where 0.6 m above the floor are 0.85 m above it.
        let lower = |due_m: f64, _: f64| due_m * (0.6 - floor_m) / 0.6;
        // What the map holds where the line is seen, 1.8 m ahead; before that, where it was due, is floor.
        let on = |class: CellClass, height_m: f64| {
            let cells = (0..80 * 80).map(|at| {
                let far = at % 80 >= 40 + 32;
                let (class, height_m) =
                    if far { (class, height_m) } else { (CellClass::Free, 0.0) };
                GridCell { class, height_m: height_m as f32, ..GridCell::default() }
            });
            let grid = Grid::from_cells(0.05, CellIndex { x: -40, y: -40 }, 80, cells.collect());
            judged_on(lower, Some((&world_from_robot, &grid)))
        };
        // One side of the robot on a ramp: the floor ahead is too steep for it, but as mapped.
        assert!(on(CellClass::TooSteep, floor_m).is_clear());
        for verdict in [on(CellClass::Free, 0.0), on(CellClass::Unknown, f64::NAN)] {
            assert!(matches!(verdict, GuardVerdict::DropOff { .. }), "{verdict:?}");
        }
    }
}
