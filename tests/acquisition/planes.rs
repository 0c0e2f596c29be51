//! What errors of acquisition do to the planes of a scan.

use super::bench::{Bench, Setting};
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use usar_agent::acquisition::{AcquisitionConfig, SweepRequest};
use usar_agent::protocol::Dialect;
use usar_agent::robot::HeadPose;
use usar_agent::scan::{LaserLine, PointGrid, RangeImage, Return};
use usar_agent::segmentation::{SegmentationConfig, Segmenter, Shape};

/// How far the planes of a scan are off, against the same pixels where they truly were: root mean
/// squares over the planes, weighted by their points.
#[derive(Clone, Copy, Debug)]
pub struct PlaneErrors {
    pub planes: usize,
    pub offset_m: f64,
    pub tilt_rad: f64,
}

/// Planes of fewer points tilt by range noise alone.
const FEWEST_POINTS: usize = 150;

/// Segments `taken` and holds each of its planes against the same pixels in `truth`.
pub fn plane_errors(taken: &RangeImage, truth: &RangeImage) -> PlaneErrors {
    let grid = taken.point_grid(0..taken.columns());
    let true_grid = truth.point_grid(0..truth.columns());
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let segmentation = segmenter.segment(&grid);
    let (mut planes, mut weight, mut offsets, mut tilts) = (0, 0.0, 0.0, 0.0);
    for surface in &segmentation.surfaces {
        if !matches!(surface.shape, Shape::Plane(_)) || surface.points < FEWEST_POINTS {
            continue;
        }
        let pixels: Vec<usize> = (0..segmentation.labels.len())
            .filter(|&pixel| segmentation.labels[pixel] == surface.id)
            .collect();
        let (Some((centre, normal)), Some((true_centre, true_normal))) =
            (fit(&grid, &pixels), fit(&true_grid, &pixels))
        else {
            continue;
        };
        let points = surface.points as f64;
        planes += 1;
        weight += points;
        offsets += points * true_normal.dot(&(centre - true_centre)).powi(2);
        tilts += points * normal.dot(&true_normal).abs().min(1.0).acos().powi(2);
    }
    let mean = |sum: f64| (sum / f64::max(weight, 1.0)).sqrt();
    PlaneErrors { planes, offset_m: mean(offsets), tilt_rad: mean(tilts) }
}

/// Centroid and normal of the points of `pixels`.
fn fit(grid: &PointGrid, pixels: &[usize]) -> Option<(Point3<f64>, Vector3<f64>)> {
    let at = |&pixel: &usize| grid.point(pixel / grid.columns(), pixel % grid.columns());
    let points: Vec<Point3<f64>> = pixels.iter().filter_map(at).collect();
    if points.len() < 3 {
        return None;
    }
    let sum: Vector3<f64> = points.iter().map(|point| point.coords).sum();
    let centre = Point3::from(sum / points.len() as f64);
    let scatter: Matrix3<f64> =
        points.iter().map(|point| (point - centre) * (point - centre).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    Some((centre, eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned()))
}

/// The image with each row where it was truly taken from a robot that stood still.
pub fn truth_of(bench: &Bench, taken: &RangeImage, lines: &[LaserLine]) -> RangeImage {
    let head = &bench.rig.laser.as_ref().unwrap().head;
    let scan_from_robot = head.robot_from_device(HeadPose::default()).inverse();
    rebuilt(taken, lines, |row| {
        let tilt = bench.cast_of(&taken.rows()[row]).unwrap().tilt_rad;
        scan_from_robot * head.robot_from_device(HeadPose::tilted(tilt))
    })
}

fn rebuilt(
    taken: &RangeImage,
    lines: &[LaserLine],
    scan_from_sensor: impl Fn(usize) -> Isometry3<f64>,
) -> RangeImage {
    let bearings = (0..lines[0].len()).map(|beam| lines[0].bearing_rad(beam)).collect();
    let mut image = RangeImage::new(taken.robot_from_scan, bearings, lines[0].max_range_m);
    for (at, (row, line)) in taken.rows().iter().zip(lines).enumerate() {
        let mut row = row.clone();
        row.scan_from_sensor = scan_from_sensor(at);
        image.push_line(row, line);
    }
    image
}

/// The lines that an image was made of.
pub fn lines_of(image: &RangeImage) -> Vec<LaserLine> {
    let rows = image.rows().iter().enumerate();
    rows.map(|(at, row)| LaserLine {
        stamp: row.stamp.unwrap(),
        first_bearing_rad: -std::f64::consts::FRAC_PI_2,
        bearing_step_rad: std::f64::consts::PI / (image.columns() - 1) as f64,
        min_range_m: 0.1,
        max_range_m: 20.0,
        phantom_m: None,
        ranges_m: (0..image.columns())
            .map(|column| match image.at(at, column) {
                Return::Hit(range) => range,
                Return::Nothing => 20.0,
                Return::Missing => f64::NAN,
            })
            .collect(),
    })
    .collect()
}

/// `tests/campaign/scans.sh` prints it.
#[test]
#[ignore = "a table to read, ten minutes of simulated scanning: tests/campaign/scans.sh"]
fn station_by_profile() {
    println!("station          | profile | seconds | planes | offset mm | tilt °");
    for (name, dialect) in [("UT2004", Dialect::Ut2004), ("UDK", Dialect::Udk)] {
        let scenario = if dialect == Dialect::Udk { "station_udk" } else { "station" };
        let setting = Setting { scenario, ..Setting::new(dialect, true) };
        let mut bench = Bench::new(&setting, AcquisitionConfig::default());
        bench.calibrate();
        let paper = SweepRequest::paper(bench.acquisition.config());
        for (profile, request) in [("paper", paper), ("model", SweepRequest::model())] {
            let scan = bench.take(request);
            let lines = lines_of(&scan.image);
            let errors = plane_errors(&scan.image, &truth_of(&bench, &scan.image, &lines));
            println!(
                "{name:<16} | {profile:<7} | {:>7.1} | {:>6} | {:>9.2} | {:.3}",
                scan.seconds(),
                errors.planes,
                1e3 * errors.offset_m,
                errors.tilt_rad.to_degrees()
            );
        }
    }
}
