//! The mission as a whole, in lockstep with the stand-in.

use crate::replay::{record, scenario};
use nalgebra::Isometry3;
use usar_agent::driver::simulated::SimulatedMission;
use usar_agent::protocol::Dialect;
use usar_agent::sim::{FaultKind, FaultSpec, PanTiltSpec};

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
fn a_sweep_that_is_not_over_in_time_is_taken_in_as_far_as_it_came() {
    let mut cut_short = 0;
    for end_s in [40.0, 44.0, 48.0, 52.0] {
        // Times that noise leaves unsure make sweeps slow, and how long one takes is an estimate.
        let mut loaded = scenario(2, end_s);
        loaded.files.scenario.noise.range_sigma_m = 0.01;
        let (agent, _) = record(&loaded);
        let notes = agent.journal().since(0);
        if notes.iter().any(|note| note.text.ends_with("sweep: the time is up")) {
            let running = agent.running().unwrap();
            let (told, known) =
                (running.ledger().sweeps.len(), running.belief().mapper().keyframes().len());
            assert!(told > 0 && known == told, "{end_s}: {known} of {told} sweeps");
            cut_short += 1;
        }
    }
    assert!(cut_short > 0, "no sweep was under way at the end");
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

#[test]
fn no_head_is_taken_to_turn_the_other_way_round_because_the_line_is_slow() {
    for (dialect, late_s) in [(Dialect::Ut2004, 2.0), (Dialect::Ut2004, 3.0), (Dialect::Udk, 2.0)] {
        let name = if dialect == Dialect::Udk { "station_udk" } else { "box" };
        let mut loaded =
            usar_agent::files::scenario::load(std::path::Path::new(name), &[]).unwrap();
        loaded.agent.mission.time_limit_s = 60.0;
        let files = &mut loaded.files.scenario;
        let kind = FaultKind::Delay;
        let late = FaultSpec {
            at_s: 1.0,
            for_s: None,
            robot: None,
            kind,
            what: None,
            value: Some(late_s),
        };
        files.faults = vec![late];
        let unit = PanTiltSpec { name: "CameraPanTilt".to_owned(), ..PanTiltSpec::default() };
        files.robots[0].pan_tilt.get_or_insert_with(|| vec![unit])[0].status = Some(false);
        let (agent, _) = record(&loaded);
        let notes = agent.journal().since(0);
        let told = |part: &str| notes.iter().any(|note| note.text.contains(part));
        assert!(told("tilt: turns as believed"), "{dialect:?} {late_s}: {notes:?}");
        assert!(!told("the other way round"), "{dialect:?} {late_s}: {notes:?}");
    }
}

/// A laser that does not tilt shows walls, and walls show where the robot is.
#[test]
fn a_robot_with_a_fixed_laser_keeps_its_place_by_its_lines() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fixed.toml");
    let text = std::fs::read_to_string(root.join("scenarios/yellow.toml")).unwrap();
    let map = root.join("maps/yellow.toml");
    let text = text.replace("../maps/yellow.toml", map.to_str().unwrap());
    let text = text.replace("USARBot.P3AT", "USARBot.P2AT");
    std::fs::write(&path, text + "\n[agent.belief.terrain]\nflat_floor = true\n").unwrap();
    let mut loaded = usar_agent::files::scenario::load(&path, &[]).unwrap();
    loaded.agent.mission.time_limit_s = 150.0;
    let mut mission = SimulatedMission::new(loaded, std::io::sink()).unwrap();
    let mut worst_m = 0.0_f64;
    // The map begins where the robot did.
    let mut map_from_world: Option<Isometry3<f64>> = None;
    while mission.step().unwrap() {
        let (Some(truth), Some(running)) = (mission.truth(), mission.agent().running()) else {
            continue;
        };
        let estimate = running.belief().world_from_robot();
        let truth = truth.world_from_robot;
        let frame = *map_from_world.get_or_insert_with(|| estimate * truth.inverse());
        let apart = estimate.translation.vector - (frame * truth).translation.vector;
        worst_m = worst_m.max(apart.xy().norm());
    }
    let path_m = mission.agent().running().unwrap().belief().path_m();
    assert!(path_m > 6.0, "{path_m} m driven");
    // Odometry and inertial unit alone came to be 0.24 m off in this time.
    assert!(worst_m < 0.15, "{worst_m} m off on {path_m} m");
}

/// The box world with `more` in it and the robot set down in the middle, headed 20 degrees left of x.
fn set_down_on(more: &str, height_m: f64, until_s: f64) -> usar_agent::mission::Agent {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let map = std::fs::read_to_string(root.join("maps/box.toml")).unwrap();
    let map = &map[..map.find("[[start]]").unwrap()];
    let start =
        format!("[[start]]\nname = \"A\"\nposition = [-1.5, 0.0, {height_m}]\nyaw_deg = 20.0\n");
    std::fs::write(folder.path().join("map.toml"), format!("{map}{more}{start}")).unwrap();
    let text = "map = \"map.toml\"\ntime_limit_s = 300.0\nseed = 1\ndialect = \"ut2004\"\n\n\
                [[phase]]\nname = \"autonomous\"\nuntil_s = 300.0\n\n\
                [[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\nstart = \"A\"\n";
    let path = folder.path().join("set_down.toml");
    std::fs::write(&path, text).unwrap();
    let mut loaded = usar_agent::files::scenario::load(&path, &[]).unwrap();
    loaded.agent.mission.time_limit_s = until_s;
    record(&loaded).0
}

#[test]
fn a_robot_set_down_on_a_board_or_a_ramp_finds_out_how_it_stands() {
    let board =
        "[[box]]\nname = \"board\"\ncenter = [-1.3, 0.3, 0.015]\nsize = [0.5, 0.35, 0.03]\n";
    let ramp = "[[wedge]]\nname = \"ramp\"\ncenter = [-1.0, 0.0, 0.25]\nsize = [4.0, 2.4, 0.5]\n";
    for (more, height_m, least_rad) in [(board, 0.2, 0.02), (ramp, 0.5, 0.1)] {
        let agent = set_down_on(more, height_m, 160.0);
        let belief = agent.running().unwrap().belief();
        let up = nalgebra::Vector3::z_axis();
        let stood_rad = (belief.start().rotation * up).angle(&up);
        assert!(stood_rad > least_rad, "{stood_rad} rad");
        let turned_round = |text: &str| text.contains("turns the other way round");
        assert!(!agent.journal().since(0).iter().any(|note| turned_round(&note.text)));
        // What it sees from then on hangs together, and stands upright.
        let mapper = belief.mapper();
        let known = (1..mapper.keyframes().len()).map(|at| mapper.sightings(at).len());
        assert!(known.clone().count() > 1 && known.min() > Some(2), "{least_rad}");
        let walls = mapper.landmarks().iter().filter(|wall| wall.area_m2() > 4.0);
        let upright = walls.filter(|wall| wall.normal().z.abs() < 0.003).count();
        assert!(upright >= 3, "{upright} walls stand upright");
    }
}

#[test]
fn a_robot_with_a_wheel_on_a_thick_board_knows_its_height_and_gets_off_it() {
    let level = set_down_on("", 0.2, 90.0);
    let board =
        "[[box]]\nname = \"board\"\ncenter = [-1.3, 0.3, 0.025]\nsize = [0.35, 0.35, 0.05]\n";
    let tilted = set_down_on(board, 0.2, 200.0);
    let height_m =
        |agent: &usar_agent::mission::Agent| agent.running().unwrap().rig().body.origin_height_m;
    // Along its own z it looked into the floor's depth 2 m ahead: 0.54 m.
    let off_m = height_m(&tilted) - height_m(&level);
    assert!(off_m.abs() < 0.01, "{off_m} m off");
    let path_m = tilted.running().unwrap().belief().path_m();
    assert!(path_m > 2.0, "{path_m} m driven");
}
