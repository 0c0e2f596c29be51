use super::*;
use crate::protocol::message::LinkState;
use std::collections::BTreeMap;

/// A P3AT with a pan-tilt that carries the laser, an odometer and a depth camera.
const RIG: &str = "[[robot.pan_tilt]]\nname = \"Head\"\nposition = [0.0, 0.0, 0.3]\n\
    tilt_offset = [0.0, 0.0, 0.1]\npan_limits_rad = [-2.0, 2.0]\ntilt_limits_rad = [-1.0, 1.0]\n\
    spring_hz = 3.0\nspring_damping = 0.4\n\
    [[robot.sensor]]\ntype = \"RangeScanner\"\nname = \"lms200\"\nmount = \"Head_Link2\"\n\
    fov_deg = 179.996\nresolution_deg = 1.0\ninterval_s = 0.2\n\
    [[robot.sensor]]\ntype = \"Odometry\"\nname = \"Odometer\"\n\
    [[robot.sensor]]\ntype = \"RangeImager\"\nname = \"KinectDepth\"\nposition = [0.2, 0.0, 0.3]\n\
    [[robot.sensor]]\ntype = \"Sonar\"\nname = \"F1\"\nposition = [0.2, 0.0, 0.0]\n";

fn udk(more: &str) -> Client {
    let mut client = Client::new(BOX, &format!("{}{more}", scenario("dialect = \"udk\"")));
    client.send("INIT {Classname USARBot.P3AT} {Name R1} {Start starta}");
    client.run(1.0);
    client
}

fn number(line: &str, key: &str) -> f64 {
    let value = line.split(&format!("{{{key} ")).nth(1).expect(line).split('}').next().unwrap();
    value.parse().unwrap_or_else(|_| panic!("{key} of {line}"))
}

#[test]
fn the_lines_have_the_forms_of_the_reference() {
    let client = udk(RIG);
    let line = |start: &str| {
        let found = client.lines.iter().find(|line| line.contains(start));
        found.unwrap_or_else(|| panic!("no {start} in {:?}", client.lines)).as_str()
    };
    assert!(client.lines[0].ends_with("{TimeLimit 20}"));
    let sta = line("STA {Time ");
    let rest = "{Battery 1200} {Type GroundVehicle} {LightToggle False} {LightIntensity 100} \
                {FrontSteer 0} {RearSteer 0}";
    assert!(sta.ends_with(rest), "{sta}");
    assert!(line("ASTA ").contains("{Name Head} {Link 1} {Value "));
    assert!(line("{Type INS}").starts_with("SEN {Type INS} {Name InsTest} {Location "));
    assert!(line("{Type Odometry}").starts_with("SEN {Time "));
    assert!(line("{Type Sonar}").contains("{Name F1} {Range "));
    assert!(line("{Name W1}").contains("{Type Encoder} {Name W1} {Tick "));
    let scan = line("{Type RangeScanner}");
    assert!(scan.contains("{Resolution 0.0174} {FOV 3.1414} {Range "), "{scan}");
    assert!(line("{Type RangeImager}").ends_with(
        "{Name KinectDepth} {Resolution 320,240} {FOV 1.0122,0.7853} {Frames 0} {Frame 0}"
    ));
    let conf = client.lines.iter().filter(|line| line.starts_with("CONF")).collect::<Vec<_>>();
    assert_eq!(conf.len(), 1, "one for the camera, unasked");
    assert!(conf[0].starts_with("CONF {Type Camera} {Name Camera}{TextureOffsetX 0}"));
}

#[test]
fn the_document_s_samples_are_answered_as_it_says() {
    let mut client = Client::new(YELLOW, &scenario("dialect = \"udk\""));
    client.run(0.1);
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Location 4.5,1.9,1.8}");
    client.run(2.0);
    for (question, answer) in [
        (
            "GETGEO {Type Robot}",
            "GEO {Type GroundVehicle} {Name P3AT} {Dimensions 0.2480,0.3600,0.0000} {COG 0.0000,0.0000,0.0000} {WheelRadius 0.0980} {WheelSeparation 0.3600} {WheelBase 0.2480}",
        ),
        (
            "GETCONF {Type Robot}",
            "CONF {Name P3AT} {Type GroundVehicle} {SteeringType SkidSteered} {Mass 11.9000} {MaxSpeed 1.2999} {MaxTorque 50000.0000} {MaxFrontSteer 0} {MaxRearSteer 0}",
        ),
        (
            "GETGEO {Type RangeScanner} {Name LMS200}",
            "GEO {Type RangeScanner} {Name lms200} {Location 0.21,0.00,-0.20} {Orientation 0.00,0.00,0.00}{Mount P3AT}",
        ),
        (
            "GETCONF {Type RangeScanner}",
            "CONF {Type RangeScanner} {Name lms200} {MaxRange 20.0000} {MinRange 0.1000} {Resolution 0.0174} {Fov 3.1414} {Panning True} {Tilting False}",
        ),
        (
            "GETCONF {Type Camera}",
            "CONF {Type Camera} {Name Camera}{TextureOffsetX 0}{TextureOffsetY 0}{TextureResolutionX 320}{TextureResolutionY 240}{CameraDefFov 80.0000}{CameraMinFov 20.0000}{CameraMaxFov 120.0000}{CameraFov 80.0000}",
        ),
        (
            "GETGEO {Type Battery}",
            "GEO {Type Battery} {Name battery} {Location 0.15,0.00,-0.20} {Orientation 0.00,0.00,0.00}{Mount P3AT}",
        ),
        ("GETCONF {Type INS}", "CONF {Type INS} {Name InsTest} {ScanInterval 0.2000}"),
    ] {
        // World places are subtracted: a robot that has turned by a hair as it settled prints some
        // zeros with a sign, as a line that was seen does (section 12, C35).
        assert_eq!(client.ask(question, &question[3..6]).replace("-0.00,", "0.00,"), answer);
    }
}

#[test]
fn ranges_have_two_decimals_and_are_cut() {
    let mut client = udk("");
    client.run(2.0);
    let line = client.of_type("RangeScanner").last().unwrap().to_string();
    let text = line.split("{Range ").nth(1).unwrap().trim_end_matches('}');
    assert_eq!(text.split(',').count(), 181);
    assert!(text.split(',').all(|r| r.split('.').nth(1).is_some_and(|d| d.len() == 2)), "{text}");
    // Straight ahead: the wall at 5 m from 0.2085 m ahead of the origin, 4.7915 m, cut to 4.79.
    assert_eq!(ranges(&line)[90], 4.79);
}

#[test]
fn every_sensor_has_a_timer_of_its_own() {
    let mut client = udk(RIG);
    client.lines.clear();
    client.run(10.0);
    let mut times: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for line in client.lines.iter().filter(|line| line.starts_with("SEN {Time")) {
        let kind = line.split("{Type ").nth(1).unwrap().split('}').next().unwrap();
        times.entry(kind.to_owned()).or_default().push(number(line, "Time"));
    }
    let mean = |kind: &str| {
        let times = &times[kind];
        (times.last().unwrap() - times[0]) / (times.len() - 1) as f64
    };
    for (kind, interval_s) in
        [("RangeScanner", 0.2), ("Odometry", 0.1), ("Tachometer", 0.2), ("GroundTruth", 0.1)]
    {
        assert!((mean(kind) - interval_s).abs() < 0.003, "{kind}: {}", mean(kind));
    }
    let phase = |kind: &str| times[kind][0].rem_euclid(0.2);
    assert!((phase("RangeScanner") - phase("Tachometer")).abs() > 0.015, "not aligned");
    let status: Vec<f64> = client
        .lines
        .iter()
        .filter(|line| line.starts_with("STA"))
        .map(|line| number(line, "Time"))
        .collect();
    assert!((99..=101).contains(&status.len()), "{}", status.len());
}

#[test]
fn links_are_counted_from_zero_in_act_and_from_one_in_asta_and_swing() {
    let mut client = udk(RIG);
    client.send("ACT {Name head} {Link 1} {Value 0.4}");
    let mut greatest = 0.0_f64;
    for _ in 0..100 {
        client.run(0.02);
        greatest = greatest.max(-client.truth().tilt_rad);
    }
    // Damped by 0.4 a spring overshoots by exp(-0.4π/√(1-0.16)) = 25 %.
    assert!((greatest - 0.5).abs() < 0.02, "{greatest}");
    client.run(2.0);
    let state = client.lines.iter().rfind(|line| line.starts_with("ASTA")).unwrap();
    let Message::AsTa(state) = parse(state.as_bytes()).message else { panic!() };
    let at = |link: i64| state.links.iter().find(|l| l.link == link).map(|l: &LinkState| l.value);
    assert_eq!((at(1), at(2)), (Some(0.0), Some(0.4)));
}

#[test]
fn what_is_not_there_is_met_with_silence() {
    let mut client = udk("");
    client.lines.clear();
    for line in [
        "GETGEO {Type Nothing}",
        "GETCONF {Type Nothing}",
        "GETGEO {Type MisPkg}",
        "GETGEO {Type Actuator}",
        "GETGEO {Type Sonar} {Name F9}",
        "GETCONF {Type Battery}",
        "SET {Type INS} {Name InsTest} {Opcode POSE} {Params 1,2,3,0,0,0}",
        "MULTIDRIVE {FRFlipper 1.0}",
        "TRACE {On 1}",
        "WHATEVER {A b}",
    ] {
        client.send(line);
    }
    client.run(1.0);
    let answers =
        client.lines.iter().filter(|line| !line.starts_with("SEN") && !line.starts_with("STA"));
    assert_eq!(answers.collect::<Vec<_>>(), Vec::<&String>::new());
    let ins = client.of_type("INS").last().unwrap().to_string();
    assert!(ins.contains("{Location 1.00,2.00,3.00}"), "the order was obeyed: {ins}");
}

#[test]
fn questions_sent_at_once_are_all_answered() {
    let mut client = udk(RIG);
    client.lines.clear();
    client.send("GETGEO {Type robot}\r\nGETGEO {Type rangescanner}\r\nGETGEO {Type Actuator}");
    client.send("GETCONF {Type Robot}\r\nGETCONF {Type Actuator}\r\nGETCONF {Type MisPkg}");
    client.run(0.1);
    let answers: Vec<&String> =
        client.lines.iter().filter(|l| l.starts_with("GEO") || l.starts_with("CONF")).collect();
    assert_eq!(answers.len(), 6, "{answers:?}");
    assert!(answers[0].starts_with(
        "GEO {Type GroundVehicle} {Name P3AT} {Dimensions 0.2480,0.3600,0.0000} {COG "
    ));
    let has = |text: &str| answers.iter().any(|answer| answer.contains(text));
    assert!(has("GEO {Type RangeScanner} {Name lms200} {Location 0.00,"), "{answers:?}");
    assert!(has("{Mount Head}{MountLink 2}"), "{answers:?}");
    assert!(has(
        "CONF {Name P3AT} {Type GroundVehicle} {SteeringType SkidSteered} {Mass 11.9000} \
         {MaxSpeed 1.2999} {MaxTorque 50000.0000} {MaxFrontSteer 0} {MaxRearSteer 0}"
    ));
    assert!(has(
        "CONF {Type Actuator} {Name Head} {Link 1} {JointType Revolute} {MaxTorque 600.0000} \
         {MinValue -2.0000} {MaxValue 2.0000} {Link 2}"
    ));
    assert!(has("{MaxRotationSpeed 1.571}"), "{answers:?}");
}

#[test]
fn normalized_sticks_and_one_side_alone_is_ignored() {
    let mut client = udk("");
    // The server takes lower case alone; teams send both, and here both are taken.
    client.send("DRIVE {Left 100} {Right 100} {Normalized True}");
    client.run(1.0);
    let full = client.truth().speed_mps;
    assert!((full - 0.1274).abs() < 0.005, "{full}");
    client.send("DRIVE {Left 50} {Right 50}");
    client.run(1.0);
    assert!((client.truth().speed_mps - full / 2.0).abs() < 0.005, "still in percent");
    client.send("DRIVE {Left 0}");
    client.run(1.0);
    assert!((client.truth().speed_mps - full / 2.0).abs() < 0.005, "both sides are needed");
    client.send("DRIVE {Left 0.65} {Right 0.65} {Normalized false}");
    client.run(1.0);
    assert!((client.truth().speed_mps - full / 2.0).abs() < 0.005);
}

#[test]
fn a_beam_without_echo_tells_the_way_to_the_world_s_origin() {
    let open = "name = \"m\"\nbounds = [-5.0, -5.0, 5.0, 5.0]\n\
                [[box]]\ncenter = [3.0, 4.0, -0.5]\nsize = [30.0, 30.0, 1.0]\n";
    let mut client = Client::new(open, &scenario("dialect = \"udk\""));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Location 3,-4,-0.2}");
    client.run(1.5);
    let line = ranges(client.of_type("RangeScanner")[0]);
    // The sensor stands at (3.21, 4, 0.37).
    assert!(line.iter().all(|range| (range - 5.14).abs() < 0.02), "{line:?}");
}

#[test]
fn a_depth_image_comes_in_twenty_strips_and_then_no_more() {
    let mut client = udk(RIG);
    client.lines.clear();
    client.send("SET {Type RangeImager} {Name KinectDepth} {Opcode SCAN}");
    client.run(3.0);
    let strips: Vec<_> = client
        .of_type("RangeImager")
        .iter()
        .filter_map(|line| match parse(line.as_bytes()).message {
            Message::Sen(Sen::RangeImager(image)) => image.ranges_m.map(|r| (image.frame, r)),
            other => panic!("{other:?}"),
        })
        .collect();
    let numbers: Vec<_> = strips.iter().map(|(frame, _)| frame.unwrap()).collect();
    assert_eq!(numbers, (0..20).collect::<Vec<_>>());
    assert!(strips.iter().all(|(_, ranges)| ranges.len() == 12 * 320));
    // Depths along the axis: the wall 4.8 m ahead of the camera is flat over the middle rows.
    let middle = &strips[9].1;
    let at = |column: usize| middle[6 * 320 + column];
    assert!(
        (at(160) - 4.8).abs() < 0.02 && (at(190) - 4.8).abs() < 0.02,
        "{} {}",
        at(160),
        at(190)
    );
}

#[test]
fn an_empty_battery_leaves_the_state_alone_and_the_wheels_turning() {
    let mut client =
        Client::new(BOX, &format!("{}battery_s = 3.0\n", scenario("dialect = \"udk\"")));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1}");
    client.send("DRIVE {Left 1.0} {Right 1.0} {Normalized false}");
    client.run(3.2);
    client.lines.clear();
    client.send("DRIVE {Left 0} {Right 0}");
    client.send("GETGEO {Type Robot}");
    client.run(1.0);
    assert!(client.lines.iter().all(|line| line.starts_with("STA")), "{:?}", client.lines);
    assert!(client.lines[0].contains("{Battery 0}"));
    assert!((client.truth().speed_mps - 0.098).abs() < 0.01, "the last speed stays");
}
