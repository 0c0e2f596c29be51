//! `usar demo`: the main job with nothing to install.

use super::files::{warn_of_no_console, write_stdout};
use super::mission::{CommonArguments, Progress, fly, load, summary};
use super::say;
use anyhow::Result;
use clap::Args;
use std::path::Path;
use std::process::ExitCode;

/// Arguments of `usar demo`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  usar demo --seed 3 --out run/")]
pub struct DemoArguments {
    #[command(flatten)]
    common: CommonArguments,
    /// Address of the operator console, or off
    #[arg(long, value_name = "ADDR", default_value = "off")]
    console: String,
    /// Keep the console up after the mission
    #[arg(long)]
    stay: bool,
}

/// Runs the verb: one mission in the station.
///
/// # Errors
///
/// A run folder that cannot be written.
pub fn run(arguments: &DemoArguments) -> Result<ExitCode> {
    warn_of_no_console(&arguments.console);
    if arguments.stay {
        say::warn(format_args!(
            "--stay keeps the console up, which is not built yet: the demo ends with its \
             mission"
        ));
    }
    say::tell(format_args!(
        "one autonomous mission in the railway station, with its own simulator"
    ));
    let loaded = load(Path::new("station"), &arguments.common)?;
    let (report, folder) = fly(loaded, &arguments.common, Progress::Lively)?;
    write_stdout(&summary(&report, &folder))?;
    Ok(ExitCode::SUCCESS)
}
