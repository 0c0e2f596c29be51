//! `usar map`: organised scans through segmentation, localisation and mapping.

mod grid;

use super::files::{Format, Scan, median, read_scan, write_stdout};
use super::say;
use super::series::{Series, is_session};
use super::session::DONE_WITH_LOSS;
use crate::exploration::Walls;
use crate::export::keyframes::keyframes_at;
use crate::export::landmarks::{rows, surface_polygons, surfaces_json};
use crate::export::ply;
use crate::export::run_folder::trinary_map;
use crate::export::tum::{self, TimedPose};
use crate::files::replace::replace_file;
use crate::mapping::{
    Mapper, MapperConfig, Mode, MotionSource, RefusalReason, ScanErrors, ScanObservations,
    UpdateReport, WeakDirection, curved_observations, observations, unmeasured_motion,
};
use crate::scan::{PointGrid, RangeImage};
use crate::segmentation::{SegmentationConfig, Segmenter};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use nalgebra::{Isometry3, Point3};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Arguments of `usar map`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  usar map scan_*.pcd --odometry odometry.tum --out run/\n  \
                  usar map run/ --mode mip --out mip/")]
pub struct MapArguments {
    /// Organised scans in order: PCD 0.7 with HEIGHT > 1, points in the sensor's frame. Or one session, whose scans
    /// and way are taken, or run folder, whose truth is taken, too
    #[arg(required = true)]
    scans: Vec<PathBuf>,
    /// Odometry poses of the sensor, one TUM line a scan; without it each scan is sought within about a
    /// metre and 30° of the one before
    #[arg(long, value_name = "FILE")]
    odometry: Option<PathBuf>,
    /// True poses of the sensor, one TUM line a scan: for scoring only
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Columns to use, 0-based and half-open
    #[arg(long, value_name = "A..B", value_parser = super::files::parse_columns)]
    columns: Option<Range<usize>>,
    /// Which filter runs
    #[arg(long, value_enum, default_value_t)]
    mode: ModeArgument,
    /// Folder for trajectory.tum, planes.ply, surfaces.json, keyframes.json, report.json and the
    /// grid: map.pgm, map.yaml, map.png, places.json; `usar eval` scores it
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    out: Option<PathBuf>,
    /// Form of the summary on standard output
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum ModeArgument {
    /// Landmarks with covariance, loops, several explanations
    #[default]
    Full,
    /// The paper's Maximum Incremental Probability filter
    Mip,
}

/// What one scan came to.
struct Step {
    time_s: f64,
    planes: usize,
    /// Where the scan was made, in its own frame.
    viewpoint: Point3<f64>,
    report: UpdateReport,
    segment_ms: f64,
    map_ms: f64,
}

/// Runs the verb.
///
/// # Errors
///
/// A scan or pose file that cannot be used, files of different lengths, an output that cannot be
/// written.
pub fn run(arguments: &MapArguments) -> Result<ExitCode> {
    say::log("warn");
    if let Some(folder) =
        arguments.out.as_deref().filter(|folder| folder.join("session.usar").exists())
    {
        bail!("{} holds a recording: its map stays, give another folder", folder.display());
    }
    let Input { scans, odometry, truth, loss } = Input::of(arguments)?;
    let mode = match arguments.mode {
        ModeArgument::Full => Mode::Full,
        ModeArgument::Mip => Mode::Mip,
    };
    let config = MapperConfig { mode, ..MapperConfig::default() };
    let start = odometry.as_ref().map_or_else(Isometry3::identity, |poses| poses[0].pose);
    let mut mapper = Mapper::new(config, start);
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let mut steps = Vec::new();
    let mut images = Vec::new();
    for (k, source) in scans.into_iter().enumerate() {
        let name = source.name(k);
        let Scan { grid: whole, viewpoint } = source.read()?;
        let robot_from_scan = Isometry3::from(viewpoint.coords);
        let grid = match &arguments.columns {
            Some(columns) if columns.end > whole.columns() => bail!(
                "{name}: --columns {}..{} asked for, {} columns found",
                columns.start,
                columns.end,
                whole.columns()
            ),
            Some(columns) => whole.columns_only(columns.clone()),
            None => whole,
        };
        if arguments.out.is_some() {
            images.push((RangeImage::of_points(&grid), robot_from_scan));
        }
        if k > 0 {
            match &odometry {
                Some(poses) => {
                    let increment = poses[k - 1].pose.inverse() * poses[k].pose;
                    mapper.predict(&increment, MotionSource::Wheels);
                }
                None => mapper.predict_with(&Isometry3::identity(), &unmeasured_motion()),
            }
        }
        let clock = Stopwatch::start();
        let segmentation = segmenter.segment(&grid);
        let segment_ms = clock.milliseconds();
        let clock = Stopwatch::start();
        let scan = ScanObservations {
            observations: observations(segmentation, &grid, &robot_from_scan),
            curves: curved_observations(segmentation, &robot_from_scan),
            robot_from_scan,
            errors: ScanErrors::default(),
            contacts: Vec::new(),
        };
        let report = mapper.observe(&scan);
        let map_ms = clock.milliseconds();
        let time_s = odometry.as_ref().map_or(k as f64, |poses| poses[k].time_s);
        let planes = scan.observations.len();
        steps.push(Step { time_s, planes, viewpoint, report, segment_ms, map_ms });
    }
    let blank = steps.iter().filter(|step| step.planes == 0).count();
    if blank > 0 {
        say::warn(format_args!("{blank} of {} scans show no plane", steps.len()));
    }
    let score = truth.as_ref().map(|truth| Score::new(&mapper, truth));
    let document = document(&mapper, &steps, score.as_ref());
    if let Some(folder) = &arguments.out {
        write_outputs(folder, &mapper, &steps, truth.as_deref(), &document)?;
        write_grid(folder, &mapper, &images)?;
    }
    write_stdout(&match arguments.format {
        Format::Text => summary(&mapper, &steps, score.as_ref()),
        Format::Json => serde_json::to_string(&document)? + "\n",
    })?;
    Ok(if loss { ExitCode::from(DONE_WITH_LOSS) } else { ExitCode::SUCCESS })
}

/// What is to be mapped.
struct Input {
    scans: Vec<Source>,
    /// Poses of the sensor, one a scan.
    odometry: Option<Vec<TimedPose>>,
    truth: Option<Vec<TimedPose>>,
    /// Whether the session that it comes from is not whole.
    loss: bool,
}

/// Where a scan comes from.
enum Source {
    File(PathBuf),
    /// The session had it.
    Session(PointGrid),
}

impl Input {
    fn of(arguments: &MapArguments) -> Result<Self> {
        let mut input = match arguments.scans.as_slice() {
            [path] if is_session(path) => {
                let Series { scans, way, truth, loss, .. } = Series::read(path)?;
                let scans = scans.into_iter().map(Source::Session).collect();
                Self { scans, odometry: Some(way), truth, loss }
            }
            paths => {
                if let Some(path) = paths.iter().find(|path| is_session(path)) {
                    bail!("{} is a session: it is mapped alone", path.display());
                }
                let scans = paths.iter().cloned().map(Source::File).collect();
                Self { scans, odometry: None, truth: None, loss: false }
            }
        };
        let poses = |path: &Path| read_poses(path, input.scans.len());
        let odometry = arguments.odometry.as_deref().map(poses).transpose()?;
        let truth = arguments.truth.as_deref().map(poses).transpose()?;
        input.odometry = odometry.or(input.odometry);
        input.truth = truth.or(input.truth);
        Ok(input)
    }
}

impl Source {
    fn name(&self, k: usize) -> String {
        match self {
            Self::File(path) => path.display().to_string(),
            Self::Session(_) => format!("scan {}", k + 1),
        }
    }

    fn read(self) -> Result<Scan> {
        match self {
            Self::File(path) => read_scan(&path),
            Self::Session(grid) => Ok(Scan { grid, viewpoint: Point3::origin() }),
        }
    }
}

struct Stopwatch(Instant);

impl Stopwatch {
    #[expect(
        clippy::disallowed_methods,
        reason = "the verb measures wall time; the core has no clock"
    )]
    fn start() -> Self {
        Self(Instant::now())
    }

    fn milliseconds(&self) -> f64 {
        self.0.elapsed().as_secs_f64() * 1e3
    }
}

/// Farthest from one scan to the next that is no broken line of a file, in metres.
const FARTHEST_STEP_M: f64 = 1000.0;

fn read_poses(path: &Path, scans: usize) -> Result<Vec<TimedPose>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let poses = tum::parse(&text).with_context(|| format!("{}", path.display()))?;
    if poses.len() != scans {
        bail!("{}: {} poses found, {scans} scans given", path.display(), poses.len());
    }
    if let Some(at) = poses.windows(2).position(|pair| pair[1].time_s < pair[0].time_s) {
        let (before, after) = (poses[at].time_s, poses[at + 1].time_s);
        bail!("{}: pose {} is of {after} s, before that of {before} s", path.display(), at + 2);
    }
    let leap_m = |pair: &[TimedPose]| {
        (pair[1].pose.translation.vector - pair[0].pose.translation.vector).norm()
    };
    if let Some(at) = poses.windows(2).position(|pair| leap_m(pair) > FARTHEST_STEP_M) {
        let leap_m = leap_m(&poses[at..at + 2]);
        bail!(
            "{}: pose {} is {leap_m:.0} m from the one before; scans of one map are at most \
             {FARTHEST_STEP_M} m apart",
            path.display(),
            at + 2
        );
    }
    Ok(poses)
}

/// Errors of the motions between successive scans against the truth.
struct Score {
    translation_m: Vec<f64>,
    rotation_rad: Vec<f64>,
    /// Normalised squared errors of the motions, where the filter states their covariance.
    nees: Vec<f64>,
    final_m: f64,
    final_rad: f64,
}

impl Score {
    fn new(mapper: &Mapper, truth: &[TimedPose]) -> Self {
        let poses = mapper.keyframes();
        let mut score = Self {
            translation_m: Vec::new(),
            rotation_rad: Vec::new(),
            nees: Vec::new(),
            final_m: 0.0,
            final_rad: 0.0,
        };
        for k in 1..poses.len().min(truth.len()) {
            let motion = poses[k - 1].inverse() * poses[k];
            let true_motion = truth[k - 1].pose.inverse() * truth[k].pose;
            let error = crate::mapping::perturbation::pose_error(&motion, &true_motion);
            score.translation_m.push(error.fixed_rows::<3>(0).norm());
            score.rotation_rad.push(error.fixed_rows::<3>(3).norm());
            let nees = mapper
                .step_covariance(k)
                .and_then(nalgebra::Matrix::cholesky)
                .map(|cholesky| error.dot(&cholesky.solve(&error)));
            score.nees.extend(nees);
        }
        if let (Some(pose), Some(last)) = (poses.last(), truth.last()) {
            let travelled = poses[0].inverse() * pose;
            let true_travelled = truth[0].pose.inverse() * last.pose;
            let error = travelled.inverse() * true_travelled;
            score.final_m = error.translation.vector.norm();
            score.final_rad = error.rotation.angle();
        }
        score
    }

    fn json(&self) -> Value {
        json!({
            "rpe_median_m": median(&self.translation_m),
            "rpe_median_deg": median(&self.rotation_rad).to_degrees(),
            "rpe_max_m": self.translation_m.iter().copied().fold(0.0, f64::max),
            "rpe_max_deg": self.rotation_rad.iter().copied().fold(0.0, f64::max).to_degrees(),
            "final_m": self.final_m,
            "final_deg": self.final_rad.to_degrees(),
            "nees_mean": self.mean_nees(),
        })
    }

    /// `None` where no motion has a covariance.
    fn mean_nees(&self) -> Option<f64> {
        let count = self.nees.len();
        (count > 0).then(|| self.nees.iter().sum::<f64>() / count as f64)
    }
}

fn document(mapper: &Mapper, steps: &[Step], score: Option<&Score>) -> Value {
    let scans: Vec<Value> = steps
        .iter()
        .map(|step| {
            let report = &step.report;
            let weak: Vec<&str> = report.weak_directions.iter().map(WeakDirection::word).collect();
            json!({
                "time_s": step.time_s,
                "planes": step.planes,
                "viewpoint": step.viewpoint,
                "associations": report.associations.len() + report.curves_known,
                "added": report.added.len() + report.curves_new,
                "refused": report.refused.len(),
                "nis": report.nis,
                "nis_degrees": report.nis_degrees,
                "weak_directions": weak,
                "hypotheses": report.hypotheses,
                // As told then; what was seen later has moved it on, to where `keyframes.json` has it.
                "pose": report.world_from_robot,
                "covariance": rows(&report.covariance),
                "segment_ms": step.segment_ms,
                "map_ms": step.map_ms,
            })
        })
        .collect();
    json!({
        "scans": scans,
        "landmarks": mapper.surface_count(),
        "associations": steps.iter().map(|step| step.report.associations.len()).sum::<usize>(),
        "segment_ms": median(&steps.iter().map(|step| step.segment_ms).collect::<Vec<_>>()),
        "map_ms": median(&steps.iter().map(|step| step.map_ms).collect::<Vec<_>>()),
        "pose_error": score.map(Score::json),
    })
}

/// The grid that navigation would use, in the formats of a run folder.
fn write_grid(
    folder: &Path,
    mapper: &Mapper,
    images: &[(RangeImage, Isometry3<f64>)],
) -> Result<()> {
    let sensors: Vec<Isometry3<f64>> =
        mapper.keyframes().iter().zip(images).map(|(pose, (_, sensor))| pose * sensor).collect();
    let images: Vec<&RangeImage> = images.iter().map(|(image, _)| image).collect();
    let above_m = grid::sensor_above_floor(mapper.landmarks(), &sensors).unwrap_or_else(|| {
        let supposed_m = grid::SUPPOSED_HEIGHT_M;
        say::warn(format_args!(
            "no floor was seen below the sensor: the grid supposes it {supposed_m} m down"
        ));
        supposed_m
    });
    let (grid, places) = grid::grid(&images, &sensors, above_m, &Walls::of(mapper.landmarks()));
    let map = trinary_map(&grid);
    let title = format!("{} scans", images.len());
    write(folder, "map.pgm", &map.pgm())?;
    write(folder, "map.yaml", map.yaml("map.pgm").as_bytes())?;
    write(folder, "places.json", &serde_json::to_vec_pretty(&places)?)?;
    write(folder, "map.png", &grid::picture(&grid, places, &sensors, title).to_png())
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> Result<()> {
    let path = folder.join(name);
    replace_file(&path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

fn write_outputs(
    folder: &Path,
    mapper: &Mapper,
    steps: &[Step],
    truth: Option<&[TimedPose]>,
    document: &Value,
) -> Result<()> {
    std::fs::create_dir_all(folder)
        .with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let write = |name: &str, bytes: &[u8]| write(folder, name, bytes);
    let trajectory: Vec<TimedPose> = mapper
        .keyframes()
        .into_iter()
        .zip(steps)
        .map(|(pose, step)| TimedPose { time_s: step.time_s, pose })
        .collect();
    write("trajectory.tum", tum::format(&trajectory).as_bytes())?;
    if let Some(truth) = truth {
        // Line k is of scan k, whatever clock its times are of.
        let truth: Vec<TimedPose> = truth
            .iter()
            .zip(steps)
            .map(|(of, step)| TimedPose { time_s: step.time_s, ..*of })
            .collect();
        write("truth.tum", tum::format(&truth).as_bytes())?;
    } else {
        // That of an earlier map is none of this one.
        match std::fs::remove_file(folder.join("truth.tum")) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).context(format!("cannot remove {}/truth.tum", folder.display()));
            }
            _ => {}
        }
    }
    write("planes.ply", ply::format(&surface_polygons(mapper)).as_bytes())?;
    let surfaces = json!({ "surfaces": surfaces_json(mapper) });
    write("surfaces.json", serde_json::to_string_pretty(&surfaces)?.as_bytes())?;
    let keyframes = keyframes_at(mapper, steps.iter().map(|step| Some(step.time_s)));
    write("keyframes.json", &serde_json::to_vec(&keyframes)?)?;
    write("report.json", serde_json::to_string_pretty(document)?.as_bytes())
}

fn summary(mapper: &Mapper, steps: &[Step], score: Option<&Score>) -> String {
    let mut text = format!(
        "{:>4} {:>7} {:>7} {:>6} {:>8} {:>9} {:>11} {:>8}  pose x, y, z (m), heading\n",
        "scan", "planes", "paired", "added", "refused", "NIS/dof", "segment ms", "map ms"
    );
    for (k, step) in steps.iter().enumerate() {
        let report = &step.report;
        let t = report.world_from_robot.translation.vector;
        let heading = report.world_from_robot.rotation.euler_angles().2.to_degrees();
        let _ = write!(
            text,
            "{k:>4} {:>7} {:>7} {:>6} {:>8} {:>9.2} {:>11.2} {:>8.2}  {:.3} {:.3} {:.3} {heading:.2}°",
            step.planes,
            report.associations.len(),
            report.added.len(),
            report.refused.len(),
            report.nis / report.nis_degrees.max(1) as f64,
            step.segment_ms,
            step.map_ms,
            t.x,
            t.y,
            t.z,
        );
        // The first scan is where the map begins.
        for weak in report.weak_directions.iter().filter(|_| k > 0) {
            let _ = write!(text, "; {} open", weak.word());
        }
        for refusal in &report.refused {
            let reason = match refusal.reason {
                RefusalReason::FailedRetest(d) => format!("failed after the update ({d:.1})"),
                RefusalReason::Ambiguous => "ambiguous".to_owned(),
                RefusalReason::Crowded => "one of too many".to_owned(),
                RefusalReason::Doubtful(d) => format!("doubtful ({d:.1})"),
            };
            let _ = write!(text, "; {} {reason}", refusal.observation);
        }
        text.push('\n');
    }
    let _ = writeln!(text, "{} landmarks", mapper.surface_count());
    if let Some(score) = score {
        let nees = score.mean_nees().map_or_else(
            || "no NEES: no covariance of the motions from scan to scan".to_owned(),
            |nees| format!("NEES {nees:.2} (6 expected)"),
        );
        let _ = writeln!(
            text,
            "motion error median {:.2} mm {:.4}°, {nees}; final error {:.2} mm {:.4}°",
            1e3 * median(&score.translation_m),
            median(&score.rotation_rad).to_degrees(),
            1e3 * score.final_m,
            score.final_rad.to_degrees()
        );
    }
    text
}
