//! Scenarios with the map, triangles and robots they name; those that came with the program are in
//! it, so that it runs without its repository.

use crate::config::{self, ConfigError};
use crate::sim::{MapFile, RobotCatalogue, Scenario, SpecError, World, WorldError};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// A scenario ready to run.
#[derive(Clone, Debug)]
pub struct WorldFiles {
    /// The scenario as written.
    pub scenario: Scenario,
    /// The map as written.
    pub map: MapFile,
    /// The robots: `robots.toml` beside the map, else the one in the program.
    pub catalogue: RobotCatalogue,
    /// The map ready for rays and contact.
    pub world: World,
}

/// Why a scenario could not be loaded.
#[derive(Debug, thiserror::Error)]
pub enum WorldFilesError {
    /// A file could not be read.
    #[error("cannot read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The map that a scenario names could not be read.
    #[error("scenario {} names map {}: {source}", .scenario.display(), .map.display())]
    Map {
        /// The scenario file.
        scenario: PathBuf,
        /// The map, as it was looked for.
        map: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file is not the TOML it should be: every mistake with its line.
    #[error(transparent)]
    Toml(#[from] ConfigError),
    /// What a file says cannot be.
    #[error("{}: {source}", .path.display())]
    Spec {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        source: SpecError,
    },
    /// A map's triangles are unsound.
    #[error("{}: {source}", .path.display())]
    World {
        /// The map file.
        path: PathBuf,
        /// What is wrong with them.
        source: WorldError,
    },
}

/// One of the scenarios in the program: name, scenario text, map text.
struct BuiltIn {
    name: &'static str,
    scenario: &'static str,
    map: &'static str,
}

macro_rules! built_in {
    ($name:literal) => {
        built_in!($name, $name)
    };
    ($name:literal, $map:literal) => {
        BuiltIn {
            name: $name,
            scenario: include_str!(concat!("../../scenarios/", $name, ".toml")),
            map: include_str!(concat!("../../maps/", $map, ".toml")),
        }
    };
}

const BUILT_IN: [BuiltIn; 5] = [
    built_in!("box"),
    built_in!("planes"),
    built_in!("station"),
    built_in!("station_udk", "station"),
    built_in!("yellow"),
];

const ROBOTS: &str = include_str!("../../maps/robots.toml");

/// Names of the scenarios in the program.
pub fn built_in_names() -> impl Iterator<Item = &'static str> {
    BUILT_IN.iter().map(|own| own.name)
}

/// Loads a scenario file, or the built-in scenario of that name where there is no such file.
///
/// The map's path is relative to the scenario file, triangle files to the map file.
pub fn load_world(scenario: &Path) -> Result<WorldFiles, WorldFilesError> {
    let own = BUILT_IN.iter().find(|own| scenario.as_os_str() == own.name);
    if let Some(own) = own.filter(|_| !scenario.exists()) {
        return load_built_in(own);
    }
    let text = read_text(scenario)?;
    let parsed = parse(scenario, &text, Scenario::parse)?;
    let map_path = beside(scenario, &parsed.map);
    let map = parse(&map_path, &map_text(scenario, &map_path)?, MapFile::parse)?;
    let robots_path = beside(&map_path, "robots.toml");
    let robots = if robots_path.exists() { read_text(&robots_path)? } else { ROBOTS.to_owned() };
    let meshes = read_meshes(&map_path, &map)?;
    let catalogue = parse(&robots_path, &robots, RobotCatalogue::parse)?;
    assemble(scenario, &map_path, parsed, map, catalogue, &meshes).map_err(|error| match error {
        WorldFilesError::Spec { path, source } if path == scenario => located(&path, &text, source),
        error => error,
    })
}

/// The text of the map that a scenario names.
///
/// # Errors
///
/// When it cannot be read.
pub fn map_text(scenario: &Path, map: &Path) -> Result<String, WorldFilesError> {
    std::fs::read_to_string(map).map_err(|source| WorldFilesError::Map {
        scenario: scenario.to_owned(),
        map: map.to_owned(),
        source,
    })
}

/// A scenario's own mistakes alone, without what it names.
///
/// # Errors
///
/// Every mistake of spelling and type; else every value that cannot be.
pub fn scenario_of(path: &Path, text: &str) -> Result<Scenario, WorldFilesError> {
    parse(path, text, Scenario::parse)
}

/// Reads the map at a path with the triangle files it names.
///
/// # Errors
///
/// Everything wrong with the first file that has anything wrong.
pub fn check_map(path: &Path) -> Result<(MapFile, World), WorldFilesError> {
    let map = parse(path, &read_text(path)?, MapFile::parse)?;
    let meshes = read_meshes(path, &map)?;
    let world = World::new(&map, &meshes)
        .map_err(|source| WorldFilesError::World { path: path.to_owned(), source })?;
    Ok((map, world))
}

fn read_meshes(
    map_path: &Path,
    map: &MapFile,
) -> Result<BTreeMap<String, Vec<u8>>, WorldFilesError> {
    let mut meshes = BTreeMap::new();
    for mesh in &map.meshes {
        let path = beside(map_path, &mesh.file);
        let bytes =
            std::fs::read(&path).map_err(|source| WorldFilesError::Read { path, source })?;
        meshes.insert(mesh.file.clone(), bytes);
    }
    Ok(meshes)
}

/// The text of a scenario file, or of the built-in scenario of that name.
pub fn scenario_text(scenario: &Path) -> Result<String, WorldFilesError> {
    let own = BUILT_IN.iter().find(|own| scenario.as_os_str() == own.name);
    match own.filter(|_| !scenario.exists()) {
        Some(own) => Ok(own.scenario.to_owned()),
        None => read_text(scenario),
    }
}

/// The robots that are in the program.
pub fn built_in_robots() -> RobotCatalogue {
    RobotCatalogue::parse(ROBOTS).expect("the robot file in the program is tested")
}

fn load_built_in(own: &BuiltIn) -> Result<WorldFiles, WorldFilesError> {
    let path = PathBuf::from(own.name);
    let spec = |source| spec_error(&path, source);
    let scenario = Scenario::parse(own.scenario).map_err(spec)?;
    let map = MapFile::parse(own.map).map_err(spec)?;
    assemble(&path, &path, scenario, map, built_in_robots(), &BTreeMap::new())
}

fn assemble(
    scenario_path: &Path,
    map_path: &Path,
    scenario: Scenario,
    map: MapFile,
    catalogue: RobotCatalogue,
    meshes: &BTreeMap<String, Vec<u8>>,
) -> Result<WorldFiles, WorldFilesError> {
    let world = World::new(&map, meshes)
        .map_err(|source| WorldFilesError::World { path: map_path.to_owned(), source })?;
    let fits = scenario.models(&catalogue).and_then(|_| scenario.check_starts(&world));
    fits.map_err(|source| spec_error(scenario_path, source))?;
    Ok(WorldFiles { scenario, map, catalogue, world })
}

/// Mistakes of spelling and type first, all of them; then what the values contradict.
fn parse<T: serde::de::DeserializeOwned>(
    path: &Path,
    text: &str,
    check: impl FnOnce(&str) -> Result<T, SpecError>,
) -> Result<T, WorldFilesError> {
    config::read_plain::<T>(&path.display().to_string(), text)?;
    check(text).map_err(|source| located(path, text, source))
}

/// What a file's values contradict, each with the line of its place.
fn located(path: &Path, text: &str, source: SpecError) -> WorldFilesError {
    let SpecError::Invalid(violations) = source else { return spec_error(path, source) };
    let violations = violations.into_iter().map(|violation| (violation.place, violation.reason));
    ConfigError::located(&path.display().to_string(), text, violations).into()
}

fn beside(file: &Path, name: &str) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).join(name)
}

fn spec_error(path: &Path, source: SpecError) -> WorldFilesError {
    WorldFilesError::Spec { path: path.to_owned(), source }
}

fn read_text(path: &Path) -> Result<String, WorldFilesError> {
    std::fs::read_to_string(path)
        .map_err(|source| WorldFilesError::Read { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_built_in_scenario_loads() {
        for name in built_in_names() {
            let files = load_world(Path::new(name)).unwrap();
            assert!(!files.world.objects().is_empty() && !files.scenario.robots.is_empty());
        }
    }

    #[test]
    fn files_are_found_beside_each_other_and_missing_ones_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let head = "map = \"m.toml\"\n[[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\n";
        let scenario = write("s.toml", head);
        let missing = load_world(&scenario).unwrap_err().to_string();
        let names = format!("scenario {} names map", scenario.display());
        assert!(missing.starts_with(&names), "{missing}");
        assert!(missing.contains("m.toml: No such file"), "{missing}");
        let map = "name = \"m\"\nbounds = [0.0, 0.0, 1.0, 1.0]\n[[mesh]]\nfile = \"t.obj\"\n";
        write("m.toml", map);
        let missing = load_world(&scenario).unwrap_err().to_string();
        assert!(missing.contains("t.obj: No such file"), "{missing}");
        write("t.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\no tile\nf 1 2 3\n");
        let files = load_world(&scenario).unwrap();
        assert_eq!(files.world.objects()[0].name, "tile");
        let phases = "[[phase]]\nname = \"autonomous\"\nuntil_s = 60.0\n\
                      [[phase]]\nname = \"operator\"\nuntil_s = 50.0\n";
        write("s.toml", &format!("{head}start = \"StartZ\"\n{phases}"));
        let error = load_world(&scenario).unwrap_err().to_string();
        let expected = "s.toml:11: phase 2 until_s: expected more than 60, found 50";
        assert!(error.ends_with(expected), "{error}");
        write("s.toml", &format!("{head}start = \"StartZ\"\n"));
        let error = load_world(&scenario).unwrap_err().to_string();
        assert!(error.contains("s.toml:5: robot \"R1\" start: "), "{error}");
        assert!(error.ends_with("found \"StartZ\""), "{error}");
        write("s.toml", &head.replace("class", "klass"));
        let typo = load_world(&scenario).unwrap_err().to_string();
        assert!(typo.contains("s.toml:4: unknown key `klass`, did you mean `class`?"), "{typo}");
    }
}
