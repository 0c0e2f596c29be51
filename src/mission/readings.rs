//! Readings: what the server tells becomes motion, lines and candidates of the robot in service.

use super::motion::PlanarPose;
use super::running::{Activity, Desk, Running, Verdict};
use crate::acquisition::{HeadEvent, ParkState};
use crate::protocol::message::Sen;
use crate::protocol::{Dialect, Message};
use crate::robot::{HeadPose, HeadReading, OdometryReading};
use crate::scan::{LaserLine, RangeImage};
use crate::time::{Span, Stamp};
use nalgebra::Isometry3;
use std::borrow::Cow;

/// From the time that a UT2004 server prints with a laser line to the casting of its rays, where no calibration
/// tells.
const CAST_AFTER: Span = Span::from_millis(100);

impl Running {
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
            answer if self.rig.answers_line_query(answer) => {
                self.head_event(&HeadEvent::Answered, desk);
            }
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
            Sen::Ins(message) => self.belief.take_inertial(&self.rig.ins(message)),
            Sen::Inu(message) => self.belief.take_inertial(&self.rig.inu(message)),
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

    fn take_odometry(&mut self, reading: &OdometryReading) {
        let wheels = PlanarPose::from(reading);
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

    /// How long after a laser line's stamp its rays are cast, once a calibration has found it.
    pub fn line_lag(&self) -> Option<Span> {
        let acquisition = self.acquisition.as_ref().filter(|found| found.is_calibrated())?;
        Some(acquisition.control().timing().line_lag)
    }

    /// The head's pose at the newest stamp, at zero where it is not known.
    fn head_now(&self) -> HeadPose {
        self.acquisition
            .as_ref()
            .and_then(|acquisition| acquisition.pose_at(self.latest_stamp))
            .unwrap_or_default()
    }

    fn line(&mut self, line: &LaserLine, desk: &mut Desk<'_>) {
        let line = &*self.without_phantom(line);
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
            let clear = !self.looks_level
                && self.pilot.watch(
                    line,
                    &robot_from_sensor,
                    &world_from_robot,
                    &self.grid,
                    desk.now,
                );
            // Where no reading says that the tilt is there, only ground where it should be does: what
            // contradicts it may be seen under another tilt, and a sweep has to tell.
            let sure = clear || matches!(parked, ParkState::Verified { .. });
            if (sure || self.looks_level)
                && !matches!(self.activity, Activity::Sweep | Activity::Settle { .. })
            {
                let cast = acquisition.control().cast_time(line);
                self.belief.take_line(line, &robot_from_sensor, pose.tilt_rad, cast, sure);
            }
        }
        self.head_event(&HeadEvent::Line(line), desk);
    }

    /// `line` without the beams that hit nothing, where these carry a range.
    fn without_phantom<'a>(&mut self, line: &'a LaserLine) -> Cow<'a, LaserLine> {
        if self.rig.dialect != Dialect::Udk {
            return Cow::Borrowed(line);
        }
        let head = self.acquisition.as_ref().and_then(|found| found.pose_of_line(line));
        let robot_from_sensor = self.rig.robot_from_sensor(head.unwrap_or_default());
        let world_from_sensor = self.belief.world_from_robot() * robot_from_sensor;
        Cow::Owned(self.phantom.without(line, &world_from_sensor))
    }

    /// The same of a finished scan.
    pub(super) fn take_phantom_from(&mut self, image: &mut RangeImage) {
        if self.rig.dialect == Dialect::Udk {
            self.phantom.take_from(image, &self.belief.world_from_robot());
        }
    }

    /// A line of a laser that does not tilt: flat occupancy.
    fn planar_line(&mut self, line: &LaserLine) {
        let robot_from_sensor = self.rig.robot_from_sensor(HeadPose::default());
        self.take_level_line(line, &robot_from_sensor);
    }

    /// A line at the laser's own height: flat occupancy.
    pub(super) fn take_level_line(&mut self, line: &LaserLine, robot_from_sensor: &Isometry3<f64>) {
        // UT2004 casts the rays a burst after the one that it prints (protocol reference, section 6).
        let after = match self.rig.dialect {
            Dialect::Ut2004 => CAST_AFTER,
            Dialect::Udk => Span::ZERO,
        };
        self.belief.take_flat_line(line, robot_from_sensor, line.stamp + after);
    }
}
