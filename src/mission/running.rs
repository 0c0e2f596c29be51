//! The robot in service: readings in, activity after activity, commands out.

use super::belief::Belief;
use super::config::AgentConfig;
use super::journal::{Journal, Level};
use super::ledger::{Ledger, Pastime};
use super::motion::{BodyAttitude, PlanarPose};
use super::observe::ObservedSweep;
use super::operator::{DriveLease, Mode};
use super::pilot::Pilot;
use super::sign_test::SignTest;
use crate::acquisition::{
    Acquisition, HeadAction, HeadEvent, ParkState, Profile, Scan, SweepRequest,
};
use crate::exploration::{ExploreConfig, Explorer, FrontierLeft};
use crate::navigation::{DriveCommand, Motion, Planner, Pose2, Recovery};
use crate::protocol::message::Sen;
use crate::protocol::{Command, Message};
use crate::robot::{
    BodySpeed, HeadPose, HeadReading, InsReading, OdometryReading, Rig, WheelCount,
};
use crate::scan::LaserLine;
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
    pub(super) activity: Activity,
    /// What is to be looked at before anything else.
    pub(super) queue: VecDeque<Look>,
    pub(super) mode: Mode,
    pub(super) lease: DriveLease,
    pub(super) ledger: Ledger,
    pub(super) candidates: Candidates,
    victim_config: VictimConfig,
    pub(super) frontiers_left: Vec<FrontierLeft>,
    /// Cells that the hull did not get past, and until when they are avoided.
    pub(super) shunned: Vec<(CellIndex, Arrival)>,
    /// Where a gap that could not be seen was assumed.
    pub(super) bridged: Vec<Pose2>,
    /// Last resorts tried since the robot last had somewhere to go.
    pub(super) resorts: u32,
    pub(super) give_ups: u32,
    pub(super) battery_s: Option<i64>,
    /// The command in force and when it was sent.
    pub(super) command: DriveCommand,
    pub(super) commanded: Option<Arrival>,
    pub(super) wheels: Option<PlanarPose>,
    pub(super) last_wheels: PlanarPose,
    pub(super) latest_stamp: Stamp,
    first_scan_due: bool,
    pub(super) planar_lines: usize,
    pub(super) wheel_count: WheelCount,
    /// The sweep that is being watched in a recording of somebody else.
    pub(super) observed: ObservedSweep,
    /// Length of the path when a nod was last thought of.
    pub(super) nod_asked_m: f64,
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
        let belief = Belief::new(config.belief.clone(), shape.clone(), start, assumed_m);
        let acquisition = if rig.is_planar() {
            None
        } else {
            Acquisition::for_rig(&rig, config.acquisition.clone())
        };
        let mut explore: ExploreConfig = config.explore.clone();
        if let Some(sight) = rig.visibility() {
            explore.blind_m = sight.nearest_from_centre_m.unwrap_or(explore.blind_m);
        }
        if let (Some(acquisition), Some(view)) = (&acquisition, rig.ground_view()) {
            let fan = Profile::ground_fan(&view, &config.acquisition.fan);
            let sweep_s = acquisition.seconds_for(&fan, config.mission.flowing_sweeps);
            explore.scan_s = explore.scan_s.min(sweep_s + config.mission.settle_s);
        }
        let mut running = Self {
            pilot: Pilot::new(config, &rig, &shape),
            explorer: Explorer::new(explore),
            planner: Planner::default(),
            grid: belief.grid(),
            grid_made: desk.now,
            activity: Activity::Stand,
            queue: VecDeque::new(),
            mode: config.mission.mode,
            lease: DriveLease::default(),
            ledger: Ledger::default(),
            candidates: Candidates::default(),
            victim_config: config.victims,
            frontiers_left: Vec::new(),
            shunned: Vec::new(),
            bridged: Vec::new(),
            resorts: 0,
            give_ups: 0,
            battery_s: None,
            command: DriveCommand::STOP,
            commanded: None,
            wheels: None,
            last_wheels: PlanarPose::default(),
            latest_stamp: Stamp::default(),
            first_scan_due: true,
            planar_lines: 0,
            wheel_count: WheelCount::default(),
            observed: ObservedSweep::default(),
            nod_asked_m: 0.0,
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
        let (Some(acquisition), Some(view)) = (&self.acquisition, self.rig.ground_view()) else {
            if desk.config.mission.mode == Mode::Auto && !desk.config.belief.terrain.flat_floor {
                desk.warn(
                    "this rig cannot see an edge: standing still; `belief.terrain.flat_floor = true` \
                     lets it explore a floor that you vouch for, `--mode teleop` lets you drive",
                );
            }
            return;
        };
        if self.mode == Mode::Teleop {
            return;
        }
        if desk.config.mission.verify_signs {
            self.queue.push_back(Look::SignTest);
        }
        if desk.config.mission.flowing_sweeps {
            self.queue.push_back(Look::Calibrate);
        }
        let limits = acquisition.control().head().tilt().and_then(|axis| axis.limits);
        if let Some(lost) = Profile::paper_full().clipped(limits).1 {
            desk.warn(lost.explain(&view));
        }
        self.queue.extend(self.first_sweep(desk.config).map(Look::Sweep));
        self.queue.extend(self.fan(desk.config).map(Look::Sweep));
        self.next_look_or_choose(desk);
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

    /// Frontiers that stayed when nothing was left to explore.
    pub fn frontiers_left(&self) -> &[FrontierLeft] {
        &self.frontiers_left
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

    /// Takes in a message. Gives what it means for the mission.
    pub(super) fn message(&mut self, message: &Message, desk: &mut Desk<'_>) -> Verdict {
        if let Some(stamp) = message.time() {
            let is_scanner = matches!(message, Message::Sen(Sen::RangeScanner(_)));
            if !is_scanner {
                self.latest_stamp = self.latest_stamp.max(stamp);
                self.head_event(&HeadEvent::Stamped(stamp), desk);
            }
        }
        match message {
            Message::Sen(sensor) => self.sensor(sensor, desk),
            Message::MisSta(state) => {
                if let Some(reading) = self.rig.head_reading(state) {
                    self.joints(reading, desk);
                }
            }
            Message::AsTa(state) => {
                if let Some(reading) = self.rig.actuator_reading(state) {
                    self.joints(reading, desk);
                }
            }
            Message::Sta(state) => {
                self.battery_s = state.battery_s.or(self.battery_s);
                // The last line of a UT2004 burst: what came without a time came at this one.
                let stamp = state.time.unwrap_or(self.latest_stamp);
                if let Some(wheels) = self.wheels.take() {
                    self.take_wheels(wheels, stamp);
                }
                return self.cycle(desk);
            }
            _ => {}
        }
        Verdict::GoOn
    }

    fn sensor(&mut self, sensor: &Sen, desk: &mut Desk<'_>) {
        match sensor {
            Sen::Odometry(message) => {
                self.wheel_count.retire();
                let reading = self.rig.odometry(message);
                self.take_odometry(&reading);
            }
            Sen::Tachometer(message) => {
                if let Some(reading) = self.wheel_count.tachometer(message, &self.rig.drive) {
                    self.take_odometry(&reading);
                }
            }
            Sen::Ins(message) => self.take_attitude(&self.rig.ins(message)),
            Sen::Inu(message) => self.take_attitude(&self.rig.inu(message)),
            Sen::RangeScanner(message) => {
                match self.rig.laser_line(message, Some(self.latest_stamp)) {
                    Ok(line) if desk.config.mission.observe => self.observed_line(&line, desk),
                    Ok(line) => self.line(&line, desk),
                    Err(error) => desk.warn(format!("laser line not used: {error}")),
                }
            }
            Sen::VictSensor(message) => {
                let head = self.head_now();
                let world_from_robot = self.belief.world_from_robot();
                for seen in self.rig.victims(message, head) {
                    let place = world_from_robot * seen.p_robot;
                    self.candidates.sight(&seen.part, place, seen.distance_m);
                }
            }
            _ => {}
        }
    }

    fn take_attitude(&mut self, reading: &InsReading) {
        self.belief.take_attitude(BodyAttitude {
            roll_rad: reading.roll_rad,
            pitch_rad: reading.pitch_rad,
            heading_rad: reading.yaw_rad,
        });
    }

    fn take_odometry(&mut self, reading: &OdometryReading) {
        let wheels = PlanarPose {
            x_m: reading.odom_from_robot.translation.x,
            y_m: reading.odom_from_robot.translation.y,
            heading_rad: reading.odom_from_robot.rotation.angle(),
        };
        match reading.stamp {
            Some(stamp) => self.take_wheels(wheels, stamp),
            None => self.wheels = Some(wheels),
        }
    }

    fn take_wheels(&mut self, wheels: PlanarPose, stamp: Stamp) {
        self.last_wheels = wheels;
        self.belief.take_wheels(wheels, stamp);
        let world_from_robot = self.belief.world_from_robot();
        if let Some(acquisition) = &mut self.acquisition {
            acquisition.moved(stamp, world_from_robot);
        }
    }

    fn joints(&mut self, reading: HeadReading, desk: &mut Desk<'_>) {
        self.head_event(&HeadEvent::Joints(reading), desk);
    }

    /// The head's pose at the newest stamp, at zero where it is not known.
    fn head_now(&self) -> HeadPose {
        self.acquisition
            .as_ref()
            .and_then(|acquisition| acquisition.pose_at(self.latest_stamp))
            .unwrap_or_default()
    }

    fn line(&mut self, line: &LaserLine, desk: &mut Desk<'_>) {
        let Some(acquisition) = &self.acquisition else {
            return self.planar_line(line);
        };
        let parked = acquisition.parked(desk.now);
        if matches!(self.activity, Activity::SignTest(_)) {
            self.head_event(&HeadEvent::Line(line), desk);
            return self.sign_test_line(line, parked, desk);
        }
        let head = match parked {
            ParkState::Computed { pose, .. } | ParkState::Verified { pose, .. } => Some(pose),
            _ => None,
        };
        if let Some(pose) = head.filter(|_| parked.covers(line.stamp)) {
            let robot_from_sensor = self.rig.robot_from_sensor(pose);
            let world_from_robot = self.belief.world_from_robot();
            self.pilot.watch(line, &robot_from_sensor, &world_from_robot, &self.grid, desk.now);
            if !matches!(self.activity, Activity::Sweep | Activity::Settle { .. }) {
                self.belief.take_line(line, &robot_from_sensor, pose.tilt_rad);
            }
        }
        self.head_event(&HeadEvent::Line(line), desk);
    }

    /// A line of a laser that does not tilt: flat occupancy.
    fn planar_line(&mut self, line: &LaserLine) {
        let robot_from_sensor = self.rig.robot_from_sensor(HeadPose::default());
        self.take_level_line(line, &robot_from_sensor);
    }

    /// A line at the laser's own height: flat occupancy.
    pub(super) fn take_level_line(&mut self, line: &LaserLine, robot_from_sensor: &Isometry3<f64>) {
        if self.belief.take_flat_line(line, robot_from_sensor) {
            self.planar_lines += 1;
        }
    }

    /// Hands an event to the acquisition and does what it asks.
    pub(super) fn head_event(&mut self, event: &HeadEvent<'_>, desk: &mut Desk<'_>) {
        let Some(acquisition) = &mut self.acquisition else { return };
        let actions = acquisition.handle(event, desk.now);
        self.head_actions(actions, desk);
    }

    pub(super) fn head_actions(&mut self, actions: Vec<HeadAction>, desk: &mut Desk<'_>) {
        for action in actions {
            match action {
                HeadAction::Send(command) => {
                    desk.out.extend(self.rig.head_commands(command.pan, command.tilt));
                }
                HeadAction::Ask => desk.out.extend(self.rig.trigger_command()),
                HeadAction::Filed { .. } => {}
                HeadAction::Finished(scan) => self.finish_sweep(*scan, desk),
                HeadAction::Calibrated(report) => {
                    desk.info(format!("pan-tilt: {}", report.text));
                    self.next_look_or_choose(desk);
                }
            }
        }
    }

    /// A sweep has ended: everything it told enters the belief.
    fn finish_sweep(&mut self, scan: Scan, desk: &mut Desk<'_>) {
        self.ledger.sweep(&scan);
        for remark in &scan.remarks {
            desk.warn(format!("{} sweep: {remark}", scan.profile));
        }
        if scan.driven_m.is_some() {
            return self.finish_nod(scan, desk);
        }
        if std::mem::take(&mut self.first_scan_due) {
            self.measure_floor(&scan, desk);
        }
        let (profile, filed, seconds) = (scan.profile.clone(), scan.filed, scan.seconds());
        let budget = scan.budget.to_string();
        let errors = crate::mapping::ScanErrors {
            tilt_offset_sigma_rad: scan.errors.tilt_common_rad,
            ..crate::mapping::ScanErrors::default()
        };
        let before = self.belief.world_from_robot();
        let findings = self.belief.take_scan(scan.image, errors);
        let after = self.belief.world_from_robot();
        let counts = [findings.planes, findings.spheres, findings.cylinders];
        for (sum, count) in self.ledger.surfaces.iter_mut().zip(counts) {
            *sum += count;
        }
        self.ledger.associations += findings.update.associations.len();
        let moved_m = (after.translation.vector - before.translation.vector).norm();
        let turned = before.rotation.angle_to(&after.rotation).to_degrees();
        desk.info(format!(
            "{profile} sweep: {filed} rows in {seconds:.1} s ({budget}), {} planes ({} known, {} new), pose \
             corrected by {moved_m:.3} m and {turned:.2}°",
            findings.planes,
            findings.update.associations.len(),
            findings.update.added.len(),
        ));
        self.pilot.corrected(&before, &after);
        if findings.update.loop_closed {
            desk.info(format!(
                "loop closed, {} earlier poses corrected",
                findings.update.moved.len()
            ));
        }
        self.refresh_grid(desk.now);
        let pose = self.pose2();
        self.explorer.swept(&self.grid, &pose, std::f64::consts::PI);
        self.next_look_or_choose(desk);
    }

    /// Measures how high the robot's origin stands above the floor; no message tells it. The belief
    /// is still empty then and is begun anew with the measured height.
    fn measure_floor(&mut self, scan: &Scan, desk: &mut Desk<'_>) {
        let guess_m = self.shape.base_above_floor_m;
        let Some(height_m) = Belief::floor_below_m(&scan.image) else { return };
        if (height_m - guess_m).abs() < 0.01 {
            return;
        }
        desk.info(format!(
            "the floor lies {height_m:.3} m below the robot's origin, not {guess_m:.3} m as supposed"
        ));
        self.rig.body.origin_height_m = height_m;
        self.shape = shape_of(&self.rig);
        self.belief.restart(self.shape.clone());
        self.pilot = Pilot::new(desk.config, &self.rig, &self.shape);
    }

    pub(super) fn refresh_grid(&mut self, now: Arrival) {
        self.grid = self.belief.grid();
        self.grid_made = now;
    }

    /// One control cycle: trouble first, then the operator, then whatever is being done.
    fn cycle(&mut self, desk: &mut Desk<'_>) -> Verdict {
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
            observed: None,
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
