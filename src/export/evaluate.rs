//! A run's files against the truth: what `usar eval` computes. Nothing here reaches an agent.

use super::consistency::{self, Associations, Nees};
use super::coverage::{self, Evidence, Passability};
use super::keyframes::Keyframe;
use super::report::Report;
use super::score::{at, settled_s};
use super::timeline::Timeline;
use super::truth_steps::Steps;
use super::tum::TimedPose;
use crate::sim::World;
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// Length of true path over which relative pose errors are taken, in metres.
const RPE_OVER_M: f64 = 1.0;

/// A surface of the run belongs to a true one within this distance along its normal …
const SAME_SURFACE_M: f64 = 0.3;
/// … and this angle.
const SAME_SURFACE_DEG: f64 = 20.0;

/// Hull corners are looked at this far towards the centroid: the rim of a patch may hang over.
const INSET: f64 = 0.4;

/// A planar patch: in the map frame as `surfaces.json` has it, in the robot frame in `keyframes.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// Unit normal towards the free side.
    pub normal: Vector3<f64>,
    /// Centroid.
    pub centroid: Point3<f64>,
    /// Corners of the hull.
    pub hull: Vec<Point3<f64>>,
}

/// What a run folder holds, read.
#[derive(Clone, Debug, Default)]
pub struct RunFiles {
    /// `report.json`.
    pub report: Report,
    /// `trajectory.tum`.
    pub trajectory: Vec<TimedPose>,
    /// `truth.tum`, in the order of sampling, by the stamps that the robot's messages carried; empty
    /// where the truth is not known.
    pub truth: Vec<TimedPose>,
    /// `map.pgm` and `ground.png`.
    pub evidence: Option<Evidence>,
    /// `surfaces.json`.
    pub patches: Vec<Patch>,
    /// `keyframes.json`.
    pub keyframes: Vec<Keyframe>,
}

impl RunFiles {
    /// The same with all that is stamped at its time on `line`.
    fn in_one_time(&self, line: &Timeline) -> Self {
        let stamped = self.keyframes.iter().filter_map(|keyframe| keyframe.time_s);
        let mut times = line.times(stamped).into_iter();
        let mut keyframes = self.keyframes.clone();
        for keyframe in keyframes.iter_mut().filter(|keyframe| keyframe.time_s.is_some()) {
            keyframe.time_s = times.next();
        }
        Self {
            trajectory: line.unfolded(&self.trajectory),
            truth: line.unfolded(&self.truth),
            keyframes,
            ..self.clone()
        }
    }
}

/// A run scored. A field that needs something that is not there is `None`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Evaluation {
    /// Scenario or level.
    pub scenario: String,
    /// How the mission ended.
    pub outcome: String,
    /// Length of the mission in seconds.
    pub mission_time_s: f64,
    /// Absolute trajectory error.
    pub ate: Option<AbsoluteError>,
    /// Relative pose error.
    pub rpe: Option<RelativeError>,
    /// Length of the true path in metres.
    pub true_path_m: Option<f64>,
    /// Position error at the end over the length of the true path, in percent.
    pub drift_percent: Option<f64>,
    /// Floor that the robot can be driven to, in m².
    pub reachable_m2: Option<f64>,
    /// Explored part of it, in m².
    pub explored_m2: Option<f64>,
    /// `explored_m2 / reachable_m2`.
    pub coverage: Option<f64>,
    /// Planes of the map against the surfaces of the world.
    pub planes: Option<PlaneErrors>,
    /// Errors of the keyframes against their covariance.
    pub nees: Option<Nees>,
    /// Errors of the motions from each keyframe to the next against their covariance.
    pub step_nees: Option<Nees>,
    /// What planes were taken for: against the surfaces of the world, or where that is not known against one
    /// another.
    pub associations: Option<Associations>,
    /// By the simulator's count.
    pub falls: Option<usize>,
    /// By the simulator's count.
    pub collisions: Option<usize>,
    /// Victims reported near a true one.
    pub victims_found: Option<usize>,
}

/// Position errors over the trajectory, start poses laid on one another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AbsoluteError {
    /// Poses compared.
    pub poses: usize,
    /// Root mean square in metres.
    pub rmse_m: f64,
    /// Mean in metres.
    pub mean_m: f64,
    /// Greatest in metres.
    pub max_m: f64,
    /// At the end, in metres.
    pub final_m: f64,
    /// At the end, in degrees.
    pub final_deg: f64,
}

/// Errors of the motion over each metre of true path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RelativeError {
    /// Stretches compared.
    pub stretches: usize,
    /// Length of a stretch in metres.
    pub over_m: f64,
    /// Root mean square of the translation error in metres.
    pub translation_rmse_m: f64,
    /// Root mean square of the rotation error in degrees.
    pub rotation_rmse_deg: f64,
}

/// Planes of the map against the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PlaneErrors {
    /// Planes that lie on a surface of the world.
    pub matched: usize,
    /// Planes that lie on none.
    pub unmatched: usize,
    /// Root mean square of the offset along the normal at the centroid, in metres; `None`, as what follows, where
    /// no plane lies on a surface.
    pub offset_rmse_m: Option<f64>,
    /// Median of its size in metres.
    pub offset_median_m: Option<f64>,
    /// Root mean square of the angle between the normals, in degrees.
    pub tilt_rmse_deg: Option<f64>,
    /// Median of it in degrees.
    pub tilt_median_deg: Option<f64>,
}

/// Scores a run. `world` and the robot's limits are those of its scenario, where it is known.
pub fn evaluate(files: &RunFiles, world: Option<(&World, &Passability)>) -> Evaluation {
    let line = Timeline::of(&files.truth);
    if !line.is_plain() {
        return evaluate(&files.in_one_time(&line), world);
    }
    let report = &files.report;
    let mut evaluation = Evaluation {
        scenario: report.scenario.clone(),
        outcome: report.outcome.clone(),
        mission_time_s: report.mission_time_s,
        falls: report.falls,
        collisions: report.collisions,
        victims_found: report.victims.found,
        ..Evaluation::default()
    };
    let Some(true_from_map) = true_from_map(files) else { return evaluation };
    let pairs = pairs(files, &true_from_map);
    let ate = absolute(files, &true_from_map, &pairs);
    let path_m = path_length(&files.truth);
    evaluation.drift_percent = ate.filter(|_| path_m > 0.0).map(|ate| 100.0 * ate.final_m / path_m);
    evaluation.ate = ate;
    evaluation.true_path_m = Some(path_m);
    evaluation.rpe = relative(&pairs);
    // Poses given with scans may be round numbers and exact; what a wire tells was rounded.
    let steps = if report.is_of_map() { Steps::default() } else { Steps::of(&files.truth) };
    evaluation.nees = consistency::nees(&files.keyframes, &files.truth, steps);
    evaluation.step_nees = consistency::step_nees(&files.keyframes, &files.truth, steps);
    evaluation.associations =
        consistency::associations(&files.keyframes, &files.truth, world.map(|(world, _)| world));
    let Some((world, limits)) = world else { return evaluation };
    if let (Some(evidence), Some(first)) = (&files.evidence, files.truth.first()) {
        let start = Point3::from(first.pose.translation.vector);
        let reachable = coverage::reachable(world, limits, &start);
        let (reachable_m2, explored_m2) = coverage::coverage(&reachable, evidence);
        evaluation.reachable_m2 = Some(reachable_m2);
        evaluation.explored_m2 = Some(explored_m2);
        evaluation.coverage = (reachable_m2 > 0.0).then(|| explored_m2 / reachable_m2);
    }
    evaluation.planes = planes(files, world, &true_from_map);
    evaluation
}

/// The frame of the map in the world, from where the run began.
fn true_from_map(files: &RunFiles) -> Option<Isometry3<f64>> {
    let first = files.trajectory.first()?;
    let from_s = settled_s(&files.truth)?;
    Some(at(&files.truth, first.time_s.max(from_s))? * first.pose.inverse())
}

/// Estimated and true pose at each time of the trajectory, in the world.
fn pairs(
    files: &RunFiles,
    true_from_map: &Isometry3<f64>,
) -> Vec<(Isometry3<f64>, Isometry3<f64>)> {
    let from_s = settled_s(&files.truth).unwrap_or_default();
    let pair = |timed: &TimedPose| {
        Some((true_from_map * timed.pose, at(&files.truth, timed.time_s.max(from_s))?))
    };
    files.trajectory.iter().filter_map(pair).collect()
}

fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.translation.vector - b.translation.vector).norm()
}

fn absolute(
    files: &RunFiles,
    true_from_map: &Isometry3<f64>,
    pairs: &[(Isometry3<f64>, Isometry3<f64>)],
) -> Option<AbsoluteError> {
    let (last, last_true) = (files.trajectory.last()?, files.truth.last()?);
    let errors: Vec<f64> = pairs.iter().map(|(own, truth)| apart(own, truth)).collect();
    let end = true_from_map * last.pose;
    Some(AbsoluteError {
        poses: errors.len(),
        rmse_m: rms(&errors),
        mean_m: errors.iter().sum::<f64>() / errors.len().max(1) as f64,
        max_m: errors.iter().copied().fold(0.0, f64::max),
        final_m: apart(&end, &last_true.pose),
        final_deg: end.rotation.angle_to(&last_true.pose.rotation).to_degrees(),
    })
}

fn relative(pairs: &[(Isometry3<f64>, Isometry3<f64>)]) -> Option<RelativeError> {
    let mut driven_m = vec![0.0];
    for pair in pairs.windows(2) {
        driven_m.push(driven_m[driven_m.len() - 1] + apart(&pair[0].1, &pair[1].1));
    }
    let (mut translations, mut rotations) = (Vec::new(), Vec::new());
    for (from, (own, truth)) in pairs.iter().enumerate() {
        let to = driven_m.partition_point(|driven| *driven < driven_m[from] + RPE_OVER_M);
        let Some((own_to, truth_to)) = pairs.get(to) else { break };
        let error = (truth.inverse() * truth_to).inverse() * (own.inverse() * own_to);
        translations.push(error.translation.vector.norm());
        rotations.push(error.rotation.angle().to_degrees());
    }
    (!translations.is_empty()).then(|| RelativeError {
        stretches: translations.len(),
        over_m: RPE_OVER_M,
        translation_rmse_m: rms(&translations),
        rotation_rmse_deg: rms(&rotations),
    })
}

fn planes(files: &RunFiles, world: &World, true_from_map: &Isometry3<f64>) -> Option<PlaneErrors> {
    if files.patches.is_empty() {
        return None;
    }
    let (mut offsets, mut tilts) = (Vec::new(), Vec::new());
    for patch in &files.patches {
        if let Some(found) = true_surface(patch, world, true_from_map) {
            offsets.push(found.offset_m);
            tilts.push(found.tilt_deg);
        }
    }
    let sizes: Vec<f64> = offsets.iter().map(|offset| offset.abs()).collect();
    let of_any = |value: f64| (!offsets.is_empty()).then_some(value);
    Some(PlaneErrors {
        matched: offsets.len(),
        unmatched: files.patches.len() - offsets.len(),
        offset_rmse_m: of_any(rms(&offsets)),
        offset_median_m: of_any(median(&sizes)),
        tilt_rmse_deg: of_any(rms(&tilts)),
        tilt_median_deg: of_any(median(&tilts)),
    })
}

/// A true surface under a patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnderPatch {
    /// A point of it, in the world.
    pub point: Point3<f64>,
    /// Its outward unit normal, in the world.
    pub normal: Vector3<f64>,
    /// How far the patch lies before it, along the patch's normal, in metres.
    pub offset_m: f64,
    /// Angle between the two normals in degrees.
    pub tilt_deg: f64,
}

/// How far behind what it has hit a ray is cast anew, in metres.
const BEYOND_M: f64 = 0.005;

/// The surface that a patch lies on as a whole: at the median of its points' offsets. `None` where most lie
/// on none. `true_from_map` leads from the patch's frame into the world.
fn true_surface(
    patch: &Patch,
    world: &World,
    true_from_map: &Isometry3<f64>,
) -> Option<UnderPatch> {
    middle_surface(true_surfaces(patch, world, true_from_map))
}

/// Of the surfaces under a patch's points the one at the median of their offsets.
pub(super) fn middle_surface(mut found: Vec<UnderPatch>) -> Option<UnderPatch> {
    found.sort_by(|a, b| a.offset_m.total_cmp(&b.offset_m));
    found.get(found.len() / 2).copied()
}

/// The surfaces under a patch's centroid and under each of its corners, where there is one; empty where
/// there is none under most of them.
pub(super) fn true_surfaces(
    patch: &Patch,
    world: &World,
    true_from_map: &Isometry3<f64>,
) -> Vec<UnderPatch> {
    let normal = true_from_map * patch.normal;
    let corners =
        patch.hull.iter().map(|corner| patch.centroid + (corner - patch.centroid) * (1.0 - INSET));
    let found: Vec<UnderPatch> = std::iter::once(patch.centroid)
        .chain(corners)
        .filter_map(|point| surface_at(&(true_from_map * point), &normal, world))
        .collect();
    if 2 * found.len() > patch.hull.len() { found } else { Vec::new() }
}

/// The surface facing along `normal` that is nearest to `point`; `None` where none is near. What stands in
/// front of it, a step before a wall, is another one.
fn surface_at(point: &Point3<f64>, normal: &Vector3<f64>, world: &World) -> Option<UnderPatch> {
    let from = point + normal * SAME_SURFACE_M;
    let mut nearest: Option<UnderPatch> = None;
    let mut begun_m = 0.0;
    while let Some(hit) =
        world.cast_ray(&(from - normal * begun_m), &-normal, 2.0 * SAME_SURFACE_M - begun_m)
    {
        let range_m = begun_m + hit.range_m;
        begun_m = range_m + BEYOND_M;
        let offset_m = range_m - SAME_SURFACE_M;
        let tilt_deg = Unit::new_normalize(hit.normal).angle(normal).to_degrees();
        let is_nearer = nearest.as_ref().is_none_or(|best| offset_m.abs() < best.offset_m.abs());
        // A ray that begins within a body meets no surface there.
        if hit.range_m > 0.0 && tilt_deg <= SAME_SURFACE_DEG && is_nearer {
            // A surface off the normal shifts the foot of the ray; the offset is along the normal.
            let point = from - normal * range_m;
            nearest = Some(UnderPatch { point, normal: hit.normal, offset_m, tilt_deg });
        }
    }
    nearest
}

fn path_length(path: &[TimedPose]) -> f64 {
    path.windows(2).map(|pair| apart(&pair[0].pose, &pair[1].pose)).sum()
}

fn rms(values: &[f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::MapFile;
    use nalgebra::UnitQuaternion;
    use std::collections::BTreeMap;

    fn drive(heading: f64) -> Vec<TimedPose> {
        let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, heading);
        (0..=40)
            .map(|i| TimedPose {
                time_s: f64::from(i),
                pose: Isometry3::from_parts(
                    (turn * Vector3::new(0.1 * f64::from(i), 0.0, 0.2)).into(),
                    turn,
                ),
            })
            .collect()
    }

    #[test]
    fn a_path_that_is_one_percent_long_is_one_centimetre_off_per_metre() {
        let mut own = drive(0.0);
        for timed in &mut own {
            timed.pose.translation.x *= 1.01;
        }
        let files = RunFiles { trajectory: own, truth: drive(0.7), ..RunFiles::default() };
        let evaluation = evaluate(&files, None);
        let (ate, rpe) = (evaluation.ate.unwrap(), evaluation.rpe.unwrap());
        assert!((ate.final_m - 0.04).abs() < 1e-9 && ate.final_deg < 1e-6, "{ate:?}");
        // A stretch ends at the first pose beyond its metre.
        assert!((0.01..0.0102).contains(&rpe.translation_rmse_m), "{rpe:?}");
        assert!((evaluation.drift_percent.unwrap() - 1.0).abs() < 1e-6);
        assert_eq!(evaluation.coverage, None);
    }

    #[test]
    fn a_plane_behind_a_thin_board_is_not_taken_for_the_board() {
        // A board stands 0.2 m before the wall at x = 4.
        let map = "name = \"m\"\nbounds = [0.0, 0.0, 6.0, 4.0]\n\
                   [[box]]\ncenter = [4.5, 2.0, 1.0]\nsize = [1.0, 4.0, 2.0]\n\
                   [[box]]\ncenter = [3.75, 2.0, 1.0]\nsize = [0.1, 4.0, 2.0]\n";
        let world = World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap();
        let x_of = |x: f64| {
            let hull = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
                .map(|(y, z)| Point3::new(x, 2.0 + y, 1.0 + z))
                .to_vec();
            let centroid = Point3::new(x, 2.0, 1.0);
            let patch = Patch { normal: -Vector3::x(), centroid, hull };
            true_surface(&patch, &world, &Isometry3::identity()).unwrap().point.x
        };
        assert!((x_of(4.01) - 4.0).abs() < 1e-9, "the wall, not the board: {}", x_of(4.01));
        assert!((x_of(3.69) - 3.7).abs() < 1e-9, "the board: {}", x_of(3.69));
    }

    #[test]
    fn planes_are_compared_with_the_surface_they_lie_on() {
        let map = "name = \"m\"\nbounds = [0.0, 0.0, 6.0, 4.0]\n\
                   [[box]]\ncenter = [3.0, 2.0, -0.5]\nsize = [6.0, 4.0, 1.0]\n";
        let world = World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap();
        let tilt = 0.01_f64;
        let patch = |z: f64| Patch {
            normal: Vector3::new(tilt.sin(), 0.0, tilt.cos()),
            centroid: Point3::new(3.0, 2.0, z),
            hull: [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
                .map(|(x, y)| Point3::new(3.0 + x, 2.0 + y, z - x * tilt.tan()))
                .to_vec(),
        };
        let files = RunFiles {
            trajectory: drive(0.0),
            truth: drive(0.0),
            patches: vec![patch(0.02), patch(2.0)],
            ..RunFiles::default()
        };
        let limits = Passability {
            radius_m: 0.25,
            height_m: 0.8,
            max_step_m: 0.06,
            max_slope: 0.38,
            max_gap_m: 0.1,
        };
        let planes = evaluate(&files, Some((&world, &limits))).planes.unwrap();
        assert_eq!((planes.matched, planes.unmatched), (1, 1));
        assert!((planes.offset_rmse_m.unwrap() - 0.02).abs() < 1e-3, "{planes:?}");
        assert!((planes.tilt_rmse_deg.unwrap() - tilt.to_degrees()).abs() < 1e-6, "{planes:?}");
        // Of another world nothing is told to be exact.
        let files = RunFiles { patches: vec![patch(2.0)], ..files };
        let planes = evaluate(&files, Some((&world, &limits))).planes.unwrap();
        assert_eq!((planes.matched, planes.unmatched), (0, 1));
        assert_eq!((planes.offset_rmse_m, planes.tilt_median_deg), (None, None));
    }
}
