//! Section 12 of the protocol reference: every line is read, and what the agent or the stand-in
//! sends is written back byte for byte.

use std::collections::BTreeMap;
use usar_agent::protocol::{
    Command, Dialect, Message, Problem, encode_command, encode_message, parse, parse_command,
};

/// Number and line of each vector.
fn vectors() -> Vec<(&'static str, &'static str)> {
    let text = include_str!("vectors.txt");
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.map(|row| row.split_once('\t').unwrap()).collect()
}

/// Lines that are written back otherwise than they stand in the reference: the line as it is
/// written, and why.
const EXCEPTIONS: &[(&str, &str, &str)] = &[
    (
        "A03",
        "NFO {StartPoses 1} {UnitLoader1 10.24,3.54,10.05 0.00,0.00,1.60}",
        "a form documented by two clients only; servers are written as A02",
    ),
    (
        "A24",
        "SEN {Type Encoder} {Name EncTest1 Tick 0}",
        "a variant; the grouped form of A22 is written",
    ),
    (
        "A37",
        "MISSTA {Time 102.09} {Name CameraPanTilt} {Link 1} {Value 0.0000} {Torque -20.00} {Link 2} {Value -0.1600} {Torque -20.00}",
        "torque with 4 decimals in some 3.1.x logs; 2 are written as in A36 and in the recording",
    ),
    (
        "A55",
        "CONF {Type MisPkg} {Name CameraPantilt} {Link 1} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00} {MinRange 1} {MaxRange 0} {Link 2} {JointType Revolute} {MaxSpeed 0.17} {MaxTorque 20.00} {MinRange -0.16} {MaxRange 0.40}",
        "typed by hand: the second torque has no decimals",
    ),
    (
        "B01",
        "INIT {ClassName USARBot.P2DX} {Name R1} {Location 1.5,2,1.8}",
        "the name stands before the pose as in B02; 2.0 in its shortest form",
    ),
    ("B06", "DRIVE {Name FLFlipper} {Order 1} {Value 0.5}", "one blank stands between segments"),
    ("B14", "TRACE {On 1} {Interval 1} {Color White}", "verbs are upper case"),
    (
        "C12",
        "SEN {Time 45.1400} {Type Sonar} {Name F1} {Range 4.4690}",
        "one blank between segments; UDK stamps have 4 decimals",
    ),
    (
        "D02",
        "INIT {ClassName USARBot.P3AT} {Name ROS1} {Start RobotStart2}",
        "the key as the server's source spells it",
    ),
    ("D05", "DRIVE {Left 1.0} {Right 1.0}", "a decimal comma is read as the server does"),
    (
        "D10",
        "MOVE {Action New} {Type Run} {Location 1,2}",
        "order of section 4.9, numbers in their shortest form, no blank after the comma",
    ),
    ("D13", "Com1 {BasMan Rulez} {Hello 2}", "one blank stands before the first segment"),
    (
        "D14",
        "Com2 {WithWhitespaces      88} {More  whitespaces}",
        "outer blanks are not kept; inner ones are",
    ),
    (
        "E01",
        "SEN {Type Odometry} {Name Odometry} {Pose 1.0000,2.0000,0.5000}",
        "a reader's vector: blanks and decimals as no server writes them",
    ),
    ("E02", "STA {Time 1.0000} {Type GroundVehicle}", "a reader's vector: lower case"),
    (
        "E03",
        "GEO {Type Sonar} {Name F1} {Location 0.10,0.20,0.00} {Orientation 0.00,0.00,0.00}{Mount HARD}",
        "a reader's vector: UT2004's form, written here as UDK does",
    ),
    (
        "E07",
        "MISSTA {Time 1.0000} {Name P} {Link 1} {Value -0.0000} {Torque -20.0000}",
        "a reader's vector: UT2004's form, written here as UDK does",
    ),
    (
        "E08",
        "STA {Name n} {Size 1.0000,1.0000,1.0000} {Location 1.0000,2.0000,3.0000 {Memory {text} {Rotation 0.0000,0.0000,0.0000}",
        "a reader's vector: decimals as no server writes them; its braces are the server's",
    ),
    (
        "E10",
        "RES {Time 1.00} {Type RFID} {Name R} {Status OK} {ID 7} {Mem two words}",
        "a reader's vector: key in lower case",
    ),
];

/// Vectors without a typed form: other ports' lines and commands that servers ignore. They are
/// kept as raw lines, all segments in order.
const RAW: [&str; 14] = [
    "C35", "C36", "C37", "C38", "C39", "C40", "C41", "C42", "D12", "D13", "D14", "D15", "D16",
    "D17",
];

/// Vectors whose form is damaged on purpose, with the number of problems that are told.
const DAMAGED: [(&str, usize); 1] = [("D05", 2)];

struct Reading {
    back: String,
    problems: Vec<Problem>,
    raw: bool,
}

fn read(number: &str, line: &str) -> Reading {
    let dialect = match number.as_bytes()[0] {
        b'A' | b'B' => Dialect::Ut2004,
        _ => Dialect::Udk,
    };
    let (bytes, problems, raw) = if number.starts_with(['B', 'D']) {
        let parsed = parse_command(line.as_bytes());
        let raw = matches!(parsed.command, Command::Unknown(_));
        (encode_command(&parsed.command, dialect), parsed.problems, raw)
    } else {
        let parsed = parse(line.as_bytes());
        let raw = matches!(parsed.message, Message::Unknown(_));
        (encode_message(&parsed.message, dialect), parsed.problems, raw)
    };
    let back = String::from_utf8(bytes).unwrap();
    let back = back.strip_suffix("\r\n").expect("lines end with CR LF").to_owned();
    Reading { back, problems, raw }
}

#[test]
fn every_vector_is_read_as_what_it_is() {
    assert_eq!(vectors().len(), 142);
    let damaged = BTreeMap::from(DAMAGED);
    for (number, line) in vectors() {
        let reading = read(number, line);
        assert_eq!(reading.raw, RAW.contains(&number), "{number}: {line}");
        let expected = damaged.get(number).copied().unwrap_or(0);
        assert_eq!(reading.problems.len(), expected, "{number}: {:?}", reading.problems);
    }
}

#[test]
fn every_vector_is_written_back_byte_for_byte_but_for_reasoned_exceptions() {
    let exceptions: BTreeMap<_, _> =
        EXCEPTIONS.iter().map(|(number, line, _)| (*number, *line)).collect();
    for (number, line) in vectors() {
        let expected = exceptions.get(number).copied().unwrap_or(line);
        assert_eq!(read(number, line).back, expected, "{number}");
    }
}

#[test]
fn no_exception_is_out_of_date() {
    let lines: BTreeMap<_, _> = vectors().into_iter().collect();
    for (number, written, reason) in EXCEPTIONS {
        assert_ne!(lines[number], *written, "{number} needs no exception");
        assert!(!reason.is_empty());
    }
}

#[test]
fn no_vector_loses_a_segment() {
    for (number, line) in vectors() {
        let message = read(number, line).back;
        let count = |text: &str| text.matches('{').count();
        // Compound and simple segments differ in braces, not in words; E08 is unbalanced.
        if !["A03", "A24", "E03", "E08"].contains(&number) {
            assert_eq!(count(&message), count(line), "{number}");
        }
    }
}
