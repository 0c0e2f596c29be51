//! A hall that only its columns and a ball fix along its length.

use super::drive::step;
use super::world::{World, drawn6, normal, rng};
use nalgebra::{
    Isometry3, Matrix4, Point3, Translation3, UnitQuaternion, Vector3, Vector4, Vector6,
};
use rand_pcg::Pcg64;
use usar_agent::mapping::perturbation::{perturbed_pose, pose_error};
use usar_agent::mapping::{
    CurveKind, CurvedObservation, Mapper, MapperConfig, Motion, MotionSource, OdometryNoise,
    UpdateReport, curve_error_jacobian,
};

/// Spacing of the columns along the hall in metres.
const SPACING_M: f64 = 6.0;

struct Hall {
    walls: World,
    /// Where columns stand and how thick they are.
    columns: Vec<(f64, f64, f64)>,
    balls: Vec<(Vector3<f64>, f64)>,
}

impl Hall {
    fn new() -> Self {
        let mut walls = World::default();
        walls.level((-60.0, 100.0), (-6.0, 6.0), 0.0, true);
        walls.wall((-60.0, -6.0), (100.0, -6.0), 0.0, 3.0);
        walls.wall((100.0, 6.0), (-60.0, 6.0), 0.0, 3.0);
        let places = (0..12).map(|i| SPACING_M * f64::from(i) - 9.0);
        let columns = places.flat_map(|x| [(x, -3.0, 0.25), (x, 3.0, 0.25)]).collect();
        Self { walls, columns, balls: Vec::new() }
    }

    /// The curves that show ahead within 12 m, with noise drawn from their covariances.
    fn curves(&self, truth: &Isometry3<f64>, rng: &mut Pcg64) -> Vec<CurvedObservation> {
        let ahead = |p: &Vector3<f64>| p.x > 0.5 && p.y.abs() < 1.5 * p.x && p.norm() < 12.0;
        let mut seen = Vec::new();
        for &(x, y, radius_m) in &self.columns {
            let frame = truth.inverse() * Isometry3::translation(x, y, 1.0);
            if ahead(&frame.translation.vector) {
                let sigma = Vector4::new(0.008, 0.005, 0.006, 0.006);
                let covariance = Matrix4::from_diagonal(&sigma.component_mul(&sigma));
                let kind = CurveKind::Cylinder;
                seen.push(drawn(kind, frame, covariance, (radius_m, 2.0), rng));
            }
        }
        for (centre, radius_m) in &self.balls {
            let at = truth.inverse() * Point3::from(*centre);
            if ahead(&at.coords) {
                let covariance = Matrix4::from_diagonal(&Vector4::new(6.4e-5, 2.5e-5, 2.5e-5, 1.0));
                let frame = Isometry3::from(Translation3::from(at.coords));
                seen.push(drawn(CurveKind::Sphere, frame, covariance, (*radius_m, 0.0), rng));
            }
        }
        seen
    }
}

fn drawn(
    kind: CurveKind,
    frame: Isometry3<f64>,
    covariance: Matrix4<f64>,
    (radius_m, length_m): (f64, f64),
    rng: &mut Pcg64,
) -> CurvedObservation {
    let error = Vector4::from_fn(|i, _| covariance[(i, i)].sqrt() * normal(rng));
    let error = match kind {
        CurveKind::Cylinder => Isometry3::from_parts(
            Translation3::new(error.x, error.y, 0.0),
            UnitQuaternion::from_scaled_axis(Vector3::new(-error[3], error[2], 0.0)),
        ),
        CurveKind::Sphere => Isometry3::translation(error.x, error.y, error.z),
    };
    CurvedObservation {
        kind,
        robot_from_curve: frame * error,
        covariance,
        radius_m: radius_m + 0.004 * normal(rng),
        radius_sigma_m: 0.004,
        length_m,
        points: 100,
        rms_m: 0.003,
    }
}

struct Walk<'a> {
    hall: &'a Hall,
    mapper: Mapper,
    truth: Isometry3<f64>,
    rng: Pcg64,
}

impl<'a> Walk<'a> {
    fn begin(hall: &'a Hall, odometry: OdometryNoise, seed: u64) -> Self {
        let config = MapperConfig { odometry, ..MapperConfig::default() };
        let start = Isometry3::identity();
        let mapper = Mapper::new(config, start);
        let mut walk = Self { hall, mapper, truth: start, rng: rng(seed) };
        walk.look();
        walk
    }

    fn look(&mut self) -> UpdateReport {
        let (mut scan, _) = self.hall.walls.observe(&self.truth, Some(&mut self.rng));
        scan.curves = self.hall.curves(&self.truth, &mut self.rng);
        self.mapper.observe(&scan)
    }

    fn slide(&mut self, told: &Isometry3<f64>, error: &Vector6<f64>) {
        self.truth *= perturbed_pose(told, error);
        self.mapper.predict(told, MotionSource::Wheels);
    }

    fn error(&self) -> Vector6<f64> {
        pose_error(&self.mapper.world_from_robot(), &self.truth)
    }
}

fn ahead(metres: f64) -> Vector6<f64> {
    Vector6::new(metres, 0.0, 0.0, 0.0, 0.0, 0.0)
}

fn wheels() -> OdometryNoise {
    OdometryNoise { position_per_m: 0.2, ..OdometryNoise::default() }
}

#[test]
fn columns_fix_a_hall_along_its_length() {
    let hall = Hall::new();
    let mut walk = Walk::begin(&hall, wheels(), 1);
    for k in 0..20 {
        walk.slide(&step(1.5, 0.0, 0.0), &ahead(if k % 3 == 0 { 0.4 } else { -0.3 }));
        let report = walk.look();
        assert!(report.curves_known >= 2, "look {k}: {report:?}");
        assert_eq!(report.curves_refused, 0, "look {k}");
        assert!(walk.error().norm() < 0.02, "look {k}: {}", walk.error());
        assert!(report.weak_directions.is_empty(), "look {k}: {:?}", report.weak_directions);
    }
    // Each column once, and nothing else.
    let curves = walk.mapper.curves();
    assert!(curves.len() <= hall.columns.len(), "{}", curves.len());
    for curve in curves {
        let at = curve.world_from_curve.translation.vector;
        let gap = |c: &(f64, f64, f64)| (c.0 - at.x).hypot(c.1 - at.y);
        let nearest = hall.columns.iter().map(gap).fold(f64::INFINITY, f64::min);
        assert!(nearest < 0.03, "{at}");
        assert!((curve.radius_m - 0.25).abs() < 0.01, "{}", curve.radius_m);
    }
}

/// The same without columns: nothing speaks for the length, and the filter says so.
#[test]
fn without_columns_the_length_stays_open() {
    let hall = Hall { columns: Vec::new(), ..Hall::new() };
    let mut walk = Walk::begin(&hall, wheels(), 1);
    walk.slide(&step(1.5, 0.0, 0.0), &ahead(0.4));
    let report = walk.look();
    assert!(walk.error()[0].abs() > 0.3, "{}", walk.error());
    assert_eq!(report.weak_directions.len(), 1, "{:?}", report.weak_directions);
    assert!(report.weak_directions[0].direction[0] > 0.9);
}

/// A pose that is open by half the columns' spacing fits two of them.
#[test]
fn a_row_of_columns_is_not_counted_where_it_could_be_shifted_by_one() {
    let hall = Hall::new();
    let noise = OdometryNoise { position_per_m: 1.0, ..OdometryNoise::default() };
    let mut walk = Walk::begin(&hall, noise, 3);
    let known = walk.mapper.curves().len();
    walk.slide(&step(4.0, 0.0, 0.0), &ahead(2.6));
    let report = walk.look();
    assert_eq!((report.curves_known, report.curves_new), (0, 0), "{report:?}");
    assert!(report.curves_refused >= 2, "{report:?}");
    assert_eq!(walk.mapper.curves().len(), known);
}

/// A hall so large that no wall is in sight, its columns at `places`.
fn open_hall(places: &[(f64, f64)]) -> Hall {
    let mut walls = World::default();
    walls.level((-60.0, 60.0), (-60.0, 60.0), 0.0, true);
    let columns = places.iter().map(|&(x, y)| (x, y, 0.25)).collect();
    Hall { walls, columns, balls: Vec::new() }
}

/// By itself each of them could be one of several, as far as wheels tell that are off by a third of a metre and more.
#[test]
fn columns_are_known_by_how_they_stand_to_one_another() {
    let places = [(3.0, -1.0), (4.2, 2.0), (6.0, -2.5), (7.5, 0.6), (9.0, 3.5), (10.5, -4.0)];
    let hall = open_hall(&places);
    let mut walk = Walk::begin(&hall, OdometryNoise::default(), 7);
    for k in 0..5 {
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        let error = Vector6::new(0.1 * sign, -0.12 * sign, 0.0, 0.0, 0.0, 0.09 * sign);
        walk.slide(&step(0.4, 0.0, 0.0), &error);
        let report = walk.look();
        assert!(report.curves_known >= 4, "look {k}: {report:?}");
        assert!(walk.error().norm() < 0.02, "look {k}: {}", walk.error());
    }
    assert_eq!(walk.mapper.curves().len(), places.len());
}

/// Of a grid all are as far from one another wherever the robot stands.
#[test]
fn columns_in_a_grid_are_no_constellation_where_it_could_be_shifted() {
    let places: Vec<(f64, f64)> = (0..6)
        .flat_map(|i| (-3..4).map(move |j| (2.0 * f64::from(i) + 2.5, 2.0 * f64::from(j))))
        .collect();
    let hall = open_hall(&places);
    let noise = OdometryNoise { position_per_m: 0.5, ..OdometryNoise::default() };
    let mut walk = Walk::begin(&hall, noise, 8);
    walk.slide(&step(2.0, 0.0, 0.0), &ahead(1.0));
    let report = walk.look();
    assert_eq!(report.curves_known, 0, "{report:?}");
}

#[test]
fn balls_fix_it_as_well() {
    let balls = (0..8).map(|i| (Vector3::new(5.0 * f64::from(i) + 4.0, 1.0, 0.3), 0.3)).collect();
    let hall = Hall { columns: Vec::new(), balls, ..Hall::new() };
    let mut walk = Walk::begin(&hall, wheels(), 5);
    for _ in 0..6 {
        walk.slide(&step(1.5, 0.0, 0.0), &ahead(-0.3));
        let report = walk.look();
        assert!(report.curves_known >= 1, "{report:?}");
        assert!(walk.error()[0].abs() < 0.03, "{}", walk.error());
    }
}

#[test]
fn errors_match_their_covariance() {
    let hall = Hall::new();
    let noise = OdometryNoise {
        position_per_m: 0.1,
        heading_per_m: 0.02,
        height_per_m: 0.02,
        attitude_per_m: 0.01,
        ..OdometryNoise::default()
    };
    let runs = 100;
    let mut nees = 0.0;
    for seed in 0..runs {
        let mut walk = Walk::begin(&hall, noise, 700 + seed);
        for _ in 0..6 {
            let told = step(1.0, 0.0, 0.0);
            let mut motion = Motion::default();
            motion.append(&told, MotionSource::Wheels);
            let error = drawn6(&mut walk.rng, &noise.covariance(&motion));
            walk.slide(&told, &error);
            walk.look();
        }
        let error = walk.error();
        let covariance = walk.mapper.covariance();
        let solved = covariance.cholesky().expect("a covariance is positive").solve(&error);
        nees += error.dot(&solved) / runs as f64;
    }
    let band = 1.96 * (2.0 * 6.0 / runs as f64).sqrt();
    assert!((nees - 6.0).abs() < band, "{nees:.2}, expected 6 ± {band:.2}");
}

/// A tilt that is off by a constant carries everything about the scan's y axis.
#[test]
fn an_axis_goes_along_with_the_errors_of_its_scan() {
    let scan = Isometry3::translation(0.0, 0.0, 0.6);
    let frame = Isometry3::new(Vector3::new(4.0, 1.0, 1.4), Vector3::new(0.1, -0.05, 0.3));
    let mut seen = drawn(CurveKind::Cylinder, frame, Matrix4::identity(), (0.2, 1.6), &mut rng(1));
    seen.robot_from_curve = frame;
    let by_tilt = curve_error_jacobian(&seen, &scan).column(0).into_owned();
    let small = 1e-5;
    let turned = scan * Isometry3::rotation(Vector3::y() * small) * scan.inverse() * frame;
    let change = frame.inverse() * turned;
    let direction = change.rotation * Vector3::z();
    let pierced = change.translation.vector.xy() - direction.xy() * change.translation.vector.z;
    let expected = Vector4::new(pierced.x, pierced.y, direction.x, direction.y) / small;
    assert!((by_tilt - expected).norm() < 1e-3, "{by_tilt} {expected}");
}
