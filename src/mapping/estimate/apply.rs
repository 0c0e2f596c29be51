//! Taking a scan in: new variables and measurements, the solution, and the test after it.

use super::candidates::Led;
use super::curves::gate;
use super::{Arrival, Attitude, Estimate, Keyframe, Prepared, Roots, Sighting};
use crate::mapping::association::{Assignment, AssociationConfig, Verdict};
use crate::mapping::graph::{Factor, FactorId, Value};
use crate::mapping::innovation::Innovation;
use crate::mapping::landmark::{Landmark, LandmarkId};
use crate::mapping::observation::Observation;
use crate::mapping::odometry::predicted_covariance;
use crate::mapping::perturbation::{perturbed_pose, pose_error};
use crate::mapping::report::{Addition, Association, RefusalReason, UpdateReport};
use crate::mapping::scan_errors::CommonColumns;
use nalgebra::{Isometry3, Matrix6, Point3, Vector6};
use std::sync::Arc;

/// Most planes that one scan may bring in, the largest first: all of a scan's planes are tied to one
/// pose, and what a thousand slivers add does not pay for a joint covariance of three thousand rows.
const MOST_PLANES: usize = 150;
/// Most pairs that the test after the update may drop.
const MOST_DROPPED: usize = 4;
/// Standard deviation of a pose's turn, in radians, from which on the graph is linearised the more finely the
/// greater it is. Planes that leave a heading open, a floor and a ceiling, say something of it where they are
/// linearised a little off their solution: by as much as they are off and as it is open.
const OPEN_RAD: f64 = 1e-3;

impl Estimate {
    /// What each observation is under an assignment.
    pub(in crate::mapping) fn verdicts(
        &self,
        arrival: &Arrival<'_>,
        prepared: &Prepared,
        assignment: &Assignment,
        config: &AssociationConfig,
    ) -> Vec<Verdict> {
        let landmarks = self.named(&prepared.planes);
        let mut verdicts = prepared.question(arrival, &landmarks).decide(assignment, config);
        for index in beyond_the_largest(&arrival.scan.observations) {
            verdicts[index] = Verdict::Crowded;
        }
        // What was not compared with all that it may be is not known to be new.
        for (verdict, &cut) in verdicts.iter_mut().zip(&prepared.cut) {
            if cut && matches!(verdict, Verdict::New) {
                *verdict = Verdict::Crowded;
            }
        }
        verdicts
    }

    /// Takes a scan in under one of its assignments, with what that says of each observation.
    pub(in crate::mapping) fn apply(
        &mut self,
        arrival: &Arrival<'_>,
        prepared: &Prepared,
        assignment: &Assignment,
        verdicts: &[Verdict],
        config: &AssociationConfig,
    ) -> UpdateReport {
        let observations = &arrival.scan.observations;
        let landmarks = self.named(&prepared.planes);
        let question = prepared.question(arrival, &landmarks);
        let nis = question.joint_nis(&prepared.belief, &assignment.belief, verdicts);

        let mut report = UpdateReport::begun(self.keyframes.len(), nis);
        let pairs = verdicts.iter().enumerate().filter_map(|(index, verdict)| match *verdict {
            Verdict::Seen(plane, _) => {
                let key = self.roots[&landmarks[plane].id].key;
                Some((&observations[index], self.graph.linearised_at(key).plane()))
            }
            _ => None,
        });
        let guess = self.beside_last(&assignment.belief.world_from_robot);
        let guess = beside_landmarks(&guess, pairs);
        self.add_keyframe(arrival, prepared, assignment, guess);
        for (index, verdict) in verdicts.iter().enumerate() {
            let observation = &observations[index];
            let common = prepared.common[index];
            match *verdict {
                Verdict::Seen(plane, distance_squared) => {
                    let landmark = prepared.planes[plane];
                    self.see(index, landmark, observation, common);
                    let pair = Association { observation: index, landmark, distance_squared };
                    report.associations.push(pair);
                }
                Verdict::New => {
                    let landmark = self.add_landmark(index, observation, common);
                    report.added.push(Addition { observation: index, landmark });
                }
                Verdict::Crowded => report.refuse(index, RefusalReason::Crowded),
                Verdict::Ambiguous => report.refuse(index, RefusalReason::Ambiguous),
                Verdict::Doubtful(distance) => {
                    report.refuse(index, RefusalReason::Doubtful(distance));
                }
            }
        }
        report.nis_degrees = 3 * report.associations.len();
        let (_, turn_rad2) = assignment.belief.pose_spread();
        let fineness = 1.0 / (1.0 + turn_rad2 / (OPEN_RAD * OPEN_RAD));
        self.solve(&mut report, config, fineness);
        let solve = |estimate: &mut Self, report: &mut UpdateReport| {
            estimate.solve(report, config, fineness);
        };
        self.take_curves(arrival, &mut report, solve);
        // What is united was seen when either of the two was.
        report.loop_closed = self.closes_loop(&report);
        if self.unite_doubles(&mut report) {
            self.solve(&mut report, config, fineness);
            self.redraw_united(&report);
        }
        self.keep_up(&mut report, arrival.scan);
        report
    }

    /// A pose beside where the last keyframe is linearised, from where it is beside its solution.
    fn beside_last(&self, world_from_robot: &Isometry3<f64>) -> Isometry3<f64> {
        let Some(last) = self.keyframes.last() else { return *world_from_robot };
        let last_from_robot = self.graph.pose(last.pose).inverse() * world_from_robot;
        self.graph.linearised_at(last.pose).pose() * last_from_robot
    }

    /// Adds the variables of a new keyframe and what ties them to the past.
    fn add_keyframe(
        &mut self,
        arrival: &Arrival<'_>,
        prepared: &Prepared,
        assignment: &Assignment,
        guess: Isometry3<f64>,
    ) {
        let pose = self.graph.add_variable(Value::Pose(guess));
        let covariance = prepared.motion_covariance;
        self.graph.add_factor(match self.keyframes.last() {
            Some(last) => Factor::Between {
                before: last.pose,
                after: pose,
                before_from_after: prepared.motion,
                covariance,
            },
            None => Factor::Prior {
                pose,
                world_from_robot: self.start * prepared.motion,
                covariance: predicted_covariance(
                    &self.start,
                    &self.start_covariance,
                    &prepared.motion,
                    &covariance,
                ),
            },
        });
        if let Some(Attitude { roll_rad, pitch_rad, sigma_rad }) = arrival.attitude {
            self.graph.add_factor(Factor::Attitude { pose, roll_rad, pitch_rad, sigma_rad });
        }
        let errors = arrival.scan.errors.any().then(|| {
            let key = self.graph.add_variable(Value::Errors(assignment.belief.errors()));
            self.graph.add_factor(Factor::ErrorPrior { errors: key });
            key
        });
        self.keyframe_of.insert(pose, self.keyframes.len());
        self.keyframes.push(Keyframe {
            pose,
            errors,
            told: guess,
            sightings: Vec::new(),
            curves: Vec::new(),
            robot_from_eye: Point3::from(arrival.scan.robot_from_scan.translation.vector),
            led: Led::by(&covariance),
        });
    }

    /// Adds the measurement of a landmark from the newest keyframe.
    fn see(
        &mut self,
        index: usize,
        landmark: LandmarkId,
        observation: &Observation,
        common: Option<CommonColumns<3>>,
    ) {
        let number = self.keyframes.len() - 1;
        let keyframe = &mut self.keyframes[number];
        let roots = self.roots.get_mut(&landmark).expect("a landmark has roots");
        let factor = self.graph.add_factor(Factor::Plane {
            pose: keyframe.pose,
            plane: roots.key,
            errors: keyframe.errors.zip(common),
            robot_from_plane: observation.robot_from_plane,
            covariance: observation.covariance,
        });
        roots.sightings.push((number, index));
        keyframe.sightings.push(Sighting {
            index,
            landmark,
            factor,
            observation: Arc::new(observation.clone()),
            drawn: None,
        });
    }

    /// Adds a landmark that the newest keyframe sees first.
    fn add_landmark(
        &mut self,
        index: usize,
        observation: &Observation,
        common: Option<CommonColumns<3>>,
    ) -> LandmarkId {
        let id = LandmarkId(self.next_landmark);
        self.next_landmark += 1;
        let number = self.keyframes.len() - 1;
        let world_from_robot = self.graph.pose(self.keyframes[number].pose);
        let landmark = Landmark::first_seen(id, observation, &world_from_robot, number);
        let key = self.graph.add_variable(Value::Plane(landmark.world_from_plane));
        self.landmark_of.insert(key, id);
        self.roots.insert(id, Roots { key, sightings: Vec::new() });
        self.landmarks.push(landmark);
        self.see(index, id, observation, common);
        id
    }

    /// Solves the graph, as finely as it is told, and again without the pair that fits worst as long as one
    /// does not fit.
    fn solve(&mut self, report: &mut UpdateReport, config: &AssociationConfig, fineness: f64) {
        for round in 0..=MOST_DROPPED {
            let update = self.graph.update_finely(fineness);
            report.iterations += update.rounds;
            self.follow(&update.changed, report);
            let (planes, curves) = (self.worst_plane(report), self.worst_curve());
            let excess =
                |worst: Option<(f64, f64)>| worst.map_or(0.0, |(square, gate)| square / gate);
            let plane_excess = excess(planes.map(|(square, ..)| (square, config.gate)));
            let curve_excess = excess(curves.map(|(square, gate, _)| (square, gate)));
            if plane_excess.max(curve_excess) <= 1.0 || round == MOST_DROPPED {
                return;
            }
            if let Some((_, _, at)) = curves.filter(|_| curve_excess > plane_excess) {
                let keyframe = self.keyframes.last_mut().expect("the scan's keyframe is there");
                let dropped = keyframe.curves.remove(at);
                self.graph.remove_factor(dropped.factor);
                report.curves_refused += 1;
            } else if let Some((distance, observation, factor)) = planes {
                self.drop_newest_sighting(observation, factor);
                report.associations.retain(|pair| pair.observation != observation);
                report.refuse(observation, RefusalReason::FailedRetest(distance));
            }
        }
    }

    /// The accepted plane that fits worst: squared distance, observation, factor.
    fn worst_plane(&self, report: &UpdateReport) -> Option<(f64, usize, FactorId)> {
        let pairs = report.associations.iter().filter_map(|pair| {
            let factor = self.newest_sighting(pair.observation)?.factor;
            Some((self.graph.residual(factor)?.norm_squared(), pair.observation, factor))
        });
        pairs.max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// The accepted curve that fits worst: squared distance, gate, place among the keyframe's.
    fn worst_curve(&self) -> Option<(f64, f64, usize)> {
        let sightings = &self.keyframes.last()?.curves;
        let pairs = sightings.iter().enumerate().filter_map(|(at, sighting)| {
            let square = self.graph.residual(sighting.factor)?.norm_squared();
            Some((square, gate(self.curves[sighting.curve].kind), at))
        });
        pairs.max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)))
    }

    fn newest_sighting(&self, index: usize) -> Option<&Sighting> {
        let keyframe = self.keyframes.last()?;
        keyframe.sightings.iter().find(|sighting| sighting.index == index)
    }

    fn drop_newest_sighting(&mut self, index: usize, factor: FactorId) {
        self.graph.remove_factor(factor);
        let number = self.keyframes.len() - 1;
        let sightings = &mut self.keyframes[number].sightings;
        let Some(at) = sightings.iter().position(|sighting| sighting.index == index) else {
            return;
        };
        let landmark = sightings.remove(at).landmark;
        if let Some(roots) = self.roots.get_mut(&landmark) {
            roots.sightings.retain(|sighting| *sighting != (number, index));
        }
    }
}

/// Rounds in which a guess is improved, and the standard deviations (metres, radians) with which it holds
/// where no landmark speaks.
const GUESS_ROUNDS: usize = 3;
const GUESS_SIGMAS: (f64, f64) = (0.5, 0.1);

/// The pose from which landmarks, where they are linearised, look as observed. The graph begins there:
/// begun elsewhere, all its neighbours would have to be linearised anew, and until then a turn of the
/// map as a whole would look as if it were measured.
fn beside_landmarks<'a>(
    guess: &Isometry3<f64>,
    pairs: impl Iterator<Item = (&'a Observation, &'a Isometry3<f64>)> + Clone,
) -> Isometry3<f64> {
    let (sigma_m, sigma_rad) = GUESS_SIGMAS;
    let held = Matrix6::from_diagonal(&Vector6::from_fn(|i, _| {
        if i < 3 { sigma_m.powi(-2) } else { sigma_rad.powi(-2) }
    }));
    let mut pose = *guess;
    for _ in 0..GUESS_ROUNDS {
        let mut information = held;
        let mut gradient = held * pose_error(guess, &pose);
        for (seen, frame) in pairs.clone() {
            let innovation = Innovation::new(frame, &pose, &seen.robot_from_plane);
            let Some(weight) = innovation.information(&seen.covariance) else { continue };
            let weighted = innovation.h_x.transpose() * weight;
            information += weighted * innovation.h_x;
            gradient += weighted * innovation.h;
        }
        let Some(step) = information.cholesky().map(|root| root.solve(&gradient)) else {
            return *guess;
        };
        pose = perturbed_pose(&pose, &-step);
    }
    pose
}

/// The observations beyond the [`MOST_PLANES`] of most points.
fn beyond_the_largest(observations: &[Observation]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..observations.len()).collect();
    order.sort_by_key(|&index| (std::cmp::Reverse(observations[index].points), index));
    order.split_off(order.len().min(MOST_PLANES))
}
