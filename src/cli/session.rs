//! Sessions from files: own recordings, and text that other clients printed.

use super::say;
use crate::driver::observed::{observing, recording_of_text, server_side};
use crate::files::agent_config::{Source, agent_config};
use crate::mission::Agent;
use crate::protocol::capture::Capture;
use crate::record::{Header, MAGIC, Recording, read};
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};

/// Exit code: a recording that was cut, damaged or replayed otherwise than it went was used as far as it goes.
pub const DONE_WITH_LOSS: u8 = 3;

/// A session ready to be replayed.
pub struct Session {
    /// Its entries.
    pub recording: Recording,
    /// The agent for it, fresh.
    pub agent: Agent,
    /// Name of the scenario, or of the file.
    pub name: String,
    /// Whether it is a recording of ours, with actions in it.
    pub own: bool,
}

/// Reads a session and makes the agent for it. `class` is that of the robot in captured text;
/// `observe` keeps only what the server said; `overrides` change the recorded configuration.
///
/// # Errors
///
/// A file that cannot be read or is no session, a configuration that cannot be used.
pub fn open(
    path: &Path,
    class: Option<&str>,
    observe: bool,
    overrides: &[Source],
) -> Result<Session> {
    let (bytes, path) = read_session(path)?;
    of_bytes(&bytes, &path, class, observe, overrides)
}

/// The same of the bytes of a session that stood in `path`.
///
/// # Errors
///
/// Bytes that are no session, a configuration that cannot be used.
pub fn of_bytes(
    bytes: &[u8],
    path: &Path,
    class: Option<&str>,
    observe: bool,
    overrides: &[Source],
) -> Result<Session> {
    if bytes.starts_with(MAGIC) {
        return own(observe, bytes, path, overrides);
    }
    let capture = Capture::read(bytes);
    if capture.lines.is_empty() {
        bail!("{}: neither a recording nor text with lines of a server in it", path.display());
    }
    say::tell(format_args!(
        "captured text: {} lines of the server, {} of them put together again, {} remarks left out",
        capture.lines.len(),
        capture.rejoined(),
        capture.remarks.len()
    ));
    let mut config = observing(agent_config(overrides)?);
    if let Some(class) = class {
        class.clone_into(&mut config.mission.class);
    }
    let recording = recording_of_text(&capture, Header::default());
    let agent = Agent::new(config, recording.header.placement.clone());
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    Ok(Session { recording, agent, name, own: false })
}

fn own(observe: bool, bytes: &[u8], path: &Path, overrides: &[Source]) -> Result<Session> {
    let recording = read(bytes).with_context(|| format!("cannot read {}", path.display()))?;
    let recorded = Source {
        file: format!("configuration in {}", path.display()),
        text: recording.header.config.clone(),
        section: None,
    };
    let sources: Vec<Source> = std::iter::once(recorded).chain(overrides.iter().cloned()).collect();
    let config = agent_config(&sources)?;
    let (recording, config) = match observe {
        true => (server_side(&recording), observing(config)),
        false => (recording, config),
    };
    let agent = Agent::new(config, recording.header.placement.clone());
    let name = match recording.header.scenario.as_str() {
        "" => "session".to_owned(),
        scenario => scenario.to_owned(),
    };
    Ok(Session { recording, agent, name, own: true })
}

/// The bytes of a session file, of the recording in a run folder, or of standard input; and the
/// file's name.
pub fn read_session(path: &Path) -> Result<(Vec<u8>, PathBuf)> {
    use std::io::Read as _;
    if path == Path::new("-") {
        let mut bytes = Vec::new();
        std::io::stdin().read_to_end(&mut bytes).context("cannot read standard input")?;
        return Ok((bytes, PathBuf::from("stdin")));
    }
    let file = if path.is_dir() { path.join("session.usar") } else { path.to_owned() };
    if path.is_dir() && !file.exists() {
        bail!("{} is no run folder: there is no session.usar in it", path.display());
    }
    let bytes = std::fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok((bytes, file))
}
