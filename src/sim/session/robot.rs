//! One robot of a session: its body, joints, sensors and what it tells.

use super::fault::Inside;
use crate::protocol::command::{Drive, DriveForm, MisPkg, MisPkgForm, Order};
use crate::protocol::message::{AsTa, LinkState, MisSta, Sta};
use crate::protocol::{Dialect, Message};
use crate::sim::catalogue::RobotClass;
use crate::sim::pan_tilt::PanTilt;
use crate::sim::physics::{Physics, RobotKey, STEP_S};
use crate::sim::sensor::{Carrier, Device, Instant, Suite, TagMemory, Timer};
use crate::sim::solid::Solid;
use crate::sim::spec::Layout;
use crate::sim::surroundings::{RobotBody, Surroundings};
use crate::sim::truth::{CastTruth, Score, Truth};
use crate::sim::vehicle::Vehicle;
use crate::sim::wire;
use crate::sim::world::World;
use crate::time::{Span, Stamp};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::collections::VecDeque;
use std::sync::Arc;

/// How long a robot takes to be put back on its wheels.
const FLIP: Span = Span::from_millis(3000);

/// UDK robots report their state this often, in seconds.
const UDK_STATUS_S: f64 = 0.1;

/// UT2004 scanners cast this long after a burst, as scans fitted to recorded poses show.
const SCAN_LAG: Span = Span::from_millis(100);

/// Casts whose truth is kept for whoever scores.
const MOST_CASTS: usize = 256;

/// What a battery reports that lasts for ever.
const ENDLESS_BATTERY_S: i64 = 99_999;

pub(super) struct Robot {
    pub(super) key: RobotKey,
    pub(super) name: String,
    pub(super) class: Arc<RobotClass>,
    pub(super) dialect: Dialect,
    pub(super) vehicle: Box<dyn Vehicle>,
    pub(super) units: Vec<PanTilt>,
    pub(super) suite: Suite,
    pub(super) score: Score,
    pub(super) casts: VecDeque<CastTruth>,
    pub(super) inside: Inside,
    /// Its tile of a split screen, or -1.
    pub(super) view: i64,
    /// The tile of its first camera (UDK).
    pub(super) first_tile: usize,
    spawned: Stamp,
    solids: Arc<Vec<(Isometry3<f64>, Solid)>>,
    radius_m: f64,
    spin_rps: [f64; 2],
    normalized: bool,
    light: bool,
    flip_until: Option<Stamp>,
    status: Timer,
    /// UT2004: when the scanners cast next, and how that line is stamped.
    scan_due: Option<(Stamp, Stamp)>,
}

/// The world at one tick, as the robots in it find it.
pub(super) struct Stage<'a> {
    pub(super) world: &'a World,
    pub(super) bodies: &'a [RobotBody],
    /// Level time.
    pub(super) now: Stamp,
}

/// What a robot needs to come to life.
pub(super) struct Birth {
    pub(super) key: RobotKey,
    pub(super) name: String,
    pub(super) class: Arc<RobotClass>,
    pub(super) dialect: Dialect,
    pub(super) vehicle: Box<dyn Vehicle>,
    pub(super) units: Vec<PanTilt>,
    pub(super) suite: Suite,
    pub(super) score: Score,
    pub(super) now: Stamp,
    pub(super) message_interval_s: f64,
    pub(super) first_tile: usize,
}

impl Robot {
    pub(super) fn new(birth: Birth) -> Self {
        let Birth { key, name, class, dialect, vehicle, units, suite, score, now, .. } = birth;
        let solids = Arc::new(class.solids());
        let [length, width, height] = class.extents_m();
        let status_s = match dialect {
            Dialect::Ut2004 => birth.message_interval_s,
            Dialect::Udk => UDK_STATUS_S,
        };
        Self {
            key,
            name,
            dialect,
            vehicle,
            units,
            suite,
            score,
            casts: VecDeque::new(),
            inside: Inside { odometry_scale: 1.0, ..Inside::default() },
            view: -1,
            first_tile: birth.first_tile,
            spawned: now,
            solids,
            // Every part lies within the extents, the origin among them.
            radius_m: (length * length + width * width + height * height).sqrt(),
            spin_rps: [0.0; 2],
            normalized: false,
            light: false,
            flip_until: None,
            status: Timer::new(status_s, now),
            scan_due: None,
            class,
        }
    }

    /// The robot as its sensors know it.
    pub(super) fn carrier(&self) -> Carrier<'_> {
        Carrier { class: &self.class, state: self.vehicle.state(), units: &self.units }
    }

    /// Lets `read` use the sensors on a stage; `stamp` is what lines are stamped with.
    pub(super) fn sense<R>(
        &mut self,
        stage: &Stage<'_>,
        tags: &TagMemory,
        stamp: Stamp,
        read: impl FnOnce(&mut Suite, &Instant<'_>) -> R,
    ) -> R {
        let Self { key, class, vehicle, units, suite, inside, .. } = self;
        let instant = Instant {
            carrier: Carrier { class, state: vehicle.state(), units },
            surroundings: Surroundings { world: stage.world, bodies: stage.bodies, own: *key },
            tags,
            stamp,
            now: stage.now,
            odometry_scale: inside.odometry_scale,
            silenced: &inside.silenced,
        };
        read(suite, &instant)
    }

    /// What a line of this robot is stamped with at `now`.
    pub(super) fn stamp(&self, now: Stamp) -> Stamp {
        now + self.inside.clock_offset
    }

    /// The sensors beside the robot that carries them.
    pub(super) fn split(&mut self) -> (Carrier<'_>, &mut Suite) {
        let carrier =
            Carrier { class: &self.class, state: self.vehicle.state(), units: &self.units };
        (carrier, &mut self.suite)
    }

    pub(super) fn body(&self) -> RobotBody {
        RobotBody {
            key: self.key,
            world_from_robot: self.vehicle.state().world_from_robot,
            solids: self.solids.clone(),
            radius_m: self.radius_m,
        }
    }

    /// Seconds of battery left, cut to whole ones.
    pub(super) fn battery_s(&self, now: Stamp) -> i64 {
        self.class.battery_s.map_or(ENDLESS_BATTERY_S, |life| {
            let left = life - (now - self.spawned).seconds();
            left.max(0.0) as i64
        })
    }

    pub(super) fn powered(&self, now: Stamp) -> bool {
        self.class.battery_s.is_none_or(|life| (now - self.spawned).seconds() < life)
    }

    /// Takes a DRIVE command.
    pub(super) fn drive(&mut self, command: &Drive, now: Stamp) {
        match self.dialect {
            // UDK remembers the flag; UT2004 takes it for one command.
            Dialect::Udk => self.normalized = command.normalized.unwrap_or(self.normalized),
            Dialect::Ut2004 => self.normalized = command.normalized.unwrap_or(false),
        }
        if let Some(light) = command.light {
            self.light = light;
        }
        if command.flip == Some(true) && self.dialect == Dialect::Ut2004 {
            self.flip_until = Some(now + FLIP);
        }
        match &command.form {
            DriveForm::Skid { left, right } => self.skid([*left, *right]),
            DriveForm::Joint { name, order, value, .. } if self.dialect == Dialect::Ut2004 => {
                self.order_wheel(name, order.unwrap_or_default(), value.unwrap_or(0.0));
            }
            _ => {}
        }
        self.vehicle.drive(self.spin_rps);
    }

    fn skid(&mut self, sides: [Option<f64>; 2]) {
        // UDK ignores a line that lacks a side.
        if self.dialect == Dialect::Udk && sides.contains(&None) {
            return;
        }
        let most = self.class.wheels.max_spin_rps;
        for (spin, side) in self.spin_rps.iter_mut().zip(sides) {
            if let Some(value) = side.filter(|value| value.is_finite()) {
                let wanted = if self.normalized { value / 100.0 * most } else { value };
                *spin = wanted.clamp(-most, most);
            }
        }
    }

    /// One wheel joint by name moves its side: the wheels of a side turn alike. Says whether the robot
    /// has that wheel and it takes that order.
    pub(super) fn order_wheel(&mut self, name: &str, order: Order, value: f64) -> bool {
        let wheels: &[&str] = match self.class.wheels.layout {
            Layout::FourWheels => &["FWheel", "RWheel"],
            Layout::TwoWheelsAndCaster => &["Wheel"],
        };
        let of_side = |side: &str| {
            let (start, wheel) = name.split_at_checked(side.len()).unwrap_or_default();
            start.eq_ignore_ascii_case(side)
                && wheels.iter().any(|own| own.eq_ignore_ascii_case(wheel))
        };
        let Some(side) = ["Left", "Right"].into_iter().position(of_side) else { return false };
        let spin = match order {
            Order::Velocity => value,
            Order::RelVelocity => self.spin_rps[side] + value,
            Order::Brake => 0.0,
            _ => return false,
        };
        if spin.is_finite() {
            let most = self.class.wheels.max_spin_rps;
            self.spin_rps[side] = spin.clamp(-most, most);
            self.vehicle.drive(self.spin_rps);
        }
        true
    }

    /// Takes an order for one link, counted from 1, of the unit of that name.
    pub(super) fn order_link(&mut self, unit: &str, link: i64, order: Order, value: f64) {
        let Some(unit) = self.units.iter_mut().find(|own| own.name.eq_ignore_ascii_case(unit))
        else {
            return;
        };
        let torque = unit.torque;
        let joint = usize::try_from(link - 1).ok().and_then(|index| unit.joints.get_mut(index));
        if let Some(joint) = joint.filter(|_| value.is_finite()) {
            joint.order(order, value, torque);
        }
    }

    /// Takes a MISPKG command; UDK accepts it with order 0 only.
    pub(super) fn package(&mut self, command: &MisPkg) {
        match &command.form {
            MisPkgForm::Links(links) => {
                for link in links {
                    let order = link.order.unwrap_or_default();
                    if self.dialect == Dialect::Ut2004 || order == Order::Angle {
                        self.order_link(&command.name, link.link, order, link.value);
                    }
                }
            }
            MisPkgForm::Rotation { rotation: [_, pan, tilt], order } => {
                // The 2.x form is 0,pan,tilt and counts pan positive to the right.
                let order = order.unwrap_or_default();
                self.order_link(&command.name, 1, order, -pan);
                self.order_link(&command.name, 2, order, *tilt);
            }
        }
    }

    /// Work before a physics step.
    pub(super) fn before_step(&mut self, physics: &mut Physics, world: &World) {
        self.vehicle.before_step(physics, world);
    }

    /// Work after a physics step.
    pub(super) fn after_step(&mut self, physics: &Physics, world: &World, now: Stamp) {
        self.vehicle.after_step(physics);
        for unit in &mut self.units {
            unit.step(STEP_S);
        }
        self.score.step(self.vehicle.state(), world, now);
    }

    /// Lets faults act inside, and what else happens at a tick besides talking.
    pub(super) fn tick(&mut self, inside: Inside, physics: &mut Physics, now: Stamp) {
        for unit in &mut self.units {
            let stuck = inside
                .tilt_stuck
                .iter()
                .any(|what| what.is_empty() || what.eq_ignore_ascii_case(&unit.name));
            unit.joints[1].jam(stuck);
            if inside.tilt_bound_rad != self.inside.tilt_bound_rad {
                unit.joints[1].narrow(inside.tilt_bound_rad);
            }
        }
        self.vehicle.jam(inside.jammed);
        self.inside = inside;
        if self.flip_until.is_some_and(|until| now >= until) {
            self.flip_until = None;
            self.put_upright(physics);
        }
        if self.dialect == Dialect::Ut2004 && !self.powered(now) {
            self.spin_rps = [0.0; 2];
            self.vehicle.drive(self.spin_rps);
        }
    }

    fn put_upright(&mut self, physics: &mut Physics) {
        let place = self.vehicle.state().world_from_robot;
        let ahead = place.rotation * Vector3::x();
        let level = UnitQuaternion::from_euler_angles(0.0, 0.0, ahead.y.atan2(ahead.x));
        let lifted = place.translation.vector + Vector3::z() * self.class.origin_height_m();
        self.vehicle.place(physics, &Isometry3::from_parts(lifted.into(), level));
    }

    /// Pushes the body towards one of its sides.
    pub(super) fn shove(&mut self, physics: &mut Physics, towards: &str, speed_mps: f64) {
        let direction = match towards {
            "forward" => Vector3::x(),
            "back" => -Vector3::x(),
            "right" => -Vector3::y(),
            _ => Vector3::y(),
        };
        let world = self.vehicle.state().world_from_robot.rotation * direction;
        self.vehicle.shove(physics, &(world * speed_mps));
    }

    /// Whether the status is due; UT2004 sends its whole burst then.
    pub(super) fn status_due(&mut self, now: Stamp) -> bool {
        self.status.fires(now)
    }

    /// UT2004: the stamp of the lines to cast now, if casting is due.
    pub(super) fn scan_due(&mut self, now: Stamp) -> Option<Stamp> {
        let (due, stamp) = self.scan_due?;
        if now < due {
            return None;
        }
        self.scan_due = None;
        Some(stamp)
    }

    /// UT2004: a burst went out at `now`; its stamp is that of the next line.
    pub(super) fn burst_sent(&mut self, now: Stamp, stamp: Stamp, interval_s: f64) {
        let lag = SCAN_LAG.min(Span::from_seconds(interval_s / 2.0));
        self.scan_due = Some((now + lag, stamp));
    }

    /// The state of the body, as STA.
    pub(super) fn status(&self, now: Stamp, stamp: Stamp) -> Message {
        let udk = self.dialect == Dialect::Udk;
        let light_intensity = if udk || self.light { 100 } else { 0 };
        Message::Sta(Sta {
            vehicle_type: Some("GroundVehicle".to_owned()),
            time: Some(stamp),
            battery_s: Some(self.battery_s(now)),
            front_steer_rad: Some(0.0),
            rear_steer_rad: Some(0.0),
            joints: Vec::new(),
            light_on: Some(self.light),
            light_intensity: Some(light_intensity),
            view: (!udk).then_some(self.view),
            extra: Vec::new(),
        })
    }

    /// The state of the units that report theirs, as MISSTA or ASTA.
    pub(super) fn unit_status(&self, stamp: Stamp) -> Vec<Message> {
        self.units
            .iter()
            .filter(|unit| unit.reports)
            .map(|unit| {
                let links = |values: [f64; 2], torque: Option<f64>| {
                    (1_i64..)
                        .zip(values)
                        .map(|(link, value)| LinkState { link, value, torque })
                        .collect()
                };
                let (time, name) = (Some(stamp), unit.name.clone());
                match self.dialect {
                    Dialect::Ut2004 => Message::MisSta(MisSta {
                        time,
                        name,
                        links: links(unit.reported_rad(), Some(-unit.torque)),
                        extra: Vec::new(),
                    }),
                    Dialect::Udk => {
                        let values =
                            [0, 1].map(|index: usize| wire::round(unit.joints[index].angle_rad, 4));
                        let links = links(values, None);
                        Message::AsTa(AsTa { time, name, links, extra: Vec::new() })
                    }
                }
            })
            .collect()
    }

    fn angles(&self) -> [f64; 2] {
        self.units.first().map_or([0.0; 2], PanTilt::true_angles_rad)
    }

    /// Notes where the scanners stood when they cast.
    pub(super) fn note_casts(&mut self, printed: Stamp, now: Stamp) {
        let [pan_rad, tilt_rad] = self.angles();
        let carrier = self.carrier();
        let casts: Vec<CastTruth> = self
            .suite
            .items
            .iter()
            .filter_map(|item| match &item.device {
                Device::Scanner(scanner) => Some(CastTruth {
                    scanner: scanner.mounting.name.clone(),
                    printed,
                    cast_at: now,
                    world_from_sensor: carrier.world_from_sensor(&scanner.mounting),
                    pan_rad,
                    tilt_rad,
                }),
                _ => None,
            })
            .collect();
        self.casts.extend(casts);
        while self.casts.len() > MOST_CASTS {
            self.casts.pop_front();
        }
    }

    /// The truth about the robot.
    pub(super) fn truth(&self, now: Stamp) -> Truth {
        let state = self.vehicle.state();
        let [pan_rad, tilt_rad] = self.angles();
        let score = &self.score;
        Truth {
            name: self.name.clone(),
            class: self.class.class.clone(),
            stamp: now,
            printed: self.stamp(now),
            world_from_robot: state.world_from_robot,
            speed_mps: state.velocity_mps.norm(),
            angular_rps: state.angular_rps,
            pan_rad,
            tilt_rad,
            distance_m: score.distance_m,
            toppled: score.toppled,
            falls: score.falls,
            collisions: score.collisions,
            worst_collision_mps: score.worst_collision_mps,
            portals: score.portals.clone(),
            victim_contacts: score.victim_contacts.clone(),
        }
    }
}
