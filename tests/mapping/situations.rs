//! Situations in which plane mapping goes wrong when something is missing: one test each.

use super::drive::{Drive, step};
use super::world::{World, furnished_room};
use nalgebra::{Isometry3, Matrix3, Matrix6, Point2, Rotation3, UnitQuaternion, Vector3, Vector6};
use usar_agent::mapping::perturbation::perturbed_pose;
use usar_agent::mapping::{
    Mapper, MapperConfig, Mode, MotionSource, OdometryNoise, PlaneMask, RefusalReason,
};

const NO_ERROR: Vector6<f64> = Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0);

fn config() -> MapperConfig {
    MapperConfig::default()
}

fn shift(x: f64, y: f64, yaw_deg: f64) -> Vector6<f64> {
    Vector6::new(x, y, 0.0, 0.0, 0.0, yaw_deg.to_radians())
}

/// Normals along the world's axes are where the paper's Euler angles are singular.
#[test]
fn a_wall_that_exactly_faces_the_robot_corrects_it() {
    for mode in [Mode::Full, Mode::Mip] {
        let mut world = World::default();
        world.room((-3.0, 6.0), (-4.0, 4.0), 3.0);
        let config = MapperConfig { mode, ..config() };
        let mut drive = Drive::begin(&world, config, Isometry3::identity(), 1);
        for _ in 0..4 {
            drive.slide(&step(0.5, 0.0, 0.0), &shift(0.03, -0.02, 0.5));
            let report = drive.look();
            assert!(report.associations.len() >= 4, "{mode:?}: {report:?}");
        }
        let (metres, radians) = drive.error();
        assert!(metres < 0.01 && radians < 0.004, "{mode:?}: {metres} m, {radians} rad");
        assert_eq!(drive.wrong, 0);
        // Both tell of the way from the first scan and of what they took the planes for, so that they compare.
        let spread = drive.mapper.motion_covariance(0, 4).unwrap();
        assert!(spread.cholesky().is_some(), "{mode:?}: {spread}");
        assert!(drive.mapper.sightings(4).len() >= 4, "{mode:?}");
    }
}

#[test]
fn a_floor_alone_corrects_height_and_tilt_and_nothing_else() {
    let mut world = World::default();
    world.level((-30.0, 30.0), (-30.0, 30.0), 0.0, true);
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 2);
    let before = drive.mapper.covariance();
    drive.slide(&step(0.5, 0.0, 5.0), &Vector6::new(0.02, 0.01, 0.03, 0.01, -0.02, 0.01));
    let predicted = drive.mapper.world_from_robot();
    let spread = drive.mapper.covariance() - before;
    let report = drive.look();
    assert_eq!(report.associations.len(), 1);
    let estimate = drive.mapper.world_from_robot();
    // What the floor does not say stays as predicted, and as uncertain.
    let moved = estimate.translation.vector - predicted.translation.vector;
    assert!(moved.xy().norm() < 2e-3, "{moved}");
    let after = drive.mapper.covariance();
    for open in [0, 1, 5] {
        assert!(after[(open, open)] > 0.9 * spread[(open, open)], "{open}: {after}");
    }
    let gap = estimate.translation.z - drive.truth.translation.z;
    assert!(gap.abs() < 0.005, "{gap}");
    // Three directions are open and reported as such.
    assert_eq!(report.weak_directions.len(), 3, "{:?}", report.weak_directions);
    let seen: f64 = report
        .weak_directions
        .iter()
        .flat_map(|weak| [2, 3, 4].map(|axis| weak.direction[axis].abs()))
        .fold(0.0, f64::max);
    assert!(seen < 0.1, "height or tilt reported as open: {:?}", report.weak_directions);
}

#[test]
fn a_turn_of_90_degrees_between_scans_is_taken() {
    let world = furnished_room();
    let start = step(3.0, 0.5, 0.0);
    let mut drive = Drive::begin(&world, config(), start, 4);
    drive.slide(&step(0.0, 0.0, 45.0), &NO_ERROR);
    drive.look();
    drive.slide(&step(0.0, 0.0, -45.0), &NO_ERROR);
    drive.look();
    // The wheels overstate a turn by a tenth: 9° at 90°.
    drive.slide(&step(0.0, 0.0, 90.0), &shift(0.05, -0.05, -9.0));
    let report = drive.look();
    assert!(report.associations.len() >= 3, "{report:?}");
    let (metres, radians) = drive.error();
    assert!(metres < 0.01 && radians < 0.003, "{metres} m, {radians} rad");
    assert_eq!(drive.wrong, 0);
}

#[test]
fn odometry_that_errs_by_0_3_m_a_step_is_corrected_when_it_says_so() {
    let world = furnished_room();
    let noise = OdometryNoise { fixed_m: 0.3, ..OdometryNoise::default() };
    let mut wrong = 0;
    for seed in 0..20 {
        let config = MapperConfig { odometry: noise, ..config() };
        let mut drive = Drive::begin(&world, config, Isometry3::identity(), 100 + seed);
        for k in 0..8 {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            drive.slide(&step(0.5, 0.0, 8.0), &shift(0.21 * sign, -0.21, 1.0));
            drive.look();
        }
        wrong += drive.wrong;
        let (metres, radians) = drive.error();
        assert!(metres < 0.02 && radians < 0.004, "seed {seed}: {metres} m, {radians} rad");
    }
    assert_eq!(wrong, 0);
}

/// Ten times what the noise model says, and nobody says so: the map tells, as long as it has been seen.
#[test]
fn odometry_that_errs_by_0_3_m_a_step_without_saying_so_is_found_out() {
    let world = furnished_room();
    let mut astray = Vec::new();
    for seed in 0..20 {
        let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 300 + seed);
        for k in 0..8 {
            let (sin, cos) = (2.4 * (k + 3 * seed) as f64).sin_cos();
            let turn_deg = if k % 2 == 0 { 3.0 } else { -3.0 };
            drive.slide(&step(0.5, 0.0, 8.0), &shift(0.3 * cos, 0.3 * sin, turn_deg));
            drive.look();
        }
        let (metres, radians) = drive.error();
        if metres > 0.02 || radians > 0.004 {
            astray.push((seed, metres));
        }
    }
    assert!(astray.len() <= 1, "{astray:?}");
}

/// A partition 10 cm thick with a doorway, seen first from one side and then from the other.
#[test]
fn two_faces_of_a_thin_wall_stay_two_landmarks() {
    let mut world = World::default();
    world.room((-4.0, 8.0), (-3.0, 3.0), 2.6);
    let faces = world.rectangles.len();
    for (low, high) in [(-3.0, -0.6), (0.6, 2.0)] {
        world.wall((2.0, low), (2.0, high), 0.0, 2.6);
        world.wall((2.1, high), (2.1, low), 0.0, 2.6);
    }
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 5);
    for turn in [0.0, 0.0, 0.0, 0.0, 60.0, 60.0, 60.0, 0.0] {
        let ahead = if turn == 0.0 { 1.0 } else { 0.0 };
        drive.slide(&step(ahead, 0.0, turn), &shift(0.02 * ahead, 0.01, 0.01 * turn));
        drive.look();
    }
    assert_eq!(drive.wrong, 0);
    // Both sides were seen, and no landmark of one is one of the other.
    let seen = |parity: usize| {
        drive.behind.values().any(|&plane| plane >= faces && (plane - faces) % 2 == parity)
    };
    assert!(seen(0) && seen(1), "{:?}", drive.behind);
    // 99.9 % of χ² with six degrees of freedom.
    assert!(drive.nees() < 22.46, "{} at an error of {:?}", drive.nees(), drive.error());
}

/// In the next room the wall stands nearer by the thickness of a panel, and nothing else tells how far the
/// robot came aside on its way there: that the wall goes on is as likely as that it does not.
#[test]
fn a_panel_beside_a_wall_is_not_taken_for_the_wall() {
    let mut world = World::default();
    world.level((-0.5, 9.0), (-6.0, 4.0), 0.0, true);
    world.wall((4.0, 2.0), (0.0, 2.0), 0.0, 2.5);
    world.wall((8.2, 1.96), (4.1, 1.96), 0.0, 2.5);
    for (low, high) in [(-3.0, -0.6), (0.6, 2.0)] {
        world.wall((4.0, low), (4.0, high), 0.0, 2.5);
        world.wall((4.1, high), (4.1, low), 0.0, 2.5);
    }
    world.wall((0.0, 2.0), (0.0, -3.0), 0.0, 2.5);
    world.wall((8.2, -3.0), (8.2, 2.0), 0.0, 2.5);
    let spread =
        Vector6::new(0.05, 0.05, 0.005, 0.003, 0.003, 0.01).map(|sigma: f64| sigma * sigma);
    let spread = Matrix6::from_diagonal(&spread);
    for aside in [-0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06] {
        let start = Isometry3::new(Vector3::new(1.0, 0.0, 0.0), Vector3::zeros());
        let mut drive = Drive::begin(&world, config(), start, 4);
        for _ in 0..4 {
            drive.slide(&step(0.0, 0.0, 90.0), &NO_ERROR);
            drive.look();
        }
        drive.mapper.predict_with(&step(6.0, 0.0, 180.0), &spread);
        drive.truth *= perturbed_pose(&step(6.0, 0.0, 180.0), &shift(0.01, aside, 0.3));
        for _ in 0..3 {
            drive.look();
        }
        assert_eq!(drive.wrong, 0, "{aside}");
        assert!(drive.right > 8, "{aside}: {} recognised", drive.right);
        // 99 % of χ² with six degrees of freedom.
        assert!(drive.nees() < 16.8, "{aside}: {}", drive.nees());
        // Back in the first room its own wall is known again.
        drive.mapper.predict_with(&step(6.0, 0.0, 180.0), &spread);
        drive.truth *= perturbed_pose(&step(6.0, 0.0, 180.0), &shift(0.02, 0.03, -0.2));
        drive.look();
        let (metres, radians) = drive.error();
        assert!(metres < 0.01 && radians < 0.004, "{aside}: {metres} m, {radians} rad");
        assert_eq!(drive.wrong, 0, "{aside}");
    }
}

/// A leaf 4 cm thick, ajar in a room: both of its faces are within the greatest offset of a comparison, and
/// nearer to each other than odometry knows where the robot is.
#[test]
fn both_sides_of_a_door_leaf_stay_two_landmarks() {
    for seed in 0..5 {
        let mut world = World::default();
        world.room((-4.0, 8.0), (-4.0, 4.0), 2.6);
        let faces = world.rectangles.len();
        let (sin, cos) = 0.15_f64.sin_cos();
        let at = |along: f64, across: f64| {
            (2.5 - sin * along - cos * across, cos * along - sin * across)
        };
        world.wall(at(-0.5, 0.02), at(0.5, 0.02), 0.0, 2.05);
        world.wall(at(0.5, -0.02), at(-0.5, -0.02), 0.0, 2.05);
        let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 500 + seed);
        // Past the leaf on its left, and about.
        let way = [(1.0, 0.0, 40.0), (2.2, 0.0, -40.0), (1.5, 0.0, -80.0), (1.2, 0.0, -80.0)];
        for (ahead, left, turn) in way {
            drive.slide(&step(ahead, left, turn), &shift(0.03, -0.02, 0.5));
            drive.look();
        }
        drive.slide(&step(0.3, 0.0, 0.0), &shift(0.01, -0.02, 0.2));
        drive.look();
        assert_eq!(drive.wrong, 0, "seed {seed}");
        let of_face = |face: usize| -> Vec<_> {
            drive
                .behind
                .iter()
                .filter(|(_, plane)| **plane == faces + face)
                .map(|(id, _)| *id)
                .collect()
        };
        let [front, back] = [of_face(0), of_face(1)];
        assert_eq!((front.len(), back.len()), (1, 1), "seed {seed}: {:?}", drive.behind);
        let plane = |id| {
            let landmark = drive.mapper.landmarks().iter().find(|landmark| landmark.id == id);
            landmark.unwrap().world_from_plane
        };
        let gap = plane(front[0]).inverse() * plane(back[0]);
        assert!((gap.translation.vector.z + 0.04).abs() < 0.01, "seed {seed}: {gap}");
    }
}

/// Two walls, a floor and a ceiling without an end in sight: nothing says how far along it is.
#[test]
fn a_corridor_alone_leaves_its_length_open_and_says_so() {
    let mut world = World::default();
    world.level((-45.0, 45.0), (-1.2, 1.2), 0.0, true);
    world.level((-45.0, 45.0), (-1.2, 1.2), 2.5, false);
    world.wall((-45.0, -1.2), (45.0, -1.2), 0.0, 2.5);
    world.wall((45.0, 1.2), (-45.0, 1.2), 0.0, 2.5);
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 12);
    let mut told_m = 0.0;
    for k in 0..10 {
        let before = drive.mapper.covariance()[(0, 0)];
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        drive.slide(&step(0.8, 0.0, 0.0), &shift(0.05, 0.03 * sign, 0.6 * sign));
        let predicted = drive.mapper.covariance()[(0, 0)];
        told_m += 0.8;
        let report = drive.look();
        let [weak] = &report.weak_directions[..] else {
            panic!("one direction is open: {:?}", report.weak_directions)
        };
        assert!(weak.direction[0].abs() > 0.99, "{:?}", weak.direction);
        // It grows by what the wheels leave open, and no look takes any of it away.
        let after = report.covariance[(0, 0)];
        assert!(after > before && after > 0.95 * predicted, "{before} {predicted} {after}");
    }
    let error = drive.mapper.world_from_robot().translation.vector - drive.truth.translation.vector;
    // The walls hold the rest; the way along is what the wheels told, and half a metre off.
    assert!(error.y.abs() < 0.005 && error.z.abs() < 0.005, "{error}");
    let along = drive.mapper.world_from_robot().translation.x;
    assert!((along - told_m).abs() < 0.05, "{along} of {told_m} m told");
    assert!(drive.error().1 < 0.002 && drive.wrong == 0, "{:?}", drive.error());
}

/// A scrap of a wall, hardly known, between two surfaces one of which is turned by 2.6° and 2 cm off: each by
/// itself may be the scrap's, both may not.
#[test]
fn two_surfaces_do_not_become_pieces_of_a_scrap_that_either_fits() {
    let mut world = World::default();
    world.room((-4.0, 4.0), (-3.0, 3.0), 2.6);
    let (mut first, _) = world.observe(&Isometry3::identity(), None);
    let whole = first.observations.clone();
    let ahead = |x: f64, y: f64, size: f64, tilt: f64| {
        let mut piece = whole[0].clone();
        let axes = [-Vector3::y(), Vector3::z(), -Vector3::x()];
        let facing = Rotation3::from_basis_unchecked(&axes);
        let facing = UnitQuaternion::from_rotation_matrix(&facing);
        piece.robot_from_plane = Isometry3::from_parts(Vector3::new(x, y, 1.0).into(), facing);
        let half = 0.5 * size;
        piece.hull = [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(x, y)| Point2::new(x, y))
            .to_vec();
        piece.mask = PlaneMask::default();
        piece.covariance = Matrix3::from_diagonal(&Vector3::new(1e-6, tilt * tilt, tilt * tilt));
        piece.points = 200;
        piece
    };
    first.observations.push(ahead(2.5, 0.0, 0.15, 0.04));
    let mut mapper = Mapper::new(config(), Isometry3::identity());
    let added = mapper.observe(&first).added;
    let scrap = added.iter().find(|added| added.observation == whole.len()).unwrap().landmark;
    let mut second = first.clone();
    second.observations.truncate(whole.len());
    second.observations.push(ahead(2.5, 0.45, 0.6, 0.002));
    // Through the scrap too, but turned by as much as the scrap is open.
    let mut other = ahead(2.5, -0.45, 0.6, 0.002);
    let turn = Isometry3::rotation(Vector3::z() * 0.045);
    let [to, from] = [2.5, -2.5].map(|x| Isometry3::translation(x, 0.0, 0.0));
    other.robot_from_plane = to * turn * from * other.robot_from_plane;
    second.observations.push(other);
    mapper.predict(&Isometry3::identity(), MotionSource::Wheels);
    let report = mapper.observe(&second);
    let pieces = report.associations.iter().filter(|pair| pair.landmark == scrap).count();
    assert_eq!(pieces, 1, "{report:?}");
    assert_eq!(report.associations.len(), whole.len() + 1);
    // Not only when both have already pulled at it.
    let was_tried =
        report.refused.iter().any(|one| matches!(one.reason, RefusalReason::FailedRetest(_)));
    assert!(!was_tried, "{:?}", report.refused);
}

#[test]
fn steps_of_a_stair_do_not_fuse() {
    let mut world = World::default();
    world.room((-3.0, 9.0), (-3.0, 3.0), 4.0);
    let first = world.rectangles.len();
    // Treads of 0.4 m, risers of 0.17 m, each tread with its riser.
    for k in 0..4 {
        let (x, z) = (2.5 + 0.4 * f64::from(k), 0.17 * f64::from(k));
        world.wall((x, -1.0), (x, 1.0), z, z + 0.17);
        world.level((x, x + 0.4), (-1.0, 1.0), z + 0.17, true);
    }
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 6);
    for _ in 0..6 {
        drive.slide(&step(0.2, 0.0, 0.0), &shift(0.02, 0.01, 0.4));
        drive.look();
    }
    assert_eq!(drive.wrong, 0);
    let mut planes: Vec<usize> =
        drive.behind.values().copied().filter(|&plane| plane >= first).collect();
    planes.sort_unstable();
    let all = planes.len();
    planes.dedup();
    assert!(planes.len() >= 4, "{:?}", drive.behind);
    assert_eq!(all, planes.len(), "one step became two landmarks: {:?}", drive.behind);
}

/// A stair repeats itself one step higher: floor for tread and tread for tread, 0.18 m up, is what the
/// height's uncertainty after a way of 2.6 m allows. All walls fit that as well.
#[test]
fn a_floor_is_not_taken_for_the_first_tread_of_a_stair() {
    let mut world = World::default();
    world.room((-6.0, 4.0), (-3.0, 6.0), 3.0);
    for k in 0..5 {
        let (x, z) = (-1.0 - 0.32 * f64::from(k), 0.18 * f64::from(k));
        world.wall((x, 0.8), (x, -0.8), z, z + 0.18);
        world.level((x - 0.32, x), (-0.8, 0.8), z + 0.18, true);
    }
    for seed in 0..10 {
        let start = step(1.5, 0.0, 180.0);
        let mut drive = Drive::begin(&world, config(), start, 60 + seed);
        drive.slide(&step(0.3, 0.0, 0.0), &NO_ERROR);
        drive.look();
        // Two metres aside, the height told 0.1 m too high: half a step, and within what wheels allow.
        drive.slide(&step(0.0, 0.0, -90.0), &shift(0.01, 0.0, 1.0));
        let told = Isometry3::translation(2.6, 0.0, 0.1);
        drive.slide(&told, &Vector6::new(0.05, 0.03, -0.1, 0.0, 0.0, 0.01));
        drive.slide(&step(0.0, 0.0, 140.0), &shift(0.0, 0.01, -1.0));
        drive.look();
        drive.slide(&step(0.2, 0.0, 0.0), &NO_ERROR);
        drive.look();
        let gap = drive.mapper.world_from_robot().translation.z - drive.truth.translation.z;
        assert!(gap.abs() < 0.01, "seed {seed}: {gap}");
        assert_eq!(drive.wrong, 0, "seed {seed}");
    }
}

/// Shelf fronts 0.35 m behind each other: nearer than the greatest offset of a comparison.
#[test]
fn parallel_shelves_stay_apart() {
    let mut world = World::default();
    world.room((-3.0, 9.0), (-4.0, 4.0), 3.0);
    for k in 0..4 {
        let x = 4.0 + 0.35 * f64::from(k);
        let y = -3.0 + 1.5 * f64::from(k);
        world.wall((x, y), (x, y + 1.2), 0.0, 1.8);
    }
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 7);
    for k in 0..6 {
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        drive.slide(&step(0.3, 0.05, 2.0), &shift(0.04 * sign, 0.03, 0.6 * sign));
        drive.look();
    }
    assert_eq!(drive.wrong, 0);
    assert!(drive.error().0 < 0.01, "{:?}", drive.error());
}

/// Rooms that repeat every 6 m along a corridor, but for a cupboard in every second one.
fn repeated_rooms() -> World {
    let mut world = World::default();
    world.level((-20.0, 20.0), (-8.0, 8.0), 0.0, true);
    world.level((-20.0, 20.0), (-8.0, 8.0), 2.5, false);
    for k in -3..3 {
        let x = 6.0 * f64::from(k);
        // Partition with two faces, back wall, door wall with a doorway of 1.2 m in the middle.
        world.wall((x + 0.1, 6.0), (x + 0.1, 1.2), 0.0, 2.5);
        world.wall((x - 0.1, 1.2), (x - 0.1, 6.0), 0.0, 2.5);
        world.wall((x + 5.9, 6.0), (x + 0.1, 6.0), 0.0, 2.5);
        for (a, b) in [(0.1, 2.4), (3.6, 5.9)] {
            world.wall((x + a, 1.3), (x + b, 1.3), 0.0, 2.5);
            world.wall((x + b, 1.2), (x + a, 1.2), 0.0, 2.5);
        }
        if k % 2 == 0 {
            world.block((x + 4.6, 4.9), (1.2, 0.6, 1.6), 0.0);
        }
    }
    // The corridor's other side.
    world.wall((-20.0, -1.2), (20.0, -1.2), 0.0, 2.5);
    world
}

#[test]
fn a_room_like_the_one_before_is_not_taken_for_it() {
    let world = repeated_rooms();
    let noise = OdometryNoise::default();
    for seed in 0..10 {
        // From within one room out of its door, along the corridor, into the next and about.
        let start = Isometry3::new(Vector3::new(3.0, 3.5, 0.0), Vector3::z() * -1.57);
        let mut drive = Drive::begin(&world, config(), start, 40 + seed);
        let turns = [
            step(0.0, 0.0, 90.0),
            step(0.0, 0.0, 90.0),
            step(0.0, 0.0, 90.0),
            step(0.0, 0.0, 90.0),
            step(3.5, 0.0, 0.0),
            step(0.0, 0.0, 90.0),
            step(3.0, 0.0, 0.0),
            step(3.0, 0.0, 90.0),
            step(3.5, 0.0, 0.0),
            step(0.0, 0.0, 90.0),
            step(0.0, 0.0, 90.0),
        ];
        for turn in turns {
            drive.go(&turn, &noise);
        }
        assert_eq!(drive.wrong, 0, "seed {seed}");
        // Wheels alone leave the way along the corridor open by half a metre; a room's length is
        // more than its covariance can explain. 99.9 % of χ² with six degrees of freedom.
        assert!(drive.nees() < 22.46, "seed {seed}: {} at {:?}", drive.nees(), drive.error());
    }
}

/// A push that odometry did not see, in a room that was seen well: the scan itself says so.
#[test]
fn a_push_that_no_sensor_felt_is_found_out() {
    let world = furnished_room();
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 9);
    for _ in 0..3 {
        drive.slide(&step(0.4, 0.0, 4.0), &NO_ERROR);
        drive.look();
    }
    drive.slide(&step(0.4, 0.0, 0.0), &shift(0.45, -0.3, 4.0));
    drive.look();
    for _ in 0..3 {
        drive.slide(&step(0.3, 0.0, 0.0), &NO_ERROR);
        drive.look();
    }
    let (metres, radians) = drive.error();
    assert!(metres < 0.01 && radians < 0.003, "{metres} m, {radians} rad");
    assert_eq!(drive.wrong, 0);
}

/// A floor 1 m above another is not the same floor seen again, however odd the pose.
#[test]
fn an_upper_floor_is_not_the_lower_one() {
    let mut world = World::default();
    world.room((-4.0, 10.0), (-4.0, 4.0), 3.5);
    world.level((5.0, 10.0), (-4.0, 4.0), 0.8, true);
    let mut drive = Drive::begin(&world, config(), Isometry3::identity(), 10);
    for _ in 0..2 {
        drive.slide(&step(1.0, 0.0, 0.0), &NO_ERROR);
        drive.look();
    }
    // Up a ramp that is not in the world: the inertial unit felt it.
    let up = Isometry3::translation(4.0, 0.0, 0.8);
    drive.truth *= up;
    drive.mapper.predict(&up, MotionSource::InertialTurn);
    drive.look();
    assert_eq!(drive.wrong, 0);
    let height_m = drive.mapper.world_from_robot().translation.z;
    assert!((height_m - 0.8).abs() < 0.02, "{height_m}");
}
