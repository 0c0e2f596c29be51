//! Which landmarks a scan may show.

use super::{Estimate, Keyframe};
use crate::mapping::association::AssociationConfig;
use crate::mapping::index::Bounds;
use crate::mapping::landmark::{Landmark, LandmarkId};
use crate::mapping::observation::Observation;
use crate::mapping::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Matrix6, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// Most landmarks that one scan is compared with; those seen last come first. More than one scan may bring in.
const MOST_CANDIDATES: usize = 200;
/// Standard deviations within which a candidate is looked for, in the world and along the way: wheels
/// that err all to one side err by more than they tell after a while.
const REACH_SIGMAS: f64 = 3.5;
const WAY_SIGMAS: f64 = 5.0;
/// Limits of what an uncertain pose may open: beyond them nearly everything would be a candidate.
const MOST_OPEN_M: f64 = 20.0;
const MOST_OPEN_RAD: f64 = 0.6;

/// Variances of shift (m²) and turn (rad²) of the motion that led to a keyframe, over all axes: by
/// odometry before its scan is taken in, by all that is known then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Led {
    shift_m2: f64,
    turn_rad2: f64,
}

impl Led {
    /// From the motion's covariance.
    pub(super) fn by(covariance: &Matrix6<f64>) -> Self {
        let trace = |first: usize| (first..first + 3).map(|i| covariance[(i, i)]).sum::<f64>();
        Self { shift_m2: trace(0), turn_rad2: trace(3) }
    }
}

/// What a place is open by: metres at the robot, and radians.
#[derive(Clone, Copy)]
struct Open {
    shift_m: f64,
    turn_rad: f64,
}

/// What a scan's place is open by, in the world and beside what was seen from the keyframes.
pub(super) struct Window {
    world: Open,
    /// Of the last keyframes, the newest first; beside earlier ones it is open by as much as in the world.
    lately: Vec<Open>,
}

impl Window {
    /// From the predicted pose, its covariance in the world and the motion that led there.
    ///
    /// What the robot is off by in the world it shares with all that it saw lately: the next room's wall
    /// is none of this one's, however long the way was that led to both. Beside a keyframe it is off by
    /// what the motions since have summed up to, each turn with the distance from where it was made as its
    /// lever; what was seen from more than one keyframe makes that less.
    pub(super) fn new(
        world_from_robot: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
        led: Led,
        keyframes: &[Keyframe],
    ) -> Self {
        let spread = |range: std::ops::Range<usize>| {
            REACH_SIGMAS * range.map(|i| covariance[(i, i)].max(0.0)).fold(0.0, f64::max).sqrt()
        };
        let world = Open {
            shift_m: spread(0..3).min(MOST_OPEN_M),
            turn_rad: spread(3..6).min(MOST_OPEN_RAD),
        };
        let here = world_from_robot.translation.vector;
        let (mut shift_m2, mut turn_rad2) = (0.0, 0.0);
        let mut led = led;
        let mut lately = Vec::new();
        for keyframe in keyframes.iter().rev() {
            let lever_m2 = (keyframe.told.translation.vector - here).norm_squared();
            shift_m2 += led.shift_m2 + led.turn_rad2 * lever_m2;
            turn_rad2 += led.turn_rad2;
            led = keyframe.led;
            let open = Open {
                shift_m: (WAY_SIGMAS * f64::sqrt(shift_m2)).min(world.shift_m),
                turn_rad: (WAY_SIGMAS * f64::sqrt(turn_rad2)).min(world.turn_rad),
            };
            if open.shift_m >= world.shift_m && open.turn_rad >= world.turn_rad {
                break;
            }
            lately.push(open);
        }
        Self { world, lately }
    }

    /// Beside what was last seen so many keyframes ago, none being the newest.
    fn beside(&self, ago: usize) -> Open {
        self.lately.get(ago).copied().unwrap_or(self.world)
    }
}

/// An observation where it is predicted.
struct Predicted {
    frame: Isometry3<f64>,
    normal: Vector3<f64>,
    /// The box around its hull.
    bounds: Option<Bounds>,
    /// How far from the robot it lies, in metres.
    reach_m: f64,
}

impl Predicted {
    fn new(observation: &Observation, world_from_robot: &Isometry3<f64>) -> Self {
        let frame = world_from_robot * observation.robot_from_plane;
        let points = observation.hull_points().map(|p| world_from_robot * p);
        Self {
            frame,
            normal: frame.rotation * Vector3::z(),
            bounds: Bounds::around(points, 0.0),
            reach_m: observation.robot_from_plane.translation.vector.norm(),
        }
    }

    /// Whether a landmark in `bounds` faces it near enough, where the pose is open by so many metres and
    /// radians.
    fn may_be(
        &self,
        landmark: &Landmark,
        bounds: &Bounds,
        open: Open,
        config: &AssociationConfig,
    ) -> bool {
        let open_m = open.shift_m + self.reach_m * open.turn_rad;
        let apart = self.frame.translation.vector - landmark.origin().coords;
        let normal = landmark.normal();
        normal.dot(&self.normal) > (config.max_angle_rad + open.turn_rad).cos()
            && normal.dot(&apart).abs() < config.max_offset_m + open_m
            && self.bounds.is_some_and(|own| own.widened(config.max_gap_m + open_m).meets(bounds))
    }
}

impl Estimate {
    /// For each observation the landmarks that its box reaches and that face it, as positions in the
    /// list of all candidates, and whether some had to be left out.
    pub(super) fn candidates(
        &self,
        scan: &ScanObservations,
        predicted: &Isometry3<f64>,
        window: &Window,
        config: &AssociationConfig,
    ) -> (Vec<LandmarkId>, Vec<Vec<usize>>, Vec<bool>) {
        let seen: Vec<Predicted> =
            scan.observations.iter().map(|seen| Predicted::new(seen, predicted)).collect();
        let reach_m = seen.iter().map(|seen| seen.reach_m).fold(0.0, f64::max);
        let corners = seen.iter().filter_map(|seen| seen.bounds).flat_map(Bounds::corners);
        let whole = Bounds::around(corners, config.max_gap_m);
        let margin_m = |open: Open| open.shift_m + reach_m * open.turn_rad;
        let newest = self.keyframes.len().saturating_sub(1);
        let mut lists: Vec<Vec<LandmarkId>> = vec![Vec::new(); seen.len()];
        let corners = whole.into_iter().flat_map(Bounds::corners);
        for (landmark, bounds) in self.landmarks_about(corners, margin_m(window.world)) {
            let open = window.beside(newest.saturating_sub(landmark.last_keyframe));
            if !whole.is_some_and(|whole| whole.widened(margin_m(open)).meets(bounds)) {
                continue;
            }
            for (seen, list) in seen.iter().zip(&mut lists) {
                if seen.may_be(landmark, bounds, open, config) {
                    list.push(landmark.id);
                }
            }
        }
        let mut all: Vec<LandmarkId> = lists.iter().flatten().copied().collect();
        all.sort_unstable();
        all.dedup();
        if all.len() > MOST_CANDIDATES {
            let last_seen = |id: LandmarkId| self.landmark(id).map_or(0, |l| l.last_keyframe);
            all.sort_by_key(|&id| (std::cmp::Reverse(last_seen(id)), id));
            all.truncate(MOST_CANDIDATES);
            all.sort_unstable();
        }
        let positions: Vec<Vec<usize>> = lists
            .iter()
            .map(|list| list.iter().filter_map(|id| all.binary_search(id).ok()).collect())
            .collect();
        let cut = lists.iter().zip(&positions).map(|(all, kept)| kept.len() < all.len()).collect();
        (all, positions, cut)
    }

    /// The landmarks whose boxes meet the box around some points, `margin_m` wider on each side, with
    /// those boxes.
    pub(in crate::mapping) fn landmarks_about(
        &self,
        points: impl IntoIterator<Item = Point3<f64>>,
        margin_m: f64,
    ) -> impl Iterator<Item = (&Landmark, &Bounds)> {
        let near = Bounds::around(points, margin_m).map(|bounds| self.index.query(&bounds));
        near.into_iter()
            .flatten()
            .filter_map(|id| Some((self.landmark(LandmarkId(id))?, self.index.bounds(id)?)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::graph::Key;
    use nalgebra::Vector6;

    fn covariance(sigma_m: f64, sigma_rad: f64) -> Matrix6<f64> {
        let sigmas = [sigma_m, sigma_m, sigma_m, sigma_rad, sigma_rad, sigma_rad];
        Matrix6::from_diagonal(&Vector6::from(sigmas).map(|sigma| sigma * sigma))
    }

    fn keyframe(x_m: f64, led: Led) -> Keyframe {
        let told = Isometry3::translation(x_m, 0.0, 0.0);
        Keyframe {
            pose: Key(0),
            errors: None,
            told,
            sightings: Vec::new(),
            curves: Vec::new(),
            robot_from_eye: Point3::origin(),
            led,
        }
    }

    #[test]
    fn beside_what_was_seen_lately_a_place_is_open_by_the_last_motions_only() {
        let led = Led::by(&covariance(0.01, 0.002));
        let keyframes: Vec<Keyframe> = (0..100).map(|k| keyframe(f64::from(k), led)).collect();
        let here = Isometry3::translation(100.0, 0.0, 0.0);
        let window = Window::new(&here, &covariance(0.5, 0.02), led, &keyframes);
        let shift_sigma = |ago: usize| {
            let levers = (1..=ago + 1).map(|k| 0.002 * k as f64);
            (levers.map(|lever| 3.0 * (lever * lever + 1e-4)).sum::<f64>()).sqrt()
        };
        for ago in [0, 1, 5, 10] {
            let open = window.beside(ago);
            assert!((open.shift_m - WAY_SIGMAS * shift_sigma(ago)).abs() < 1e-12, "{ago}");
            let turn_rad = WAY_SIGMAS * 0.002 * (3.0 * (ago + 1) as f64).sqrt();
            assert!((open.turn_rad - turn_rad.min(window.world.turn_rad)).abs() < 1e-12, "{ago}");
        }
        // Never by more than in the world.
        let open = window.beside(99);
        assert_eq!((open.shift_m, open.turn_rad), (REACH_SIGMAS * 0.5, REACH_SIGMAS * 0.02));
    }
}
