//! A line of a tilted laser laid over the walls of the map: where a robot on its way is, beside what its wheels tell.
//!
//! Point to plane, over the ground only: height, roll and pitch stay as they were reckoned. What odometry tells is
//! the prior, so that along a corridor, of which walls say nothing, odometry is what is left.

use super::landmark::Landmark;
use crate::geometry::wrap_pi;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, UnitQuaternion, Vector3};

/// A surface whose normal leans by less than this is a wall, by more than the other the ground: sine.
const UPRIGHT: f64 = 0.1;
const LEVEL: f64 = 0.9;
/// How far beyond a wall's hull a point may still lie on it, in metres: hulls end where sweeps ended.
const BESIDE_M: f64 = 0.2;
/// How far a point may lie from its wall, in the first round and in the last, in metres.
const REACH_M: (f64, f64) = (0.4, 0.08);
const ROUNDS: usize = 10;
/// A robot is not put off by more than this at once, in metres.
const MOST_M: f64 = 0.3;
/// While walls are sought odometry is held with so many times its deviations; the last rounds weigh it as it is.
const LOOSE: f64 = 3.0;
const LAST_ROUNDS: usize = 3;
/// Least deviation of a point from its wall that is believed, in metres.
const LEAST_SIGMA_M: f64 = 0.01;
/// Neighbouring points err together, by what a wall is uneven and by what is known of it: so many count for one.
const TOGETHER: f64 = 8.0;
/// Fewest points on walls that tell anything, and their least share of those that do not lie on the ground.
const FEWEST: u32 = 15;
const LEAST_SHARE: f64 = 0.6;
/// How near to known ground a point lies on it, in metres: the body rocks.
const GROUND_M: f64 = 0.1;
/// Headings that are tried: so many of odometry's deviations to either side, in steps, in radians.
const HEADINGS_SIGMA: f64 = 2.5;
const HEADING_STEP_RAD: f64 = 0.07;
const MOST_STEPS: f64 = 12.0;
/// Fits are one and the same within this, and another is a rival from this share of the best one's score on.
const LIKE_M: f64 = 0.1;
const LIKE_RAD: f64 = 0.03;
const UNLIKE_SHARE: f64 = 0.8;
/// 99.9 % of χ² with three degrees of freedom: what odometry may be wrong by.
const GATE: f64 = 16.27;

/// A robot's place as a line beside known walls and odometry together tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallAlignment {
    /// The robot in the world.
    pub world_from_robot: Isometry3<f64>,
    /// Covariance of its (x, y, heading) in the world's axes: m², m rad, rad².
    pub covariance: Matrix3<f64>,
}

/// Something flat of the map, ready to have points held against it.
struct Flat {
    plane_from_world: Isometry3<f64>,
    normal: Vector3<f64>,
    hull: Vec<Point2<f64>>,
}

/// The walls and the ground of a map.
pub struct Walls {
    walls: Vec<Flat>,
    ground: Vec<Flat>,
}

impl Walls {
    /// The walls among `landmarks` that face `eye`, in the world, and all of the ground.
    pub fn of(landmarks: &[Landmark], eye: &Point3<f64>) -> Self {
        let (mut walls, mut ground) = (Vec::new(), Vec::new());
        for landmark in landmarks.iter().filter(|landmark| !landmark.gone) {
            let normal = landmark.normal();
            let faces = normal.dot(&(eye - landmark.origin())) > 0.0;
            let list = match normal.z.abs() {
                lean if lean < UPRIGHT && faces => &mut walls,
                lean if lean > LEVEL => &mut ground,
                _ => continue,
            };
            let plane_from_world = landmark.world_from_plane.inverse();
            list.push(Flat { plane_from_world, normal, hull: landmark.hull.clone() });
        }
        Self { walls, ground }
    }

    /// Lays `points`, in the robot's frame, over the walls. `told` is where odometry has the robot in the world,
    /// `covariance` that of its (x, y, heading) there. `None` where too little fits, or only what odometry excludes.
    ///
    /// Costs the product of points and walls for each of ten rounds.
    pub fn align(
        &self,
        points: &[Point3<f64>],
        told: &Isometry3<f64>,
        covariance: &Matrix3<f64>,
    ) -> Option<WallAlignment> {
        let prior = covariance.try_inverse()?;
        let arms: Vec<Vector3<f64>> = points.iter().map(|p| told.rotation * p.coords).collect();
        let place = told.translation.vector;
        // Headings from which the walls are sought: from each of them all within reach of it are found.
        let most_rad = HEADINGS_SIGMA * covariance[(2, 2)].sqrt();
        let steps = (most_rad / HEADING_STEP_RAD).min(MOST_STEPS).floor() as i32;
        let starts = (-steps..=steps).map(|step| f64::from(step) * HEADING_STEP_RAD);
        let mut found: Vec<Fit> = Vec::new();
        for turn_rad in starts {
            let Some(fit) = self.fit(&arms, &place, &prior, turn_rad) else { continue };
            let away = fit.state.dot(&(prior * fit.state));
            if away > GATE || fit.state.xy().norm() > MOST_M {
                continue;
            }
            match found.iter_mut().find(|other| other.is_like(&fit)) {
                Some(other) if other.score < fit.score => *other = fit,
                Some(_) => {}
                None => found.push(fit),
            }
        }
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let best = found.first()?;
        if found.get(1).is_some_and(|second| second.score > UNLIKE_SHARE * best.score) {
            // Lines that fit elsewhere as well tell nothing.
            return None;
        }
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), wrap_pi(best.state.z));
        let place = place + Vector3::new(best.state.x, best.state.y, 0.0);
        Some(WallAlignment {
            world_from_robot: Isometry3::from_parts(place.into(), turn * told.rotation),
            covariance: best.information.try_inverse()?,
        })
    }

    /// The place and heading nearest to those at which the search begins, as offsets from what odometry tells.
    fn fit(
        &self,
        arms: &[Vector3<f64>],
        told: &Vector3<f64>,
        prior: &Matrix3<f64>,
        turn_rad: f64,
    ) -> Option<Fit> {
        let mut state = Vector3::new(0.0, 0.0, turn_rad);
        let (mut sigma_m, mut last) = (REACH_M.0 / 3.0, None);
        for round in 0..ROUNDS {
            let seeking = round + LAST_ROUNDS < ROUNDS;
            let prior = if seeking { prior / (LOOSE * LOOSE) } else { *prior };
            let share = round as f64 / (ROUNDS - 1) as f64;
            let reach_m = REACH_M.0 * (REACH_M.1 / REACH_M.0).powf(share);
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), state.z);
            let place = told + Vector3::new(state.x, state.y, 0.0);
            let (mut information, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
            let (mut pairs, mut elsewhere, mut squares) = (0_u32, 0_u32, 0.0);
            for arm in arms {
                let arm = turn * arm;
                let at = Point3::from(place + arm);
                if nearest(&self.ground, &at, GROUND_M).is_some() {
                    continue;
                }
                let Some((normal, gap_m)) = nearest(&self.walls, &at, reach_m) else {
                    elsewhere += 1;
                    continue;
                };
                let row = Vector3::new(normal.x, normal.y, normal.dot(&Vector3::z().cross(&arm)));
                // Huber's weight: what stands where nothing stood pulls with no more than its sigmas.
                let weight = (2.0 * sigma_m / gap_m.abs().max(1e-12)).min(1.0);
                information += row * row.transpose() * weight;
                gradient += row * (weight * gap_m);
                squares += weight * gap_m * gap_m;
                pairs += 1;
            }
            let share = f64::from(pairs) / f64::from(pairs + elsewhere).max(1.0);
            if pairs < FEWEST || share < LEAST_SHARE && !seeking {
                return None;
            }
            sigma_m = (squares / f64::from(pairs)).sqrt().max(LEAST_SIGMA_M);
            let weight = 1.0 / (TOGETHER * sigma_m * sigma_m);
            let whole = information * weight + prior;
            state -= whole.try_inverse()? * (gradient * weight + prior * state);
            last = Some(Fit {
                state,
                information: whole,
                score: f64::from(pairs) - f64::from(elsewhere),
            });
        }
        last
    }
}

/// Where a search among walls has ended.
#[derive(Clone, Copy)]
struct Fit {
    state: Vector3<f64>,
    information: Matrix3<f64>,
    /// Points that lie on walls less those that lie on nothing known.
    score: f64,
}

impl Fit {
    fn is_like(&self, other: &Self) -> bool {
        let apart = self.state - other.state;
        apart.xy().norm() < LIKE_M && apart.z.abs() < LIKE_RAD
    }
}

/// The surface nearest to a point that lies on it to within `reach_m`: its normal, and how far from it the point is.
fn nearest(flats: &[Flat], at: &Point3<f64>, reach_m: f64) -> Option<(Vector3<f64>, f64)> {
    let near = flats.iter().filter_map(|flat| {
        let p = flat.plane_from_world * at;
        (p.z.abs() <= reach_m && is_within(&flat.hull, &p.xy())).then_some((flat.normal, p.z))
    });
    near.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}

/// Whether a point lies within a convex hull, counter-clockwise, or close beside it.
fn is_within(hull: &[Point2<f64>], p: &Point2<f64>) -> bool {
    let next = hull.iter().cycle().skip(1);
    hull.iter().zip(next).all(|(a, b)| {
        let edge = b - a;
        edge.perp(&(p - a)) >= -BESIDE_M * edge.norm()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall over `a`-`b`, 2 m high, its normal to the left of the way from `a` to `b`.
    fn wall(a: [f64; 2], b: [f64; 2]) -> Flat {
        let along = Vector3::new(b[0] - a[0], b[1] - a[1], 0.0);
        let normal = Vector3::z().cross(&along).normalize();
        let axes = nalgebra::Rotation3::from_basis_unchecked(&[
            along.normalize(),
            normal.cross(&along.normalize()),
            normal,
        ]);
        let origin = Vector3::new(a[0], a[1], 0.0);
        let rotation = UnitQuaternion::from_rotation_matrix(&axes);
        let plane_from_world = Isometry3::from_parts(origin.into(), rotation).inverse();
        let length_m = along.norm();
        let corners = [(0.0, 0.0), (0.0, 2.0), (length_m, 0.0), (length_m, 2.0)].map(|(x, z)| {
            (plane_from_world * Point3::from(origin + along.normalize() * x + Vector3::z() * z))
                .xy()
        });
        Flat { plane_from_world, normal, hull: crate::geometry::convex_hull(&corners) }
    }

    fn walls_through(corners: &[[f64; 2]]) -> Walls {
        let next = corners.iter().cycle().skip(1);
        let walls = corners.iter().zip(next).map(|(a, b)| wall(*a, *b)).collect();
        Walls { walls, ground: Vec::new() }
    }

    /// What the beams of a laser 0.6 m up and tilted down by 4° hit of `walls`, in the robot's frame.
    fn seen(walls: &Walls, world_from_robot: &Isometry3<f64>) -> Vec<Point3<f64>> {
        let tilt = UnitQuaternion::from_euler_angles(0.0, 4_f64.to_radians(), 0.0);
        let eye = Vector3::new(0.0, 0.0, 0.6);
        (-90..=90)
            .filter_map(|beam| {
                let (sin, cos) = f64::from(beam).to_radians().sin_cos();
                let ray = tilt * Vector3::new(cos, sin, 0.0);
                let (from, along) = (world_from_robot * Point3::from(eye), world_from_robot * ray);
                let range = |flat: &Flat| {
                    let (o, d) = (flat.plane_from_world * from, flat.plane_from_world * along);
                    let range = -o.z / d.z;
                    let at = o + d * range;
                    let within = flat.hull.iter().zip(flat.hull.iter().cycle().skip(1));
                    let hit = within.fold(range > 0.0, |hit, (a, b)| {
                        hit && (b - a).perp(&(at.xy() - a)) >= 0.0
                    });
                    hit.then_some(range)
                };
                let range = walls.walls.iter().filter_map(range).min_by(f64::total_cmp)?;
                Some(Point3::from(eye + ray * range))
            })
            .collect()
    }

    fn at(x_m: f64, y_m: f64, heading_rad: f64) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
        Isometry3::from_parts(Vector3::new(x_m, y_m, 0.0).into(), turn)
    }

    fn covariance(sigma_m: f64, sigma_rad: f64) -> Matrix3<f64> {
        let sigmas = Vector3::new(sigma_m, sigma_m, sigma_rad);
        Matrix3::from_diagonal(&sigmas.component_mul(&sigmas))
    }

    /// Wider than deep, with a corner cut off: it looks like itself from no other heading.
    const ROOM: [[f64; 2]; 5] = [[-3.0, -2.0], [4.0, -2.0], [4.0, 2.0], [-1.0, 2.0], [-3.0, 1.0]];

    #[test]
    fn a_heading_that_wheels_miss_by_half_a_radian_is_found() {
        let room = walls_through(&ROOM);
        for (k, turned_rad) in [-0.5, -0.3, -0.05, 0.1, 0.45].into_iter().enumerate() {
            let truth = at(0.3, -0.4, 0.8 * k as f64);
            let told = at(0.36, -0.45, 0.8 * k as f64 + turned_rad);
            let found = room.align(&seen(&room, &truth), &told, &covariance(0.1, 0.3)).unwrap();
            let off = truth.inverse() * found.world_from_robot;
            assert!(off.translation.vector.norm() < 0.01, "{k}: {off}");
            assert!(off.rotation.angle() < 0.005, "{k}: {off}");
            assert!(found.covariance[(2, 2)].sqrt() < 0.01, "{k}: {}", found.covariance);
        }
    }

    #[test]
    fn along_a_corridor_odometry_is_what_is_left() {
        let sides = walls_through(&[[-9.0, -1.0], [9.0, -1.0], [9.0, 1.0], [-9.0, 1.0]]);
        let corridor =
            Walls { walls: sides.walls.into_iter().step_by(2).collect(), ground: Vec::new() };
        let truth = at(0.0, 0.2, 0.1);
        let told = at(0.2, 0.0, 0.0);
        let found = corridor.align(&seen(&corridor, &truth), &told, &covariance(0.1, 0.1)).unwrap();
        let off = found.world_from_robot.translation.vector - truth.translation.vector;
        assert!((off.x - 0.2).abs() < 0.01 && off.y.abs() < 0.01, "{off}");
        assert!(found.covariance[(0, 0)].sqrt() > 0.09, "{}", found.covariance);
        assert!(found.covariance[(1, 1)].sqrt() < 0.03, "{}", found.covariance);
    }

    #[test]
    fn what_fits_two_headings_or_nothing_known_tells_nothing() {
        let square = walls_through(&[[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]);
        let line = seen(&square, &at(0.0, 0.0, 0.0));
        // Between two headings that look alike, and as wide open.
        let between = at(0.0, 0.0, std::f64::consts::FRAC_PI_4);
        assert_eq!(square.align(&line, &between, &covariance(0.1, 0.6)), None);
        assert!(square.align(&line, &at(0.0, 0.0, 0.2), &covariance(0.1, 0.15)).is_some());
        let elsewhere = walls_through(&ROOM);
        assert_eq!(elsewhere.align(&line, &at(0.0, 0.0, 0.2), &covariance(0.1, 0.15)), None);
        assert_eq!(square.align(&[], &between, &covariance(0.1, 0.6)), None);
    }

    #[test]
    fn ground_that_goes_with_the_robot_is_no_wall_that_holds_it() {
        let mut room = walls_through(&ROOM);
        let floor = Isometry3::identity();
        let hull =
            [[-3.0, -2.0], [4.0, -2.0], [4.0, 2.0], [-3.0, 2.0]].map(|[x, y]| Point2::new(x, y));
        room.ground.push(Flat {
            plane_from_world: floor,
            normal: Vector3::z(),
            hull: hull.to_vec(),
        });
        // All that is seen is floor, beside the wall ahead.
        let line: Vec<Point3<f64>> =
            (-30..=30).map(|y| Point3::new(1.2, 0.02 * f64::from(y), 0.02)).collect();
        assert_eq!(room.align(&line, &at(2.7, 0.0, 0.0), &covariance(0.1, 0.1)), None);
    }
}
