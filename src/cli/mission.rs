//! `usar mission`: one mission headless, agents and simulator in lockstep.

use super::files::{Format, write_stderr, write_stdout};
use super::out::RunFolder;
use super::say;
use crate::driver::simulated::{MissionResult, SimulatedMission};
use crate::export::report::{Report, SweepBudget};
use crate::files::agent_config::Source;
use crate::files::scenario::{self, LoadedScenario};
use crate::mission::Level;
use anyhow::Result;
use clap::Args;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Arguments of `usar mission`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  usar mission scenarios/station.toml --seed 7 --out run/")]
pub struct MissionArguments {
    /// Scenario file, or the name of one in the program: box, planes, station, station_udk, yellow
    scenario: PathBuf,
    #[command(flatten)]
    common: CommonArguments,
    /// Form of the summary on standard output
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

/// What `mission` and `demo` share.
#[derive(Debug, Args)]
pub struct CommonArguments {
    /// Seed of the simulator's noise, instead of the scenario's
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Length of the mission in seconds, instead of the scenario's
    #[arg(long, value_name = "S", value_parser = positive_seconds)]
    pub time_limit: Option<f64>,
    /// Agent configuration that overrides the scenario's
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Run folder, instead of runs/<date>_<scenario>/
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// Write into a folder that holds a recording already
    #[arg(long, help_heading = "Output")]
    pub force: bool,
}

/// Where the time of all sweeps went, and what nods cost.
fn sweep_times(report: &Report) -> String {
    let sum = |part: fn(&SweepBudget) -> f64| -> f64 {
        report.sweeps.iter().fold(0.0, |sum, sweep| sum + part(&sweep.budget_s))
    };
    let mut text = format!(
        "  sweeps   tilt moving {:.0} s, servo {:.0} s, laser {:.0} s, idle {:.0} s",
        sum(|budget| budget.moving),
        sum(|budget| budget.servo),
        sum(|budget| budget.laser),
        sum(|budget| budget.idle)
    );
    let nods = &report.nods;
    if let (Some(metres), Some(seconds)) = (nods.metres_per_nod, nods.seconds_per_metre) {
        let _ = write!(
            text,
            "; {} nods on the way, {metres:.2} m each at {seconds:.1} s a metre",
            nods.count
        );
    }
    text + "\n"
}

/// A number of seconds above zero.
pub fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        _ => Err("expected a number of seconds above 0".to_owned()),
    }
}

/// Runs the verb.
///
/// # Errors
///
/// A scenario or configuration that cannot be used, a run folder that cannot be written.
pub fn run(arguments: &MissionArguments) -> Result<ExitCode> {
    let loaded = load(&arguments.scenario, &arguments.common)?;
    let (report, folder) = fly(loaded, &arguments.common, Progress::Quiet)?;
    write_stdout(&match arguments.format {
        Format::Text => summary(&report, &folder),
        Format::Json => serde_json::to_string_pretty(&report)? + "\n",
    })?;
    Ok(ExitCode::SUCCESS)
}

/// The scenario with what the command line changes in it.
///
/// # Errors
///
/// Everything wrong with scenario, map, robots or configuration.
pub fn load(path: &std::path::Path, common: &CommonArguments) -> Result<LoadedScenario> {
    let overrides: Vec<Source> =
        common.config.iter().map(|path| Source::file(path)).collect::<Result<_, _>>()?;
    let mut loaded = scenario::load(path, &overrides)?;
    if let Some(seed) = common.seed {
        loaded.files.scenario.seed = seed;
    }
    if let Some(limit) = common.time_limit {
        loaded.agent.mission.time_limit_s = limit;
    }
    Ok(loaded)
}

/// How much is said while a mission runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Warnings only.
    Quiet,
    /// What the agent does, and a line of progress.
    Lively,
}

/// Runs a mission to its end and writes its folder; gives the report and the folder's path.
///
/// # Errors
///
/// When parts do not fit or files cannot be written.
pub fn fly(
    loaded: LoadedScenario,
    common: &CommonArguments,
    progress: Progress,
) -> Result<(Report, PathBuf)> {
    let progress = match say::loudness() {
        ..0 => Progress::Quiet,
        0 => progress,
        1.. => Progress::Lively,
    };
    let folder = RunFolder::create(common.out.as_deref(), &loaded.name, common.force)?;
    folder.write("config.toml", toml::to_string(&loaded.agent)?.as_bytes())?;
    let stop = super::interrupt::watch();
    #[expect(clippy::disallowed_methods, reason = "the report tells how long the run took")]
    let began = Instant::now();
    let limit_s = loaded.agent.mission.time_limit_s;
    let mut mission = SimulatedMission::new(loaded, folder.recording()?)?;
    let mut seen = 0;
    let mut shown_s = f64::NEG_INFINITY;
    while mission.step()? {
        seen = show(&mission, seen, progress);
        if progress == Progress::Lively && mission.now().seconds() - shown_s >= 5.0 {
            shown_s = mission.now().seconds();
            status_line(&mission, limit_s);
        }
        if stop.is_set() {
            mission.end("interrupted")?;
        }
    }
    show(&mission, seen, progress);
    let MissionResult { mut report, files } = mission.finish()?;
    report.wall_time_s = began.elapsed().as_secs_f64();
    for (name, bytes) in &files {
        folder.write(name, bytes)?;
    }
    folder.write("report.json", serde_json::to_string_pretty(&report)?.as_bytes())?;
    Ok((report, folder.path().to_owned()))
}

/// Prints what the agent has noted since; gives the number of notes.
fn show<W: std::io::Write>(
    mission: &SimulatedMission<W>,
    seen: usize,
    progress: Progress,
) -> usize {
    let journal = mission.agent().journal();
    for note in journal.since(seen) {
        if say::loudness() >= 0 && (progress == Progress::Lively || note.level > Level::Info) {
            write_stderr(format_args!("\r{:8.1} s  {}\n", note.arrival.seconds(), note.text));
        }
    }
    journal.len()
}

fn status_line<W: std::io::Write>(mission: &SimulatedMission<W>, limit_s: f64) {
    let Some(running) = mission.agent().running() else { return };
    let p = running.belief().world_from_robot().translation.vector;
    write_stderr(format_args!(
        "\r{:8.1} / {limit_s:.0} s  at ({:.1}, {:.1}), {:.0} m driven, {} landmarks ",
        mission.now().seconds(),
        p.x,
        p.y,
        running.belief().path_m(),
        running.belief().mapper().surface_count(),
    ));
    let _ = std::io::stderr().flush();
}

/// The report in a dozen lines.
pub fn summary(report: &Report, folder: &std::path::Path) -> String {
    let mut text = format!(
        "\n{}: {} after {:.0} s ({:.0} s of wall time)\n",
        report.scenario, report.outcome, report.mission_time_s, report.wall_time_s
    );
    let split = report.time_split_s;
    let _ = writeln!(
        text,
        "  time     scan {:.0} s, drive {:.0} s, turn {:.0} s, think {:.0} s, recover {:.0} s",
        split.scan, split.drive, split.turn, split.think, split.recover
    );
    let _ = writeln!(
        text,
        "  map      {} landmarks, {} associations, {} sweeps, {:.1} m driven",
        report.landmarks,
        report.associations,
        report.sweeps.len(),
        report.distance_m
    );
    let fixes = &report.localisation;
    if fixes.weak_scans > 0 || fixes.most_hypotheses > 1 {
        let _ = writeln!(
            text,
            "  place    {} of {} scans left a direction open{}, {} explanations alive (most {})",
            fixes.weak_scans,
            fixes.scans,
            fixes.last_weak.last().map_or_else(String::new, |weak| {
                let axes: Vec<&str> = weak.open.iter().map(|open| &*open.axis).collect();
                format!(", the last one {}", axes.join(", "))
            }),
            fixes.hypotheses,
            fixes.most_hypotheses
        );
    }
    text += &sweep_times(report);
    if let (Some(coverage), Some(explored), Some(reachable)) =
        (report.coverage, report.explored_m2, report.reachable_m2)
    {
        let _ = writeln!(
            text,
            "  coverage {coverage:.3}: {explored:.0} of {reachable:.0} m² that can be reached"
        );
    }
    if let Some(error) = report.pose_error {
        let or_dash = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.2} m"));
        let _ = writeln!(
            text,
            "  pose     {:.3} m, {:.2}° at the end, {:.3} m RMS; odometry alone {}, INS alone {}",
            error.final_m,
            error.final_deg,
            error.ate_rmse_m,
            or_dash(error.odometry_final_m),
            or_dash(error.ins_final_m)
        );
    }
    if let (Some(falls), Some(collisions)) = (report.falls, report.collisions) {
        let _ = writeln!(
            text,
            "  safety   {falls} falls, {collisions} collisions (hardest {:.2} m/s), {} troubles",
            report.hardest_collision_mps.unwrap_or(0.0),
            report.stuck
        );
    }
    if let (Some(found), Some(victims)) = (report.victims.found, report.victims.truth) {
        let _ = writeln!(
            text,
            "  victims  {found} of {victims} found, {} wrong",
            report.victims.wrong.unwrap_or(0)
        );
    }
    let link = report.link;
    if link.damaged > 0 {
        let _ = writeln!(
            text,
            "  link     {} lines, {} damaged, {} of an unknown type",
            link.lines, link.damaged, link.unknown
        );
    }
    let _ = writeln!(text, "  files    {}", folder.display());
    text
}
