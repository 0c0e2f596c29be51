//! A robot of a scenario: its class with units and sensors of its own.

use crate::sim::catalogue::RobotClass;
use crate::sim::file_check::Check;
use crate::sim::spec::{PanTiltSpec, SensorSpec};
use serde::{Deserialize, Serialize};

/// One robot of the scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotSpec {
    /// Name, unique, as INIT gives it.
    pub name: String,
    /// Class, from the robot file.
    pub class: String,
    /// Start pose of the map; absent means the map's first, or the origin if it has none.
    #[serde(default)]
    pub start: Option<String>,
    /// Seconds that the battery lasts, > 0; absent means the class's.
    #[serde(default)]
    pub battery_s: Option<f64>,
    /// Pan-tilt units instead of the class's; what a unit leaves out comes from the class's unit of
    /// that name.
    #[serde(default)]
    pub pan_tilt: Option<Vec<PanTiltSpec>>,
    /// Sensors: those given replace all of the class's sensors of the same types.
    #[serde(default, rename = "sensor")]
    pub sensors: Vec<SensorSpec>,
    /// Whether the class's sensors of other types stay.
    #[serde(default = "yes")]
    pub class_sensors: bool,
}

fn yes() -> bool {
    true
}

impl RobotSpec {
    pub(super) fn model(&self, class: &RobotClass, check: &mut Check) -> RobotClass {
        let mut model = class.clone();
        model.battery_s = self.battery_s.or(class.battery_s);
        if let Some(units) = &self.pan_tilt {
            let of_class = |name: &str| class.pan_tilt.iter().find(|unit| unit.name == name);
            let first = class.pan_tilt.first();
            model.pan_tilt = units
                .iter()
                .map(|unit| {
                    of_class(&unit.name).or(first).map_or_else(|| unit.clone(), |c| unit.or(c))
                })
                .collect();
        }
        let replaced = |sensor: &SensorSpec| {
            !self.class_sensors || self.sensors.iter().any(|own| own.kind == sensor.kind)
        };
        model.sensor.retain(|sensor| !replaced(sensor));
        for sensor in &mut model.sensor {
            remount(sensor, &class.pan_tilt, &model.pan_tilt);
        }
        model.sensor.extend(self.sensors.iter().cloned());
        for sensor in &model.sensor {
            sensor.check_dialect(class.dialect, check, &format!("robot {:?}", self.name));
            check.that(
                mountable(sensor, &model.pan_tilt),
                format_args!("robot {:?} sensor {:?} mount", self.name, sensor.name),
                format_args!(
                    "expected body, a wheel or NAME_Link1/2 of a unit, found {:?}",
                    sensor.mount
                ),
            );
        }
        model
    }
}

/// Unit and link that a mount such as `NAME_Link2` names.
pub(crate) fn link_of_mount(mount: &str) -> Option<(&str, usize)> {
    let (unit, link) = mount.rsplit_once("_Link")?;
    match link {
        "1" => Some((unit, 0)),
        "2" => Some((unit, 1)),
        _ => None,
    }
}

fn mountable(sensor: &SensorSpec, units: &[PanTiltSpec]) -> bool {
    match link_of_mount(&sensor.mount) {
        Some((unit, _)) => units.iter().any(|own| own.name == unit),
        None => sensor.mount == "body" || sensor.mount.ends_with("Wheel"),
    }
}

/// A sensor of the class on a unit that the scenario renamed moves to the only unit there is; where
/// there is none it stays where it was at zero angles, on the body.
fn remount(sensor: &mut SensorSpec, class_units: &[PanTiltSpec], units: &[PanTiltSpec]) {
    let Some((unit, link)) = link_of_mount(&sensor.mount) else { return };
    if units.iter().any(|own| own.name == unit) {
        return;
    }
    let lost = class_units.iter().find(|own| own.name == unit);
    sensor.mount = match (units, lost) {
        ([only], _) => format!("{}_Link{}", only.name, link + 1),
        (_, Some(lost)) => {
            let offset = if link == 1 { lost.tilt_offset.unwrap_or_default() } else { [0.0; 3] };
            let joint = lost.position.unwrap_or_default();
            for axis in 0..3 {
                sensor.position[axis] += joint[axis] + offset[axis];
            }
            "body".to_owned()
        }
        (_, None) => "body".to_owned(),
    };
}
