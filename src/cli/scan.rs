//! `usar scan`: recorded triples put together to organised scans, as the paper's real robot takes them.

use super::files::{Format, write_stdout};
use super::session::{self, Session};
use crate::acquisition::{
    CONTINUOUS_CYCLE_S, HEADING, RecordedTriples, TiltMount, Triple, scan_by_request,
};
use crate::driver::triples::triples_of;
use crate::files::pcd::{Encoding, write_pcd};
use crate::files::replace::replace_file;
use crate::scan::RangeImage;
use crate::time::Span;
use anyhow::{Context, Result, bail};
use clap::Args;
use nalgebra::{Isometry3, Vector3};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Arguments of `usar scan`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  usar scan run/ --triples triples.txt\n  \
                  usar scan triples.txt -o scan.pcd && usar segment scan.pcd --columns 25..156")]
pub struct ScanArguments {
    /// Triples of odometry, tilt and laser (`usar triples 1`, see src/guide/triples.md), or a session,
    /// run folder or text that a client printed, from which they are made; - is standard input
    record: PathBuf,
    /// Which of the sweeps found, from 1 [default: the one with most rows]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    sweep: Option<u32>,
    /// Seconds between requests; 0 keeps every line. The default is the paper's: 70 rows of 55°
    #[arg(long, value_name = "S", default_value_t = CONTINUOUS_CYCLE_S, value_parser = seconds)]
    cycle: f64,
    /// Most rows of a scan
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    rows: Option<u32>,
    /// Seconds by which tilts are later than their lines, negative for earlier: what a desynchronised
    /// server does to a scan
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true, value_parser = any_seconds)]
    tilt_late: f64,
    /// The same of the robot's poses
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true, value_parser = any_seconds)]
    pose_late: f64,
    /// Seconds from a line's stamp to the casting of its rays, in a session [default: as its
    /// calibration found, else 0]
    #[arg(long, value_name = "S", value_parser = seconds)]
    line_lag: Option<f64>,
    /// Class of the robot in captured text [default: the configuration's, USARBot.P3AT]
    #[arg(long, value_name = "CLASS")]
    class: Option<String>,
    /// Where the laser sits, for triples that do not tell: tilt axis in the robot's frame, then laser
    /// from the axis, metres, x forward, y left, z up
    #[arg(long, value_name = "X,Y,Z,X,Y,Z", allow_hyphen_values = true, value_parser = mount)]
    mount: Option<TiltMount>,
    /// The scan: PCD, organised, rows from the highest tilt down
    #[arg(short, long, value_name = "SCAN.pcd", help_heading = "Output")]
    output: Option<PathBuf>,
    /// The triples as text
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    triples: Option<PathBuf>,
    /// Form of the list of sweeps on standard output
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

fn any_seconds(text: &str) -> Result<f64, String> {
    let found = text.parse::<f64>().ok().filter(|seconds| seconds.is_finite());
    found.ok_or_else(|| "expected a number of seconds".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let found = any_seconds(text).ok().filter(|&seconds| seconds >= 0.0);
    found.ok_or_else(|| "expected a number of seconds, 0 or more".to_owned())
}

fn mount(text: &str) -> Result<TiltMount, String> {
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|word| word.trim().parse::<f64>().ok().filter(|number| number.is_finite()))
        .collect();
    let [x, y, z, lx, ly, lz] = numbers
        .and_then(|all| <[f64; 6]>::try_from(all).ok())
        .ok_or_else(|| "expected six numbers with commas between them".to_owned())?;
    Ok(TiltMount {
        robot_from_axis: Isometry3::new(Vector3::new(x, y, z), Vector3::zeros()),
        axis_from_laser: Isometry3::new(Vector3::new(lx, ly, lz), Vector3::zeros()),
    })
}

/// One scan, and where it came from.
struct Swept {
    image: RangeImage,
    facts: Value,
}

/// Runs the verb.
///
/// # Errors
///
/// A record that cannot be read or holds no sweep, an output that cannot be written.
pub fn run(arguments: &ScanArguments) -> Result<ExitCode> {
    let mut record = read(arguments)?;
    if let Some(mount) = &arguments.mount {
        record = record.on(mount.clone());
    }
    if let Some(path) = &arguments.triples {
        replace_file(path, record.to_text().as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let name = arguments.record.display();
    record.remarks().iter().for_each(|remark| eprintln!("warning: {name}: {remark}"));
    let mount = record.mount().with_context(|| {
        format!("{name} does not tell where the laser sits: a `mount` line in it or --mount does")
    })?;
    let swept: Vec<Swept> = record
        .sweeps()
        .into_iter()
        .enumerate()
        .filter_map(|(at, range)| scan_of(at, &record.triples()[range], mount, arguments))
        .collect();
    if swept.is_empty() {
        bail!("{name}: no sweep in {} triples: the tilt never swings", record.triples().len());
    }
    let most_rows = || {
        let rows = |at: &usize| (swept[*at].image.rows().len(), std::cmp::Reverse(*at));
        (0..swept.len()).max_by_key(rows)
    };
    let chosen = match arguments.sweep {
        Some(number) if number as usize <= swept.len() => Some(number as usize - 1),
        Some(number) => bail!("--sweep {number} asked for, {} sweeps found in {name}", swept.len()),
        None => most_rows(),
    };
    if let (Some(path), Some(chosen)) = (&arguments.output, chosen) {
        let image = &swept[chosen].image;
        let bytes = write_pcd(&image.point_grid(0..image.columns()), Encoding::Binary);
        replace_file(path, &bytes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    let written = arguments.output.as_ref().and(chosen).map(|at| at + 1);
    let sweeps: Vec<&Value> = swept.iter().map(|swept| &swept.facts).collect();
    write_stdout(&match arguments.format {
        Format::Json => {
            let triples = record.triples().len();
            json!({ "triples": triples, "sweeps": sweeps, "written": written }).to_string() + "\n"
        }
        Format::Text => table(&sweeps, written, arguments.output.as_deref()),
    })?;
    Ok(ExitCode::SUCCESS)
}

/// The record: as it stands in a file, or made from a session.
fn read(arguments: &ScanArguments) -> Result<RecordedTriples> {
    let (bytes, path) = session::read_session(&arguments.record)?;
    if bytes.starts_with(HEADING.as_bytes()) {
        let text = std::str::from_utf8(&bytes)
            .with_context(|| format!("{} is not text", path.display()))?;
        return RecordedTriples::parse(text).with_context(|| path.display().to_string());
    }
    let Session { recording, agent, .. } =
        session::of_bytes(&bytes, &path, arguments.class.as_deref(), false, &[])?;
    if let Some(loss) = &recording.loss {
        eprintln!("warning: the recording is not whole: {loss}");
    }
    let line_lag = arguments.line_lag.map(Span::from_seconds);
    let found =
        triples_of(agent, &recording, line_lag).with_context(|| format!("{}", path.display()))?;
    let triples = found.record.triples().len();
    if triples == 0 {
        bail!(
            "{}: {} laser lines and no two readings of the tilt around any of them",
            path.display(),
            found.without_tilt
        );
    }
    eprintln!(
        "{triples} triples; {} lines left out for want of a tilt reading, {} triples without odometry \
         on either side",
        found.without_tilt, found.without_pose
    );
    Ok(found.record)
}

/// The scan of one sweep, by requests from its first triple on.
fn scan_of(
    at: usize,
    triples: &[Triple],
    mount: &TiltMount,
    arguments: &ScanArguments,
) -> Option<Swept> {
    let (first, last) = (triples.first()?, triples.last()?);
    let mut source = RecordedTriples::new(triples.to_vec()).desynchronised(
        Span::from_seconds(arguments.tilt_late),
        Span::from_seconds(arguments.pose_late),
    );
    let rows = arguments.rows.map_or(usize::MAX, |rows| rows as usize);
    let cycle = Span::from_seconds(arguments.cycle);
    let image = scan_by_request(&mut source, (first.stamp, cycle, rows), mount)?;
    let seconds = (last.stamp - first.stamp).seconds();
    let moved = first.frame_from_robot.inverse() * last.frame_from_robot;
    let facts = json!({
        "sweep": at + 1,
        "from_s": first.stamp.seconds(),
        "to_s": last.stamp.seconds(),
        "lines": triples.len(),
        "rows": image.rows().len(),
        "columns": image.columns(),
        "tilt_from_deg": first.tilt_rad.to_degrees(),
        "tilt_to_deg": last.tilt_rad.to_degrees(),
        "rate_rad_s": (last.tilt_rad - first.tilt_rad) / seconds,
        "driven_m": moved.translation.vector.norm(),
    });
    Some(Swept { image, facts })
}

fn table(sweeps: &[&Value], written: Option<usize>, output: Option<&Path>) -> String {
    let mut text = "sweep |   from s |     to s | lines | rows × columns | tilt °            | \
                    rad/s  | driven m\n"
        .to_owned();
    for sweep in sweeps {
        let number = |key: &str| sweep[key].as_f64().unwrap_or(f64::NAN);
        let _ = writeln!(
            text,
            "{:>5} | {:>8.2} | {:>8.2} | {:>5} | {:>4} × {:<7} | {:>7.2} … {:>7.2} | \
             {:>6.3} | {:>8.2}",
            number("sweep"),
            number("from_s"),
            number("to_s"),
            number("lines"),
            number("rows"),
            number("columns"),
            number("tilt_from_deg"),
            number("tilt_to_deg"),
            number("rate_rad_s").abs(),
            number("driven_m"),
        );
    }
    if let (Some(number), Some(path)) = (written, output) {
        let _ = writeln!(text, "sweep {number} written to {}", path.display());
    }
    text
}
