//! Recordings through the same computation: own ones give every action again, those of others are
//! looked at.

use std::path::{Path, PathBuf};
use usar_agent::config::read_plain;
use usar_agent::driver::host::Host;
use usar_agent::driver::lockstep::Lockstep;
use usar_agent::driver::observed::{observing, recording_of_text, server_side};
use usar_agent::driver::replay::Replay;
use usar_agent::driver::results::results;
use usar_agent::export::report::PoseError;
use usar_agent::files::scenario::{LoadedScenario, load};
use usar_agent::mission::{Agent, AgentConfig};
use usar_agent::protocol::capture::Capture;
use usar_agent::record::{Header, Recording, What, Writer, read};
use usar_agent::sim::Session;
use usar_agent::time::Arrival;

/// A mission of `until_s` seconds in the box world without the long sweep at the start: the first goal
/// comes within half a minute.
pub fn scenario(seed: u64, until_s: f64) -> LoadedScenario {
    let mut loaded = load(Path::new("box"), &[]).unwrap();
    loaded.files.scenario.seed = seed;
    loaded.agent.mission.fine_sweep_at_start = false;
    loaded.agent.mission.time_limit_s = until_s;
    loaded
}

/// A mission at its beginning, in lockstep and recorded.
pub fn recorded(loaded: &LoadedScenario) -> Lockstep<Vec<u8>> {
    let files = &loaded.files;
    let session = Session::new(&files.world, &files.scenario, &files.catalogue).unwrap();
    let header = Header {
        seed: files.scenario.seed,
        scenario: loaded.name.clone(),
        config: toml::to_string(&loaded.agent).unwrap(),
        placement: loaded.placement.clone(),
    };
    let agent = Agent::new(loaded.agent.clone(), loaded.placement.clone());
    let host = Host::new(agent, Some(Writer::new(Vec::new(), &header).unwrap()));
    Lockstep::new(session, vec![host]).unwrap()
}

/// Runs a mission in lockstep; gives the agent and the recording's bytes.
pub fn record(loaded: &LoadedScenario) -> (Agent, Vec<u8>) {
    let mut lockstep = recorded(loaded);
    while lockstep.step().unwrap() {}
    let (agent, bytes) = lockstep.finish_recordings().unwrap().remove(0);
    (agent, bytes.unwrap())
}

fn replayed(recording: &Recording) -> (Agent, Option<String>) {
    let config = read_plain("recorded", &recording.header.config).unwrap();
    let agent = Agent::new(config, recording.header.placement.clone());
    let mut replay = Replay::new(agent, recording);
    while replay.step().unwrap() {}
    let (agent, _, difference) = replay.finish();
    (agent, difference.map(|difference| difference.to_string()))
}

/// All of an agent, as bytes.
fn state(agent: &Agent) -> Vec<u8> {
    postcard::to_stdvec(agent).unwrap()
}

#[test]
fn the_replay_of_a_recording_is_the_run() {
    let (agent, bytes) = record(&scenario(3, 65.0));
    let running = agent.running().unwrap();
    assert!(running.belief().path_m() > 0.0 && !running.ledger().sweeps.is_empty());
    let (again, difference) = replayed(&read(&bytes).unwrap());
    assert_eq!(difference, None);
    assert!(state(&again) == state(&agent), "the agents differ");
}

#[test]
fn a_changed_reading_is_found_where_it_first_matters() {
    let (_, bytes) = record(&scenario(3, 40.0));
    let mut recording = read(&bytes).unwrap();
    let sent: Vec<usize> = recording
        .entries
        .iter()
        .enumerate()
        .filter(|(_, entry)| matches!(entry.what, What::Sent(_)))
        .map(|(at, _)| at)
        .collect();
    let at = sent[sent.len() / 2];
    let What::Sent(line) = &mut recording.entries[at].what else { unreachable!() };
    let length = line.len();
    // A digit before the closing brace and the line end.
    line[length - 4] = if line[length - 4] == b'9' { b'8' } else { b'9' };
    let (_, difference) = replayed(&recording);
    let text = difference.expect("the change was not found");
    assert!(text.starts_with(&format!("entry {at} ")), "{text}");
}

#[test]
fn a_recording_cut_anywhere_replays_as_far_as_it_goes() {
    let (_, bytes) = record(&scenario(5, 30.0));
    for share in [0.3, 0.7, 0.95] {
        let cut = &bytes[..(bytes.len() as f64 * share) as usize];
        let recording = read(cut).unwrap();
        assert!(!recording.entries.is_empty());
        let (_, difference) = replayed(&recording);
        // What the last block lost may have been an answer to its last line.
        assert!(difference.is_none_or(|text| text.contains("recorded nothing")));
    }
}

#[test]
fn an_own_recording_can_be_only_looked_at() {
    let (_, bytes) = record(&scenario(3, 30.0));
    let recording = server_side(&read(&bytes).unwrap());
    let config: AgentConfig = read_plain("recorded", &recording.header.config).unwrap();
    let mut replay = Replay::new(Agent::new(observing(config), Default::default()), &recording);
    while replay.step().unwrap() {}
    let (agent, _, difference) = replay.finish();
    assert_eq!(difference, None, "an agent that looks on sends nothing");
    assert!(agent.running().is_some());
}

/// The recorded session of another client, if the reference data is there.
fn captured() -> Option<Vec<u8>> {
    let folder = std::env::var_os("USAR_REFERENCE_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let bytes = std::fs::read(folder.join("usarsim-session/session_30_scans.txt")).ok();
    if bytes.is_none() {
        println!("skipped: needs session_30_scans.txt");
    }
    bytes
}

fn observed(text: &[u8], class: &str) -> (Agent, Option<PoseError>) {
    let mut config = observing(AgentConfig::default());
    config.mission.class = class.into();
    let recording = recording_of_text(&Capture::read(text), Header::default());
    let mut replay = Replay::new(Agent::new(config, Default::default()), &recording);
    while replay.step().unwrap() {}
    let (agent, bystander, _) = replay.finish();
    let report = results(&agent, &bystander, "captured", 0).report;
    (agent, report.pose_error)
}

#[test]
fn a_session_of_another_client_gives_its_way_and_thin_walls() {
    let Some(text) = captured() else { return };
    let (agent, score) = observed(&text, "USARBot.P2DX");
    let belief = agent.running().unwrap().belief();
    // The robot crept forward by 0.12 m; its ground truth has two decimals.
    assert!((belief.path_m() - 0.12).abs() < 0.01, "{}", belief.path_m());
    assert!(score.unwrap().ate_rmse_m < 0.01, "{score:?}");
    let grid = belief.grid();
    let occupied: Vec<_> = grid
        .iter()
        .filter(|(_, cell)| cell.class == usar_agent::terrain::CellClass::Occupied)
        .map(|(cell, _)| grid.centre(cell))
        .collect();
    // The wall to the left is straight: its cells lie in one row of the grid.
    let left: Vec<f64> = occupied.iter().filter(|p| p.y > 4.4 && p.x < 1.0).map(|p| p.y).collect();
    let spread = left.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b))
        - left.iter().fold(f64::INFINITY, |a, b| a.min(*b));
    assert!(left.len() >= 15 && spread < 0.051, "{} cells over {spread} m", left.len());
}

#[test]
fn captured_text_cut_anywhere_is_still_read() {
    let Some(text) = captured() else { return };
    let mut driven = 0.0;
    for share in [0.05, 0.21, 0.4, 0.63, 0.8, 0.99] {
        let (agent, _) = observed(&text[..(text.len() as f64 * share) as usize], "USARBot.P2DX");
        let path_m = agent.running().unwrap().belief().path_m();
        assert!(path_m >= driven, "{path_m} after {driven}");
        driven = path_m;
    }
    assert!(driven > 0.1);
    // Without its beginning it is still a session.
    let (agent, _) = observed(&text[text.len() / 3..], "USARBot.P2DX");
    assert!(agent.running().is_some());
}

#[test]
fn a_class_that_tilts_its_laser_maps_level_lines_too() {
    let Some(text) = captured() else { return };
    let (agent, _) = observed(&text, "USARBot.P3AT");
    let grid = agent.running().unwrap().belief().grid();
    let occupied = grid
        .iter()
        .filter(|(_, cell)| cell.class == usar_agent::terrain::CellClass::Occupied)
        .count();
    assert!(occupied > 50, "{occupied} occupied cells");
    assert!(agent.mission_time() > Arrival::from_seconds(5.0) - Arrival::default());
}
