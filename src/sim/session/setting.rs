//! SET, and its answer RES.

use super::robot::{Robot, Stage};
use crate::protocol::command::{Order, Set, SetForm};
use crate::protocol::message::{CameraResult, Res, SetResult};
use crate::protocol::{Dialect, Message, WirePose, engine_number};
use crate::sim::sensor::{Device, TagMemory};
use crate::sim::spec::SensorKind;
use crate::sim::wire;
use crate::time::Stamp;
use nalgebra::Point3;

/// What a SET led to: its answer, and lines that it made a sensor write at once.
pub(super) struct Outcome {
    pub(super) result: SetResult,
    pub(super) lines: Vec<Message>,
}

/// The RES of a result; `None` in UDK, which answers no SET.
pub(super) fn answer(
    dialect: Dialect,
    set: &Set,
    result: SetResult,
    stamp: Stamp,
) -> Option<Message> {
    (dialect == Dialect::Ut2004).then(|| {
        Message::Res(Res {
            time: Some(stamp),
            type_name: set.type_name.clone(),
            result,
            extra: Vec::new(),
        })
    })
}

fn item(name: &str, ok: bool) -> SetResult {
    SetResult::Item { name: name.to_owned(), ok, id: None, memory: None }
}

/// Does what a SET asks, on the given stage.
pub(super) fn apply(
    robot: &mut Robot,
    set: &Set,
    tags: &mut TagMemory,
    stage: &Stage<'_>,
) -> Outcome {
    let mut lines = Vec::new();
    let result = match &set.form {
        SetForm::Opcode { name, opcode, params } => {
            let params = params.as_deref().unwrap_or_default();
            let kind = set.type_name.to_ascii_lowercase();
            match (kind.as_str(), opcode.to_ascii_lowercase().as_str()) {
                ("rangescanner" | "irscanner" | "objectsensor" | "acoustic", "scan") => {
                    let kind = match kind.as_str() {
                        "rangescanner" => SensorKind::RangeScanner,
                        "irscanner" => SensorKind::IrScanner,
                        "acoustic" => SensorKind::Acoustic,
                        _ => SensorKind::ObjectSensor,
                    };
                    let stamp = robot.stamp(stage.now);
                    lines = robot.sense(stage, tags, stamp, |suite, instant| {
                        suite.scan_now(kind, name, instant)
                    });
                    item(name, !lines.is_empty())
                }
                ("rangeimager", "scan") => item(name, start_imaging(robot, name)),
                ("camera", "zoom" | "fov") => zoom(robot, name, number(params)),
                ("rfid", opcode) => rfid(robot, name, opcode, params, tags),
                ("rfidreleaser", "release") => item(name, release(robot, name, tags)),
                ("joint", opcode) => item(name, joint(robot, name, opcode, params)),
                (kind, opcode) => item(name, other(robot, kind, name, opcode, params)),
            }
        }
        SetForm::CameraFov { name, fov_rad } => zoom(robot, name, *fov_rad),
        SetForm::CameraClient { name, .. } => {
            let known = robot.suite.of(SensorKind::Camera, name).next().is_some();
            item(name, known)
        }
        SetForm::Viewports { config, views } => {
            let views = (1..=4).map(|number| {
                let view = views.iter().find(|(own, _)| *own == number);
                let view = view.map_or("Disabled", |(_, view)| view.as_str());
                let known = ["none", "disabled"].contains(&view.to_ascii_lowercase().as_str())
                    || robot.suite.of(SensorKind::Camera, view).next().is_some();
                (view.to_owned(), known)
            });
            let views = views.collect();
            let ok = ["singleview", "quadview"].contains(&config.to_ascii_lowercase().as_str());
            SetResult::Viewports { config: config.clone(), ok, views }
        }
    };
    Outcome { result, lines }
}

/// A number as the engine reads it: words such as `nan` are 0, and no infinity gets in.
fn number(text: &str) -> f64 {
    Some(engine_number(text.trim().as_bytes())).filter(|value| value.is_finite()).unwrap_or(0.0)
}

/// Lets the named depth camera, or all, send an image.
fn start_imaging(robot: &mut Robot, name: &str) -> bool {
    let mut found = false;
    for device in robot.suite.of(SensorKind::RangeImager, name) {
        if let Device::Depth(depth) = device {
            depth.start();
            found = true;
        }
    }
    found
}

/// Sets the view of the named camera, or of all, and tells the views of all.
fn zoom(robot: &mut Robot, name: &str, fov_rad: f64) -> SetResult {
    let mut found = false;
    for device in robot.suite.of(SensorKind::Camera, name) {
        if let Device::Camera(camera) = device {
            found = true;
            camera.zoom(fov_rad);
        }
    }
    if !found {
        return item(name, false);
    }
    let cameras = robot.suite.of(SensorKind::Camera, "").filter_map(|device| match device {
        Device::Camera(camera) => Some(CameraResult {
            name: camera.mounting.name.clone(),
            fov_rad: wire::truncate(camera.fov_rad, 4),
            ok: true,
        }),
        _ => None,
    });
    SetResult::Cameras(cameras.collect())
}

fn rfid(
    robot: &mut Robot,
    name: &str,
    opcode: &str,
    params: &str,
    tags: &mut TagMemory,
) -> SetResult {
    let failed = item(name, false);
    let (carrier, suite) = robot.split();
    let Some(Device::Tags(reader)) = suite.of(SensorKind::Rfid, name).next() else {
        return failed;
    };
    let (id, text) = params.trim().split_once(' ').unwrap_or((params.trim(), ""));
    let Ok(number) = id.parse::<i64>() else { return failed };
    match opcode {
        "read" => match reader.read_memory(&carrier, tags, number) {
            Some(memory) => SetResult::Item {
                name: reader.mounting.name.clone(),
                ok: true,
                id: Some(id.to_owned()),
                memory: Some(memory),
            },
            None => failed,
        },
        "write" => item(name, reader.write_memory(&carrier, tags, number, text.trim())),
        _ => failed,
    }
}

fn release(robot: &mut Robot, name: &str, tags: &mut TagMemory) -> bool {
    let (carrier, suite) = robot.split();
    let Some(Device::Releaser(gun)) = suite.of(SensorKind::RfidReleaser, name).next() else {
        return false;
    };
    if gun.left == 0 {
        return false;
    }
    gun.left -= 1;
    tags.release(Point3::from(carrier.world_from_sensor(&gun.mounting).translation.vector))
}

/// UT2004: `Angle`, `Velocity`, `Torque` and their relatives, by name or number, for the joints of
/// the units (`NAME_Link1`) and the wheels.
fn joint(robot: &mut Robot, name: &str, opcode: &str, params: &str) -> bool {
    let order = match opcode {
        "angle" | "target" | "0" => Order::Angle,
        "velocity" | "1" => Order::Velocity,
        "torque" | "2" => Order::Torque,
        "relangle" | "10" => Order::RelAngle,
        "relvelocity" | "11" => Order::RelVelocity,
        "reltorque" | "12" => Order::RelTorque,
        _ => return false,
    };
    let value = params.split(',').next().map_or(0.0, number);
    let Some((unit, link)) = crate::sim::scenario::link_of_mount(name) else {
        return robot.order_wheel(name, order, value);
    };
    let known = robot.units.iter().any(|own| own.name.eq_ignore_ascii_case(unit));
    robot.order_link(unit, link as i64 + 1, order, value);
    known
}

/// RESET and POSE; everything else fails.
fn other(robot: &mut Robot, kind: &str, name: &str, opcode: &str, params: &str) -> bool {
    let (carrier, suite) = robot.split();
    let mut done = false;
    for item in &mut suite.items {
        let mounting = &item.device.mounting().name;
        let meant = item.kind.name().eq_ignore_ascii_case(kind)
            && (name.is_empty() || mounting.eq_ignore_ascii_case(name));
        if !meant {
            continue;
        }
        match (&mut item.device, opcode) {
            (Device::Odometry(odometry), "reset") => odometry.reset(),
            (Device::Encoder(encoder), "reset") => encoder.reset(),
            (Device::Tachometer(tachometer), "reset") => tachometer.reset(&carrier),
            (Device::Ins(ins), "pose") => {
                let values: Vec<f64> = params.split(',').map(number).collect();
                let [x, y, z, roll, pitch, yaw] = values[..] else { continue };
                ins.set_pose(WirePose { location: [x, y, z], orientation: [roll, pitch, yaw] });
            }
            _ => continue,
        }
        done = true;
    }
    done
}
