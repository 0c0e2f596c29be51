//! A connection lost after a finished sweep: what was mapped before is there after, and used.

use crate::replay::recorded;
use std::path::Path;
use usar_agent::config::read_plain;
use usar_agent::driver::lockstep::Lockstep;
use usar_agent::driver::replay::Replay;
use usar_agent::files::scenario::load;
use usar_agent::mission::Agent;
use usar_agent::record::{What, read};
use usar_agent::sim::{FaultKind, FaultSpec};

/// The connection goes when the robot has swept, and drives.
const LOST_AT_S: f64 = 45.0;

/// The planes of the map to the last bit, and the number of points that were measured.
fn mapped(agent: &Agent) -> (Vec<Vec<u8>>, usize) {
    let belief = agent.running().expect("a robot was in service").belief();
    let planes = belief.mapper().landmarks();
    let planes = planes.iter().map(|plane| postcard::to_stdvec(plane).unwrap()).collect();
    (planes, belief.points().len())
}

#[test]
fn planes_of_a_finished_sweep_outlive_the_connection_and_are_seen_again() {
    let mut loaded = load(Path::new("box"), &[]).unwrap();
    loaded.agent.mission.fine_sweep_at_start = false;
    loaded.agent.mission.time_limit_s = LOST_AT_S + 75.0;
    loaded.files.scenario.faults.push(FaultSpec {
        at_s: LOST_AT_S,
        for_s: None,
        robot: None,
        kind: FaultKind::Disconnect,
        what: None,
        value: None,
    });
    let mut lockstep = recorded(&loaded);
    let agent = |lockstep: &Lockstep<Vec<u8>>| lockstep.agents().next().unwrap().clone();

    while lockstep.agents().next().unwrap().is_in_service() || lockstep.now().seconds() < 20.0 {
        assert!(lockstep.step().unwrap() && lockstep.now().seconds() < LOST_AT_S + 1.0);
    }
    let before = mapped(&agent(&lockstep));
    assert!(
        before.0.len() >= 4 && before.1 > 5000,
        "{} planes, {} points",
        before.0.len(),
        before.1
    );

    while !lockstep.agents().next().unwrap().is_in_service() {
        assert!(lockstep.step().unwrap());
    }
    let after = mapped(&agent(&lockstep));
    assert!(after == before, "{} planes and {} points are left", after.0.len(), after.1);

    let seen_before = agent(&lockstep).running().unwrap().ledger().associations;
    while lockstep.step().unwrap() {}
    let ended = agent(&lockstep);
    let running = ended.running().unwrap();
    let seen_again = running.ledger().associations - seen_before;
    assert!(seen_again >= 4, "the planes were seen {seen_again} times after the loss");
    assert!(mapped(&ended).1 > after.1, "it went on mapping");
    let truth = lockstep.truth(0).unwrap().world_from_robot;
    let error = running.belief().world_from_robot().inv_mul(&truth);
    assert!(error.translation.vector.norm() < 0.1, "{:.3} m off", error.translation.vector.norm());

    let (_, bytes) = lockstep.finish_recordings().unwrap().remove(0);
    let recording = read(&bytes.unwrap()).unwrap();
    let count = |is: fn(&What) -> bool| recording.entries.iter().filter(|e| is(&e.what)).count();
    assert_eq!(count(|what| matches!(what, What::Connected)), 2);
    assert_eq!(count(|what| matches!(what, What::Disconnected(_))), 1);
    let config = read_plain("recorded", &recording.header.config).unwrap();
    let mut replay =
        Replay::new(Agent::new(config, recording.header.placement.clone()), &recording);
    while replay.step().unwrap() {}
    assert!(replay.finish().2.is_none(), "one recording over both connections");
}
