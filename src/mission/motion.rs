//! From wheel and inertial readings to one increment of motion at a time.

use super::grip::{Grip, SweptTurn};
use super::inertial_way::InertialWay;
use super::leaps::Leaps;
use super::level::LevelDrift;
use crate::geometry::wrap_pi;
use crate::mapping::{MotionSource, tilted_increment};
use crate::robot::{InertialPlace, InsReading, OdometryReading};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A planar pose: x and y in metres, heading in radians, left positive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PlanarPose {
    /// Along the first heading.
    pub x_m: f64,
    /// To its left.
    pub y_m: f64,
    /// Heading.
    pub heading_rad: f64,
}

impl From<&OdometryReading> for PlanarPose {
    fn from(reading: &OdometryReading) -> Self {
        let place = &reading.odom_from_robot;
        let [x_m, y_m] = [place.translation.x, place.translation.y];
        Self { x_m, y_m, heading_rad: place.rotation.angle() }
    }
}

/// Attitude of the body as an inertial unit gives it: roll, pitch and heading of `Rz Ry Rx`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyAttitude {
    /// About x, right side down positive.
    pub roll_rad: f64,
    /// About y, nose down positive.
    pub pitch_rad: f64,
    /// About z, left positive.
    pub heading_rad: f64,
}

impl BodyAttitude {
    fn rotation(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_euler_angles(self.roll_rad, self.pitch_rad, self.heading_rad)
    }
}

impl From<&InsReading> for BodyAttitude {
    fn from(reading: &InsReading) -> Self {
        let InsReading { roll_rad, pitch_rad, yaw_rad, .. } = *reading;
        Self { roll_rad, pitch_rad, heading_rad: yaw_rad }
    }
}

/// Joins wheel odometry and an inertial unit's readings into increments.
///
/// The inertial unit says how much the robot turned: skid-steered wheels count a turn that the ground gives
/// them only in part. It also says how far the robot went, if it tells places; else the wheels do. Without an
/// inertial unit the wheels say both; where wheels are missing there is no increment at all.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionTracker {
    wheels: Option<PlanarPose>,
    attitude: Option<BodyAttitude>,
    /// Attitude at the time of `wheels`.
    attitude_at_wheels: Option<BodyAttitude>,
    /// What both are off by.
    drift: LevelDrift,
    wheel_leaps: Leaps<PlanarPose>,
    attitude_leaps: Leaps<BodyAttitude>,
    /// Readings of the wheels since an attitude was read, and how far they turned from the first of them on.
    silent: u32,
    unheard_rad: f64,
    grip: Grip,
    swept: SweptTurn,
    way: InertialWay,
    /// The increments so far put together, and whether an inertial unit had a part in the last.
    reckoned: Isometry3<f64>,
    is_inertial: bool,
}

/// A robot drives no farther than this between two readings of its wheels, unless some were lost; nor does it
/// lean or turn by more.
const LEAP_M: f64 = 2.0;
const LEAP_RAD: f64 = 1.0;
/// Readings of the wheels after which an inertial unit that says nothing more knows nothing of turns.
const SILENT: u32 = 12;
/// Over more than this no readings are lost: the wheels are counted from elsewhere.
const RESTARTED_M: f64 = 20.0;

impl MotionTracker {
    /// Takes in an attitude reading.
    pub fn attitude(&mut self, attitude: BodyAttitude) {
        let is_near = |a: &BodyAttitude, b: &BodyAttitude| {
            [b.roll_rad - a.roll_rad, b.pitch_rad - a.pitch_rad, b.heading_rad - a.heading_rad]
                .iter()
                .all(|turn| wrap_pi(*turn).abs() <= LEAP_RAD)
        };
        if self.attitude_leaps.believes(self.attitude.as_ref(), &attitude, is_near) {
            self.drift.note(attitude);
            self.attitude = Some(attitude);
            self.silent = 0;
        }
    }

    /// Takes in a place that an inertial unit tells.
    pub fn place(&mut self, place: InertialPlace) {
        self.way.place(place);
    }

    /// The last attitude read, without what the unit is known to be off by; `None` of a unit that has fallen
    /// silent.
    pub fn last_attitude(&self) -> Option<BodyAttitude> {
        self.attitude.map(|read| self.drift.corrected(&read))
    }

    /// Standard deviation that has been added to its roll and pitch since the unit's error was told, of
    /// whose steps each errs by `step_share`, in radians.
    pub fn level_sigma_rad(&self, step_share: f64) -> f64 {
        self.drift.sigma_rad(step_share)
    }

    /// Takes in the attitude at the last reading as a sweep tells it, roll and pitch to `sigma_rad`.
    pub fn settle_attitude(&mut self, known: &BodyAttitude, sigma_rad: f64) {
        if let Some(read) = self.attitude {
            self.way.settle(known.heading_rad, read.heading_rad);
        }
        self.drift.settle(known, sigma_rad);
    }

    /// Whether an inertial unit tells of turns, or it is known how much of them the wheels make.
    pub fn knows_turns(&self) -> bool {
        self.attitude.is_some() || self.grip.is_proven()
    }

    /// Takes in the heading at the last reading as a sweep tells it, `None` if it tells none, and whether many
    /// surfaces do.
    pub fn settle_heading(&mut self, told_rad: Option<f64>, many_tell: bool) {
        self.swept.settle(told_rad, many_tell, &mut self.grip);
    }

    /// The same on the way between two sweeps, once the robot has turned far enough since the first for it to tell.
    pub fn settle_heading_on_way(&mut self, told_rad: f64) {
        if self.swept.is_telling() {
            self.swept.settle(Some(told_rad), true, &mut self.grip);
        }
    }

    /// Takes in a wheel odometry pose; gives the robot's pose now in its own frame at the reading
    /// before, and what measured it. `None` for the first reading, which is only the origin, and for
    /// one that leaps, until the next is near it.
    pub fn wheels(&mut self, wheels: PlanarPose) -> Option<(Isometry3<f64>, MotionSource)> {
        let (increment, source) = self.increment(wheels)?;
        self.reckoned *= increment;
        self.reckoned.rotation.renormalize();
        self.is_inertial = source.is_inertial();
        Some((increment, source))
    }

    /// Dead reckoning from the first reading on, which no sweep corrects, so that it never jumps. `None` where
    /// it is the wheels' alone; else the turn is an inertial unit's, and the way if that tells places.
    pub fn reckoned(&self) -> Option<&Isometry3<f64>> {
        self.is_inertial.then_some(&self.reckoned)
    }

    fn increment(&mut self, wheels: PlanarPose) -> Option<(Isometry3<f64>, MotionSource)> {
        let apart_m = |a: &PlanarPose, b: &PlanarPose| (b.x_m - a.x_m).hypot(b.y_m - a.y_m);
        let is_near = |a: &PlanarPose, b: &PlanarPose| apart_m(a, b) <= LEAP_M;
        if !self.wheel_leaps.believes(self.wheels.as_ref(), &wheels, is_near) {
            return None;
        }
        let before = self.wheels.replace(wheels);
        let before = before.filter(|before| apart_m(before, &wheels) <= RESTARTED_M);
        let mut attitude_before = std::mem::replace(&mut self.attitude_at_wheels, self.attitude);
        let before = before?;
        let mut wheel_turn = wrap_pi(wheels.heading_rad - before.heading_rad);
        // The chord of the arc the wheels drove, seen from half way through the turn.
        let (sin, cos) = (before.heading_rad + 0.5 * wheel_turn).sin_cos();
        let (dx, dy) = (wheels.x_m - before.x_m, wheels.y_m - before.y_m);
        let (along, across) = (cos * dx + sin * dy, cos * dy - sin * dx);
        self.silent = self.silent.saturating_add(1);
        let unheard = std::mem::take(&mut self.unheard_rad);
        if (2..=SILENT).contains(&self.silent) {
            self.unheard_rad = unheard + wheel_turn;
        } else if self.silent > SILENT && self.attitude.take().is_some() {
            // Lost: what was taken for standing was turning that nobody told.
            wheel_turn += unheard;
            (self.attitude_at_wheels, attitude_before) = (None, None);
        }
        let (turn, level_before, level_after, source) = match (attitude_before, self.attitude) {
            (Some(a), Some(b)) => {
                let [a, b] = [a, b].map(|read| self.drift.corrected(&read));
                let (before, after) = ((a.roll_rad, a.pitch_rad), (b.roll_rad, b.pitch_rad));
                let turn = wrap_pi(b.heading_rad - a.heading_rad);
                if self.silent == 1 {
                    self.grip.learn(unheard + wheel_turn, turn);
                }
                (turn, before, after, MotionSource::InertialTurn)
            }
            _ => {
                let source = if self.grip.is_proven() {
                    MotionSource::Wheels
                } else {
                    MotionSource::UnprovenWheels
                };
                (wheel_turn * self.grip.share(), (0.0, 0.0), (0.0, 0.0), source)
            }
        };
        if source.is_inertial() {
            self.swept.forget();
        } else {
            self.swept.add(wheel_turn);
        }
        let (sin, cos) = (0.5 * turn).sin_cos();
        let mut increment = tilted_increment(
            cos * along - sin * across,
            sin * along + cos * across,
            turn,
            level_before,
            level_after,
        );
        let Some(attitude) = attitude_before.filter(|_| source == MotionSource::InertialTurn)
        else {
            return Some((increment, source));
        };
        let map_from_before = self.drift.corrected(&attitude).rotation();
        let by_wheels = map_from_before * increment.translation.vector;
        let Some(way) = self.way.way(by_wheels.xy()) else { return Some((increment, source)) };
        // It climbs with the way that it goes, not with that of wheels that spin on a kerb.
        let level_m2 = by_wheels.xy().norm_squared();
        let share = if level_m2 > 0.0 { way.dot(&by_wheels.xy()) / level_m2 } else { 1.0 };
        increment.translation.vector =
            map_from_before.inverse() * Vector3::new(way.x, way.y, share * by_wheels.z);
        Some((increment, MotionSource::Inertial))
    }

    /// Forgets the last wheel reading: after a reconnect the odometry of a new robot starts at zero.
    pub fn restart_wheels(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> PlanarPose {
        PlanarPose { x_m, y_m, heading_rad }
    }

    #[test]
    fn wheels_alone_reproduce_their_own_pose() {
        let mut tracker = MotionTracker::default();
        let mut world = Isometry3::identity();
        let (mut x, mut y, mut heading) = (0.0_f64, 0.0_f64, 0.3_f64);
        tracker.wheels(pose(x, y, heading));
        for _ in 0..200 {
            let turn = 0.02;
            x += 0.05 * (heading + 0.5 * turn).cos();
            y += 0.05 * (heading + 0.5 * turn).sin();
            heading += turn;
            let (increment, source) = tracker.wheels(pose(x, y, wrap_pi(heading))).unwrap();
            assert_eq!(source, MotionSource::UnprovenWheels);
            world *= increment;
        }
        let expected = nalgebra::Rotation2::new(-0.3) * nalgebra::Vector2::new(x, y);
        assert!((world.translation.vector.xy() - expected).norm() < 1e-9);
    }

    #[test]
    fn the_inertial_heading_overrules_slipping_wheels() {
        let mut tracker = MotionTracker::default();
        tracker.attitude(BodyAttitude::default());
        tracker.wheels(pose(0.0, 0.0, 0.0));
        tracker.attitude(BodyAttitude { heading_rad: 0.5, ..Default::default() });
        let (increment, source) = tracker.wheels(pose(0.0, 0.0, FRAC_PI_2)).unwrap();
        assert_eq!(source, MotionSource::InertialTurn);
        assert!((increment.rotation.euler_angles().2 - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_unit_that_falls_silent_leaves_turns_to_the_wheels_and_comes_back() {
        let mut tracker = MotionTracker::default();
        let mut turned_rad = 0.0;
        for step in 0..90 {
            let heading_rad = 0.05 * f64::from(step);
            // It is lost after the tenth reading, and back, counted from elsewhere, after the sixtieth.
            if !(10..60).contains(&step) {
                let from_rad = if step < 10 { 0.0 } else { 2.0 };
                let heading_rad = wrap_pi(from_rad + heading_rad);
                tracker.attitude(BodyAttitude { heading_rad, pitch_rad: 0.1, roll_rad: 0.0 });
            }
            assert_eq!(tracker.last_attitude().is_some(), !(22..60).contains(&step), "{step}");
            let wheels = pose(0.0, 0.0, wrap_pi(heading_rad));
            if let Some((increment, _)) = tracker.wheels(wheels) {
                turned_rad += increment.rotation.euler_angles().2;
            }
        }
        assert!((turned_rad - 0.05 * 89.0).abs() < 0.02, "{turned_rad}");
    }

    #[test]
    fn wheels_that_turn_more_than_the_robot_are_found_out_while_a_unit_tells() {
        // A unit that tells as often as the wheels, and one that tells at every third reading of theirs.
        for every in [1, 3] {
            wheels_are_found_out(every);
        }
    }

    fn wheels_are_found_out(every: i32) {
        let mut tracker = MotionTracker::default();
        let (mut turned_rad, mut lost_rad) = (0.0, 0.0);
        for step in 0..120 {
            let heading_rad = 0.03 * f64::from(step);
            if step <= 78 && step % every == 0 {
                tracker.attitude(BodyAttitude { heading_rad, ..BodyAttitude::default() });
            }
            let Some((increment, source)) =
                tracker.wheels(pose(0.0, 0.0, wrap_pi(heading_rad / 0.6)))
            else {
                continue;
            };
            turned_rad += increment.rotation.euler_angles().2;
            if source == MotionSource::Wheels {
                lost_rad += increment.rotation.euler_angles().2;
            }
        }
        assert!(lost_rad > 0.5, "{lost_rad}");
        assert!((turned_rad - 0.03 * 119.0).abs() < 0.03, "{turned_rad}");
    }

    #[test]
    fn wheels_that_spin_on_a_kerb_climb_nothing() {
        // Up a ramp of 0.2 rad, the wheels counting a fifth too much, and then against a kerb.
        let ramp = BodyAttitude { pitch_rad: -0.2, ..Default::default() };
        let mut tracker = MotionTracker::default();
        tracker.attitude(ramp);
        tracker.settle_attitude(&ramp, 0.001);
        let mut world = ramp.rotation() * Isometry3::identity();
        let (mut wheels_m, mut climbed_m) = (0.0, 0.0);
        for step in 0..=200 {
            let way_m = 0.04 * f64::from(step.min(50));
            let cut = |metres: f64| (100.0 * metres).round() / 100.0;
            tracker.attitude(ramp);
            tracker.place(InertialPlace::new(cut(way_m * 0.2_f64.cos()), 0.0, 0.4));
            wheels_m += 1.2 * 0.04;
            if let Some((increment, _)) = tracker.wheels(pose(wheels_m, 0.0, 0.0)) {
                world *= increment;
            }
            if step == 50 {
                climbed_m = world.translation.vector.z;
                assert!((climbed_m - 2.0 * 0.2_f64.sin()).abs() < 0.05, "{climbed_m}");
            }
        }
        let more_m = world.translation.vector.z - climbed_m;
        assert!(more_m.abs() < 0.005, "{more_m} m higher by 7 m of spinning wheels");
    }

    #[test]
    fn an_inertial_units_places_overrule_slipping_wheels() {
        let mut tracker = MotionTracker::default();
        let mut world = Isometry3::identity();
        // The unit heads 0.3 rad left of the map; the robot drives 2 m straight ahead of itself, turned by
        // 0.5 rad in the map, and the wheels count a fifth too much.
        let heading = BodyAttitude { heading_rad: 0.8, ..Default::default() };
        tracker.attitude(heading);
        tracker.settle_attitude(&BodyAttitude { heading_rad: 0.5, ..heading }, 0.001);
        let mut last = MotionSource::Wheels;
        for step in 0..=50 {
            let way_m = 0.04 * f64::from(step);
            let cut = |metres: f64| (100.0 * metres).round() / 100.0;
            let (sin, cos) = 0.8_f64.sin_cos();
            tracker.attitude(heading);
            tracker.place(InertialPlace::new(cut(3.0 + way_m * cos), cut(way_m * sin), 0.4));
            if let Some((increment, source)) = tracker.wheels(pose(1.2 * way_m, 0.0, 0.0)) {
                world *= increment;
                last = source;
            }
        }
        assert_eq!(last, MotionSource::Inertial);
        // The first of it, until the unit was seen to go where the wheels go, is the wheels' own.
        assert!((world.translation.vector.x - 2.0).abs() < 0.02, "{}", world.translation.vector);
        assert!(world.translation.vector.y.abs() < 0.02, "{}", world.translation.vector);
    }

    #[test]
    fn a_garbled_reading_moves_nothing() {
        let mut tracker = MotionTracker::default();
        tracker.attitude(BodyAttitude::default());
        tracker.wheels(pose(0.0, 0.0, 0.0));
        assert_eq!(tracker.wheels(pose(9.3e6, 0.0, 0.0)), None);
        tracker.attitude(BodyAttitude { roll_rad: 2.8, ..BodyAttitude::default() });
        let (increment, _) = tracker.wheels(pose(0.1, 0.0, 0.0)).unwrap();
        assert!((increment.translation.vector.norm() - 0.1).abs() < 1e-9);
        assert_eq!(tracker.last_attitude(), Some(BodyAttitude::default()));
        // Twice the same is no garbled digit, but no way that a robot drove either.
        tracker.wheels(pose(9.3e6, 0.0, 0.0));
        assert_eq!(tracker.wheels(pose(9.3e6, 0.1, 0.0)), None);
        assert!(tracker.wheels(pose(9.3e6, 0.2, 0.0)).is_some());
    }

    #[test]
    fn driving_up_a_slope_gains_height() {
        let mut tracker = MotionTracker::default();
        let nose_up = BodyAttitude { pitch_rad: -0.3, ..Default::default() };
        tracker.attitude(nose_up);
        tracker.wheels(pose(0.0, 0.0, 0.0));
        tracker.attitude(nose_up);
        let (increment, _) = tracker.wheels(pose(1.0, 0.0, 0.0)).unwrap();
        let world = nalgebra::UnitQuaternion::from_euler_angles(0.0, -0.3, 0.0)
            * increment.translation.vector;
        assert!((world.z - 0.3_f64.sin()).abs() < 1e-9);
    }
}
