//! The robot in service: readings in, activity after activity, commands out.

use super::belief::Belief;
use super::closing::Closing;
use super::config::AgentConfig;
use super::journal::{Journal, Level};
use super::ledger::{Ledger, Pastime};
use super::motion::{BodyAttitude, PlanarPose};
use super::observe::ObservedSweep;
use super::operator::{DriveLease, Mode};
use super::pilot::{Hold, Pilot};
use super::sign_test::SignTest;
use crate::acquisition::{Acquisition, HeadEvent, Profile, SweepRequest};
use crate::exploration::{Explorer, Frontier, FrontierLeft, Places, Walls};
use crate::navigation::{DriveCommand, Motion, Planner, Pose2, Recovery};
use crate::protocol::Command;
use crate::robot::{BodySpeed, PhantomWatch, Rig, WheelCount};
use crate::terrain::{CellIndex, Grid, RobotShape};
use crate::time::{Arrival, Span, Stamp};
use crate::victims::{Candidate, Candidates, VictimConfig};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Roll or pitch from which on the robot counts as fallen over, in radians.
const FALLEN_RAD: f64 = 1.05;

/// A standing command is repeated this often, so that one lost line does not last.
const REPEAT: Span = Span::from_millis(1_000);

/// What an activity needs from around it for the length of one event.
pub(super) struct Desk<'a> {
    /// Settings.
    pub config: &'a AgentConfig,
    /// The diary.
    pub journal: &'a mut Journal,
    /// Commands to be sent, in order.
    pub out: &'a mut Vec<Command>,
    /// The time.
    pub now: Arrival,
    /// When the mission's time is up; `None` where it has no limit.
    pub end: Option<Arrival>,
}

impl Desk<'_> {
    /// A step of the mission and its reason.
    pub fn info(&mut self, text: impl Into<String>) {
        self.journal.note(self.now, Level::Info, text);
    }

    /// Something that did not go as told.
    pub fn warn(&mut self, text: impl Into<String>) {
        self.journal.note(self.now, Level::Warn, text);
    }
}

/// What the robot is doing.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum Activity {
    /// Standing until the body rests, then sweeping.
    Settle { until: Arrival, look: Look },
    /// Sweeping.
    Sweep,
    /// Finding out which way the head's joints turn.
    SignTest(Box<SignTest>),
    /// Driving to the explorer's goal.
    Drive(Drive),
    /// Getting out of trouble.
    Recover { recovery: Box<Recovery>, gave_up: u32 },
    /// Standing for a while, then choosing anew.
    Rest { until: Arrival },
    /// Waiting for an operator.
    Stand,
}

/// What is done with the head while the robot stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum Look {
    /// Finding out which way pan and tilt turn.
    SignTest,
    /// Finding out how the tilt moves, so that later sweeps need not wait for it.
    Calibrate,
    /// A sweep.
    Sweep(SweepRequest),
}

/// A drive to a goal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Drive {
    /// When it began.
    pub since: Arrival,
    /// Length of the whole path then.
    pub path_m: f64,
    /// Times the path was planned anew.
    pub replans: u32,
}

/// The robot in service.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Running {
    pub(super) rig: Rig,
    pub(super) acquisition: Option<Acquisition>,
    pub(super) belief: Belief,
    pub(super) pilot: Pilot,
    pub(super) explorer: Explorer,
    pub(super) planner: Planner,
    pub(super) shape: RobotShape,
    pub(super) grid: Grid,
    pub(super) grid_made: Arrival,
    /// Images and lines that the grid was made of.
    grid_scans: u32,
    pub(super) activity: Activity,
    /// What is to be looked at before anything else.
    pub(super) queue: VecDeque<Look>,
    pub(super) mode: Mode,
    pub(super) lease: DriveLease,
    /// What the operator was last told of what holds the robot.
    pub(super) held: Option<Hold>,
    /// Whether the operator was told that the mode takes no drive commands.
    pub(super) refusal_told: bool,
    pub(super) ledger: Ledger,
    pub(super) candidates: Candidates,
    /// What beams carry that hit nothing.
    pub(super) phantom: PhantomWatch,
    pub(super) victim_config: VictimConfig,
    /// What was left when nothing was worth going to, as long as that is so.
    pub(super) frontiers_left: Option<Vec<FrontierLeft>>,
    /// Cells that the hull did not get past, and until when they are avoided.
    pub(super) shunned: Vec<(CellIndex, Arrival)>,
    /// Where a gap that could not be seen was assumed.
    pub(super) bridged: Vec<Pose2>,
    /// Where the ground that it turns over was assumed, beside the start.
    pub(super) turning_room: Option<Pose2>,
    /// Last resorts tried since the robot last had somewhere to go.
    pub(super) resorts: u32,
    /// Rooms and doorways as the last sweep left them.
    pub(super) places: Places,
    /// Whether the head is parked level for a turn, not to guard.
    pub(super) looks_level: bool,
    /// Whether a calibration that found nothing was repeated.
    pub(super) calibrated_again: bool,
    /// Sixths of a turn by which it was turned, or tried to be, to look to the other sides where the robot began.
    pub(super) looks_around: u32,
    pub(super) give_ups: u32,
    pub(super) battery_s: Option<i64>,
    /// The command in force and when it was sent.
    pub(super) command: DriveCommand,
    pub(super) commanded: Option<Arrival>,
    pub(super) wheels: Option<PlanarPose>,
    pub(super) last_wheels: PlanarPose,
    pub(super) latest_stamp: Stamp,
    pub(super) first_scan_due: bool,
    /// What the last sweep had to say of itself.
    pub(super) remarks: Vec<String>,
    pub(super) wheel_count: WheelCount,
    /// The sweep that is being watched in a recording of somebody else.
    pub(super) observed: ObservedSweep,
    /// Length of the path when a nod was last thought of.
    pub(super) nod_asked_m: f64,
    /// How far the end has come.
    pub(super) closing: Closing,
}

/// How a cycle ended for the mission as a whole.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It goes on.
    GoOn,
    /// Everything reachable is explored.
    Explored,
    /// The robot has fallen over.
    Fallen,
}

impl Running {
    /// Puts a rig into service at `start` (map frame).
    pub(super) fn new(rig: Rig, start: Isometry3<f64>, desk: &mut Desk<'_>) -> Self {
        let config = desk.config;
        let shape = shape_of(&rig);
        let assumed_m = shape.circumscribed_radius_m() + config.mission.assumed_margin_m;
        let mounted_within_m = rig.laser.as_ref().map_or(0.0, |laser| laser.mounted_within_m);
        let belief = Belief::new(config.belief.clone(), shape.clone(), start, assumed_m)
            .mounted_within(mounted_within_m);
        let acquisition = if rig.is_planar() {
            None
        } else {
            Acquisition::for_rig(&rig, config.acquisition.clone())
        };
        let mut running = Self {
            pilot: Pilot::new(config, &rig, &shape),
            explorer: explorer(config, &rig, acquisition.as_ref()),
            planner: Planner::default(),
            grid: belief.grid(),
            grid_made: desk.now,
            grid_scans: 0,
            activity: Activity::Stand,
            queue: VecDeque::new(),
            mode: config.mission.mode,
            lease: DriveLease::default(),
            held: None,
            refusal_told: false,
            ledger: Ledger::default(),
            phantom: PhantomWatch::default(),
            candidates: Candidates::default(),
            victim_config: config.victims,
            frontiers_left: None,
            shunned: Vec::new(),
            bridged: Vec::new(),
            turning_room: None,
            resorts: 0,
            places: Places::default(),
            looks_level: false,
            calibrated_again: false,
            looks_around: 0,
            give_ups: 0,
            battery_s: None,
            command: DriveCommand::STOP,
            commanded: None,
            wheels: None,
            last_wheels: PlanarPose::default(),
            latest_stamp: Stamp::default(),
            first_scan_due: true,
            remarks: Vec::new(),
            wheel_count: WheelCount::default(),
            observed: ObservedSweep::default(),
            nod_asked_m: 0.0,
            closing: Closing::NotYet,
            acquisition,
            belief,
            shape,
            rig,
        };
        running.plan_first_sweeps(desk);
        running
    }

    /// What the rig and the mission ask for before the first move.
    fn plan_first_sweeps(&mut self, desk: &mut Desk<'_>) {
        if desk.config.mission.observe {
            return;
        }
        if self.acquisition.is_some() && !self.sees_edges() {
            if desk.config.mission.mode == Mode::Auto {
                desk.warn(
                    "this rig tilts but never looks at the ground, so it cannot see an edge: standing \
                     still; `--mode teleop` lets you drive",
                );
            }
            return;
        }
        if self.acquisition.is_none() {
            if desk.config.mission.mode == Mode::Auto && !desk.config.belief.terrain.flat_floor {
                desk.warn(
                    "this rig cannot see an edge: standing still; `belief.terrain.flat_floor = true` \
                     lets it explore a floor that you vouch for, `--mode teleop` lets you drive",
                );
            }
            return;
        }
        // An operator gets a picture at once, and the guard line the height of the floor.
        if self.mode != Mode::Teleop {
            if desk.config.mission.verify_signs {
                self.queue.push_back(Look::SignTest);
            }
            if desk.config.mission.flowing_sweeps {
                self.queue.push_back(Look::Calibrate);
            }
            self.queue.extend(self.first_sweep(desk.config).map(Look::Sweep));
        }
        self.queue.extend(self.fan(desk.config).map(Look::Sweep));
        self.next_look_or_choose(desk);
    }

    /// Whether the laser can be tilted so far down that it meets level ground.
    pub(super) fn sees_edges(&self) -> bool {
        let sight = self.rig.visibility();
        self.acquisition.is_some() && sight.is_some_and(|sight| sight.nearest_ahead_m.is_some())
    }

    /// The pose of the robot in the plane.
    pub(super) fn pose2(&self) -> Pose2 {
        Pose2::from_isometry(&self.belief.world_from_robot())
    }

    /// What the belief is.
    pub fn belief(&self) -> &Belief {
        &self.belief
    }

    /// The account of the mission.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Frontiers that are left, each with the reason.
    pub fn frontiers_left(&self) -> Vec<FrontierLeft> {
        self.frontiers_left.clone().unwrap_or_else(|| {
            // Chinks that the hull does not fit into are of no use to whoever searches on.
            let width_cells = self.shape.width_m / self.grid.cell_m().max(0.01);
            let found = self.explorer.frontiers(&self.grid).into_iter();
            let found = found.filter(|frontier| frontier.cells as f64 >= width_cells);
            let unseen = |frontier: Frontier| FrontierLeft {
                x: frontier.at.x,
                y: frontier.at.y,
                cells: frontier.cells,
                reason: "not looked at before the mission ended".into(),
            };
            found.map(unseen).collect()
        })
    }

    /// The robot as the terrain sees it.
    pub fn shape(&self) -> &RobotShape {
        &self.shape
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Victim candidates with the evidence of a person.
    pub fn victims(&self) -> impl Iterator<Item = &Candidate> {
        self.candidates.confirmed(&self.victim_config)
    }

    /// The same with those that can only be one body made one.
    pub fn bodies(&self) -> Vec<Candidate> {
        self.candidates.bodies(&self.victim_config)
    }

    /// The rooms and doorways of the map, known again from sweep to sweep.
    pub fn places(&self) -> &Places {
        &self.places
    }

    /// Makes the grid anew after a sweep, and the places with it.
    pub(super) fn map_sweep(&mut self, now: Arrival) {
        self.refresh_grid(now);
        let walls = Walls::of(self.belief.mapper().landmarks());
        self.places = self.places.renewed(&self.grid, &walls);
    }

    pub(super) fn refresh_grid(&mut self, now: Arrival) {
        self.grid = self.belief.grid();
        self.grid_made = now;
        self.grid_scans = self.belief.terrain().scans();
    }

    /// Makes the grid anew if it is old and anything was seen since, or the robot has moved.
    pub(super) fn renew_grid(&mut self, desk: &Desk<'_>) {
        let period = Span::from_seconds(desk.config.mission.grid_period_s);
        let pose = self.pose2();
        let is_new = self.belief.terrain().scans() != self.grid_scans
            || self.grid.cell_of(pose.x_m, pose.y_m) != self.grid.robot();
        if is_new && desk.now - self.grid_made >= period {
            self.refresh_grid(desk.now);
        }
    }

    /// One control cycle: trouble first, then the operator, then whatever is being done.
    pub(super) fn cycle(&mut self, desk: &mut Desk<'_>) -> Verdict {
        if desk.config.mission.observe {
            return Verdict::GoOn;
        }
        let attitude = self.belief.attitude().unwrap_or_default();
        if attitude.roll_rad.abs() > FALLEN_RAD || attitude.pitch_rad.abs() > FALLEN_RAD {
            self.stop(desk);
            return Verdict::Fallen;
        }
        if self.watch_for_trouble(&attitude, desk) {
            return Verdict::GoOn;
        }
        if self.operator_cycle(desk) {
            return Verdict::GoOn;
        }
        self.activity_cycle(desk)
    }

    /// Time has passed without a message that would have driven a cycle.
    pub(super) fn wake(&mut self, desk: &mut Desk<'_>) {
        self.head_event(&HeadEvent::Tick, desk);
        if self.lease.ends().is_some() && self.lease.command(desk.now).is_none() {
            self.lease.release();
            if matches!(self.activity, Activity::Stand) {
                self.stop(desk);
            }
        }
    }

    /// When the robot must be woken even if nothing arrives.
    pub(super) fn next_wakeup(&self) -> Option<Arrival> {
        let head = self.acquisition.as_ref().and_then(Acquisition::next_wakeup);
        [head, self.lease.ends()].into_iter().flatten().min()
    }

    /// Compares motion with commands; true if the trouble has just begun.
    fn watch_for_trouble(&mut self, attitude: &BodyAttitude, desk: &mut Desk<'_>) -> bool {
        let PlanarPose { x_m, y_m, heading_rad } = self.last_wheels;
        let trouble = self.pilot.check(Motion {
            arrival: desk.now,
            command: self.command,
            odometry: Pose2 { x_m, y_m, yaw_rad: heading_rad },
            observed: self.belief.reckoned().map(Pose2::from_isometry),
            roll_rad: attitude.roll_rad,
            pitch_rad: attitude.pitch_rad,
        });
        let Some(trouble) = trouble else { return false };
        if matches!(self.activity, Activity::Recover { .. }) {
            return false;
        }
        self.ledger.troubles += 1;
        desk.warn(format!("trouble: {trouble}"));
        if self.mode == Mode::Teleop {
            self.stop(desk);
            return false;
        }
        let pose = self.pose2();
        if let Some(acquisition) = &mut self.acquisition {
            acquisition.stop_sweep("the robot is in trouble", desk.now);
        }
        let recovery = self.pilot.recover(desk.config, &trouble, &pose, desk.now);
        self.explorer.give_up(&trouble.to_string(), desk.now);
        self.activity = Activity::Recover { recovery: Box::new(recovery), gave_up: 0 };
        self.stop(desk);
        true
    }

    /// Sends a drive command if it differs from the one in force, or that one is old.
    pub(super) fn drive(&mut self, command: DriveCommand, desk: &mut Desk<'_>) {
        let old = self.commanded.is_none_or(|at| desk.now - at >= REPEAT);
        let repeat = old && !(command.is_stop() && self.command.is_stop());
        if command == self.command && !repeat {
            return;
        }
        self.command = command;
        self.commanded = Some(desk.now);
        desk.out.push(self.rig.drive_command(BodySpeed {
            linear_mps: command.linear_mps,
            angular_rps: command.angular_rps,
        }));
    }

    /// Stops the wheels, whatever was sent before.
    pub(super) fn stop(&mut self, desk: &mut Desk<'_>) {
        if !self.command.is_stop() || self.commanded.is_none() {
            self.command = DriveCommand::STOP;
            self.commanded = Some(desk.now);
            desk.out.push(self.rig.stop_command());
        }
    }

    /// What the time is being spent on.
    pub(super) fn pastime(&self) -> Pastime {
        match &self.activity {
            Activity::Settle { .. } | Activity::Sweep | Activity::SignTest(_) => Pastime::Scan,
            Activity::Recover { .. } => Pastime::Recover,
            Activity::Drive(_) | Activity::Rest { .. } | Activity::Stand => {
                if self.command.linear_mps != 0.0 {
                    Pastime::Drive
                } else if self.command.angular_rps != 0.0 {
                    Pastime::Turn
                } else {
                    Pastime::Think
                }
            }
        }
    }
}

/// An explorer for what the rig can see.
pub(super) fn explorer(
    config: &AgentConfig,
    rig: &Rig,
    acquisition: Option<&Acquisition>,
) -> Explorer {
    let mut explore = config.explore.clone();
    if rig.is_planar() {
        // A level line has no blind ring about the robot, and no sweep takes time.
        (explore.blind_m, explore.scan_s) = (0.0, 0.0);
    } else if let Some(sight) = rig.visibility() {
        explore.blind_m = sight.nearest_from_centre_m.unwrap_or(explore.blind_m);
    }
    if let (Some(acquisition), Some(view)) = (acquisition, rig.ground_view()) {
        let fan = Profile::ground_fan(&view, &config.acquisition.fan);
        let sweep_s = acquisition.seconds_for(&fan, config.mission.flowing_sweeps);
        explore.scan_s = explore.scan_s.min(sweep_s + config.mission.settle_s);
    }
    Explorer::new(explore)
}

/// The rig as the terrain sees it.
pub(super) fn shape_of(rig: &Rig) -> RobotShape {
    RobotShape {
        length_m: rig.body.length_m,
        width_m: rig.body.width_m,
        height_m: rig.height_m(),
        base_above_floor_m: rig.body.origin_height_m,
        wheel_radius_m: rig.drive.wheel_radius_m,
        ..RobotShape::default()
    }
}
