//! Rigs learned from the lines that servers were seen to send.

use super::*;
use crate::protocol::{Dialect, Message, encode_command, message::Sen, parse};
use crate::scan::Return;
use crate::time::Stamp;
use nalgebra::{Point3, Vector3};

const P2AT: &str = "GEO {Type GroundVehicle} {Name P2AT} {Dimensions 0.5238,0.4968,0.2913} {COG 0.0000,0.0000,0.0000} {WheelRadius 0.1300} {WheelSeparation 0.4712} {WheelBase 0.2884}";
const P2AT_CONF: &str = "CONF {Type GroundVehicle} {Name P2AT} {SteeringType SkidSteered} {Mass 14.0000} {MaxSpeed 5.3850} {MaxTorque 60.0000} {MaxFrontSteer 0.0000} {MaxRearSteer 0.0000}";
const SCANNER_CONF: &str = "CONF {Type RangeScanner} {Name Scanner1} {MaxRange 20.0000} {MinRange 0.1000} {Resolution 0.0174} {Fov 3.1415} {Paning True} {Tilting False}";
const PAN_TILT: &str = "GEO {Type MisPkg} {Name CameraPanTilt} {Link 1} {ParentLink -1} {Location 0.1239,0.0000,-0.2036} {Orientation 3.1415,0.0000,0.0000} {Link 2} {ParentLink 1} {Location 0.0000,0.0000,0.0599} {Orientation 1.5707,0.0000,0.0000}";
const PAN_TILT_CONF: &str = "CONF {Type MisPkg} {Name CameraPantilt} {Link 1} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00} {MinRange 1} {MaxRange 0} {Link 2} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20} {MinRange -0.16} {MaxRange 0.40}";

fn scanner_on(mount: &str) -> String {
    format!(
        "GEO {{Type RangeScanner}} {{Name Scanner1 Location 0.1439,0.0000,-0.0920 Orientation 0.0000,0.0000,0.0000 Mount {mount}}}"
    )
}

fn message(line: &str) -> Message {
    let parsed = parse(line.as_bytes());
    assert!(parsed.problems.is_empty(), "{line}: {:?}", parsed.problems);
    parsed.message
}

fn sen(line: &str) -> Sen {
    let Message::Sen(sen) = message(line) else { panic!("no sensor line: {line}") };
    sen
}

fn learned(dialect: Dialect, class: &str, lines: &[&str]) -> (Rig, Vec<RigWarning>) {
    let mut builder = RigBuilder::new(dialect, class);
    for line in lines {
        assert!(builder.learn(&message(line)), "{line}");
    }
    builder.build()
}

fn stock() -> Rig {
    let scanner = scanner_on("CameraPanTilt_Link2");
    let lines = [P2AT, P2AT_CONF, &scanner, SCANNER_CONF, PAN_TILT, PAN_TILT_CONF];
    let (rig, warnings) = learned(Dialect::Ut2004, "USARBot.P2AT", &lines);
    assert_eq!(warnings, [], "nothing had to be supposed");
    rig
}

#[test]
fn a_laser_on_the_body_is_planar_even_beside_a_camera_pan_tilt() {
    let scanner = scanner_on("HARD");
    let lines = [P2AT, P2AT_CONF, &scanner, SCANNER_CONF, PAN_TILT, PAN_TILT_CONF];
    let (rig, warnings) = learned(Dialect::Ut2004, "USARBot.P2AT", &lines);
    assert!(rig.is_planar());
    assert_eq!(warnings, [RigWarning::Planar]);
    assert!(rig.head_commands(None, Some(Demand::Angle(0.1))).is_empty());
    let at = rig.robot_from_sensor(HeadPose::tilted(0.5)).translation.vector;
    assert!((at - Vector3::new(0.1439, 0.0, 0.0920)).norm() < 1e-12);
}

#[test]
fn the_lasers_joints_follow_from_its_mount() {
    let rig = stock();
    let head = &rig.laser.as_ref().unwrap().head;
    let tilt = head.tilt().unwrap();
    assert_eq!(
        (tilt.package.as_str(), tilt.link, tilt.speed_rad_s),
        ("CameraPanTilt", 2, Some(0.17))
    );
    let limits = tilt.limits.unwrap();
    assert_eq!((limits.min_rad, limits.max_rad), (-0.40, 0.16), "up is negative in the core");
    assert_eq!(head.pan().unwrap().limits, None, "MinRange above MaxRange is no limit");
    assert!((rig.drive.max_linear_mps() - 0.70).abs() < 0.001);
    let seen = rig.visibility().unwrap();
    assert!(seen.to_string().starts_with("ground nearer than"), "{seen}");
}

#[test]
fn commands_have_the_dialects_form_and_the_wires_sign() {
    let rig = stock();
    let lines = |commands: Vec<crate::protocol::Command>| -> Vec<String> {
        commands
            .iter()
            .map(|c| String::from_utf8(encode_command(c, rig.dialect)).unwrap())
            .collect()
    };
    // The paper's -22.5° look up; the wire says so with a positive value.
    let up = Demand::Angle(-22.5_f64.to_radians());
    assert_eq!(
        lines(rig.head_commands(None, Some(up))),
        ["MISPKG {Name CameraPanTilt} {Link 2} {Value 0.392699} {Order 0}\r\n"]
    );
    assert_eq!(
        lines(rig.head_commands(Some(Demand::Angle(0.5)), Some(Demand::Rate(0.05)))),
        [
            "MISPKG {Name CameraPanTilt} {Link 1} {Value 0.5} {Order 0} {Link 2} {Value -0.05} {Order 1}\r\n"
        ]
    );
    let clipped = lines(rig.head_commands(None, Some(Demand::Angle(1.0))));
    assert_eq!(clipped, ["MISPKG {Name CameraPanTilt} {Link 2} {Value -0.16} {Order 0}\r\n"]);
    let drive = rig.drive_command(BodySpeed { linear_mps: 0.13, angular_rps: 0.0 });
    assert_eq!(lines(vec![drive]), ["DRIVE {Left 1.0} {Right 1.0} {Normalized false}\r\n"]);
}

#[test]
fn status_lines_of_the_lasers_package_become_core_angles() {
    let rig = stock();
    let line = "MISSTA {Time 5609.45} {Name CameraPanTilt} {Link 1} {Value 0.5000} {Torque -20.00} {Link 2} {Value -0.1600} {Torque -20.00}";
    let Message::MisSta(state) = message(line) else { panic!() };
    let reading = rig.head_reading(&state).unwrap();
    let (pan, tilt) = (reading.pan.unwrap(), reading.tilt.unwrap());
    assert_eq!(reading.stamp, Stamp::from_seconds(5609.45));
    // The wire cuts towards zero, so the truth lies at the printed value or a little beyond.
    assert!(pan.angle_rad >= 0.5 && pan.angle_rad - pan.half_width_rad <= 0.5);
    assert!(tilt.angle_rad >= 0.16 && tilt.angle_rad - tilt.half_width_rad <= 0.16 + 1e-12);
    let other = "MISSTA {Time 48.22} {Name TeleMaxArm} {Link 1} {Value 0.0000} {Torque -300.00}";
    let Message::MisSta(state) = message(other) else { panic!() };
    assert_eq!(rig.head_reading(&state), None);
}

#[test]
fn missing_answers_are_replaced_and_named() {
    let (rig, warnings) = learned(Dialect::Ut2004, "USARBot.Rover", &[]);
    let text: Vec<String> = warnings.iter().map(ToString::to_string).collect();
    assert_eq!(text.len(), 6, "{text:#?}");
    assert!(text[0].starts_with("class Rover is not in the class table"));
    assert!(text[1].starts_with("GETGEO Robot was not answered: supposing hull"));
    assert!(text[3].contains("GETGEO RangeScanner was not answered: supposing Scanner1 at (0.144"));
    assert!(rig.is_planar());
}

#[test]
fn a_robot_without_a_scanner_has_no_laser() {
    let (rig, _) = learned(Dialect::Ut2004, "P2AT", &[P2AT, P2AT_CONF, "GEO {Type RangeScanner}"]);
    assert_eq!(rig.laser, None);
    assert!(rig.is_planar() && rig.visibility().is_none());
    let Sen::RangeScanner(line) = sen("SEN {Time 1.00} {Type RangeScanner} {Name S} {Range 1.0}")
    else {
        panic!()
    };
    assert!(rig.laser_line(&line, None).is_err());
}

#[test]
fn queries_are_known_to_be_answered_or_not() {
    let mut builder = RigBuilder::new(Dialect::Ut2004, "USARBot.P2AT");
    let queries = builder.queries();
    let lines: Vec<_> = queries.iter().map(|q| encode_command(q, Dialect::Ut2004)).collect();
    assert_eq!(lines[0], b"GETGEO {Type Robot}\r\n");
    assert!(queries.iter().all(|query| !builder.has_answer(query)));
    builder.learn(&message(P2AT));
    builder.learn(&message("GEO {Type MisPkg}"));
    assert!(builder.has_answer(&queries[0]) && !builder.has_answer(&queries[1]));
    assert!(queries.iter().filter(|query| builder.has_answer(query)).count() == 2);
}

#[test]
fn udk_rigs_have_separate_segments_and_wheel_distances_for_dimensions() {
    let geo = "GEO {Type GroundVehicle} {Name P3AT} {Dimensions 0.2480,0.3600,0.0000} {COG 0.0000,0.0000,0.0000} {WheelRadius 0.0980} {WheelSeparation 0.3600} {WheelBase 0.2480}";
    let conf = "CONF {Name P3AT} {Type GroundVehicle} {SteeringType SkidSteered} {Mass 11.9000} {MaxSpeed 1.2999} {MaxTorque 50000.0000} {MaxFrontSteer 0} {MaxRearSteer 0}";
    let scanner = "GEO {Type RangeScanner} {Name lms200} {Location 0.21,0.00,-0.20} {Orientation 0.00,0.00,0.00}{Mount P3AT}";
    let limits = "CONF {Type RangeScanner} {Name lms200} {MaxRange 20.0000} {MinRange 0.1000} {Resolution 0.0174} {Fov 3.1414} {Panning True} {Tilting False}";
    let (rig, warnings) = learned(Dialect::Udk, "USARBot.P3AT", &[geo, conf, scanner, limits]);
    assert!(rig.is_planar());
    assert!((rig.drive.max_linear_mps() - 0.127).abs() < 0.001);
    assert!(rig.body.length_m > 0.4, "the hull, not the wheels");
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    let Sen::RangeScanner(line) = sen(
        "SEN {Time 29.9739} {Type RangeScanner} {Name lms200} {Resolution 0.0174} {FOV 3.1414} {Range 2.19,2.19,2.20}",
    ) else {
        panic!()
    };
    let line = rig.laser_line(&line, None).unwrap();
    assert_eq!(line.classify(0), Return::Hit(2.195));
}

#[test]
fn a_udk_laser_on_an_actuator_tilts_by_act_from_zero() {
    let actuator = "GEO {Type Actuator} {Name Tilter} {Location 0.100,0.000,-0.300} {Orientation 0.00,0.00,0.00}{Mount P3AT} {Link 1} {Parent 0} {Location 0.000,0.000,0.000} {Orientation -1.57,0.00,0.00}{Tip 0.0000,0.0000,0.0000}";
    let conf = "CONF {Type Actuator} {Name Tilter} {Link 1} {JointType Revolute} {MaxTorque 600.0000} {MinValue -0.2618} {MaxValue 0.2618}";
    let scanner = "GEO {Type RangeScanner} {Name lms200} {Location 0.05,0.00,-0.05} {Orientation 0.00,0.00,0.00}{Mount Tilter}{MountLink 1}";
    let (rig, _) = learned(Dialect::Udk, "USARBot.P3AT", &[actuator, conf, scanner]);
    let tilt = rig.laser.as_ref().unwrap().head.tilt().unwrap();
    assert_eq!((tilt.core_per_wire, tilt.speed_rad_s), (-1.0, None));
    assert_eq!(tilt.limits.map(|l| (l.min_rad, l.max_rad)), Some((-0.2618, 0.2618)));
    let command = rig.head_commands(None, Some(Demand::Angle(0.25))).remove(0);
    assert_eq!(
        encode_command(&command, Dialect::Udk),
        b"ACT {Name Tilter} {Link 0} {Value -0.25}\r\n"
    );
    assert!(rig.head_commands(None, Some(Demand::Rate(0.1))).is_empty(), "UDK has no rates");
    let at = rig.robot_from_sensor(HeadPose::default()).translation.vector;
    assert!((at - Vector3::new(0.15, 0.0, 0.35)).norm() < 1e-9, "{at}");
    let Message::AsTa(state) = message("ASTA {Time 29.9739} {Name Tilter} {Link 1} {Value 0.1000}")
    else {
        panic!()
    };
    let reading = rig.actuator_reading(&state).unwrap();
    assert!((reading.tilt.unwrap().angle_rad + 0.1).abs() < 1e-12 && reading.pan.is_none());
}

#[test]
fn mountings_measured_at_a_heading_are_turned_back() {
    // A UDK robot created looking along the world's +y: the sensor 0.2 m ahead of it lies at y.
    let scanner = "GEO {Type RangeScanner} {Name lms200} {Location 0.00,0.20,-0.20} {Orientation 0.00,0.00,0.00}{Mount P3AT}";
    let mut builder = RigBuilder::new(Dialect::Udk, "USARBot.P3AT").standing_at([
        0.0,
        0.0,
        std::f64::consts::FRAC_PI_2,
    ]);
    builder.learn(&message(scanner));
    let at = builder.build().0.robot_from_sensor(HeadPose::default()).translation.vector;
    assert!((at - Vector3::new(0.2, 0.0, 0.2)).norm() < 1e-12, "{at}");
}

#[test]
fn readings_change_sides_between_wire_and_core() {
    let rig = stock();
    let Sen::Odometry(message) =
        sen("SEN {Type Odometry} {Name Odometry} {Pose 0.4265,0.1643,0.9105}")
    else {
        panic!()
    };
    let odometry = rig.odometry(&message);
    assert_eq!(odometry.odom_from_robot.translation.vector.as_slice(), [0.4265, -0.1643]);
    assert!((odometry.odom_from_robot.rotation.angle() + 0.9105).abs() < 1e-12);
    assert_eq!(odometry.stamp, None);

    let Sen::Ins(message) =
        sen("SEN {Type INS} {Name INS} {Location 0.80,-7.28,-0.45} {Orientation 0.00,6.23,0.10}")
    else {
        panic!()
    };
    let ins = rig.ins(&message);
    // 6.23 on the wire is 0.05 nose down, which is positive pitch in the core.
    assert!((ins.pitch_rad - (std::f64::consts::TAU - 6.23)).abs() < 1e-12);
    assert!((ins.yaw_rad + 0.10).abs() < 1e-12);
    assert!((ins.world_from_robot * Vector3::x()).z < 0.0, "the nose is down");
    assert_eq!(ins.place, Some(InertialPlace::new(0.80, 7.28, 0.45)));
}

#[test]
fn victims_are_placed_through_the_mount_of_their_sensor() {
    let scanner = scanner_on("HARD");
    let victims = "GEO {Type VictSensor} {Name VictSensor Location 0.0600,0.0000,-0.0087 Orientation 0.0000,0.0000,0.0000 Mount CameraPanTilt_Link2}";
    let lines = [P2AT, P2AT_CONF, &scanner, SCANNER_CONF, PAN_TILT, PAN_TILT_CONF, victims];
    let (rig, _) = learned(Dialect::Ut2004, "USARBot.P2AT", &lines);
    let Sen::VictSensor(message) = sen(
        "SEN {Type VictSensor} {Name VictimSensor} {PartName Leg} {Location 2.05,0.33,0.46} {PartName Arm} {Location 2.51,0.44,0.39}",
    ) else {
        panic!()
    };
    let seen = rig.victims(&message, HeadPose::default());
    let expected = Point3::new(0.1239 + 0.06 + 2.05, -0.33, 0.2635 + 0.0087 - 0.46);
    assert!((seen[0].p_robot - expected).norm() < 1e-6, "{:?}", seen[0]);
    assert_eq!((seen[0].part.as_str(), seen.len()), ("Leg", 2));
    let panned = rig.victims(&message, HeadPose { pan_rad: 0.5, tilt_rad: 0.0 });
    assert!(panned[0].p_robot.y > seen[0].p_robot.y, "the sensor turned left");
}

#[test]
fn sonars_know_where_they_look() {
    let geo = "GEO {Type Sonar} {Name F1 Location 0.1450,-0.1300,0.0000 Orientation 0.0002,0.0002,-1.5707 Mount HARD} {Name F2 Location 0.1850,-0.1150,0.0000 Orientation 0.0000,0.0000,-0.8727 Mount HARD}";
    let conf = "CONF {Type Sonar} {Name F1} {MaxRange 5.0000} {MinRange 0.1000} {BeamAngle 0.3491}";
    let (rig, _) = learned(Dialect::Ut2004, "USARBot.P2AT", &[P2AT, P2AT_CONF, geo, conf]);
    let Sen::Sonar(message) =
        sen("SEN {Time 5608.8500} {Type Sonar} {Name F1 Range 2.5098} {Name F2 Range 4.9950}")
    else {
        panic!()
    };
    let echoes = rig.sonar_echoes(&message);
    assert_eq!((echoes[0].echo, echoes[1].echo), (Echo::At(2.5098), Echo::Nothing));
    let axis = echoes[0].robot_from_sonar.rotation * Vector3::x();
    assert!((axis - Vector3::y()).norm() < 1e-3, "F1 looks to the left: {axis}");
}

#[test]
fn a_message_of_ground_truth_is_for_scoring_alone() {
    let line = "SEN {Time 5608.8500} {Type GroundTruth} {Name GroundTruth} {Location 12.61,-2.68,1.64} {Orientation 0.00,6.23,0.00}";
    let Message::GroundTruth(message) = message(line) else { panic!() };
    let truth = ScoringTruth::of(&message).unwrap();
    let at = truth.world_from_robot.translation.vector;
    assert!((at - Vector3::new(12.61, 2.68, -1.64)).norm() < 1e-12);
}
