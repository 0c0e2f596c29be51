//! Pan-tilt units: how their joints move and where they carry what is mounted on them.

use super::spec::PanTiltSpec;
use super::wire;
use crate::protocol::Dialect;
use crate::protocol::command::Order;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Inside this gap a UT2004 hinge slows down in proportion to it: 364 Unreal units.
const PROPORTIONAL_GAP_RAD: f64 = 364.0 * std::f64::consts::TAU / 65_536.0;

/// Steps of the spring's integration per physics step.
const SPRING_SUBSTEPS: usize = 5;

/// What a joint is told to do.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Drive {
    /// To an angle, in radians.
    Angle(f64),
    /// At a speed in rad/s until told otherwise or at the limit.
    Velocity(f64),
    /// Stays where it is.
    Brake,
}

/// How a joint gets to its set-point.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Law {
    /// UT2004: constant speed, proportional to the gap inside the last 2.0°.
    Servo { speed_rps: f64 },
    /// UDK: a damped spring without a speed limit.
    Spring { omega_rps: f64, damping: f64, velocity_rps: f64 },
}

/// One revolute joint; angles are the wire's: pan positive left, tilt positive up.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Joint {
    pub(crate) angle_rad: f64,
    /// As configured, for CONF; the first greater than the second means none.
    pub(crate) range_rad: [f64; 2],
    limits_rad: Option<[f64; 2]>,
    pub(crate) top_speed_rps: f64,
    law: Law,
    drive: Drive,
    stuck: bool,
}

impl Joint {
    fn new(range_rad: [f64; 2], spec: &PanTiltSpec, dialect: Dialect) -> Self {
        let top_speed_rps = spec.speed_rad_s.unwrap_or(0.17);
        let law = match dialect {
            Dialect::Ut2004 => Law::Servo { speed_rps: top_speed_rps },
            Dialect::Udk => Law::Spring {
                omega_rps: std::f64::consts::TAU * spec.spring_hz.unwrap_or(2.0),
                damping: spec.spring_damping.unwrap_or(0.5),
                velocity_rps: 0.0,
            },
        };
        let limits_rad = (range_rad[0] <= range_rad[1]).then_some(range_rad);
        let angle_rad = limits_rad.map_or(0.0, |[least, most]| 0.0_f64.clamp(least, most));
        Self {
            angle_rad,
            range_rad,
            limits_rad,
            top_speed_rps,
            law,
            drive: Drive::Angle(angle_rad),
            stuck: false,
        }
    }

    /// Takes an order of protocol section 4.2; values beyond the limits are clamped silently.
    pub(crate) fn order(&mut self, order: Order, value: f64, max_torque: f64) {
        let speed = match self.drive {
            Drive::Velocity(speed) => speed,
            Drive::Angle(_) | Drive::Brake => 0.0,
        };
        // A torque that nothing opposes brings the hinge to a speed; full torque to the top speed.
        let by_torque = |torque: f64| self.top_speed_rps * (torque / max_torque).clamp(-1.0, 1.0);
        let drive = match order {
            Order::Angle => Drive::Angle(value),
            Order::RelAngle => Drive::Angle(self.angle_rad + value),
            Order::Velocity => Drive::Velocity(value),
            Order::RelVelocity => Drive::Velocity(speed + value),
            Order::Torque => Drive::Velocity(by_torque(value)),
            Order::RelTorque => Drive::Velocity(speed + by_torque(value)),
            Order::Brake => Drive::Brake,
            Order::Other(_) => return,
        };
        self.drive = match drive {
            Drive::Angle(angle) => Drive::Angle(self.clamped(angle)),
            Drive::Velocity(speed) => {
                Drive::Velocity(speed.clamp(-self.top_speed_rps, self.top_speed_rps))
            }
            Drive::Brake => Drive::Brake,
        };
    }

    fn clamped(&self, angle_rad: f64) -> f64 {
        self.limits_rad.map_or(angle_rad, |[least, most]| angle_rad.clamp(least, most))
    }

    /// Holds the joint where it is, or frees it.
    pub(crate) fn jam(&mut self, stuck: bool) {
        self.stuck = stuck;
    }

    /// Narrows the limits to ± `bound_rad`, or gives the configured ones back.
    pub(crate) fn narrow(&mut self, bound_rad: Option<f64>) {
        let [least, most] = self.range_rad;
        let own = (least <= most).then_some(self.range_rad);
        self.limits_rad = match (bound_rad, own) {
            (Some(bound), Some([least, most])) => Some([least.max(-bound), most.min(bound)]),
            (Some(bound), None) => Some([-bound, bound]),
            (None, own) => own,
        };
        if let Drive::Angle(target) = self.drive {
            self.drive = Drive::Angle(self.clamped(target));
        }
    }

    /// Moves on by `dt_s`.
    pub(crate) fn step(&mut self, dt_s: f64) {
        if self.stuck {
            return;
        }
        let aim = match self.drive {
            Drive::Angle(target) => Some(target),
            Drive::Velocity(_) => None,
            Drive::Brake => Some(self.angle_rad),
        };
        let angle = match (self.drive, &mut self.law) {
            (Drive::Velocity(speed), _) => self.angle_rad + speed * dt_s,
            (_, Law::Servo { speed_rps }) => {
                servo_step(self.angle_rad, aim.unwrap_or(self.angle_rad), *speed_rps, dt_s)
            }
            (_, Law::Spring { omega_rps, damping, velocity_rps }) => {
                let target = aim.unwrap_or(self.angle_rad);
                let (mut angle, h) = (self.angle_rad, dt_s / SPRING_SUBSTEPS as f64);
                for _ in 0..SPRING_SUBSTEPS {
                    let pull = *omega_rps * *omega_rps * (target - angle);
                    *velocity_rps += h * (pull - 2.0 * *damping * *omega_rps * *velocity_rps);
                    angle += h * *velocity_rps;
                }
                angle
            }
        };
        let clamped = self.clamped(angle);
        if clamped != angle
            && let Law::Spring { velocity_rps, .. } = &mut self.law
        {
            *velocity_rps = 0.0;
        }
        self.angle_rad = clamped;
    }
}

/// The angle after `dt_s` of protocol section 6.3: full speed down to the proportional gap, then
/// decay with the time constant gap ÷ speed, both in closed form.
fn servo_step(angle_rad: f64, target_rad: f64, speed_rps: f64, dt_s: f64) -> f64 {
    let gap = target_rad - angle_rad;
    let beyond = (gap.abs() - PROPORTIONAL_GAP_RAD).max(0.0);
    let fast_s = (beyond / speed_rps).min(dt_s);
    let left = gap - (speed_rps * fast_s).copysign(gap);
    if left == 0.0 {
        return target_rad;
    }
    let decay = (-(dt_s - fast_s) * speed_rps / PROPORTIONAL_GAP_RAD).exp();
    target_rad - left * decay
}

/// A pan-tilt unit of a robot.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PanTilt {
    pub(crate) name: String,
    pub(crate) position: Vector3<f64>,
    pub(crate) tilt_offset: Vector3<f64>,
    /// 1, or -1 for a joint that turns against the wire's sign: pan, then tilt.
    senses: [f64; 2],
    /// Pan, then tilt.
    pub(crate) joints: [Joint; 2],
    pub(crate) torque: f64,
    pub(crate) reports: bool,
}

impl PanTilt {
    pub(crate) fn new(spec: &PanTiltSpec, dialect: Dialect) -> Self {
        const FREE: [f64; 2] = [1.0, 0.0];
        Self {
            name: spec.name.clone(),
            position: spec.position.unwrap_or([0.0, 0.0, 0.2]).into(),
            tilt_offset: spec.tilt_offset.unwrap_or([0.0, 0.0, 0.06]).into(),
            senses: [spec.pan_inverted, spec.tilt_inverted]
                .map(|inverted| if inverted == Some(true) { -1.0 } else { 1.0 }),
            joints: [spec.pan_limits_rad, spec.tilt_limits_rad]
                .map(|range| Joint::new(range.unwrap_or(FREE), spec, dialect)),
            torque: spec.torque.unwrap_or(20.0),
            reports: spec.status.unwrap_or(true),
        }
    }

    pub(crate) fn step(&mut self, dt_s: f64) {
        for joint in &mut self.joints {
            joint.step(dt_s);
        }
    }

    /// True angles in the core's sense: pan positive left, tilt positive down.
    pub(crate) fn true_angles_rad(&self) -> [f64; 2] {
        let [pan, tilt] = [0, 1].map(|joint| self.senses[joint] * self.joints[joint].angle_rad);
        [pan, -tilt]
    }

    /// The frame of link 0 (pan) or 1 (tilt), parallel to the body at zero angles.
    pub(crate) fn robot_from_link(&self, link: usize) -> Isometry3<f64> {
        let [pan_rad, tilt_rad] = self.true_angles_rad();
        let pan = UnitQuaternion::from_euler_angles(0.0, 0.0, pan_rad);
        let robot_from_pan = Isometry3::from_parts(Translation3::from(self.position), pan);
        if link == 0 {
            return robot_from_pan;
        }
        let tilt = UnitQuaternion::from_euler_angles(0.0, tilt_rad, 0.0);
        robot_from_pan * Isometry3::from_parts(Translation3::from(self.tilt_offset), tilt)
    }

    /// Angles as the unit reports them: cut to 1/65536 of a turn, then to 4 decimals.
    pub(crate) fn reported_rad(&self) -> [f64; 2] {
        [wire::angle(self.joints[0].angle_rad), wire::angle(self.joints[1].angle_rad)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn unit(dialect: Dialect) -> PanTilt {
        let spec = PanTiltSpec {
            name: "P".to_owned(),
            tilt_limits_rad: Some([-0.5, 0.4]),
            speed_rad_s: Some(0.17),
            torque: Some(20.0),
            ..PanTiltSpec::default()
        };
        PanTilt::new(&spec, dialect)
    }

    fn after(joint: &mut Joint, seconds: f64) -> f64 {
        for _ in 0..(seconds / 0.005).round() as usize {
            joint.step(0.005);
        }
        joint.angle_rad
    }

    #[test]
    fn a_quarter_degree_takes_what_the_protocol_document_says() {
        let mut joint = unit(Dialect::Ut2004).joints[1].clone();
        let step = 0.25_f64.to_radians();
        joint.order(Order::Angle, step, 20.0);
        // 10 % of the error is left after 0.47 s, 5 % after 0.62 s (section 6.3).
        assert!((1.0 - after(&mut joint, 0.47) / step - 0.10).abs() < 0.003);
        assert!((1.0 - after(&mut joint, 0.15) / step - 0.05).abs() < 0.003);
    }

    #[test]
    fn large_moves_run_at_full_speed() {
        let mut joint = unit(Dialect::Ut2004).joints[1].clone();
        joint.order(Order::Angle, 0.4, 20.0);
        assert!((after(&mut joint, 1.0) - 0.17).abs() < 1e-9);
        assert!((after(&mut joint, 5.0) - 0.4).abs() < 1e-6);
    }

    #[test]
    fn set_points_beyond_the_limits_are_clamped() {
        let mut joint = unit(Dialect::Ut2004).joints[1].clone();
        joint.order(Order::Angle, -9.0, 20.0);
        assert!((after(&mut joint, 9.0) + 0.5).abs() < 1e-6);
        joint.order(Order::Velocity, 0.1, 20.0);
        assert!((after(&mut joint, 2.0) + 0.3).abs() < 1e-6);
        assert_eq!(after(&mut joint, 20.0), 0.4);
    }

    #[test]
    fn speed_orders_run_until_told_to_stop() {
        let mut joint = unit(Dialect::Ut2004).joints[0].clone();
        joint.order(Order::Velocity, 5.0, 20.0);
        assert!((after(&mut joint, 1.0) - 0.17).abs() < 1e-9, "clamped to the top speed");
        joint.order(Order::RelVelocity, -0.07, 20.0);
        assert!((after(&mut joint, 1.0) - 0.27).abs() < 1e-9);
        joint.order(Order::Velocity, 0.0, 20.0);
        let frozen = after(&mut joint, 0.005);
        assert_eq!(after(&mut joint, 1.0), frozen);
        joint.order(Order::RelAngle, 0.05, 20.0);
        assert!((after(&mut joint, 4.0) - frozen - 0.05).abs() < 1e-6);
        joint.order(Order::Torque, -10.0, 20.0);
        let before = joint.angle_rad;
        assert!((after(&mut joint, 1.0) - before + 0.085).abs() < 1e-9, "half torque, half speed");
        joint.order(Order::Brake, 0.0, 20.0);
        let braked = joint.angle_rad;
        assert_eq!(after(&mut joint, 1.0), braked);
    }

    #[test]
    fn a_udk_joint_swings_about_its_set_point_and_settles() {
        let mut joint = unit(Dialect::Udk).joints[1].clone();
        joint.order(Order::Angle, 0.2, 20.0);
        let overshoot = (0..200).map(|_| after(&mut joint, 0.005)).fold(0.0, f64::max);
        assert!(overshoot > 0.21 && overshoot < 0.26, "{overshoot}");
        assert!((after(&mut joint, 4.0) - 0.2).abs() < 1e-4);
    }

    #[test]
    fn tilt_up_raises_what_is_mounted_ahead_and_pan_left_turns_it_left() {
        let mut unit = unit(Dialect::Ut2004);
        unit.joints[1].angle_rad = 0.3;
        let ahead = Point3::new(1.0, 0.0, 0.0);
        assert!((unit.robot_from_link(1) * ahead).z > 0.26 + 0.29);
        unit.joints[0].angle_rad = 0.3;
        assert!((unit.robot_from_link(1) * ahead).y > 0.2);
        assert!((unit.robot_from_link(0) * ahead).y > 0.29);
    }

    #[test]
    fn an_inverted_joint_tells_what_it_is_told_and_turns_the_other_way() {
        let spec = PanTiltSpec {
            name: "P".to_owned(),
            tilt_inverted: Some(true),
            ..PanTiltSpec::default()
        };
        let mut unit = PanTilt::new(&spec, Dialect::Ut2004);
        unit.joints[1].order(Order::Angle, 0.3, 20.0);
        after(&mut unit.joints[1], 5.0);
        assert!((unit.reported_rad()[1] - 0.3).abs() < 1e-3);
        assert!((unit.robot_from_link(1) * Point3::new(1.0, 0.0, 0.0)).z < 0.26 - 0.29);
    }

    #[test]
    fn a_stuck_joint_forgets_no_order() {
        let mut joint = unit(Dialect::Ut2004).joints[1].clone();
        joint.jam(true);
        joint.order(Order::Angle, 0.2, 20.0);
        assert_eq!(after(&mut joint, 2.0), 0.0);
        joint.jam(false);
        assert!((after(&mut joint, 4.0) - 0.2).abs() < 1e-6);
        joint.narrow(Some(0.1));
        assert!(after(&mut joint, 1.0) <= 0.1 + 1e-9);
        joint.narrow(None);
        joint.order(Order::Angle, 0.3, 20.0);
        assert!((after(&mut joint, 4.0) - 0.3).abs() < 1e-5);
    }
}
