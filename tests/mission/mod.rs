//! The mission as a whole, in lockstep with the stand-in.

use crate::replay::{record, scenario};

#[test]
fn the_place_told_at_the_end_is_one_that_a_sweep_corrected() {
    for end_s in [140.0, 147.0, 155.0] {
        let (agent, _) = record(&scenario(3, end_s));
        let belief = agent.running().unwrap().belief();
        assert!(belief.path_m() > 0.3, "{end_s}: the robot hardly moved");
        assert!(belief.leg_m() < 0.05, "{end_s}: {} m since the last sweep", belief.leg_m());
    }
}

#[test]
fn a_rig_that_tilts_but_never_looks_down_stands_still() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("up.toml");
    let text = std::fs::read_to_string(root.join("scenarios/box.toml")).unwrap();
    let map = root.join("maps/box.toml");
    let text = text.replace("../maps/box.toml", map.to_str().unwrap());
    let up = "[[robot.pan_tilt]]\nname = \"CameraPanTilt\"\ntilt_limits_rad = [0.1, 0.4]\n";
    let at = text.find("\n[agent").map_or(text.len(), |at| at + 1);
    std::fs::write(&path, format!("{}{up}{}", &text[..at], &text[at..])).unwrap();
    let mut loaded = usar_agent::files::scenario::load(&path, &[]).unwrap();
    loaded.agent.mission.time_limit_s = 40.0;
    let (agent, _) = record(&loaded);
    let running = agent.running().unwrap();
    assert!(running.ledger().sweeps.is_empty() && running.belief().path_m() < 0.01);
    let warned =
        agent.journal().since(0).iter().any(|note| note.text.contains("cannot see an edge"));
    assert!(warned, "{:?}", agent.journal().since(0));
}
