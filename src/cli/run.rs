//! `usar run`: the agent against any USARSim server.

use super::files::{warn_of_no_console, write_stderr, write_stdout};
use super::interrupt;
use super::keys::{self, Keyboard};
use super::mission::{positive_seconds, summary};
use super::out::RunFolder;
use super::say;
use crate::driver::host::Host;
use crate::driver::live::Live;
use crate::driver::results::results;
use crate::driver::simulated::MissionResult;
use crate::files::agent_config::{Source, agent_config};
use crate::link::{Backoff, SessionClock, connect};
use crate::mission::{Agent, AgentConfig, Mode, Outcome, Placement};
use crate::protocol::WirePose;
use crate::record::{Header, Writer};
use crate::time::Arrival;
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use std::fs::File;
use std::io::{BufWriter, IsTerminal as _, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use tokio::sync::mpsc;

/// Operator acts that may wait for an agent that is busy; more are dropped, newest first.
const INPUTS: usize = 64;

/// Arguments of `usar run`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  usar run --server 127.0.0.1:3000 --start StartA --out run/\n  \
                  usar run --server 127.0.0.1:3000 --location 4.5,1.9,1.8 --mode teleop"
)]
pub struct RunArguments {
    /// Where the server listens
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:3000")]
    server: String,
    /// Class of the robot that INIT asks for [default: the configuration's, USARBot.P3AT]
    #[arg(long, value_name = "CLASS", help_heading = "Robot")]
    class: Option<String>,
    /// Name that INIT gives the robot [default: the configuration's, R1]
    #[arg(long, help_heading = "Robot")]
    name: Option<String>,
    /// Start pose by its name [default: the first that the server lists]
    #[arg(long, value_name = "NAME", conflicts_with = "location", help_heading = "Robot")]
    start: Option<String>,
    /// Place in the wire's axes (x forward, y right, z down), in metres
    #[arg(
        long,
        value_name = "X,Y,Z",
        value_parser = triple,
        allow_hyphen_values = true,
        help_heading = "Robot"
    )]
    location: Option<[f64; 3]>,
    /// Attitude at that place, in radians on the wire's axes
    #[arg(
        long,
        value_name = "R,P,Y",
        value_parser = triple,
        allow_hyphen_values = true,
        requires = "location",
        help_heading = "Robot"
    )]
    rotation: Option<[f64; 3]>,
    /// Who decides where the robot goes [default: the configuration's, auto]
    #[arg(long, value_enum)]
    mode: Option<ModeArgument>,
    /// Agent configuration
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address of the operator console, or off
    #[arg(long, value_name = "ADDR", default_value = "off")]
    console: String,
    /// Length of the mission in seconds [default: the configuration's, 1200]
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    time_limit: Option<f64>,
    /// Run folder, instead of runs/<date>_live/
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Write into a folder that holds a recording already
    #[arg(long, help_heading = "Output")]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ModeArgument {
    /// The robot decides
    Auto,
    /// The robot decides, an operator can take over
    Shared,
    /// The operator drives by keys
    Teleop,
}

impl From<ModeArgument> for Mode {
    fn from(mode: ModeArgument) -> Self {
        match mode {
            ModeArgument::Auto => Self::Auto,
            ModeArgument::Shared => Self::Shared,
            ModeArgument::Teleop => Self::Teleop,
        }
    }
}

/// `A,B,C`, three finite numbers.
fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|word| word.trim().parse().ok().filter(|v: &f64| v.is_finite()))
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| "expected three numbers with commas between, for example 4.5,1.9,1.8".into())
}

/// Runs the verb.
///
/// # Errors
///
/// A configuration that cannot be used, no server, a run folder that cannot be written, no robot.
pub fn run(arguments: &RunArguments) -> Result<ExitCode> {
    warn_of_no_console(&arguments.console);
    let config = config(arguments)?;
    RunFolder::check(arguments.out.as_deref(), arguments.force)?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .context("cannot start the runtime")?;
    runtime.block_on(live(arguments, config))
}

fn config(arguments: &RunArguments) -> Result<AgentConfig> {
    let sources: Vec<Source> =
        arguments.config.iter().map(|path| Source::file(path)).collect::<Result<_, _>>()?;
    let mut config = agent_config(&sources)?;
    let mission = &mut config.mission;
    if let Some(class) = &arguments.class {
        mission.class.clone_from(class);
    }
    if let Some(name) = &arguments.name {
        mission.name.clone_from(name);
    }
    if let Some(mode) = arguments.mode {
        mission.mode = mode.into();
    }
    if let Some(limit_s) = arguments.time_limit {
        mission.time_limit_s = limit_s;
    }
    if mission.observe {
        bail!("`mission.observe` is for recordings: a robot that is watched only cannot be run");
    }
    Ok(config)
}

fn placement(arguments: &RunArguments) -> Placement {
    match (&arguments.start, arguments.location) {
        (Some(name), _) => Placement::Start(name.clone()),
        (None, Some(location)) => {
            let orientation = arguments.rotation.unwrap_or_default();
            Placement::At(WirePose { location, orientation })
        }
        (None, None) => Placement::FirstStart,
    }
}

async fn live(arguments: &RunArguments, config: AgentConfig) -> Result<ExitCode> {
    #[expect(clippy::disallowed_methods, reason = "the report tells how long the run took")]
    let began = Instant::now();
    let (inputs, mut received) = mpsc::channel(INPUTS);
    // Before anything else, so that Ctrl-C ends the wait for a server too.
    let clock = SessionClock::start();
    let signals = tokio::spawn(interrupt::forward(inputs.clone(), clock));
    let backoff = Backoff::default();
    let link = tokio::select! {
        link = connect(&arguments.server, &backoff, clock) => link?,
        _ = received.recv() => {
            say::tell(format_args!("interrupted before there was a server"));
            return Ok(ExitCode::SUCCESS);
        }
    };
    let folder = RunFolder::create(arguments.out.as_deref(), "live", arguments.force)?;
    folder.write("config.toml", toml::to_string(&config)?.as_bytes())?;
    let placement = placement(arguments);
    let header = Header {
        config: toml::to_string(&config)?,
        placement: placement.clone(),
        ..Header::default()
    };
    let agent = Agent::new(config, placement);
    let recording = Writer::new(folder.recording()?, &header)?;
    let mut host: Host<BufWriter<File>> = Host::new(agent, Some(recording));
    let keyboard = keyboard(&host, &inputs, clock)?;
    let mut screen = Screen::default();
    let watch = |agent: &Agent, now: Arrival| screen.show(agent, now);
    let live = Live::new(&mut host, clock, &arguments.server, backoff, received, watch);
    let ended = live.run(link).await;
    drop(keyboard);
    signals.abort();
    write_stderr(format_args!("\n"));
    let MissionResult { mut report, files } = {
        let level = host.agent().level().unwrap_or("live").to_owned();
        results(host.agent(), host.bystander(), &level, 0)
    };
    let (agent, _) = host.finish().context("the recording cannot be closed")?;
    ended?;
    report.wall_time_s = began.elapsed().as_secs_f64();
    for (name, bytes) in &files {
        folder.write(name, bytes)?;
    }
    folder.write("report.json", serde_json::to_string_pretty(&report)?.as_bytes())?;
    match agent.outcome() {
        Some(Outcome::NoRobot(reason)) => bail!("no robot at {}: {reason}", arguments.server),
        Some(Outcome::LinkLost(reason)) => {
            write_stdout(&summary(&report, folder.path()))?;
            bail!("the connection to {} was lost: {reason}", arguments.server)
        }
        _ => write_stdout(&summary(&report, folder.path()))?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The operator's keys, where the mode and the terminal allow them.
fn keyboard<W: std::io::Write>(
    host: &Host<W>,
    inputs: &keys::Sender,
    clock: SessionClock,
) -> Result<Option<Keyboard>> {
    if host.agent().config().mission.mode == Mode::Auto {
        return Ok(None);
    }
    if !std::io::stdin().is_terminal() {
        say::warn(format_args!("no terminal to read keys from; nobody can drive"));
        return Ok(None);
    }
    say::tell(format_args!("{}", keys::HELP));
    Keyboard::open(inputs.clone(), clock).map(Some).context("cannot read keys from the terminal")
}

/// Prints notes and a line of progress. In a terminal that gives keys a line end alone does not
/// return to the left, so each line ends with both.
#[derive(Default)]
struct Screen {
    seen: usize,
    shown_s: f64,
}

impl Screen {
    fn show(&mut self, agent: &Agent, now: Arrival) {
        if say::loudness() < 0 {
            return;
        }
        let journal = agent.journal();
        for note in journal.since(self.seen) {
            let (back, end) =
                if std::io::stderr().is_terminal() { ("\r", "\x1b[K\r\n") } else { ("", "\n") };
            write_stderr(format_args!(
                "{back}{:8.1} s  {}{end}",
                note.arrival.seconds(),
                note.text
            ));
        }
        self.seen = journal.len();
        if now.seconds() - self.shown_s < 1.0 || !std::io::stderr().is_terminal() {
            return;
        }
        self.shown_s = now.seconds();
        let Some(running) = agent.running() else { return };
        let pose = running.belief().world_from_robot();
        let p = pose.translation.vector;
        write_stderr(format_args!(
            "\r{:8.1} s  at ({:.2}, {:.2}) heading {:.0}°, {:.1} m driven, {} landmarks\x1b[K",
            agent.mission_time().seconds(),
            p.x,
            p.y,
            pose.rotation.euler_angles().2.to_degrees(),
            running.belief().path_m(),
            running.belief().mapper().surface_count(),
        ));
        let _ = std::io::stderr().flush();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_numbers_are_a_triple_and_nothing_else_is() {
        assert_eq!(triple("4.5,-1.9, 1.8"), Ok([4.5, -1.9, 1.8]));
        for wrong in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", ""] {
            assert!(triple(wrong).is_err(), "{wrong}");
        }
    }
}
