//! `usar eval`: a run against the truth in it, or two runs side by side.

use super::files::{Format, write_stdout};
use super::say;
use crate::driver::simulated::passability;
use crate::export::coverage::Passability;
use crate::export::evaluate::{Evaluation, RunFiles, evaluate};
use crate::export::tum::{self, TimedPose};
use crate::files::run;
use crate::files::world::{WorldFiles, built_in_names, load_world};
use crate::terrain::RobotShape;
use anyhow::{Context, Result, ensure};
use clap::Args;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `usar eval`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  usar eval run/\n  usar eval run/ other/ --format json\n  usar eval map/ --truth truth.tum"
)]
pub struct EvalArguments {
    /// Run folder
    run: PathBuf,
    /// A second one, set beside the first
    run2: Option<PathBuf>,
    /// Scenario of the runs, where its name in the report is not one in the program
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// True poses, TUM lines, in the place of the run's truth.tum: of the robot, or of the sensor at each
    /// scan for a folder of `usar map`
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Form of the scores
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

/// Runs the verb.
///
/// # Errors
///
/// A folder that is no run, a scenario that cannot be used.
pub fn run(arguments: &EvalArguments) -> Result<ExitCode> {
    let folders: Vec<&Path> =
        std::iter::once(&arguments.run).chain(&arguments.run2).map(PathBuf::as_path).collect();
    let scores: Vec<Evaluation> =
        folders.iter().map(|folder| score(folder, arguments)).collect::<Result<_>>()?;
    write_stdout(&match (arguments.format, scores.as_slice()) {
        (Format::Json, [only]) => serde_json::to_string_pretty(only)? + "\n",
        (Format::Json, both) => serde_json::to_string_pretty(both)? + "\n",
        (Format::Text, both) => table(&folders, both),
    })?;
    Ok(ExitCode::SUCCESS)
}

fn score(folder: &Path, arguments: &EvalArguments) -> Result<Evaluation> {
    let mut files = run::load(folder)?;
    if let Some(path) = &arguments.truth {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        files.truth = tum::parse(&text).with_context(|| format!("{}", path.display()))?;
    }
    let is_map = files.report.is_of_map();
    let world = match &arguments.scenario {
        Some(path) => Some(load_world(path)?),
        None => known_world(&files.report.scenario)?,
    };
    if world.is_none() && is_map {
        say::warn(format_args!(
            "{}: planes are not scored without the world they are of, name its scenario's file with \
             --scenario; what planes were taken for is told from the planes themselves",
            folder.display()
        ));
    } else if world.is_none() {
        say::warn(format_args!(
            "{}: scenario `{}` is not known, so coverage and planes are not scored; name \
             its file with --scenario",
            folder.display(),
            files.report.scenario
        ));
    }
    if files.truth.is_empty() {
        say::warn(format_args!(
            "{}: no truth.tum, so nothing is scored; name the true poses with --truth",
            folder.display()
        ));
    } else if files.keyframes.is_empty() {
        say::warn(format_args!(
            "{}: no keyframes.json, so neither NEES nor associations are scored",
            folder.display()
        ));
    } else if files.keyframes.iter().skip(1).all(|keyframe| keyframe.motion_covariance.is_none()) {
        say::warn(format_args!(
            "{}: no covariances in keyframes.json, so no NEES is told",
            folder.display()
        ));
    }
    check_times(folder, &files)?;
    let limits = world.as_ref().map(limits).transpose()?;
    let score = evaluate(&files, world.as_ref().map(|world| &world.world).zip(limits.as_ref()));
    if score.planes.is_some_and(|planes| planes.matched == 0) {
        say::warn(format_args!(
            "{}: none of its planes lies on a surface of the scenario's world; is it of another one?",
            folder.display()
        ));
    }
    Ok(score)
}

/// Says that the truth does not end where the trajectory does: beyond its end its last pose holds.
///
/// # Errors
///
/// Times that have nothing in common.
fn check_times(folder: &Path, files: &RunFiles) -> Result<()> {
    const APART_S: f64 = 1.0;
    let span = |poses: &[TimedPose]| Some((poses.first()?.time_s, poses.last()?.time_s));
    let spans = span(&files.trajectory).zip(span(&files.truth));
    let Some(((own_first_s, own_s), (true_first_s, true_s))) = spans else { return Ok(()) };
    ensure!(
        own_first_s <= true_s && true_first_s <= own_s,
        "{}: the trajectory is of {own_first_s} to {own_s} s, the truth of {true_first_s} to {true_s} s: \
         they have no time in common",
        folder.display()
    );
    if (own_s - true_s).abs() >= APART_S {
        say::warn(format_args!(
            "{}: the trajectory ends at {own_s} s, the truth at {true_s} s: what one of them lacks is held \
             against the last pose that it has",
            folder.display()
        ));
    }
    Ok(())
}

/// The world of a scenario in the program.
fn known_world(name: &str) -> Result<Option<WorldFiles>> {
    match built_in_names().find(|known| *known == name) {
        Some(known) => Ok(Some(load_world(Path::new(known))?)),
        None => Ok(None),
    }
}

/// What the scenario's first robot can pass.
fn limits(world: &WorldFiles) -> Result<Passability> {
    let models = world.scenario.models(&world.catalogue)?;
    let class = models.first().context("the scenario has no robot")?;
    let [length_m, width_m, height_m] =
        class.wire.dimensions_m.unwrap_or_else(|| class.extents_m());
    Ok(passability(&RobotShape {
        length_m,
        width_m,
        height_m,
        base_above_floor_m: class.origin_height_m(),
        wheel_radius_m: class.wheels.radius_m,
        ..RobotShape::default()
    }))
}

/// The scores as a table, one column a run.
fn table(folders: &[&Path], scores: &[Evaluation]) -> String {
    let names: String =
        folders.iter().map(|folder| format!("  {:>22}", folder.display())).collect();
    let mut text = format!("{:<28}{names}\n", "");
    let mut row = |name: &str, value: &dyn Fn(&Evaluation) -> Option<String>| {
        let cells: String = scores
            .iter()
            .map(|score| format!("  {:>22}", value(score).unwrap_or_else(|| "-".into())))
            .collect();
        let _ = writeln!(text, "{name:<28}{cells}");
    };
    let metres = |value: f64| format!("{value:.4}");
    let degrees = |value: f64| format!("{value:.3}");
    row("scenario", &|score| Some(score.scenario.clone()));
    row("outcome", &|score| Some(score.outcome.clone()));
    row("mission time, s", &|score| Some(format!("{:.0}", score.mission_time_s)));
    row("true path, m", &|score| score.true_path_m.map(|v| format!("{v:.1}")));
    row("ATE rmse, m", &|score| score.ate.map(|ate| format!("{:.4}", ate.rmse_m)));
    row("ATE max, m", &|score| score.ate.map(|ate| format!("{:.4}", ate.max_m)));
    row("final error, m", &|score| score.ate.map(|ate| format!("{:.4}", ate.final_m)));
    row("final error, deg", &|score| score.ate.map(|ate| format!("{:.3}", ate.final_deg)));
    row("RPE over 1 m, m", &|score| score.rpe.map(|rpe| format!("{:.4}", rpe.translation_rmse_m)));
    row("RPE over 1 m, deg", &|score| score.rpe.map(|rpe| format!("{:.3}", rpe.rotation_rmse_deg)));
    row("drift, % of path", &|score| score.drift_percent.map(|v| format!("{v:.3}")));
    row("reachable, m2", &|score| score.reachable_m2.map(|v| format!("{v:.1}")));
    row("explored, m2", &|score| score.explored_m2.map(|v| format!("{v:.1}")));
    row("coverage", &|score| score.coverage.map(|v| format!("{v:.4}")));
    row("planes matched / not", &|score| {
        score.planes.map(|planes| format!("{} / {}", planes.matched, planes.unmatched))
    });
    row("plane offset rmse, m", &|score| score.planes?.offset_rmse_m.map(metres));
    row("plane offset median, m", &|score| score.planes?.offset_median_m.map(metres));
    row("plane tilt rmse, deg", &|score| score.planes?.tilt_rmse_deg.map(degrees));
    row("plane tilt median, deg", &|score| score.planes?.tilt_median_deg.map(degrees));
    row("NEES of keyframes (6)", &|score| score.nees.map(|nees| format!("{:.2}", nees.mean)));
    row("NEES from each to the next (6)", &|score| {
        score.step_nees.map(|nees| format!("{:.2}", nees.mean))
    });
    row("truth told to, m and deg", &|score| {
        let nees = score.nees.filter(|nees| nees.truth_step_m.max(nees.truth_step_rad) > 0.0)?;
        Some(format!("{} / {:.4}", nees.truth_step_m, nees.truth_step_rad.to_degrees()))
    });
    row("within 95 %", &|score| score.nees.map(|nees| format!("{:.2}", nees.within_95)));
    row("associations right / wrong", &|score| {
        score.associations.map(|a| format!("{} / {}", a.right, a.wrong))
    });
    row("surfaces mapped twice", &|score| score.associations.map(|a| a.doubled.to_string()));
    row("falls", &|score| score.falls.map(|v| v.to_string()));
    row("collisions", &|score| score.collisions.map(|v| v.to_string()));
    row("victims found", &|score| score.victims_found.map(|v| v.to_string()));
    text
}
