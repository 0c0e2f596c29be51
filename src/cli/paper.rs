//! `usar paper`: the paper's tables and figures from this code.

mod fig2;
mod table1;

use crate::export::canvas::Canvas;
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
        #[arg(long, value_enum, default_value_t = Format::Text)]
        format: Format,
    },
    /// Figure 2: prediction and update of each step of Table I, as `fig2.png`.
    Fig2 {
        /// Folder for the picture.
        #[arg(long, default_value = ".")]
        out: PathBuf,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// For people.
    Text,
    /// For scripts.
    Json,
}

/// Runs the verb.
pub fn run(arguments: PaperArguments) -> anyhow::Result<ExitCode> {
    match arguments.what {
        What::Table1 { format } => {
            let rows = table1::paper_mode(|_| ());
            match format {
                Format::Text => print!("{}", table1::text("Paper mode (MIP)", &rows)),
                Format::Json => println!("{}", serde_json::json!({ "paper_mode": rows })),
            }
        }
        What::Fig2 { out } => write_picture(&out, "fig2.png", &fig2::picture())?,
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes a picture by way of a temporary file, so that a viewer never sees half of it.
fn write_picture(folder: &Path, name: &str, picture: &Canvas) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}", folder.display()))?;
    let path = folder.join(name);
    let partial = folder.join(format!("{name}.part"));
    std::fs::write(&partial, picture.to_png()).with_context(|| format!("{}", partial.display()))?;
    std::fs::rename(&partial, &path).with_context(|| format!("{}", path.display()))?;
    println!("{}", path.display());
    Ok(())
}
