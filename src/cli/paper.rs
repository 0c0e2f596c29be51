//! `usar paper`: the paper's tables and figures from this code.

mod compare2d;
mod fig2;
mod figures;
mod table1;

use super::files::{Format, write_stdout};
use super::out::RunFolder;
use crate::export::canvas::Canvas;
use crate::files::replace::replace_file;
use crate::files::scenario::{self, LoadedScenario};
use crate::mission::FineSweep;
use anyhow::Context;
use clap::{Args, Subcommand};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `usar paper`.
#[derive(Debug, Args)]
#[command(after_help = "Example: usar paper table1 --format json")]
pub struct PaperArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Table I: localisation on three planes, with the paper's own odometry noise.
    Table1 {
        /// How to print it.
        #[arg(long, value_enum, default_value_t)]
        format: Format,
        /// Folder for `table1.json` beside the printed table.
        #[arg(long)]
        out: Option<PathBuf>,
    },
    /// Figure 2: prediction and update of each step of Table I, as `fig2.png`.
    Fig2 {
        /// Folder for the picture, instead of runs/<date>_fig2/
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
    },
    /// Figure 3: a mission's map from above, as `fig3.png`.
    Fig3(Flight),
    /// Figure 6: a mission's map at a slant, as `fig6.png`, and its size beside cloud and octree.
    Fig6(Flight),
    /// Figures 4, 7 and 10: a mission mapped in 3D and, from its level lines, by 2D scan matching.
    ///
    /// Writes `compare3d.png`, `compare2d.png` and `compare2d.json`.
    Compare2d(Flight),
}

/// A mission that a figure is drawn from. Its full scan is the paper's: at rest at each of 220 tilts.
#[derive(Debug, Args)]
struct Flight {
    /// Scenario file, or the name of one in the program.
    #[arg(long, default_value = "station")]
    scenario: PathBuf,
    /// Seed of the simulator's noise, instead of the scenario's.
    #[arg(long)]
    seed: Option<u64>,
    /// Length of the mission in seconds, instead of the scenario's.
    #[arg(long, value_name = "S", value_parser = super::mission::positive_seconds)]
    time_limit: Option<f64>,
    /// Folder for the pictures, instead of runs/<date>_<figure>/
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Flight {
    fn load(&self) -> anyhow::Result<LoadedScenario> {
        let mut loaded = scenario::load(&self.scenario, &[])?;
        if let Some(seed) = self.seed {
            loaded.files.scenario.seed = seed;
        }
        if let Some(limit) = self.time_limit {
            loaded.agent.mission.time_limit_s = limit;
        }
        // A figure of the paper's begins with the paper's scan, not with the faster one of missions.
        loaded.agent.mission.fine_sweep = FineSweep::Paper;
        Ok(loaded)
    }
}

/// Runs the verb.
pub fn run(arguments: PaperArguments) -> anyhow::Result<ExitCode> {
    match arguments.what {
        What::Table1 { format, out } => {
            let (paper, full) = (table1::paper_mode(|_| ()), table1::full_mode());
            let document = serde_json::json!({ "paper_mode": paper, "full_mode": full });
            if let Some(folder) = out {
                let text = serde_json::to_string_pretty(&document)?;
                write_file(&folder, "table1.json", text.as_bytes())?;
            }
            write_stdout(&match format {
                Format::Text => {
                    table1::text("Paper mode (MIP)", &paper) + &table1::text("Full mode", &full)
                }
                Format::Json => document.to_string() + "\n",
            })?;
        }
        What::Fig2 { out } => {
            write_picture(&folder(out.as_deref(), "fig2")?, "fig2.png", &fig2::picture())?;
        }
        What::Fig3(flight) => {
            let figures = figures::map_figures(flight.load()?)?;
            let out = folder(flight.out.as_deref(), "fig3")?;
            write_picture(&out, "fig3.png", &figures.fig3)?;
        }
        What::Fig6(flight) => {
            let figures = figures::map_figures(flight.load()?)?;
            let out = folder(flight.out.as_deref(), "fig6")?;
            let text = serde_json::to_string_pretty(&figures.compactness)?;
            write_file(&out, "fig6.json", text.as_bytes())?;
            write_picture(&out, "fig6.png", &figures.fig6)?;
            write_stdout(&figures.compactness.text())?;
        }
        What::Compare2d(flight) => {
            let outcome = compare2d::compare(flight.load()?)?;
            let out = folder(flight.out.as_deref(), "compare2d")?;
            let text = serde_json::to_string_pretty(&outcome.comparison)?;
            write_file(&out, "compare2d.json", text.as_bytes())?;
            write_picture(&out, "compare3d.png", &outcome.map_3d)?;
            write_picture(&out, "compare2d.png", &outcome.map_2d)?;
            write_stdout(&outcome.comparison.text())?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Where a figure goes: the folder that was asked for, else one under `runs/` as any run.
fn folder(out: Option<&Path>, name: &str) -> anyhow::Result<PathBuf> {
    match out {
        Some(out) => Ok(out.to_owned()),
        None => Ok(RunFolder::create(None, name, false)?.path().to_owned()),
    }
}

/// Writes a picture and prints where it lies.
fn write_picture(folder: &Path, name: &str, picture: &Canvas) -> anyhow::Result<()> {
    write_file(folder, name, &picture.to_png())?;
    write_stdout(&format!("{}\n", folder.join(name).display()))
}

/// Writes a file of a folder, which is made where it is missing; a reader never sees half of it.
fn write_file(folder: &Path, name: &str, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}", folder.display()))?;
    let path = folder.join(name);
    replace_file(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
}
