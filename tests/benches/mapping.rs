//! One scan's update in maps of 50, 200, 800 and 5000 landmarks: time, and bytes of the whole state.
//!
//! A robot goes through rooms of ten planes each, a serpentine of rooms on one floor, and looks twice
//! in each. Printed is the median over its last 40 scans in a map of that size, so search for
//! candidates, association, update and upkeep are all in it. `cargo bench --bench mapping`.

use nalgebra::{Isometry3, Matrix3, Point2, UnitQuaternion, Vector3};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::time::Instant;
use usar_agent::mapping::perturbation::perturbed_plane;
use usar_agent::mapping::{
    Mapper, MapperConfig, Observation, PlaneMask, ScanErrors, ScanObservations, TurnSource,
};

/// Edge of a room, and how many stand in a row.
const ROOM_M: f64 = 6.0;
const ROOMS_IN_A_ROW: usize = 20;
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
    // The box stands elsewhere in each room.
    let at = (1.2 + 0.1 * (room % 7) as f64, 0.8 - 0.15 * (room % 5) as f64);
    vec![
        ([0.0, 0.0, 0.0], z, (half, half)),
        ([0.0, 0.0, 2.6 + 0.01 * (room % 11) as f64], -z, (half, half)),
        ([half, 0.0, 1.3], -x, (half, 1.3)),
        ([-half, 0.0, 1.3], x, (half, 1.3)),
        ([0.0, half, 1.3], -y, (half, 1.3)),
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
    // Floors of neighbouring rooms are two centimetres apart, so that each is a landmark.
    let level = 0.05 * (room % 2) as f64;
    Vector3::new(ROOM_M * column as f64, ROOM_M * row as f64, level)
}

fn observation(frame: Isometry3<f64>, half: (f64, f64), rng: &mut Pcg64) -> Observation {
    let corner = |x: f64, y: f64| Point2::new(half.0 * x, half.1 * y);
    let hull = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let mut mask = PlaneMask::default();
    let (nx, ny) = ((half.0 / 0.05) as i32, (half.1 / 0.05) as i32);
    for i in 0..=nx {
        for j in 0..=ny {
            let share = |k: i32, n: i32| 2.0 * f64::from(k) / f64::from(n.max(1)) - 1.0;
            mask.insert(&corner(share(i, nx), share(j, ny)));
        }
    }
    let sigmas = Vector3::new(5e-4, 8e-4, 8e-4);
    let error = sigmas.map(|sigma| sigma * normal(rng));
    Observation {
        robot_from_plane: perturbed_plane(&frame, &error),
        covariance: Matrix3::from_diagonal(&sigmas.map(|sigma| sigma * sigma)),
        hull,
        mask,
        points: 2000,
        rms_m: 0.003,
    }
}

fn scan(room: usize, world_from_robot: &Isometry3<f64>, rng: &mut Pcg64) -> ScanObservations {
    let observations = faces(room)
        .into_iter()
        .map(|(at, normal, half)| {
            let rotation =
                UnitQuaternion::rotation_between(&Vector3::z(), &normal).unwrap_or_else(|| {
                    UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI)
                });
            let place = centre(room) + Vector3::from(at);
            let frame = Isometry3::from_parts(place.into(), rotation);
            observation(world_from_robot.inverse() * frame, half, rng)
        })
        .collect();
    let robot_from_scan = Isometry3::translation(0.0, 0.0, 0.6);
    ScanObservations {
        observations,
        curves: Vec::new(),
        robot_from_scan,
        errors: ScanErrors::default(),
        contacts: Vec::new(),
    }
}

struct Measured {
    landmarks: usize,
    median_ms: f64,
    worst_ms: f64,
    bytes: usize,
}

#[expect(clippy::disallowed_methods, reason = "a benchmark reads the clock")]
fn measure(landmarks: usize) -> Measured {
    let mut rng = Pcg64::seed_from_u64(11);
    let rooms = landmarks / faces(0).len();
    let pose_in = |room: usize, turned: bool| {
        let turn = if turned { 0.3 } else { 0.0 };
        Isometry3::new(centre(room) - Vector3::new(0.5, 0.4, 0.0), Vector3::z() * turn)
    };
    let mut mapper = Mapper::new(MapperConfig::default(), pose_in(0, false));
    let mut before = pose_in(0, false);
    let mut look = |room: usize, turned: bool| {
        let pose = pose_in(room, turned);
        mapper.predict(&(before.inverse() * pose), TurnSource::Inertial);
        before = pose;
        let scan = scan(room, &pose, &mut rng);
        let clock = Instant::now();
        std::hint::black_box(mapper.observe(&scan));
        clock.elapsed().as_secs_f64() * 1e3
    };
    for room in 0..rooms {
        look(room, false);
        look(room, true);
    }
    // The last rooms again and again: a map of this size and no larger.
    let mut last: Vec<f64> =
        (0..MEASURED).map(|k| look(rooms - 1 - k % 2.min(rooms), k % 4 < 2)).collect();
    last.sort_by(f64::total_cmp);
    Measured {
        landmarks: mapper.landmarks().len(),
        median_ms: last[MEASURED / 2],
        worst_ms: last[MEASURED - 1],
        bytes: postcard::to_stdvec(&mapper).map_or(0, |bytes| bytes.len()),
    }
}

fn main() {
    println!("{:>10} {:>10} {:>10} {:>14}", "landmarks", "median ms", "worst ms", "state");
    for landmarks in [50, 200, 800, 5000] {
        let Measured { landmarks, median_ms, worst_ms, bytes } = measure(landmarks);
        println!("{landmarks:>10} {median_ms:>10.3} {worst_ms:>10.3} {:>11} kB", bytes / 1000);
    }
}
