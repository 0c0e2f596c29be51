//! One scan's update in maps of 50, 200, 800 and 5000 landmarks: time, and bytes of the whole state.
//!
//! A robot goes through rooms of ten planes each, a serpentine of rooms on one floor. It looks twice in
//! each room and once in the doorway to the next, where it sees planes of both: what ties two rooms
//! together in a building is what can be seen of both, not the wheels. Printed is the median over its
//! last 40 scans in a map of that size, back and forth through the last doorway, so search for
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
/// Between two rows, so that the walls of one are not continued in the next.
const BETWEEN_ROWS_M: f64 = 1.0;
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
fn faces(room: usize) -> [Face; 10] {
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    let half = 0.5 * ROOM_M - 0.1;
    // Neighbouring rooms differ in depth, so that their walls in a row are not one wall.
    let deep = half - 0.25 * (room % 3) as f64;
    let high = 2.6 + 0.04 * (room % 11) as f64;
    // The box stands elsewhere in each room.
    let at = (1.2 + 0.1 * (room % 7) as f64, 0.8 - 0.15 * (room % 5) as f64);
    [
        ([0.0, 0.0, 0.0], z, (half, deep)),
        ([0.0, 0.0, high], -z, (half, deep)),
        ([half, 0.0, 1.3], -x, (deep, 1.3)),
        ([-half, 0.0, 1.3], x, (deep, 1.3)),
        ([0.0, deep, 1.3], -y, (half, 1.3)),
        ([0.0, -deep, 1.3], y, (half, 1.3)),
        ([at.0 - 0.4, at.1, 0.4], -x, (0.4, 0.4)),
        ([at.0, at.1 - 0.4, 0.4], -y, (0.4, 0.4)),
        ([at.0, at.1, 0.8], z, (0.4, 0.4)),
        ([at.0 - 1.6, at.1 - 2.0, 0.9], (y - x).normalize(), (0.3, 0.9)),
    ]
}

/// Which faces of the room behind and of the room ahead are seen from a doorway.
const FROM_DOORWAY: ([usize; 6], [usize; 6]) = ([0, 3, 4, 5, 8, 9], [0, 2, 4, 5, 6, 8]);

fn centre(room: usize) -> Vector3<f64> {
    let (row, place) = (room / ROOMS_IN_A_ROW, room % ROOMS_IN_A_ROW);
    let column = if row % 2 == 0 { place } else { ROOMS_IN_A_ROW - 1 - place };
    // A step from each room into the next, so that each has a floor of its own.
    let level = 0.2 * (room % 2) as f64;
    Vector3::new(ROOM_M * column as f64, (ROOM_M + BETWEEN_ROWS_M) * row as f64, level)
}

/// Where the robot looks from.
#[derive(Clone, Copy)]
enum Stand {
    /// In a room, turned aside or not.
    Room(usize, bool),
    /// Between a room and the next.
    Doorway(usize),
}

impl Stand {
    fn pose(self) -> Isometry3<f64> {
        match self {
            Self::Room(room, turned) => {
                let turn = if turned { 0.3 } else { 0.0 };
                Isometry3::new(centre(room) - Vector3::new(0.5, 0.4, 0.0), Vector3::z() * turn)
            }
            Self::Doorway(room) => {
                let between = 0.5 * (centre(room) + centre(room + 1));
                Isometry3::new(between, Vector3::z() * 0.1)
            }
        }
    }

    fn in_view(self) -> Vec<(usize, Face)> {
        match self {
            Self::Room(room, _) => faces(room).map(|face| (room, face)).to_vec(),
            Self::Doorway(room) => {
                let (behind, ahead) = FROM_DOORWAY;
                let behind = behind.map(|face| (room, faces(room)[face]));
                let ahead = ahead.map(|face| (room + 1, faces(room + 1)[face]));
                behind.into_iter().chain(ahead).collect()
            }
        }
    }
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

fn scan(stand: Stand, rng: &mut Pcg64) -> ScanObservations {
    let world_from_robot = stand.pose();
    let observations = stand
        .in_view()
        .into_iter()
        .map(|(room, (at, normal, half))| {
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
    let mut before = Stand::Room(0, false).pose();
    let mut mapper = Mapper::new(MapperConfig::default(), before);
    let mut look = |stand: Stand| {
        let pose = stand.pose();
        mapper.predict(&(before.inverse() * pose), TurnSource::Inertial);
        before = pose;
        let scan = scan(stand, &mut rng);
        let clock = Instant::now();
        std::hint::black_box(mapper.observe(&scan));
        clock.elapsed().as_secs_f64() * 1e3
    };
    for room in 0..rooms {
        look(Stand::Room(room, false));
        look(Stand::Room(room, true));
        if room + 1 < rooms {
            look(Stand::Doorway(room));
        }
    }
    // Back and forth between the last rooms: a map of this size and no larger.
    let round = [
        Stand::Doorway(rooms - 2),
        Stand::Room(rooms - 2, false),
        Stand::Room(rooms - 2, true),
        Stand::Doorway(rooms - 2),
        Stand::Room(rooms - 1, true),
        Stand::Room(rooms - 1, false),
    ];
    let mut last: Vec<f64> = round.into_iter().cycle().take(MEASURED).map(&mut look).collect();
    last.sort_by(f64::total_cmp);
    Measured {
        landmarks: mapper.landmarks().len(),
        median_ms: last[MEASURED / 2],
        worst_ms: last[MEASURED - 1],
        bytes: postcard::to_stdvec(&mapper).map_or(0, |bytes| bytes.len()),
    }
}

/// Exponent x of a growth as landmarksˣ between two sizes.
fn exponent(small: (usize, f64), large: (usize, f64)) -> f64 {
    (large.1 / small.1).ln() / (large.0 as f64 / small.0 as f64).ln()
}

fn main() {
    println!("{:>10} {:>10} {:>10} {:>14}", "landmarks", "median ms", "worst ms", "state");
    let mut rows: Vec<Measured> = Vec::new();
    for landmarks in [50, 200, 800, 5000] {
        let row = measure(landmarks);
        let Measured { landmarks, median_ms, worst_ms, bytes } = row;
        println!("{landmarks:>10} {median_ms:>10.3} {worst_ms:>10.3} {:>11} kB", bytes / 1000);
        rows.push(row);
    }
    for pair in rows.windows(2) {
        let time = |row: &Measured| (row.landmarks, row.median_ms);
        let bytes = |row: &Measured| (row.landmarks, row.bytes as f64);
        println!(
            "from {} to {} landmarks: time as n^{:.2}, bytes as n^{:.2}",
            pair[0].landmarks,
            pair[1].landmarks,
            exponent(time(&pair[0]), time(&pair[1])),
            exponent(bytes(&pair[0]), bytes(&pair[1])),
        );
    }
}
