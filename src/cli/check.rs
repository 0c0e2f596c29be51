//! `usar check`: whether files are valid, and what a scenario's rig can see of the ground.

use super::files::write_stdout;
use super::say;
use super::session::DONE_WITH_LOSS;
use crate::driver::host::Host;
use crate::driver::lockstep::Lockstep;
use crate::files::kind::{Verdict, check};
use crate::files::scenario;
use crate::mission::Agent;
use crate::robot::{Rig, Visibility};
use crate::sim::Session;
use crate::time::Arrival;
use anyhow::{Context, Result, bail};
use clap::Args;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Simulated time within which a robot of the stand-in is in service.
const OPEN_WITHIN_S: f64 = 30.0;

/// Arguments of `usar check`.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  usar check scenarios/station.toml maps/station.toml run/session.usar\n  \
                  usar check --rig scenarios/station.toml"
)]
pub struct CheckArguments {
    /// Sessions, scans, maps, scenarios, robots or configurations
    #[arg(required_unless_present = "rig")]
    files: Vec<PathBuf>,
    /// Print what the rig of this scenario's first robot can see of level ground
    #[arg(long, value_name = "SCENARIO")]
    rig: Option<PathBuf>,
}

/// Runs the verb.
///
/// # Errors
///
/// A file that cannot be read, a scenario that cannot be used.
pub fn run(arguments: &CheckArguments) -> Result<ExitCode> {
    let (mut invalid, mut cut) = (false, false);
    for path in &arguments.files {
        match std::fs::read(path) {
            Err(error) => {
                invalid = true;
                say::error(format_args!("cannot read {}: {error}", path.display()));
            }
            Ok(bytes) => match check(path, &bytes) {
                Verdict::Valid(kind) => {
                    write_stdout(&format!("{}: valid {kind}\n", path.display()))?;
                }
                Verdict::Cut { loss } => {
                    cut = true;
                    say::warn(format_args!("{}: not whole: {loss}", path.display()));
                }
                Verdict::Invalid(mistakes) => {
                    invalid = true;
                    for mistake in mistakes {
                        say::error(format_args!("{mistake}"));
                    }
                }
            },
        }
    }
    if let Some(scenario) = &arguments.rig {
        write_stdout(&rig_report(scenario)?)?;
    }
    Ok(match (invalid, cut) {
        (true, _) => ExitCode::FAILURE,
        (false, true) => ExitCode::from(DONE_WITH_LOSS),
        (false, false) => ExitCode::SUCCESS,
    })
}

/// What the rig sees, learnt as the agent learns it: from a session with the stand-in.
fn rig_report(path: &Path) -> Result<String> {
    let loaded = scenario::load(path, &[])?;
    let session =
        Session::new(&loaded.files.world, &loaded.files.scenario, &loaded.files.catalogue)?;
    let models = loaded.files.scenario.models(&loaded.files.catalogue)?;
    let origin_height_m = models.first().context("a scenario has a robot")?.origin_height_m();
    let agent = Agent::new(loaded.agent.clone(), loaded.placement.clone());
    let host: Host<std::io::Sink> = Host::new(agent, None);
    let mut lockstep = Lockstep::new(session, vec![host])?;
    let limit = Arrival::from_seconds(OPEN_WITHIN_S);
    loop {
        let alive = lockstep.step()?;
        let agent = lockstep.agents().next().context("a scenario has a robot")?;
        if let Some(running) = agent.running() {
            let mut rig = running.rig().clone();
            // The agent measures this with its first scan; the scenario has it.
            rig.body.origin_height_m = origin_height_m;
            return Ok(describe(&loaded.name, &rig));
        }
        if !alive || lockstep.now() > limit {
            let outcome = agent.outcome().map_or("not in service", |outcome| outcome.word());
            bail!("{}: the robot was never in service: {outcome}", path.display());
        }
    }
}

fn describe(name: &str, rig: &Rig) -> String {
    let mut text = format!("{name}: {} ({:?})\n", rig.class, rig.dialect);
    let body = &rig.body;
    let _ = writeln!(
        text,
        "  hull           {:.3} × {:.3} × {:.3} m, origin {:.3} m above the floor",
        body.length_m, body.width_m, body.height_m, body.origin_height_m
    );
    let Some(laser) = &rig.laser else {
        text.push_str("  laser          none: no ground is ever seen\n");
        return text;
    };
    let _ = writeln!(
        text,
        "  laser          {}, {:.1}°, {:.2} to {:.1} m",
        laser.name,
        laser.fov_rad.to_degrees(),
        laser.min_range_m,
        laser.max_range_m
    );
    match laser.head.tilt().and_then(|tilt| tilt.limits) {
        Some(limits) => {
            let degrees = [limits.min_rad, limits.max_rad].map(f64::to_degrees);
            let _ = writeln!(
                text,
                "  tilt           {:.1}° (up) to {:+.1}° (down)",
                degrees[0], degrees[1]
            );
        }
        None if laser.head.tilt().is_some() => text.push_str("  tilt           without limits\n"),
        None => text.push_str("  tilt           none: 2D mode, drop-offs are not seen\n"),
    }
    if let Some(sight) = rig.visibility() {
        describe_sight(&mut text, &sight);
    }
    text
}

fn describe_sight(text: &mut String, sight: &Visibility) {
    let metres = |m: Option<f64>| m.map_or("never".to_owned(), |m| format!("{m:.2} m"));
    let _ = writeln!(text, "  laser height   {:.3} m", sight.laser_height_m);
    let _ = writeln!(
        text,
        "  nearest ground {} ahead of the laser, {} from the robot's centre",
        metres(sight.nearest_ahead_m),
        metres(sight.nearest_from_centre_m)
    );
    let _ = writeln!(text, "  blind radius   {}", metres(sight.blind_radius_m));
    text.push_str("  bearing   nearest seen   with the pan turned\n");
    // The list goes in steps of 5°; every 15° is enough for people.
    for ground in sight.by_bearing.iter().step_by(3) {
        let _ = writeln!(
            text,
            "  {:+6.0}°   {:>12}   {:>12}",
            ground.bearing_rad.to_degrees(),
            metres(ground.nearest_m),
            metres(ground.nearest_panned_m)
        );
    }
}
