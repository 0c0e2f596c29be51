//! `usar replay`: a recording through the live path.

use super::files::write_stdout;
use super::mission::summary;
use super::out::RunFolder;
use crate::driver::observed::{observing, recording_of_text, server_side};
use crate::driver::replay::{Difference, Replay};
use crate::driver::results::results;
use crate::driver::simulated::MissionResult;
use crate::export::report::Report;
use crate::files::agent_config::{Source, agent_config};
use crate::mission::{Agent, Level};
use crate::protocol::capture::Capture;
use crate::record::{Header, MAGIC, Recording, read};
use anyhow::{Context, Result, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// A recording that was cut or damaged was used as far as it goes.
const DONE_WITH_LOSS: u8 = 3;

/// Arguments of `usar replay`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  usar replay run/session.usar --verify\n  \
                  usar replay captured.txt --class USARBot.P2DX --out seen/")]
pub struct ReplayArguments {
    /// A recording (session.usar or its run folder), or text that a client printed; - is standard input
    session: PathBuf,
    /// Compare every action with the recorded one; the first difference is a failure
    #[arg(long, conflicts_with_all = ["observe", "config"])]
    verify: bool,
    /// Only look on: estimate and map, do not decide. Text of other clients is always observed
    #[arg(long)]
    observe: bool,
    /// Times real time, or max
    #[arg(long, value_name = "X|max", default_value = "max", value_parser = speed)]
    speed: Speed,
    /// Class of the robot in captured text [default: the configuration's, USARBot.P3AT]
    #[arg(long, value_name = "CLASS")]
    class: Option<String>,
    /// Agent configuration, instead of the recorded one
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address of the console
    #[arg(long, value_name = "ADDR", default_value = "off")]
    console: String,
    /// Folder for map, trajectory and report
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Write into a folder that holds a recording
    #[arg(long, help_heading = "Output")]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Speed {
    Max,
    Times(f64),
}

fn speed(text: &str) -> Result<Speed, String> {
    if text == "max" {
        return Ok(Speed::Max);
    }
    match text.parse::<f64>() {
        Ok(times) if times > 0.0 && times.is_finite() => Ok(Speed::Times(times)),
        _ => Err("expected a number above 0, or max".into()),
    }
}

/// A session ready to be replayed.
struct Session {
    recording: Recording,
    agent: Agent,
    name: String,
    own: bool,
}

/// Runs the verb.
///
/// # Errors
///
/// A file that is no session, a configuration that cannot be used, a folder that cannot be written.
pub fn run(arguments: &ReplayArguments) -> Result<ExitCode> {
    if !arguments.console.eq_ignore_ascii_case("off") {
        eprintln!("warning: the console is not built yet; going on without it");
    }
    let Session { recording, agent, name, own } = open(arguments)?;
    if arguments.verify && !own {
        bail!("{} is captured text: it holds no actions to verify", arguments.session.display());
    }
    if let Some(out) = &arguments.out {
        RunFolder::check(Some(out), arguments.force)?;
    }
    let config = agent.config().clone();
    #[expect(clippy::disallowed_methods, reason = "the report tells how long the run took")]
    let began = Instant::now();
    let mut replay = Replay::new(agent, &recording);
    let mut seen = 0;
    loop {
        if let Speed::Times(times) = arguments.speed {
            pace(began, &replay, times);
        }
        let more = replay.step().context("the recording holds an unreadable operator event")?;
        seen = show(replay.agent(), seen);
        if !more || (arguments.verify && replay.difference().is_some()) {
            break;
        }
    }
    let (agent, bystander, difference) = replay.finish();
    show(&agent, seen);
    let MissionResult { mut report, files } =
        results(&agent, &bystander, &name, recording.header.seed);
    report.wall_time_s = began.elapsed().as_secs_f64();
    if let Some(out) = &arguments.out {
        let folder = RunFolder::create(Some(out), &name, arguments.force)?;
        folder.write("config.toml", toml::to_string(&config)?.as_bytes())?;
        for (name, bytes) in &files {
            folder.write(name, bytes)?;
        }
        folder.write("report.json", serde_json::to_string_pretty(&report)?.as_bytes())?;
    }
    conclude(arguments, &recording, &report, difference)
}

fn conclude(
    arguments: &ReplayArguments,
    recording: &Recording,
    report: &Report,
    difference: Option<Difference>,
) -> Result<ExitCode> {
    let folder = arguments.out.as_deref().unwrap_or(Path::new("-"));
    write_stdout(&summary(report, folder))?;
    if arguments.verify {
        match difference {
            Some(difference) => bail!("the replay differs: {difference}"),
            None => write_stdout(&format!(
                "verified: {} entries, every action as recorded\n",
                recording.entries.len()
            ))?,
        }
    }
    if let Some(loss) = &recording.loss {
        eprintln!("warning: the recording is not whole: {loss}");
        return Ok(ExitCode::from(DONE_WITH_LOSS));
    }
    Ok(ExitCode::SUCCESS)
}

/// Reads a session, own or foreign, and makes the agent for it.
fn open(arguments: &ReplayArguments) -> Result<Session> {
    let (bytes, path) = read_session(&arguments.session)?;
    let overrides: Vec<Source> =
        arguments.config.iter().map(|path| Source::file(path)).collect::<Result<_, _>>()?;
    if bytes.starts_with(MAGIC) {
        return own(arguments, &bytes, &path, &overrides);
    }
    let capture = Capture::read(&bytes);
    if capture.lines.is_empty() {
        bail!("{}: neither a recording nor text with lines of a server in it", path.display());
    }
    eprintln!(
        "captured text: {} lines of the server, {} of them put together again, {} remarks left out",
        capture.lines.len(),
        capture.rejoined(),
        capture.remarks.len()
    );
    let mut config = observing(agent_config(&overrides)?);
    if let Some(class) = &arguments.class {
        config.mission.class.clone_from(class);
    }
    let recording = recording_of_text(&capture, Header::default());
    let agent = Agent::new(config, recording.header.placement.clone());
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    Ok(Session { recording, agent, name, own: false })
}

fn own(
    arguments: &ReplayArguments,
    bytes: &[u8],
    path: &Path,
    overrides: &[Source],
) -> Result<Session> {
    let recording = read(bytes).with_context(|| format!("cannot read {}", path.display()))?;
    let recorded = Source {
        file: format!("configuration in {}", path.display()),
        text: recording.header.config.clone(),
        section: None,
    };
    let sources: Vec<Source> = std::iter::once(recorded).chain(overrides.iter().cloned()).collect();
    let config = agent_config(&sources)?;
    let (recording, config) = match arguments.observe {
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

/// The bytes of a session file, of the recording in a run folder, or of standard input.
fn read_session(path: &Path) -> Result<(Vec<u8>, PathBuf)> {
    use std::io::Read as _;
    if path == Path::new("-") {
        let mut bytes = Vec::new();
        std::io::stdin().read_to_end(&mut bytes).context("cannot read standard input")?;
        return Ok((bytes, PathBuf::from("stdin")));
    }
    let file = if path.is_dir() { path.join("session.usar") } else { path.to_owned() };
    let bytes = std::fs::read(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok((bytes, file))
}

/// Waits until the next entry is due.
fn pace(began: Instant, replay: &Replay<'_>, times: f64) {
    let Some(arrival) = replay.next_arrival() else { return };
    let due = Duration::from_secs_f64((arrival.seconds() / times).max(0.0));
    if let Some(early) = due.checked_sub(began.elapsed()) {
        std::thread::sleep(early);
    }
}

/// Prints warnings of the agent; gives the number of notes seen.
fn show(agent: &Agent, seen: usize) -> usize {
    let journal = agent.journal();
    for note in journal.since(seen).iter().filter(|note| note.level > Level::Info) {
        eprintln!("{:8.1} s  {}", note.arrival.seconds(), note.text);
    }
    journal.len()
}
