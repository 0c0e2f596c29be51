//! `DRIVE` and `MULTIDRIVE`: wheels, tracks, rotors, fins and single joints.

use super::Order;
use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::{NamedValue, Segment, number, text};
use serde::{Deserialize, Serialize};

/// A `DRIVE` line. It holds until the next one: neither dialect has a command time-out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Drive {
    /// What is driven.
    pub form: DriveForm,
    /// Whether speeds are percent of the maximum (-100…100). UT2004: per command, default false.
    /// UDK: sticky for ground robots, so every line should say it.
    pub normalized: Option<bool>,
    /// Headlight on or off.
    pub light: Option<bool>,
    /// UT2004: turns the robot back on its wheels within 3 s.
    pub flip: Option<bool>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

/// The forms of a `DRIVE` line. A key that is absent keeps its value, except that UDK ignores a
/// skid or Ackermann line that lacks one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum DriveForm {
    /// Nothing is driven: light or flip alone.
    #[default]
    None,
    /// `{Left f} {Right f}`: wheel spin in rad/s, positive is forward.
    Skid {
        /// Left wheels.
        left: Option<f64>,
        /// Right wheels.
        right: Option<f64>,
    },
    /// `{Speed f} {FrontSteer f} {RearSteer f}`: wheel spin in rad/s, steering in radians.
    Ackermann {
        /// Wheel spin.
        speed: Option<f64>,
        /// Front angle.
        front_steer: Option<f64>,
        /// Rear angle.
        rear_steer: Option<f64>,
    },
    /// `{AltitudeVelocity f} {LinearVelocity f} {LateralVelocity f} {RotationalVelocity f}`: m/s up,
    /// forward and sideways; UT2004 turns in rad/s, UDK in deg/s clockwise.
    Aerial {
        /// Up.
        altitude: Option<f64>,
        /// Forward.
        linear: Option<f64>,
        /// UDK: right; UT2004: the one client known names it left.
        lateral: Option<f64>,
        /// UDK: clockwise, deg/s.
        rotational: Option<f64>,
        /// UDK: degrees.
        pitch_deg: Option<f64>,
        /// UDK: degrees.
        roll_deg: Option<f64>,
    },
    /// `{Propeller f} {Rudder f} {SternPlane f}` (UT2004).
    Nautic {
        /// Propeller.
        propeller: Option<f64>,
        /// Rudder.
        rudder: Option<f64>,
        /// Stern planes.
        stern_plane: Option<f64>,
    },
    /// `{WheelNumber i} {WheelSpeed f} {WheelSteer f} …` (UT2004).
    Omni(Vec<WheelCommand>),
    /// `{Name joint} [{Steer f}] [{Order i}] [{Value f}]` (UT2004), with a bone and an axis for
    /// humanoids.
    Joint {
        /// The joint, or the humanoid's part.
        name: String,
        /// Humanoids: the bone.
        bone: Option<String>,
        /// Steering angle in radians.
        steer: Option<f64>,
        /// What `value` is.
        order: Option<Order>,
        /// Radians, rad/s or torque, by the order.
        value: Option<f64>,
        /// Humanoids: a single letter.
        axis: Option<String>,
    },
}

/// One wheel of an omni-drive.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WheelCommand {
    /// From 0.
    pub wheel: i64,
    /// rad/s.
    pub speed: Option<f64>,
    /// Radians.
    pub steer: Option<f64>,
}

impl Drive {
    /// Wheel spins in rad/s for a skid-steered robot, not normalised: good for both dialects.
    pub fn skid(left_rad_s: f64, right_rad_s: f64) -> Self {
        let form = DriveForm::Skid { left: Some(left_rad_s), right: Some(right_rad_s) };
        Self { form, normalized: Some(false), ..Self::default() }
    }

    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            form: DriveForm::read(fields),
            normalized: fields.flag("Normalized"),
            light: fields.flag("Light"),
            flip: fields.flag("Flip"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        self.form.write(w);
        for (key, flag) in
            [("Normalized", self.normalized), ("Light", self.light), ("Flip", self.flip)]
        {
            if let Some(flag) = flag {
                w.client_flag(key, flag);
            }
        }
        w.extra(&self.extra);
    }
}

impl DriveForm {
    fn read(fields: &mut Fields<'_>) -> Self {
        let any = |fields: &Fields<'_>, keys: &[&str]| keys.iter().any(|key| fields.has(key));
        if any(fields, &["Left", "Right"]) {
            Self::Skid { left: fields.engine_number("Left"), right: fields.engine_number("Right") }
        } else if any(fields, &["Speed", "FrontSteer", "RearSteer"]) {
            Self::Ackermann {
                speed: fields.engine_number("Speed"),
                front_steer: fields.engine_number("FrontSteer"),
                rear_steer: fields.engine_number("RearSteer"),
            }
        } else if any(fields, &AERIAL_KEYS) {
            let [altitude, linear, lateral, rotational, pitch_deg, roll_deg] =
                AERIAL_KEYS.map(|key| fields.engine_number(key));
            Self::Aerial { altitude, linear, lateral, rotational, pitch_deg, roll_deg }
        } else if any(fields, &["Propeller", "Rudder", "SternPlane"]) {
            Self::Nautic {
                propeller: fields.engine_number("Propeller"),
                rudder: fields.engine_number("Rudder"),
                stern_plane: fields.engine_number("SternPlane"),
            }
        } else if any(fields, &["WheelNumber"]) {
            let groups = fields.groups("WheelNumber");
            Self::Omni(fields.read_groups(groups, |group| {
                Ok(WheelCommand {
                    wheel: group.engine_integer("WheelNumber").unwrap_or(0),
                    speed: group.engine_number("WheelSpeed"),
                    steer: group.engine_number("WheelSteer"),
                })
            }))
        } else if any(fields, &["Name"]) {
            Self::Joint {
                name: fields.name(),
                bone: fields.text("Bone"),
                steer: fields.engine_number("Steer"),
                order: Order::read(fields),
                value: fields.engine_number("Value"),
                axis: fields.text("Axis"),
            }
        } else {
            Self::None
        }
    }

    fn write(&self, w: &mut LineWriter) {
        let mut real = |key: &str, value: Option<f64>| {
            if let Some(value) = value {
                w.real(key, value);
            }
        };
        match self {
            Self::None => {}
            Self::Skid { left, right } => {
                real("Left", *left);
                real("Right", *right);
            }
            Self::Ackermann { speed, front_steer, rear_steer } => {
                real("Speed", *speed);
                real("FrontSteer", *front_steer);
                real("RearSteer", *rear_steer);
            }
            Self::Aerial { altitude, linear, lateral, rotational, pitch_deg, roll_deg } => {
                let values = [altitude, linear, lateral, rotational, pitch_deg, roll_deg];
                for (key, value) in AERIAL_KEYS.into_iter().zip(values) {
                    real(key, *value);
                }
            }
            Self::Nautic { propeller, rudder, stern_plane } => {
                real("Propeller", *propeller);
                real("Rudder", *rudder);
                real("SternPlane", *stern_plane);
            }
            Self::Omni(wheels) => {
                for wheel in wheels {
                    w.integer("WheelNumber", wheel.wheel);
                    for (key, value) in [("WheelSpeed", wheel.speed), ("WheelSteer", wheel.steer)] {
                        if let Some(value) = value {
                            w.real(key, value);
                        }
                    }
                }
            }
            Self::Joint { name, bone, steer, order, value, axis } => {
                w.text("Name", name).optional_text("Bone", bone.as_deref());
                if let Some(steer) = steer {
                    w.real("Steer", *steer);
                }
                w.optional_integer("Order", order.map(Order::code));
                if let Some(value) = value {
                    w.real("Value", *value);
                }
                w.optional_text("Axis", axis.as_deref());
            }
        }
    }
}

const AERIAL_KEYS: [&str; 6] = [
    "AltitudeVelocity",
    "LinearVelocity",
    "LateralVelocity",
    "RotationalVelocity",
    "PitchAngle",
    "RollAngle",
];

/// `MULTIDRIVE {joint value} {joint value} …`: absolute angles; joints not named stay (UT2004).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiDrive {
    /// Joints with their angles in radians, in wire order.
    pub joints: Vec<NamedValue>,
}

impl MultiDrive {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        let joints = fields.take_where(|key, value| {
            let value = number::engine_number(value);
            Some(NamedValue { name: text::from_wire(key), value })
        });
        Self { joints }
    }

    pub(super) fn write(&self, w: &mut LineWriter) {
        for NamedValue { name, value } in &self.joints {
            w.real(name, *value);
        }
    }
}
