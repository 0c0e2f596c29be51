//! What is known of robot classes when the server does not answer (protocol 5.3, 5.4, 8).

use super::beams::{PRINTED_PI, PRINTED_UDK_SICK_FOV};
use super::head::ScanHead;
use super::mount::{Joint, JointKind, Mount};
use super::rig::Body;
use super::{DriveTrain, Laser};
use crate::geometry::AngleSpan;
use crate::protocol::Dialect;
use std::f64::consts::{FRAC_PI_2, PI};

/// One class as the table has it.
#[derive(Clone, Debug)]
pub(super) struct ClassEntry {
    /// Whether the table knows the class; else this is a P2AT for want of better.
    pub known: bool,
    pub body: Body,
    pub drive: DriveTrain,
    pub laser: Laser,
}

/// The table's entry for a class such as `USARBot.P2AT`; the package is ignored.
pub(super) fn entry(class: &str, dialect: Dialect) -> ClassEntry {
    let bare = class.rsplit('.').next().unwrap_or(class).to_ascii_uppercase();
    match (bare.as_str(), dialect) {
        ("P2AT", _) => p2at(true),
        ("P3AT", Dialect::Ut2004) => p3at_ut2004(),
        ("P3AT", Dialect::Udk) => p3at_udk(),
        ("P2DX", _) => p2dx(),
        _ => p2at(false),
    }
}

fn sick(name: &str, fov_rad: f64, mount: Mount) -> Laser {
    Laser {
        name: name.into(),
        type_name: "RangeScanner".into(),
        head: ScanHead::new(mount),
        mounted_within_m: 0.0,
        min_range_m: 0.1,
        max_range_m: 20.0,
        fov_rad,
        resolution_rad: 0.0174,
    }
}

fn p2at(known: bool) -> ClassEntry {
    ClassEntry {
        known,
        body: Body {
            length_m: 0.5238,
            width_m: 0.4968,
            height_m: 0.2913,
            origin_height_m: 0.1457,
            mass_kg: 14.0,
        },
        drive: DriveTrain {
            wheel_radius_m: 0.13,
            wheel_separation_m: 0.4712,
            wheel_base_m: 0.2884,
            max_spin_rps: 5.385,
            turn_share: 1.0,
        },
        laser: sick("Scanner1", PRINTED_PI, Mount::on_body([0.1439, 0.0, -0.0920], [0.0; 3])),
    }
}

/// The stock pan-tilt of protocol 5.4.
pub(super) fn camera_pan_tilt() -> Vec<Joint> {
    let revolute = JointKind::Revolute;
    let pan =
        Joint::from_wire("CameraPanTilt", 1, revolute, [0.1239, 0.0, -0.2036], [PI, 0.0, 0.0]);
    let tilt =
        Joint::from_wire("CameraPanTilt", 2, revolute, [0.0, 0.0, 0.0599], [FRAC_PI_2, 0.0, 0.0]);
    vec![
        Joint { max_speed: Some(0.17), ..pan },
        Joint { max_speed: Some(0.17), limits: Some(AngleSpan::new(-0.16, 0.40)), ..tilt },
    ]
}

/// The paper's robot: a Pioneer 3AT whose SICK sits on the pan-tilt; dimensions as the P2AT's, mount
/// of the laser as one team had it.
fn p3at_ut2004() -> ClassEntry {
    let mount = Mount {
        joints: camera_pan_tilt(),
        part_from_device: super::core_pose([0.06, 0.0, -0.0087], [0.0; 3]),
    };
    ClassEntry { laser: sick("Scanner1", PRINTED_PI, mount), ..p2at(true) }
}

fn p3at_udk() -> ClassEntry {
    ClassEntry {
        known: true,
        body: Body {
            length_m: 0.508,
            width_m: 0.497,
            height_m: 0.277,
            origin_height_m: 0.14,
            mass_kg: 11.9,
        },
        drive: DriveTrain {
            wheel_radius_m: 0.098,
            wheel_separation_m: 0.36,
            wheel_base_m: 0.248,
            max_spin_rps: 1.3,
            turn_share: 1.0,
        },
        laser: sick("lms200", PRINTED_UDK_SICK_FOV, Mount::on_body([0.2085, 0.0, -0.2], [0.0; 3])),
    }
}

/// Wheels and hull of the real Pioneer 2DX; the protocol document has none. The laser's place is that
/// of the recorded session, 5 cm ahead of the robot's centre.
fn p2dx() -> ClassEntry {
    ClassEntry {
        known: true,
        body: Body {
            length_m: 0.44,
            width_m: 0.38,
            height_m: 0.29,
            origin_height_m: 0.15,
            mass_kg: 9.0,
        },
        drive: DriveTrain {
            wheel_radius_m: 0.0825,
            wheel_separation_m: 0.33,
            wheel_base_m: 0.0,
            max_spin_rps: 5.385,
            turn_share: 1.0,
        },
        laser: sick("Scanner1", PRINTED_PI, Mount::on_body([0.05, 0.0, -0.0920], [0.0; 3])),
    }
}
