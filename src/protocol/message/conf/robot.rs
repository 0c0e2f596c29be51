//! The robot's own configuration.

use crate::protocol::encode::LineWriter;
use crate::protocol::fields::Fields;
use crate::protocol::{Dialect, Segment};
use serde::{Deserialize, Serialize};

/// ```text
/// UT2004  CONF {Type GroundVehicle} {Name P2AT} {SteeringType SkidSteered} {Mass 14.0000} {MaxSpeed 5.3850} {MaxTorque 60.0000} {MaxFrontSteer 0.0000} {MaxRearSteer 0.0000}
/// UDK     CONF {Name P3AT} {Type GroundVehicle} … {MaxFrontSteer 0} {MaxRearSteer 0}
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RobotConf {
    /// `GroundVehicle`, …
    pub vehicle_type: String,
    /// The class.
    pub name: String,
    /// `SkidSteered`, `AckermanSteered`, `OmniDrive`, `TwoLegs`, …
    pub steering_type: Option<String>,
    /// Kilograms.
    pub mass_kg: Option<f64>,
    /// Wheel spin, rad/s.
    pub max_spin_rad_s: Option<f64>,
    /// Engine units.
    pub max_torque: Option<f64>,
    /// Radians.
    pub max_front_steer_rad: Option<f64>,
    /// Radians.
    pub max_rear_steer_rad: Option<f64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl RobotConf {
    pub(super) fn read(fields: &mut Fields<'_>, vehicle_type: String) -> Self {
        Self {
            vehicle_type,
            name: fields.name(),
            steering_type: fields.text("SteeringType"),
            mass_kg: fields.number("Mass"),
            max_spin_rad_s: fields.number("MaxSpeed"),
            max_torque: fields.number("MaxTorque"),
            max_front_steer_rad: fields.number("MaxFrontSteer"),
            max_rear_steer_rad: fields.number("MaxRearSteer"),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        match dialect {
            Dialect::Ut2004 => w.text("Type", &self.vehicle_type).text("Name", &self.name),
            Dialect::Udk => w.text("Name", &self.name).text("Type", &self.vehicle_type),
        };
        w.optional_text("SteeringType", self.steering_type.as_deref());
        w.optional_number("Mass", self.mass_kg, 4);
        w.optional_number("MaxSpeed", self.max_spin_rad_s, 4);
        w.optional_number("MaxTorque", self.max_torque, 4);
        for (key, angle) in
            [("MaxFrontSteer", self.max_front_steer_rad), ("MaxRearSteer", self.max_rear_steer_rad)]
        {
            // UDK's skid-steered classes print a literal 0.
            let plain = dialect == Dialect::Udk && angle == Some(0.0);
            w.optional_number(key, angle, if plain { 0 } else { 4 });
        }
        w.extra(&self.extra);
    }
}
