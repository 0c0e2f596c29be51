//! Sockets: several clients, one world; who comes, goes, floods or falls silent.

use super::{Client, PATIENCE, Stand};
use std::io::{BufRead, BufReader, Write};
use std::net::{Shutdown, TcpListener};
use std::process::{Command, Stdio};
use usar_agent::protocol::Dialect::{Udk, Ut2004};

const GREETING: &str = "NFO {Gametype BotDeathMatch} {Level DM-USAR_yellow_250} {TimeLimit 0}";
const INIT: &str = "INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.5,1.9,1.8}\r\n";

#[test]
fn the_greeting_comes_at_once_and_start_poses_before_init() {
    let stand = Stand::of("yellow", Ut2004);
    let mut client = stand.client();
    assert_eq!(client.line().unwrap(), GREETING);
    assert!(
        client.ask("GETSTARTPOSES", "NFO").starts_with("NFO {StartPoses 3} {PlayerStart 4.50,")
    );
    client.send(INIT);
    let status = client.line_of("STA ");
    assert!(status.starts_with("STA {Type GroundVehicle} {Time 100."), "{status}");
}

#[test]
fn lines_may_end_and_be_cut_in_any_way() {
    let stand = Stand::of("yellow", Udk);
    for (name, end, place) in
        [("A", "\r\n", "4.5,1.9,1.8"), ("B", "\n", "1.2 5.6 1.8"), ("C", "\n\r", "8.8, 2.0, 1.8")]
    {
        let mut client = stand.client();
        client.line().unwrap();
        let both = format!(
            "getstartposes{end}init {{classname usarbot.p2at}}{{NAME {name}}}{{location {place}}}{end}"
        );
        let (head, tail) = both.split_at(both.len() / 2);
        client.send(head);
        client.stream.flush().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(20));
        client.send(tail);
        assert!(client.line().unwrap().starts_with("NFO {StartPoses 3} {PlayerStart 4.5000,"));
        assert!(client.line_of("STA ").starts_with("STA {Time 1"));
    }
}

#[test]
fn a_client_that_leaves_frees_its_place_for_one_that_comes_at_once() {
    let stand = Stand::of("yellow", Ut2004);
    for _ in 0..5 {
        let mut client = stand.client();
        client.send(INIT);
        client.line_of("STA ");
    }
    let mut first = stand.client();
    first.send(INIT);
    first.line_of("STA ");
    // The place is taken, so the second gets silence until the first one goes.
    let mut second = stand.client();
    second.send(INIT);
    second.ask("GETSTARTPOSES", "NFO {StartPoses");
    drop(first);
    loop {
        second.send(INIT);
        second.send("GETSTARTPOSES\r\n");
        second.line_of("NFO {StartPoses");
        second.stream.set_read_timeout(Some(std::time::Duration::from_millis(200))).unwrap();
        let mut line = Vec::new();
        if second.reader.read_until(b'\n', &mut line).is_ok() {
            break;
        }
    }
    second.stream.set_read_timeout(Some(PATIENCE)).unwrap();
    second.line_of("STA ");
}

#[test]
fn what_was_asked_before_the_end_of_the_stream_is_answered() {
    let stand = Stand::of("yellow", Ut2004);
    let mut client = stand.client();
    client.send(INIT);
    client.send("GETGEO {Type Robot}\r\nGETGEO {Type RangeScanner}\r\nGETCONF {Type Robot}\r\n");
    client.stream.shutdown(Shutdown::Write).unwrap();
    let rest = String::from_utf8(client.read_to_end()).unwrap();
    assert!(rest.contains("GEO {Type GroundVehicle} {Name P2AT}"), "{rest}");
    assert!(rest.contains("GEO {Type RangeScanner}") && rest.contains("CONF {Type GroundVehicle}"));
}

#[test]
fn two_robots_share_one_world_and_one_clock() {
    let stand = Stand::of("yellow", Ut2004);
    let mut near = stand.client();
    near.send(INIT);
    near.line_of("STA ");
    let mut far = stand.client();
    far.send(
        "INIT {ClassName USARBot.P2AT} {Name R2} {Location 6.0,1.9,1.8} {Rotation 0,0,3.14}\r\n",
    );
    let time = |line: &str| -> f64 {
        line.split("{Time ").nth(1).unwrap().split('}').next().unwrap().parse().unwrap()
    };
    let later = time(&far.line_of("STA "));
    let mut sonar = near.line_of("SEN {Time");
    while time(&sonar) < later + 1.0 || !sonar.contains("{Type Sonar}") {
        sonar = near.line_of("SEN {Time");
    }
    let ahead: f64 =
        sonar.split("{Name F4 Range ").nth(1).unwrap().split('}').next().unwrap().parse().unwrap();
    assert!((0.7..1.3).contains(&ahead), "1.5 m between the origins: {sonar}");
}

#[test]
fn a_client_that_floods_and_never_reads_is_cut_off_and_others_are_served() {
    let stand = Stand::of("yellow", Ut2004);
    let mut hostile = stand.client();
    let block = "GETSTARTPOSES\r\n".repeat(4000);
    let mut sent = 0_usize;
    while hostile.stream.write_all(block.as_bytes()).is_ok() {
        sent += block.len();
        assert!(sent < 400 << 20, "never cut off");
    }
    let mut other = stand.client();
    assert_eq!(other.line().unwrap(), GREETING);
    assert!(other.ask("GETSTARTPOSES", "NFO").starts_with("NFO {StartPoses 3}"));
}

#[test]
fn a_line_without_end_is_dropped_and_the_next_one_is_read() {
    let stand = Stand::of("yellow", Ut2004);
    let mut client = stand.client();
    client.line().unwrap();
    let mut long = "{".repeat(3 << 20);
    long.push_str("\r\n\0\u{1}{{}}garbage}\r\n");
    client.send(&long);
    assert!(client.ask("GETSTARTPOSES", "NFO").starts_with("NFO {StartPoses 3}"));
}

/// The server as a program: its first line, and itself.
fn program(arguments: &[&str]) -> (String, std::process::Child) {
    let mut child = Command::new(assert_cmd::cargo::cargo_bin!("usar"))
        .arg("sim")
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    (line.trim_end().to_owned(), child)
}

#[test]
fn the_program_names_its_port_first_and_ends_with_success_when_asked_to() {
    for signal in ["-INT", "-TERM"] {
        let (line, mut child) =
            program(&["yellow", "--port", "0", "--image-port", "0", "--monitor-port", "0"]);
        let address = line.strip_prefix("listening on ").expect(&line).parse().unwrap();
        assert_eq!(Client::connect(address).line().unwrap(), GREETING);
        let killed = Command::new("kill").args([signal, &child.id().to_string()]).status();
        if !killed.is_ok_and(|status| status.success()) {
            child.kill().unwrap();
            println!("skipped: needs kill");
            return;
        }
        assert_eq!(child.wait().unwrap().code(), Some(0), "{signal}");
    }
}

#[test]
fn a_port_that_is_taken_is_one_line_and_failure() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port();
    let output = Command::new(assert_cmd::cargo::cargo_bin!("usar"))
        .args([
            "sim",
            "yellow",
            "--port",
            &port.to_string(),
            "--image-port",
            "0",
            "--monitor-port",
            "0",
        ])
        .output()
        .unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    let expected = format!("error: cannot listen on 127.0.0.1:{port}: the port is taken\n");
    assert_eq!((text, output.stdout), (expected, Vec::new()));
}
