//! The agent's configuration, put together from its sources.

use crate::config::{self, Check, ConfigError};
use crate::mission::AgentConfig;
use std::path::Path;
use toml::{Table, Value};

/// A text that overrides parts of the configuration.
#[derive(Clone, Debug)]
pub struct Source {
    /// Name of the file, for messages.
    pub file: String,
    /// Its text.
    pub text: String,
    /// The table in it that counts; `None` for the whole.
    pub section: Option<&'static str>,
}

impl Source {
    /// The file at `path`, the whole of which is agent configuration.
    ///
    /// # Errors
    ///
    /// When it cannot be read.
    pub fn file(path: &Path) -> Result<Self, ConfigError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|error| ConfigError::whole(&file, format!("cannot read: {error}")))?;
        Ok(Self { file, text, section: None })
    }
}

/// The defaults, overridden by each source in turn.
///
/// # Errors
///
/// Everything wrong with the first source that has anything wrong.
pub fn agent_config(sources: &[Source]) -> Result<AgentConfig, ConfigError> {
    let mut merged = Table::new();
    for source in sources {
        // Read on its own first: only so do mistakes have a line of a file.
        match source.section {
            Some(section) => {
                config::read_section::<AgentConfig>(&source.file, &source.text, section)?;
            }
            None => {
                config::read::<AgentConfig>(&source.file, &source.text)?;
            }
        }
        let table: Table = toml::from_str(&source.text)
            .map_err(|error| ConfigError::whole(&source.file, error.to_string()))?;
        let table = match source.section {
            None => table,
            Some(section) => match table.get(section) {
                Some(Value::Table(table)) => table.clone(),
                _ => Table::new(),
            },
        };
        merge(&mut merged, table);
    }
    let together = "the configuration put together";
    let config: AgentConfig = Value::Table(merged)
        .try_into()
        .map_err(|error: toml::de::Error| ConfigError::whole(together, error.message()))?;
    let wrong: Vec<String> =
        config.violations().iter().map(|v| format!("{}: {}", v.key, v.message)).collect();
    if wrong.is_empty() { Ok(config) } else { Err(ConfigError::whole(together, wrong.join("; "))) }
}

/// Lays `over` upon `under`, table by table.
fn merge(under: &mut Table, over: Table) {
    for (key, value) in over {
        match (under.get_mut(&key), value) {
            (Some(Value::Table(under)), Value::Table(over)) => merge(under, over),
            (_, value) => {
                under.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(text: &str, section: Option<&'static str>) -> Source {
        Source { file: "f".into(), text: text.into(), section }
    }

    #[test]
    fn later_sources_override_single_keys() {
        let scenario = source("[agent.mission]\nname = \"R7\"\nsettle_s = 1.0\n", Some("agent"));
        let file = source("[mission]\nsettle_s = 2.0\n", None);
        let config = agent_config(&[scenario, file]).unwrap();
        assert_eq!((config.mission.name.as_str(), config.mission.settle_s), ("R7", 2.0));
    }

    #[test]
    fn a_misspelt_key_is_named_with_its_line() {
        let error = agent_config(&[source("[mission]\nsetle_s = 2.0\n", None)]).unwrap_err();
        assert_eq!(error.to_string(), "f:2: unknown key `setle_s`, did you mean `settle_s`?");
    }
}
