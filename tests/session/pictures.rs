//! Viewers of the image server, and the monitor port.

use super::{PATIENCE, Stand};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use usar_agent::protocol::Dialect::{Udk, Ut2004};

/// One picture: its type and its data.
fn picture(stream: &mut TcpStream) -> (u8, Vec<u8>) {
    let mut head = [0; 5];
    stream.read_exact(&mut head).unwrap();
    let length = u32::from_be_bytes(head[1..].try_into().unwrap());
    let mut data = vec![0; length as usize];
    stream.read_exact(&mut data).unwrap();
    (head[0], data)
}

fn viewer(stand: &Stand) -> TcpStream {
    let stream = TcpStream::connect(stand.images).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream
}

/// How many different colours there are among raw pixels.
fn colours(pixels: &[u8]) -> usize {
    let mut seen: Vec<&[u8]> = pixels.chunks_exact(3).collect();
    seen.sort_unstable();
    seen.dedup();
    seen.len()
}

#[test]
fn ut2004_pushes_a_jpeg_and_then_sends_one_for_each_ok() {
    let stand = Stand::of("yellow", Ut2004);
    let mut viewer = viewer(&stand);
    // Nobody is in the world yet: whoever looks sees it from above the first start.
    let (kind, data) = picture(&mut viewer);
    assert_eq!((kind, &data[..2]), (2, &[0xff, 0xd8][..]));
    let mut robot = stand.client();
    robot.send("INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.5,1.9,1.8}\r\n");
    robot.line_of("STA ");
    for request in ["OK\r\n", "OKOK"] {
        viewer.write_all(request.as_bytes()).unwrap();
    }
    let frames: Vec<_> = (0..3).map(|_| picture(&mut viewer)).collect();
    assert!(frames.iter().all(|(kind, data)| *kind == 2 && data.len() > 2000));
    assert_ne!(frames[0].1, data, "the robot's camera, not the bystander's");
}

#[test]
fn udk_waits_to_be_asked_and_cuts_parts() {
    let stand = Stand::of("yellow", Udk);
    let mut robot = stand.client();
    robot.send("INIT {ClassName USARBot.P3AT} {Name R1} {Location 4.5,1.9,1.8}\r\n");
    robot.line_of("STA ");
    let mut viewer = viewer(&stand);
    viewer.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    assert!(viewer.read(&mut [0]).is_err(), "nothing is pushed");
    viewer.set_read_timeout(Some(PATIENCE)).unwrap();
    viewer.write_all(b"OK").unwrap();
    let (kind, whole) = picture(&mut viewer);
    assert_eq!((kind, &whole[..4]), (0, &[2, 128, 1, 224][..]), "640 × 480 raw");
    assert_eq!(whole.len(), 4 + 640 * 480 * 3);
    let part = |x: u32, y: u32, width: u32, height: u32| {
        let numbers = [x, y, width, height].into_iter().flat_map(u32::to_be_bytes);
        std::iter::once(b'U').chain(numbers).collect::<Vec<u8>>()
    };
    // The only camera's tile, as CONF tells it; then one that no camera fills.
    viewer.write_all(&part(0, 0, 320, 240)).unwrap();
    let (_, tile) = picture(&mut viewer);
    assert_eq!(&tile[..4], [1, 64, 0, 240]);
    assert!(colours(&tile[4..]) > 20, "{} colours", colours(&tile[4..]));
    viewer.write_all(&part(320, 240, 320, 240)).unwrap();
    assert_eq!(colours(&picture(&mut viewer).1[4..]), 1, "black");
    viewer.write_all(&part(u32::MAX, 7, u32::MAX, u32::MAX)).unwrap();
    assert_eq!(&picture(&mut viewer).1[..4], [2, 128, 1, 224], "no more than the screen");
}

#[test]
fn a_split_screen_tells_each_robot_its_tile() {
    let stand = Stand::of("yellow", Ut2004);
    let mut first = stand.client();
    first.send("INIT {ClassName USARBot.P2AT} {Name R1} {Location 4.5,1.9,1.8}\r\n");
    assert!(first.line_of("STA ").ends_with("{View -1}"));
    let mut screen = stand.client();
    screen.send("INIT {ClassName USARBot.MultiView}\r\n");
    let mut second = stand.client();
    second.send("INIT {ClassName USARBot.P2AT} {Name R2} {Location 8.8,2.0,1.8}\r\n");
    assert!(second.line_of("STA ").ends_with("{View 1}"));
    while !first.line_of("STA ").ends_with("{View 0}") {}
    drop(screen);
    while !first.line_of("STA ").ends_with("{View -1}") {}
}

#[test]
fn the_monitor_port_tells_positions_and_obstacles() {
    let stand = Stand::of("yellow", Ut2004);
    let mut robots: Vec<_> = [("R1", "4.5,1.9,1.8"), ("R2", "1.4,6.0,1.8")]
        .into_iter()
        .map(|(name, place)| {
            let mut robot = stand.client();
            robot.send(&format!(
                "INIT {{ClassName USARBot.P2AT}} {{Name {name}}} {{Location {place}}}\r\n"
            ));
            robot.line_of("STA ");
            robot
        })
        .collect();
    let mut stream = TcpStream::connect(stand.monitor).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut reader = BufReader::new(stream.try_clone().unwrap());
    let mut ask = |request: &str| {
        stream.write_all(format!("{request}\r\n").as_bytes()).unwrap();
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        line.strip_suffix("\r\n").unwrap().to_owned()
    };
    let positions = ask("GETPOS");
    assert!(
        positions.starts_with("POSITIONS {Robots 2} {Name R1 Location 4.")
            && positions.contains(" BatteryEmpty False} {Name R2 Location 1."),
        "{positions}"
    );
    // The partition lies between them.
    assert_eq!(ask("GETOBS {From R1} {To R2}"), "NUMOBS {From R1} {To R2} {ObstCount 1.0000}");
    assert_eq!(ask("GETOBS {From R1} {To R9}"), "NUMOBS {From R1} {To R9} {ObstCount -1.0000}");
    assert_eq!(
        ask("GETOBS {Start 3.0,3.0,1.0} {End 3.0,5.0,1.0}"),
        "NUMOBS {Start 3.0,3.0,1.0} {End 3.0,5.0,1.0} {ObstCount 1.0000}"
    );
    robots.pop();
    while ask("GETPOS").contains("R2") {}
}

#[test]
fn udk_tells_the_true_poses_to_who_asks_without_a_verb() {
    let stand = Stand::of("yellow", Udk);
    let mut robot = stand.client();
    robot.send("INIT {ClassName USARBot.P3AT} {Name R1} {Location 4.5,1.9,1.8}\r\n");
    robot.line_of("STA ");
    let mut stream = TcpStream::connect(stand.monitor).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut reader = BufReader::new(stream.try_clone().unwrap());
    let mut ask = |request: &str| {
        stream.write_all(format!("{request}\r\n").as_bytes()).unwrap();
        let mut lines: Vec<String> = Vec::new();
        while lines.last().is_none_or(|line| line != "{End}\r\n") {
            let mut line = String::new();
            assert!(reader.read_line(&mut line).unwrap() > 0, "{lines:?}");
            lines.push(line);
        }
        lines
    };
    for all in ["{}", "{class USARBot.P3AT}", "{Class p3at} {Name r1}"] {
        let lines = ask(all);
        assert_eq!(lines.len(), 2, "{all}");
        assert!(lines[0].starts_with("{Name R1} {Class P3AT} {Time "), "{lines:?}");
        assert!(lines[0].contains("} {Location 4.50,1.90,1.8"), "{lines:?}");
        assert!(lines[0].contains("} {Rotation "), "{lines:?}");
    }
    assert_eq!(ask("{class USARPhysObj.partc} {name part_c_6}"), ["{End}\r\n"]);
}
