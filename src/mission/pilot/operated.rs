//! What is left of an operator's command after the guard line and the grid.

use super::{Pilot, is_barrier};
use crate::acquisition::ParkState;
use crate::geometry::wrap_pi;
use crate::navigation::{Conflict, DriveCommand, GuardVerdict, Pose2, speed::stopping_distance_m};
use crate::terrain::{CellClass, Grid};
use crate::time::Arrival;
use serde::{Deserialize, Serialize};

/// A turn in place is looked ahead by what it turns within the latency and this, in radians.
const TURN_AHEAD_RAD: f64 = 0.15;
/// Steps in which a turn is judged, in radians.
const TURN_STEP_RAD: f64 = 0.05;
/// A hull this near to where it stood before, and turned by no more than this, stands on its own track.
const TRACK_M: f64 = 0.1;
const TRACK_RAD: f64 = 0.35;

/// Why an operator's robot does not move as told.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Hold {
    /// The map holds something that the hull would touch.
    Barrier {
        /// What it is.
        class: CellClass,
        /// Which way the robot was to move.
        way: Way,
        /// Metres from the robot's centre.
        away_m: f64,
    },
    /// Ground behind that was neither seen nor driven over.
    Unseen {
        /// Metres from the robot's centre.
        away_m: f64,
    },
    /// The guard line sees something.
    Guard(GuardVerdict),
    /// The head is still on its way to where it sees the ground ahead.
    HeadMoves,
    /// The head looks at the ground ahead and no line has come from it lately.
    NoLine,
}

/// A way to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Way {
    /// Bow first.
    Ahead,
    /// Stern first.
    Back,
    /// In place.
    Turn,
}

impl Hold {
    /// Whether it is the same trouble as another, wherever exactly.
    pub fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Guard(a), Self::Guard(b)) => {
                std::mem::discriminant(a) == std::mem::discriminant(b)
            }
            (Self::Barrier { way: a, .. }, Self::Barrier { way: b, .. }) => a == b,
            (a, b) => std::mem::discriminant(a) == std::mem::discriminant(b),
        }
    }
}

impl std::fmt::Display for Hold {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Barrier { class, way, away_m } => {
                let what = match class {
                    CellClass::DropOff => "a drop-off",
                    CellClass::Suspect => "a suspected edge",
                    CellClass::TooSteep => "ground too steep",
                    _ => "an obstacle",
                };
                match way {
                    Way::Ahead => write!(f, "{what} {away_m:.2} m ahead in the map"),
                    Way::Back => write!(f, "{what} {away_m:.2} m behind in the map"),
                    Way::Turn => {
                        write!(f, "turning would touch {what} {away_m:.2} m away in the map")
                    }
                }
            }
            Self::Unseen { away_m } => {
                write!(f, "ground {away_m:.2} m behind was neither seen nor driven over")
            }
            Self::Guard(verdict) => write!(f, "the guard line sees {verdict}"),
            Self::HeadMoves => f.write_str("the head is still turning to the ground ahead"),
            Self::NoLine => f.write_str("no laser line shows the ground ahead"),
        }
    }
}

impl Pilot {
    /// What is left of an operator's command after the guard line and the grid, and what held it back:
    /// the hull's way is judged as far as it takes to stop. Known obstacles and edges stop it; unknown
    /// ground ahead does not, for the guard line sees what the grid does not hold, but behind it does,
    /// where nothing looks: back it goes over ground that was seen or its own track only.
    pub fn filter(
        &mut self,
        wanted: DriveCommand,
        pose: &Pose2,
        grid: &Grid,
        parked: ParkState,
        now: Arrival,
    ) -> (DriveCommand, Option<Hold>) {
        self.trail.note(pose);
        let config = self.follower.config();
        let wanted = wanted.limited(config.full_mps, config.turn_rps);
        let (linear_mps, hold) = if wanted.linear_mps > 0.0 {
            self.ahead(wanted, pose, grid, parked, now)
        } else if wanted.linear_mps < 0.0 {
            let slow = wanted.limited(self.slow_mps, config.turn_rps);
            match self.held_back(slow, pose, grid) {
                Some(hold) => (0.0, Some(hold)),
                None => (slow.linear_mps, None),
            }
        } else {
            (0.0, None)
        };
        if linear_mps != 0.0 || wanted.angular_rps == 0.0 {
            return (DriveCommand { linear_mps, ..wanted }, hold);
        }
        // What is left of a command whose way is closed is the turn.
        let turn = self.held_in_turn(wanted.angular_rps, pose, grid);
        let angular_rps = if turn.is_some() { 0.0 } else { wanted.angular_rps };
        (DriveCommand { linear_mps, angular_rps }, hold.or(turn))
    }

    /// Speed ahead that is left, and what holds the robot if none is.
    fn ahead(
        &self,
        wanted: DriveCommand,
        pose: &Pose2,
        grid: &Grid,
        parked: ParkState,
        now: Arrival,
    ) -> (f64, Option<Hold>) {
        let barrier = self.arc(wanted, pose, grid).find_map(|at| {
            let found = self.footprint.conflict_among(grid, &at, Some(pose), is_barrier);
            found.map(|conflict| barred_by(&conflict, Way::Ahead, pose, grid))
        });
        // Skid steering may turn less than it is told: no edge on the straight way either.
        let straight = DriveCommand { angular_rps: 0.0, ..wanted };
        let edge = || {
            self.arc(straight, pose, grid).find_map(|at| {
                let found =
                    self.footprint.conflict_among(grid, &at, Some(pose), CellClass::is_edge);
                found.map(|conflict| barred_by(&conflict, Way::Ahead, pose, grid))
            })
        };
        let barrier = barrier.or_else(edge);
        let seen = self.watch.surprise.filter(|_| self.watch.surprises > 0).map(Hold::Guard);
        let allowed_mps = match (barrier, self.surprise()) {
            (None, None) => self.allowed_mps(parked, now),
            _ => 0.0,
        };
        if wanted.linear_mps <= allowed_mps {
            return (wanted.linear_mps, None);
        }
        let is_parked = matches!(parked, ParkState::Computed { .. } | ParkState::Verified { .. });
        let waiting = if is_parked { Hold::NoLine } else { Hold::HeadMoves };
        // Held at a creeping pace it goes on, and there is nothing to explain.
        let hold = (allowed_mps == 0.0).then(|| barrier.or(seen).unwrap_or(waiting));
        (allowed_mps, hold)
    }

    /// What holds the robot from going back.
    fn held_back(&self, wanted: DriveCommand, pose: &Pose2, grid: &Grid) -> Option<Hold> {
        let unfit = |class: CellClass| !class.is_drivable();
        self.arc(wanted, pose, grid).find_map(|at| {
            let on_track = self.trail.crumbs().iter().rev().any(|crumb| {
                crumb.distance_m(&at.point()) <= TRACK_M
                    && wrap_pi(crumb.yaw_rad - at.yaw_rad).abs() <= TRACK_RAD
            });
            let counts = if on_track { is_barrier } else { unfit };
            let conflict = self.footprint.conflict_among(grid, &at, Some(pose), counts)?;
            Some(if is_barrier(conflict.class) {
                barred_by(&conflict, Way::Back, pose, grid)
            } else {
                Hold::Unseen { away_m: pose.distance_m(&grid.centre(conflict.cell)) }
            })
        })
    }

    /// What holds the robot from turning in place.
    fn held_in_turn(&self, angular_rps: f64, pose: &Pose2, grid: &Grid) -> Option<Hold> {
        let latency_s = self.follower.config().latency_s;
        let turn_rad = (angular_rps.abs() * latency_s + TURN_AHEAD_RAD).copysign(angular_rps);
        let steps = (turn_rad.abs() / TURN_STEP_RAD).ceil().max(1.0) as u32;
        (1..=steps).find_map(|step| {
            let at = pose.driven(0.0, turn_rad * f64::from(step) / f64::from(steps));
            let conflict = self.footprint.conflict_among(grid, &at, Some(pose), is_barrier)?;
            Some(barred_by(&conflict, Way::Turn, pose, grid))
        })
    }

    /// Where the hull comes while the robot goes on as told and then stops, every half cell.
    fn arc(&self, wanted: DriveCommand, pose: &Pose2, grid: &Grid) -> impl Iterator<Item = Pose2> {
        let config = self.follower.config();
        let speed_mps = wanted.linear_mps.abs();
        let way_m = config.stop_margin_m
            + stopping_distance_m(speed_mps, config.latency_s, config.deceleration_mps2);
        let steps = (way_m / (0.5 * grid.cell_m()).max(0.01)).ceil().max(1.0);
        let step_m = (way_m / steps).copysign(wanted.linear_mps);
        let turn_rad = wanted.angular_rps * step_m.abs() / speed_mps.max(1e-6);
        let driven = move |at: &Pose2| Some(at.driven(step_m, turn_rad));
        std::iter::successors(driven(pose), driven).take(steps as usize)
    }
}

fn barred_by(conflict: &Conflict, way: Way, pose: &Pose2, grid: &Grid) -> Hold {
    let away_m = pose.distance_m(&grid.centre(conflict.cell));
    Hold::Barrier { class: conflict.class, way, away_m }
}
