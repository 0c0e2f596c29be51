//! What several verbs share: reading scans, printing, medians.

use super::say;
use crate::files::pcd::read_pcd;
use crate::scan::PointGrid;
use anyhow::{Context, Result};
use std::io::{Read as _, Write as _};
use std::ops::Range;
use std::path::Path;

/// Form of what goes to standard output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Format {
    /// A table for people
    #[default]
    Text,
    /// One JSON document
    Json,
}

/// An organised scan from a file; `-` is standard input.
pub fn read_scan(path: &Path) -> Result<PointGrid> {
    let name = path.display();
    let bytes = if path == Path::new("-") {
        let mut bytes = Vec::new();
        std::io::stdin().read_to_end(&mut bytes).map(|_| bytes)
    } else {
        std::fs::read(path)
    };
    let bytes = bytes.with_context(|| format!("cannot read {name}"))?;
    let cloud = read_pcd(&bytes).with_context(|| format!("{name} is not a usable scan"))?;
    cloud.into_grid().with_context(|| format!("{name} is not a usable scan"))
}

/// `A..B` with `A < B`.
pub fn parse_columns(text: &str) -> Result<Range<usize>, String> {
    let range = text.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
    match range {
        Some(range) if range.start < range.end => Ok(range),
        _ => Err("expected A..B with A < B, for example 25..156".to_owned()),
    }
}

/// Prints to standard output; a reader that has seen enough and closed the pipe is success.
pub fn write_stdout(text: &str) -> Result<()> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        result => result.context("cannot write to standard output"),
    }
}

/// Prints to standard error. A terminal that has gone must not end a run, as `eprint!` would.
pub fn write_stderr(text: std::fmt::Arguments<'_>) {
    let _ = std::io::stderr().write_fmt(text);
}

/// The middle value, the upper of two; zero of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

/// Says that a console at `address` is not to be had; `off` asks for none.
pub fn warn_of_no_console(address: &str) {
    if !address.eq_ignore_ascii_case("off") {
        say::warn(format_args!("the console is not built yet; going on without it"));
    }
}
