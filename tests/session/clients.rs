//! How clients of those years send and read, as far as it asks more of a server than the protocol does:
//! what they take for granted must stay so.

use super::{Client, Stand};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::time::Duration;
use usar_agent::cli::interrupt::hangup_is_ignored;
use usar_agent::protocol::Dialect::{self, Udk, Ut2004};

/// The text from `start` to the next `}`.
fn between<'a>(line: &'a str, start: &str) -> Option<&'a str> {
    line.split_once(start)?.1.split('}').next()
}

/// Which line tells the truth about the place, in the dialect.
fn place(client: &mut Client) -> String {
    let line = loop {
        let line = client.line_of("SEN ");
        if line.contains("{Type GroundTruth}") {
            break line;
        }
    };
    between(&line, "{Location ").unwrap().to_owned()
}

/// The same in metres.
fn place_m(client: &mut Client) -> Vec<f64> {
    place(client).split(',').map(|number| number.parse().unwrap()).collect()
}

/// A client of the ROS bridge's kind: everything in the first packet, then one question at a time,
/// the next only when the last is answered; an item that is not answered stops it for good. `speaking` items have lines of their own.
fn ask_as_told(dialect: Dialect, class: &str, speaking: usize) {
    let stand = Stand::of("yellow", dialect);
    let mut client = stand.client();
    client.send(&format!(
        "GETSTARTPOSES\r\nINIT {{Classname USARBot.{class}}} {{Name ROS1}} {{Start PlayerStart}}\r\n"
    ));
    let mut items: BTreeMap<(String, String), bool> = BTreeMap::new();
    let mut waits: Option<(String, String)> = None;
    let mut answered = 0;
    for _ in 0..2000 {
        let line = client.line().unwrap();
        let kind = between(&line, "{Type ").unwrap_or_default().to_owned();
        if line.starts_with("SEN ") || line.starts_with("ASTA ") || line.starts_with("MISSTA ") {
            let kind = if line.starts_with("SEN ") { kind } else { "MisPkg".to_owned() };
            for name in line.split("{Name ").skip(1) {
                let name = name.split([' ', '}']).next().unwrap().to_owned();
                items.entry((kind.clone(), name)).or_default();
            }
        } else if let Some((kind_asked, name)) = &waits
            && line.starts_with("CONF ")
            && kind == *kind_asked
            && line.contains(name.as_str())
        {
            waits = None;
            answered += 1;
        }
        if waits.is_none()
            && let Some((item, done)) = items.iter_mut().find(|(_, done)| !**done)
        {
            *done = true;
            let (kind, name) = item;
            client.send(&format!("GETCONF {{Type {kind}}} {{Name {name}}}\r\n"));
            waits = Some(item.clone());
        }
        if answered == speaking {
            return;
        }
    }
    panic!("{waits:?} was not answered; {answered} others were");
}

#[test]
fn every_item_that_speaks_is_answered_when_asked_by_its_name() {
    // Sixteen sonars, four encoders, the pan-tilt, laser, INS, odometry, touch, RFID, victims, truth.
    ask_as_told(Ut2004, "P2AT", 27);
    // Laser, INS, two encoders, tachometer, truth.
    ask_as_told(Udk, "P3AT", 6);
}

#[test]
fn segments_can_be_split_at_a_brace_a_blank_and_a_brace() {
    let stand = Stand::of("yellow", Ut2004);
    let mut client = stand.client();
    client.send("INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.500000 1.900000 1.800000} {Rotation 0.000000 0.000000 0.000000}\r\n");
    let mut seen = [false; 3];
    while seen != [true; 3] {
        let line = client.line().unwrap();
        assert!(line.len() < 4096);
        let parts: Vec<&str> = line.split("} {").collect();
        let word = |part: &str, at: usize| part.split(' ').nth(at).unwrap().to_owned();
        if line.contains("{Type Sonar}") {
            // Two segments of the head, then eight sonars before and eight behind, by their place.
            for (at, number) in (2..18).zip((1..=8).chain(1..=8)) {
                let side = if at < 10 { "F" } else { "R" };
                assert_eq!(word(parts[at], 1), format!("{side}{number}"));
                assert!(word(parts[at], 3).trim_end_matches('}').parse::<f32>().is_ok());
            }
            seen[0] = true;
        } else if line.contains("{Type RangeScanner}") {
            let ranges = parts[5].strip_prefix("Range ").unwrap().strip_suffix('}').unwrap();
            assert_eq!(ranges.split(',').filter(|range| range.parse::<f32>().is_ok()).count(), 181);
            assert!(ranges.len() < 2048);
            seen[1] = true;
        } else if line.starts_with("STA ") {
            assert_eq!(word(parts[7], 0), "View");
            assert!(word(parts[6], 1).parse::<i32>().is_ok_and(|battery| battery > 0));
            seen[2] = true;
        }
    }
}

#[test]
fn a_start_pose_can_be_given_back_as_it_was_told() {
    for dialect in [Ut2004, Udk] {
        let stand = Stand::of("yellow", dialect);
        let mut client = stand.client();
        let poses = client.ask("GETSTARTPOSES", "NFO {StartPoses");
        // All of the list from the pose's name on, other poses and angles too, as some send it.
        let told = between(&poses, "PlayerStart ").unwrap();
        client
            .send(&format!("INIT {{ClassName USARBot.P2AT}} {{Location {told}}} {{Name R1}}\r\n"));
        let place = place_m(&mut client);
        assert!((place[0] - 4.5).abs() < 0.02 && (place[1] - 1.9).abs() < 0.02, "{place:?}");
    }
}

#[test]
fn a_closed_terminal_ends_a_run_well() {
    // Started under `nohup` it goes on without its terminal, as it should, and is asked to end otherwise.
    let signal = if hangup_is_ignored() { "-TERM" } else { "-HUP" };
    let stand = Stand::of("yellow", Ut2004);
    let folder = tempfile::tempdir().unwrap();
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("usar"))
        .args(["run", "--server", &stand.address.to_string(), "--out"])
        .arg(folder.path())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    // Nobody reads on: whatever the program says from here on is refused.
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut line).unwrap();
    let killed = Command::new("kill").args([signal, &child.id().to_string()]).status();
    assert!(killed.unwrap().success(), "`kill` is of every POSIX system");
    assert_eq!(child.wait().unwrap().code(), Some(0), "after {line}");
    assert!(folder.path().join("report.json").exists());
}

#[test]
fn init_is_served_however_clients_spell_it() {
    for (dialect, class) in [(Ut2004, "P2AT"), (Udk, "P3AT")] {
        let stand = Stand::of("yellow", dialect);
        for form in [
            "init {classname usarbot.CLASS} {name A} {location 4.5,1.9,1.8}\n",
            "INIT{ClassName USARBot.CLASS}{Name B}{Location 4.5, 1.9, 1.8}{Rotation 0, 0, 0}\n\r",
            "INIT {ClassName USARBot.CLASS} {Location 4.5 1.9 1.8} {Rotation 0 0 0} {Name C}\r\n",
            "INIT {ClassName CLASS} {Location 4.50,1.90,1.80} {Team 255} {Battery 500}\r",
            "GETSTARTPOSES\r\nINIT {Classname USARBot.CLASS} {Name E} {Start playerstart}\r\n",
            "   INIT   {  ClassName   USARBot.CLASS  }   {Start PlayerStart}   {Name F} \r\n",
        ] {
            let mut client = stand.client();
            client.send(&form.replace("CLASS", class));
            let at = place_m(&mut client);
            assert!((at[0] - 4.5).abs() < 0.02 && (at[1] - 1.9).abs() < 0.02, "{form}: {at:?}");
        }
    }
}

#[test]
fn drive_is_served_however_clients_spell_it_and_cut_it() {
    for (dialect, class) in [(Ut2004, "P2AT"), (Udk, "P3AT")] {
        let stand = Stand::of("yellow", dialect);
        let mut client = stand.client();
        client.send(&format!("INIT {{ClassName USARBot.{class}}} {{Start PlayerStart}}\r\n"));
        for packets in [
            &["DRIVE{Left 1}{Right 1}\r\n"][..],
            &["drive {left 1.0} {right 1.0} {normalized false}\n\r"],
            &["DRIVE {Right 1.000000} {Left 1.000000} {Light false}\r\n"],
            &["DRIVE {Left 1,00} {Right 1,00}\r\n"],
            &["DRI", "VE {Left 1.", "0} {Right 1.0}\r", "\n"],
            &["DRIVE {Left 0} {Right 0}\r\nWHATEVER\r\n\r\nDRIVE {Left 1} {Right 1}\r\n"],
        ] {
            client.send("DRIVE {Left 0.0} {Right 0.0}\r\n");
            let mut still = place_m(&mut client);
            for _ in 0..20 {
                still = place_m(&mut client);
            }
            for packet in packets {
                client.send(packet);
                std::thread::sleep(Duration::from_millis(5));
            }
            let moved = (0..60).any(|_| place_m(&mut client)[0] - still[0] > 0.04);
            assert!(moved, "{dialect:?} {packets:?}");
        }
    }
}
