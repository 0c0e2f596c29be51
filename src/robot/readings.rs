//! Sensor readings in project frames and units.

use super::frames::{core_point, core_rotation};
use super::head::HeadPose;
use super::rig::Rig;
use crate::geometry::wrap_pi;
use crate::protocol::message::sen;
use crate::scan::Return;
use crate::time::Stamp;
use nalgebra::{Isometry2, Isometry3, Point3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Where odometry believes the robot is, relative to where it was created or last reset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OdometryReading {
    /// Pose of the robot in the odometry frame: metres, left positive, radians counter-clockwise.
    pub odom_from_robot: Isometry2<f64>,
    /// When, if the server says; UT2004 does not.
    pub stamp: Option<Stamp>,
}

/// What the inertial sensor believes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct InsReading {
    /// Attitude of the robot in the world: level frame, yaw counter-clockwise.
    pub world_from_robot: UnitQuaternion<f64>,
    /// Roll in radians, right side down positive, in (-π, π].
    pub roll_rad: f64,
    /// Pitch in radians, nose down positive, in (-π, π].
    pub pitch_rad: f64,
    /// Yaw in radians, counter-clockwise, in (-π, π].
    pub yaw_rad: f64,
    /// Place in the unit's own level frame, if it gives one.
    pub place: Option<InertialPlace>,
    /// When, if the server says.
    pub stamp: Option<Stamp>,
}

/// Where an inertial unit has added the robot's way up to.
///
/// It was begun at the true place, so it is no number to localise by; the way since an earlier one is, and
/// nothing else can be had of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct InertialPlace(Point3<f64>);

impl InertialPlace {
    /// A place of a unit's own frame, in metres.
    pub fn new(x_m: f64, y_m: f64, z_m: f64) -> Self {
        Self(Point3::new(x_m, y_m, z_m))
    }

    /// The way from `before` to here in the unit's level frame, in metres.
    pub fn since(&self, before: &Self) -> Vector3<f64> {
        self.0 - before.0
    }
}

/// One sonar's echo.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SonarEcho {
    /// The sensor's name.
    pub name: String,
    /// Pose of the sensor in the robot frame, its axis along x.
    pub robot_from_sonar: Isometry3<f64>,
    /// Opening of its cone in radians.
    pub beam_angle_rad: f64,
    /// What it heard.
    pub echo: Echo,
}

/// What a sonar heard.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Echo {
    /// Something at this distance in metres, somewhere in the cone.
    At(f64),
    /// Nothing within its range.
    Nothing,
}

/// A body part, or a false alarm that looks like one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VictimSighting {
    /// The sensor that saw it; empty where the server does not say.
    pub sensor: String,
    /// `Head`, `Arm`, `Hand`, `Chest`, `Pelvis`, `Leg` or `Foot`.
    pub part: String,
    /// Where it is in the robot frame.
    pub p_robot: Point3<f64>,
    /// Distance from the sensor in metres; the error of each coordinate grows with it.
    pub distance_m: f64,
}

/// A tag near the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TagSighting {
    /// Its identity, a number as a rule.
    pub id: String,
    /// Where it is in the robot frame, if the server says.
    pub p_robot: Option<Point3<f64>>,
    /// Its memory, if the reader reads it.
    pub memory: Option<String>,
}

impl Rig {
    /// Odometry in core axes.
    pub fn odometry(&self, message: &sen::Odometry) -> OdometryReading {
        let odom_from_robot =
            Isometry2::new(Vector2::new(message.x_m, -message.y_m), -message.theta_rad);
        OdometryReading { odom_from_robot, stamp: message.time }
    }

    /// Attitude and place of the inertial sensor.
    pub fn ins(&self, message: &sen::Ins) -> InsReading {
        attitude(message.pose.orientation, Some(message.pose.location), message.time)
    }

    /// Attitude of the 2006 sensor, which gives no position.
    pub fn inu(&self, message: &sen::Inu) -> InsReading {
        attitude(message.orientation_rad, None, message.time)
    }

    /// Echoes of the sonars that the rig knows, in the order of the message.
    pub fn sonar_echoes(&self, message: &sen::RangeReadings) -> Vec<SonarEcho> {
        message
            .readings
            .iter()
            .filter_map(|reading| {
                let sonar =
                    self.sonars.iter().find(|s| s.name.eq_ignore_ascii_case(&reading.name))?;
                // A saturated reading is the maximum less its 0.1 % noise; some servers write -1 or 25.
                let nothing = reading.range_m < 0.0 || reading.range_m >= 0.998 * sonar.max_range_m;
                Some(SonarEcho {
                    name: sonar.name.clone(),
                    robot_from_sonar: sonar.robot_from_sonar,
                    beam_angle_rad: sonar.beam_angle_rad,
                    echo: if nothing { Echo::Nothing } else { Echo::At(reading.range_m) },
                })
            })
            .collect()
    }

    /// Body parts that the victim sensor reports, with the scan head at `head`.
    pub fn victims(&self, message: &sen::VictSensor, head: HeadPose) -> Vec<VictimSighting> {
        let robot_from_sensor = self.device_pose("VictSensor", &message.name, head);
        message
            .parts
            .iter()
            .map(|part| {
                let p_sensor = core_point(part.location);
                VictimSighting {
                    sensor: message.name.clone(),
                    part: part.part.clone(),
                    p_robot: robot_from_sensor * p_sensor,
                    distance_m: p_sensor.coords.norm(),
                }
            })
            .collect()
    }

    /// Tags that the RFID reader reports.
    pub fn tags(&self, message: &sen::Rfid, head: HeadPose) -> Vec<TagSighting> {
        let robot_from_sensor = self.device_pose("RFID", &message.name, head);
        message
            .tags
            .iter()
            .map(|tag| TagSighting {
                id: tag.id.clone(),
                p_robot: tag.location.map(|at| robot_from_sensor * core_point(at)),
                memory: tag.memory.clone(),
            })
            .collect()
    }

    /// Names of the bumpers that touch something.
    pub fn touched<'a>(&self, message: &'a sen::Touch) -> Vec<&'a str> {
        message.readings.iter().filter(|r| r.touched).map(|r| r.name.as_str()).collect()
    }
}

fn attitude(orientation: [f64; 3], location: Option<[f64; 3]>, stamp: Option<Stamp>) -> InsReading {
    let [roll, pitch, yaw] = orientation;
    InsReading {
        world_from_robot: core_rotation(orientation),
        roll_rad: wrap_pi(roll),
        pitch_rad: wrap_pi(-pitch),
        yaw_rad: wrap_pi(-yaw),
        place: location.map(core_point).map(InertialPlace),
        stamp,
    }
}

impl SonarEcho {
    /// The echo as a beam's return.
    pub fn as_return(&self) -> Return {
        match self.echo {
            Echo::At(range_m) => Return::Hit(range_m),
            Echo::Nothing => Return::Nothing,
        }
    }
}
