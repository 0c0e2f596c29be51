//! Going on after a lost connection: the server has destroyed the robot and makes another one.

use super::operator::Mode;
use super::pilot::Pilot;
use super::running::{Activity, Desk, Look, Running, shape_of};
use crate::acquisition::Acquisition;
use crate::navigation::DriveCommand;
use crate::protocol::WirePose;
use crate::robot::{Rig, WheelCount, wire_location, wire_orientation};
use crate::time::Stamp;
use nalgebra::{Isometry3, Point3};

/// A new robot is made this much above the believed ground: servers refuse or throw robots that
/// touch it.
const LIFT_M: f64 = 0.05;

/// Where the new robot stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Put {
    /// Where the old one was believed to be.
    Back,
    /// At this pose of the map, which is the level's own frame.
    At(Isometry3<f64>),
    /// Where the old one began: the server was asked for a start by its name.
    AtStart,
}

/// A believed pose as INIT takes it.
pub(super) fn placeable(world_from_robot: &Isometry3<f64>) -> WirePose {
    let mut place = Point3::from(world_from_robot.translation.vector);
    place.z += LIFT_M;
    WirePose {
        location: wire_location(&place).map(to_wire_decimals),
        orientation: wire_orientation(&world_from_robot.rotation).map(to_wire_decimals),
    }
}

/// Four decimals, as servers write them, and no minus zero.
fn to_wire_decimals(value: f64) -> f64 {
    let rounded = (value * 1e4).round() / 1e4;
    if rounded == 0.0 { 0.0 } else { rounded }
}

impl Running {
    /// Takes a new robot of the same class into service. Map, way and account stay; whatever was
    /// being done is dropped, and a look around comes first.
    pub(super) fn resume(&mut self, mut rig: Rig, put: Put, desk: &mut Desk<'_>) {
        // A scan has measured the height once; no message tells it.
        rig.body.origin_height_m = self.rig.body.origin_height_m;
        self.explorer.give_up("the connection was lost", desk.now);
        self.acquisition = if rig.is_planar() {
            None
        } else {
            Acquisition::for_rig(&rig, desk.config.acquisition.clone())
        };
        self.shape = shape_of(&rig);
        self.pilot = Pilot::new(desk.config, &rig, &self.shape);
        self.rig = rig;
        self.lease.release();
        self.command = DriveCommand::STOP;
        self.commanded = None;
        self.wheels = None;
        self.wheel_count = WheelCount::default();
        self.last_wheels = super::motion::PlanarPose::default();
        // The clock of another server may be behind.
        self.latest_stamp = Stamp::default();
        let (place, sigma_m, sigma_rad) = self.placed(put);
        self.belief.put_at(&place, sigma_m, sigma_rad);
        self.queue.clear();
        self.activity = Activity::Stand;
        self.refresh_grid(desk.now);
        if self.mode == Mode::Teleop || !self.sees_edges() {
            return;
        }
        if desk.config.mission.flowing_sweeps {
            self.queue.push_back(Look::Calibrate);
        }
        self.queue.extend(self.fan(desk.config).map(Look::Sweep));
        self.next_look_or_choose(desk);
    }

    /// Where a robot put like this stands in the map, and how far off that may be: the server puts it
    /// at a place of its level, from which the map has drifted by as much as the way so far allows.
    fn placed(&self, put: Put) -> (Isometry3<f64>, f64, f64) {
        const DRIFT_PER_METRE: f64 = 0.005;
        let drift_m = 0.05 + DRIFT_PER_METRE * self.belief.path_m();
        match put {
            Put::Back => (self.belief.world_from_robot(), drift_m.min(0.3), 0.02),
            Put::At(pose) => (pose, drift_m.min(0.3), 0.02),
            Put::AtStart => (*self.belief.start(), 0.05, 0.02),
        }
    }
}
