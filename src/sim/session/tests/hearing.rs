//! What a robot hears: the calls of living victims.

use super::*;

fn listening(dialect: &str, kind: &str, map: &str) -> Client {
    let ears = format!(
        "[[robot.sensor]]\ntype = \"{kind}\"\nname = \"Ears\"\nposition = [0.0, 0.0, 1.0]\n"
    );
    let mut client =
        Client::new(map, &format!("{}{ears}", scenario(&format!("dialect = \"{dialect}\""))));
    client.send("INIT {ClassName USARBot.P3AT} {Name R1} {Start StartA}");
    client.run(12.0);
    client
}

#[test]
fn udk_tells_every_second_what_it_heard_and_from_where() {
    let client = listening("udk", "Acoustic", BOX);
    let lines = client.of_type("Acoustic");
    assert!((10..=12).contains(&lines.len()), "once a second: {lines:?}");
    assert!(lines.iter().all(|line| line.contains("{Name AcousticArraySensor_0} {")));
    let is_silent = |line: &&&String| line.ends_with("{Name AcousticArraySensor_0} {None}");
    let silent = lines.iter().filter(is_silent).count();
    let heard: Vec<&&String> = lines.iter().filter(|line| !is_silent(line)).collect();
    assert!((2..=3).contains(&heard.len()), "once in five seconds: {heard:?}");
    assert!(silent > heard.len());
    let world = World::new(&MapFile::parse(BOX).unwrap(), &BTreeMap::new()).unwrap();
    let victim = world.victims()[0].world_from_victim.translation.vector;
    let ear = client.truth().world_from_robot.translation.vector;
    for line in heard {
        let Message::Sen(Sen::Acoustic(acoustic)) = parse(line.as_bytes()).message else {
            panic!("{line}")
        };
        let [sound] = &acoustic.sounds[..] else { panic!("{line}") };
        let crate::protocol::message::sen::HeardSound::Near { direction, volume, delay_s, .. } =
            sound
        else {
            panic!("{line}")
        };
        let [right, ahead] = [-(victim.y - ear.y), victim.x - ear.x];
        let off = direction[1].atan2(direction[0]) - right.atan2(ahead);
        assert!(off.abs() < 0.03, "{line}: off by {off}");
        let expected = 60.0 - 20.0 * right.hypot(ahead).log10();
        assert!((volume - expected).abs() < 0.5 && *delay_s < 0.05, "{line}: {expected}");
    }
}

#[test]
fn ut2004_tells_the_loudness_and_nothing_of_silence() {
    let client = listening("ut2004", "Sound", BOX);
    let lines = client.of_type("Sound");
    assert!((2..=3).contains(&lines.len()), "{lines:?}");
    assert!(lines[0].starts_with("SEN {Type Sound} {Name Ears} {Loudness "), "{lines:?}");
    assert!(lines[0].ends_with("} {Duration 1.4000}"), "{lines:?}");
}

#[test]
fn the_dead_are_silent() {
    let dead = BOX.replace("status = \"alive\"", "status = \"dead\"");
    assert_ne!(dead, BOX);
    let client = listening("udk", "Acoustic", &dead);
    assert!(client.of_type("Acoustic").iter().all(|line| line.ends_with("{None}")));
}
