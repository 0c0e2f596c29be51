//! What is left of an operator's command after the guard line and the grid.

use super::{Pilot, is_barrier};
use crate::acquisition::ParkState;
use crate::geometry::wrap_pi;
use crate::mission::motion::BodyAttitude;
use crate::navigation::speed::stopping_distance_m;
use crate::navigation::{
    Conflict, DriveCommand, FollowConfig, Footprint, GuardVerdict, Pose2, Swath, Trail,
};
use crate::terrain::{CellClass, CellIndex, Grid};
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
    /// Ground on the way that was neither seen closely nor driven over.
    Unseen {
        /// Which way the robot was to move.
        way: Way,
        /// Metres from the robot's centre.
        away_m: f64,
    },
    /// The body leans so far that it may tip over.
    Leaning,
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
            (Self::Barrier { way: a, .. }, Self::Barrier { way: b, .. })
            | (Self::Unseen { way: a, .. }, Self::Unseen { way: b, .. }) => a == b,
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
            Self::Unseen { way: Way::Ahead, away_m } => {
                write!(f, "ground {away_m:.2} m ahead was not seen closely yet")
            }
            Self::Unseen { way: Way::Back, away_m } => {
                write!(f, "ground {away_m:.2} m behind was neither seen nor driven over")
            }
            Self::Unseen { way: Way::Turn, away_m } => {
                write!(
                    f,
                    "turning would touch ground {away_m:.2} m away that was not seen closely yet"
                )
            }
            Self::Leaning => f.write_str("the robot leans too far: only back the way it came"),
            Self::Guard(verdict) => write!(f, "the guard line sees {verdict}"),
            Self::HeadMoves => f.write_str("the head is still turning to the ground ahead"),
            Self::NoLine => f.write_str("no laser line shows the ground ahead"),
        }
    }
}

impl Pilot {
    /// What is left of an operator's command after the guard line and the grid, and what held it back.
    ///
    /// The hull's way is judged as far as it takes to stop, over ground that a sweep has seen closely,
    /// that the guard line has swept or that the robot stood on. A rig that never looks at the ground is
    /// held by what the map holds only: there the operator has to see the edges.
    pub fn filter(
        &self,
        wanted: DriveCommand,
        pose: &Pose2,
        grid: &Grid,
        parked: ParkState,
        now: Arrival,
    ) -> (DriveCommand, Option<Hold>) {
        let config = self.follower.config();
        let wanted = wanted.limited(config.full_mps, config.turn_rps);
        let (linear_mps, hold) = if wanted.linear_mps > 0.0 {
            self.ahead(wanted, pose, grid, parked, now)
        } else if wanted.linear_mps < 0.0 {
            let slow = wanted.limited(self.slow_mps, config.turn_rps);
            match self.hull(grid).held_back(slow, pose) {
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
        let turn = self.hull(grid).held_in_turn(wanted.angular_rps, pose);
        let angular_rps = if turn.is_some() { 0.0 } else { wanted.angular_rps };
        (DriveCommand { linear_mps, angular_rps }, hold.or(turn))
    }

    /// What is left of an operator's command while the body leans so far that it may tip over: the way
    /// back over the own track. `None` where it does not lean.
    pub fn righted(
        &self,
        wanted: DriveCommand,
        attitude: &BodyAttitude,
        pose: &Pose2,
        grid: &Grid,
    ) -> Option<(DriveCommand, Option<Hold>)> {
        if !self.stuck.leans(attitude.roll_rad, attitude.pitch_rad) {
            return None;
        }
        let turn_rps = self.follower.config().turn_rps;
        let back = (wanted.linear_mps < 0.0)
            .then(|| self.trail.back_out(pose, self.slow_mps, turn_rps))
            .flatten();
        Some(match back {
            Some(back) => match self.hull(grid).held_back(back, pose) {
                None => (back, None),
                hold => (DriveCommand::STOP, hold),
            },
            None => (DriveCommand::STOP, Some(Hold::Leaning)),
        })
    }

    fn hull<'a>(&'a self, grid: &'a Grid) -> Hull<'a> {
        Hull {
            footprint: &self.footprint,
            trail: &self.trail,
            swath: &self.swath,
            sees_ground: self.guard_tilt.is_some(),
            config: self.follower.config(),
            grid,
        }
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
        let ahead = self.hull(grid).held_ahead(wanted, pose);
        let (barrier, unseen) = match ahead {
            Some(Hold::Unseen { .. }) => (None, ahead),
            _ => (ahead, None),
        };
        let by_line_mps = self.allowed_mps(parked, now);
        let is_open = ahead.is_none() && self.surprise().is_none();
        let allowed_mps = if is_open { by_line_mps } else { 0.0 };
        if wanted.linear_mps <= allowed_mps {
            return (wanted.linear_mps, None);
        }
        let seen = self.watch.surprise.filter(|_| self.watch.surprises > 0).map(Hold::Guard);
        let is_parked = matches!(parked, ParkState::Computed { .. } | ParkState::Verified { .. });
        let waiting = if is_parked { Hold::NoLine } else { Hold::HeadMoves };
        // What the line may yet show is waited for first.
        let waiting = Some(waiting).filter(|_| by_line_mps == 0.0);
        // Held at a creeping pace it goes on, and there is nothing to explain.
        let hold = barrier.or(seen).or(waiting).or(unseen).filter(|_| allowed_mps == 0.0);
        (allowed_mps, hold)
    }
}

/// The hull on the grid: what it would touch on its way.
struct Hull<'a> {
    footprint: &'a Footprint,
    trail: &'a Trail,
    swath: &'a Swath,
    /// Whether the rig looks at the ground, so that ground it has not seen is a reason to stop.
    sees_ground: bool,
    config: &'a FollowConfig,
    grid: &'a Grid,
}

impl Hull<'_> {
    /// What the map holds against going ahead.
    fn held_ahead(&self, wanted: DriveCommand, pose: &Pose2) -> Option<Hold> {
        // Skid steering may turn less than it is told: no edge on the straight way either.
        let straight = DriveCommand { angular_rps: 0.0, ..wanted };
        let edge = || {
            self.arc(straight, pose).find_map(|at| {
                let counts = |_: CellIndex, class: CellClass| class.is_edge();
                let found = self.footprint.conflict_among(self.grid, &at, Some(pose), counts)?;
                Some(self.hold(&found, Way::Ahead, pose))
            })
        };
        self.arc(wanted, pose).find_map(|at| self.held_at(&at, pose, Way::Ahead)).or_else(edge)
    }

    /// What holds the robot from going back: nothing looks there, so ground that was not seen counts
    /// for every rig.
    fn held_back(&self, wanted: DriveCommand, pose: &Pose2) -> Option<Hold> {
        self.arc(wanted, pose).find_map(|at| {
            let on_track = self.trail.crumbs().iter().rev().any(|crumb| {
                crumb.distance_m(&at.point()) <= TRACK_M
                    && wrap_pi(crumb.yaw_rad - at.yaw_rad).abs() <= TRACK_RAD
            });
            let counts = |cell, class| {
                is_barrier(class) || !(on_track || class.is_drivable() || self.covered(cell))
            };
            let found = self.footprint.conflict_among(self.grid, &at, Some(pose), counts)?;
            Some(self.hold(&found, Way::Back, pose))
        })
    }

    /// What holds the robot from turning in place.
    fn held_in_turn(&self, angular_rps: f64, pose: &Pose2) -> Option<Hold> {
        let turn_rad = angular_rps.abs() * self.config.latency_s + TURN_AHEAD_RAD;
        let steps = (turn_rad / TURN_STEP_RAD).ceil().max(1.0) as u32;
        let step_rad = (turn_rad / f64::from(steps)).copysign(angular_rps);
        (1..=steps).find_map(|step| {
            self.held_at(&pose.driven(0.0, step_rad * f64::from(step)), pose, Way::Turn)
        })
    }

    /// What holds the hull from standing at `at`, on its way from `pose`.
    fn held_at(&self, at: &Pose2, pose: &Pose2, way: Way) -> Option<Hold> {
        let counts = |cell, class| is_barrier(class) || (self.sees_ground && !self.covered(cell));
        let found = self.footprint.conflict_among(self.grid, at, Some(pose), counts)?;
        Some(self.hold(&found, way, pose))
    }

    fn covered(&self, cell: CellIndex) -> bool {
        self.swath.covers(&self.grid.centre(cell))
    }

    fn hold(&self, found: &Conflict, way: Way, pose: &Pose2) -> Hold {
        let away_m = pose.distance_m(&self.grid.centre(found.cell));
        if is_barrier(found.class) {
            Hold::Barrier { class: found.class, way, away_m }
        } else {
            Hold::Unseen { way, away_m }
        }
    }

    /// Where the hull comes while the robot goes on as told and then stops, every half cell.
    fn arc(&self, wanted: DriveCommand, pose: &Pose2) -> impl Iterator<Item = Pose2> {
        let config = self.config;
        let speed_mps = wanted.linear_mps.abs();
        let way_m = config.stop_margin_m
            + stopping_distance_m(speed_mps, config.latency_s, config.deceleration_mps2);
        let steps = (way_m / (0.5 * self.grid.cell_m()).max(0.01)).ceil().max(1.0);
        let step_m = (way_m / steps).copysign(wanted.linear_mps);
        let turn_rad = wanted.angular_rps * step_m.abs() / speed_mps.max(1e-6);
        let driven = move |at: &Pose2| Some(at.driven(step_m, turn_rad));
        std::iter::successors(driven(pose), driven).take(steps as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{CellIndex, GridCell, RobotShape};

    const BACK: DriveCommand = DriveCommand { linear_mps: -0.15, angular_rps: 0.0 };
    const AHEAD: DriveCommand = DriveCommand { linear_mps: 0.4, angular_rps: 0.0 };

    /// 4 × 4 m of seen ground about the origin, with what `class` says of a cell's centre.
    fn ground(class: impl Fn(f64, f64) -> Option<CellClass>) -> Grid {
        let cells = (0..80 * 80).map(|at| {
            let (x, y) = (f64::from(at % 80) - 39.5, f64::from(at / 80) - 39.5);
            GridCell {
                class: class(0.05 * x, 0.05 * y).unwrap_or(CellClass::Free),
                sure: true,
                room_m: 0.1,
                ..GridCell::default()
            }
        });
        Grid::from_cells(0.05, CellIndex { x: -40, y: -40 }, 80, cells.collect())
    }

    fn held(grid: &Grid, trail: &Trail, judge: impl Fn(&Hull<'_>) -> Option<Hold>) -> Option<Hold> {
        held_with(grid, trail, &Swath::default(), true, judge)
    }

    fn held_with(
        grid: &Grid,
        trail: &Trail,
        swath: &Swath,
        sees_ground: bool,
        judge: impl Fn(&Hull<'_>) -> Option<Hold>,
    ) -> Option<Hold> {
        let shape = RobotShape { length_m: 0.5, width_m: 0.5, ..RobotShape::default() };
        let (footprint, config) = (Footprint::new(&shape, 0.15), FollowConfig::default());
        judge(&Hull { footprint: &footprint, trail, swath, sees_ground, config: &config, grid })
    }

    #[test]
    fn an_edge_behind_the_robot_stops_it_on_its_own_track_too() {
        let grid = ground(|x, _| (x < -0.45).then_some(CellClass::DropOff));
        let mut trail = Trail::default();
        for step in 0..=20 {
            trail.note(&Pose2::default().driven(0.05 * f64::from(step) - 1.0, 0.0));
        }
        for trail in [Trail::default(), trail] {
            let hold = held(&grid, &trail, |hull| hull.held_back(BACK, &Pose2::default()));
            assert!(matches!(hold, Some(Hold::Barrier { way: Way::Back, .. })), "{hold:?}");
        }
        let open = ground(|_, _| None);
        let free = |hull: &Hull<'_>| hull.held_back(BACK, &Pose2::default());
        assert_eq!(held(&open, &Trail::default(), free), None);
    }

    #[test]
    fn ground_behind_that_was_not_seen_stops_it_but_its_own_track_does_not() {
        let grid = ground(|x, _| (x < -0.3).then_some(CellClass::Unknown));
        let back = |hull: &Hull<'_>| hull.held_back(BACK, &Pose2::default());
        let hold = held(&grid, &Trail::default(), back);
        assert!(matches!(hold, Some(Hold::Unseen { .. })), "{hold:?}");
        let mut trail = Trail::default();
        for step in 0..=20 {
            trail.note(&Pose2::default().driven(0.05 * f64::from(step) - 1.0, 0.0));
        }
        assert_eq!(held(&grid, &trail, back), None);
    }

    #[test]
    fn an_edge_that_is_passed_nearly_in_parallel_stops_it() {
        // The centre line stays 0.3 m from the edge for as far as it takes to stop; the hull does not.
        let grid = ground(|x, y| (y > 0.42 - 0.2 * x).then_some(CellClass::Suspect));
        let hold = held(&grid, &Trail::default(), |hull| hull.held_ahead(AHEAD, &Pose2::default()));
        assert!(matches!(hold, Some(Hold::Barrier { way: Way::Ahead, .. })), "{hold:?}");
    }

    #[test]
    fn a_turn_does_not_swing_a_corner_over_an_edge() {
        let grid = ground(|_, y| (y > 0.36).then_some(CellClass::DropOff));
        let turn = |hull: &Hull<'_>| hull.held_in_turn(0.6, &Pose2::default());
        let hold = held(&grid, &Trail::default(), turn);
        assert!(matches!(hold, Some(Hold::Barrier { way: Way::Turn, .. })), "{hold:?}");
    }

    #[test]
    fn unseen_ground_ahead_or_beside_stops_it_until_the_line_has_swept_it() {
        let grid = ground(|x, y| (x > 0.3 || y > 0.3).then_some(CellClass::Unknown));
        let pose = Pose2::default();
        let ahead = |hull: &Hull<'_>| hull.held_ahead(AHEAD, &pose);
        let turn = |hull: &Hull<'_>| hull.held_in_turn(0.6, &pose);
        let (trail, mut swath) = (Trail::default(), Swath::default());
        let hold = held_with(&grid, &trail, &swath, true, ahead);
        assert!(matches!(hold, Some(Hold::Unseen { way: Way::Ahead, .. })), "{hold:?}");
        let hold = held_with(&grid, &trail, &swath, true, turn);
        assert!(matches!(hold, Some(Hold::Unseen { way: Way::Turn, .. })), "{hold:?}");
        // Of a rig that never sees the ground only the operator can know.
        assert_eq!(held_with(&grid, &trail, &swath, false, ahead), None);
        for (x, y) in (-20..=30).flat_map(|x| (-20..=20).map(move |y| (x, y))) {
            swath.met(&nalgebra::Point2::new(0.05 * f64::from(x), 0.05 * f64::from(y)));
        }
        assert_eq!(held_with(&grid, &trail, &swath, true, ahead), None);
        assert_eq!(held_with(&grid, &trail, &swath, true, turn), None);
    }

    #[test]
    fn a_curve_into_ground_beside_the_line_stops_though_straight_on_is_swept() {
        let grid = ground(|x, _| (x > 0.3).then_some(CellClass::Unknown));
        let mut swath = Swath::default();
        for (x, y) in (0..=40).flat_map(|x| (-6..=6).map(move |y| (x, y))) {
            swath.met(&nalgebra::Point2::new(0.05 * f64::from(x), 0.05 * f64::from(y)));
        }
        let curve = DriveCommand { linear_mps: 0.4, angular_rps: 0.6 };
        let judge = |wanted: DriveCommand| {
            held_with(&grid, &Trail::default(), &swath, true, |hull| {
                hull.held_ahead(wanted, &Pose2::default())
            })
        };
        assert_eq!(judge(AHEAD), None);
        let hold = judge(curve);
        assert!(matches!(hold, Some(Hold::Unseen { way: Way::Ahead, .. })), "{hold:?}");
    }
}
