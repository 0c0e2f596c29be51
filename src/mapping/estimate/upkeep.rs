//! What hangs on the solution: landmarks' frames and extents, the index, corrected keyframes.

use super::Estimate;
use super::candidates::Led;
use crate::mapping::graph::Key;
use crate::mapping::index::Bounds;
use crate::mapping::innovation::Innovation;
use crate::mapping::landmark::LandmarkId;
use crate::mapping::moved::Gone;
use crate::mapping::perturbation::pose_error;
use crate::mapping::report::{MovedKeyframe, UpdateReport, weak_directions};
use crate::mapping::scan_errors::ScanObservations;
use nalgebra::{Isometry3, Matrix6};
use std::collections::BTreeSet;

/// A correction of an old pose that is worth telling: beyond it grid and trajectory are rebuilt.
const MOVED_M: f64 = 0.02;
const MOVED_RAD: f64 = 0.005;
/// A patch that has slid this far within its landmark is drawn anew, less than half a mask's cell.
const SLID_M: f64 = 0.02;
/// What a scan must leave of a direction, in metres, for that to be reported as weak.
const WEAK_M: f64 = 0.05;
/// Scans after which seeing a landmark again counts as the closing of a loop.
pub(super) const LOOP_SCANS: usize = 12;

impl Estimate {
    /// Carries the graph's solution over to landmarks, and notes which keyframes were corrected.
    pub(super) fn follow(&mut self, changed: &BTreeSet<Key>, report: &mut UpdateReport) {
        for key in changed {
            if let Some(slot) = self.landmark_of.get(key).and_then(|id| self.slot(*id)) {
                self.landmarks[slot].world_from_plane = self.graph.plane(*key);
                self.refile(slot);
            }
            if let Some(&slot) = self.curve_of.get(key) {
                self.curves[slot].follow(&self.graph.value(*key));
            }
            if let Some(&number) = self.keyframe_of.get(key) {
                let pose = self.graph.pose(*key);
                let told = self.keyframes[number].told;
                let gap = pose_error(&told, &pose);
                let far = gap.fixed_rows::<3>(0).norm() > MOVED_M
                    || gap.fixed_rows::<3>(3).norm() > MOVED_RAD;
                let newest = number + 1 == self.keyframes.len();
                if newest {
                    self.keyframes[number].told = pose;
                } else if far {
                    self.keyframes[number].told = pose;
                    report.moved.retain(|moved| moved.keyframe != number);
                    report.moved.push(MovedKeyframe {
                        keyframe: number,
                        before: told,
                        world_from_robot: pose,
                    });
                }
            }
        }
        report.moved.sort_by_key(|moved| moved.keyframe);
    }

    /// Whether a scan that was taken in sees a landmark again after a long way.
    pub(super) fn closes_loop(&self, report: &UpdateReport) -> bool {
        report
            .associations
            .iter()
            .filter_map(|pair| self.landmark(pair.landmark))
            .any(|landmark| landmark.last_keyframe + LOOP_SCANS < report.keyframe)
    }

    /// Extends the landmarks that a scan saw, redraws those whose old sightings slid, and completes
    /// the report.
    pub(super) fn keep_up(&mut self, report: &mut UpdateReport, scan: &ScanObservations) {
        let number = report.keyframe;
        let pose = self.last_pose();
        let mut moved = BTreeSet::new();
        for keyframe in &report.moved {
            moved.extend(self.keyframes[keyframe.keyframe].sightings.iter().map(|s| s.landmark));
        }
        let slid: Vec<LandmarkId> = moved.into_iter().filter(|&id| self.has_slid(id)).collect();
        for pair in &report.associations {
            let Some(slot) = self.slot(pair.landmark) else { continue };
            let landmark = &mut self.landmarks[slot];
            if landmark.last_keyframe != number {
                landmark.sightings += 1;
                landmark.last_keyframe = number;
            }
        }
        for id in slid {
            self.redraw_extent(id);
        }
        self.draw_newest();
        // While the scan was solved its pose may have gone far along what it leaves open.
        for added in &report.added {
            if self.has_slid(added.landmark) {
                self.redraw_extent(added.landmark);
            }
        }
        self.extend_curves(report, &scan.curves);
        if let Some(covariance) = self.motion_covariance(number.saturating_sub(1), number) {
            self.keyframes[number].led = Led::by(&covariance);
        }
        let touched: Vec<LandmarkId> = report
            .associations
            .iter()
            .map(|pair| pair.landmark)
            .chain(report.added.iter().map(|added| added.landmark))
            .collect();
        self.renew_covariances(&touched);
        report.world_from_robot = pose;
        report.covariance = self.last_covariance();
        let information = self.newest_information(&pose);
        report.weak_directions = weak_directions(&information, &pose, WEAK_M);
    }

    /// Whether a patch of a landmark lies elsewhere within it by now than where it was drawn.
    fn has_slid(&self, id: LandmarkId) -> bool {
        let (Some(landmark), Some(roots)) = (self.landmark(id), self.roots.get(&id)) else {
            return false;
        };
        let plane_from_world = landmark.world_from_plane.inverse();
        roots.sightings.iter().any(|&(number, index)| {
            let keyframe = &self.keyframes[number];
            let sighting = keyframe.sightings.iter().find(|s| s.index == index);
            sighting.and_then(|s| Some((s.drawn?, s))).is_some_and(|(drawn, s)| {
                let now = plane_from_world
                    * self.graph.pose(keyframe.pose)
                    * s.observation.robot_from_plane;
                let gap = pose_error(&drawn, &now);
                gap.fixed_rows::<3>(0).norm() > SLID_M || gap[5].abs() > MOVED_RAD
            })
        })
    }

    /// Hull and mask of a landmark anew from all its sightings: after a correction the patches lie
    /// elsewhere within the plane, which the plane itself does not show.
    pub(super) fn redraw_extent(&mut self, id: LandmarkId) {
        let (Some(slot), Some(roots)) = (self.slot(id), self.roots.get(&id)) else { return };
        let landmark = &mut self.landmarks[slot];
        landmark.hull.clear();
        landmark.mask = crate::mapping::mask::PlaneMask::default();
        (landmark.points, landmark.rms_m) = (0, 0.0);
        for &(number, index) in &roots.sightings {
            let keyframe = &mut self.keyframes[number];
            let pose = self.graph.pose(keyframe.pose);
            if let Some(sighting) = keyframe.sightings.iter_mut().find(|s| s.index == index) {
                sighting.drawn = Some(landmark.extend(&sighting.observation, &pose));
            }
        }
        self.refile(slot);
    }

    /// Draws the newest keyframe's patches into their landmarks.
    fn draw_newest(&mut self) {
        let number = self.keyframes.len().saturating_sub(1);
        let Some(keyframe) = self.keyframes.last_mut() else { return };
        let pose = self.graph.pose(keyframe.pose);
        for sighting in keyframe.sightings.iter_mut().filter(|s| s.drawn.is_none()) {
            let Ok(slot) = self.landmarks.binary_search_by_key(&sighting.landmark, |l| l.id) else {
                continue;
            };
            let landmark = &mut self.landmarks[slot];
            // A landmark begins with the extent of its first patch, in that patch's own frame.
            sighting.drawn = Some(if landmark.first_keyframe == number {
                Isometry3::identity()
            } else {
                landmark.extend(&sighting.observation, &pose)
            });
        }
    }

    /// Takes landmarks for gone, which are neither looked for nor does anything contradict them, and parts of
    /// others for open.
    pub(in crate::mapping) fn let_go(&mut self, gone: &Gone) {
        for &id in &gone.landmarks {
            if let Some(slot) = self.slot(id) {
                self.landmarks[slot].gone = true;
                self.index.remove(id.0);
            }
        }
        for &(id, opening) in &gone.openings {
            if let Some(slot) = self.slot(id) {
                self.landmarks[slot].openings.push(opening);
            }
        }
    }

    /// Files a landmark in the index where it is now.
    pub(super) fn refile(&mut self, slot: usize) {
        let landmark = &self.landmarks[slot];
        if landmark.gone {
            return;
        }
        // A margin, so that small corrections change nothing in the index.
        if let Some(bounds) = Bounds::around(landmark.hull_points(), 0.1) {
            self.index.insert(landmark.id.0, bounds.coarse());
        }
    }

    fn renew_covariances(&mut self, touched: &[LandmarkId]) {
        let keys: Vec<Key> = touched.iter().map(|id| self.roots[id].key).collect();
        let joint = self.graph.covariance(&keys);
        for (i, &id) in touched.iter().enumerate() {
            if let Some(slot) = self.slot(id) {
                self.landmarks[slot].covariance =
                    joint.fixed_view::<3, 3>(3 * i, 3 * i).into_owned();
                self.refile(slot);
            }
        }
    }

    /// What the newest scan alone says about the pose when its landmarks are taken as exact.
    fn newest_information(&self, pose: &Isometry3<f64>) -> Matrix6<f64> {
        let Some(keyframe) = self.keyframes.last() else { return Matrix6::zeros() };
        let number = self.keyframes.len() - 1;
        let mut information = Matrix6::zeros();
        for sighting in &keyframe.sightings {
            let Some(landmark) = self.landmark(sighting.landmark) else { continue };
            // A landmark that is new ties nothing down.
            if landmark.first_keyframe == number {
                continue;
            }
            let seen = &sighting.observation;
            let innovation =
                Innovation::new(&landmark.world_from_plane, pose, &seen.robot_from_plane);
            if let Some(weight) = innovation.information(&seen.covariance) {
                information += innovation.h_x.transpose() * weight * innovation.h_x;
            }
        }
        for sighting in &keyframe.curves {
            if self.curves[sighting.curve].first_keyframe == number {
                continue;
            }
            let Some(linear) = self.graph.linearised(sighting.factor) else { continue };
            let on_pose = linear.jacobian.fixed_columns::<6>(0);
            information += on_pose.transpose() * on_pose;
        }
        information
    }
}
