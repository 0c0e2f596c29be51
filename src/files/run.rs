//! Run folders read back.

use crate::export::coverage::Evidence;
use crate::export::evaluate::{Patch, RunFiles};
use crate::export::report::Report;
use crate::export::run_folder::ground_heights;
use crate::export::tum;
use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use std::io;
use std::path::{Path, PathBuf};

/// Why a run folder could not be read.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A file that must be there could not be read.
    #[error("cannot read {}: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A file is not what it should be.
    #[error("{}: {reason}", .path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
}

/// Reads a run folder. Report and trajectory must be there; truth, map, surfaces and keyframes may be
/// missing.
///
/// # Errors
///
/// When a file is missing that must not be, or one is not what it should be.
pub fn load(folder: &Path) -> Result<RunFiles, RunError> {
    let report = parsed(folder, "report.json", report)?;
    let poses = |text: &str| tum::parse(text).map_err(|error| error.to_string());
    Ok(RunFiles {
        report: report.ok_or_else(|| missing(folder, "report.json"))?,
        trajectory: parsed(folder, "trajectory.tum", poses)?
            .ok_or_else(|| missing(folder, "trajectory.tum"))?,
        truth: parsed(folder, "truth.tum", poses)?.unwrap_or_default(),
        evidence: evidence(folder)?,
        patches: parsed(folder, "surfaces.json", patches)?.unwrap_or_default(),
        keyframes: parsed(folder, "keyframes.json", |text| {
            serde_json::from_str(text).map_err(|error| error.to_string())
        })?
        .unwrap_or_default(),
    })
}

/// The report of a mission, or what there is of one in that of `usar map`.
fn report(text: &str) -> Result<Report, String> {
    #[derive(Deserialize)]
    struct OfMap {
        scans: Vec<ScanOfMap>,
        landmarks: usize,
        associations: usize,
    }
    #[derive(Deserialize)]
    struct ScanOfMap {
        time_s: f64,
    }
    let is_of_map = serde_json::from_str::<serde_json::Value>(text)
        .is_ok_and(|value| value.get("scenario").is_none() && value.get("scans").is_some());
    if !is_of_map {
        return serde_json::from_str(text).map_err(|error| {
            format!("neither the report of a mission nor that of `usar map`: {error}")
        });
    }
    let of_map: OfMap = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let times = || of_map.scans.iter().map(|scan| scan.time_s);
    Ok(Report {
        scenario: Report::MAPPED.into(),
        outcome: format!("{} scans", of_map.scans.len()),
        mission_time_s: times().next_back().unwrap_or(0.0) - times().next().unwrap_or(0.0),
        landmarks: of_map.landmarks,
        associations: of_map.associations,
        ..Report::default()
    })
}

fn missing(folder: &Path, name: &str) -> RunError {
    let source = io::Error::new(io::ErrorKind::NotFound, "no such file: not a run folder");
    RunError::Read { path: folder.join(name), source }
}

fn bytes(folder: &Path, name: &str) -> Result<Option<Vec<u8>>, RunError> {
    let path = folder.join(name);
    match std::fs::read(&path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(RunError::Read { path, source }),
    }
}

fn parsed<T>(
    folder: &Path,
    name: &str,
    parse: impl FnOnce(&str) -> Result<T, String>,
) -> Result<Option<T>, RunError> {
    let Some(bytes) = bytes(folder, name)? else { return Ok(None) };
    let fail = |reason| RunError::Content { path: folder.join(name), reason };
    let text = String::from_utf8(bytes).map_err(|error| fail(error.to_string()))?;
    parse(&text).map(Some).map_err(fail)
}

/// The parts of `surfaces.json` that are scored.
#[derive(Deserialize)]
struct Surfaces {
    surfaces: Vec<Surface>,
}

#[derive(Deserialize)]
struct Surface {
    kind: String,
    normal: Option<Vector3<f64>>,
    centroid: Option<Point3<f64>>,
    #[serde(default)]
    hull: Vec<Point3<f64>>,
}

fn patches(text: &str) -> Result<Vec<Patch>, String> {
    let surfaces: Surfaces = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let patch = |surface: Surface| {
        let (Some(normal), Some(centroid)) = (surface.normal, surface.centroid) else {
            return None;
        };
        let finite = normal.norm() > 0.5 && centroid.coords.norm().is_finite();
        (surface.kind == "plane" && finite).then(|| Patch {
            normal: normal.normalize(),
            centroid,
            hull: surface.hull,
        })
    };
    Ok(surfaces.surfaces.into_iter().filter_map(patch).collect())
}

/// What coverage counts by: `map.yaml`, `map.pgm` and `ground.png` together.
fn evidence(folder: &Path) -> Result<Option<Evidence>, RunError> {
    let (Some(pgm), Some(png)) = (bytes(folder, "map.pgm")?, bytes(folder, "ground.png")?) else {
        return Ok(None);
    };
    let Some((cell_m, origin_m)) = parsed(folder, "map.yaml", lattice)? else { return Ok(None) };
    let fail = |name: &str, reason: String| RunError::Content { path: folder.join(name), reason };
    let (width, height, grey) =
        pgm_image(&pgm).ok_or_else(|| fail("map.pgm", "not a binary PGM of 8 bits".into()))?;
    let (ground_width, mut ground_m) =
        ground_heights(&png).map_err(|reason| fail("ground.png", reason))?;
    if (ground_width, ground_m.len()) != (width, width * height) {
        return Err(fail(
            "ground.png",
            format!(
                "{} pixels {ground_width} wide, map.pgm has {width} × {height}",
                ground_m.len()
            ),
        ));
    }
    // Pictures begin at the greatest y, the lattice at the least.
    let mut known: Vec<bool> = Vec::with_capacity(grey.len());
    for row in grey.chunks(width.max(1)).rev() {
        known.extend(row.iter().map(|value| *value != UNKNOWN));
    }
    ground_m = ground_m.chunks(width.max(1)).rev().flatten().copied().collect();
    Ok(Some(Evidence { cell_m, origin_m, width, known, ground_m }))
}

/// The grey that `map.pgm` gives cells that were never seen.
const UNKNOWN: u8 = 205;

fn lattice(yaml: &str) -> Result<(f64, [f64; 2]), String> {
    let value = |key: &str| {
        yaml.lines()
            .find_map(|line| line.strip_prefix(key)?.trim_start().strip_prefix(':'))
            .ok_or_else(|| format!("no `{key}`"))
    };
    let resolution = value("resolution")?.trim();
    let cell_m: f64 = resolution
        .parse()
        .ok()
        .filter(|cell: &f64| *cell > 0.0 && cell.is_finite())
        .ok_or_else(|| format!("resolution `{resolution}`, expected metres above 0"))?;
    let origin = value("origin")?.trim();
    let numbers: Vec<f64> = origin
        .trim_matches(['[', ']'])
        .split(',')
        .filter_map(|word| word.trim().parse().ok())
        .collect();
    match numbers.as_slice() {
        [x, y, ..] => Ok((cell_m, [*x, *y])),
        _ => Err(format!("origin `{origin}`, expected [x, y, yaw]")),
    }
}

/// Width, height and pixels of a binary PGM with a maximum of 255.
fn pgm_image(bytes: &[u8]) -> Option<(usize, usize, &[u8])> {
    let mut rest = bytes.strip_prefix(b"P5")?;
    let mut numbers = [0_usize; 3];
    for number in &mut numbers {
        rest = rest.trim_ascii_start();
        let digits = rest.iter().take_while(|octet| octet.is_ascii_digit()).count();
        *number = std::str::from_utf8(&rest[..digits]).ok()?.parse().ok()?;
        rest = &rest[digits..];
    }
    let [width, height, most] = numbers;
    let pixels = rest.get(1..)?;
    (most == 255 && width.checked_mul(height) == Some(pixels.len()))
        .then_some((width, height, pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_server_pair_is_read_as_it_was_written() {
        use crate::export::map_server::{Cell, TrinaryMap};
        let map = TrinaryMap {
            width: 3,
            height: 2,
            resolution_m: 0.05,
            origin_m: [-1.0, 2.0],
            cells: vec![Cell::Free; 6],
        };
        assert_eq!(lattice(&map.yaml("map.pgm")), Ok((0.05, [-1.0, 2.0])));
        let bytes = map.pgm();
        let (width, height, pixels) = pgm_image(&bytes).unwrap();
        assert_eq!((width, height, pixels.len()), (3, 2, 6));
        assert!(pixels.iter().all(|grey| *grey != UNKNOWN));
        assert_eq!(pgm_image(&bytes[..bytes.len() - 1]), None);
    }

    #[test]
    fn a_folder_without_a_report_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = load(folder.path()).unwrap_err().to_string();
        assert!(error.contains("report.json") && error.contains("not a run folder"), "{error}");
    }

    #[test]
    fn surfaces_that_are_no_planes_are_passed_over() {
        let text = r#"{"surfaces": [
            {"kind": "sphere", "centre": [0, 0, 0], "radius_m": 1},
            {"kind": "plane", "normal": [0, 0, 2], "centroid": [1, 2, 3], "hull": [[0, 0, 3]]}
        ]}"#;
        let found = patches(text).unwrap();
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].normal.z, found[0].hull.len()), (1.0, 1));
    }
}
