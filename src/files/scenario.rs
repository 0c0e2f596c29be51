//! Scenarios with everything they name: map, meshes, robots, agent configuration.

use super::agent_config::{Source, agent_config};
use crate::config::{self, ConfigError};
use crate::mission::AgentConfig;
use crate::sim::{MapFile, RobotCatalogue, Scenario, SpecError, World};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Robots that come with the program.
const ROBOTS: &str = include_str!("../../maps/robots.toml");

/// Scenarios that come with the program: name, scenario and map.
const EMBEDDED: &[(&str, &str, &str)] = &[
    ("box", include_str!("../../scenarios/box.toml"), include_str!("../../maps/box.toml")),
    ("planes", include_str!("../../scenarios/planes.toml"), include_str!("../../maps/planes.toml")),
    ("yellow", include_str!("../../scenarios/yellow.toml"), include_str!("../../maps/yellow.toml")),
];

/// A scenario and all it needs.
#[derive(Clone, Debug)]
pub struct LoadedScenario {
    /// Its name: that of its file.
    pub name: String,
    /// The scenario.
    pub scenario: Scenario,
    /// Its world.
    pub world: World,
    /// The robots known by class.
    pub catalogue: RobotCatalogue,
    /// The agent's configuration with the scenario's overrides, for its first robot.
    pub agent: AgentConfig,
}

/// Loads the scenario at a path, or one that comes with the program by its bare name.
///
/// # Errors
///
/// Everything wrong with the first file that has anything wrong.
pub fn load(path: &Path, overrides: &[Source]) -> Result<LoadedScenario, ConfigError> {
    if !path.exists()
        && let Some(name) = path.to_str()
        && EMBEDDED.iter().any(|(embedded, ..)| *embedded == name)
    {
        return load_embedded(name, overrides);
    }
    let text = read(path)?;
    let file = path.display().to_string();
    let scenario: Scenario = parse(&file, &text, Scenario::parse)?;
    let folder = path.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let map_path = folder.join(&scenario.map);
    let map_text = read(&map_path).map_err(|error| ConfigError {
        file: file.clone(),
        mistakes: vec![config::Mistake {
            line: line_with(&text, &scenario.map),
            message: format!("map {error}"),
        }],
    })?;
    let map_file = map_path.display().to_string();
    let map: MapFile = parse(&map_file, &map_text, MapFile::parse)?;
    let meshes = meshes_of(&map, &map_path)?;
    let robots_path = map_path.with_file_name("robots.toml");
    let robots = if robots_path.exists() { Some(read(&robots_path)?) } else { None };
    let robots_file = robots_path.display().to_string();
    let catalogue = match &robots {
        Some(robots) => parse(&robots_file, robots, RobotCatalogue::parse)?,
        None => embedded_robots()?,
    };
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let world = World::new(&map, &meshes)
        .map_err(|error| ConfigError::whole(&map_file, error.to_string()))?;
    finish(name, (&file, &text), scenario, world, catalogue, overrides)
}

/// Loads a scenario that comes with the program.
///
/// # Errors
///
/// When there is none of that name, or an override is wrong.
pub fn load_embedded(name: &str, overrides: &[Source]) -> Result<LoadedScenario, ConfigError> {
    let Some((_, text, map)) = EMBEDDED.iter().find(|(embedded, ..)| *embedded == name) else {
        let known: Vec<_> = EMBEDDED.iter().map(|(name, ..)| *name).collect();
        let message = format!("no scenario of that name; there are {}", known.join(", "));
        return Err(ConfigError::whole(name, message));
    };
    let file = format!("scenarios/{name}.toml");
    let scenario: Scenario = parse(&file, text, Scenario::parse)?;
    let map: MapFile = parse(&format!("maps/{name}.toml"), map, MapFile::parse)?;
    let world = World::new(&map, &BTreeMap::new())
        .map_err(|error| ConfigError::whole(&file, error.to_string()))?;
    finish(name.to_owned(), (&file, text), scenario, world, embedded_robots()?, overrides)
}

fn finish(
    name: String,
    (file, text): (&str, &str),
    scenario: Scenario,
    world: World,
    catalogue: RobotCatalogue,
    overrides: &[Source],
) -> Result<LoadedScenario, ConfigError> {
    let whole = |error: SpecError| ConfigError::whole(file, error.to_string());
    scenario.models(&catalogue).map_err(whole)?;
    scenario.check_starts(&world).map_err(whole)?;
    let mut sources =
        vec![Source { file: file.to_owned(), text: text.to_owned(), section: Some("agent") }];
    sources.extend_from_slice(overrides);
    let mut agent = agent_config(&sources)?;
    agent.mission.time_limit_s = scenario.time_limit_s;
    if let Some(robot) = scenario.robots.first() {
        agent.mission.name.clone_from(&robot.name);
        agent.mission.class.clone_from(&robot.class);
    }
    Ok(LoadedScenario { name, scenario, world, catalogue, agent })
}

fn embedded_robots() -> Result<RobotCatalogue, ConfigError> {
    parse("maps/robots.toml", ROBOTS, RobotCatalogue::parse)
}

/// Mistakes of spelling and type with their lines first, then what the values contradict.
fn parse<T: serde::de::DeserializeOwned>(
    file: &str,
    text: &str,
    check: impl FnOnce(&str) -> Result<T, SpecError>,
) -> Result<T, ConfigError> {
    config::read_plain::<T>(file, text)?;
    check(text).map_err(|error| match error {
        SpecError::Parse(message) => ConfigError::whole(file, message),
        SpecError::Invalid(violations) => ConfigError {
            file: file.to_owned(),
            mistakes: violations
                .into_iter()
                .map(|violation| config::Mistake { line: None, message: violation.to_string() })
                .collect(),
        },
    })
}

fn meshes_of(map: &MapFile, map_path: &Path) -> Result<BTreeMap<String, Vec<u8>>, ConfigError> {
    let mut meshes = BTreeMap::new();
    for mesh in &map.meshes {
        let path = map_path.with_file_name(&mesh.file);
        let bytes = std::fs::read(&path).map_err(|error| {
            ConfigError::whole(
                &map_path.display().to_string(),
                format!("mesh {}: {error}", path.display()),
            )
        })?;
        meshes.insert(mesh.file.clone(), bytes);
    }
    Ok(meshes)
}

fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path)
        .map_err(|error| ConfigError::whole(&path.display().to_string(), error.to_string()))
}

/// The first line of `text` that holds `what`.
fn line_with(text: &str, what: &str) -> Option<usize> {
    text.lines().position(|line| line.contains(what)).map(|index| index + 1)
}
