//! What several verbs share: reading scans, printing, medians.

use super::say;
use crate::files::pcd::read_pcd;
use crate::scan::{PointGrid, viewpoint};
use anyhow::{Context, Result};
use nalgebra::Point3;
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

/// An organised scan as it was seen.
pub struct Scan {
    /// Its points, in a frame whose origin is the viewpoint.
    pub grid: PointGrid,
    /// The viewpoint in the frame of the file, whose axes are the same: its origin, unless the points tell that
    /// they were moved after they had been scanned.
    pub viewpoint: Point3<f64>,
}

/// An organised scan from a file; `-` is standard input.
pub fn read_scan(path: &Path) -> Result<Scan> {
    let name = path.display();
    let bytes = if path == Path::new("-") {
        let mut bytes = Vec::new();
        std::io::stdin().read_to_end(&mut bytes).map(|_| bytes)
    } else {
        std::fs::read(path)
    };
    let bytes = bytes.with_context(|| format!("cannot read {name}"))?;
    let cloud = read_pcd(&bytes).with_context(|| format!("{name} is not a usable scan"))?;
    let grid = cloud.into_grid().with_context(|| format!("{name} is not a usable scan"))?;
    let Some(viewpoint) = viewpoint(&grid) else {
        return Ok(Scan { grid, viewpoint: Point3::origin() });
    };
    let Point3 { coords: v } = viewpoint;
    say::warn(format_args!(
        "{name} was scanned from ({:.3}, {:.3}, {:.3}) m of its frame, not from its origin: taken as seen from there",
        v.x, v.y, v.z
    ));
    Ok(Scan { grid: grid.seen_from(&viewpoint), viewpoint })
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
