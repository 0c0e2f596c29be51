//! Everything but sensor lines.

use super::{by, extra, grid, joints, name, pose, poses, time, vector, word};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use usar_agent::protocol::message::*;
use usar_agent::protocol::{Dialect, Message, RawLine};

pub fn reply(dialect: Dialect) -> BoxedStrategy<Message> {
    prop_oneof![
        2 => nfo(dialect).prop_map(Message::Nfo),
        2 => sta(dialect).prop_map(Message::Sta),
        1 => object().prop_map(Message::ObjectSta),
        2 => links(dialect),
        1 => eff().prop_map(Message::Eff),
        4 => geo(dialect).prop_map(Message::Geo),
        4 => conf(dialect).prop_map(Message::Conf),
        2 => res().prop_map(Message::Res),
        1 => (option::of(word()), option::of(word()), extra()).prop_map(
            |(killer, damage_type, extra)| Message::Die(Die { killer, damage_type, extra })
        ),
        1 => ("[A-Z]{7,9}", extra())
            .prop_map(|(verb, segments)| Message::Unknown(RawLine { verb, segments })),
    ]
    .boxed()
}

fn nfo(dialect: Dialect) -> BoxedStrategy<Nfo> {
    let decimals = by(dialect, 2, 4);
    let greeting = (name(), name(), option::of(0_i64..99), extra()).prop_map(
        |(gametype, level, time_limit, extra)| {
            Nfo::Greeting(Greeting { gametype, level, time_limit, extra })
        },
    );
    prop_oneof![
        greeting,
        poses(decimals).prop_map(Nfo::StartPoses),
        poses(decimals).prop_map(Nfo::PathNodes),
        (word(), vector(4)).prop_map(|(name, location)| Nfo::ClosestNode { name, location }),
    ]
    .boxed()
}

fn sta(dialect: Dialect) -> impl Strategy<Value = Sta> {
    let numbers = (option::of(0_i64..99_999), option::of(0_i64..100), option::of(-1_i64..5));
    (
        (option::of(word()), time(by(dialect, 2, 4)), option::of(any::<bool>())),
        (option::of(grid(4)), option::of(grid(4)), joints()),
        numbers,
        extra(),
    )
        .prop_map(|(head, (front_steer_rad, rear_steer_rad, joints), numbers, extra)| Sta {
            vehicle_type: head.0,
            time: head.1,
            light_on: head.2,
            front_steer_rad,
            rear_steer_rad,
            joints,
            battery_s: numbers.0,
            light_intensity: numbers.1,
            view: numbers.2,
            extra,
        })
}

fn object() -> impl Strategy<Value = ObjectSta> {
    (name(), vector(4), option::of(vector(4)), option::of(word()), option::of(vector(4)), extra())
        .prop_map(|(name, size, location, memory, rotation, extra)| ObjectSta {
            name,
            size,
            location,
            memory: memory.unwrap_or_default(),
            rotation,
            extra,
        })
}

fn links(dialect: Dialect) -> BoxedStrategy<Message> {
    let link = |torque_decimals| {
        (1_i64..9, grid(4), option::of(grid(torque_decimals)))
            .prop_map(|(link, value, torque)| LinkState { link, value, torque })
    };
    let decimals = by(dialect, 2, 4);
    let package = (time(by(dialect, 2, 4)), name(), vec(link(decimals), 0..4), extra()).prop_map(
        |(time, name, links, extra)| Message::MisSta(MisSta { time, name, links, extra }),
    );
    let actuator = (time(4), name(), vec(link(4), 0..4), extra())
        .prop_map(|(time, name, links, extra)| Message::AsTa(AsTa { time, name, links, extra }));
    prop_oneof![package, actuator].boxed()
}

fn eff() -> impl Strategy<Value = Eff> {
    let state = (option::of(word()), option::of(any::<bool>()));
    (time(4), word(), name(), state, option::of(word()), option::of(word()), extra()).prop_map(
        |(time, type_name, name, (status, on), tool_type, tool, extra)| Eff {
            time,
            type_name,
            name,
            status,
            on,
            tool_type,
            tool,
            extra,
        },
    )
}

fn geo(dialect: Dialect) -> BoxedStrategy<Geo> {
    let robot = (
        name(),
        [option::of(vector(4)), option::of(vector(4))],
        [(); 3].map(|()| option::of(grid(4))),
        extra(),
    )
        .prop_map(|(name, [dimensions_m, cog_m], [radius, separation, base], extra)| {
            Geo::Robot(RobotGeo {
                vehicle_type: Some("GroundVehicle".to_owned()),
                name,
                dimensions_m,
                cog_m,
                wheel_radius_m: radius,
                wheel_separation_m: separation,
                wheel_base_m: base,
                extra,
            })
        });
    let mount_link = by(dialect, Just(None).boxed(), option::of(1_i64..5).boxed());
    let mounting = (name(), pose(by(dialect, 4, 2)), word(), mount_link.clone())
        .prop_map(|(name, pose, mount, mount_link)| Mounting { name, pose, mount, mount_link });
    let items = (vec(mounting, 0..4), extra()).prop_map(|(items, extra)| {
        Geo::Items(ItemsGeo { type_name: "Sonar".to_owned(), items, not_found: None, extra })
    });
    let missing = name().prop_map(|name| {
        let type_name = "Sonar".to_owned();
        Geo::Items(ItemsGeo { type_name, items: vec![], not_found: Some(name), extra: vec![] })
    });
    let link = (1_i64..9, -1_i64..9, option::of(pose(4)))
        .prop_map(|(link, parent_link, pose)| PackageLinkGeo { link, parent_link, pose });
    let package = (name(), vec(link, 1..4)).prop_map(|(name, links)| PackageGeo { name, links });
    let packages = (vec(package, 0..3), extra()).prop_map(|(items, extra)| {
        Geo::MisPkg(ItemsGeo { type_name: "MisPkg".to_owned(), items, not_found: None, extra })
    });
    // Locations have 3 decimals, orientations 2.
    let uneven = (vector(3), vector(2)).prop_map(|(location, orientation)| {
        usar_agent::protocol::WirePose { location, orientation }
    });
    let link = (1_i64..9, 0_i64..9, option::of(uneven.clone()))
        .prop_map(|(link, parent_link, pose)| PackageLinkGeo { link, parent_link, pose });
    let actuator =
        (name(), uneven, word(), option::of(1_i64..5), vec(link, 0..4), option::of(vector(4)))
            .prop_map(|(name, pose, mount, mount_link, links, tip)| ActuatorGeo {
                mounting: Mounting { name, pose, mount, mount_link },
                links,
                tip,
            });
    let actuators = (vec(actuator, 0..3), extra()).prop_map(|(items, extra)| {
        Geo::Actuator(ItemsGeo { type_name: "Actuator".to_owned(), items, not_found: None, extra })
    });
    prop_oneof![robot, items, missing, packages, actuators].boxed()
}

fn items<T: std::fmt::Debug>(
    type_name: &'static str,
    item: impl Strategy<Value = T>,
) -> impl Strategy<Value = ItemsConf<T>> {
    vec(item, 0..4).prop_map(move |items| ItemsConf {
        type_name: type_name.to_owned(),
        items,
        extra: Vec::new(),
    })
}

fn conf(dialect: Dialect) -> BoxedStrategy<Conf> {
    let four = || [(); 4].map(|()| option::of(grid(4)));
    let robot = (name(), option::of(word()), [(); 5].map(|()| option::of(grid(4))), extra())
        .prop_map(
            |(name, steering_type, [mass_kg, max_spin_rad_s, max_torque, front, rear], extra)| {
                Conf::Robot(RobotConf {
                    vehicle_type: "GroundVehicle".to_owned(),
                    name,
                    steering_type,
                    mass_kg,
                    max_spin_rad_s,
                    max_torque,
                    max_front_steer_rad: front,
                    max_rear_steer_rad: rear,
                    extra,
                })
            },
        );
    let scanner = (name(), four(), option::of(any::<bool>()), option::of(any::<bool>()), extra())
        .prop_map(|(name, [max, min, resolution, fov], panning, tilting, extra)| {
            RangeScannerConf {
                name,
                max_range_m: max,
                min_range_m: min,
                resolution_rad: resolution,
                fov_rad: fov,
                panning,
                tilting,
                extra,
            }
        });
    let sonar = (name(), four(), option::of(grid(4)), option::of(0_i64..99), extra()).prop_map(
        |(name, [max, min, interval, beam], incidence, rays, extra)| SonarConf {
            name,
            max_range_m: max,
            min_range_m: min,
            scan_interval_s: interval,
            beam_angle_rad: beam,
            max_incidence_rad: incidence,
            traces_per_cone: rays,
            cones: rays,
            extra,
        },
    );
    let victims = (name(), [(); 3].map(|()| option::of(grid(4))), extra()).prop_map(
        |(name, [max_range_m, horizontal_fov_rad, vertical_fov_rad], extra)| VictSensorConf {
            name,
            max_range_m,
            horizontal_fov_rad,
            vertical_fov_rad,
            extra,
        },
    );
    let pixels = || option::of([0_i64..640, 0_i64..480]);
    let camera = (name(), pixels(), pixels(), four(), extra()).prop_map(
        |(name, tile_offset, tile_size, [default_fov, min_fov, max_fov, fov], extra)| CameraConf {
            name,
            tile_offset,
            tile_size,
            default_fov,
            min_fov,
            max_fov,
            fov,
            extra,
        },
    );
    let gripper = (name(), vec((word(), pixels()), 0..3), extra())
        .prop_map(|(name, opcodes, extra)| GripperConf { name, opcodes, extra });
    let item = (name(), option::of(grid(2)), option::of(grid(4)), option::of(grid(4)), extra())
        .prop_map(|(name, scan_interval_s, resolution_rad, diameter_m, extra)| ItemConf {
            name,
            scan_interval_s,
            resolution_rad,
            encoder_resolution_rad: None,
            diameter_m,
            extra,
        });
    prop_oneof![
        robot,
        items("RangeScanner", scanner).prop_map(Conf::RangeScanner),
        items("Sonar", sonar).prop_map(Conf::Sonar),
        items("VictSensor", victims).prop_map(Conf::VictSensor),
        items("Camera", camera).prop_map(Conf::Camera),
        items("Gripper", gripper).prop_map(Conf::Gripper),
        items("Encoder", item).prop_map(Conf::Item),
        items("MisPkg", package(dialect)).prop_map(Conf::MisPkg),
        items("Actuator", actuator()).prop_map(Conf::Actuator),
    ]
    .boxed()
}

fn package(dialect: Dialect) -> impl Strategy<Value = PackageConf> {
    let link = (
        1_i64..9,
        word(),
        option::of(grid(by(dialect, 2, 3))),
        option::of(grid(2)),
        [grid(by(dialect, 2, 4)), grid(by(dialect, 2, 4))],
        any::<bool>(),
    )
        .prop_map(|(link, joint_type, max_speed, max_torque, mut limits, limited)| {
            limits.sort_by(f64::total_cmp);
            let [min_range, max_range] = if limited { limits } else { [1.0, 0.0] }.map(Some);
            PackageLinkConf { link, joint_type, max_speed, max_torque, min_range, max_range }
        });
    (name(), vec(link, 0..4), extra()).prop_map(|(name, links, extra)| PackageConf {
        name,
        links,
        extra,
    })
}

fn actuator() -> impl Strategy<Value = ActuatorConf> {
    let link = (1_i64..9, word(), [(); 3].map(|()| option::of(grid(4)))).prop_map(
        |(link, joint_type, [max_torque, min_value, max_value])| ActuatorLinkConf {
            link,
            joint_type,
            max_torque,
            min_value,
            max_value,
        },
    );
    (name(), vec(link, 0..4), extra()).prop_map(|(name, links, extra)| ActuatorConf {
        name,
        links,
        extra,
    })
}

fn res() -> BoxedStrategy<Res> {
    let item = (name(), any::<bool>(), option::of("[0-9]{1,4}"), option::of(name()))
        .prop_map(|(name, ok, id, memory)| SetResult::Item { name, ok, id, memory });
    let camera = (name(), grid(4), any::<bool>()).prop_map(|(name, fov_rad, ok)| CameraResult {
        name,
        fov_rad,
        ok,
    });
    let cameras = vec(camera, 1..3).prop_map(SetResult::Cameras);
    let views = (word(), any::<bool>(), vec((word(), any::<bool>()), 0..5))
        .prop_map(|(config, ok, views)| SetResult::Viewports { config, ok, views });
    (time(2), word(), prop_oneof![item, cameras, views], extra())
        .prop_map(|(time, type_name, result, extra)| Res { time, type_name, result, extra })
        .boxed()
}
