//! Landmarks that turn out to be one surface: pieces of a wall that were first seen to both sides of a pillar, or
//! before and after a way that came back.
//!
//! Two faces of a thin thing, a panel and the wall that it hangs on never unite: what is taken for one has to face
//! the same way, to have been hit in the same places, and to be known so well that it would show if it were two.

use super::{Estimate, Roots};
use crate::mapping::graph::Factor;
use crate::mapping::innovation::Innovation;
use crate::mapping::landmark::{Landmark, LandmarkId, Opening};
use crate::mapping::report::UpdateReport;
use nalgebra::{Isometry3, Matrix3, Matrix3x6, Matrix6, Point3, Vector3};

/// Gap and tilt beyond which two surfaces are not compared.
const MOST_GAP_M: f64 = 0.02;
const MOST_TILT_RAD: f64 = 0.02;
/// Standard deviations of the gap and of the tilts up to which two surfaces would show if they were two.
const KNOWN_M: f64 = 0.004;
const KNOWN_RAD: f64 = 0.01;
/// Gate of their discrepancy, χ² with 3 degrees of freedom at 95 %: two that stay cost little.
const GATE: f64 = 7.815;
/// Scans that each was seen in.
const LEAST_SIGHTINGS: u32 = 2;
/// Share of the smaller one's cells that the larger one was hit in, of some hundred that are asked.
const SHARED: f64 = 0.25;
const ASKED: usize = 200;

impl Estimate {
    /// Unites what a scan saw again with what else it proves to be; whether there was anything. The graph has to
    /// be solved after it.
    pub(super) fn unite_doubles(&mut self, report: &mut UpdateReport) -> bool {
        let mut seen: Vec<LandmarkId> = report.associations.iter().map(|it| it.landmark).collect();
        seen.sort_unstable();
        seen.dedup();
        let mut pairs: Vec<(LandmarkId, LandmarkId)> = Vec::new();
        for id in seen {
            let is_taken = |id| pairs.iter().any(|&(kept, gone)| kept == id || gone == id);
            if is_taken(id) {
                continue;
            }
            let Some(landmark) = self.landmark(id) else { continue };
            let others = self.landmarks_about(landmark.hull_points(), 0.0).map(|(other, _)| other);
            let mut others = others.filter(|other| other.id != id && !is_taken(other.id));
            let found = others.find(|other| self.are_one(landmark, other));
            pairs.extend(found.map(|other| (id.min(other.id), id.max(other.id))));
        }
        for &(kept, gone) in &pairs {
            tracing::debug!(?kept, ?gone, "two landmarks are one surface");
            self.unite(kept, gone);
            for pair in report.associations.iter_mut().filter(|pair| pair.landmark == gone) {
                pair.landmark = kept;
            }
        }
        report.merged.extend(&pairs);
        !pairs.is_empty()
    }

    /// Draws anew what was united, once the graph is solved.
    pub(super) fn redraw_united(&mut self, report: &UpdateReport) {
        for &(kept, _) in &report.merged {
            self.redraw_extent(kept);
        }
    }

    /// Whether two landmarks are proven to be one surface.
    fn are_one(&self, a: &Landmark, b: &Landmark) -> bool {
        let a_from_b = a.world_from_plane.inverse() * b.world_from_plane;
        let tilt_rad = (a_from_b.rotation * Vector3::z()).angle(&Vector3::z());
        !a.gone
            && !b.gone
            && a.sightings.min(b.sightings) >= LEAST_SIGHTINGS
            && tilt_rad < MOST_TILT_RAD
            && a_from_b.translation.z.abs() < MOST_GAP_M
            && share_hit(a, b, &a_from_b)
            && self.agree(a, b)
    }

    /// Whether two planes are one as far as is known, and so much is known.
    fn agree(&self, a: &Landmark, b: &Landmark) -> bool {
        let keys = [self.roots[&a.id].key, self.roots[&b.id].key];
        let joint = self.graph.covariance(&keys);
        let joint = Matrix6::from_column_slice(joint.as_slice());
        let at = [a, b].map(|landmark| landmark.world_from_plane);
        let Innovation { h, h_f, h_z, .. } =
            Innovation::new(&at[0], &Isometry3::identity(), &at[1]);
        let mut rows = Matrix3x6::zeros();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&h_f);
        rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&h_z);
        let spread: Matrix3<f64> = rows * joint * rows.transpose();
        let sigma = |i: usize| spread[(i, i)].max(0.0).sqrt();
        sigma(0) < KNOWN_M
            && sigma(1).max(sigma(2)) < KNOWN_RAD
            && spread.cholesky().is_some_and(|root| h.dot(&root.solve(&h)) < GATE)
    }

    /// Gives all sightings of one landmark to another, which is drawn anew.
    fn unite(&mut self, kept: LandmarkId, gone: LandmarkId) {
        let Some(slot) = self.slot(gone) else { return };
        let other = self.landmarks.remove(slot);
        self.index.remove(gone.0);
        let Some(Roots { key, sightings }) = self.roots.remove(&gone) else { return };
        self.landmark_of.remove(&key);
        let plane = self.roots[&kept].key;
        for &(number, index) in &sightings {
            let of_it = |it: &&mut super::Sighting| it.index == index;
            let Some(sighting) = self.keyframes[number].sightings.iter_mut().find(of_it) else {
                continue;
            };
            let Some(Factor::Plane { pose, errors, robot_from_plane, covariance, .. }) =
                self.graph.factor(sighting.factor).cloned()
            else {
                continue;
            };
            self.graph.remove_factor(sighting.factor);
            sighting.factor = self.graph.add_factor(Factor::Plane {
                pose,
                plane,
                errors,
                robot_from_plane,
                covariance,
            });
            sighting.landmark = kept;
        }
        let all = &mut self.roots.get_mut(&kept).expect("a landmark has roots").sightings;
        all.extend(sightings);
        all.sort_unstable();
        let mut scans: Vec<usize> = all.iter().map(|&(number, _)| number).collect();
        scans.dedup();
        let Some(slot) = self.slot(kept) else { return };
        let landmark = &mut self.landmarks[slot];
        landmark.first_keyframe = landmark.first_keyframe.min(other.first_keyframe);
        landmark.last_keyframe = landmark.last_keyframe.max(other.last_keyframe);
        // The newest scan is counted when all is done with it.
        scans.retain(|&number| number <= landmark.last_keyframe);
        landmark.sightings = scans.len() as u32;
        let kept_from_other = landmark.world_from_plane.inverse() * other.world_from_plane;
        landmark.openings.extend(other.openings.iter().map(|opening| {
            let centre = kept_from_other * Point3::new(opening.centre.x, opening.centre.y, 0.0);
            Opening { centre: centre.xy(), ..*opening }
        }));
    }
}

/// Whether enough of the smaller of two landmarks was hit in the larger one, too.
fn share_hit(a: &Landmark, b: &Landmark, a_from_b: &Isometry3<f64>) -> bool {
    let (larger, smaller, larger_from_smaller) = if a.mask.count() >= b.mask.count() {
        (a, b, *a_from_b)
    } else {
        (b, a, a_from_b.inverse())
    };
    let asked = smaller.mask.thinned(ASKED);
    let is_hit = |cell: &&nalgebra::Point2<f64>| {
        let there = larger_from_smaller * Point3::new(cell.x, cell.y, 0.0);
        larger.mask.contains(&there.xy())
    };
    asked.iter().filter(is_hit).count() as f64 > SHARED * asked.len() as f64
}
