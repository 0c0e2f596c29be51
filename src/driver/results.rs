//! What a run came to, as far as its session tells: the world it took place in is not known.

use super::simulated::{MissionResult, log_text};
use crate::export::run_folder;
use crate::export::score::{Bystander, pose_error};
use crate::export::tum::{self, TimedPose};
use crate::mission::Agent;

/// Report and files of an agent's run. Where the server has a ground truth sensor its readings score
/// the pose; everything else that needs the truth stays empty.
pub fn results(agent: &Agent, bystander: &Bystander, scenario: &str, seed: u64) -> MissionResult {
    let mut report = run_folder::agent_report(agent, scenario, seed);
    if let Some(running) = agent.running() {
        let trajectory: Vec<TimedPose> = running
            .belief()
            .trajectory()
            .into_iter()
            .map(|(stamp, pose)| TimedPose { time_s: stamp.seconds(), pose })
            .collect();
        let truth = bystander.truth();
        report.pose_error = pose_error(&trajectory, truth, length_m(truth), bystander);
    }
    let title = format!("{scenario}, {:.0} s: {}", report.mission_time_s, report.outcome);
    let mut files = run_folder::map_files(agent, &title);
    if !bystander.truth().is_empty() {
        files.push(("truth.tum", tum::format(bystander.truth()).into_bytes()));
    }
    files.push(("log.txt", log_text(agent).into_bytes()));
    MissionResult { report, files }
}

/// Length of a path. Steps below the sensor's own two decimals are not counted: a robot that stands
/// would drive with them.
fn length_m(path: &[TimedPose]) -> f64 {
    const STEP_M: f64 = 0.03;
    let Some(mut last) = path.first().map(|timed| timed.pose.translation.vector) else {
        return 0.0;
    };
    let mut length = 0.0;
    for timed in path {
        let step = (timed.pose.translation.vector - last).norm();
        if step >= STEP_M {
            length += step;
            last = timed.pose.translation.vector;
        }
    }
    length
}
