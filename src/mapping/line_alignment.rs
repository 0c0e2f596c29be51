//! Two level lines laid over each other: what a laser that does not tilt says of a robot's motion.
//!
//! Point to line (Censi, "An ICP variant using a point-to-line metric", ICRA 2008), with the motion that
//! odometry tells as a prior: along a corridor, of which the lines say nothing, odometry is what is left.

use nalgebra::{Isometry2, Matrix2, Matrix3, Point2, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Beams to either side that a point's direction is taken from: so many at least, and more until they span
/// enough for noise not to turn it.
const BESIDE: std::ops::RangeInclusive<usize> = 2..=12;
const SPAN_M: f64 = 0.3;
/// What neighbouring points of one surface may be apart by: metres, and a share of their distance.
const APART_M: f64 = 0.1;
const APART_SHARE: f64 = 0.15;
/// Points farther from the line through their neighbours than this lie on no surface, in metres.
const STRAIGHT_M: f64 = 0.03;
/// Points of a line that are kept, evenly along it: rounds cost the product of two lines' points.
const MOST_POINTS: usize = 240;
/// How far a point may lie from its counterpart, in the first round and in the last, in metres.
const REACH_M: (f64, f64) = (0.6, 0.12);
const ROUNDS: usize = 14;
/// Least deviation of a point from its counterpart that is believed, in metres.
const LEAST_SIGMA_M: f64 = 0.005;
/// Neighbouring points err together, by what a surface is uneven: so many count for one.
const TOGETHER: f64 = 4.0;
/// Fewest pairs that align anything, and their least share of the points that have a direction.
const FEWEST: usize = 20;
const LEAST_SHARE: f64 = 0.5;
/// While pairs are sought odometry is held with so many times its deviations, or it would hold lines apart
/// that belong together; the last rounds weigh it as it is.
const LOOSE: f64 = 5.0;
const LAST_ROUNDS: usize = 3;
/// A direction is seen when points say this many times more of it than noise does.
const BY_CHANCE: f64 = 4.0;
/// 99.9 % of χ² with three degrees of freedom: what odometry may be wrong by.
const GATE: f64 = 16.27;

/// The points of a level line in the robot's frame, by beam.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelLine {
    points: Vec<Straight>,
}

/// A point that lies on something straight.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Straight {
    p: Point2<f64>,
    normal: Vector2<f64>,
    /// Variance of the normal's direction in rad².
    turn_rad2: f64,
}

/// A motion as lines and odometry together tell it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// The second line's robot in the frame of the first's.
    pub first_from_second: Isometry2<f64>,
    /// Covariance of (x, y, turn) in that frame: m², m rad, rad².
    pub covariance: Matrix3<f64>,
    /// Share of the second line's points that lie on the first.
    pub share: f64,
}

impl LevelLine {
    /// From the ends of beams in order, in metres; `None` where a beam hit nothing.
    pub fn new(ends: &[Option<Point2<f64>>]) -> Self {
        let points: Vec<Straight> =
            (0..ends.len()).filter_map(|at| straight_at(ends, at)).collect();
        let stride = points.len().div_ceil(MOST_POINTS).max(1);
        Self { points: points.into_iter().step_by(stride).collect() }
    }

    /// Lays `second` over this line. `told` is the motion between them by odometry, `covariance` that of its
    /// (x, y, turn) in the frame of the first. `None` where too little fits, or only what odometry excludes.
    ///
    /// Costs the product of both lines' points for each of a dozen rounds.
    pub fn align(
        &self,
        second: &Self,
        told: &Isometry2<f64>,
        covariance: &Matrix3<f64>,
    ) -> Option<Alignment> {
        let prior = covariance.try_inverse()?;
        let mut state = Vector3::new(told.translation.x, told.translation.y, told.rotation.angle());
        let begin = state;
        let mut sigma_m = REACH_M.0 / 3.0;
        let mut last = None;
        for round in 0..ROUNDS {
            let seeking = round + LAST_ROUNDS < ROUNDS;
            if round + LAST_ROUNDS == ROUNDS {
                let away = state - begin;
                if away.dot(&(prior * away)) > GATE {
                    return None;
                }
            }
            let prior = if seeking { prior / (LOOSE * LOOSE) } else { prior };
            let share = round as f64 / (ROUNDS - 1) as f64;
            let reach_m = REACH_M.0 * (REACH_M.1 / REACH_M.0).powf(share);
            let pose = Isometry2::new(state.xy(), state.z);
            let (mut information, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
            let (mut pairs, mut squares, mut by_chance) = (0, 0.0, 0.0);
            for Straight { p, .. } in &second.points {
                let turned = pose.rotation * p.coords;
                let at = Point2::from(turned + pose.translation.vector);
                let Some(found) = self.nearest(&at, reach_m) else { continue };
                let Straight { p: q, normal, turn_rad2 } = found;
                let gap_m = normal.dot(&(at - q));
                let row = Vector3::new(normal.x, normal.y, -normal.perp(&turned));
                // Huber's weight: what stands where nothing stood pulls with no more than its sigmas.
                let weight = (2.0 * sigma_m / gap_m.abs().max(1e-12)).min(1.0);
                information += row * row.transpose() * weight;
                gradient += row * (weight * gap_m);
                by_chance += weight * turn_rad2;
                squares += weight * gap_m * gap_m;
                pairs += 1;
            }
            if pairs < FEWEST {
                return None;
            }
            let blind = blind(&information, by_chance);
            (information, gradient) = (blind * information * blind, blind * gradient);
            sigma_m = (squares / pairs as f64).sqrt().max(LEAST_SIGMA_M);
            let weight = 1.0 / (TOGETHER * sigma_m * sigma_m);
            let whole = information * weight + prior;
            let step = whole.try_inverse()? * (gradient * weight + prior * (state - begin));
            state -= step;
            last = Some((whole, pairs));
        }
        let (whole, pairs) = last?;
        let share = pairs as f64 / second.points.len() as f64;
        (share >= LEAST_SHARE).then_some(Alignment {
            first_from_second: Isometry2::new(state.xy(), state.z),
            covariance: whole.try_inverse()?,
            share,
        })
    }

    fn nearest(&self, at: &Point2<f64>, reach_m: f64) -> Option<Straight> {
        let away = self.points.iter().map(|found| ((found.p - at).norm_squared(), found));
        let (square, nearest) = away.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (square <= reach_m * reach_m).then_some(*nearest)
    }
}

/// The projection that takes out the direction of which points say no more than the noise of their normals
/// does by chance: along a corridor normals that noise has turned would hold the robot. `by_chance` is the sum
/// of their variances.
fn blind(information: &Matrix3<f64>, by_chance: f64) -> Matrix3<f64> {
    let shifts = information.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigen();
    let weakest = shifts.eigenvalues.imin();
    let mut projection = Matrix3::identity();
    if shifts.eigenvalues[weakest] < BY_CHANCE * by_chance {
        let open = shifts.eigenvectors.column(weakest);
        let mut block = projection.fixed_view_mut::<2, 2>(0, 0);
        block -= open * open.transpose();
    }
    projection
}

/// The end of a beam, if it lies on something straight with its neighbours.
fn straight_at(ends: &[Option<Point2<f64>>], at: usize) -> Option<Straight> {
    let p = (*ends.get(at)?)?;
    let mut about = Vec::new();
    for beside in BESIDE {
        let window = ends.get(at.checked_sub(beside)?..=at + beside)?;
        about = window.iter().copied().collect::<Option<Vec<Point2<f64>>>>()?;
        let near = |pair: &[Point2<f64>]| {
            (pair[1] - pair[0]).norm() < APART_M + APART_SHARE * pair[0].coords.norm()
        };
        if !about.windows(2).all(near) {
            return None;
        }
        if (about[about.len() - 1] - about[0]).norm() >= SPAN_M {
            break;
        }
    }
    let mean = about.iter().map(|p| p.coords).sum::<Vector2<f64>>() / about.len() as f64;
    let scatter: Matrix2<f64> =
        about.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let variance = eigen.eigenvalues.min() / (about.len() - 2) as f64;
    let turn_rad2 = variance.max(LEAST_SIGMA_M * LEAST_SIGMA_M) / eigen.eigenvalues.max().max(1e-9);
    let bent = about.iter().any(|p| normal.dot(&(p.coords - mean)).abs() > STRAIGHT_M);
    (!bent).then_some(Straight { p, normal, turn_rad2 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_core::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    /// Walls as (normal, distance), seen from a pose by 181 beams with noise.
    fn line(
        walls: &[(f64, f64, f64)],
        world_from_robot: &Isometry2<f64>,
        random: &mut Pcg64,
    ) -> LevelLine {
        let mut noise = || {
            let uniform = |random: &mut Pcg64| f64::from(random.next_u32()) / f64::from(u32::MAX);
            0.01 * ((0..12).map(|_| uniform(random)).sum::<f64>() - 6.0)
        };
        let ends: Vec<Option<Point2<f64>>> = (-90..=90)
            .map(|beam| {
                let ray = world_from_robot.rotation
                    * nalgebra::Rotation2::new(f64::from(beam).to_radians())
                    * Vector2::x();
                let from = world_from_robot.translation.vector;
                let range = walls
                    .iter()
                    .map(|&(nx, ny, d)| (d - nx * from.x - ny * from.y) / (nx * ray.x + ny * ray.y))
                    .filter(|range| *range > 0.0)
                    .fold(f64::INFINITY, f64::min);
                (range < 20.0).then(|| {
                    world_from_robot.inverse() * Point2::from(from + ray * (range + noise()))
                })
            })
            .collect();
        LevelLine::new(&ends)
    }

    fn odometry_covariance() -> Matrix3<f64> {
        Matrix3::from_diagonal(&Vector3::new(0.05, 0.05, 0.05).map(|sigma| sigma * sigma))
    }

    fn error(found: &Alignment, truth: &Isometry2<f64>) -> Vector3<f64> {
        let (a, b) = (&found.first_from_second, truth);
        let shift = a.translation.vector - b.translation.vector;
        Vector3::new(shift.x, shift.y, (a.rotation.inverse() * b.rotation).angle())
    }

    #[test]
    fn a_room_corrects_odometry_and_the_covariance_tells_by_how_much() {
        let room =
            [(1.0, 0.0, 4.0), (-1.0, 0.0, 4.0), (0.0, 1.0, 3.0), (0.0, -1.0, 3.0), (0.6, 0.8, 4.0)];
        let mut random = Pcg64::seed_from_u64(3);
        let mut nees = 0.0;
        for k in 0..60 {
            let truth = Isometry2::new(Vector2::new(0.4, 0.1), 0.01 * f64::from(k % 20));
            let first = line(&room, &Isometry2::identity(), &mut random);
            let second = line(&room, &truth, &mut random);
            let told = truth * Isometry2::new(Vector2::new(0.05, -0.04), 0.05);
            let found = first.align(&second, &told, &odometry_covariance()).unwrap();
            let error = error(&found, &truth);
            assert!(error.xy().norm() < 0.012 && error.z.abs() < 0.004, "{k}: {error}");
            nees += error.dot(&(found.covariance.try_inverse().unwrap() * error)) / 60.0;
        }
        // Three are expected; neighbours that err apart make it less.
        assert!((0.2..4.0).contains(&nees), "{nees}");
    }

    #[test]
    fn along_a_corridor_odometry_is_what_is_left() {
        let corridor = [(0.0, 1.0, 1.2), (0.0, -1.0, 1.2)];
        let mut random = Pcg64::seed_from_u64(4);
        let truth = Isometry2::new(Vector2::new(0.5, 0.05), 0.03);
        let first = line(&corridor, &Isometry2::identity(), &mut random);
        let second = line(&corridor, &truth, &mut random);
        let told = Isometry2::new(Vector2::new(0.53, 0.0), 0.0);
        let found = first.align(&second, &told, &odometry_covariance()).unwrap();
        let error = error(&found, &truth);
        assert!(error.y.abs() < 0.01 && error.z.abs() < 0.004, "{error}");
        assert!((error.x - 0.03).abs() < 0.01, "{error}");
        assert!(found.covariance[(0, 0)].sqrt() > 0.04, "{}", found.covariance);
        assert!(found.covariance[(1, 1)].sqrt() < 0.01, "{}", found.covariance);
    }

    #[test]
    fn what_odometry_excludes_or_too_few_points_show_is_refused() {
        let room = [(1.0, 0.0, 4.0), (-1.0, 0.0, 4.0), (0.0, 1.0, 3.0), (0.0, -1.0, 3.0)];
        let mut random = Pcg64::seed_from_u64(5);
        let first = line(&room, &Isometry2::identity(), &mut random);
        let truth = Isometry2::new(Vector2::new(0.3, 0.0), 0.0);
        let second = line(&room, &truth, &mut random);
        let sure = odometry_covariance() * 0.01;
        assert_eq!(first.align(&second, &Isometry2::identity(), &sure), None);
        assert_eq!(first.align(&LevelLine::default(), &truth, &odometry_covariance()), None);
        assert_eq!(LevelLine::default().align(&second, &truth, &odometry_covariance()), None);
    }
}
