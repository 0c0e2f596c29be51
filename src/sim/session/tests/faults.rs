use super::*;

/// A P3AT in the box world with one fault from its second second on, for two seconds; the lines of
/// three seconds, one before, two during.
fn with(fault: &str) -> Client {
    let fault = format!("[[fault]]\nat_s = 2.0\nfor_s = 2.0\n{fault}\n");
    let mut client = Client::new(BOX, &format!("{}{fault}", scenario("")));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    client.run(1.9);
    client.lines.clear();
    client
}

fn count(client: &Client, kind: &str) -> usize {
    client.of_type(kind).len()
}

#[test]
fn lines_are_dropped_and_come_again() {
    let mut client = with("kind = \"drop\"\nwhat = \"RangeScanner\"");
    client.run(2.0);
    assert!(count(&client, "RangeScanner") <= 1 && count(&client, "Odometry") >= 9);
    client.lines.clear();
    client.run(2.0);
    assert!(count(&client, "RangeScanner") >= 8);
}

#[test]
fn lines_come_late_twice_in_pieces_and_garbled() {
    let mut client = with("kind = \"delay\"\nvalue = 0.4");
    client.run(2.0);
    let age = |client: &Client| {
        let line = client.lines.iter().rfind(|line| line.starts_with("STA")).unwrap();
        (client.session.now() - parse(line.as_bytes()).message.time().unwrap()).seconds()
    };
    assert!((0.39..0.7).contains(&age(&client)), "{}", age(&client));

    let mut client = with("kind = \"duplicate\"\nwhat = \"STA\"");
    client.run(2.0);
    assert!(client.lines.iter().filter(|line| line.starts_with("STA")).count() >= 18);

    let mut client = with("kind = \"split\"\nvalue = 0.06");
    let mut halves = 0;
    for _ in 0..100 {
        client.session.advance(Span::from_millis(20));
        let bytes = client.session.take_output(client.id);
        halves += usize::from(!bytes.is_empty() && !bytes.ends_with(b"\r\n"));
    }
    // What is behind a late piece waits with it: one cut for each burst.
    assert!(halves >= 8, "{halves}");

    let mut client = with("kind = \"garble\"\nvalue = 0.5");
    client.run(2.0);
    let unknown = |line: &&String| {
        let parsed = parse(line.as_bytes());
        matches!(parsed.message, Message::Unknown(_)) || !parsed.problems.is_empty()
    };
    let damaged = client.lines.iter().filter(unknown).count();
    assert!(damaged > 5 && damaged < client.lines.len(), "{damaged} of {}", client.lines.len());
}

#[test]
fn a_stall_holds_everything_back_and_lets_it_all_through() {
    let mut client = with("kind = \"stall\"");
    client.run(0.2);
    client.lines.clear();
    client.run(1.6);
    assert_eq!(client.lines.len(), 0);
    client.run(0.5);
    assert!(count(&client, "Odometry") >= 9);
}

#[test]
fn a_disconnect_closes_the_connection_and_takes_the_robot() {
    let mut client = with("kind = \"disconnect\"");
    assert!(!client.session.is_closed(client.id));
    client.run(0.3);
    assert!(client.session.is_closed(client.id) && client.session.truth(client.id).is_none());
    client.id = client.session.connect();
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    client.run(3.0);
    assert!(client.session.truth(client.id).is_some(), "it strikes once");
}

#[test]
fn a_sensor_falls_silent() {
    let mut client = with("kind = \"sensor_loss\"\nwhat = \"Odometry\"");
    client.run(2.0);
    assert!(count(&client, "Odometry") <= 1 && count(&client, "INS") >= 9);
}

#[test]
fn a_tilt_sticks_and_its_limits_shrink() {
    let mut client = with("kind = \"tilt_stuck\"");
    client.run(0.2);
    client.send("MISPKG {Name CameraPanTilt} {Link 2} {Value 0.3}");
    client.run(1.5);
    assert_eq!(client.truth().tilt_rad, 0.0);
    client.run(4.0);
    assert!((client.truth().tilt_rad + 0.3).abs() < 0.01, "free again");

    let mut client = with("kind = \"tilt_limits\"\nvalue = 0.1");
    client.run(0.2);
    client.send("MISPKG {Name CameraPanTilt} {Link 2} {Value 0.3}");
    client.run(1.7);
    assert!((client.truth().tilt_rad + 0.1).abs() < 0.01, "{}", client.truth().tilt_rad);
}

#[test]
fn a_wheel_sticks() {
    let mut client = with("kind = \"wheel_stuck\"\nwhat = \"left\"");
    client.send("DRIVE {Left 2} {Right 2}");
    client.run(1.5);
    assert!(client.truth().angular_rps.z > 0.1, "it turns about the left side");
}

#[test]
fn odometry_runs_at_another_scale() {
    let mut client = with("kind = \"odometry_scale\"\nvalue = 1.5");
    client.run(0.3);
    let way = |client: &Client| {
        let line = client.of_type("Odometry").last().unwrap().to_string();
        let Message::Sen(Sen::Odometry(odometry)) = parse(line.as_bytes()).message else {
            panic!()
        };
        (odometry.x_m, client.truth().world_from_robot.translation.x)
    };
    let before = way(&client);
    client.send("DRIVE {Left 2} {Right 2}");
    client.run(1.6);
    let after = way(&client);
    let ratio = (after.0 - before.0) / (after.1 - before.1);
    assert!((ratio - 1.5).abs() < 0.15, "{ratio}");
}

#[test]
fn the_clock_jumps_and_jumps_back() {
    let mut client = with("kind = \"clock_jump\"\nvalue = -30.0");
    client.run(1.0);
    let off = |client: &Client| {
        let line = client.lines.iter().rfind(|line| line.starts_with("STA")).unwrap();
        (client.session.now() - parse(line.as_bytes()).message.time().unwrap()).seconds()
    };
    assert!((30.0..30.4).contains(&off(&client)), "{}", off(&client));
    client.run(2.0);
    assert!(off(&client) < 0.4);
}

#[test]
fn a_shove_moves_the_body() {
    let mut client = with("kind = \"shove\"\nwhat = \"forward\"\nvalue = 2.0");
    let before = client.truth().world_from_robot.translation.x;
    client.run(0.3);
    assert!(client.truth().world_from_robot.translation.x > before + 0.02);
}

#[test]
fn a_fault_befalls_the_robot_it_names() {
    let more = "[[fault]]\nat_s = 0.0\nkind = \"drop\"\nrobot = \"R2\"\n";
    let robots =
        format!("{}[[robot]]\nname = \"R2\"\nclass = \"USARBot.P3AT\"\n{more}", scenario(""));
    let mut client = Client::new(BOX, &robots);
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    let other = client.session.connect();
    client.session.receive(other, b"INIT {ClassName USARBot.P3AT} {Name R2} {Start StartB}\r\n");
    client.run(2.0);
    assert!(count(&client, "Odometry") > 5);
    let heard = client.session.take_output(other);
    assert!(!heard.windows(4).any(|octets| octets == b"SEN "), "nothing after the greeting");
}
