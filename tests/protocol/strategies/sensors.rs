//! Sensor lines.

use super::{by, extra, grid, name, pose, time, vector, word};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use usar_agent::protocol::message::sen::*;
use usar_agent::protocol::message::{GroundTruth, Sen};
use usar_agent::protocol::{Dialect, Message};

pub fn sensor(dialect: Dialect) -> BoxedStrategy<Message> {
    let sen = prop_oneof![ranges(dialect), images(dialect), robot(), things(), world()];
    prop_oneof![8 => sen.prop_map(Message::Sen), 1 => ground_truth(dialect)].boxed()
}

fn ground_truth(dialect: Dialect) -> impl Strategy<Value = Message> {
    (time(4), any::<bool>(), name(), pose(by(dialect, 2, 3)), extra()).prop_map(
        |(time, movable, name, pose, extra)| {
            Message::GroundTruth(GroundTruth { time, movable, name, pose, extra })
        },
    )
}

fn ranges(dialect: Dialect) -> BoxedStrategy<Sen> {
    let decimals = by(dialect, 4, 2);
    let scan =
        (
            time(by(dialect, 2, 4)),
            name(),
            option::of(grid(4)),
            option::of(grid(4)),
            vec(grid(decimals), 0..200),
            extra(),
        )
            .prop_map(|(time, name, resolution_rad, fov_rad, ranges_m, extra)| {
                RangeScanner { time, name, resolution_rad, fov_rad, ranges_m, extra }
            });
    let reading = (name(), grid(4)).prop_map(|(name, range_m)| RangeReading { name, range_m });
    let readings = (time(4), vec(reading, 0..5), extra())
        .prop_map(|(time, readings, extra)| RangeReadings { time, readings, extra });
    prop_oneof![
        scan.clone().prop_map(Sen::RangeScanner),
        scan.prop_map(Sen::IrScanner),
        readings.clone().prop_map(Sen::Sonar),
        readings.clone().prop_map(Sen::Range),
        readings.prop_map(Sen::Ir),
    ]
    .boxed()
}

fn images(dialect: Dialect) -> BoxedStrategy<Sen> {
    let hundredths = (0_u32..2000).prop_map(|steps| f64::from(steps) / 100.0);
    let strip =
        (time(by(dialect, 2, 4)), name(), option::of(vec(hundredths, 0..50)), 0_i64..20, extra())
            .prop_map(|(time, name, ranges_m, frame, extra)| {
                Sen::RangeImager(RangeImager {
                    time,
                    name,
                    resolution: vec![320.0, 240.0],
                    fov_rad: vec![1.0122, 0.5886],
                    frames: Some(20),
                    frame: Some(frame),
                    ranges_m,
                    extra,
                })
            });
    let cloud = (time(4), name(), any::<bool>())
        .prop_flat_map(|(time, name, rotating)| {
            let points = vec(vector(if rotating { 2 } else { 4 }), 1..20);
            (Just((time, name, rotating)), points, extra())
        })
        .prop_map(|((time, name, rotating), points, extra)| {
            Sen::PointCloud(PointCloud { time, name, points, rotating, extra })
        });
    let line = (time(4), name(), option::of(vector(3)), vec(vector(3), 0..9), extra()).prop_map(
        |(time, name, location, points, extra)| {
            Sen::LineLaser(LineLaser { time, name, location, points, extra })
        },
    );
    prop_oneof![strip, cloud, line].boxed()
}

fn robot() -> BoxedStrategy<Sen> {
    let odometry = (time(4), name(), vector(4), extra()).prop_map(|(time, name, pose, extra)| {
        let [x_m, y_m, theta_rad] = pose;
        Sen::Odometry(Odometry { time, name, x_m, y_m, theta_rad, extra })
    });
    let ins = (time(4), name(), pose(2), extra())
        .prop_map(|(time, name, pose, extra)| Sen::Ins(Ins { time, name, pose, extra }));
    let inu = (time(4), name(), vector(2), extra()).prop_map(|(time, name, angles, extra)| {
        Sen::Inu(Inu { time, name, orientation_rad: angles, extra })
    });
    let tick = (name(), -9999_i64..9999).prop_map(|(name, tick)| EncoderReading { name, tick });
    let encoder = (time(4), vec(tick, 0..5), extra())
        .prop_map(|(time, readings, extra)| Sen::Encoder(Encoder { time, readings, extra }));
    let tachometer = (time(4), name(), vec(grid(4), 0..5), vec(grid(4), 0..5), extra()).prop_map(
        |(time, name, velocities_rad_s, positions_rad, extra)| {
            Sen::Tachometer(Tachometer { time, name, velocities_rad_s, positions_rad, extra })
        },
    );
    let bumper = (name(), any::<bool>()).prop_map(|(name, touched)| TouchReading { name, touched });
    let touch = (time(4), vec(bumper, 0..4), extra()).prop_map(|(time, readings, extra)| Touch {
        time,
        readings,
        extra,
    });
    let three = [option::of(vector(4)), option::of(vector(4)), option::of(vector(4))];
    let imu = (time(4), name(), three, option::of(vector(4)), extra()).prop_map(
        |(time, name, [acceleration, angular_velocity, angular_acceleration], rotation, extra)| {
            Sen::Imu(Imu {
                time,
                name,
                acceleration,
                angular_velocity,
                angular_acceleration,
                rotation,
                extra,
            })
        },
    );
    let acceleration = (time(4), name(), vector(4), any::<bool>(), extra()).prop_map(
        |(time, name, acceleration, proper, extra)| {
            Sen::Acceleration(Acceleration { time, name, acceleration, proper, extra })
        },
    );
    prop_oneof![
        odometry,
        ins,
        inu,
        encoder,
        tachometer,
        touch.clone().prop_map(Sen::Touch),
        touch.prop_map(Sen::TouchArray),
        imu,
        acceleration,
    ]
    .boxed()
}

fn things() -> BoxedStrategy<Sen> {
    let part = (word(), vector(2)).prop_map(|(part, location)| VictimPart { part, location });
    let victims = (time(4), name(), option::of(word()), vec(part, 0..4), extra()).prop_map(
        |(time, name, status, parts, extra)| {
            Sen::VictSensor(VictSensor { time, name, status, parts, extra })
        },
    );
    let tag = (name(), option::of(word()), option::of(vector(2)));
    let tags = (time(4), name(), vec(tag, 1..4), any::<bool>(), extra()).prop_map(
        |(time, name, tags, long_keys, extra)| {
            let tag = |(id, status, location)| VictimTag { id, name: None, status, location };
            let tags = tags.into_iter().map(tag).collect();
            Sen::VictRfid(VictRfid { time, name, tags, long_keys, extra })
        },
    );
    let rfid = ("[0-9]{1,5}", option::of(vector(2)), option::of(name()))
        .prop_map(|(id, location, memory)| RfidTag { id, location, memory });
    let rfids =
        (time(4), name(), vec(rfid, 0..4), extra()).prop_map(|(time, name, tags, extra)| {
            Sen::Rfid(Rfid { time, type_name: "RFID".to_owned(), name, tags, extra })
        });
    let object = (word(), pose(4), option::of(vector(4)), option::of(word()))
        .prop_map(|(tag, pose, hit, material)| SeenObject { tag, pose, hit, material });
    let objects =
        (time(4), name(), vec(object, 0..3), extra()).prop_map(|(time, name, objects, extra)| {
            Sen::ObjectSensor(ObjectSensor { time, name, objects, extra })
        });
    let motion =
        (time(4), name(), grid(4), extra()).prop_map(|(time, name, probability, extra)| {
            Sen::HumanMotion(HumanMotion { time, name, probability, extra })
        });
    let ball = (time(4), name(), option::of(vector(4)), option::of(any::<bool>()), extra())
        .prop_map(|(time, name, position, visible, extra)| {
            Sen::Ball(Ball { time, name, position, visible, extra })
        });
    prop_oneof![victims, tags, rfids, objects, motion, ball].boxed()
}

fn world() -> BoxedStrategy<Sen> {
    let coordinate = (0_i64..180, 0_u32..599_999, "[NSEW]").prop_map(|(degrees, steps, letter)| {
        let minutes = f64::from(steps) / 1e4;
        GeoCoordinate { degrees, minutes, hemisphere: letter.chars().next().unwrap() }
    });
    let coordinate = option::of(coordinate);
    let gps = (time(4), name(), [coordinate.clone(), coordinate], option::of(0_i64..2), extra())
        .prop_map(|(time, name, [latitude, longitude], fix, extra)| {
            Sen::Gps(Gps { time, name, latitude, longitude, fix, satellites: Some(5), extra })
        });
    let altitude = (time(4), name(), option::of(grid(4)), option::of(grid(4)), extra()).prop_map(
        |(time, name, relative_m, absolute_m, extra)| {
            Sen::Altitude(Altitude { time, name, relative_m, absolute_m, extra })
        },
    );
    let compass =
        (time(4), name(), grid(4), extra()).prop_map(|(time, name, magnetic_angle, extra)| {
            Sen::Compass(Compass { time, name, magnetic_angle, extra })
        });
    let minutes = (time(4), name(), 0_i64..99, extra()).prop_map(|(time, name, minutes, extra)| {
        Sen::MissionTime(MissionTime { time, name, minutes, extra })
    });
    let gas = (time(4), name(), word(), grid(2), extra()).prop_map(
        |(time, name, gas, density, extra)| Sen::Gas(Gas { time, name, gas, density, extra }),
    );
    let sound = (time(4), name(), option::of(grid(4)), option::of(grid(4)), extra()).prop_map(
        |(time, name, loudness, duration_s, extra)| {
            Sen::Sound(Sound { time, name, loudness, duration_s, extra })
        },
    );
    let near = (vector(3), vector(3)).prop_map(|(direction, [volume, duration_s, delay_s])| {
        HeardSound::Near { direction, volume, duration_s, delay_s }
    });
    let acoustic = (time(4), name(), 0_usize..3, vec(near, 0..3), extra()).prop_map(
        |(time, name, far, near, extra)| {
            let sounds = vec![HeardSound::Far; far].into_iter().chain(near).collect();
            Sen::Acoustic(Acoustic { time, name, sounds, extra })
        },
    );
    prop_oneof![gps, altitude, compass, minutes, gas, sound, acoustic].boxed()
}
