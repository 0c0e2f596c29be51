//! Cylinders and spheres of a scan: recognised once its planes have placed the robot, so that what is
//! left to ask is which of a few columns each of them is.

use super::upkeep::LOOP_SCANS;
use super::{Arrival, CurveSighting, Estimate};
use crate::mapping::curved::{CurveKind, CurvedLandmark, CurvedObservation};
use crate::mapping::graph::{Factor, Key};
use crate::mapping::report::UpdateReport;
use nalgebra::Isometry3;

/// Squared Mahalanobis distance within which a curve may be a landmark: 99.9 % of χ² with four and
/// with three degrees of freedom.
const AXIS_GATE: f64 = 18.47;
const CENTRE_GATE: f64 = 16.27;
/// How much farther than the nearest landmark the next must be: columns stand in rows, and a pose that
/// is open by half their spacing fits two of them.
const CLEAR: f64 = 20.0;
/// Spacing of curves of one kind where none is nearer: beyond the last of a row there may be one more
/// that no scan has shown, so that a pose must be known to half the spacing even where one alone fits.
const SPACING_M: f64 = 3.0;
/// Radii of one body agree within their deviations times the first, and the second and third of what
/// bark, paint and a slanting cut make of them (metres, share).
const RADIUS_SIGMAS: f64 = 3.0;
const RADIUS_SLACK_M: f64 = 0.02;
const RADIUS_SLACK_SHARE: f64 = 0.05;
/// A landmark is looked for this far around where it is seen, beyond what the pose is open by.
const ABOUT_M: f64 = 1.0;
const REACH_SIGMAS: f64 = 3.5;
/// Rounds in which those recognised so far help with the rest.
const ROUNDS: usize = 3;

/// Squared Mahalanobis distance up to which a curve of a kind may be a landmark.
pub(super) fn gate(kind: CurveKind) -> f64 {
    match kind {
        CurveKind::Cylinder => AXIS_GATE,
        CurveKind::Sphere => CENTRE_GATE,
    }
}

/// How a curve fits a landmark.
struct Fit {
    /// Squared Mahalanobis distance.
    square: f64,
    /// Gap between both in metres, and the greatest standard deviation that it has in any direction.
    misfit_m: f64,
    sigma_m: f64,
}

impl Estimate {
    /// Takes in the curves of the newest keyframe. What could be one of several landmarks, or shares
    /// room with one that it is too far from to be, is used for nothing.
    pub(super) fn take_curves(
        &mut self,
        arrival: &Arrival<'_>,
        report: &mut UpdateReport,
        mut solve: impl FnMut(&mut Self, &mut UpdateReport),
    ) {
        let curves = &arrival.scan.curves;
        let mut pending: Vec<usize> = (0..curves.len()).collect();
        for _ in 0..ROUNDS {
            let mut found = self.clear_pairs(arrival, &pending);
            if found.is_empty() {
                found = self.constellation(arrival, &pending);
            }
            if found.is_empty() {
                break;
            }
            for &(index, slot) in &found {
                self.see_curve(index, slot, arrival);
            }
            solve(self, report);
            pending.retain(|index| found.iter().all(|(known, _)| known != index));
        }
        for index in pending {
            if self.is_apart(arrival, &curves[index]) {
                self.add_curve(index, arrival);
                report.curves_new += 1;
            } else {
                report.curves_refused += 1;
            }
        }
        if report.curves_new > 0 {
            solve(self, report);
        }
    }

    /// Curves that are one landmark and no other, each landmark for one of them at most.
    fn clear_pairs(&self, arrival: &Arrival<'_>, pending: &[usize]) -> Vec<(usize, usize)> {
        let curves = &arrival.scan.curves;
        // Index of the curve, place of the landmark, squared distance.
        let mut clear: Vec<(usize, usize, f64)> = Vec::new();
        for &index in pending {
            let seen = &curves[index];
            let mut options: Vec<(Fit, usize)> = self
                .curve_candidates(seen)
                .filter_map(|slot| Some((self.curve_fit(arrival, seen, slot)?, slot)))
                .collect();
            options.sort_by(|a, b| a.0.square.total_cmp(&b.0.square).then(a.1.cmp(&b.1)));
            let Some((fit, slot)) = options.first() else { continue };
            let next = options.get(1).map_or(f64::INFINITY, |option| option.0.square);
            let open_m = fit.misfit_m + REACH_SIGMAS * fit.sigma_m;
            let is_clear = fit.square < gate(seen.kind)
                && next > fit.square + CLEAR
                && open_m < 0.5 * self.spacing_m(*slot, seen, curves);
            if is_clear {
                clear.push((index, *slot, fit.square));
            }
        }
        let alone = |&(index, slot, square): &(usize, usize, f64)| {
            let rivals = clear.iter().filter(|other| other.1 == slot && other.0 != index);
            rivals.fold(f64::INFINITY, |least, rival| least.min(rival.2)) > square + CLEAR
        };
        clear.iter().filter(|pair| alone(pair)).map(|&(index, slot, _)| (index, slot)).collect()
    }

    /// Distance between the nearest two curves of a kind about a landmark and its sighting, in the map
    /// or in the scan, [`SPACING_M`] at most.
    fn spacing_m(&self, slot: usize, seen: &CurvedObservation, all: &[CurvedObservation]) -> f64 {
        let at = |frame: &Isometry3<f64>| frame.translation.vector;
        let landmark = &self.curves[slot];
        let mapped = self
            .curves
            .iter()
            .enumerate()
            .filter(|(other, curve)| *other != slot && curve.kind == seen.kind);
        let mapped = mapped.map(|(_, curve)| {
            (at(&curve.world_from_curve) - at(&landmark.world_from_curve)).norm()
        });
        let scanned = all.iter().filter(|other| *other != seen && other.kind == seen.kind);
        let scanned =
            scanned.map(|other| (at(&other.robot_from_curve) - at(&seen.robot_from_curve)).norm());
        mapped.chain(scanned).fold(SPACING_M, f64::min)
    }

    /// Landmarks that may be a curve by kind, radius and place.
    pub(super) fn curve_candidates<'a>(
        &'a self,
        seen: &'a CurvedObservation,
    ) -> impl Iterator<Item = usize> + 'a {
        let pose = self.last_pose();
        let covariance = self.last_covariance();
        let sigma = |range: std::ops::Range<usize>| {
            range.map(|i| covariance[(i, i)].max(0.0)).fold(0.0, f64::max).sqrt()
        };
        let reach = seen.robot_from_curve.translation.vector.norm();
        let open_m = ABOUT_M + REACH_SIGMAS * (sigma(0..3) + reach * sigma(3..6));
        let number = self.keyframes.len() - 1;
        self.curves.iter().enumerate().filter_map(move |(slot, landmark)| {
            let taken = self.keyframes[number].curves.iter().any(|s| s.curve == slot);
            let fits = !taken
                && landmark.kind == seen.kind
                && radii_agree(landmark, seen)
                && landmark.gap_m(seen, &pose) < open_m;
            fits.then_some(slot)
        })
    }

    /// How a curve fits a landmark; `None` where numbers fail.
    fn curve_fit(
        &self,
        arrival: &Arrival<'_>,
        seen: &CurvedObservation,
        slot: usize,
    ) -> Option<Fit> {
        let factor = self.curve_factor(arrival, seen, self.curves[slot].key);
        let (residual, spread) = self.graph.innovation(&factor);
        let square = residual.dot(&spread.clone().cholesky()?.solve(&residual));
        // Out of units of the sighting's own noise, into metres.
        let (root, offsets) = factor.curve_noise()?;
        let (residual, spread) = (&root * residual, &root * spread * root.transpose());
        let offsets = ..offsets;
        let spread = spread.view_range(offsets, offsets).into_owned();
        let sigma_m = spread.symmetric_eigenvalues().max().max(0.0).sqrt();
        Some(Fit { square, misfit_m: residual.rows_range(offsets).norm(), sigma_m })
    }

    fn curve_factor(&self, arrival: &Arrival<'_>, seen: &CurvedObservation, key: Key) -> Factor {
        let keyframe = self.keyframes.last().expect("the scan's keyframe is there");
        let errors = keyframe.errors.map(|key| (key, &arrival.scan.errors));
        seen.factor(keyframe.pose, key, errors, &arrival.scan.robot_from_scan)
    }

    /// Adds the measurement of a landmark from the newest keyframe.
    fn see_curve(&mut self, index: usize, slot: usize, arrival: &Arrival<'_>) {
        let seen = &arrival.scan.curves[index];
        let factor = self.curve_factor(arrival, seen, self.curves[slot].key);
        let factor = self.graph.add_factor(factor);
        let keyframe = self.keyframes.last_mut().expect("the scan's keyframe is there");
        keyframe.curves.push(CurveSighting { index, curve: slot, factor });
    }

    /// Adds a landmark that the newest keyframe sees first.
    fn add_curve(&mut self, index: usize, arrival: &Arrival<'_>) {
        let seen = &arrival.scan.curves[index];
        let pose = self.last_pose();
        let keyframe = self.keyframes.last().expect("the scan's keyframe is there");
        let guess = seen.guess(self.graph.linearised_at(keyframe.pose).pose());
        let key = self.graph.add_variable(guess);
        self.curve_of.insert(key, self.curves.len());
        let number = self.keyframes.len() - 1;
        self.curves.push(CurvedLandmark::first_seen(key, seen, &pose, number));
        self.see_curve(index, self.curves.len() - 1, arrival);
    }

    /// Whether a curve shares no room with a landmark and can be none of them.
    fn is_apart(&self, arrival: &Arrival<'_>, seen: &CurvedObservation) -> bool {
        let pose = self.last_pose();
        let alone = self.curves.iter().all(|l| l.kind != seen.kind || l.gap_m(seen, &pose) > 0.0);
        let known = |slot| {
            let fit = self.curve_fit(arrival, seen, slot);
            fit.is_none_or(|fit| fit.square < gate(seen.kind))
        };
        alone && !self.curve_candidates(seen).any(known)
    }

    /// Extends the landmarks that the newest keyframe saw again.
    pub(super) fn extend_curves(
        &mut self,
        report: &mut UpdateReport,
        curves: &[CurvedObservation],
    ) {
        let number = report.keyframe;
        let pose = self.last_pose();
        for sighting in &self.keyframes[number].curves {
            let landmark = &mut self.curves[sighting.curve];
            if landmark.first_keyframe == number {
                continue;
            }
            report.loop_closed |= landmark.last_keyframe + LOOP_SCANS < number;
            report.curves_known += 1;
            landmark.extend(&curves[sighting.index], &pose, number);
        }
    }
}

fn radii_agree(landmark: &CurvedLandmark, seen: &CurvedObservation) -> bool {
    let sigma = landmark.radius_sigma_m.hypot(seen.radius_sigma_m);
    let slack = RADIUS_SLACK_M + RADIUS_SLACK_SHARE * landmark.radius_m.min(seen.radius_m);
    (landmark.radius_m - seen.radius_m).abs() < RADIUS_SIGMAS * sigma + slack
}
