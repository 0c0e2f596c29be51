//! Answers to GETGEO and GETCONF.

use super::robot::Robot;
use super::screen::corner;
use crate::protocol::command::Query;
use crate::protocol::message::{
    ActuatorConf, ActuatorGeo, ActuatorLinkConf, CameraConf, Conf, Geo, ItemConf, ItemsConf,
    ItemsGeo, Mounting as WireMounting, PackageConf, PackageGeo, PackageLinkConf, PackageLinkGeo,
    RangeScannerConf, RobotConf, RobotGeo, SonarConf, VictSensorConf,
};
use crate::protocol::{Dialect, Message, WirePose};
use crate::sim::pan_tilt::{Joint, PanTilt};
use crate::sim::sensor::{
    Device, Item, Mount, Mounting, UDK_CONES, UDK_MAX_INCIDENCE_RAD, UDK_TRACES, default_interval_s,
};
use crate::sim::spec::SensorKind;
use crate::sim::wire;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, PI};

/// UDK prints this for every link's speed; nothing enforces it.
const UDK_LINK_SPEED: f64 = 1.571;

/// What a UDK actuator reports as its torque.
const UDK_TORQUE: f64 = 600.0;

fn cut4(value: f64) -> f64 {
    wire::truncate(value, 4)
}

fn matches(query: &Query, name: &str) -> bool {
    query.name.as_deref().is_none_or(|asked| asked.is_empty() || asked.eq_ignore_ascii_case(name))
}

/// The name that an empty answer repeats, if one was asked for.
fn asked(query: &Query) -> Option<String> {
    query.name.clone().filter(|name| !name.is_empty())
}

/// The answer to GETGEO; `None` where UDK keeps silent.
pub(super) fn geo(robot: &Robot, query: &Query) -> Option<Message> {
    let type_name = query.type_name.as_str();
    if type_name.eq_ignore_ascii_case("Robot") {
        return Some(Message::Geo(Geo::Robot(robot_geo(robot))));
    }
    let udk = robot.dialect == Dialect::Udk;
    let units = || robot.units.iter().filter(|unit| matches(query, &unit.name));
    let answer = if type_name.eq_ignore_ascii_case("MisPkg") {
        if udk {
            return None;
        }
        let items: Vec<PackageGeo> = units().map(|unit| package_geo(robot, unit)).collect();
        Geo::MisPkg(items_geo("MisPkg", items, query))
    } else if udk && type_name.eq_ignore_ascii_case("Actuator") {
        let items: Vec<ActuatorGeo> = units().map(|unit| actuator_geo(robot, unit)).collect();
        if items.is_empty() {
            return None;
        }
        Geo::Actuator(items_geo("Actuator", items, query))
    } else {
        let of_type = |item: &&Item| item.kind.name().eq_ignore_ascii_case(type_name);
        // Answered as the type is spelt here; one that nothing has, as it was asked.
        let type_name = robot.suite.items.iter().find(of_type).map_or(type_name, |i| i.kind.name());
        let items: Vec<WireMounting> = robot
            .suite
            .items
            .iter()
            .filter(of_type)
            .map(|item| item.device.mounting())
            .filter(|mounting| matches(query, &mounting.name))
            .map(|mounting| mounting_geo(robot, mounting))
            .collect();
        if udk && items.is_empty() {
            return None;
        }
        Geo::Items(items_geo(type_name, items, query))
    };
    Some(Message::Geo(answer))
}

fn items_geo<T>(type_name: &str, items: Vec<T>, query: &Query) -> ItemsGeo<T> {
    let not_found = if items.is_empty() { asked(query) } else { None };
    ItemsGeo { type_name: type_name.to_owned(), items, not_found, extra: Vec::new() }
}

fn robot_geo(robot: &Robot) -> RobotGeo {
    let class = &robot.class;
    let wheels = &class.wheels;
    RobotGeo {
        vehicle_type: Some("GroundVehicle".to_owned()),
        name: class.short_name().to_owned(),
        dimensions_m: Some(class.wire.dimensions_m.unwrap_or_else(|| class.extents_m()).map(cut4)),
        cog_m: Some(class.wire.cog_m.map(cut4)),
        wheel_radius_m: Some(cut4(wheels.radius_m)),
        wheel_separation_m: Some(cut4(wheels.separation_m)),
        wheel_base_m: Some(cut4(wheels.base_m)),
        extra: Vec::new(),
    }
}

/// Where a sensor is mounted, as the dialect computes it.
///
/// UT2004 gives the pose in the part's frame. UDK subtracts world positions and Euler angles without
/// turning them into the body, so that its answer is right only at zero attitude.
fn mounting_geo(robot: &Robot, mounting: &Mounting) -> WireMounting {
    let (mount, mount_link) = match (&mounting.mount, robot.dialect) {
        (Mount::Body, Dialect::Ut2004) => ("HARD".to_owned(), None),
        (Mount::Link { unit, link }, Dialect::Ut2004) => {
            (format!("{}_Link{}", robot.units[*unit].name, link + 1), None)
        }
        (Mount::Wheel(name), Dialect::Ut2004) => (name.clone(), None),
        (Mount::Link { unit, link }, Dialect::Udk) => {
            (robot.units[*unit].name.clone(), Some(*link as i64 + 1))
        }
        (Mount::Body | Mount::Wheel(_), Dialect::Udk) => {
            (robot.class.short_name().to_owned(), None)
        }
    };
    let pose = match robot.dialect {
        Dialect::Ut2004 => {
            let pose = wire::pose(&mounting.part_from_sensor);
            WirePose {
                location: pose.location.map(cut4),
                orientation: pose.orientation.map(wire::angle),
            }
        }
        Dialect::Udk => {
            let carrier = robot.carrier();
            let place = wire::engine_pose(&robot.vehicle.state().world_from_robot);
            let base = place * carrier.robot_from_part(&mounting.mount);
            let sensor = base * mounting.part_from_sensor;
            let pose = difference(&wire::pose(&sensor), &wire::pose(&base));
            WirePose {
                location: pose.location.map(|value| wire::round(value, 2)),
                orientation: pose.orientation.map(|value| wire::round(value, 2)),
            }
        }
    };
    WireMounting { name: mounting.name.clone(), pose, mount, mount_link }
}

fn difference(a: &WirePose, b: &WirePose) -> WirePose {
    let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    WirePose {
        location: minus(a.location, b.location),
        orientation: minus(a.orientation, b.orientation),
    }
}

/// Joint frames of a unit: each one's z axis is its joint's axis, in the parent's static frame.
///
/// The second location is computed as the server does, from world positions turned back by the
/// static frame alone: right only on level ground at zero angles, or straight above the pan joint.
fn joint_frames(robot: &Robot, unit: &PanTilt) -> [WirePose; 2] {
    let place = wire::engine_pose(&robot.vehicle.state().world_from_robot);
    let pan = place * unit.robot_from_link(0);
    let tilt = place * unit.robot_from_link(1);
    // A roll by π turns wire axes into x forward, y left, z up: the core's.
    let apart = tilt.translation.vector - pan.translation.vector;
    [
        WirePose { location: wire::vector(&unit.position), orientation: [PI, 0.0, 0.0] },
        WirePose { location: apart.into(), orientation: [FRAC_PI_2, 0.0, 0.0] },
    ]
}

fn package_geo(robot: &Robot, unit: &PanTilt) -> PackageGeo {
    let links = (1_i64..)
        .zip(joint_frames(robot, unit))
        .map(|(link, pose)| PackageLinkGeo {
            link,
            parent_link: if link == 1 { -1 } else { link - 1 },
            pose: Some(WirePose {
                location: pose.location.map(cut4),
                orientation: pose.orientation.map(wire::angle),
            }),
        })
        .collect();
    PackageGeo { name: unit.name.clone(), links }
}

fn actuator_geo(robot: &Robot, unit: &PanTilt) -> ActuatorGeo {
    let at = |pose: WirePose| WirePose {
        location: pose.location.map(|value| wire::truncate(value, 3)),
        orientation: pose.orientation.map(|value| wire::round(value, 2)),
    };
    let [pan, tilt] = joint_frames(robot, unit);
    let base = WirePose { location: pan.location, orientation: [0.0; 3] };
    let zero = WirePose { location: [0.0; 3], ..pan };
    ActuatorGeo {
        mounting: WireMounting {
            name: unit.name.clone(),
            pose: at(base),
            mount: robot.class.short_name().to_owned(),
            mount_link: None,
        },
        links: [(1, zero), (2, tilt)]
            .map(|(link, pose)| PackageLinkGeo {
                link,
                parent_link: link - 1,
                pose: Some(at(pose)),
            })
            .to_vec(),
        tip: Some(Vector3::zeros().into()),
    }
}

/// The answer to GETCONF; `None` where UDK keeps silent.
pub(super) fn conf(robot: &Robot, query: &Query) -> Option<Message> {
    let type_name = query.type_name.as_str();
    if type_name.eq_ignore_ascii_case("Robot") {
        return Some(Message::Conf(Conf::Robot(robot_conf(robot))));
    }
    let udk = robot.dialect == Dialect::Udk;
    let units = || robot.units.iter().filter(|unit| matches(query, &unit.name));
    if type_name.eq_ignore_ascii_case("MisPkg") {
        let items: Vec<PackageConf> = units().map(|unit| package_conf(robot, unit)).collect();
        return answer(udk, "MisPkg", items, query, Conf::MisPkg);
    }
    if udk && type_name.eq_ignore_ascii_case("Actuator") {
        let items: Vec<ActuatorConf> = units().map(actuator_conf).collect();
        return answer(udk, "Actuator", items, query, Conf::Actuator);
    }
    let items: Vec<&Item> = robot
        .suite
        .items
        .iter()
        .filter(|item| item.kind.name().eq_ignore_ascii_case(type_name))
        .filter(|item| matches(query, &item.device.mounting().name))
        .collect();
    // A battery has a place and nothing else to tell.
    let speaks = |kind: &SensorKind| *kind != SensorKind::Battery;
    let Some(kind) = items.first().map(|item| item.kind).filter(speaks) else {
        return answer(udk, type_name, Vec::<ItemConf>::new(), query, Conf::Item);
    };
    let name = kind.name();
    match kind {
        SensorKind::RangeScanner => {
            answer(udk, name, collect(&items, scanner_conf), query, Conf::RangeScanner)
        }
        SensorKind::Sonar => {
            let sonar = |item: &Item| sonar_conf(item, udk);
            answer(udk, name, collect(&items, sonar), query, Conf::Sonar)
        }
        SensorKind::Ir | SensorKind::Range => {
            let beam = |item: &Item| beam_conf(item, udk);
            answer(udk, name, collect(&items, beam), query, Conf::Sonar)
        }
        SensorKind::IrScanner => {
            answer(udk, name, collect(&items, ir_scanner_conf), query, Conf::RangeScanner)
        }
        SensorKind::VictSensor => {
            answer(udk, name, collect(&items, victims_conf), query, Conf::VictSensor)
        }
        SensorKind::Camera => {
            let confs = camera_confs(robot, query);
            answer(udk, name, confs, query, Conf::Camera)
        }
        _ => {
            let confs = items.iter().map(|item| item_conf(item, robot.dialect)).collect();
            answer(udk, name, confs, query, Conf::Item)
        }
    }
}

fn collect<T>(items: &[&Item], of: impl Fn(&Item) -> Option<T>) -> Vec<T> {
    items.iter().filter_map(|item| of(item)).collect()
}

fn answer<T>(
    udk: bool,
    type_name: &str,
    items: Vec<T>,
    query: &Query,
    wrap: impl Fn(ItemsConf<T>) -> Conf,
) -> Option<Message> {
    if items.is_empty() && udk {
        return None;
    }
    let extra = match asked(query).filter(|_| items.is_empty()) {
        Some(name) => vec![crate::protocol::Segment::new("Name", &name)],
        None => Vec::new(),
    };
    let conf = ItemsConf { type_name: type_name.to_owned(), items, extra };
    Some(Message::Conf(wrap(conf)))
}

fn robot_conf(robot: &Robot) -> RobotConf {
    let class = &robot.class;
    // UDK computes in single precision: 1.3 prints as 1.2999.
    let spin = match robot.dialect {
        Dialect::Ut2004 => cut4(class.wheels.max_spin_rps),
        Dialect::Udk => (f64::from(class.wheels.max_spin_rps as f32 - 1e-7) * 1e4).trunc() / 1e4,
    };
    RobotConf {
        vehicle_type: "GroundVehicle".to_owned(),
        name: class.short_name().to_owned(),
        steering_type: Some("SkidSteered".to_owned()),
        mass_kg: Some(cut4(class.wire.mass_kg.unwrap_or_else(|| class.mass_kg()))),
        max_spin_rad_s: Some(spin),
        max_torque: Some(cut4(class.wire.max_torque.unwrap_or(60.0))),
        max_front_steer_rad: Some(0.0),
        max_rear_steer_rad: Some(0.0),
        extra: Vec::new(),
    }
}

/// A joint's limits as configured; no limit is told by the first being the greater.
fn range_of(joint: &Joint, decimals: i32) -> [Option<f64>; 2] {
    joint.range_rad.map(|bound| Some(wire::truncate(bound, decimals)))
}

fn package_conf(robot: &Robot, unit: &PanTilt) -> PackageConf {
    let udk = robot.dialect == Dialect::Udk;
    let links = (1_i64..)
        .zip(&unit.joints)
        .map(|(link, joint)| {
            let [min_range, max_range] = range_of(joint, if udk { 4 } else { 2 });
            let speed = if udk { UDK_LINK_SPEED } else { wire::truncate(joint.top_speed_rps, 2) };
            PackageLinkConf {
                link,
                joint_type: "Revolute".to_owned(),
                max_speed: Some(speed),
                max_torque: Some(wire::truncate(unit.torque, 2)),
                min_range,
                max_range,
            }
        })
        .collect();
    PackageConf { name: unit.name.clone(), links, extra: Vec::new() }
}

fn actuator_conf(unit: &PanTilt) -> ActuatorConf {
    let links = (1_i64..)
        .zip(&unit.joints)
        .map(|(link, joint)| {
            let [min_value, max_value] = range_of(joint, 4);
            ActuatorLinkConf {
                link,
                joint_type: "Revolute".to_owned(),
                max_torque: Some(UDK_TORQUE),
                min_value,
                max_value,
            }
        })
        .collect();
    ActuatorConf { name: unit.name.clone(), links, extra: Vec::new() }
}

fn scanner_conf(item: &Item) -> Option<RangeScannerConf> {
    let Device::Scanner(scanner) = &item.device else { return None };
    Some(RangeScannerConf {
        name: scanner.mounting.name.clone(),
        max_range_m: Some(cut4(scanner.max_range_m)),
        min_range_m: Some(cut4(scanner.min_range_m)),
        resolution_rad: Some(wire::angle(scanner.resolution_rad)),
        fov_rad: Some(wire::angle(scanner.fov_rad)),
        panning: Some(true),
        tilting: Some(false),
        extra: Vec::new(),
    })
}

fn sonar_conf(item: &Item, udk: bool) -> Option<SonarConf> {
    let Device::Sonar(sonar) = &item.device else { return None };
    let mut conf = SonarConf {
        name: sonar.mounting.name.clone(),
        max_range_m: Some(cut4(sonar.max_range_m)),
        min_range_m: Some(cut4(sonar.min_range_m)),
        // Here a server rounds: 20° is 0.3490 cut and 0.3491 in the recorded answers.
        beam_angle_rad: Some(wire::round(sonar.beam_rad, 4)),
        ..SonarConf::default()
    };
    if udk {
        conf.scan_interval_s = Some(cut4(item.interval_s.unwrap_or(0.2)));
        conf.beam_angle_rad = Some(wire::angle(sonar.beam_rad));
        conf.max_incidence_rad = Some(cut4(UDK_MAX_INCIDENCE_RAD));
        conf.traces_per_cone = Some(UDK_TRACES as i64);
        conf.cones = Some(UDK_CONES as i64);
    }
    Some(conf)
}

fn beam_conf(item: &Item, udk: bool) -> Option<SonarConf> {
    let Device::Beam(beam) = &item.device else { return None };
    Some(SonarConf {
        name: beam.mounting.name.clone(),
        max_range_m: Some(cut4(beam.max_range_m)),
        min_range_m: Some(cut4(beam.min_range_m)),
        scan_interval_s: udk
            .then(|| cut4(item.interval_s.unwrap_or(default_interval_s(item.kind)))),
        ..SonarConf::default()
    })
}

fn ir_scanner_conf(item: &Item) -> Option<RangeScannerConf> {
    let Device::IrScanner(scanner) = &item.device else { return None };
    Some(RangeScannerConf {
        name: scanner.beam.mounting.name.clone(),
        max_range_m: Some(cut4(scanner.beam.max_range_m)),
        min_range_m: Some(cut4(scanner.beam.min_range_m)),
        resolution_rad: Some(wire::angle(scanner.resolution_rad)),
        fov_rad: Some(wire::angle(scanner.fov_rad)),
        panning: Some(scanner.yaw),
        tilting: Some(false),
        extra: Vec::new(),
    })
}

fn victims_conf(item: &Item) -> Option<VictSensorConf> {
    let Device::Victims(sensor) = &item.device else { return None };
    let fov_rad = Some(wire::truncate(sensor.fov_rad, 4));
    Some(VictSensorConf {
        name: sensor.mounting.name.clone(),
        max_range_m: Some(cut4(sensor.max_range_m)),
        horizontal_fov_rad: fov_rad,
        vertical_fov_rad: fov_rad,
        extra: Vec::new(),
    })
}

/// Configurations of the robot's cameras; UDK's tiles lie in a 2×2 grid in order of creation.
pub(super) fn camera_confs(robot: &Robot, query: &Query) -> Vec<CameraConf> {
    let udk = robot.dialect == Dialect::Udk;
    let cameras = robot.suite.items.iter().filter_map(|item| match &item.device {
        Device::Camera(camera) => Some(camera),
        _ => None,
    });
    cameras
        .enumerate()
        .filter(|(_, camera)| matches(query, &camera.mounting.name))
        .map(|(tile, camera)| {
            let [width, height] = camera.size.map(i64::from);
            let offset = corner(robot.first_tile + tile).map(i64::from);
            let unit = |fov_rad: f64| {
                Some(if udk { wire::round(fov_rad.to_degrees(), 4) } else { cut4(fov_rad) })
            };
            CameraConf {
                name: camera.mounting.name.clone(),
                tile_offset: udk.then_some(offset),
                tile_size: udk.then_some([width, height]),
                default_fov: unit(camera.default_fov_rad),
                min_fov: unit(camera.min_fov_rad),
                max_fov: unit(camera.max_fov_rad),
                fov: unit(camera.fov_rad),
                extra: Vec::new(),
            }
        })
        .collect()
}

fn item_conf(item: &Item, dialect: Dialect) -> ItemConf {
    let mut conf = ItemConf { name: item.device.mounting().name.clone(), ..ItemConf::default() };
    let interval = item.interval_s.unwrap_or(match dialect {
        Dialect::Ut2004 => 0.2,
        Dialect::Udk => default_interval_s(item.kind),
    });
    match &item.device {
        Device::Encoder(encoder) => conf.resolution_rad = Some(cut4(encoder.resolution_rad)),
        Device::Odometry(odometry) => {
            conf.scan_interval_s = Some(interval);
            if dialect == Dialect::Ut2004 {
                conf.encoder_resolution_rad = Some(cut4(odometry.encoder_resolution_rad));
            }
        }
        Device::Bumper(bumper) if dialect == Dialect::Udk => {
            conf.diameter_m = Some(cut4(bumper.diameter_m));
        }
        Device::Bumper(_) | Device::Tags(_) | Device::Releaser(_) => {}
        _ => conf.scan_interval_s = Some(interval),
    }
    conf
}
