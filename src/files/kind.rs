//! What a file is, told by its content, and everything that is wrong with it.

use super::agent_config::{Source, agent_config};
use super::pcd::read_pcd;
use super::{scenario, world};
use crate::acquisition::{HEADING, RecordedTriples};
use crate::config::{self, ConfigError};
use crate::protocol::capture::Capture;
use crate::record::{self, MAGIC};
use crate::sim::RobotCatalogue;
use std::fmt;
use std::path::Path;
use toml::de::DeTable;

/// The kinds of files that the program reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A recording of ours.
    Session,
    /// Text with a server's lines in it.
    Captured,
    /// A record of synchronised triples.
    Triples,
    /// A PCD cloud.
    Scan,
    /// A scenario.
    Scenario,
    /// A map.
    Map,
    /// Robots.
    Robots,
    /// Agent configuration.
    AgentConfig,
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Session => "session",
            Self::Captured => "captured text",
            Self::Triples => "triples",
            Self::Scan => "scan",
            Self::Scenario => "scenario",
            Self::Map => "map",
            Self::Robots => "robots",
            Self::AgentConfig => "agent configuration",
        })
    }
}

/// What a file is; `None` for something else.
pub fn kind_of(path: &Path, bytes: &[u8]) -> Option<Kind> {
    if bytes.starts_with(MAGIC) {
        return Some(Kind::Session);
    }
    if bytes.starts_with(HEADING.as_bytes()) {
        return Some(Kind::Triples);
    }
    let has_ending =
        |ending: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
    let is_pcd = |line: &[u8]| line.starts_with(b"# .PCD") || line.starts_with(b"VERSION");
    if has_ending("pcd") || bytes.split(|octet| *octet == b'\n').take(3).any(is_pcd) {
        return Some(Kind::Scan);
    }
    if has_ending("toml") {
        return std::str::from_utf8(bytes).ok().map(kind_of_toml);
    }
    (!Capture::read(bytes).lines.is_empty()).then_some(Kind::Captured)
}

/// What a TOML text is by its top keys, as far as it can be read.
fn kind_of_toml(text: &str) -> Kind {
    let (document, _) = DeTable::parse_recoverable(text);
    let has = |key: &str| document.get_ref().contains_key(key);
    if has("map") {
        Kind::Scenario
    } else if has("bounds") || has("start") || has("box") {
        Kind::Map
    } else if has("robot") && document.get_ref().len() == 1 {
        // A robots file is a list of robots and nothing else: with another key beside it, it is a
        // scenario whose `map` is missing or misspelt.
        Kind::Robots
    } else if has("robot") {
        Kind::Scenario
    } else {
        Kind::AgentConfig
    }
}

/// Whether a file is valid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is.
    Valid(Kind),
    /// A recording that is good as far as it goes.
    Cut {
        /// Where reading ended and why.
        loss: String,
    },
    /// Everything that is wrong with it, a line each.
    Invalid(Vec<String>),
}

/// Checks a file, and the files that it names.
pub fn check(path: &Path, bytes: &[u8]) -> Verdict {
    let Some(kind) = kind_of(path, bytes) else {
        let expected = "expected a session, captured text, a PCD scan or TOML";
        return Verdict::Invalid(vec![format!(
            "{}: unknown kind of file; {expected}",
            path.display()
        )]);
    };
    let name = path.display();
    let mistakes = match kind {
        Kind::Session => match record::read(bytes) {
            Ok(recording) => match recording.loss {
                Some(loss) => return Verdict::Cut { loss },
                None => Vec::new(),
            },
            Err(error) => vec![format!("{name}: {error}")],
        },
        Kind::Captured => Vec::new(),
        Kind::Triples => match RecordedTriples::parse(&String::from_utf8_lossy(bytes)) {
            Ok(_) => Vec::new(),
            Err(error) => vec![format!("{name}: {error}")],
        },
        Kind::Scan => match read_pcd(bytes).and_then(super::pcd::Cloud::into_grid) {
            Ok(_) => Vec::new(),
            Err(error) => vec![format!("{name}: {error}")],
        },
        Kind::Scenario => scenario_mistakes(path, bytes),
        Kind::Map => lines(world::check_map(path)),
        Kind::Robots => text_mistakes::<RobotCatalogue>(path, bytes, |text| {
            RobotCatalogue::parse(text).err().map(|error| error.to_string())
        }),
        Kind::AgentConfig => lines(Source::file(path).and_then(|source| agent_config(&[source]))),
    };
    if mistakes.is_empty() { Verdict::Valid(kind) } else { Verdict::Invalid(mistakes) }
}

/// A scenario's own mistakes, those of the agent's configuration in it, and those of the map it names;
/// where there are none of these, what does not fit together.
fn scenario_mistakes(path: &Path, bytes: &[u8]) -> Vec<String> {
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text,
        Err(error) => return vec![format!("{}: {error}", path.display())],
    };
    let mut mistakes = lines(world::scenario_of(path, text));
    let (document, syntax) = DeTable::parse_recoverable(text);
    if syntax.is_empty() {
        let file = path.display().to_string();
        let agent = Source { file, text: text.to_owned(), section: Some("agent") };
        mistakes.extend(lines(agent_config(&[agent])));
    }
    let map = document.get_ref().get("map").and_then(|map| map.get_ref().as_str());
    let map = map.map(|map| path.parent().unwrap_or(Path::new("")).join(map));
    if let Some(map) = map {
        let read = world::map_text(path, &map);
        mistakes.extend(lines(read.and_then(|_| world::check_map(&map))));
    }
    if mistakes.is_empty() { lines(scenario::load(path, &[])) } else { mistakes }
}

fn text_mistakes<T: serde::de::DeserializeOwned>(
    path: &Path,
    bytes: &[u8],
    check: impl FnOnce(&str) -> Option<String>,
) -> Vec<String> {
    let name = path.display().to_string();
    let read = || -> Result<Option<String>, ConfigError> {
        let text = std::str::from_utf8(bytes)
            .map_err(|error| ConfigError::whole(&name, error.to_string()))?;
        config::read_plain::<T>(&name, text)?;
        Ok(check(text).map(|mistake| format!("{name}: {mistake}")))
    };
    match read() {
        Ok(mistake) => mistake.into_iter().collect(),
        Err(error) => error.to_string().lines().map(str::to_owned).collect(),
    }
}

fn lines<T, E: fmt::Display>(result: Result<T, E>) -> Vec<String> {
    match result {
        Ok(_) => Vec::new(),
        Err(error) => error.to_string().lines().map(str::to_owned).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_known_by_their_content() {
        let kind = |name: &str, text: &str| kind_of(Path::new(name), text.as_bytes());
        assert_eq!(kind("s", "USARSES\nxyz"), Some(Kind::Session));
        assert_eq!(kind("t.txt", "usar triples 1\n"), Some(Kind::Triples));
        assert_eq!(kind("x.pcd", ""), Some(Kind::Scan));
        assert_eq!(kind("x", "# .PCD v0.7\nVERSION 0.7\n"), Some(Kind::Scan));
        assert_eq!(kind("a.toml", "map = \"m.toml\"\n"), Some(Kind::Scenario));
        assert_eq!(kind("a.toml", "bounds = [0, 0, 1, 1]\n"), Some(Kind::Map));
        assert_eq!(kind("a.toml", "[[robot]]\nclass = \"X\"\n"), Some(Kind::Robots));
        assert_eq!(kind("a.toml", "[mission]\n"), Some(Kind::AgentConfig));
        assert_eq!(kind("log.txt", "hello\nSTA {Time 1.0}\n"), Some(Kind::Captured));
        assert_eq!(kind("log.txt", "hello\n"), None);
    }

    #[test]
    fn a_broken_scenario_is_still_a_scenario() {
        assert_eq!(kind_of_toml("map = \"m.toml\"\n[[robot]\nname = \n"), Kind::Scenario);
    }

    #[test]
    fn a_scenario_with_a_misspelt_map_is_no_robots_file() {
        let text = "mapp = \"m.toml\"\n[[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\n";
        assert_eq!(kind_of_toml(text), Kind::Scenario);
        let Verdict::Invalid(mistakes) = check(Path::new("s.toml"), text.as_bytes()) else {
            panic!()
        };
        assert_eq!(mistakes, ["s.toml:1: unknown key `mapp`, did you mean `map`?"]);
    }

    #[test]
    fn mistakes_of_scenario_and_map_come_together() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.toml");
        let text = "map = \"m.toml\"\nsed = 1\n[[robot]]\nname = \"R1\"\nklass = \"USARBot.P3AT\"\n\
             [agent.mission]\nsetle_s = 1.0\n";
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("m.toml"), "name = \"m\"\nbound = [0.0]\n").unwrap();
        let Verdict::Invalid(mistakes) = check(&path, text.as_bytes()) else { panic!() };
        let found = |part: &str| mistakes.iter().any(|mistake| mistake.contains(part));
        assert!(found("s.toml:2") && found("`seed`"), "{mistakes:?}");
        assert!(found("s.toml:5") && found("m.toml:2"), "{mistakes:?}");
        assert!(found("s.toml:7") && found("`settle_s`"), "{mistakes:?}");
    }
}
