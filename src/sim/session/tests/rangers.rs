//! Infrared and plain rangers on the wire.

use super::*;

/// An infrared ranger ahead and one to the left, a plain ranger, and two infrared scanners.
const RIG: &str = "[[robot.sensor]]\ntype = \"IR\"\nname = \"IR1\"\nposition = [0.24, 0.0, 0.2]\n\
    max_range_m = 6.0\n\
    [[robot.sensor]]\ntype = \"IR\"\nname = \"IR2\"\nposition = [0.0, 0.2, 0.2]\n\
    rpy_deg = [0.0, 0.0, 90.0]\n\
    [[robot.sensor]]\ntype = \"Range\"\nname = \"Plain\"\nposition = [0.24, 0.0, 0.2]\n\
    max_range_m = 6.0\n\
    [[robot.sensor]]\ntype = \"IRScanner\"\nname = \"Ahead\"\nposition = [0.24, 0.0, 0.2]\n\
    [[robot.sensor]]\ntype = \"IRScanner\"\nname = \"Spread\"\nposition = [0.24, 0.0, 0.2]\n\
    yaw = true\n";

/// A resting robot at the middle of the box, 5 m west of a wall.
fn resting(dialect: &str) -> Client {
    let quiet = format!("dialect = \"{dialect}\"\n[noise]\nrange_relative = 0.0\n");
    let mut client = Client::new(BOX, &format!("{}{RIG}", scenario(&quiet)));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    client.run(2.0);
    client.lines.clear();
    client.run(1.0);
    client
}

fn last<'a>(client: &'a Client, start: &str) -> &'a str {
    client.lines.iter().rfind(|line| line.contains(start)).expect(start).as_str()
}

/// The number that ends a line such as `… {Range 4.7600}`.
fn final_number(line: &str) -> f64 {
    let end = line.trim_end_matches('}');
    end.rsplit(' ').next().unwrap().parse().unwrap_or_else(|_| panic!("{line}"))
}

fn fan(line: &str) -> Vec<f64> {
    match parse(line.as_bytes()).message {
        Message::Sen(Sen::IrScanner(scan)) => scan.ranges_m,
        other => panic!("{other:?}"),
    }
}

#[test]
fn udk_rangers_write_a_line_each_and_are_clipped() {
    let client = resting("udk");
    let near = last(&client, "{Type IR} {Name IR2}");
    assert!(near.starts_with("SEN {Time "), "{near}");
    assert!(near.ends_with(" {Type IR} {Name IR2} {Range 1.5000}"), "nothing within reach: {near}");
    for start in ["{Type IR} {Name IR1} {Range ", "{Type Range} {Name Plain} {Range "] {
        let range = final_number(last(&client, start));
        assert!((range - 4.76).abs() < 0.01, "{range}");
    }
}

#[test]
fn ut2004_rangers_share_a_line_of_their_type_after_the_sonars() {
    let client = resting("ut2004");
    let line = last(&client, "{Type IR}");
    let (head, rest) = line.split_once(" {Type IR} {Name IR1 Range 4.7").expect(line);
    assert!(
        head.starts_with("SEN {Time ") && rest.ends_with("} {Name IR2 Range 1.5000}"),
        "{line}"
    );
    let at = |kind: &str| client.lines.iter().position(|line| line.contains(kind)).unwrap();
    assert!(at("{Type Sonar}") < at("{Type Range}") && at("{Type Range}") < at("{Type IR}"));
    assert!(at("{Type RangeScanner}") < at("{Type IRScanner}"));
}

#[test]
fn an_infrared_scanner_looks_straight_ahead_unless_its_yaw_flag_is_set() {
    let client = resting("udk");
    let ahead = last(&client, "{Name Ahead}");
    assert!(
        ahead.contains("{Type IRScanner} {Name Ahead} {Resolution 0.0869} {FOV 3.1399} {Range ")
    );
    let ranges = fan(ahead);
    assert_eq!(ranges.len(), 37);
    assert!(ranges.iter().all(|range| *range == ranges[0] && (*range - 4.76).abs() < 0.02));
    let spread = fan(last(&client, "{Name Spread}"));
    // The first beam looks right at the cabinet, the middle one at the wall, the last one left.
    assert_eq!(spread.len(), 37);
    for (beam, metres) in [(0, 3.1), (18, 4.76), (36, 4.0)] {
        assert!((spread[beam] - metres).abs() < 0.03, "{beam}: {spread:?}");
    }
}

#[test]
fn rangers_answer_what_and_where_they_are() {
    let mut udk = resting("udk");
    for (question, answer) in [
        (
            "GETCONF {Type IR}",
            "CONF {Type IR} {Name IR1} {MaxRange 6.0000} {MinRange 0.2000} {ScanInterval 0.1000} {Name IR2} {MaxRange 1.5000} {MinRange 0.2000} {ScanInterval 0.1000}",
        ),
        (
            "GETCONF {Type IRScanner} {Name Ahead}",
            "CONF {Type IRScanner} {Name Ahead} {MaxRange 10.0000} {MinRange 0.2000} {Resolution 0.0869} {Fov 3.1399} {Panning False} {Tilting False}",
        ),
    ] {
        assert_eq!(udk.ask(question, &answer[..4]), answer);
    }
    // UDK subtracts places in the world, so that a heading of a hair shows in the zeros.
    let place = udk.ask("GETGEO {Type IR} {Name IR1}", "GEO");
    assert!(place.starts_with("GEO {Type IR} {Name IR1} {Location 0.24,"), "{place}");
    assert!(place.ends_with(",-0.20} {Orientation 0.00,0.00,0.00}{Mount P3AT}"), "{place}");
    let mut ut2004 = resting("ut2004");
    assert_eq!(
        ut2004.ask("GETCONF {Type Range}", "CONF"),
        "CONF {Type Range} {Name Plain} {MaxRange 6.0000} {MinRange 0.2000}"
    );
    assert_eq!(
        ut2004.ask("GETGEO {Type IR} {Name ir2}", "GEO"),
        "GEO {Type IR} {Name IR2 Location 0.0000,-0.2000,-0.2000 Orientation 0.0000,0.0000,-1.5707 Mount HARD}"
    );
}

#[test]
fn a_scan_is_cast_by_the_scanners_of_the_type_that_was_named() {
    let rig = "[[robot.sensor]]\ntype = \"RangeScanner\"\nname = \"Laser\"\ninterval_s = 0.0\n\
               [[robot.sensor]]\ntype = \"IRScanner\"\nname = \"Red\"\ninterval_s = 0.0\n";
    let mut client = Client::new(BOX, &format!("{}{rig}", scenario("dialect = \"udk\"")));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    client.run(1.0);
    assert!(client.of_type("IRScanner").is_empty(), "nobody asked yet");
    client.session.take_casts(client.id);
    client.send("SET {Type IRScanner} {Opcode Scan}");
    client.run(1.0);
    assert!(client.session.take_casts(client.id).is_empty(), "no laser line was cast");
    assert_eq!([client.of_type("IRScanner").len(), client.of_type("RangeScanner").len()], [1, 0]);
    client.send("SET {Type RangeScanner} {Name Laser} {Opcode Scan}");
    client.run(1.0);
    assert_eq!([client.of_type("IRScanner").len(), client.of_type("RangeScanner").len()], [1, 1]);
}
