//! Which way is up, told by what was built upright.
//!
//! A robot that is set down on a slope or with a wheel on a board comes to rest tilted, and nothing on the wire
//! tells it: the server was asked for a level robot, and an inertial unit that begins to count while the robot
//! still settles has missed it. But walls stand upright and floors lie level: one direction to which several of
//! them agree is the vertical.

use super::observation::Observation;
use nalgebra::{Matrix3, Unit, Vector3};

/// A robot that stands tilts no farther than this, in radians.
const STEEPEST_RAD: f64 = 0.45;
/// How far off upright or level a surface that was built so is seen, in radians: errors of the head among it.
const TOLERANCE_RAD: f64 = 0.009;
/// Patches below this area tell no direction well, in m²; of the others no more than the greatest are asked.
const LEAST_M2: f64 = 0.3;
const ASKED: usize = 32;
/// A floor that tells alone how the robot stands, in m².
const LEAST_FLOOR_M2: f64 = 2.0;
/// Two walls cross at an angle of at least this sine.
const CROSSING: f64 = 0.35;
/// Surfaces that only the vertical explains, where the slope under the robot is the greatest of all.
const ACROSS: usize = 3;
/// The rise of a normal up to which a surface may be a wall seen by a robot that stands tilted.
const STEEP: f64 = 0.5;
/// Share of the area asked that agrees to the vertical, and the share of that at most which agrees to the
/// direction that was taken for up before.
const AGREED: f64 = 0.6;
const BEFORE: f64 = 0.7;

/// What one surface says about a direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Says {
    Upright,
    Level,
}

/// The vertical in the frame of `observations`, the robot's, if they tell that it is not `assumed`.
///
/// It is told where two walls that cross agree with each other and with a third surface, wall or floor, so that
/// nothing is told of a ramp and the floor beside it; and where much less agrees to `assumed`. Of a slope that the
/// robot stands on three walls tell, or several surfaces that only the vertical explains. Where too few walls are in
/// sight the floor tells it, if nothing lies level beside it: who stands level before a ramp sees the ground that he
/// stands on.
pub fn upright(
    observations: &[Observation],
    assumed: &Unit<Vector3<f64>>,
) -> Option<Unit<Vector3<f64>>> {
    let mut asked: Vec<(Vector3<f64>, f64)> = observations
        .iter()
        .map(|seen| (seen.normal(), seen.area_m2()))
        .filter(|(_, area_m2)| *area_m2 >= LEAST_M2)
        .collect();
    asked.sort_by(|a, b| b.1.total_cmp(&a.1));
    asked.truncate(ASKED);
    let tell = |asked: &[(Vector3<f64>, f64)], up: &Unit<Vector3<f64>>| {
        let area_m2: f64 = asked.iter().map(|(_, area_m2)| area_m2).sum();
        let by_up_m2 = agreed_m2(asked, up);
        by_up_m2 >= AGREED * area_m2 && agreed_m2(asked, assumed) <= BEFORE * by_up_m2
    };
    // The ground lies along a robot that stands on a slope: of that only the walls know.
    let steep: Vec<(Vector3<f64>, f64)> =
        asked.iter().filter(|(normal, _)| normal.z.abs() < STEEP).copied().collect();
    let walls_tell = |up: &Unit<Vector3<f64>>| {
        let walls = steep.iter().filter(|(normal, _)| says(normal, up) == Some(Says::Upright));
        walls.count() > 2 && tell(&steep, up)
    };
    let by_walls =
        candidates(&asked).max_by(|a, b| agreed_m2(&asked, a).total_cmp(&agreed_m2(&asked, b)));
    let best = by_walls
        .map(|best| refined(&asked, &refined(&asked, &best)))
        .filter(|up| is_fixed(&asked, up))
        .filter(|up| tell(&asked, up) || walls_tell(up) || stands_across(&asked, up, assumed));
    best.or_else(|| {
        let floor = refined(&asked, &floor(&asked)?);
        let lies = |(normal, _): &(Vector3<f64>, f64)| says(normal, assumed) == Some(Says::Level);
        (tell(&asked, &floor) && !asked.iter().any(lies)).then_some(floor)
    })
}

/// Whether a robot stands on a slope whose walls are in sight hardly or along it: what agrees to both directions says
/// nothing, and that the ground lies along the robot it would at any slope. What is left must be several surfaces, a
/// wall among them, none of them a wall that stands as was assumed.
fn stands_across(
    asked: &[(Vector3<f64>, f64)],
    up: &Unit<Vector3<f64>>,
    assumed: &Unit<Vector3<f64>>,
) -> bool {
    let only = |by: &Unit<Vector3<f64>>, other: &Unit<Vector3<f64>>| {
        let agreeing = asked.iter().filter(|(normal, _)| says(normal, other).is_none());
        let agreeing = agreeing.filter_map(|(normal, area_m2)| Some((says(normal, by)?, *area_m2)));
        agreeing.collect::<Vec<_>>()
    };
    let (by_up, by_assumed) = (only(up, assumed), only(assumed, up));
    let area_m2 =
        |surfaces: &[(Says, f64)]| surfaces.iter().map(|(_, area_m2)| area_m2).sum::<f64>();
    let walls = |surfaces: &[(Says, f64)]| surfaces.iter().any(|(says, _)| *says == Says::Upright);
    by_up.len() >= ACROSS
        && walls(&by_up)
        && !walls(&by_assumed)
        && area_m2(&by_up) >= area_m2(&by_assumed)
}

/// The normal of the greatest surface that may be a floor, seen from above by a robot that stands on it.
fn floor(asked: &[(Vector3<f64>, f64)]) -> Option<Unit<Vector3<f64>>> {
    let may_be = |(normal, area_m2): &&(Vector3<f64>, f64)| {
        normal.z >= STEEPEST_RAD.cos() && *area_m2 >= LEAST_FLOOR_M2
    };
    asked.iter().find(may_be).map(|(normal, _)| Unit::new_normalize(*normal))
}

/// The directions at right angles to two walls, as far as a robot may stand so.
fn candidates(asked: &[(Vector3<f64>, f64)]) -> impl Iterator<Item = Unit<Vector3<f64>>> + '_ {
    let pairs = asked
        .iter()
        .enumerate()
        .flat_map(|(at, first)| asked[at + 1..].iter().map(move |second| first.0.cross(&second.0)));
    pairs.filter(|across| across.norm() >= CROSSING).filter_map(|across| {
        let up = Unit::new_normalize(if across.z < 0.0 { -across } else { across });
        (up.z >= STEEPEST_RAD.cos()).then_some(up)
    })
}

fn says(normal: &Vector3<f64>, up: &Unit<Vector3<f64>>) -> Option<Says> {
    if normal.dot(up).abs() <= TOLERANCE_RAD {
        Some(Says::Upright)
    } else if normal.cross(up).norm() <= TOLERANCE_RAD {
        Some(Says::Level)
    } else {
        None
    }
}

fn agreed_m2(asked: &[(Vector3<f64>, f64)], up: &Unit<Vector3<f64>>) -> f64 {
    asked.iter().filter(|(normal, _)| says(normal, up).is_some()).map(|(_, area_m2)| area_m2).sum()
}

/// Whether two walls that cross and a third surface that is beside neither agree to `up`.
fn is_fixed(asked: &[(Vector3<f64>, f64)], up: &Unit<Vector3<f64>>) -> bool {
    let agreeing = |what: Says| {
        asked.iter().filter(move |(normal, _)| says(normal, up) == Some(what)).map(|(n, _)| *n)
    };
    let cross = |a: &Vector3<f64>, b: &Vector3<f64>| a.cross(b).norm() >= CROSSING;
    let walls: Vec<Vector3<f64>> = agreeing(Says::Upright).collect();
    let crossing = walls.iter().skip(1).any(|wall| cross(&walls[0], wall));
    // Of two walls alone any pair agrees to something.
    crossing && (agreeing(Says::Level).next().is_some() || walls.len() > 2)
}

/// The direction to which all that agree to `up` fit best, by their areas.
fn refined(asked: &[(Vector3<f64>, f64)], up: &Unit<Vector3<f64>>) -> Unit<Vector3<f64>> {
    let mut scatter = Matrix3::zeros();
    for (normal, area_m2) in asked {
        let of_one = normal * normal.transpose() * *area_m2;
        match says(normal, up) {
            Some(Says::Upright) => scatter += of_one,
            Some(Says::Level) => scatter += Matrix3::identity() * *area_m2 - of_one,
            None => {}
        }
    }
    let eigen = scatter.symmetric_eigen();
    let found: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
    Unit::new_normalize(if found.dot(up) < 0.0 { -found } else { found })
}

#[cfg(test)]
mod tests {
    use super::super::mask::PlaneMask;
    use super::*;
    use nalgebra::{Isometry3, Point2, UnitQuaternion};
    use std::f64::consts::FRAC_PI_2;

    /// A square with sides of `side_m` and the normal `[x, y, z]`, seen by a robot that stands rolled and pitched
    /// by `tilt_rad`.
    fn seen(normal: [f64; 3], side_m: f64, tilt_rad: [f64; 2]) -> Observation {
        let z = Vector3::z();
        let in_world = UnitQuaternion::rotation_between(&z, &Vector3::from(normal))
            .unwrap_or_else(|| UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0));
        let robot_from_world =
            UnitQuaternion::from_euler_angles(tilt_rad[0], tilt_rad[1], 0.0).inverse();
        let half_m = 0.5 * side_m;
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        Observation {
            robot_from_plane: Isometry3::from_parts(
                Vector3::zeros().into(),
                robot_from_world * in_world,
            ),
            covariance: Matrix3::identity() * 1e-6,
            hull: corners.map(|(x, y)| Point2::new(half_m * x, half_m * y)).to_vec(),
            mask: PlaneMask::default(),
            points: 100,
            rms_m: 0.003,
        }
    }

    fn room(tilt_rad: [f64; 2]) -> Vec<Observation> {
        let heading = Vector3::new(0.4_f64.cos(), 0.4_f64.sin(), 0.0);
        let aside = UnitQuaternion::from_euler_angles(0.0, 0.0, FRAC_PI_2) * heading;
        vec![
            seen(heading.into(), 2.0, tilt_rad),
            seen(aside.into(), 3.0, tilt_rad),
            seen((-heading).into(), 1.5, tilt_rad),
            seen([0.0, 0.0, 1.0], 2.5, tilt_rad),
            // A board that leans.
            seen([0.9, 0.0, 0.436], 1.0, tilt_rad),
        ]
    }

    #[test]
    fn a_room_tells_how_a_robot_stands_that_was_thought_level() {
        for tilt_rad in [[0.05, -0.09], [-0.2, 0.02], [0.0, 0.3], [-0.02, 0.0]] {
            let up = upright(&room(tilt_rad), &Vector3::z_axis()).unwrap();
            let stands = UnitQuaternion::from_euler_angles(tilt_rad[0], tilt_rad[1], 0.0);
            assert!((stands * up).angle(&Vector3::z()) < 1e-6, "{tilt_rad:?}");
        }
    }

    #[test]
    fn a_level_robot_is_left_as_it_was() {
        assert_eq!(upright(&room([0.0; 2]), &Vector3::z_axis()), None);
        assert_eq!(upright(&room([0.004, -0.004]), &Vector3::z_axis()), None);
    }

    #[test]
    fn ramps_and_too_few_walls_tell_nothing() {
        let told = |seen: &[Observation]| upright(seen, &Vector3::z_axis());
        assert_eq!(told(&[]), None);
        // Two ramps and the floor before them.
        let ramp = seen([0.26, 0.0, 0.966], 3.0, [0.0; 2]);
        let other = seen([0.0, 0.2, 0.98], 3.0, [0.0; 2]);
        let floor = seen([0.0, 0.0, 1.0], 1.0, [0.0; 2]);
        assert_eq!(told(&[ramp, other, floor]), None);
        // Two walls that lean agree to a direction, and nothing else does.
        let lean = seen([0.98, 0.0, 0.2], 3.0, [0.0; 2]);
        let aslant = seen([0.0, 0.98, 0.2], 3.0, [0.0; 2]);
        assert_eq!(told(&[lean, aslant]), None);
        // One wall and a ramp beside it that it goes along with.
        let ramp = seen([0.26, 0.0, 0.966], 3.0, [0.0; 2]);
        let wall = seen([0.0, 1.0, 0.0], 3.0, [0.0; 2]);
        let ground = seen([0.0, 0.0, 1.0], 0.6, [0.0; 2]);
        assert_eq!(told(&[ramp, wall, ground]), None);
    }

    #[test]
    fn walls_tell_it_where_the_robot_stands_on_a_slope() {
        // Four walls, and the slope along which the robot stands is more than all of them.
        let tilt_rad = [0.0, 0.12];
        let mut seen_now: Vec<Observation> = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
            .map(|[x, y]| seen([x, y, 0.0], 2.0, tilt_rad))
            .into();
        seen_now.push(seen([0.0, 0.0, 1.0], 6.0, [0.0; 2]));
        let up = upright(&seen_now, &Vector3::z_axis()).unwrap();
        let stands = UnitQuaternion::from_euler_angles(tilt_rad[0], tilt_rad[1], 0.0);
        assert!((stands * up).angle(&Vector3::z()) < 1e-6);
    }

    #[test]
    fn a_robot_that_stands_across_a_slope_is_told_from_one_before_a_ramp() {
        let tilt_rad = [0.12, 0.0];
        // The wall ahead stands upright either way; level ground to both sides of the slope, and a bit of a wall.
        let across = [
            seen([-1.0, 0.0, 0.0], 5.0, tilt_rad),
            seen([0.0, 0.0, 1.0], 2.7, [0.0; 2]),
            seen([0.0, 0.0, 1.0], 2.5, tilt_rad),
            seen([0.0, 0.0, 1.0], 1.7, tilt_rad),
            seen([0.0, -1.0, 0.0], 1.0, tilt_rad),
        ];
        let up = upright(&across, &Vector3::z_axis()).unwrap();
        let stands = UnitQuaternion::from_euler_angles(tilt_rad[0], tilt_rad[1], 0.0);
        assert!((stands * up).angle(&Vector3::z()) < 1e-6);
        // A crate on a ramp, beside the wall along it.
        let before = [
            seen([0.0, 1.0, 0.0], 5.0, [0.0; 2]),
            seen([0.0, 0.0, 1.0], 3.0, [0.0; 2]),
            seen([0.0, 0.0, 1.0], 2.0, [0.0, 0.2]),
            seen([-1.0, 0.0, 0.0], 0.8, [0.0, 0.2]),
            seen([0.0, 0.0, 1.0], 0.6, [0.0, 0.2]),
        ];
        assert_eq!(upright(&before, &Vector3::z_axis()), None);
    }

    #[test]
    fn a_floor_tells_it_where_there_are_too_few_walls() {
        let tilt_rad = [0.1, 0.1];
        let floor = || seen([0.0, 0.0, 1.0], 3.0, tilt_rad);
        let wall = || seen([1.0, 0.0, 0.0], 3.0, tilt_rad);
        let stands = UnitQuaternion::from_euler_angles(tilt_rad[0], tilt_rad[1], 0.0);
        for seen in [vec![floor()], vec![floor(), wall()]] {
            let up = upright(&seen, &Vector3::z_axis()).unwrap();
            assert!((stands * up).angle(&Vector3::z()) < 1e-6);
        }
        // A ceiling alone does not.
        assert_eq!(upright(&[seen([0.0, 0.0, -1.0], 3.0, tilt_rad)], &Vector3::z_axis()), None);
    }
}
