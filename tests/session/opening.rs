//! The agent's opening against the stand-in in lockstep: which way the head's joints turn.

use std::path::Path;
use usar_agent::driver::simulated::SimulatedMission;
use usar_agent::files::scenario;

/// Runs a mission until the test motion has been judged. Gives what was noted of tilt and pan, and
/// whether the rig's tilt and pan then turn as on a server that keeps to its frames.
fn judged(name: &str, pan_inverted: bool, tilt_inverted: bool) -> (Vec<String>, [bool; 2]) {
    let mut loaded = scenario::load(Path::new(name), &[]).unwrap();
    let robot = &mut loaded.files.scenario.robots[0];
    let class = loaded.files.catalogue.find(&robot.class, loaded.files.scenario.dialect);
    let mut units = robot.pan_tilt.clone().unwrap_or_else(|| class.unwrap().pan_tilt.clone());
    units[0].pan_inverted = Some(pan_inverted);
    units[0].tilt_inverted = Some(tilt_inverted);
    robot.pan_tilt = Some(units);
    let mut mission = SimulatedMission::new(loaded, Vec::new()).unwrap();
    let mut notes = Vec::new();
    let mut seen = 0;
    while notes.len() < 2 {
        assert!(mission.now().seconds() < 60.0, "the test motion never ends: {notes:?}");
        mission.step().unwrap();
        let journal = mission.agent().journal();
        let new = journal.since(seen).iter().map(|note| note.text.clone());
        notes.extend(new.filter(|text| text.starts_with("tilt: ") || text.starts_with("pan: ")));
        seen = journal.len();
    }
    let head = &mission.agent().running().unwrap().rig().laser.as_ref().unwrap().head;
    let plain =
        [head.pan().unwrap().core_per_wire == 1.0, head.tilt().unwrap().core_per_wire == -1.0];
    (notes, plain)
}

#[test]
fn joints_that_turn_as_promised_are_left_alone() {
    for name in ["station", "station_udk"] {
        let (notes, plain) = judged(name, false, false);
        assert_eq!(notes, ["tilt: turns as believed", "pan: turns as believed"], "{name}");
        assert_eq!(plain, [true, true], "{name}");
    }
}

#[test]
fn a_tilt_that_turns_the_other_way_is_turned_round() {
    for name in ["station", "station_udk"] {
        let (notes, plain) = judged(name, false, true);
        assert!(notes[0].starts_with("tilt: turns the other way round"), "{name}: {notes:?}");
        assert_eq!((notes[1].as_str(), plain), ("pan: turns as believed", [true, false]), "{name}");
    }
}

#[test]
fn a_pan_that_turns_the_other_way_is_turned_round() {
    let (notes, plain) = judged("station", true, true);
    assert!(notes.iter().all(|note| note.contains("turns the other way round")), "{notes:?}");
    assert_eq!(plain, [false, false]);
}
