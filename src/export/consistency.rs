//! Whether a map knows how wrong it is: keyframes against the truth. Nothing here reaches an agent.

use super::evaluate::{Patch, UnderPatch, middle_surface, true_surfaces};
use super::keyframes::{Keyframe, Sighting};
use super::score::{at, settled_s};
use super::truth_steps::Steps;
use super::tum::TimedPose;
use crate::geometry::{contains_point, convex_hull};
use crate::mapping::perturbation::pose_error;
use crate::sim::World;
use nalgebra::{Isometry3, Matrix6, Point2, Point3, Unit, Vector3};
use serde::Serialize;
use std::collections::BTreeMap;

/// 95 % of a χ² variable of six degrees of freedom lie below this.
const WITHIN_95: f64 = 12.592;

/// Two sightings lie on one true surface if that surface's planes agree to this at each other's place.
const SAME_PLANE_M: f64 = 0.005;
const SAME_PLANE_RAD: f64 = 0.01;
/// A sighting lies on every surface that this share of its corners and its centroid lie on: seen from afar,
/// surfaces a few millimetres apart, as of a person's leg and chest, are one patch.
const ONE_OF_ITS_SURFACES: f64 = 0.25;
/// The same for sightings themselves, which err: what lies closer together passes for one surface here.
const SEEN_ALIKE_M: f64 = 0.03;
const SEEN_ALIKE_RAD: f64 = 0.1;
/// Standard deviations of its own normal by which a sighting may be turned.
const TILT_SIGMAS: f64 = 3.0;

/// Normalised estimation errors squared of motions between keyframes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Nees {
    /// Keyframes compared.
    pub keyframes: usize,
    /// Mean; 6 for a filter that knows its errors. One run's keyframes share their errors, so it is no
    /// sharp test.
    pub mean: f64,
    /// Share below the 95 % quantile of χ² with six degrees of freedom.
    pub within_95: f64,
    /// What the truth's places were rounded to in metres, and its angles in radians; 0 for a truth that was
    /// not. The errors that this makes are allowed for.
    pub truth_step_m: f64,
    /// See `truth_step_m`.
    pub truth_step_rad: f64,
}

/// What planes were taken for, against the surfaces of the world that they lie on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Associations {
    /// Sightings of a landmark on the surface on which most of its sightings are; one may be on several.
    pub right: usize,
    /// Sightings on another one.
    pub wrong: usize,
    /// Sightings that lie on no surface of the world, such as bodies and patches over an edge.
    pub unknown: usize,
    /// Landmarks of which some sighting and one of a landmark with a lower number lie on one surface, each with
    /// its middle within the other: one surface taken for two. Doubles that overlap less are not counted.
    pub doubled: usize,
}

/// NEES of the motions from the first keyframe to each later one; `None` without truth or covariances. `steps`
/// are what the truth was rounded to: a motion is no better known than both of its ends, and the angles of the
/// first move all that is far from it.
pub(super) fn nees(keyframes: &[Keyframe], truth: &[TimedPose], steps: Steps) -> Option<Nees> {
    let (first, later) = keyframes.split_first()?;
    let motions = later.iter().map(|keyframe| (first, keyframe, keyframe.motion_covariance));
    nees_of(motions, truth, steps)
}

/// The same of the motions from each keyframe to the next: once the way from the first is open by decimetres,
/// only these show what is told for sure and wrong.
pub(super) fn step_nees(keyframes: &[Keyframe], truth: &[TimedPose], steps: Steps) -> Option<Nees> {
    let pairs = keyframes.windows(2).map(|pair| (&pair[0], &pair[1], pair[1].step_covariance));
    nees_of(pairs, truth, steps)
}

fn nees_of<'a>(
    motions: impl Iterator<Item = (&'a Keyframe, &'a Keyframe, Option<Matrix6<f64>>)>,
    truth: &[TimedPose],
    steps: Steps,
) -> Option<Nees> {
    let pose_at = true_poses(truth)?;
    let errors: Vec<f64> = motions
        .filter_map(|(before, after, covariance)| {
            let (true_before, true_after) = (pose_at(before)?, pose_at(after)?);
            let motion = before.pose.inverse() * after.pose;
            let true_motion = true_before.inverse() * true_after;
            let error = pose_error(&true_motion, &motion);
            let rounding = steps.of_motion(&true_before, &true_after);
            let information = (covariance? + rounding).try_inverse()?;
            Some(error.dot(&(information * error)))
        })
        .collect();
    let within = errors.iter().filter(|error| **error <= WITHIN_95).count();
    (!errors.is_empty()).then(|| Nees {
        keyframes: errors.len(),
        mean: errors.iter().sum::<f64>() / errors.len() as f64,
        within_95: within as f64 / errors.len() as f64,
        truth_step_m: steps.place_m,
        truth_step_rad: steps.angle_rad,
    })
}

/// Associations right and wrong; `None` without truth or sightings. Where the world is not known the
/// sightings, carried to where they were truly made, are compared with one another.
pub fn associations(
    keyframes: &[Keyframe],
    truth: &[TimedPose],
    world: Option<&World>,
) -> Option<Associations> {
    let (within_m, within_rad) =
        world.map_or((SEEN_ALIKE_M, SEEN_ALIKE_RAD), |_| (SAME_PLANE_M, SAME_PLANE_RAD));
    let pose_at = true_poses(truth)?;
    let mut surfaces: BTreeMap<u32, Vec<Vec<SeenPlane>>> = BTreeMap::new();
    let mut outlines: BTreeMap<u32, Vec<Outline>> = BTreeMap::new();
    let mut score = Associations::default();
    for keyframe in keyframes {
        let Some(pose) = pose_at(keyframe) else { continue };
        for Sighting { landmark, patch, tilt_sigma_rad } in &keyframe.sightings {
            let as_seen = SeenPlane::of_sighting(patch, *tilt_sigma_rad, &pose);
            let (whole, under) = match world {
                Some(world) => {
                    let under = true_surfaces(patch, world, &pose);
                    let planes = under.iter().copied().map(SeenPlane::from).collect();
                    (middle_surface(under).map(SeenPlane::from), planes)
                }
                None => (Some(as_seen), vec![as_seen]),
            };
            let Some(whole) = whole else {
                score.unknown += 1;
                continue;
            };
            let outline = Outline::new(patch, &whole, &pose);
            outlines.entry(*landmark).or_default().extend(outline);
            let own = main_surfaces(&whole, &under, within_m, within_rad);
            surfaces.entry(*landmark).or_default().push(own);
        }
    }
    for seen in surfaces.values() {
        let lies_on = |sighting: &[SeenPlane], surface: &SeenPlane| {
            sighting.iter().any(|own| same_plane(own, surface, within_m, within_rad))
        };
        let sightings_on =
            |surface: &SeenPlane| seen.iter().filter(|sighting| lies_on(sighting, surface)).count();
        let right = seen.iter().flatten().map(sightings_on).max().unwrap_or(0);
        score.right += right;
        score.wrong += seen.len() - right;
    }
    let of_one_surface = |a: &Outline, b: &Outline| {
        same_plane(&a.surface, &b.surface, within_m, within_rad) && a.holds(b) && b.holds(a)
    };
    let is_double = |(landmark, seen): &(&u32, &Vec<Outline>)| {
        let mut before = outlines.range(..**landmark).flat_map(|(_, before)| before);
        before.any(|before| seen.iter().any(|seen| of_one_surface(seen, before)))
    };
    score.doubled = outlines.iter().filter(is_double).count();
    (score != Associations::default()).then_some(score)
}

/// A plane that a sighting lies on.
#[derive(Clone, Copy, Debug)]
struct SeenPlane {
    point: Point3<f64>,
    normal: Vector3<f64>,
    /// By how much its normal may be off.
    open_rad: f64,
}

impl From<UnderPatch> for SeenPlane {
    fn from(UnderPatch { point, normal, .. }: UnderPatch) -> Self {
        Self { point, normal, open_rad: 0.0 }
    }
}

impl SeenPlane {
    /// The sighting's own plane where it was truly made: that of a board's edge says nothing of how the edge is
    /// turned about its length.
    fn of_sighting(patch: &Patch, tilt_sigma_rad: f64, pose: &Isometry3<f64>) -> Self {
        let open_rad = open_by_width_rad(patch).max(TILT_SIGMAS * tilt_sigma_rad);
        Self { point: pose * patch.centroid, normal: pose * patch.normal, open_rad }
    }
}

/// How far a patch may be turned about its length without its sides leaving its place.
fn open_by_width_rad(patch: &Patch) -> f64 {
    (SEEN_ALIKE_M / (0.5 * width_m(patch)).max(1e-6)).atan()
}

/// Least width of a patch's hull in its plane, in metres.
fn width_m(patch: &Patch) -> f64 {
    let next = patch.hull.iter().cycle().skip(1);
    let across = patch.hull.iter().zip(next).filter_map(|(corner, next)| {
        let across = patch.normal.cross(&(next - corner)).try_normalize(1e-9)?;
        let beside = patch.hull.iter().map(|other| across.dot(&(other - corner)).abs());
        Some(beside.fold(0.0, f64::max))
    });
    across.min_by(f64::total_cmp).unwrap_or(0.0)
}

/// The surfaces that a sighting lies on, each once: that at the median of its offsets, and of those `under`
/// its points all that enough of them lie on.
fn main_surfaces(
    whole: &SeenPlane,
    under: &[SeenPlane],
    within_m: f64,
    within_rad: f64,
) -> Vec<SeenPlane> {
    let enough = ONE_OF_ITS_SURFACES * under.len() as f64;
    let mut found = vec![*whole];
    for surface in under {
        let alike = |other: &&SeenPlane| same_plane(surface, other, within_m, within_rad);
        let is_known = found.iter().any(|known| alike(&known));
        if !is_known && under.iter().filter(alike).count() as f64 >= enough {
            found.push(*surface);
        }
    }
    found
}

/// A sighting's hull laid on the true surface that it shows.
struct Outline {
    surface: SeenPlane,
    surface_from_world: Isometry3<f64>,
    middle: Point3<f64>,
    hull: Vec<Point2<f64>>,
}

impl Outline {
    /// `None` where the surface has no normal.
    fn new(patch: &Patch, surface: &SeenPlane, world_from_robot: &Isometry3<f64>) -> Option<Self> {
        let normal = Unit::try_new(surface.normal, 0.5)?;
        let up = if normal.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let surface_from_world =
            Isometry3::look_at_rh(&surface.point, &(surface.point + *normal), &up);
        let on_surface = |p: &Point3<f64>| (surface_from_world * (world_from_robot * p)).xy();
        let corners: Vec<Point2<f64>> = patch.hull.iter().map(on_surface).collect();
        // What is turned any way lies on anything: a double has to show that it is one.
        let open_rad = surface.open_rad.min(open_by_width_rad(patch));
        Some(Self {
            surface: SeenPlane { open_rad, ..*surface },
            middle: world_from_robot * patch.centroid,
            hull: convex_hull(&corners),
            surface_from_world,
        })
    }

    fn holds(&self, other: &Self) -> bool {
        contains_point(&self.hull, &(self.surface_from_world * other.middle).xy())
    }
}

/// The true pose at a keyframe.
fn true_poses(truth: &[TimedPose]) -> Option<impl Fn(&Keyframe) -> Option<Isometry3<f64>>> {
    let from_s = settled_s(truth)?;
    Some(move |keyframe: &Keyframe| at(truth, keyframe.time_s?.max(from_s)))
}

/// Whether two planes are one, as far as they are known.
fn same_plane(a: &SeenPlane, b: &SeenPlane, within_m: f64, within_rad: f64) -> bool {
    let apart = b.point - a.point;
    let off_m = apart.dot(&a.normal).abs().min(apart.dot(&b.normal).abs());
    let open_rad = a.open_rad.max(b.open_rad);
    a.normal.angle(&b.normal) <= within_rad + open_rad && off_m <= within_m
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::MapFile;

    fn truth() -> Vec<TimedPose> {
        let pose = |i: u32| Isometry3::translation(0.1 * f64::from(i), 0.0, 0.2);
        (0..=40).map(|i| TimedPose { time_s: f64::from(i), pose: pose(i) }).collect()
    }

    fn keyframe(time_s: f64, off_m: f64, sightings: Vec<Sighting>) -> Keyframe {
        Keyframe {
            time_s: Some(time_s),
            pose: Isometry3::translation(0.1 * time_s + off_m, 0.0, 0.2),
            motion_covariance: Some(Matrix6::identity() * 1e-4),
            step_covariance: Some(Matrix6::identity() * 1e-6),
            sightings,
        }
    }

    #[test]
    fn an_error_of_three_deviations_gives_nine() {
        let keyframes = [
            keyframe(2.0, 0.0, vec![]),
            keyframe(10.0, 0.03, vec![]),
            keyframe(20.0, 0.05, vec![]),
        ];
        let nees = nees(&keyframes, &truth(), Steps::default()).unwrap();
        assert_eq!(nees.keyframes, 2);
        assert!((nees.mean - (9.0 + 25.0) / 2.0).abs() < 1e-6, "{nees:?}");
        assert!((nees.within_95 - 0.5).abs() < 1e-9);
        // From each to the next it is 0.03 and 0.02 m, of 0.001 m told.
        let steps = step_nees(&keyframes, &truth(), Steps::default()).unwrap();
        assert_eq!(steps.keyframes, 2);
        assert!((steps.mean - (900.0 + 400.0) / 2.0).abs() < 1e-3, "{steps:?}");
    }

    #[test]
    fn a_sighting_of_another_surface_is_wrong() {
        // Two floors, the second 0.1 m higher from x = 2 m on.
        let map = "name = \"m\"\nbounds = [-1.0, -2.0, 6.0, 2.0]\n\
                   [[box]]\ncenter = [0.5, 0.0, -0.5]\nsize = [3.0, 4.0, 1.0]\n\
                   [[box]]\ncenter = [4.0, 0.0, -0.4]\nsize = [4.0, 4.0, 1.0]\n";
        let world = World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap();
        // A patch of floor ahead of the robot, whose origin is 0.2 m above the lower floor.
        let floor_of = |landmark: u32, x: f64, z: f64| Sighting {
            landmark,
            patch: Patch {
                normal: Vector3::z(),
                centroid: Point3::new(x, 0.0, z),
                hull: [(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)]
                    .map(|(dx, dy)| Point3::new(x + dx, dy, z))
                    .to_vec(),
            },
            tilt_sigma_rad: 0.0,
        };
        let floor = |x: f64, z: f64| floor_of(3, x, z);
        let seen = [
            keyframe(2.0, 0.0, vec![floor(0.5, -0.2)]),
            keyframe(5.0, 0.0, vec![floor(0.8, -0.2)]),
            keyframe(10.0, 0.0, vec![floor(2.0, -0.1)]),
            keyframe(11.0, 0.0, vec![floor(9.0, -0.2)]),
        ];
        let score = associations(&seen, &truth(), Some(&world)).unwrap();
        assert_eq!(score, Associations { right: 2, wrong: 1, unknown: 1, doubled: 0 });
        // By themselves three lie in one plane, and one does not.
        let score = associations(&seen, &truth(), None).unwrap();
        assert_eq!(score, Associations { right: 3, wrong: 1, unknown: 0, doubled: 0 });
        // Another landmark beside the first, and one that lies on it.
        let seen = [
            keyframe(2.0, 0.0, vec![floor(0.5, -0.2)]),
            keyframe(5.0, 0.0, vec![floor_of(4, 0.8, -0.2)]),
            keyframe(6.0, 0.0, vec![floor_of(5, 0.2, -0.2)]),
        ];
        let score = associations(&seen, &truth(), Some(&world)).unwrap();
        assert_eq!(score, Associations { right: 3, wrong: 0, unknown: 0, doubled: 1 });
    }

    /// From afar a step of 8 mm is not seen, from close by both of its floors are.
    #[test]
    fn a_sighting_that_lies_on_two_surfaces_is_right_with_either_but_they_are_not_one() {
        let map = "name = \"m\"\nbounds = [-1.0, -2.0, 6.0, 2.0]\n\
                   [[box]]\ncenter = [0.5, 0.0, -0.5]\nsize = [3.0, 4.0, 1.0]\n\
                   [[box]]\ncenter = [4.0, 0.0, -0.492]\nsize = [4.0, 4.0, 1.0]\n";
        let world = World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap();
        let floor = |from_m: f64, to_m: f64| Sighting {
            landmark: 3,
            patch: Patch {
                normal: Vector3::z(),
                centroid: Point3::new(0.5 * (from_m + to_m), 0.0, -0.2),
                hull: [(from_m, -0.2), (to_m, -0.2), (to_m, 0.2), (from_m, 0.2)]
                    .map(|(x, y)| Point3::new(x, y, -0.2))
                    .to_vec(),
            },
            tilt_sigma_rad: 0.0,
        };
        let score = |sightings: &[Sighting]| {
            let seen: Vec<Keyframe> =
                sightings.iter().map(|one| keyframe(2.0, 0.0, vec![one.clone()])).collect();
            let score = associations(&seen, &truth(), Some(&world)).unwrap();
            (score.right, score.wrong)
        };
        let (across, low, high) = (floor(1.0, 2.8), floor(0.5, 1.2), floor(2.2, 3.0));
        assert_eq!(score(&[across.clone(), low.clone()]), (2, 0));
        assert_eq!(score(&[across.clone(), high.clone()]), (2, 0));
        assert_eq!(score(&[across, low.clone(), high.clone()]), (2, 1));
        assert_eq!(score(&[low, high]), (1, 1));
    }

    /// The edge of a board, 3 cm thin and a metre long, is turned about its length by what noise makes of it; a
    /// wall is not.
    #[test]
    fn how_a_strip_is_turned_about_its_length_is_not_held_against_it() {
        let seen = |height_m: f64, tilt_sigma_rad: f64, turned_rad: f64| {
            let normal = Vector3::new(-turned_rad.cos(), 0.0, turned_rad.sin());
            let up = Vector3::new(turned_rad.sin(), 0.0, turned_rad.cos()) * (0.5 * height_m);
            let corner = |y: f64, side: f64| Point3::new(2.0, y, 0.5) + up * side;
            let hull =
                vec![corner(-0.5, -1.0), corner(0.5, -1.0), corner(0.5, 1.0), corner(-0.5, 1.0)];
            let patch = Patch { normal, centroid: Point3::new(2.0, 0.0, 0.5), hull };
            keyframe(2.0, 0.0, vec![Sighting { landmark: 1, patch, tilt_sigma_rad }])
        };
        let wrong = |height_m, sigma_rad| {
            let turned = [0.0, 0.2, -0.01].map(|turned_rad| seen(height_m, sigma_rad, turned_rad));
            associations(&turned, &truth(), None).unwrap().wrong
        };
        assert_eq!((wrong(0.03, 0.0), wrong(2.0, 0.0)), (0, 1));
        // One column of rows that lie far apart, by what it says of itself.
        assert_eq!((wrong(2.0, 0.05), wrong(2.0, 0.02)), (0, 1));
    }
}
