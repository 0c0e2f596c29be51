//! A small server for tests: one pan-tilt with a laser in a room, speaking in bursts.
//!
//! Written apart from the stand-in simulator on purpose: it knows only what the tests of this module
//! need, and it can be told to misbehave.

use super::{
    Acquisition, CalibrationReport, HeadAction, HeadCommand, HeadEvent, Reach, Scan, ServoLaw,
    ServoState,
};
use crate::geometry::AngleSpan;
use crate::robot::{Demand, HeadPose, HeadReading, Joint, JointAngle, JointKind, Mount, ScanHead};
use crate::scan::LaserLine;
use crate::time::{Arrival, Stamp};
use nalgebra::{Isometry3, Point3, Vector3};
use rand_core::{Rng as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::{FRAC_PI_2, PI};

/// How the server behaves.
#[derive(Clone, Debug)]
pub struct Behaviour {
    pub law: ServoLaw,
    pub limits: Option<AngleSpan>,
    /// Time between bursts, and the greatest deviation from it.
    pub burst_s: f64,
    pub jitter_s: f64,
    /// Share of a burst between a line's printed stamp and the casting of its rays, in 0..=1.
    pub cast_share: f64,
    /// Lines carry the stamp of the burst before.
    pub line_lags: bool,
    pub readings: bool,
    /// Readings are cut to this grid.
    pub reading_grid_rad: f64,
    /// Time from sending to the server, and from the server.
    pub up_s: f64,
    pub down_s: f64,
    /// Commands are obeyed on this frame grid.
    pub frame_s: f64,
    pub stamp_grid_s: f64,
    pub range_noise: f64,
}

impl Default for Behaviour {
    fn default() -> Self {
        Self {
            law: ServoLaw::hinge(0.17),
            limits: Some(AngleSpan::new(-1.05, 1.05)),
            burst_s: 0.2,
            jitter_s: 0.03,
            cast_share: 0.5,
            line_lags: true,
            readings: true,
            reading_grid_rad: 1e-4,
            up_s: 0.002,
            down_s: 0.002,
            frame_s: 0.02,
            stamp_grid_s: 0.01,
            range_noise: 0.001,
        }
    }
}

/// What goes wrong, and when, in server seconds since the start.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    pub laser_stops_at_s: Option<f64>,
    pub tilt_sticks_at_s: Option<f64>,
    pub true_limits: Option<AngleSpan>,
    /// Readings arrive this much later than sent.
    pub reading_delay_s: f64,
    /// Every second reading is held back behind its successor.
    pub swap_readings: bool,
    /// From then on every second line is held back behind its successor.
    pub swap_lines_from_s: Option<f64>,
    pub drop_every: Option<u64>,
    pub clock_jump: Option<(f64, f64)>,
    /// Nothing arrives from the first time on for the second; then all of it does.
    pub stall: Option<(f64, f64)>,
    /// From the first time on everything arrives later by the second.
    pub slower: Option<(f64, f64)>,
}

pub struct Testbed {
    pub behaviour: Behaviour,
    pub faults: Faults,
    rng: Pcg64Mcg,
    now_s: f64,
    tilt: ServoState,
    demand: Demand,
    pending: Vec<(f64, HeadCommand)>,
    queue: Vec<(f64, u64, Message)>,
    serial: u64,
    next_burst_s: f64,
    last_stamp: f64,
    cast: Option<(f64, Option<(LaserLine, f64)>)>,
    held: Option<HeadReading>,
    held_line: Option<LaserLine>,
    /// Stamp of every line sent, with the true tilt when its rays were cast.
    pub truth: Vec<(Stamp, f64)>,
    lines: u64,
    pub world: World,
    /// Reports of calibrations.
    pub calibrations: Vec<CalibrationReport>,
    /// What the tilt was found to reach.
    pub reaches: Vec<Reach>,
}

#[derive(Clone, Debug)]
enum Message {
    Line(LaserLine),
    Joints(HeadReading),
    Stamped(Stamp),
    Answer,
}

/// Level ground and upright walls around the origin, seen by a laser that does not move.
#[derive(Clone, Debug)]
pub struct World {
    pub ground_z: f64,
    pub ceiling_z: f64,
    /// Half-lengths of the room in x and y.
    pub room: [f64; 2],
}

impl Default for World {
    fn default() -> Self {
        Self { ground_z: -0.15, ceiling_z: 3.0, room: [6.0, 4.0] }
    }
}

impl World {
    pub fn range(&self, origin: &Point3<f64>, direction: &Vector3<f64>) -> f64 {
        let plane = |o: f64, d: f64, at: f64| {
            let t = (at - o) / d;
            if t.is_finite() && t > 1e-9 { t } else { f64::INFINITY }
        };
        [
            plane(origin.z, direction.z, self.ground_z),
            plane(origin.z, direction.z, self.ceiling_z),
            plane(origin.x, direction.x, self.room[0]),
            plane(origin.x, direction.x, -self.room[0]),
            plane(origin.y, direction.y, self.room[1]),
            plane(origin.y, direction.y, -self.room[1]),
        ]
        .into_iter()
        .fold(f64::INFINITY, f64::min)
    }
}

/// The paper's head: the laser about 0.6 m over the ground on a pan-tilt.
pub fn head(limits: Option<AngleSpan>, speed_rad_s: Option<f64>) -> ScanHead {
    let revolute = JointKind::Revolute;
    let pan = Joint::from_wire("PanTilt", 1, revolute, [0.1, 0.0, -0.35], [PI, 0.0, 0.0]);
    let mut tilt =
        Joint::from_wire("PanTilt", 2, revolute, [0.0, 0.0, 0.06], [FRAC_PI_2, 0.0, 0.0]);
    tilt.limits = limits.map(|core| AngleSpan::new(-core.min_rad, -core.max_rad));
    tilt.max_speed = speed_rad_s;
    ScanHead::new(Mount {
        joints: vec![pan, tilt],
        part_from_device: Isometry3::translation(0.03, 0.0, 0.04),
    })
}

/// A line of the room under `pose`, its ranges scaled by `scale`.
pub fn line_at(world: &World, head: &ScanHead, pose: HeadPose, scale: f64) -> LaserLine {
    let sensor = head.robot_from_device(pose);
    let step = PI / (BEAMS - 1) as f64;
    let ranges_m = (0..BEAMS)
        .map(|beam| {
            let (sin, cos) = (-FRAC_PI_2 + beam as f64 * step).sin_cos();
            let direction = sensor.rotation * Vector3::new(cos, sin, 0.0);
            (world.range(&sensor.translation.vector.into(), &direction) * scale).min(20.0)
        })
        .collect();
    LaserLine {
        stamp: Stamp(0),
        first_bearing_rad: -FRAC_PI_2,
        bearing_step_rad: step,
        min_range_m: 0.1,
        max_range_m: 20.0,
        phantom_m: None,
        ranges_m,
    }
}

/// However a sweep ended, its time budget holds all of its time.
pub fn books_balance(scan: &Scan) {
    let (booked_s, lasted_s) = (scan.budget.total_s(), scan.seconds());
    assert!(
        (booked_s - lasted_s).abs() < 1e-6,
        "{} of {lasted_s} s: {:?}",
        scan.budget,
        scan.remarks
    );
}

/// When a server's first message is stamped.
const EPOCH_S: f64 = 5085.0;
const STEP_S: f64 = 0.0025;
pub const BEAMS: usize = 61;

impl Testbed {
    pub fn new(behaviour: Behaviour, faults: Faults, seed: u64) -> Self {
        Self {
            behaviour,
            faults,
            rng: Pcg64Mcg::seed_from_u64(seed),
            now_s: 0.0,
            tilt: ServoState::default(),
            demand: Demand::Angle(0.0),
            pending: Vec::new(),
            queue: Vec::new(),
            serial: 0,
            next_burst_s: 0.05,
            last_stamp: EPOCH_S,
            cast: None,
            held: None,
            held_line: None,
            truth: Vec::new(),
            lines: 0,
            world: World::default(),
            calibrations: Vec::new(),
            reaches: Vec::new(),
        }
    }

    pub fn now(&self) -> Arrival {
        Arrival::from_seconds(self.now_s)
    }

    fn uniform(&mut self) -> f64 {
        (self.rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Runs until `limit_s` or until a scan is finished.
    pub fn run(&mut self, acquisition: &mut Acquisition, limit_s: f64) -> Option<Scan> {
        let end = self.now_s + limit_s;
        while self.now_s < end {
            self.now_s += STEP_S;
            self.advance_server();
            let scan = self.deliver(acquisition);
            if scan.is_some() {
                return scan;
            }
        }
        None
    }

    /// Runs until something holds, or for `limit_s`.
    pub fn run_until(
        &mut self,
        acquisition: &mut Acquisition,
        limit_s: f64,
        holds: impl Fn(&Self) -> bool,
    ) {
        let end = self.now_s + limit_s;
        while self.now_s < end && !holds(self) {
            self.run(acquisition, 0.05);
        }
    }

    /// Puts commands of an action list on their way; hands back a scan if one is finished.
    pub fn take(&mut self, actions: Vec<HeadAction>) -> Option<Scan> {
        let mut finished = None;
        for action in actions {
            match action {
                HeadAction::Send(command) => {
                    let frame = self.behaviour.frame_s;
                    let arrives = self.now_s + self.behaviour.up_s;
                    self.pending.push(((arrives / frame).ceil() * frame, command));
                }
                HeadAction::Finished(scan) => {
                    books_balance(&scan);
                    finished = Some(*scan);
                }
                HeadAction::Query => {
                    let frame = self.behaviour.frame_s;
                    let arrives = self.now_s + self.behaviour.up_s;
                    let answered_s = (arrives / frame).ceil() * frame;
                    self.send(Message::Answer, answered_s - self.now_s);
                }
                HeadAction::Calibrated(report) => self.calibrations.push(*report),
                HeadAction::Reach(reach) => self.reaches.push(reach),
                // Its scanner speaks by itself.
                HeadAction::Ask | HeadAction::Filed { .. } => {}
            }
        }
        finished
    }

    fn deliver(&mut self, acquisition: &mut Acquisition) -> Option<Scan> {
        self.queue.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        while self.queue.first().is_some_and(|row| row.0 <= self.now_s) {
            let (_, _, message) = self.queue.remove(0);
            let event = match &message {
                Message::Line(line) => HeadEvent::Line(line),
                Message::Joints(reading) => HeadEvent::Joints(*reading),
                Message::Stamped(stamp) => HeadEvent::Stamped(*stamp),
                Message::Answer => HeadEvent::Answered,
            };
            let actions = acquisition.handle(&event, self.now());
            if let Some(scan) = self.take(actions) {
                return Some(scan);
            }
        }
        let due = acquisition.next_wakeup().is_some_and(|wakeup| wakeup <= self.now());
        if due {
            let actions = acquisition.handle(&HeadEvent::Tick, self.now());
            return self.take(actions);
        }
        None
    }

    fn advance_server(&mut self) {
        let due: Vec<_> = self.pending.iter().filter(|c| c.0 <= self.now_s).copied().collect();
        self.pending.retain(|c| c.0 > self.now_s);
        for (_, command) in due {
            if let Some(demand) = command.tilt {
                let limits = self.faults.true_limits.or(self.behaviour.limits);
                self.demand = match (demand, limits) {
                    (Demand::Angle(angle), Some(limits)) => Demand::Angle(limits.clamp(angle)),
                    _ => demand,
                };
            }
        }
        let stuck = self.faults.tilt_sticks_at_s.is_some_and(|at| self.now_s >= at);
        if !stuck {
            self.tilt = self.behaviour.law.advance(self.tilt, self.demand, STEP_S);
            let limits = self.faults.true_limits.or(self.behaviour.limits);
            if let Some(limits) = limits.filter(|limits| !limits.contains(self.tilt.angle_rad)) {
                self.tilt = ServoState::at_rest(limits.clamp(self.tilt.angle_rad));
            }
        }
        if self.cast.as_ref().is_some_and(|(at, line)| line.is_none() && *at <= self.now_s) {
            let line = self.cast_line();
            let tilt = self.tilt.angle_rad;
            if let Some(cast) = &mut self.cast {
                cast.1 = Some((line, tilt));
            }
        }
        if self.now_s >= self.next_burst_s {
            self.burst();
        }
    }

    fn stamp(&self, seconds: f64) -> Stamp {
        let grid = self.behaviour.stamp_grid_s;
        Stamp::from_seconds((seconds / grid).round() * grid)
    }

    fn send(&mut self, message: Message, extra_s: f64) {
        self.serial += 1;
        let slower_s = self.faults.slower.filter(|(at, _)| self.now_s >= *at).map_or(0.0, |s| s.1);
        let arrives_s = self.now_s + self.behaviour.down_s + extra_s + slower_s;
        let stall = self.faults.stall.map(|(at, lasts)| (at, at + lasts));
        let held_up = stall.filter(|&(from, to)| from <= arrives_s && arrives_s < to);
        self.queue.push((held_up.map_or(arrives_s, |(_, to)| to), self.serial, message));
    }

    fn burst(&mut self) {
        let jump = self.faults.clock_jump.filter(|(at, _)| self.now_s >= *at).map_or(0.0, |j| j.1);
        let level_s = EPOCH_S + self.now_s + jump;
        let stopped = self.faults.laser_stops_at_s.is_some_and(|at| self.now_s >= at);
        // With a lag of a burst the line sent now was cast since the last burst and carries its stamp.
        let ready = if self.behaviour.line_lags {
            self.cast
                .take()
                .and_then(|cast| cast.1)
                .map(|(line, tilt)| (line, tilt, self.last_stamp))
        } else {
            Some((self.cast_line(), self.tilt.angle_rad, level_s))
        };
        if let Some((mut line, tilt, stamp)) = ready {
            self.lines += 1;
            line.stamp = self.stamp(stamp);
            let dropped = self.faults.drop_every.is_some_and(|n| self.lines.is_multiple_of(n));
            if !stopped && !dropped {
                self.truth.push((line.stamp, tilt));
                let swaps = self.faults.swap_lines_from_s.is_some_and(|from| self.now_s >= from);
                match self.held_line.take() {
                    Some(held) => {
                        self.send(Message::Line(line), 0.0);
                        self.send(Message::Line(held), 0.0);
                    }
                    None if swaps => self.held_line = Some(line),
                    None => self.send(Message::Line(line), 0.0),
                }
            }
        }
        if self.behaviour.readings {
            self.send_reading(level_s);
        }
        let stamp = self.stamp(level_s);
        self.send(Message::Stamped(stamp), 0.0);
        self.last_stamp = level_s;
        let jitter = (2.0 * self.uniform() - 1.0) * self.behaviour.jitter_s;
        self.next_burst_s = self.now_s + self.behaviour.burst_s + jitter;
        if self.behaviour.line_lags {
            let share = self.behaviour.cast_share * 0.999;
            self.cast = Some((self.now_s + share * (self.next_burst_s - self.now_s), None));
            if share < 0.01 {
                let now = (self.cast_line(), self.tilt.angle_rad);
                self.cast = Some((self.now_s, Some(now)));
            }
        }
    }

    fn send_reading(&mut self, level_s: f64) {
        let grid = self.behaviour.reading_grid_rad;
        let cut = (self.tilt.angle_rad / grid).trunc() * grid;
        let reading = HeadReading {
            stamp: self.stamp(level_s),
            pan: Some(JointAngle { angle_rad: 0.0, half_width_rad: grid }),
            tilt: Some(JointAngle {
                angle_rad: cut + 0.5 * grid * cut.signum(),
                half_width_rad: grid,
            }),
        };
        let delay = self.faults.reading_delay_s;
        match self.held.take() {
            Some(held) => {
                self.send(Message::Joints(reading), delay);
                self.send(Message::Joints(held), delay);
            }
            None if self.faults.swap_readings => self.held = Some(reading),
            None => self.send(Message::Joints(reading), delay),
        }
    }

    fn cast_line(&mut self) -> LaserLine {
        let pose = HeadPose::tilted(self.tilt.angle_rad);
        let mut line = line_at(&self.world, &head(None, None), pose, 1.0);
        for range in &mut line.ranges_m {
            let noise = 1.0
                + (2.0 * ((self.rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64) - 1.0)
                    * self.behaviour.range_noise;
            *range = (*range * noise).min(20.0);
        }
        line
    }

    /// Error of each filed row against the true tilt at the casting of its line, in degrees.
    pub fn tilt_errors_deg(&self, scan: &Scan) -> Vec<f64> {
        scan.image
            .rows()
            .iter()
            .filter_map(|row| {
                let stamp = row.stamp?;
                let truth = self.truth.iter().rev().find(|t| t.0 == stamp)?;
                Some((row.tilt_rad - truth.1).to_degrees())
            })
            .collect()
    }

    pub fn tilt_rad(&self) -> f64 {
        self.tilt.angle_rad
    }

    pub fn now_s(&self) -> f64 {
        self.now_s
    }
}
