use super::footprint::Footprint;
use super::stuck::Trouble;
use super::tipping::{TipGuard, Tipping};
use super::trail::Trail;
use super::{DriveCommand, Pose2};
use crate::geometry::wrap_pi;
use crate::terrain::{Grid, RobotShape};
use crate::time::{Arrival, Span};
use serde::{Deserialize, Serialize};

/// Speed of creeping ahead or back in m/s: slow enough to stop within a cell.
const EASE_MPS: f64 = 0.08;

/// Bounds of each rung of the ladder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecoveryConfig {
    /// Time to stand before anything is tried, in seconds. [0, 10]
    pub pause_s: f64,
    /// Distance to back out over the own track, in metres. [0.1, 2]
    pub back_m: f64,
    /// Distance of the second, longer attempt, in metres. [0.1, 5]
    pub back_farther_m: f64,
    /// Speed of backing out in m/s. (0, 0.5]
    pub back_mps: f64,
    /// Distance to creep straight ahead or back where there is no room to turn, in metres. [0.1, 1]
    pub ease_m: f64,
    /// Turn to either side that is tried to get free, in radians. [0.1, 2]
    pub turn_rad: f64,
    /// Turn rate in rad/s. (0, 2]
    pub turn_rps: f64,
    /// Longest time for any one rung, in seconds. [1, 60]
    pub rung_s: f64,
}

impl Default for RecoveryConfig {
    fn default() -> Self {
        Self {
            pause_s: 1.0,
            back_m: 0.4,
            back_farther_m: 1.0,
            back_mps: 0.15,
            ease_m: 0.3,
            turn_rad: 0.5,
            turn_rps: 0.3,
            rung_s: 8.0,
        }
    }
}

/// The rungs of the ladder, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rung {
    /// Stand and let what moved come to rest.
    Pause,
    /// Back out over the own track.
    BackOut,
    /// Turn a little to the left, where there is room.
    TurnLeft,
    /// Turn a little to the right, where there is room.
    TurnRight,
    /// Creep straight ahead, where the ground is known: out of a place with no room to turn.
    EaseAhead,
    /// Back out once more, farther.
    BackFarther,
    /// Creep straight back off its track, which leads elsewhere for a robot that has turned since: only where
    /// all of the ground was seen closely.
    EaseBack,
}

impl Rung {
    fn next(self) -> Option<Self> {
        Some(match self {
            Self::Pause => Self::BackOut,
            Self::BackOut => Self::TurnLeft,
            Self::TurnLeft => Self::TurnRight,
            Self::TurnRight => Self::EaseAhead,
            Self::EaseAhead => Self::BackFarther,
            Self::BackFarther => Self::EaseBack,
            Self::EaseBack => return None,
        })
    }
}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum RecoveryStep {
    /// Go on with this rung.
    Try(Rung, DriveCommand),
    /// The robot moved: plan anew, and avoid what it was heading for.
    Recovered,
    /// Nothing helped: stand still and ask the operator.
    GaveUp,
}

/// One run down the ladder. Ends by itself: every rung has a longest time and distance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    config: RecoveryConfig,
    footprint: Footprint,
    leaning: bool,
    rung: Rung,
    since: Arrival,
    from: Pose2,
    tip_guard: TipGuard,
}

impl Recovery {
    /// Starts at the first rung. A leaning robot only pauses and backs out: turning could tip it.
    pub fn new(
        config: RecoveryConfig,
        shape: &RobotShape,
        edge_margin_m: f64,
        trouble: &Trouble,
        now: Arrival,
        pose: &Pose2,
    ) -> Self {
        Self {
            config,
            footprint: Footprint::new(shape, edge_margin_m).squeezed(),
            leaning: matches!(trouble, Trouble::Tilted { .. }),
            rung: Rung::Pause,
            since: now,
            from: *pose,
            tip_guard: TipGuard::default(),
        }
    }

    /// The same for a robot that got out by `last` and is back: what did not lead away is not tried first again.
    #[must_use]
    pub fn after(self, last: Rung) -> Self {
        let rung = if self.leaning { self.rung } else { last.next().unwrap_or(Rung::Pause) };
        Self { rung, ..self }
    }

    /// The rung being tried.
    pub fn rung(&self) -> Rung {
        self.rung
    }

    /// Whether the robot could turn about at `pose` without touching anything.
    fn can_turn(&self, grid: &Grid, pose: &Pose2) -> bool {
        self.footprint.turn_conflict(grid, pose, std::f64::consts::PI).is_none()
    }

    /// The next command, for a robot at `pose` with this track behind it that leans by `lean_rad`, the greater of
    /// its roll and pitch. A rung that tips it over ends at once: the wheels turn back until it is down, and the
    /// next rung waits until it stands.
    pub fn step(
        &mut self,
        now: Arrival,
        pose: &Pose2,
        lean_rad: f64,
        trail: &Trail,
        grid: &Grid,
    ) -> RecoveryStep {
        match self.tip_guard.watch(now, lean_rad) {
            Tipping::No => {}
            Tipping::Back(command) => return RecoveryStep::Try(self.rung, command),
            Tipping::Over => {
                let Some(next) = self.rung.next() else { return RecoveryStep::GaveUp };
                (self.rung, self.from) = (next, *pose);
                self.since = now + Span::from_seconds(self.config.pause_s);
            }
        }
        if now < self.since {
            return RecoveryStep::Try(self.rung, DriveCommand::STOP);
        }
        let step = self.climb(now, pose, trail, grid);
        if let RecoveryStep::Try(_, command) = step {
            self.tip_guard.told(command);
        }
        step
    }

    /// The same while the body does not tip.
    fn climb(&mut self, now: Arrival, pose: &Pose2, trail: &Trail, grid: &Grid) -> RecoveryStep {
        loop {
            let spent = now - self.since;
            let moved_m = pose.distance_m(&self.from.point());
            let turned_rad = wrap_pi(pose.yaw_rad - self.from.yaw_rad);
            let in_time = spent < Span::from_seconds(self.config.rung_s);
            let command = match self.rung {
                Rung::Pause => {
                    (spent < Span::from_seconds(self.config.pause_s)).then_some(DriveCommand::STOP)
                }
                Rung::BackOut | Rung::BackFarther => {
                    let goal_m = if self.rung == Rung::BackOut {
                        self.config.back_m
                    } else {
                        self.config.back_farther_m
                    };
                    // Out of a corner means to where it can turn: else the next way ends here again.
                    let is_out = moved_m >= 0.9 * goal_m
                        && (moved_m >= self.config.back_farther_m || self.can_turn(grid, pose));
                    if is_out {
                        return RecoveryStep::Recovered;
                    }
                    let (mps, rps) = (self.config.back_mps, self.config.turn_rps);
                    let back =
                        trail.back_out(pose, mps, rps).or_else(|| trail.head_back(pose, mps, rps));
                    // Half the way is a success when the time or the track ends.
                    if (back.is_none() || !in_time) && moved_m >= 0.5 * goal_m {
                        return RecoveryStep::Recovered;
                    }
                    back.filter(|_| in_time)
                }
                Rung::EaseAhead | Rung::EaseBack => {
                    let sign = if self.rung == Rung::EaseAhead { 1.0 } else { -1.0 };
                    let rest_m = self.config.ease_m - moved_m;
                    if rest_m < 0.05 {
                        return RecoveryStep::Recovered;
                    }
                    let steps = (rest_m / 0.05).ceil() as u32;
                    let free = !self.leaning
                        && in_time
                        && (1..=steps).all(|step| {
                            let there = pose.driven(0.05 * sign * f64::from(step), 0.0);
                            self.footprint.conflict_from(grid, &there, Some(pose)).is_none()
                        });
                    free.then_some(DriveCommand { linear_mps: sign * EASE_MPS, angular_rps: 0.0 })
                }
                Rung::TurnLeft | Rung::TurnRight => {
                    let sign = if self.rung == Rung::TurnLeft { 1.0 } else { -1.0 };
                    let rest_rad = self.config.turn_rad - sign * turned_rad;
                    if rest_rad < 0.1 {
                        return RecoveryStep::Recovered;
                    }
                    let free = !self.leaning
                        && in_time
                        && self.footprint.turn_conflict(grid, pose, sign * rest_rad).is_none();
                    free.then_some(DriveCommand {
                        linear_mps: 0.0,
                        angular_rps: sign * self.config.turn_rps,
                    })
                }
            };
            match command {
                Some(command) => return RecoveryStep::Try(self.rung, command),
                None => {
                    let Some(next) = self.rung.next() else { return RecoveryStep::GaveUp };
                    self.rung = next;
                    self.since = now;
                    self.from = *pose;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::{CellClass, CellIndex, GridCell};

    fn open_grid() -> Grid {
        let cell = GridCell {
            class: CellClass::Free,
            height_m: 0.0,
            room_m: 1.5,
            sure: true,
            reachable: true,
            ..GridCell::default()
        };
        Grid::from_cells(0.05, CellIndex { x: -100, y: -100 }, 200, vec![cell; 40_000])
    }

    fn track() -> Trail {
        let mut trail = Trail::default();
        for step in 0..40 {
            trail.note(&Pose2 { x_m: 0.05 * f64::from(step), y_m: 0.0, yaw_rad: 0.0 });
        }
        trail
    }

    /// Runs a recovery at 5 Hz; `grip` scales the robot's motion. Returns the end, seconds, rungs.
    fn run(trouble: Trouble, trail: &Trail, grip: f64) -> (RecoveryStep, f64, Vec<Rung>, Pose2) {
        run_in(&open_grid(), trouble, trail, grip)
    }

    fn run_in(
        grid: &Grid,
        trouble: Trouble,
        trail: &Trail,
        grip: f64,
    ) -> (RecoveryStep, f64, Vec<Rung>, Pose2) {
        let mut trail = trail.clone();
        let mut pose = Pose2 { x_m: 1.95, y_m: 0.0, yaw_rad: 0.0 };
        let shape = RobotShape::default();
        let config = RecoveryConfig::default();
        let mut recovery = Recovery::new(config, &shape, 0.15, &trouble, Arrival(0), &pose);
        let mut rungs = Vec::new();
        for tick in 0..1000 {
            let now = Arrival::from_seconds(0.2 * f64::from(tick));
            match recovery.step(now, &pose, 0.0, &trail, grid) {
                RecoveryStep::Try(rung, command) => {
                    if rungs.last() != Some(&rung) {
                        rungs.push(rung);
                    }
                    let (v, w) = (command.linear_mps, command.angular_rps);
                    pose = pose.driven(0.2 * grip * v, 0.2 * grip * w);
                    trail.note(&pose);
                }
                end => return (end, now.seconds(), rungs, pose),
            }
        }
        panic!("a recovery must end");
    }

    const STUCK: Trouble = Trouble::Stuck { commanded: 1.0, moved: 0.0 };

    #[test]
    fn a_robot_that_can_move_backs_out_over_its_track() {
        let (end, seconds, rungs, pose) = run(STUCK, &track(), 1.0);
        assert_eq!(end, RecoveryStep::Recovered);
        assert_eq!(rungs, [Rung::Pause, Rung::BackOut]);
        assert!(seconds < 5.0 && pose.x_m < 1.65 && pose.y_m.abs() < 0.01);
    }

    #[test]
    fn out_of_a_corner_means_to_where_it_can_turn() {
        // A wall 0.3 m beside the track, from 1.4 m on: the hull passes along it and cannot turn.
        let mut cells = vec![open_grid().cells()[0]; 40_000];
        for x in 128..200 {
            cells[106 * 200 + x].class = CellClass::Occupied;
        }
        for cell in &mut cells {
            cell.room_m = 0.3;
        }
        let grid = Grid::from_cells(0.05, CellIndex { x: -100, y: -100 }, 200, cells);
        let (end, _, rungs, pose) = run_in(&grid, STUCK, &track(), 1.0);
        assert_eq!(end, RecoveryStep::Recovered);
        assert_eq!(rungs, [Rung::Pause, Rung::BackOut]);
        // Its corners reach 0.36 m far; without the rule it would stop at 1.59 m.
        assert!(pose.x_m < 1.35, "{pose:?}");
    }

    #[test]
    fn a_robot_that_cannot_move_gives_up_in_bounded_time() {
        let (end, seconds, rungs, _) = run(STUCK, &track(), 0.0);
        assert_eq!(end, RecoveryStep::GaveUp);
        assert_eq!(rungs.len(), 7, "every rung was tried: {rungs:?}");
        assert!(seconds < 56.0);
    }

    #[test]
    fn what_did_not_lead_away_is_not_tried_first_again() {
        let pose = Pose2 { x_m: 1.95, y_m: 0.0, yaw_rad: 0.0 };
        let after = |last: Rung, trouble: &Trouble| {
            let (config, shape) = (RecoveryConfig::default(), RobotShape::default());
            Recovery::new(config, &shape, 0.15, trouble, Arrival(0), &pose).after(last).rung()
        };
        assert_eq!(after(Rung::BackOut, &STUCK), Rung::TurnLeft);
        assert_eq!(after(Rung::TurnRight, &STUCK), Rung::EaseAhead);
        assert_eq!(after(Rung::EaseBack, &STUCK), Rung::Pause);
        // A leaning robot only backs out.
        let leaning = Trouble::Tilted { roll_rad: 0.5, pitch_rad: 0.0 };
        assert_eq!(after(Rung::BackOut, &leaning), Rung::Pause);
    }

    /// Wheels that are blocked by an edge turn the body about them: from some way back on the robot leans by a
    /// tenth of a radian more in each tick until the wheels turn the other way; braked they hold it up.
    #[test]
    fn a_rung_that_tips_the_robot_over_ends_at_once() {
        let (start, trail) = (Pose2 { x_m: 1.95, y_m: 0.0, yaw_rad: 0.0 }, track());
        for blocked_m in [0.0, 0.1, 0.2] {
            let (config, shape) = (RecoveryConfig::default(), RobotShape::default());
            let mut recovery = Recovery::new(config, &shape, 0.15, &STUCK, Arrival(0), &start);
            let (mut pose, mut lean_rad, mut most_rad, mut rungs) = (start, 0.2, 0.0_f64, vec![]);
            let mut ended = None;
            for tick in 0..600 {
                let now = Arrival::from_seconds(0.1 * f64::from(tick));
                match recovery.step(now, &pose, lean_rad, &trail, &open_grid()) {
                    RecoveryStep::Try(rung, DriveCommand { linear_mps, .. }) => {
                        if rungs.last() != Some(&rung) {
                            rungs.push(rung);
                        }
                        let is_blocked = linear_mps < 0.0 && start.x_m - pose.x_m >= blocked_m;
                        if is_blocked {
                            lean_rad += 0.1;
                        } else if lean_rad > 0.2 && linear_mps > 0.0 {
                            lean_rad = f64::max(0.2, lean_rad - 0.1);
                        } else {
                            pose = pose.driven(0.1 * linear_mps, 0.0);
                        }
                        most_rad = most_rad.max(lean_rad);
                    }
                    end => {
                        ended = Some(end);
                        break;
                    }
                }
            }
            assert!(most_rad > 0.29 && most_rad < 0.45, "{blocked_m}: {most_rad}, {ended:?}");
            assert!(ended.is_some() && lean_rad < 0.25, "it stands again: {lean_rad}, {ended:?}");
            assert_eq!(rungs[..3], [Rung::Pause, Rung::BackOut, Rung::TurnLeft], "{rungs:?}");
        }
    }

    #[test]
    fn a_leaning_robot_does_not_turn() {
        let trouble = Trouble::Tilted { roll_rad: 0.5, pitch_rad: 0.0 };
        let (_, _, rungs, _) = run(trouble, &track(), 0.0);
        assert_eq!(rungs, [Rung::Pause, Rung::BackOut, Rung::BackFarther]);
    }

    /// A wall across, close before the right fore corner of a robot that came from the left and has turned by
    /// 74° since: the ground is of `class` from 0.3 m behind its stern on.
    fn before_a_wall(class: CellClass) -> (Grid, Trail) {
        let mut cells = vec![open_grid().cells()[0]; 40_000];
        let track = Pose2 { x_m: 1.95, y_m: 0.0, yaw_rad: -1.3 };
        let mut trail = Trail::default();
        for step in 0..20 {
            trail.note(&track.driven(0.05 * f64::from(step) - 1.0, 0.0));
        }
        trail.note(&Pose2 { yaw_rad: -1.3, ..track });
        for step in 0..40 {
            trail.note(&Pose2 { yaw_rad: -1.3 + 0.0325 * f64::from(step), ..track });
        }
        for (at, cell) in cells.iter_mut().enumerate() {
            let (x, y) = ((at % 200) as f64 * 0.05 - 5.0, (at / 200) as f64 * 0.05 - 5.0);
            cell.room_m = 0.3;
            let (dx, dy) = (x - track.x_m, y - track.y_m);
            if dx < -0.55 {
                cell.class = class;
            }
            // Close along all sides but the stern.
            if dx > -0.35 && (dx > 0.26 || dy.abs() > 0.26) {
                cell.class = CellClass::Occupied;
            }
        }
        (Grid::from_cells(0.05, CellIndex { x: -100, y: -100 }, 200, cells), trail)
    }

    #[test]
    fn a_robot_that_has_turned_off_its_track_before_a_wall_creeps_straight_back() {
        let (grid, trail) = before_a_wall(CellClass::Free);
        let (end, _, rungs, pose) = run_in(&grid, STUCK, &trail, 1.0);
        assert_eq!(end, RecoveryStep::Recovered);
        assert_eq!(rungs.last(), Some(&Rung::EaseBack), "{rungs:?}");
        assert!(pose.x_m < 1.71 && pose.y_m == 0.0, "{pose:?}");
        // Not onto what was not seen, let alone over an edge.
        for class in [CellClass::Unknown, CellClass::Suspect, CellClass::DropOff] {
            let (grid, trail) = before_a_wall(class);
            let (end, _, rungs, pose) = run_in(&grid, STUCK, &trail, 1.0);
            assert_eq!(end, RecoveryStep::GaveUp, "{class:?}");
            assert!(!rungs.contains(&Rung::EaseBack) && pose.x_m == 1.95, "{class:?}");
        }
    }

    #[test]
    fn without_a_track_it_does_not_drive_backwards() {
        let (end, _, rungs, pose) = run(STUCK, &Trail::default(), 1.0);
        assert_eq!(end, RecoveryStep::Recovered);
        assert_eq!(rungs, [Rung::Pause, Rung::TurnLeft]);
        assert!((pose.x_m - 1.95).abs() < 1e-9);
    }
}
