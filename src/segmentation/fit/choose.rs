//! Which of the three shapes a region is, by a penalised residual.

use super::super::config::ShapeLimits;
use super::super::noise::ReadingErrors;
use super::cylinder::{CylinderFit, fit_cylinder, improve_cylinder, settle_cylinder};
use super::plane::fit_plane;
use super::reach::{are_within, beyond_arc, beyond_cap, heights};
use super::round::{capped_error_of, mean_square_distance_of};
use super::sphere::{SphereFit, fit_sphere, improve_sphere, settle_sphere};
use super::{CAP, Fitted, Model, PlaneFit, Readings};
use super::{cylinder, sphere};
use nalgebra::{Matrix4, Matrix5, Point3, Unit, Vector3};

/// Excess of a plane's mean square error that imperfect surfaces and a wrong noise level explain.
const IMPERFECT: f64 = 0.05;
/// Share of a curved surface's mean square error on a plane below which it is none, and the greatest
/// mean square error for which that holds: beyond it errors may be cut.
const BENT: f64 = 0.3;
const MOST_BENT: f64 = 4.0;
/// Length, in radii of its cylinder, from which on a drum is no ball: two, and what noise adds.
const LONGEST_BALL: f64 = 2.5;
/// What a curved surface has more parameters than.
const PLANE_PARAMETERS: f64 = 3.0;

/// The model that explains the readings at the least cost, and its mean square error.
///
/// The cost is the sum of squared errors, each cut at [`CAP`], plus `k ln n` for k parameters: the
/// Bayesian information criterion with outliers. `axes` are candidates for a cylinder's axis.
pub(in super::super) fn choose(
    readings: &mut Readings,
    axes: &[Vector3<f64>],
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> (Fitted, f64) {
    let plane = fit_plane(readings);
    let readings = &*readings;
    let mut best = (f64::INFINITY, Fitted::Other, f64::INFINITY);
    let mut offer = |fitted: Fitted, model: &Model| {
        let error = capped_error(readings, model);
        let cost = error / errors.patch + model.parameters() * (readings.len() as f64).ln();
        if cost < best.0 {
            best = (cost, fitted, error / readings.len() as f64);
        }
    };
    let flat = plane
        .as_ref()
        .is_some_and(|(plane, error)| is_flat(*error, readings.len(), plane, limits, errors));
    if let Some((plane, _)) = plane {
        let model = plane.model();
        offer(Fitted::Plane(plane), &model);
    }
    if !flat {
        let sphere = fit_sphere(readings, limits.max_radius_m);
        let sphere = sphere.filter(|s| sphere_is_seen(readings, s, limits, errors));
        if let Some(sphere) = sphere {
            let model = sphere.model();
            offer(fitted_sphere(sphere), &model);
        }
        let cylinder = fit_cylinder(readings, axes, limits.max_radius_m);
        if let Some(cylinder) = cylinder.filter(|c| cylinder_is_seen(readings, c, limits, errors)) {
            let model = cylinder.model();
            offer(bounded(readings, cylinder), &model);
        }
    }
    let (_, fitted, mean_square) = best;
    if mean_square > limits.max_mean_square {
        (Fitted::Other, mean_square)
    } else {
        (fitted, mean_square)
    }
}

/// A curved surface that was found before, settled on all readings along their rays; `None` where it
/// is not what all of them show, or no better than a plane that leaves the error `flat`, cut as the
/// cost is.
pub(in super::super) fn settle_known(
    readings: &Readings,
    model: &Model,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
    flat: f64,
) -> Option<Fitted> {
    // Few readings of a ball pass for a drum's.
    let ball = match model {
        Model::Cylinder { axis, radius_m, .. } => Some(readings)
            .filter(|readings| {
                let (low, high) = heights(readings, axis);
                high - low < LONGEST_BALL * radius_m
            })
            .and_then(|readings| fit_sphere(readings, limits.max_radius_m))
            .filter(|sphere| sphere_is_seen(readings, sphere, limits, errors))
            .map(|sphere| sphere.model()),
        Model::Plane { .. } | Model::Sphere { .. } => None,
    };
    let cost = |error: f64, model: &Model| {
        let worth = (model.parameters() - PLANE_PARAMETERS) * (readings.len() as f64).ln();
        error / errors.patch + worth
    };
    let now = |model: &Model| cost(capped_error(readings, model), model);
    let model = ball.as_ref().filter(|ball| now(ball) < now(model)).unwrap_or(model);
    let start = match *model {
        Model::Plane { .. } => return None,
        Model::Sphere { centre, radius_m } => {
            fitted_sphere(SphereFit { centre, radius_m, covariance: Matrix4::zeros() })
        }
        Model::Cylinder { foot, axis, radius_m } => {
            bounded(readings, CylinderFit { foot, axis, radius_m, covariance: Matrix5::zeros() })
        }
    };
    let (fitted, error) = settle_curved(readings, start, limits, errors)?;
    let is_curved = matches!(fitted, Fitted::Sphere { .. } | Fitted::Cylinder { .. });
    (is_curved && cost(error, model) < flat / errors.patch).then_some(fitted)
}

/// The shape that a part of the readings chose, settled on all of them along their rays; `None` where
/// it is not what all of them show.
pub(in super::super) fn settle(
    readings: &Readings,
    chosen: Fitted,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> Option<Fitted> {
    match chosen {
        Fitted::Plane(_) | Fitted::Other => Some(chosen),
        Fitted::Sphere { .. } | Fitted::Cylinder { .. } => {
            settle_curved(readings, chosen, limits, errors).map(|(fitted, _)| fitted)
        }
    }
}

/// The same of a sphere or a cylinder, with the sum of its squared errors, each cut at [`CAP`].
fn settle_curved(
    readings: &Readings,
    chosen: Fitted,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> Option<(Fitted, f64)> {
    let (fitted, model) = match chosen {
        Fitted::Sphere { centre, radius_m, .. } => {
            let sphere = settle_sphere(readings, (centre.coords, radius_m))?;
            let model = sphere.model();
            (
                sphere_is_seen(readings, &sphere, limits, errors).then(|| fitted_sphere(sphere))?,
                model,
            )
        }
        Fitted::Cylinder { axis_point, axis, radius_m, .. } => {
            let start = (axis_point.coords, axis.into_inner(), radius_m);
            let cylinder = settle_cylinder(readings, start)?;
            let model = cylinder.model();
            (
                cylinder_is_seen(readings, &cylinder, limits, errors)
                    .then(|| bounded(readings, cylinder))?,
                model,
            )
        }
        Fitted::Plane(_) | Fitted::Other => return None,
    };
    let error = capped_error(readings, &model);
    let mean_square = error / readings.len() as f64;
    Some((if mean_square > limits.max_mean_square { Fitted::Other } else { fitted }, error))
}

/// A sphere or cylinder, refined by a few rounds of errors across it.
pub(in super::super) fn improve_model(readings: &Readings, model: &Model) -> Option<Model> {
    match model {
        Model::Plane { .. } => None,
        Model::Sphere { centre, radius_m } => {
            improve_sphere(readings, (*centre, *radius_m)).map(|fit| fit.model())
        }
        Model::Cylinder { foot, axis, radius_m } => {
            improve_cylinder(readings, (*foot, *axis, *radius_m)).map(|fit| fit.model())
        }
    }
}

/// A sphere or cylinder that is nearly right, settled along the rays. One that is large, or seen from within,
/// must be seen as in the end it has to be: noise makes such of any strip.
pub(in super::super) fn settle_model(
    readings: &Readings,
    model: &Model,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> Option<Model> {
    match model {
        Model::Plane { .. } => None,
        Model::Sphere { centre, radius_m } => {
            let fit = settle_sphere(readings, (*centre, *radius_m))?;
            let common =
                fit.radius_m <= LARGE_M && !are_within(readings, &fit.centre, &Vector3::zeros());
            (common || sphere_is_seen(readings, &fit, limits, errors)).then(|| fit.model())
        }
        Model::Cylinder { foot, axis, radius_m } => {
            let fit = settle_cylinder(readings, (*foot, *axis, *radius_m))?;
            let common = fit.radius_m <= LARGE_M && !are_within(readings, &fit.foot, &fit.axis);
            (common || cylinder_is_seen(readings, &fit, limits, errors)).then(|| fit.model())
        }
    }
}

fn fitted_sphere(sphere: SphereFit) -> Fitted {
    let SphereFit { centre, radius_m, covariance } = sphere;
    Fitted::Sphere { centre: Point3::from(centre), radius_m, covariance }
}

fn capped_error(readings: &Readings, model: &Model) -> f64 {
    let round = match model {
        Model::Sphere { centre, radius_m } => sphere::round_of(centre, *radius_m),
        Model::Cylinder { foot, axis, radius_m } => cylinder::round_of(foot, axis, *radius_m),
        Model::Plane { .. } => {
            let errors = readings
                .every(1)
                .map(|(point, ray, per_sigma)| model.error(&point, &ray, 1.0 / per_sigma));
            return errors.map(|e| (e * e).min(CAP * CAP)).sum();
        }
    };
    capped_error_of(readings, round)
}

/// Mean square of the distances of the readings from a sphere or a cylinder, in m²; `None` for others.
pub(in super::super) fn mean_square_distance(readings: &Readings, fitted: &Fitted) -> Option<f64> {
    let round = match fitted {
        Fitted::Sphere { centre, radius_m, .. } => sphere::round_of(&centre.coords, *radius_m),
        Fitted::Cylinder { axis_point, axis, radius_m, .. } => {
            cylinder::round_of(&axis_point.coords, axis, *radius_m)
        }
        Fitted::Plane(_) | Fitted::Other => return None,
    };
    Some(mean_square_distance_of(readings, round))
}

/// Whether `count` errors on a plane, whose squares cut at [`CAP`]² sum up to `error`, are not those
/// of a curved surface, so that no other shape needs to be tried.
///
/// They are not if they are noise. Nor if they are small for the region's size: a chord w of an arc
/// of half angle α has a sagitta of w/2 · tan(α/2), of which a plane leaves 0.3 root mean square, and
/// the arc that must be seen is given.
pub(in super::super) fn is_flat(
    error: f64,
    count: usize,
    plane: &PlaneFit,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> bool {
    // Readings that are worth one each.
    let n = (count as f64 / errors.patch).max(1.0);
    let half_arc = (0.5 * limits.min_arc_deg).min(limits.min_cap_deg).to_radians();
    let bend = 0.15 * plane.width_m * (0.5 * half_arc).tan() / plane.sigma_m;
    let excess = (3.0 * (2.0 / n).sqrt()).max(IMPERFECT).max((BENT * bend * bend).min(MOST_BENT));
    error < count as f64 * (1.0 + excess)
}

/// Radius in metres beyond which a vault, a round room or the bend of a corridor is seen in part only, and
/// no least arc is asked for but that the radius is determined: to this share of it, three deviations.
const LARGE_M: f64 = 2.0;
const DETERMINED_SHARE: f64 = 0.03;

/// Whether a radius is large, and as well known as its variance by readings that err each for itself says.
fn is_determined(radius_m: f64, variance_m2: f64, errors: &ReadingErrors) -> bool {
    let sigma_m = (variance_m2.max(0.0) * errors.inflation).sqrt();
    radius_m > LARGE_M && 3.0 * sigma_m < DETERMINED_SHARE * radius_m
}

/// The angle at the centre between the middle of the cap and its border, both robust: the border is
/// that of 95 % of the readings.
fn sphere_is_seen(
    readings: &Readings,
    sphere: &SphereFit,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> bool {
    if sphere.radius_m > limits.max_radius_m {
        return false;
    }
    if is_determined(sphere.radius_m, sphere.covariance[(3, 3)], errors) {
        return true;
    }
    let middle = (readings.centroid() - sphere.centre).normalize();
    let outside = limits.min_cap_deg.to_radians().cos();
    let beyond = beyond_cap(readings, &sphere.centre, &middle, outside);
    beyond * 20 >= readings.len()
}

fn cylinder_is_seen(
    readings: &Readings,
    cylinder: &CylinderFit,
    limits: &ShapeLimits,
    errors: &ReadingErrors,
) -> bool {
    if cylinder.radius_m > limits.max_radius_m {
        return false;
    }
    if is_determined(cylinder.radius_m, cylinder.covariance[(4, 4)], errors) {
        return true;
    }
    let radial = |p: &Vector3<f64>| {
        let d = p - cylinder.foot;
        d - cylinder.axis * cylinder.axis.dot(&d)
    };
    let middle = radial(&readings.centroid());
    let side = cylinder.axis.cross(&middle);
    let half_arc = (0.5 * limits.min_arc_deg.to_radians()).sin_cos();
    // Each side of the middle must reach half the arc, which is a right angle at most, with 2 % of
    // the readings.
    let [left, right] = beyond_arc(readings, &cylinder.foot, [&middle, &side], half_arc);
    left * 50 >= readings.len() && right * 50 >= readings.len()
}

/// The cylinder with the extent of the readings along its axis.
fn bounded(readings: &Readings, cylinder: CylinderFit) -> Fitted {
    let CylinderFit { foot, axis, radius_m, covariance } = cylinder;
    let (low, high) = heights(readings, &axis);
    let (low, high) = (low - axis.dot(&foot), high - axis.dot(&foot));
    let middle = 0.5 * (low + high);
    // The offset at the middle is that at the foot and what the tilt adds on the way.
    let mut at_middle = Matrix5::identity();
    at_middle[(0, 2)] = middle;
    at_middle[(1, 3)] = middle;
    let covariance = at_middle * covariance * at_middle.transpose();
    Fitted::Cylinder {
        axis_point: Point3::from(foot + axis * middle),
        axis: Unit::new_normalize(axis),
        radius_m,
        length_m: high - low,
        covariance,
    }
}
