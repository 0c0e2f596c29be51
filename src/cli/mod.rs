//! Arguments, wiring and exit codes: one file per verb.

mod check;
mod demo;
mod eval;
mod export;
mod files;
mod info;
pub mod interrupt;
mod keys;
mod map;
mod mission;
mod out;
mod paper;
mod replay;
mod run;
mod say;
mod scan;
mod segment;
mod series;
mod session;
mod sim;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Autonomous rescue-robot agent for USARSim, with its stand-in simulator.
#[derive(Debug, Parser)]
#[command(name = "usar", version, propagate_version = true)]
pub struct Arguments {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    manners: say::Manners,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// One autonomous mission in the railway station, with its own simulator.
    Demo(demo::DemoArguments),
    /// One mission headless, agents and simulator in lockstep.
    Mission(mission::MissionArguments),
    /// The agent against any USARSim server.
    Run(run::RunArguments),
    /// A recording through the live path.
    Replay(replay::ReplayArguments),
    /// The stand-in USARSim server on TCP.
    Sim(sim::SimArguments),
    /// Recorded triples of odometry, tilt and laser put together to organised scans.
    Scan(scan::ScanArguments),
    /// One organised scan through segmentation and fitting.
    Segment(segment::SegmentArguments),
    /// Organised scans through segmentation, localisation and mapping.
    Map(map::MapArguments),
    /// A run against the truth in it, or two runs side by side.
    Eval(eval::EvalArguments),
    /// One deliverable from a run folder or a session.
    Export(export::ExportArguments),
    /// What a session, scan, map, scenario or configuration holds.
    Info(info::InfoArguments),
    /// Whether files are valid, all errors at once; what a rig can see of the ground.
    Check(check::CheckArguments),
    /// Regenerates the paper's tables and figures from this code.
    Paper(paper::PaperArguments),
}

/// Runs the verb that the arguments name and turns its outcome into an exit code.
pub fn run(arguments: Arguments) -> ExitCode {
    arguments.manners.set();
    let outcome = match arguments.verb {
        Verb::Demo(arguments) => demo::run(&arguments),
        Verb::Mission(arguments) => mission::run(&arguments),
        Verb::Run(arguments) => run::run(&arguments),
        Verb::Replay(arguments) => replay::run(&arguments),
        Verb::Sim(arguments) => sim::run(&arguments),
        Verb::Scan(arguments) => scan::run(&arguments),
        Verb::Segment(arguments) => segment::run(&arguments),
        Verb::Map(arguments) => map::run(&arguments),
        Verb::Eval(arguments) => eval::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
        Verb::Info(arguments) => info::run(&arguments),
        Verb::Check(arguments) => check::run(&arguments),
        Verb::Paper(arguments) => paper::run(arguments),
    };
    outcome.unwrap_or_else(|error| {
        say::error(format_args!("{}", chain(&error)));
        ExitCode::FAILURE
    })
}

/// An error with its causes. Some messages name their cause already, so a cause that ends what was
/// said is not said again.
fn chain(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.ends_with(&cause) {
            text += ": ";
            text += &cause;
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context as _;

    #[test]
    fn a_cause_is_told_once() {
        let io = || std::io::Error::new(std::io::ErrorKind::NotFound, "no such thing");
        let told = crate::driver::simulated::SimulatedError::Io(io());
        assert_eq!(chain(&anyhow::Error::from(told)), "recording: no such thing");
        let plain = Err::<(), _>(io()).context("cannot read x").context("in y").unwrap_err();
        assert_eq!(chain(&plain), "in y: cannot read x: no such thing");
    }
}
