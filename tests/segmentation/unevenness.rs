//! Walls that wave by a millimetre: planes of different parts of one differ by no more than they are told
//! to, and an even wall is told as noise alone has it.

use super::world::Random;
use nalgebra::{Matrix3, Vector3};
use usar_agent::scan::PointGrid;
use usar_agent::segmentation::{PlanePatch, SegmentationConfig, Segmenter, Shape};

const ROWS: usize = 80;
const COLUMNS: usize = 120;
const DISTANCE_M: f64 = 3.0;
const NOISE_M: f64 = 0.003;
/// 95 % of a χ² variable of three degrees of freedom lie below this.
const WITHIN_95: f64 = 7.815;

/// Waves of all lengths from a fifth of a metre to a few, each as high as the others.
struct Waves(Vec<(f64, f64, f64)>);

impl Waves {
    fn of(height_m: f64, random: &mut Random) -> (f64, Self) {
        let wave = |k: usize| {
            let number = std::f64::consts::TAU / (0.2 * 1.3_f64.powi(k as i32));
            let heading = std::f64::consts::TAU * random.between(0.0, 1.0);
            (
                number * heading.cos(),
                number * heading.sin(),
                std::f64::consts::TAU * random.between(0.0, 1.0),
            )
        };
        (height_m, Self((0..12).map(wave).collect()))
    }

    fn height(&self, y: f64, z: f64) -> f64 {
        self.0.iter().map(|(ky, kz, phase)| (ky * y + kz * z + phase).sin()).sum()
    }
}

/// The plane of the wall ahead, seen in some of the columns.
fn look(
    (height_m, waves): &(f64, Waves),
    columns: std::ops::Range<usize>,
    random: &mut Random,
) -> PlanePatch {
    let mut points = Vec::new();
    for row in 0..ROWS {
        let tilt = (0.5 * row as f64 - 20.0).to_radians();
        for column in 0..COLUMNS {
            let (sin, cos) = (0.5 * column as f64 - 30.0).to_radians().sin_cos();
            let ray = Vector3::new(cos * tilt.cos(), sin, -cos * tilt.sin());
            let hit = ray * (DISTANCE_M / ray.x);
            let range = hit.norm() + height_m * waves.height(hit.y, hit.z) / ray.x;
            let p = ray * (range + NOISE_M * random.normal());
            points.push([p.x as f32, p.y as f32, p.z as f32]);
        }
    }
    let grid = PointGrid::new(ROWS, COLUMNS, points).columns_only(columns);
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let surfaces = &segmenter.segment(&grid).surfaces;
    let largest = surfaces.iter().max_by_key(|surface| surface.points).unwrap();
    let Shape::Plane(patch) = &largest.shape else { panic!("the wall is a plane: {largest:?}") };
    patch.clone()
}

/// What a patch says of offset, slope along y and along z of the wall at the line of sight ahead, and the
/// covariance of that.
fn told(patch: &PlanePatch) -> (Vector3<f64>, Matrix3<f64>) {
    let about = |error: &Vector3<f64>| {
        let turn =
            nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(error[2], error[1], 0.0));
        let moved = nalgebra::Isometry3::from_parts(Vector3::new(0.0, 0.0, error[0]).into(), turn);
        let frame = patch.grid_from_plane * moved;
        let normal = frame.rotation * Vector3::z();
        let offset = normal.dot(&frame.translation.vector);
        Vector3::new(offset / normal.x, -normal.y / normal.x, -normal.z / normal.x)
    };
    let middle = about(&Vector3::zeros());
    let step = 1e-5;
    let jacobian = Matrix3::from_columns(
        &[Vector3::x(), Vector3::y(), Vector3::z()].map(|e| (about(&(e * step)) - middle) / step),
    );
    (middle, jacobian * patch.covariance * jacobian.transpose())
}

/// Squared normalised differences of what two thirds of a wall tell from what the other two do.
fn differences(height_m: f64) -> Vec<f64> {
    let mut random = Random(17);
    let of_wall = |_| {
        let wall = Waves::of(height_m, &mut random);
        let (left, left_p) = told(&look(&wall, 0..80, &mut random));
        let (right, right_p) = told(&look(&wall, 40..120, &mut random));
        let gap = left - right;
        gap.dot(&(left_p + right_p).cholesky().unwrap().solve(&gap))
    };
    (0..40).map(of_wall).collect()
}

#[test]
fn planes_of_two_parts_of_an_uneven_wall_differ_by_what_they_are_told_to() {
    let of = differences(0.0006);
    let mean = of.iter().sum::<f64>() / of.len() as f64;
    let within = of.iter().filter(|square| **square < WITHIN_95).count();
    // Told by their noise alone they are at hundreds.
    assert!(mean < 4.5 && 10 * within >= 9 * of.len(), "{mean} {within}");
    assert!(mean > 0.2, "told far worse than they are: {mean}");
}

#[test]
fn an_even_wall_is_known_as_well_as_its_noise_lets_it_be() {
    let of = differences(0.0);
    let mean = of.iter().sum::<f64>() / of.len() as f64;
    // 3 ± 3 √(6 / 40).
    assert!((mean - 3.0).abs() < 1.2, "{mean}");
    let mut random = Random(5);
    let patch = look(&Waves::of(0.0, &mut random), 0..COLUMNS, &mut random);
    let offset_m = NOISE_M / ((ROWS * COLUMNS) as f64).sqrt();
    assert!(patch.covariance[(0, 0)].sqrt() < 1.2 * offset_m, "{}", patch.covariance);
}
