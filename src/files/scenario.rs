//! Scenarios with the agent's configuration for them.

use super::agent_config::{Source, agent_config};
use super::world::{WorldFiles, WorldFilesError, load_world, scenario_text};
use crate::mission::{AgentConfig, Placement};
use std::path::Path;

/// A scenario, its world, and the agent of its first robot.
#[derive(Clone, Debug)]
pub struct LoadedScenario {
    /// Its name: that of its file.
    pub name: String,
    /// Scenario, map, robots and world.
    pub files: WorldFiles,
    /// The agent's configuration: defaults, `[agent]` of the scenario, then the overrides.
    pub agent: AgentConfig,
    /// Where the first robot is put.
    pub placement: Placement,
}

/// Loads the scenario at a path, or one in the program by its bare name.
///
/// # Errors
///
/// Everything wrong with the first file that has anything wrong.
pub fn load(path: &Path, overrides: &[Source]) -> Result<LoadedScenario, WorldFilesError> {
    let files = load_world(path)?;
    let own = Source {
        file: path.display().to_string(),
        text: scenario_text(path)?,
        section: Some("agent"),
    };
    let sources: Vec<Source> = std::iter::once(own).chain(overrides.iter().cloned()).collect();
    let mut agent = agent_config(&sources)?;
    agent.mission.time_limit_s = files.scenario.time_limit_s;
    let mut placement = Placement::FirstStart;
    if let Some(robot) = files.scenario.robots.first() {
        agent.mission.name.clone_from(&robot.name);
        agent.mission.class.clone_from(&robot.class);
        placement = robot.start.clone().map_or(placement, Placement::Start);
    }
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    Ok(LoadedScenario { name, files, agent, placement })
}
