//! Whether a scan could have been made from where it is said to have been made: a robot does not see
//! through walls, a wall does not stand close before another that was seen, and no floor lies between
//! the sensor and the wheels.

use super::association::Assignment;
use super::estimate::{Estimate, Prepared};
use super::landmark::LandmarkId;
use super::mask::PlaneMask;
use super::moved::{Gone, Places};
use super::observation::Observation;
use super::scan_errors::ScanObservations;
use super::wall::{DOUBLED_M, LARGE_DOUBLED_M, SIGMAS, Wall};
use nalgebra::{Isometry3, Matrix3, Matrix6, Point2, Point3, Vector3, Vector6};
use std::f64::consts::TAU;

/// Most points of one observation that are looked at.
const SAMPLES_PER_PLANE: usize = 40;
/// What parallel surfaces may be apart by and yet be one, beside what the pair leaves open: no floor is even.
const EVEN_M: f64 = 0.02;
/// Area above which an observation is more likely a wall than a thing, in square metres.
const LARGE_M2: f64 = 4.0;
/// Logarithm of how seldom such a one lies where it cannot be.
const LOG_MISPLACED: f64 = -10.0;
/// Share of its area that a landmark has which is taken for a large observation without a question: the edge of
/// a shelf is in one plane with a wall that slipped wheels put there.
const KNOWN_PART: f64 = 0.5;
/// How far a large observation that is not recognised may be behind a parallel landmark: had it been the same
/// wall, it would have been recognised, whatever the pose leaves open. Before it, a board may have been put up.
const SAME_WALL_M: f64 = 0.05;
/// Standard deviation of a wheel's height above the surface that it stands on: a tyre, a carpet, the
/// fit of a floor. The pose's own adds to it.
const WHEEL_SIGMA_M: f64 = 0.02;
/// How often a wheel over a mapped floor does not stand on it: on a plank that no scan has shown, or in
/// the air at an edge.
const OFF_THE_FLOOR: f64 = 0.01;

/// How a scan and the map contradict each other under a pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Contradiction {
    /// Points of the scan that were looked at.
    pub(super) samples: usize,
    /// Those that lie behind a surface of the map, seen from the sensor, or close before one.
    pub(super) refuted: usize,
    /// Logarithm of how much likelier the wheels' heights over mapped floors are than any height
    /// within [`DOUBLED_M`] would be; 0 where no floor is mapped under them.
    pub(super) footing: f64,
    /// Logarithm of how seldom observations lie close before or behind a parallel surface of the map, over
    /// cells of it that were hit, as those here do: a floor taken for the kerb beside it. Large ones that are
    /// misplaced count, too.
    pub(super) doubled: f64,
    /// Observations that lie for the most part where they cannot be and are not recognised, or large: a wall
    /// before or behind itself is one that was seen from elsewhere, however well the rest fits.
    pub(super) misplaced: usize,
    /// Those that are not recognised and would have hidden what is behind them, and where that is.
    pub(super) before: Vec<(usize, Places)>,
    /// Landmarks that refute points, in order, and where in their own planes points are seen through them.
    pub(super) by: Places,
}

impl Contradiction {
    /// Share of the points that contradict.
    pub(super) fn share(&self) -> f64 {
        self.refuted as f64 / self.samples.max(1) as f64
    }
}

impl Estimate {
    /// How many points of the scan contradict the map when it is explained by `assignment`: along each
    /// landmark's normal a pose that pairs have fixed is held to centimetres, or a robot beside a stair
    /// could be a step of 0.18 m higher.
    ///
    /// `left_out` are observations that are said not to be a landmark which they fit. Where they lie
    /// over cells of it that were hit they cannot be anything else: two surfaces that close were not
    /// both seen square on. What the pose is uncertain by does not excuse that: it is the very question.
    ///
    /// What is `gone` is where it was no longer, and contradicts nothing, nor does what has come.
    ///
    /// Costs samples × landmarks about the scan; asked only where an association is in doubt.
    pub(super) fn contradiction(
        &self,
        scan: &ScanObservations,
        prepared: &Prepared,
        assignment: &Assignment,
        left_out: &[(usize, LandmarkId)],
        gone: &Gone,
    ) -> Contradiction {
        let belief = &assignment.belief;
        let world_from_robot = &belief.world_from_robot;
        let covariance = belief.pose_covariance();
        let hulls = scan.observations.iter().flat_map(Observation::hull_points);
        let around = hulls.chain(scan.contacts.iter().copied());
        let mut walls = self.walls(scan, prepared, assignment, around);
        walls.retain(|wall| !gone.landmarks.contains(&wall.landmark.id));
        for wall in &mut walls {
            wall.openings.extend(gone.openings_of(wall.landmark.id));
        }
        let mut found = Contradiction {
            footing: footing(&walls, world_from_robot, &covariance, &scan.contacts),
            ..Contradiction::default()
        };
        for (index, observation) in scan.observations.iter().enumerate() {
            let denied = |landmark: LandmarkId| left_out.contains(&(index, landmark));
            let held = held_against(&walls, scan, prepared, assignment, index, denied);
            found.samples += held.samples;
            if gone.came.contains(&index) {
                continue;
            }
            found.refuted += held.refuted;
            if 2 * held.doubled > held.samples {
                found.doubled += observation.log_swallowed();
            }
            let (is_free, is_large) = (assignment.plane_of(index).is_none(), is_large(observation));
            let is_misplaced = (is_free || is_large) && held.is_misplaced();
            found.misplaced += usize::from(is_misplaced);
            if is_misplaced && is_large {
                found.doubled += LOG_MISPLACED;
            }
            if is_free && 2 * held.before > held.samples {
                found.before.push((index, held.hides));
            }
            for (landmark, places) in held.by {
                found.by.entry(landmark).or_default().extend(places);
            }
        }
        found
    }

    /// Whether an observation that an assignment does not recognise, or takes for a landmark that is far smaller,
    /// lies for the most part where the map says that it cannot be: see [`Contradiction::misplaced`].
    pub(super) fn misplaces(
        &self,
        scan: &ScanObservations,
        prepared: &Prepared,
        assignment: &Assignment,
        is_unknown: impl Fn(usize) -> bool,
    ) -> bool {
        let outgrows = |index: usize| {
            let observation = &scan.observations[index];
            let landmark = || self.landmark(prepared.landmark_of(assignment.plane_of(index)?));
            let is_part =
                |known: &PlaneMask| known.area_m2() < KNOWN_PART * observation.mask.area_m2();
            is_large(observation) && landmark().is_some_and(|it| is_part(&it.mask))
        };
        let asked: Vec<usize> = (0..scan.observations.len())
            .filter(|&index| is_unknown(index) || outgrows(index))
            .collect();
        if asked.is_empty() {
            return false;
        }
        let hulls = asked.iter().flat_map(|&index| scan.observations[index].hull_points());
        let walls = self.walls(scan, prepared, assignment, hulls);
        asked.iter().any(|&index| {
            held_against(&walls, scan, prepared, assignment, index, |_| false).is_misplaced()
        })
    }

    /// The landmarks that face the sensor and may lie between it and points in the robot's frame, or close
    /// behind them.
    fn walls(
        &self,
        scan: &ScanObservations,
        prepared: &Prepared,
        assignment: &Assignment,
        points: impl Iterator<Item = Point3<f64>>,
    ) -> Vec<Wall<'_>> {
        let belief = &assignment.belief;
        let world_from_robot = belief.world_from_robot;
        let covariance = belief.pose_covariance().fixed_view::<3, 3>(0, 0).into_owned();
        let eye = Point3::from((world_from_robot * scan.robot_from_scan).translation.vector);
        let around = points.map(|p| world_from_robot * p).chain([eye]);
        // A wall that the points are said to stand before lies beyond all of them.
        self.landmarks_about(around, LARGE_DOUBLED_M)
            .filter_map(|(landmark, _)| {
                let plane = prepared.plane_of(landmark.id);
                let frame = plane.map_or(landmark.world_from_plane, |plane| belief.planes[plane]);
                Wall::facing(self, landmark, plane, frame, &eye, &covariance)
            })
            .collect()
    }
}

/// Whether an observation is more likely a wall than a thing.
fn is_large(observation: &Observation) -> bool {
    observation.mask.area_m2() > LARGE_M2
}

/// How an observation's points lie among the landmarks.
#[derive(Clone, Debug, Default)]
struct Held {
    samples: usize,
    /// See [`Refutation::Sure`] and [`Refutation::Tight`].
    refuted: usize,
    doubled: usize,
    /// Those of the refuted ones where the map does not have what the observation is said to be.
    misplaced: usize,
    /// Those of them that would have hidden what is behind them.
    before: usize,
    /// Landmarks that are sure to refute points, and where in their own planes points are seen through them.
    by: Places,
    /// Those that points would have hidden, and where.
    hides: Places,
}

impl Held {
    fn is_misplaced(&self) -> bool {
        2 * self.misplaced > self.samples
    }
}

/// Holds an observation's points against the landmarks; `denied` tells of those that it is said not to be.
fn held_against(
    walls: &[Wall<'_>],
    scan: &ScanObservations,
    prepared: &Prepared,
    assignment: &Assignment,
    index: usize,
    denied: impl Fn(LandmarkId) -> bool,
) -> Held {
    let observation = &scan.observations[index];
    let world_from_plane = assignment.belief.world_from_robot * observation.robot_from_plane;
    let taken = assignment.plane_of(index);
    let is_large = is_large(observation);
    let before_m = if is_large { LARGE_DOUBLED_M } else { DOUBLED_M };
    let against: Vec<Against<'_, '_>> = walls
        .iter()
        .map(|wall| {
            let said = if denied(wall.landmark.id) {
                Said::Another
            } else if is_large && taken.is_none() {
                let is_seen = wall.plane.is_some_and(|plane| assignment.shows(plane));
                if is_seen { Said::Before } else { Said::AnotherWall }
            } else {
                Said::Nothing
            };
            Against::new(wall, &observation.mask, before_m, &world_from_plane, said, |plane| {
                prepared.gap(scan, assignment, index, plane)
            })
        })
        .collect();
    let own = taken.and_then(|plane| walls.iter().find(|wall| wall.plane == Some(plane)));
    let mut held = Held::default();
    for cell in observation.mask.thinned(SAMPLES_PER_PLANE) {
        let point = world_from_plane * Point3::new(cell.x, cell.y, 0.0);
        // Where the map has what is said to be seen, it is no news that it has another, too.
        let is_news = || !own.is_some_and(|own| own.solid_at(&(own.plane_from_world * point)));
        held.samples += 1;
        let (mut most, mut is_behind) = (Refutation::None, false);
        for wall in &against {
            let (verdict, place) = wall.verdict(&point);
            most = most.max(verdict);
            let Some(place) = place else { continue };
            let is_through = place.z < 0.0;
            is_behind |= is_through;
            let id = wall.wall.landmark.id;
            held.by.entry(id).or_default().extend(is_through.then_some(place.xy()));
            if !is_through {
                held.hides.entry(id).or_default().push(place.xy());
            }
        }
        match most {
            Refutation::Sure => {
                let is_news = is_news();
                held.refuted += 1;
                held.misplaced += usize::from(is_news);
                held.before += usize::from(is_news && !is_behind);
            }
            Refutation::Tight if is_news() => held.doubled += 1,
            _ => {}
        }
    }
    held
}

/// What an explanation says of an observation beside a landmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Said {
    Nothing,
    /// That it is another surface, and fits this one.
    Another,
    /// That it is no wall of the map, large as it is.
    AnotherWall,
    /// The same of a wall that the scan shows beside it: what is before that has come there.
    Before,
}

/// What a landmark says against a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Refutation {
    None,
    /// It cannot be there when it is held to a parallel surface as well as the pair is known.
    Tight,
    /// It cannot be there whatever is unsure.
    Sure,
}

/// A landmark that an observation is held against.
struct Against<'a, 'w> {
    wall: &'a Wall<'w>,
    /// Whether both face the same way.
    parallel: bool,
    said: Said,
    /// Centre of the observation in the landmark's frame, and the covariance of the gap and the tilts between
    /// the two, where they are parallel and that is known.
    centre: Point3<f64>,
    gap: Option<Matrix3<f64>>,
    /// Cells of the observation, its frame in the landmark's, and how far before the landmark it cannot be.
    mask: &'a PlaneMask,
    observed_from_wall: Isometry3<f64>,
    before_m: f64,
}

impl<'a, 'w> Against<'a, 'w> {
    fn new(
        wall: &'a Wall<'w>,
        mask: &'a PlaneMask,
        before_m: f64,
        world_from_plane: &Isometry3<f64>,
        said: Said,
        gap: impl FnOnce(usize) -> Matrix3<f64>,
    ) -> Self {
        let parallel = wall.is_parallel(&(world_from_plane.rotation * Vector3::z()));
        let centre = wall.plane_from_world * Point3::from(world_from_plane.translation.vector);
        let gap = wall.plane.filter(|_| parallel).map(gap);
        let observed_from_wall = (wall.plane_from_world * world_from_plane).inverse();
        Self { wall, parallel, said, centre, gap, mask, observed_from_wall, before_m }
    }

    /// Whether a point of the observation, in the world, cannot be where it is, and where in the landmark's plane it
    /// is seen through that, or would have hidden it; z is how far before the plane it is.
    fn verdict(&self, point: &Point3<f64>) -> (Refutation, Option<Point3<f64>>) {
        let target = self.wall.plane_from_world * point;
        // Most points lie well before most surfaces: no margin would change that.
        if target.z >= self.before_m || (target.z > 0.0 && !self.parallel) {
            return (Refutation::None, None);
        }
        if target.z > 0.0 && self.said == Said::Before {
            return (Refutation::None, None);
        }
        let is_there = |crossing: &Point3<f64>| {
            self.mask.contains_well(&(self.observed_from_wall * crossing).xy())
        };
        let would_hide = |at: &Point2<f64>, before_m: f64| {
            self.parallel && self.wall.was_seen_past(at, before_m, is_there)
        };
        let refuted_at =
            |margin_m| self.wall.refuted_at(&target, margin_m, self.before_m, would_hide);
        let margin_m = match self.said {
            Said::Another => 0.0,
            Said::AnotherWall | Said::Before if self.parallel && target.z < 0.0 => SAME_WALL_M,
            _ => self.wall.ray_margin_m(&target),
        };
        if let Some(at) = refuted_at(margin_m) {
            return (Refutation::Sure, Some(Point3::new(at.x, at.y, target.z)));
        }
        let gap = self.gap.filter(|_| self.said != Said::Another);
        let tight = gap.and_then(|gap| refuted_at(self.gap_margin_m(&gap, &target, margin_m)));
        (if tight.is_some() { Refutation::Tight } else { Refutation::None }, None)
    }

    /// How far a point may lie off the landmark and yet be on it: between parallel surfaces that is known
    /// as well as the pair is, and at most so far.
    fn gap_margin_m(&self, gap: &Matrix3<f64>, target: &Point3<f64>, most_m: f64) -> f64 {
        // A point at (x, y) from the centre moves by δz - θ x + ψ y.
        let row = Vector3::new(1.0, self.centre.x - target.x, target.y - self.centre.y);
        let sigma_m = row.dot(&(gap * row)).max(0.0).sqrt();
        (EVEN_M + SIGMAS * sigma_m).min(most_m)
    }
}

/// Logarithm of the likelihood of the wheels' heights, beside that of any height within [`DOUBLED_M`].
///
/// A wheel over a mapped floor stands on it but for once in [`OFF_THE_FLOOR`]; its height is then
/// normal with what the pose leaves open, so that a pose which is known to the millimetre and one
/// which is open by a decimetre are weighed by one rule: the second explains a gap, but explains a
/// touch less well. The wheels are those of one rigid body and count as one measurement, their mean.
fn footing(
    walls: &[Wall<'_>],
    world_from_robot: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
    contacts: &[Point3<f64>],
) -> f64 {
    let up = world_from_robot.rotation * Vector3::z();
    let logs = contacts.iter().map(|contact| {
        let point = world_from_robot * contact;
        let arm = point.coords - world_from_robot.translation.vector;
        let heights = walls.iter().filter_map(|wall| wall.height_of(&point, &up));
        let nearest = heights.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        let Some((height_m, wall)) = nearest else {
            let hidden = walls.iter().any(|wall| {
                let target = wall.plane_from_world * point;
                let margin_m = wall.ray_margin_m(&target);
                // Wheels hide the floor that they stand on.
                let hides = |_: &Point2<f64>, _| wall.is_parallel(&up);
                wall.refuted_at(&target, margin_m, DOUBLED_M, hides).is_some()
            });
            return if hidden { OFF_THE_FLOOR.ln() } else { 0.0 };
        };
        let normal = wall.normal;
        let turn = arm.cross(&normal);
        let row = Vector6::new(normal.x, normal.y, normal.z, turn.x, turn.y, turn.z);
        let variance = WHEEL_SIGMA_M * WHEEL_SIGMA_M + row.dot(&(covariance * row)).max(0.0);
        let density = (-0.5 * height_m * height_m / variance).exp() / (TAU * variance).sqrt();
        ((1.0 - OFF_THE_FLOOR) * DOUBLED_M * density + OFF_THE_FLOOR).ln()
    });
    logs.sum::<f64>() / contacts.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::super::graph::GraphConfig;
    use super::super::landmark::Landmark;
    use super::super::vantage::Vantage;
    use super::*;
    use std::cell::OnceCell;

    fn empty() -> Estimate {
        Estimate::new(GraphConfig::default(), Isometry3::identity(), &Matrix6::zeros())
    }

    fn floor() -> Landmark {
        let mut mask = PlaneMask::default();
        for x in -20..20 {
            for y in -20..20 {
                mask.insert(&Point2::new(0.1 * f64::from(x) + 0.05, 0.1 * f64::from(y) + 0.05));
            }
        }
        let corner = |x: f64, y: f64| Point2::new(2.0 * x, 2.0 * y);
        let seen = Observation {
            robot_from_plane: Isometry3::identity(),
            covariance: Matrix3::identity(),
            hull: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            mask,
            points: 1600,
            rms_m: 0.005,
        };
        Landmark::first_seen(LandmarkId(0), &seen, &Isometry3::identity(), 0)
    }

    /// Footing of a robot whose wheels are that high above a floor, as far as that is known.
    fn footing_at(height_m: f64, sigma_m: f64) -> f64 {
        let floor = floor();
        let covariance = Matrix6::identity() * (sigma_m * sigma_m);
        let position = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let estimate = empty();
        let wall = Wall::facing(
            &estimate,
            &floor,
            None,
            Isometry3::identity(),
            &Point3::new(0.0, 0.0, 0.6),
            &position,
        );
        let contacts = [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]
            .map(|(x, y)| Point3::new(x, y, 0.0));
        let pose = Isometry3::translation(0.0, 0.0, height_m);
        footing(&[wall.expect("the eye is above")], &pose, &covariance, &contacts)
    }

    #[test]
    fn wheels_speak_for_a_pose_as_far_as_it_is_known() {
        // On the floor, the better known the likelier; off it, the better known the less likely.
        assert!(footing_at(0.0, 0.001) > footing_at(0.0, 0.05) + 0.5);
        assert!(footing_at(0.15, 0.001) < footing_at(0.15, 0.05) - 1.0);
        assert!(footing_at(-0.15, 0.001) < footing_at(-0.15, 0.05) - 1.0);
        // A step of 0.15 m up or down is told, more surely than one pair that fits by chance could say.
        for height_m in [0.15, -0.15] {
            assert!(footing_at(0.0, 0.001) - footing_at(height_m, 0.001) > 4.5);
        }
        // But whatever is under a wheel, it may be a thing that no scan has shown.
        assert!(footing_at(0.3, 1e-4) >= OFF_THE_FLOOR.ln());
        // Too high for the floor to have anything to do with it.
        assert_eq!(footing_at(0.7, 1e-4), 0.0);
    }

    /// A floor taken for the kerb beside it puts the robot 5 cm too high, and what else it sees of the
    /// floor close over it.
    #[test]
    fn a_floor_5_cm_over_a_mapped_floor_is_none_as_far_as_the_pair_is_known() {
        let floor = floor();
        let position = Matrix3::identity() * 1e-6;
        let eye = Point3::new(0.0, 0.0, 0.6);
        let estimate = empty();
        let wall = Wall::facing(&estimate, &floor, Some(0), Isometry3::identity(), &eye, &position);
        let mut wall = wall.expect("the eye is above");
        let observed_from_plane = Isometry3::identity();
        wall.vantages =
            OnceCell::from(vec![Vantage { eye, seen: &floor.mask, observed_from_plane }]);
        let over = Isometry3::translation(0.5, 0.5, 0.05);
        let verdict = |point: Point3<f64>, sigma_m: f64, sigma_rad: f64| {
            let sigmas = Vector3::new(sigma_m, sigma_rad, sigma_rad);
            let gap = Matrix3::from_diagonal(&sigmas.component_mul(&sigmas));
            Against::new(&wall, &floor.mask, DOUBLED_M, &over, Said::Nothing, |_| gap)
                .verdict(&point)
                .0
        };
        let point = Point3::new(1.0, -1.0, 0.05);
        // What the ray's length leaves open is more.
        assert_eq!(verdict(point, 0.002, 0.001), Refutation::Tight);
        // Open by as much, or by as much as the tilt does at that place.
        assert_eq!(verdict(point, 0.02, 0.001), Refutation::None);
        assert_eq!(verdict(point, 0.002, 0.02), Refutation::None);
        // Over no cell that was hit.
        assert_eq!(verdict(Point3::new(4.0, 0.0, 0.05), 0.002, 0.001), Refutation::None);
    }
}
