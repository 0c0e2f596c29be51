//! `usar replay`: a recording through the live path.

use super::files::{warn_of_no_console, write_stdout};
use super::mission::summary;
use super::out::RunFolder;
use super::say;
use super::session::{self, DONE_WITH_LOSS, Session};
use crate::driver::replay::{Difference, Replay};
use crate::driver::results::results;
use crate::driver::simulated::MissionResult;
use crate::export::report::Report;
use crate::files::agent_config::Source;
use crate::mission::{Agent, Level};
use crate::record::Recording;
use anyhow::{Context, Result, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

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

/// Runs the verb.
///
/// # Errors
///
/// A file that is no session, a configuration that cannot be used, a folder that cannot be written.
pub fn run(arguments: &ReplayArguments) -> Result<ExitCode> {
    super::say::log("warn");
    warn_of_no_console(&arguments.console);
    let overrides: Vec<Source> =
        arguments.config.iter().map(|path| Source::file(path)).collect::<Result<_, _>>()?;
    let class = arguments.class.as_deref();
    let Session { recording, agent, name, own } =
        session::open(&arguments.session, class, arguments.observe, &overrides)?;
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
        say::warn(format_args!("the recording is not whole: {loss}"));
        return Ok(ExitCode::from(DONE_WITH_LOSS));
    }
    Ok(ExitCode::SUCCESS)
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
    let all = say::loudness() > 0;
    for note in journal.since(seen).iter().filter(|note| all || note.level > Level::Info) {
        say::tell(format_args!("{:8.1} s  {}", note.arrival.seconds(), note.text));
    }
    journal.len()
}
