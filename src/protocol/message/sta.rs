//! `STA`: the periodic state of the robot.

use crate::protocol::encode::{LineWriter, joined};
use crate::protocol::fields::Fields;
use crate::protocol::{Dialect, NamedValue, Segment, number, text};
use crate::time::Stamp;
use serde::{Deserialize, Serialize};

/// One `STA` line of a robot.
///
/// ```text
/// UT2004  STA {Type t} {Time t} {FrontSteer f} {RearSteer f} [{joint f} …] {LightToggle b} {LightIntensity i} {Battery i} {View i}
/// UDK     STA {Time t} {Battery i} [{Type t}] [{LightToggle b} {LightIntensity i} {FrontSteer f} {RearSteer f}] [{joint f} …]
/// ```
///
/// The first segment tells the dialects apart: see [`Dialect::of_line`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sta {
    /// `GroundVehicle`, `AerialVehicle`, …; UDK's aerial robots send none.
    pub vehicle_type: Option<String>,
    /// Simulated seconds since the level started.
    pub time: Option<Stamp>,
    /// Whole seconds of life left.
    pub battery_s: Option<i64>,
    /// Commanded front steering angle in radians; 0 on a skid-steered robot.
    pub front_steer_rad: Option<f64>,
    /// Commanded rear steering angle in radians; 0 on a skid-steered robot.
    pub rear_steer_rad: Option<f64>,
    /// Flippers, head joints, rudder and stern planes under their own names, in wire order.
    pub joints: Vec<NamedValue>,
    /// Whether the headlight is on.
    pub light_on: Option<bool>,
    /// 0–100.
    pub light_intensity: Option<i64>,
    /// UT2004: the viewport that shows this robot, -1 for none.
    pub view: Option<i64>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl Sta {
    pub(super) fn read(fields: &mut Fields<'_>) -> Self {
        Self {
            vehicle_type: fields.text("Type"),
            time: fields.time(),
            battery_s: fields.integer("Battery"),
            front_steer_rad: fields.number("FrontSteer"),
            rear_steer_rad: fields.number("RearSteer"),
            light_on: fields.flag("LightToggle"),
            light_intensity: fields.integer("LightIntensity"),
            view: fields.integer("View"),
            // A joint is whatever is left that reads as one number with a decimal point: servers
            // write angles so, and counts without it.
            joints: fields.take_where(|key, value| {
                let number = number::whole(value).filter(|_| value.contains(&b'.'))?;
                Some(NamedValue { name: text::from_wire(key), value: number })
            }),
            extra: fields.rest(),
        }
    }

    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        match dialect {
            Dialect::Ut2004 => {
                w.optional_text("Type", self.vehicle_type.as_deref()).time(self.time, 2);
                w.optional_number("FrontSteer", self.front_steer_rad, 4);
                w.optional_number("RearSteer", self.rear_steer_rad, 4);
                self.write_joints(w);
                self.write_light(w);
                w.optional_integer("Battery", self.battery_s);
                w.optional_integer("View", self.view);
            }
            Dialect::Udk => {
                w.time(self.time, 4).optional_integer("Battery", self.battery_s);
                w.optional_text("Type", self.vehicle_type.as_deref());
                self.write_light(w);
                // Skid-steered classes print a literal 0, Ackermann classes an angle. An Ackermann
                // robot with straight wheels is therefore written as the former: the same value.
                let angles = [self.front_steer_rad, self.rear_steer_rad];
                let decimals =
                    if angles.iter().flatten().all(|angle| *angle == 0.0) { 0 } else { 4 };
                w.optional_number("FrontSteer", self.front_steer_rad, decimals);
                w.optional_number("RearSteer", self.rear_steer_rad, decimals);
                self.write_joints(w);
                w.optional_integer("View", self.view);
            }
        }
        w.extra(&self.extra);
    }

    fn write_joints(&self, w: &mut LineWriter) {
        for joint in &self.joints {
            w.number(&joint.name, joint.value, 4);
        }
    }

    fn write_light(&self, w: &mut LineWriter) {
        if let Some(on) = self.light_on {
            w.server_flag("LightToggle", on);
        }
        w.optional_integer("LightIntensity", self.light_intensity);
    }
}

/// `STA {Name n} {Size x,y,z} {Location x,y,z {Memory {text} {Rotation r,p,y}`: the reply to
/// `CONTROL {Type GetSTA}`, one object a line, with the braces as unbalanced as shown.
///
/// Told from a robot's status by its `Size`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ObjectSta {
    /// The object's name.
    pub name: String,
    /// Metres.
    pub size: [f64; 3],
    /// Metres, wire frame, world.
    pub location: Option<[f64; 3]>,
    /// The object's memory text; empty if it has none.
    pub memory: String,
    /// roll, pitch, yaw in radians.
    pub rotation: Option<[f64; 3]>,
    /// Segments not named above.
    pub extra: Vec<Segment>,
}

impl ObjectSta {
    /// Reads the line if it is one; the damage that belongs to its form is no problem.
    pub(super) fn read(fields: &mut Fields<'_>) -> Option<Self> {
        let size = fields.vector("Size")?;
        fields.trust_unclosed();
        let name = fields.name();
        let location = fields.vector("Location");
        let rotation = fields.vector("Rotation");
        let memory = match fields.take("Memory") {
            // `{Memory {text}`: the text stands in a segment of its own.
            Some([]) => fields.take_first().map(|field| text::from_wire(field.body)),
            value => value.map(text::from_wire),
        };
        let memory = memory.unwrap_or_default();
        Some(Self { name, size, location, memory, rotation, extra: fields.rest() })
    }

    /// UDK forgets two closing braces, and writes the memory of an object that has none.
    pub(super) fn write(&self, w: &mut LineWriter, dialect: Dialect) {
        w.text("Name", &self.name).list("Size", &self.size, 4);
        match (&self.location, dialect) {
            (Some(location), Dialect::Udk) => {
                w.unclosed(&format!("Location {}", joined(location, 4)));
                w.unclosed("Memory").bare(&self.memory);
            }
            (location, _) => {
                if let Some(location) = location {
                    w.list("Location", location, 4);
                }
                w.text_unless_empty("Memory", &self.memory);
            }
        }
        if let Some(rotation) = &self.rotation {
            w.list("Rotation", rotation, 4);
        }
        w.extra(&self.extra);
    }
}
