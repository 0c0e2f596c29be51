//! Motion, height, compass, clock and objects on the wire of a UDK server.

use super::*;

/// An accelerometer of each kind, the plain one turned to the left.
const RIG: &str = "[[robot.sensor]]\ntype = \"Accel\"\nname = \"Acc\"\nrpy_deg = [0.0, 0.0, 90.0]\n\
    [[robot.sensor]]\ntype = \"AcceleroMeter\"\nname = \"Heavy\"\n\
    [[robot.sensor]]\ntype = \"IMU\"\nname = \"IMU\"\n\
    [[robot.sensor]]\ntype = \"MagneticCompass\"\nname = \"Compass\"\n\
    [[robot.sensor]]\ntype = \"AltitudeSensor\"\nname = \"Height\"\n\
    [[robot.sensor]]\ntype = \"MissionTime\"\nname = \"Time\"\n\
    [[robot.sensor]]\ntype = \"ObjectSensor\"\nname = \"Eye\"\nposition = [0.24, 0.0, 0.2]\n";

/// A robot dropped from half a metre in the middle of the box.
fn dropped() -> Client {
    let mut client = Client::new(BOX, &format!("{}{RIG}", scenario("dialect = \"udk\"")));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Location 0,0,-0.5}");
    client.run(3.0);
    client.lines.clear();
    client
}

/// Time and the numbers of `key` in the lines of a sensor.
fn series(client: &Client, sensor: &str, key: &str) -> Vec<(f64, Vec<f64>)> {
    let of = |line: &&String| {
        let value = line.split(&format!("{{{key} ")).nth(1).expect(line).split('}').next()?;
        let numbers = value.split(',').map(|number| number.parse().unwrap()).collect();
        Some((parse(line.as_bytes()).message.time().expect(line).seconds(), numbers))
    };
    client.of_type(sensor).iter().filter_map(of).collect()
}

/// Sum of one of the numbers over time.
fn integral(series: &[(f64, Vec<f64>)], axis: usize) -> f64 {
    series.windows(2).map(|pair| (pair[1].0 - pair[0].0) * pair[1].1[axis]).sum()
}

#[test]
fn the_lines_have_the_forms_of_the_reference() {
    let mut client = dropped();
    client.run(1.0);
    let end = |sensor: &str| {
        let line = client.of_type(sensor).last().expect(sensor).as_str();
        let (head, rest) = line.split_once(&format!("{{Type {sensor}}} ")).unwrap();
        assert!(head.starts_with("SEN {Time "), "{line}");
        rest.to_owned()
    };
    assert_eq!(end("MagneticCompass"), "{Name Compass} {MagneticAngle 0.0000}");
    assert_eq!(end("MissionTime"), "{Name Time} {Minutes 0}");
    assert!(end("Accel").starts_with("{Name Acc} {Acceleration "));
    assert!(end("AcceleroMeter").starts_with("{Name Heavy} {ProperAcceleration "));
    let imu = end("IMU");
    let keys: Vec<&str> = imu.split('{').map(|part| part.split(' ').next().unwrap()).collect();
    let expected = ["", "Name", "XYZAcceleration", "AngularVel", "AngularAccel", "Rotation"];
    assert_eq!(keys, expected, "{imu}");
    let decimals = imu.split([',', ' ', '}']).filter_map(|word| word.split_once('.'));
    assert!(decimals.clone().count() == 12 && decimals.clone().all(|(_, cut)| cut.len() == 4));
}

#[test]
fn height_counts_from_the_spawn_and_from_the_sea() {
    let mut client = dropped();
    client.run(0.5);
    let fallen = client.truth().world_from_robot.translation.z - 0.5;
    assert!(fallen < -0.2, "it fell by {fallen}");
    let of = |key: &str| series(&client, "AltitudeSensor", key).last().unwrap().1[0];
    assert!((of("relativeAltitude") - fallen).abs() < 0.002);
    assert!((of("absoluteAltitude") - 111.0 - fallen).abs() < 0.002);
}

#[test]
fn acceleration_sums_up_to_the_speed_in_the_sensors_frame() {
    let mut client = dropped();
    client.run(0.5);
    client.send("DRIVE {Left 1.2} {Right 1.2}");
    client.run(2.0);
    let speed = client.truth().speed_mps;
    assert!(speed > 0.08, "{speed}");
    let felt = series(&client, "Accel", "Acceleration");
    // The sensor looks to the left, so what pushes forward comes from its right: positive y.
    assert!((integral(&felt, 1) - speed).abs() < 0.02, "{} of {speed}", integral(&felt, 1));
    assert!(integral(&felt, 0).abs() < 0.02);
    let heavy = series(&client, "AcceleroMeter", "ProperAcceleration");
    let mean = heavy.iter().map(|(_, it)| it[2]).sum::<f64>() / heavy.len() as f64;
    assert!((mean - 9.81).abs() < 0.05, "gravity pulls down: {mean}");
}

#[test]
fn the_inertial_unit_s_rates_sum_up_to_its_turn() {
    let mut client = dropped();
    client.run(0.5);
    client.send("DRIVE {Left 1.2} {Right -1.2}");
    client.run(3.0);
    let rates = series(&client, "IMU", "AngularVel");
    let attitude = series(&client, "IMU", "Rotation");
    let turned = attitude.last().unwrap().1[2] - attitude[0].1[2];
    assert!(turned > 0.3, "to the right is positive: {turned}");
    assert!((integral(&rates, 2) - turned).abs() < 0.005, "{} of {turned}", integral(&rates, 2));
    let truth = -client.truth().world_from_robot.rotation.euler_angles().2;
    let [.., last] = attitude[attitude.len() - 1].1[..] else { panic!("{attitude:?}") };
    assert!((last - truth).abs() < 0.1, "{last} of {truth}");
}

#[test]
fn minutes_count_from_the_spawn() {
    let mut client = dropped();
    client.run(58.0);
    let minutes = series(&client, "MissionTime", "Minutes");
    assert_eq!([minutes[0].1[0], minutes.last().unwrap().1[0]], [0.0, 1.0]);
    let changed = minutes.iter().find(|(_, value)| value[0] == 1.0).unwrap().0;
    let spawned = minutes[0].0 - 3.0;
    assert!((changed - spawned - 60.0).abs() < 0.3, "{changed} {spawned}");
}

#[test]
fn objects_are_told_once_with_their_place_and_where_a_beam_met_them() {
    let mut client = dropped();
    client.run(1.0);
    let line = client.of_type("ObjectSensor").last().expect("no line").as_str();
    assert!(line.starts_with("SEN {Type ObjectSensor} {Name Eye} {Object "), "{line}");
    let east = "{Object wall_east}{Location 5.1000,0.0000,-1.2500}\
                {Orientation 0.0000,0.0000,0.0000}{HitLoc ";
    let rest = line.split(east).nth(1).expect(line);
    let (hit, rest) = rest.split_once('}').unwrap();
    let hit: Vec<f64> = hit.split(',').map(|number| number.parse().unwrap()).collect();
    assert!((hit[0] - 5.0).abs() < 0.001, "on its face: {hit:?}");
    assert!(rest.starts_with("{Material Structure}"), "{rest}");
    for seen in ["wall_east", "wall_north", "cabinet", "crate", "column"] {
        assert_eq!(line.matches(&format!("{{Object {seen}}}")).count(), 1, "{seen} in {line}");
    }
    assert!(!line.contains("{Object wall_west}"), "behind it: {line}");
}

#[test]
fn they_answer_what_they_are_and_are_refused_in_the_other_dialect() {
    let mut client = dropped();
    assert_eq!(
        client.ask("GETCONF {Type IMU}", "CONF"),
        "CONF {Type IMU} {Name IMU} {ScanInterval 0.1000}"
    );
    assert_eq!(
        client.ask("GETCONF {Type ObjectSensor}", "CONF"),
        "CONF {Type ObjectSensor} {Name Eye} {ScanInterval 0.5000}"
    );
    assert_eq!(
        client.ask("GETGEO {Type AltitudeSensor}", "GEO"),
        "GEO {Type AltitudeSensor} {Name Height} {Location 0.00,0.00,0.00} {Orientation 0.00,0.00,0.00}{Mount P3AT}"
    );
    let world = World::new(&MapFile::parse(BOX).unwrap(), &BTreeMap::new()).unwrap();
    let catalogue = RobotCatalogue::parse(include_str!("../../../../maps/robots.toml")).unwrap();
    let wrong = Scenario::parse(&format!("{}{RIG}", scenario(""))).unwrap();
    let refused = Session::new(&world, &wrong, &catalogue).err().expect("UT2004 has no IMU");
    assert!(refused.to_string().contains("found IMU"), "{refused}");
}
