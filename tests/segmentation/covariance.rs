//! Covariances of the fits against their errors over many noisy scans of known surfaces.

use super::scanner::{Noise, Scanner, scan};
use super::world::{Random, Solid, World, pose};
use nalgebra::{Matrix3, Point3, SMatrix, SVector, Unit, Vector3};
use usar_agent::segmentation::{SegmentationConfig, Segmenter, Shape, Surface};

const RUNS: u64 = 150;

/// The mean normalised estimation error squared over the runs, one reading of the surface that has
/// most points in each, must lie where the χ² distribution puts it with seven deviations' room; the
/// noise itself is estimated, by about 3 %.
fn assert_consistent<const N: usize>(
    world: &World,
    error: impl Fn(&Surface) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>)>,
) {
    let mut segmenter = Segmenter::new(SegmentationConfig::default());
    let scanner = Scanner::nodding(90, 61, [-11.0, 11.0], [30.0, -30.0], [0.0, 0.0]);
    let mut sum = 0.0;
    for run in 0..RUNS {
        let mut random = Random(0xC0_0000 + run);
        let noise = Noise { dropouts: 0.01, ..Noise::of(0.01) };
        let scan = scan(world, &pose([0.0; 3], 0.0, 0.0, 0.0), &scanner, noise, &mut random);
        let result = segmenter.segment(&scan.grid);
        let largest = result.surfaces.iter().max_by_key(|surface| surface.points).unwrap();
        let (e, covariance) = error(largest)
            .unwrap_or_else(|| panic!("run {run} found another shape: {:?}", largest.shape));
        assert!((covariance - covariance.transpose()).norm() <= 1e-9 * covariance.norm());
        let weighted = covariance.cholesky().expect("a positive covariance").solve(&e);
        let nees = e.dot(&weighted);
        assert!(nees >= 0.0, "run {run}: {covariance}");
        sum += nees;
    }
    let freedom = N as f64;
    let mean = sum / RUNS as f64;
    let deviation = (2.0 * freedom / RUNS as f64).sqrt();
    assert!(
        (mean - freedom).abs() < 4.0 * deviation + 0.06 * freedom,
        "mean NEES {mean:.2} of {freedom} degrees of freedom"
    );
}

/// Errors of a patch against the true plane: offset at its origin, rotation about its y and x.
fn plane_error(
    surface: &Surface,
    normal: Vector3<f64>,
    offset_m: f64,
) -> Option<(SVector<f64, 3>, Matrix3<f64>)> {
    let Shape::Plane(patch) = &surface.shape else { return None };
    let local = patch.grid_from_plane;
    let n = local.inverse_transform_vector(&normal);
    let n = if n.z < 0.0 { -n } else { n };
    let gap = offset_m - normal.dot(&local.translation.vector);
    let gap = if local.inverse_transform_vector(&normal).z < 0.0 { -gap } else { gap };
    // A turn by θ about y moves the normal by θ along x, one by ψ about x by -ψ along y.
    Some((SVector::<f64, 3>::new(gap, n.x, -n.y), patch.covariance))
}

#[test]
fn the_covariance_of_a_wall_is_that_of_its_errors() {
    let mut world = World::default();
    let normal = Vector3::new(-0.8, 0.5, 0.33).normalize();
    let centre = Vector3::new(3.0, 0.0, 0.0);
    let (u, v) = (normal.cross(&Vector3::z()).normalize() * 3.0, normal.cross(&Vector3::y()));
    let along: f64 = u.dot(&v) / u.norm_squared();
    let v: Vector3<f64> = v - u * along;
    let v = v.normalize() * 2.0;
    let origin = centre - 0.5 * (u + v);
    world.patch(origin.into(), u.into(), v.into());
    let offset = normal.dot(&centre);
    assert_consistent(&world, |surface| plane_error(surface, normal, offset));
}

#[test]
fn the_covariance_of_a_grazing_floor_is_that_of_its_errors() {
    let mut world = World::default();
    world.patch([1.0, -2.0, -0.6], [6.0, 0.0, 0.0], [0.0, 4.0, 0.0]);
    assert_consistent(&world, |surface| plane_error(surface, Vector3::z(), -0.6));
}

/// Errors of a cylinder against the true one, in the frame that its covariance is documented to have.
fn cylinder_error(
    surface: &Surface,
    (foot, axis, radius_m): (Point3<f64>, Unit<Vector3<f64>>, f64),
) -> Option<(SVector<f64, 5>, SMatrix<f64, 5, 5>)> {
    let Shape::Cylinder(found) = &surface.shape else { return None };
    let axis_found = found.axis.into_inner();
    let mut least = Vector3::zeros();
    least[axis_found.iamin()] = 1.0;
    let e1 = axis_found.cross(&least).normalize();
    let e2 = axis_found.cross(&e1);
    let truth = if axis.dot(&axis_found) < 0.0 { -axis.into_inner() } else { axis.into_inner() };
    // The true axis where it passes the plane across the found one at its middle.
    let from = foot - found.axis_point;
    let at = from - truth * (axis_found.dot(&from) / axis_found.dot(&truth));
    let tilt = truth / axis_found.dot(&truth) - axis_found;
    let e = [e1.dot(&at), e2.dot(&at), e1.dot(&tilt), e2.dot(&tilt), radius_m - found.radius_m];
    Some((SVector::<f64, 5>::from(e), found.covariance))
}

#[test]
fn the_covariance_of_a_drum_is_that_of_its_errors() {
    let mut world = World::default();
    let (foot, axis) =
        (Point3::new(2.6, -0.2, -1.5), Unit::new_normalize(Vector3::new(0.1, 0.15, 1.0)));
    world.drum(foot.coords.into(), axis.into_inner().into(), 0.3, 3.0);
    assert_consistent(&world, |surface| cylinder_error(surface, (foot, axis, 0.3)));
}

/// A round room, and a vault whose axis lies: both are seen from within, a part of the circle each.
#[test]
fn the_covariance_of_a_cylinder_seen_from_within_is_that_of_its_errors() {
    for (foot, axis, radius) in [
        (Point3::new(-1.0, 0.8, -3.0), Vector3::new(0.05, 0.0, 1.0), 4.0),
        (Point3::new(-9.0, -3.0, -0.5), Vector3::new(1.0, 0.3, 0.02), 2.5),
    ] {
        let axis = Unit::new_normalize(axis);
        let mut world = World::default();
        let tube = Solid::Tube { foot, axis: axis.into_inner(), radius, length: 30.0 };
        world.solids.push(tube);
        assert_consistent(&world, |surface| cylinder_error(surface, (foot, axis, radius)));
    }
}

#[test]
fn the_covariance_of_a_dome_is_that_of_its_errors() {
    let mut world = World::default();
    let centre = Point3::new(0.5, 0.2, -0.4);
    world.ball(centre.coords.into(), 3.0);
    assert_consistent(&world, |surface| {
        let Shape::Sphere(found) = &surface.shape else { return None };
        let e = centre - found.centre;
        Some((SVector::<f64, 4>::new(e.x, e.y, e.z, 3.0 - found.radius_m), found.covariance))
    });
}

#[test]
fn the_covariance_of_a_ball_is_that_of_its_errors() {
    let mut world = World::default();
    let centre = Point3::new(2.2, 0.3, -0.1);
    world.ball(centre.coords.into(), 0.4);
    assert_consistent(&world, |surface| {
        let Shape::Sphere(found) = &surface.shape else { return None };
        let e = centre - found.centre;
        Some((SVector::<f64, 4>::new(e.x, e.y, e.z, 0.4 - found.radius_m), found.covariance))
    });
}
