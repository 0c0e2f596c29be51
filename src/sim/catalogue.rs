//! The robots that can be spawned, as `maps/robots.toml` describes them.

use super::file_check::{Check, SpecError, read_toml};
use super::solid::Solid;
use super::spec::{Layout, PanTiltSpec, PartSpec, SensorSpec, WheelSpec};
use super::world::placed;
use crate::protocol::Dialect;
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

/// All robot classes, each for one dialect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotCatalogue {
    /// Classes in file order.
    #[serde(rename = "robot")]
    pub robots: Vec<RobotClass>,
}

/// One robot class in one dialect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotClass {
    /// Class name as INIT gives it, with its package: `USARBot.P3AT`.
    pub class: String,
    /// The dialect whose server has this robot.
    pub dialect: Dialect,
    /// What GEO and CONF say, where that is not what the physics uses.
    #[serde(default)]
    pub wire: WireFacts,
    /// Seconds that the battery lasts; absent means for ever, reported as 99999.
    pub battery_s: Option<f64>,
    /// Wheels and motors.
    pub wheels: WheelSpec,
    /// Boxes of the body.
    pub part: Vec<PartSpec>,
    /// Pan-tilt units.
    #[serde(default)]
    pub pan_tilt: Vec<PanTiltSpec>,
    /// Sensors, cameras and effecters, in the order in which a server reports them.
    #[serde(default)]
    pub sensor: Vec<SensorSpec>,
}

/// Numbers that a server prints about a robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WireFacts {
    /// Length, width, height in metres; absent means those of the parts and wheels together.
    pub dimensions_m: Option<[f64; 3]>,
    /// Centre of gravity in wire axes, in metres.
    pub cog_m: [f64; 3],
    /// Mass in kilograms; absent means the sum of the parts.
    pub mass_kg: Option<f64>,
    /// Torque in engine units.
    pub max_torque: Option<f64>,
}

impl RobotCatalogue {
    /// Reads the text of `robots.toml`; reports every violation at once.
    pub fn parse(text: &str) -> Result<Self, SpecError> {
        let catalogue: Self = read_toml(text)?;
        let mut check = Check::default();
        for robot in &catalogue.robots {
            robot.check(&mut check);
        }
        for (at, robot) in catalogue.robots.iter().enumerate() {
            let earlier = &catalogue.robots[..at];
            check.that(
                !earlier.iter().any(|other| {
                    other.dialect == robot.dialect && other.class.eq_ignore_ascii_case(&robot.class)
                }),
                format_args!("robot {:?}", robot.class),
                "expected one entry per dialect, found a second one",
            );
        }
        check.finish(catalogue)
    }

    /// The class of that name in that dialect, without regard to case; `USARBot.` may be left out.
    pub fn find(&self, class: &str, dialect: Dialect) -> Option<&RobotClass> {
        self.robots.iter().find(|robot| {
            let short = robot.class.rsplit('.').next().unwrap_or_default();
            robot.dialect == dialect
                && (robot.class.eq_ignore_ascii_case(class) || short.eq_ignore_ascii_case(class))
        })
    }
}

impl RobotClass {
    fn check(&self, check: &mut Check) {
        let owner = format!("robot {:?}", self.class);
        let wheels = &self.wheels;
        check.positive(
            &[
                wheels.radius_m,
                wheels.width_m,
                wheels.separation_m,
                wheels.base_m,
                wheels.mass_kg,
                wheels.friction,
                wheels.max_spin_rps,
                wheels.max_torque_nm,
                wheels.max_spin_change_rps2,
            ],
            format_args!("{owner} wheels"),
        );
        check.finite(&[wheels.axle_z_m], format_args!("{owner} wheels axle_z_m"));
        check.that(!self.part.is_empty(), &owner, "expected at least one part, found none");
        for part in &self.part {
            let place = format!("{owner} part {:?}", part.name);
            check.finite(&part.center, format_args!("{place} center"));
            check.positive(&part.size, format_args!("{place} size"));
            check.positive(&[part.mass_kg], format_args!("{place} mass_kg"));
        }
        check.positive(
            &self.battery_s.into_iter().collect::<Vec<_>>(),
            format_args!("{owner} battery_s"),
        );
        for unit in &self.pan_tilt {
            unit.check(check, &owner);
        }
        for sensor in &self.sensor {
            sensor.check(check, &owner);
            sensor.check_dialect(self.dialect, check, &owner);
        }
    }

    /// The class name without its package.
    pub fn short_name(&self) -> &str {
        self.class.rsplit('.').next().unwrap_or(&self.class)
    }

    /// Height of the robot's origin above level ground in metres.
    pub fn origin_height_m(&self) -> f64 {
        self.wheels.radius_m - self.wheels.axle_z_m
    }

    /// Mass of everything in kilograms.
    pub fn mass_kg(&self) -> f64 {
        let wheels = self.wheel_centres().len() as f64 * self.wheels.mass_kg;
        self.part.iter().map(|part| part.mass_kg).sum::<f64>() + wheels
    }

    /// Centres of the driven wheels in the robot's frame: front left, front right, rear left, rear
    /// right; or left, right.
    pub fn wheel_centres(&self) -> Vec<Vector3<f64>> {
        let (half, z) = (self.wheels.separation_m / 2.0, self.wheels.axle_z_m);
        let ends: &[f64] = match self.wheels.layout {
            Layout::FourWheels => &[0.5, -0.5],
            Layout::TwoWheelsAndCaster => &[0.0],
        };
        ends.iter()
            .flat_map(|end| {
                let x = end * self.wheels.base_m;
                [Vector3::new(x, half, z), Vector3::new(x, -half, z)]
            })
            .collect()
    }

    /// Everything of the body that a ray can meet, in the robot's frame.
    pub fn solids(&self) -> Vec<(Isometry3<f64>, Solid)> {
        let parts = self.part.iter().map(|part| {
            (placed(part.center, [0.0; 3]), Solid::Box(Vector3::from(part.size) / 2.0))
        });
        let wheel = Solid::Cylinder {
            radius_m: self.wheels.radius_m,
            half_height_m: self.wheels.width_m / 2.0,
        };
        let wheels = self
            .wheel_centres()
            .into_iter()
            .map(|centre| (placed(centre.into(), [90.0, 0.0, 0.0]), wheel.clone()));
        parts.chain(wheels).collect()
    }

    /// Length, width and height of the whole robot in metres.
    pub fn extents_m(&self) -> [f64; 3] {
        let mut least = Vector3::repeat(f64::INFINITY);
        let mut greatest = Vector3::repeat(f64::NEG_INFINITY);
        let wheels = &self.wheels;
        let wheel_half = Vector3::new(wheels.radius_m, wheels.width_m / 2.0, wheels.radius_m);
        let parts = self
            .part
            .iter()
            .map(|part| (Vector3::from(part.center), Vector3::from(part.size) / 2.0));
        for (centre, half) in parts.chain(self.wheel_centres().into_iter().map(|c| (c, wheel_half)))
        {
            least = least.inf(&(centre - half));
            greatest = greatest.sup(&(centre + half));
        }
        (greatest - least).into()
    }
}
