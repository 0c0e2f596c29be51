//! `usar segment`: one organised scan through segmentation and fitting.

use super::files::{Format, Scan, parse_columns, read_scan, write_stdout};
use crate::export::segment_images::write_stage_images;
use crate::files::replace::replace_file;
use crate::scan::PointGrid;
use crate::segmentation::{
    Method, ReadingErrors, Segmentation, SegmentationConfig, Segmenter, Shape, Stage, Surface,
};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::ops::Range;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Arguments of `usar segment`.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  usar segment scan.pcd --columns 25..156 --labels labels.png \
                        --surfaces surfaces.json --images pictures/")]
pub struct SegmentArguments {
    /// Organised scan: PCD 0.7 with HEIGHT > 1, points in the sensor's frame, NaN for no return;
    /// `-` reads standard input
    scan: PathBuf,
    /// Columns to use, 0-based and half-open
    #[arg(long, value_name = "A..B", value_parser = parse_columns)]
    columns: Option<Range<usize>>,
    /// Structure that finds the regions
    #[arg(long, value_enum, default_value_t)]
    method: MethodArgument,
    /// Leave out the check of the regions by their normals (the paper's chain)
    #[arg(long)]
    without_normal_check: bool,
    /// Fewest points of a surface
    #[arg(long, value_name = "N")]
    min_points: Option<usize>,
    /// Label image to write: 16-bit PNG of the scan's size, 0 for none
    #[arg(long, value_name = "OUT.png", help_heading = "Output")]
    labels: Option<PathBuf>,
    /// Surfaces to write as JSON
    #[arg(long, value_name = "OUT.json", help_heading = "Output")]
    surfaces: Option<PathBuf>,
    /// Folder for pictures of the stages and a coloured overview
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    images: Option<PathBuf>,
    /// Warm runs; times are their medians
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Form of the summary on standard output
    #[arg(long, value_enum, default_value_t, help_heading = "Output")]
    format: Format,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum MethodArgument {
    /// Sticks grown to regions
    #[default]
    Sticks,
    /// The paper's chain
    Paper,
}

/// Runs the verb.
///
/// # Errors
///
/// An unreadable, invalid or unorganised scan, columns that it has not, an output that cannot be
/// written.
pub fn run(arguments: &SegmentArguments) -> Result<ExitCode> {
    let Scan { grid: whole, viewpoint } = read_scan(&arguments.scan)?;
    let columns = arguments.columns.clone().unwrap_or(0..whole.columns());
    if columns.end > whole.columns() {
        bail!(
            "{}: --columns {}..{} asked for, {} columns found",
            arguments.scan.display(),
            columns.start,
            columns.end,
            whole.columns()
        );
    }
    let grid = whole.columns_only(columns.clone());
    let method = match arguments.method {
        MethodArgument::Sticks => Method::Sticks,
        MethodArgument::Paper => Method::Paper,
    };
    let mut config = SegmentationConfig { method, ..SegmentationConfig::default() };
    config.paper.split_by_normals = !arguments.without_normal_check;
    if let Some(min_points) = arguments.min_points {
        config.min_points = min_points;
    }
    let mut segmenter = Segmenter::new(config);
    let times = time_runs(&mut segmenter, &grid, arguments.repeat);
    let seen = segmenter.result();
    let surfaces = seen.surfaces.iter().map(|surface| surface.translated(&viewpoint.coords));
    let segmentation = &Segmentation { surfaces: surfaces.collect(), ..seen.clone() };

    let mut document = document(segmentation, &segmenter.errors(), &whole, &times);
    document["viewpoint"] = json!(viewpoint);
    if let Some(path) = &arguments.labels {
        let png = labels_png(segmentation, &whole, &columns)?;
        replace_file(path, &png).with_context(|| format!("cannot write {}", path.display()))?;
    }
    if let Some(path) = &arguments.surfaces {
        let text = serde_json::to_string_pretty(&document)?;
        replace_file(path, text.as_bytes())
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let text = match arguments.format {
        Format::Text => summary(segmentation, &times),
        Format::Json => serde_json::to_string(&document)? + "\n",
    };
    if let Some(folder) = &arguments.images {
        write_stage_images(folder, &segmenter, &grid)
            .with_context(|| format!("cannot write pictures to {}", folder.display()))?;
    }
    write_stdout(&text)?;
    Ok(ExitCode::SUCCESS)
}

/// Median times in milliseconds, by stage, and their total.
struct Times {
    stages: [(&'static str, f64); 6],
    total: f64,
}

const STAGES: [(Stage, &str); 6] = [
    (Stage::Residual, "residual"),
    (Stage::Morphology, "morphology"),
    (Stage::Fill, "fill"),
    (Stage::Split, "split"),
    (Stage::Fit, "fit"),
    (Stage::Hull, "hull"),
];

#[expect(clippy::disallowed_methods, reason = "the verb measures wall time; the core has no clock")]
fn time_runs(segmenter: &mut Segmenter, grid: &PointGrid, repeat: u32) -> Times {
    // The first run grows the buffers.
    segmenter.segment(grid);
    let mut stages: [Vec<f64>; 6] = Default::default();
    let mut totals = Vec::new();
    for _ in 0..repeat {
        let mut spent = [0.0; 6];
        let start = Instant::now();
        let mut last = start;
        segmenter.segment_observed(grid, &mut |stage| {
            let now = Instant::now();
            if let Some(i) = STAGES.iter().position(|(s, _)| *s == stage) {
                spent[i] += (now - last).as_secs_f64() * 1e3;
            }
            last = now;
        });
        totals.push(start.elapsed().as_secs_f64() * 1e3);
        for (all, spent) in stages.iter_mut().zip(spent) {
            all.push(spent);
        }
    }
    let stages = std::array::from_fn(|i| (STAGES[i].1, median(&mut stages[i])));
    Times { stages, total: median(&mut totals) }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn kind(surface: &Surface) -> &'static str {
    match surface.shape {
        Shape::Plane(_) => "plane",
        Shape::Sphere(_) => "sphere",
        Shape::Cylinder(_) => "cylinder",
        Shape::Other => "other",
    }
}

/// The content of `surfaces.json`.
fn document(
    segmentation: &Segmentation,
    errors: &ReadingErrors,
    whole: &PointGrid,
    times: &Times,
) -> Value {
    let rejected: Vec<Value> = segmentation
        .rejected
        .iter()
        .map(|r| json!({ "points": r.points, "reason": r.reason }))
        .collect();
    let mut timing = serde_json::Map::new();
    for (name, ms) in times.stages {
        timing.insert(name.to_owned(), json!(ms));
    }
    timing.insert("total".to_owned(), json!(times.total));
    json!({
        "rows": whole.rows(),
        "columns": whole.columns(),
        "surfaces": segmentation.surfaces.iter().map(surface_json).collect::<Vec<_>>(),
        "rejected": rejected,
        "reading_errors": errors,
        "timing_ms": timing,
    })
}

fn rows<const N: usize>(matrix: &nalgebra::SMatrix<f64, N, N>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn surface_json(surface: &Surface) -> Value {
    let mut value = json!({
        "id": surface.id,
        "kind": kind(surface),
        "points": surface.points,
        "rms_m": surface.rms_m,
        "centroid": surface.centroid,
    });
    let more = match &surface.shape {
        Shape::Plane(patch) => {
            let plane = patch.plane();
            json!({
                "normal": plane.normal,
                "offset_m": plane.offset_m,
                "hull": patch.hull_points().collect::<Vec<_>>(),
                "area_m2": patch.area_m2(),
                "covariance": rows(&patch.covariance),
            })
        }
        Shape::Sphere(sphere) => json!({
            "centre": sphere.centre,
            "radius_m": sphere.radius_m,
            "covariance": rows(&sphere.covariance),
        }),
        Shape::Cylinder(cylinder) => json!({
            "axis_point": cylinder.axis_point,
            "axis": cylinder.axis.into_inner(),
            "radius_m": cylinder.radius_m,
            "length_m": cylinder.length_m,
            "covariance": rows(&cylinder.covariance),
        }),
        Shape::Other => json!({
            "reason": "no plane, sphere or cylinder within the limits describes its points",
        }),
    };
    if let (Value::Object(all), Value::Object(more)) = (&mut value, more) {
        all.extend(more);
    }
    value
}

/// The label image of the whole scan: columns that were not used have no labels.
fn labels_png(
    segmentation: &Segmentation,
    whole: &PointGrid,
    columns: &Range<usize>,
) -> Result<Vec<u8>> {
    let mut samples = Vec::with_capacity(2 * whole.rows() * whole.columns());
    for row in 0..whole.rows() {
        for column in 0..whole.columns() {
            let label = if columns.contains(&column) {
                segmentation.labels[row * segmentation.columns + column - columns.start]
            } else {
                0
            };
            samples.extend_from_slice(&label.to_be_bytes());
        }
    }
    let (width, height) = (u32::try_from(whole.columns())?, u32::try_from(whole.rows())?);
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&samples)?;
    writer.finish()?;
    Ok(bytes)
}

fn summary(segmentation: &Segmentation, times: &Times) -> String {
    let mut text = format!("{:>4}  {:<8} {:>7} {:>8}  where\n", "id", "kind", "points", "rms mm");
    for surface in &segmentation.surfaces {
        let c = surface.centroid;
        let _ = writeln!(
            text,
            "{:>4}  {:<8} {:>7} {:>8.1}  ({:.2}, {:.2}, {:.2}) m{}",
            surface.id,
            kind(surface),
            surface.points,
            1e3 * surface.rms_m,
            c.x,
            c.y,
            c.z,
            size(surface)
        );
    }
    for rejected in &segmentation.rejected {
        let _ =
            writeln!(text, "   -  rejected {:>7}           {}", rejected.points, rejected.reason);
    }
    for (name, ms) in times.stages {
        let _ = write!(text, "{name} {ms:.3} ms, ");
    }
    let _ = writeln!(text, "total {:.3} ms", times.total);
    text
}

fn size(surface: &Surface) -> String {
    match &surface.shape {
        Shape::Plane(patch) => format!(", {:.2} m²", patch.area_m2()),
        Shape::Sphere(sphere) => format!(", radius {:.3} m", sphere.radius_m),
        Shape::Cylinder(c) => format!(", radius {:.3} m, length {:.2} m", c.radius_m, c.length_m),
        Shape::Other => String::new(),
    }
}
