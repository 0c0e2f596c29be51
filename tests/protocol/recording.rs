//! The one real recording: what a client printed while a P2DX drove through `DM-USAR_yellow_250`.

use super::reference_data;
use std::collections::BTreeMap;
use usar_agent::protocol::capture::Capture;
use usar_agent::protocol::message::{Sen, sen::RangeScanner};
use usar_agent::protocol::{Dialect, Message, encode_message, parse};
use usar_agent::time::Stamp;

fn capture() -> Option<Capture> {
    let text = reference_data("usarsim-session/session_30_scans.txt")?;
    Some(Capture::read(&text))
}

fn messages(capture: &Capture) -> Vec<Message> {
    let parsed = capture.lines.iter().map(|line| (line, parse(&line.octets)));
    parsed
        .map(|(line, parsed)| {
            assert_eq!(parsed.problems, [], "text line {}", line.text_line);
            parsed.message
        })
        .collect()
}

/// The wire's name of a message, a sensor's type included.
fn kind(message: &Message) -> &'static str {
    match message {
        Message::Nfo(_) => "NFO",
        Message::Sta(_) => "STA",
        Message::MisSta(_) => "MISSTA",
        Message::GroundTruth(_) => "GroundTruth",
        Message::Sen(Sen::RangeScanner(_)) => "RangeScanner",
        Message::Sen(Sen::Sonar(_)) => "Sonar",
        Message::Sen(Sen::Odometry(_)) => "Odometry",
        Message::Sen(Sen::Ins(_)) => "INS",
        Message::Sen(Sen::Encoder(_)) => "Encoder",
        Message::Sen(Sen::Gps(_)) => "GPS",
        Message::Sen(Sen::Rfid(_)) => "RFID",
        Message::Sen(Sen::VictSensor(_)) => "VictSensor",
        other => panic!("not in the recording: {other:?}"),
    }
}

fn scans(messages: &[Message]) -> Vec<&RangeScanner> {
    let scan = |message| match message {
        &Message::Sen(Sen::RangeScanner(ref scan)) => Some(scan),
        _ => None,
    };
    messages.iter().filter_map(scan).collect()
}

#[test]
fn all_284_messages_come_out_of_the_cut_text() {
    let Some(capture) = capture() else { return };
    let mut counts = BTreeMap::new();
    for message in messages(&capture) {
        *counts.entry(kind(&message)).or_insert(0) += 1;
    }
    let expected = [
        ("Encoder", 31),
        ("GPS", 31),
        ("GroundTruth", 31),
        ("INS", 30),
        ("MISSTA", 31),
        ("NFO", 1),
        ("Odometry", 30),
        ("RFID", 1),
        ("RangeScanner", 30),
        ("STA", 31),
        ("Sonar", 30),
        ("VictSensor", 7),
    ];
    assert_eq!(counts, BTreeMap::from(expected));
    assert_eq!(capture.lines.len(), 284);
    let remarks: Vec<_> = capture.remarks.iter().map(|remark| remark.text.as_str()).collect();
    assert_eq!(
        remarks,
        [
            "attempting to connect",
            "done, data:",
            "attempting to send spawn message",
            "attempting to send forward drive message"
        ]
    );
}

#[test]
fn every_laser_line_has_its_181_beams() {
    let Some(capture) = capture() else { return };
    let messages = messages(&capture);
    let scans = scans(&messages);
    assert_eq!(scans.len(), 30);
    for scan in scans {
        assert_eq!(scan.ranges_m.len(), 181, "{:?}", scan.time);
        assert_eq!((scan.resolution_rad, scan.fov_rad), (Some(0.0174), Some(31_415.0 / 1e4)));
    }
}

#[test]
fn every_line_is_written_back_byte_for_byte() {
    let Some(capture) = capture() else { return };
    for (line, message) in capture.lines.iter().zip(messages(&capture)) {
        let mut expected = line.octets.clone();
        expected.extend_from_slice(b"\r\n");
        let written = encode_message(&message, Dialect::Ut2004);
        assert_eq!(String::from_utf8_lossy(&written), String::from_utf8_lossy(&expected));
    }
}

#[test]
fn the_scanner_is_stamped_one_burst_before_the_lines_round_it() {
    let Some(capture) = capture() else { return };
    let messages = messages(&capture);
    let bursts: Vec<Stamp> = messages
        .iter()
        .filter_map(|message| match message {
            Message::Sta(sta) => sta.time,
            _ => None,
        })
        .collect();
    let scan_times: Vec<Stamp> = scans(&messages).iter().filter_map(|scan| scan.time).collect();
    assert_eq!(scan_times, bursts[..30]);
}

#[test]
fn text_saved_without_carriage_returns_gives_the_same_messages() {
    let Some(text) = reference_data("usarsim-session/session_30_scans.txt") else { return };
    let bare: Vec<u8> = text.iter().copied().filter(|octet| *octet != b'\r').collect();
    let (bare, whole) = (Capture::read(&bare), Capture::read(&text));
    assert_eq!(messages(&bare), messages(&whole));
    assert_eq!(bare.remarks, whole.remarks);
}
