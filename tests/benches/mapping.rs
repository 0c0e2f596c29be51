//! One scan's update in maps of 50, 200, 800 and 5000 landmarks: time, and bytes of the whole state.
//!
//! A robot goes along corridors of like rooms on one floor, under one ceiling, each with six surfaces of
//! its own, looks twice in each and sees a little of those before and after. Wheels err as the estimator
//! believes that they do. Printed are medians over the last 40 scans in a map of that size (search for
//! candidates, association, update and upkeep are all in it), the worst of them and of all on the way
//! there, and the pose's error at the end: a map that is quick and wrong would be no feat.
//! `cargo bench --bench mapping`; numbers of landmarks as arguments replace those above.

use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector3};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::collections::BTreeMap;
use std::time::Instant;
use usar_agent::mapping::perturbation::{perturbed_plane, perturbed_pose, pose_error};
use usar_agent::mapping::{
    Association, InertialNoise, LandmarkId, Mapper, MapperConfig, Motion, MotionSource,
    Observation, OdometryNoise, PlaneMask, ScanErrors, ScanObservations,
};

/// Edge of a room, and how many stand in a row.
const ROOM_M: f64 = 6.0;
const ROOMS_IN_A_ROW: usize = 20;
/// How far the robot sees into the rooms before and after, on both sides of the
/// walls between them.
const SEEN_ON_M: f64 = 1.0;
/// Surfaces of a room that are no other room's.
const OWN: usize = 6;
/// Scans of which the median is printed.
const MEASURED: usize = 40;

fn normal(rng: &mut Pcg64) -> f64 {
    let mut uniform = || (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
    let (u, v) = (uniform().max(1e-300), uniform());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Centre within the room, normal, half sizes.
type Face = ([f64; 3], Vector3<f64>, (f64, f64));

/// The faces of a room and of a box in it.
fn faces(room: usize) -> Vec<Face> {
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    let half = 0.5 * ROOM_M - 0.1;
    // The box stands elsewhere in each room: fractions of multiples of irrational numbers.
    let share = |factor: f64| (room as f64 * factor).fract() - 0.5;
    let at = (1.2 + 1.6 * share(0.618_034), 0.6 + 1.6 * share(0.754_878));
    vec![
        ([0.0, 0.0, 0.0], z, (half + SEEN_ON_M, half)),
        ([0.0, 0.0, 2.6], -z, (half + SEEN_ON_M, half)),
        ([half, 0.0, 1.3], -x, (0.5 * half, 1.3)),
        ([-half, 0.0, 1.3], x, (0.5 * half, 1.3)),
        ([0.0, half, 1.3], -y, (half + SEEN_ON_M, 1.3)),
        ([0.0, -half, 1.3], y, (half, 1.3)),
        ([at.0 - 0.4, at.1, 0.4], -x, (0.4, 0.4)),
        ([at.0, at.1 - 0.4, 0.4], -y, (0.4, 0.4)),
        ([at.0, at.1, 0.8], z, (0.4, 0.4)),
        ([at.0 - 1.6, at.1 - 2.0, 0.9], (y - x).normalize(), (0.3, 0.9)),
    ]
}

fn centre(room: usize) -> Vector3<f64> {
    let (row, place) = (room / ROOMS_IN_A_ROW, room % ROOMS_IN_A_ROW);
    let column = if row % 2 == 0 { place } else { ROOMS_IN_A_ROW - 1 - place };
    // Rows lie apart: like rooms side by side would be a test of association, not of its cost.
    Vector3::new(ROOM_M * column as f64, 1.5 * ROOM_M * row as f64, 0.0)
}

/// The frame of a face: z along its normal, y up where it stands upright.
fn frame(room: usize, face: &Face) -> Isometry3<f64> {
    let (at, normal, _) = face;
    let along = if normal.z.abs() < 0.5 { Vector3::z() } else { Vector3::y() };
    let axes = Matrix3::from_columns(&[along.cross(normal), along, *normal]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts((centre(room) + Vector3::from(*at)).into(), rotation)
}

/// Where the laser is above the robot's own origin.
const EYE_M: f64 = 0.6;

fn scan(room: usize, world_from_robot: &Isometry3<f64>, rng: &mut Pcg64) -> ScanObservations {
    let faces = faces(room);
    let frames: Vec<Isometry3<f64>> = faces.iter().map(|face| frame(room, face)).collect();
    let robot_from_scan = Isometry3::translation(0.0, 0.0, EYE_M);
    let eye = (world_from_robot * robot_from_scan).translation.vector;
    // A face hides what the ray to it would have to pass.
    let hidden = |point: &Point3<f64>, own: usize| {
        frames.iter().zip(&faces).enumerate().any(|(other, (frame, (_, _, half)))| {
            let (from, to) = (frame.inverse() * Point3::from(eye), frame.inverse() * point);
            let through = from + (to - from) * (from.z / (from.z - to.z));
            other != own
                && from.z > 0.0
                && to.z < -1e-6
                && through.x.abs() < half.0
                && through.y.abs() < half.1
        })
    };
    let observations = faces.iter().zip(&frames).enumerate().map(|(own, ((_, _, half), frame))| {
        let corner = |x: f64, y: f64| Point2::new(half.0 * x, half.1 * y);
        let hull = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        let mut mask = PlaneMask::default();
        let (nx, ny) = ((half.0 / 0.05) as i32, (half.1 / 0.05) as i32);
        let share = |k: i32, n: i32| 2.0 * f64::from(k) / f64::from(n.max(1)) - 1.0;
        for (i, j) in (0..=nx).flat_map(|i| (0..=ny).map(move |j| (i, j))) {
            let cell = corner(share(i, nx), share(j, ny));
            if !hidden(&(frame * Point3::new(cell.x, cell.y, 0.0)), own) {
                mask.insert(&cell);
            }
        }
        let sigmas = Vector3::new(5e-4, 8e-4, 8e-4);
        let error = sigmas.map(|sigma| sigma * normal(rng));
        Observation {
            robot_from_plane: perturbed_plane(&(world_from_robot.inverse() * frame), &error),
            covariance: Matrix3::from_diagonal(&sigmas.map(|sigma| sigma * sigma)),
            hull,
            mask,
            points: 2000,
            rms_m: 0.003,
        }
    });
    ScanObservations {
        observations: observations.collect(),
        curves: Vec::new(),
        robot_from_scan,
        errors: ScanErrors::default(),
        contacts: Vec::new(),
    }
}

/// Wheels and an inertial unit that are good for a way of six metres between rooms that share little:
/// with the usual ones like rooms in a row would be a test of association.
fn odometry() -> OdometryNoise {
    let inertial = InertialNoise {
        fixed_rad: 0.001,
        step_share: 0.01,
        height_per_m: 0.002,
        attitude_per_m: 0.0005,
        ..InertialNoise::default()
    };
    OdometryNoise {
        position_per_m: 0.01,
        position_per_rad: 0.01,
        inertial,
        ..OdometryNoise::default()
    }
}

/// What odometry reads of a motion: away from it by a draw from its own noise model.
fn misread(motion: &Isometry3<f64>, noise: &OdometryNoise, rng: &mut Pcg64) -> Isometry3<f64> {
    let mut told = Motion::default();
    told.append(motion, MotionSource::InertialTurn);
    let root = noise.covariance(&told).cholesky().map(|cholesky| cholesky.l());
    let draw = nalgebra::Vector6::from_fn(|_, _| normal(rng));
    root.map_or(*motion, |root| perturbed_pose(motion, &(root * draw)))
}

/// Which surface a face of a room is part of: floor and ceiling are one each, and so are both walls
/// along a row.
fn surface(room: usize, face: usize) -> (usize, usize) {
    match face {
        0 | 1 => (0, face),
        4 | 5 => (room / ROOMS_IN_A_ROW, face),
        _ => (room, face),
    }
}

struct Measured {
    landmarks: usize,
    median_ms: f64,
    worst_ms: f64,
    worst_on_way_ms: f64,
    off_m: f64,
    wrong: usize,
    bytes: usize,
}

#[expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
fn measure(landmarks: usize) -> Measured {
    let mut rng = Pcg64::seed_from_u64(11);
    let rooms = landmarks / OWN;
    let config = MapperConfig { odometry: odometry(), ..MapperConfig::default() };
    let pose_in = |room: usize, turned: bool| {
        let turn = if turned { 0.3 } else { 0.0 };
        Isometry3::new(centre(room) - Vector3::new(0.5, 0.4, 0.0), Vector3::z() * turn)
    };
    let mut mapper = Mapper::new(config, pose_in(0, false));
    let mut before = pose_in(0, false);
    // Row or room and face, by landmark.
    let mut truth: BTreeMap<LandmarkId, (usize, usize)> = BTreeMap::new();
    let mut wrong = 0;
    let mut look = |room: usize, turned: bool| {
        let pose = pose_in(room, turned);
        let increment = misread(&(before.inverse() * pose), &odometry(), &mut rng);
        mapper.predict(&increment, MotionSource::InertialTurn);
        before = pose;
        let scan = scan(room, &pose, &mut rng);
        let clock = Instant::now();
        let report = mapper.observe(&scan);
        let elapsed_ms = clock.elapsed().as_secs_f64() * 1e3;
        for added in &report.added {
            truth.insert(added.landmark, surface(room, added.observation));
        }
        let of_another = |pair: &&Association| {
            let seen = surface(room, pair.observation);
            // Another explanation may have become the best, with landmarks of its own.
            *truth.entry(pair.landmark).or_insert(seen) != seen
        };
        wrong += report.associations.iter().filter(of_another).count();
        elapsed_ms
    };
    let mut worst_on_way_ms = 0.0_f64;
    for room in 0..rooms {
        worst_on_way_ms = worst_on_way_ms.max(look(room, false)).max(look(room, true));
    }
    // The last rooms again and again: a map of this size and no larger.
    let mut last: Vec<f64> =
        (0..MEASURED).map(|k| look(rooms - 1 - k % 2.min(rooms), k % 4 < 2)).collect();
    last.sort_by(f64::total_cmp);
    let off = pose_error(&before, &mapper.world_from_robot());
    Measured {
        wrong,
        off_m: off.fixed_rows::<3>(0).norm(),
        landmarks: mapper.landmarks().len(),
        median_ms: last[MEASURED / 2],
        worst_ms: last[MEASURED - 1],
        worst_on_way_ms,
        bytes: postcard::to_stdvec(&mapper).map_or(0, |bytes| bytes.len()),
    }
}

fn main() {
    let asked: Vec<usize> = std::env::args().filter_map(|word| word.parse().ok()).collect();
    let sizes = if asked.is_empty() { vec![50, 200, 800, 5000] } else { asked };
    println!(
        "{:>10} {:>10} {:>10} {:>10} {:>12} {:>10} {:>14}",
        "landmarks", "median ms", "worst ms", "on way ms", "wrong pairs", "off m", "state"
    );
    for size in sizes {
        let Measured { landmarks, median_ms, worst_ms, worst_on_way_ms, wrong, off_m, bytes } =
            measure(size);
        println!(
            "{landmarks:>10} {median_ms:>10.3} {worst_ms:>10.3} {worst_on_way_ms:>10.3} {wrong:>12} {off_m:>10.4} {:>11} kB",
            bytes / 1000
        );
    }
}
