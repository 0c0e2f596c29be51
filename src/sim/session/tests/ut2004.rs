use super::*;

/// The verbs and types of a burst, in order.
fn shape(lines: &[String]) -> Vec<String> {
    lines
        .iter()
        .map(|line| {
            let verb = line.split(' ').next().unwrap();
            let kind = line.split("{Type ").nth(1).and_then(|rest| rest.split('}').next());
            if verb == "SEN" { kind.unwrap().to_owned() } else { verb.to_owned() }
        })
        .collect()
}

#[test]
fn bursts_come_in_the_recorded_order_with_the_state_last() {
    let mut client = Client::new(YELLOW, &scenario(""));
    client.send("INIT {ClassName USARBot.P2DX} {Location 4.5,1.9,1.8} {Name R1}");
    client.run(1.0);
    let shape = shape(&client.lines[1..]);
    let bursts: Vec<&[String]> = shape.split_inclusive(|kind| kind == "STA").collect();
    let recorded = ["Encoder", "RFID", "GroundTruth", "GPS", "MISSTA", "STA"];
    assert_eq!(bursts[0], recorded, "the first burst");
    let recorded = [
        "Sonar",
        "RangeScanner",
        "INS",
        "Odometry",
        "Encoder",
        "GroundTruth",
        "GPS",
        "MISSTA",
        "STA",
    ];
    assert_eq!(bursts[1], recorded);
    assert_eq!(bursts[3][5], "VictSensor", "in every fourth burst");
}

#[test]
fn bursts_are_as_far_apart_as_in_the_recording() {
    let mut client = Client::spawned("P3AT", "");
    client.run(30.0);
    let times: Vec<f64> = client
        .of_type("GroundTruth")
        .iter()
        .map(|line| parse(line.as_bytes()).message.time().unwrap().seconds())
        .collect();
    let gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    assert!((mean - 0.2).abs() < 0.002, "{mean}");
    assert!(gaps.iter().all(|gap| (0.159..0.231).contains(gap)), "{gaps:?}");
    assert!(gaps.iter().any(|gap| *gap < 0.175) && gaps.iter().any(|gap| *gap > 0.21));
}

#[test]
fn the_scanner_is_stamped_with_the_burst_before_and_cast_in_between() {
    let mut client = Client::spawned("P3AT", "");
    client.session.take_casts(client.id);
    client.run(3.0);
    let stamps: Vec<String> = client
        .lines
        .iter()
        .filter(|line| line.contains("RangeScanner") || line.starts_with("STA"))
        .map(|line| line.split("{Time ").nth(1).unwrap().split('}').next().unwrap().to_owned())
        .collect();
    // Laser, state, laser, state: a laser line carries the stamp of the state before it.
    for window in stamps.windows(3).skip(1).step_by(2) {
        assert_eq!(window[0], window[1], "{stamps:?}");
    }
    for cast in client.session.take_casts(client.id) {
        let late = (cast.cast_at - cast.printed).seconds();
        assert!((0.1..0.14).contains(&late), "{late}");
    }
}

#[test]
fn a_straight_wall_shows_the_noise_of_the_recording() {
    let mut client = Client::spawned("P3AT", "");
    client.run(20.0);
    // Beam 90 looks straight ahead at the east wall, 5 m away, from 0.05 m ahead of the origin.
    let values: Vec<f64> =
        client.of_type("RangeScanner").iter().map(|line| ranges(line)[90]).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let relative: Vec<f64> = values.iter().map(|value| value / mean - 1.0).collect();
    let sigma = (relative.iter().map(|r| r * r).sum::<f64>() / values.len() as f64).sqrt();
    assert!((mean - 4.95).abs() < 0.01, "{mean}");
    assert!((sigma - 0.000_577).abs() < 0.000_1, "uniform ±0.1 %: {sigma}");
    assert!(relative.iter().all(|r| r.abs() < 0.00125));
    assert!(
        values
            .iter()
            .all(|value| (value * 1e4).fract().abs() < 1e-6 || (value * 1e4).fract() > 1.0 - 1e-6)
    );
}

#[test]
fn beam_one_is_the_rightmost() {
    let world = "name = \"m\"\nbounds = [-5.0, -5.0, 5.0, 5.0]\n\
                 [[box]]\ncenter = [0.0, 0.0, -0.5]\nsize = [30.0, 30.0, 1.0]\n\
                 [[box]]\nname = \"right\"\ncenter = [0.0, -2.1, 1.0]\nsize = [3.0, 0.2, 2.0]\n";
    let mut client = Client::new(
        world,
        &scenario(
            "[noise]
range_relative = 0.0
",
        ),
    );
    client.send("INIT {ClassName USARBot.P3AT} {Name R1}");
    client.run(1.5);
    let line = ranges(client.of_type("RangeScanner")[1]);
    assert_eq!(line.len(), 181);
    assert!((line[0] - 2.0).abs() < 0.01, "{}", line[0]);
    assert_eq!(line[180], 20.0, "nothing to the left");
}

#[test]
fn the_laser_rides_on_the_tilt() {
    let mut client = Client::spawned("P3AT", "");
    client.send("MISPKG {Name CameraPanTilt} {Link 2} {Value -0.5}");
    client.run(6.0);
    let down = ranges(client.of_type("RangeScanner").last().unwrap())[90];
    // 0.56 m of axis height, the optical centre 5 cm ahead and 4 cm above it, half a radian down.
    let (sin, cos) = 0.5_f64.sin_cos();
    let height = 0.56 + 0.04 * cos - 0.05 * sin;
    assert!((down - height / sin).abs() < 0.02, "{down} {}", height / sin);
    let status = client.lines.iter().rfind(|line| line.starts_with("MISSTA")).unwrap();
    assert!(status.contains("{Link 2} {Value -0.49"), "{status}");
    assert!((client.truth().tilt_rad - 0.5).abs() < 1e-4, "the core's tilt is positive down");
}

#[test]
fn the_units_status_can_be_switched_off() {
    let quiet = "[[robot.pan_tilt]]\nname = \"CameraPanTilt\"\nstatus = false\n";
    let mut client = Client::new(BOX, &format!("{}{quiet}", scenario("")));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1}");
    client.run(2.0);
    assert!(!client.lines.is_empty());
    assert!(client.lines.iter().all(|line| !line.starts_with("MISSTA")));
}

#[test]
fn odometry_and_encoders_agree_and_heading_is_clockwise() {
    let mut client = Client::spawned("P3AT", "[noise]\nencoder = 0.0\n");
    client.send("DRIVE {Left 2.0} {Right 1.0}");
    client.run(2.5);
    client.send("DRIVE {Left 0} {Right 0}");
    client.run(1.0);
    let Message::Sen(Sen::Odometry(odometry)) =
        parse(client.of_type("Odometry").last().unwrap().as_bytes()).message
    else {
        panic!()
    };
    assert!(odometry.theta_rad > 0.3, "a right turn is positive: {}", odometry.theta_rad);
    assert!(odometry.y_m > 0.02, "and leads to positive y: {}", odometry.y_m);
    let Message::Sen(Sen::Encoder(encoder)) =
        parse(client.of_type("Encoder").last().unwrap().as_bytes()).message
    else {
        panic!()
    };
    // Counts fall while rolling forward; the difference is the heading.
    let [left, right] = [encoder.readings[0].tick, encoder.readings[1].tick];
    let heading = (right - left) as f64 * 0.01745 * 0.11 / 0.40;
    assert!(left < right && (heading - odometry.theta_rad).abs() < 0.01, "{heading}");
    // The body turned less than its wheels say.
    let yaw = client.truth().world_from_robot.rotation.euler_angles().2;
    assert!(yaw < -0.1 && yaw > -0.9 * odometry.theta_rad, "{yaw} {}", odometry.theta_rad);
}

#[test]
fn the_document_s_samples_are_answered_as_it_says() {
    let mut client = Client::new(YELLOW, &scenario(""));
    client.run(0.1);
    assert_eq!(
        client.ask("GETSTARTPOSES", "NFO"),
        "NFO {StartPoses 3} {PlayerStart 4.50,1.90,1.80 0.00,0.00,0.00 \
         StartB 1.20,5.60,1.80 0.00,0.00,-1.57 StartC 8.80,2.00,1.80 0.00,0.00,-3.14}"
    );
    client.send("INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.5,1.9,1.8}");
    for (question, answer) in [
        (
            "GETGEO {Type Robot}",
            "GEO {Type GroundVehicle} {Name P2AT} {Dimensions 0.5238,0.4968,0.2913} {COG 0.0000,0.0000,0.0000} {WheelRadius 0.1300} {WheelSeparation 0.4712} {WheelBase 0.2884}",
        ),
        (
            "GETCONF {Type Robot}",
            "CONF {Type GroundVehicle} {Name P2AT} {SteeringType SkidSteered} {Mass 14.0000} {MaxSpeed 5.3850} {MaxTorque 60.0000} {MaxFrontSteer 0.0000} {MaxRearSteer 0.0000}",
        ),
        (
            "GETGEO {Type RangeScanner}",
            "GEO {Type RangeScanner} {Name Scanner1 Location 0.1439,0.0000,-0.0920 Orientation 0.0000,0.0000,0.0000 Mount HARD}",
        ),
        (
            "GETCONF {Type RangeScanner}",
            "CONF {Type RangeScanner} {Name Scanner1} {MaxRange 20.0000} {MinRange 0.1000} {Resolution 0.0174} {Fov 3.1415} {Paning True} {Tilting False}",
        ),
        (
            "GETCONF {Type Sonar} {Name r8}",
            "CONF {Type Sonar} {Name R8} {MaxRange 5.0000} {MinRange 0.1000} {BeamAngle 0.3491}",
        ),
        (
            "GETCONF {Type Odometry}",
            "CONF {Type Odometry} {Name Odometry} {ScanInterval 0.2000} {EncoderResolution 0.0099}",
        ),
        (
            "GETGEO {Type MisPkg}",
            "GEO {Type MisPkg} {Name CameraPanTilt} {Link 1} {ParentLink -1} {Location 0.1239,0.0000,-0.2036} {Orientation 3.1415,0.0000,0.0000} {Link 2} {ParentLink 1} {Location 0.0000,0.0000,0.0599} {Orientation 1.5707,0.0000,0.0000}",
        ),
        (
            "GETCONF {Type MisPkg}",
            "CONF {Type MisPkg} {Name CameraPanTilt} {Link 1} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00} {MinRange 1} {MaxRange 0} {Link 2} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00} {MinRange -0.16} {MaxRange 0.40}",
        ),
        ("GETGEO {Type Nothing}", "GEO {Type Nothing}"),
        ("GETCONF {Type Sonar} {Name X}", "CONF {Type Sonar} {Name X}"),
    ] {
        assert_eq!(client.ask(question, &question[3..6]), answer);
    }
}

#[test]
fn one_question_of_each_kind_is_answered_per_tick() {
    let mut client = Client::spawned("P2AT", "");
    for question in ["GETGEO {Type Robot}", "GETGEO {Type Sonar}", "GETCONF {Type Robot}"] {
        client.send(question);
    }
    client.run(0.06);
    let count = |client: &Client, verb| client.lines.iter().filter(|l| l.starts_with(verb)).count();
    assert_eq!((count(&client, "GEO"), count(&client, "CONF")), (1, 1));
    client.run(0.06);
    assert_eq!(count(&client, "GEO"), 2, "the other waited its turn");
}

#[test]
fn a_bad_class_and_an_occupied_place_get_silence() {
    let mut client = Client::new(BOX, &scenario(""));
    client.send("INIT {ClassName USARBot.Tank} {Name R1}");
    client.send("GETGEO {Type Robot}");
    client.run(2.0);
    assert_eq!(client.lines.len(), 1, "the greeting alone: {:?}", client.lines);
    client.send("INIT {ClassName USARBot.P2AT} {Name R1} {Start StartA}");
    client.run(1.0);
    assert!(client.lines.len() > 10);
    let second = client.session.connect();
    client.session.receive(second, b"INIT {ClassName USARBot.P2AT} {Name R2} {Start StartA}\r\n");
    client.run(1.0);
    assert_eq!(client.session.take_output(second).iter().filter(|b| **b == b'\n').count(), 1);
}

#[test]
fn a_client_that_leaves_takes_its_robot_along() {
    let mut client = Client::spawned("P3AT", "");
    client.session.disconnect(client.id);
    assert!(client.session.is_closed(client.id) && client.session.truth(client.id).is_none());
    assert_eq!(client.session.truth_by_name("R1").unwrap().name, "R1");
    client.id = client.session.connect();
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    client.run(1.0);
    assert!(client.session.truth(client.id).is_some());
}

#[test]
fn a_second_init_binds_the_socket_to_a_new_robot() {
    let mut client = Client::spawned("P3AT", "");
    client.send("INIT {ClassName USARBot.P2AT} {Name R2} {Start StartB}");
    client.run(1.0);
    assert_eq!(client.truth().name, "R2");
    assert_eq!(client.session.robot_names(), ["R1", "R2"]);
    client.session.disconnect(client.id);
    client.session.advance(Span::from_millis(100));
    assert!(client.session.truth(client.id).is_none());
}

#[test]
fn drive_takes_percent_and_one_side_and_stops() {
    let mut client = Client::spawned("P3AT", "");
    client.send("DRIVE {Left 50} {Right 50} {Normalized true}");
    client.run(2.0);
    assert!((client.truth().speed_mps - 0.35).abs() < 0.02, "{}", client.truth().speed_mps);
    client.send("DRIVE {Left 0}{Right 0}");
    client.run(1.5);
    assert!(client.truth().speed_mps < 0.001);
    client.send("DRIVE {Left 1.0}");
    client.run(1.0);
    let turn = client.truth().angular_rps.z;
    assert!(turn < -0.05, "the left side alone turns right: {turn}");
}

#[test]
fn a_wheel_joint_turns_its_side_and_one_that_is_not_there_fails() {
    let mut client = Client::spawned("P3AT", "");
    let set = |name: &str, opcode: &str| {
        format!("SET {{Type Joint}} {{Name {name}}} {{Opcode {opcode}}} {{Params 1.0}}")
    };
    let answer = client.ask(&set("leftRWheel", "Velocity"), "RES");
    assert!(answer.ends_with("{Status OK}"), "{answer}");
    client.run(1.0);
    let turn = client.truth().angular_rps.z;
    assert!(turn < -0.05, "the left side alone turns right: {turn}");
    for refused in [set("LeftFFlipper", "Velocity"), set("LeftWheel", "1"), set("RightFWheel", "0")]
    {
        let answer = client.ask(&refused, "RES");
        assert!(answer.ends_with("{Status Failed}"), "{refused}: {answer}");
    }
}

#[test]
fn the_battery_counts_down_and_takes_the_sensors_along() {
    let mut client = Client::new(BOX, &format!("{}battery_s = 3.0\n", scenario("")));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1}");
    client.send("DRIVE {Left 1} {Right 1}");
    client.run(1.6);
    assert!(client.lines.last().unwrap().contains("{Battery 1}"), "{:?}", client.lines.last());
    client.run(2.0);
    client.lines.clear();
    client.run(1.0);
    assert!(client.lines.iter().all(|line| line.starts_with("STA")), "{:?}", client.lines);
    assert!(client.lines[0].contains("{Battery 0}"));
    assert!(client.truth().speed_mps < 0.001);
}

#[test]
fn victims_are_seen_by_their_parts() {
    let mut client = Client::new(BOX, &scenario(""));
    // In front of the sitting victim, two metres away, looking at it.
    client.send(
        "INIT {ClassName USARBot.P2AT} {Name R1} {Location 3.9,1.2,-0.2} {Rotation 0,0,1.5708}",
    );
    client.run(4.0);
    let seen = client.of_type("VictSensor");
    let parts: Vec<&&String> = seen.iter().filter(|line| line.contains("PartName")).collect();
    assert!(!parts.is_empty(), "{seen:?}");
    let Message::Sen(Sen::VictSensor(reading)) = parse(parts[0].as_bytes()).message else {
        panic!()
    };
    assert!(reading.parts.len() >= 3, "{reading:?}");
    assert!(reading.parts.iter().all(|part| (0.5..3.0).contains(&part.location[0])), "{reading:?}");
}

#[test]
fn tags_are_read_and_written() {
    let mut client = Client::spawned("P2AT", "");
    let read = "SET {Type RFID} {Name RFID} {Opcode Read} {Params 101}";
    assert!(
        client
            .ask(read, "RES")
            .ends_with("{Type RFID} {Name RFID} {Status OK} {ID 101} {Mem east door}")
    );
    let write = "SET {Type RFID} {Name RFID} {Opcode Write} {Params 101 two words}";
    assert!(client.ask(write, "RES").ends_with("{Name RFID} {Status OK}"));
    assert!(client.ask(read, "RES").ends_with("{Mem two words}"));
    let release = "SET {Type RFIDReleaser} {Name Gun} {Opcode Release}";
    assert!(client.ask(release, "RES").ends_with("{Type RFIDReleaser} {Name Gun} {Status OK}"));
    client.run(1.2);
    let tags = client.of_type("RFID");
    assert!(tags.iter().any(|line| line.contains("{ID 102} {Location")), "{tags:?}");
    let failed = "SET {Type Nothing} {Name x} {Opcode y}";
    assert!(client.ask(failed, "RES").ends_with("{Type Nothing} {Name x} {Status Failed}"));
}

#[test]
fn a_scan_on_demand_is_stamped_with_its_own_time() {
    let mut client = Client::spawned("P3AT", "");
    client.send("SET {Type RangeScanner} {Name Scanner1} {Opcode Scan}");
    client.run(0.06);
    let answer = client.lines.iter().position(|line| line.starts_with("RES")).unwrap();
    let scan = parse(client.lines[answer + 1].as_bytes()).message;
    let age = (client.session.now() - scan.time().unwrap()).seconds();
    assert!(age < 0.07, "{age}");
    assert!(matches!(scan, Message::Sen(Sen::RangeScanner(_))));
}

#[test]
fn robots_see_and_bump_each_other() {
    let mut client = Client::spawned("P3AT", "");
    let other = client.session.connect();
    client.session.receive(
        other,
        b"INIT {ClassName USARBot.P2AT} {Name R2} {Location 2.0,0,-0.2} {Rotation 0,0,3.14}\r\n",
    );
    client.run(2.0);
    // At 0.6 m the paper robot's laser passes over a P2AT; its sonars do not.
    let sonar = client.of_type("Sonar").last().unwrap().to_string();
    let front: f64 =
        sonar.split("{Name F4 Range ").nth(1).unwrap().split('}').next().unwrap().parse().unwrap();
    assert!((1.3..1.8).contains(&front), "{sonar}");
    client.send("DRIVE {Left 3} {Right 3}");
    client.run(8.0);
    let struck = client.session.truth_by_name("R2").unwrap();
    assert!(struck.world_from_robot.translation.x > 2.05, "pushed along");
    assert!(client.truth().collisions > 0 && struck.collisions > 0);
}

#[test]
fn a_robot_on_its_side_is_flipped_back_within_three_seconds() {
    let mut client = Client::new(BOX, &scenario(""));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Location 0,0,-0.5} {Rotation 1.6,0,0}");
    client.run(2.0);
    assert!(client.truth().toppled);
    client.send("DRIVE {Flip true}");
    client.run(5.0);
    assert!(!client.truth().toppled);
}

#[test]
fn one_seed_gives_the_same_bytes_and_another_does_not() {
    let run = |seed: u64| {
        let mut client = Client::spawned("P3AT", &format!("seed = {seed}\n"));
        client.send("DRIVE {Left 2} {Right 3}");
        client.run(3.0);
        client.lines.concat()
    };
    let first = run(1);
    assert_eq!(first, run(1));
    assert_ne!(first, run(2));
}

#[test]
fn how_time_is_cut_into_calls_does_not_matter() {
    let run = |pieces_ms: &[i64]| {
        let mut session = session(BOX, &scenario(""));
        let id = session.connect();
        session.receive(id, b"INIT {ClassName USARBot.P3AT} {Name R1}\r\n");
        let mut bytes = Vec::new();
        for piece in pieces_ms {
            session.advance(Span::from_millis(*piece));
            bytes.extend(session.take_output(id));
        }
        bytes
    };
    assert_eq!(run(&[2000]), run(&[1, 7, 192, 800, 500, 500]));
}

#[test]
fn a_world_controller_moves_robots_and_hears_nothing_unasked() {
    let mut client = Client::spawned("P2AT", "");
    let controller = client.session.connect();
    let say = |client: &mut Client, line: &str| {
        client.session.receive(controller, format!("{line}\r\n").as_bytes());
        client.run(0.3);
        String::from_utf8(client.session.take_output(controller)).unwrap()
    };
    // Before it has said what it is, nothing happens.
    say(&mut client, "CONTROL {Type AbsMove} {Name R1} {Location 1,2,-0.3}");
    assert!(client.truth().world_from_robot.translation.vector.xy().norm() < 0.1);
    say(&mut client, "INIT {ClassName USARBot.WorldController} {Name WC}");
    assert_eq!(say(&mut client, "CONTROL {Type AbsMove} {Name R1} {Location 1,2,-0.3}"), "");
    let place = client.truth().world_from_robot.translation.vector;
    assert!((place.x - 1.0).abs() < 0.05 && (place.y + 2.0).abs() < 0.05, "{place}");
    say(&mut client, "CONTROL {Type RelMove} {Name R1} {Location -1,0,-0.1}");
    let state = say(&mut client, "CONTROL {Type GetSTA} {Name R1}");
    assert!(state.starts_with("STA {Name R1} {Size 0.5484,0.5512,0.4050}"), "{state}");
    assert!(state.contains("{Location -0.0") || state.contains("{Location 0.0"), "{state}");
    assert_eq!(say(&mut client, "CONTROL {Type GetSTA} {Name R7}"), "");
}

#[test]
fn words_for_numbers_count_as_zero_and_never_reach_the_wire() {
    let mut client = Client::spawned("P3AT", "");
    let answer = client.ask("SET {Type Camera} {Name Camera} {Opcode Zoom} {Params nan}", "RES");
    assert!(answer.contains("{FOV 0.7853} {Status OK}"), "0 resets: {answer}");
    client.ask(
        "SET {Type INS} {Name INS} {Opcode POSE} {Params nan,inf,-infinity,NaN,1e9,2.5}",
        "RES",
    );
    client.lines.clear();
    client.run(0.5);
    let lines = client.of_type("INS");
    let estimate = lines.last().expect("no INS line");
    assert!(estimate.contains("{Location 0.00,0.00,0.00}"), "{estimate}");
}
