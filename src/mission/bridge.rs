//! The gap about the start: ground that the rig cannot see from where the robot was set down.

use super::autonomy::{START_M, STAYS_M};
use super::running::{Desk, Running};
use crate::geometry::wrap_pi;
use crate::navigation::Pose2;
use crate::terrain::CellClass;

/// Share of the ring about the start that must be known, as ground or as an obstacle, for the gap
/// inside it to be assumed.
const RING_SEEN: f64 = 0.85;

/// How far beyond the nearest visible ground the gap before it is judged, in metres.
const BRIDGE_M: f64 = 0.25;

/// Most gaps that are assumed in one mission.
const MOST_BRIDGES: usize = 4;

/// Where the ring cannot be seen for an obstacle before it, the obstacle is at most this much nearer.
const RING_SHADE_M: f64 = 0.35;

/// A heading within this of one from which a gap was assumed is the same, in radians.
const SAME_HEADING_RAD: f64 = 0.5;

impl Running {
    /// Whether a gap may be assumed at `pose`: at the start only, once a heading.
    fn may_bridge(&self, pose: &Pose2) -> bool {
        let bridged_here = self.bridged.iter().any(|bridged| {
            bridged.distance_m(&pose.point()) < STAYS_M
                && wrap_pi(bridged.yaw_rad - pose.yaw_rad).abs() < SAME_HEADING_RAD
        });
        let at_start = self.belief.path_m() < START_M;
        !bridged_here && at_start && self.bridged.len() < MOST_BRIDGES
    }

    /// Takes the gap ahead, between the robot's own disc and the nearest ground that it can see, for
    /// ground, if what lies beyond is whole: the committee does not put robots on the lip of a hole.
    /// To the sides the rig sees only farther ground, so nothing is assumed there.
    pub(super) fn bridge_blind_ring(&mut self, desk: &mut Desk<'_>) -> bool {
        let Some(sight) = self.rig.visibility() else { return false };
        let Some(blind_m) = sight.nearest_from_centre_m else { return false };
        let pose = self.pose2();
        if !self.may_bridge(&pose) {
            return false;
        }
        let ring_m = blind_m + BRIDGE_M;
        let visible = |degrees: &u32| {
            let bearing_rad = f64::from(*degrees).to_radians();
            [bearing_rad, -bearing_rad].iter().all(|bearing_rad| {
                let nearest_m = sight.nearest_m(*bearing_rad);
                nearest_m.is_some_and(|near_m| near_m < ring_m - 0.5 * BRIDGE_M)
            })
        };
        let Some(widest) = (0..=90).take_while(visible).last() else { return false };
        let half_angle_rad = f64::from(widest).to_radians();
        let (mut seen, mut edges) = (0_u32, 0_u32);
        let inner_m = (ring_m - RING_SHADE_M).max(0.1);
        let steps = ((ring_m - inner_m) / self.grid.cell_m().max(0.01)).ceil() as u32;
        let samples = 2 * widest + 1;
        for i in 0..samples {
            let angle = f64::from(i).to_radians() - half_angle_rad;
            let along = |step: u32| {
                let away_m = inner_m + (ring_m - inner_m) * f64::from(step) / f64::from(steps);
                let at = pose.driven(0.0, angle).driven(away_m, 0.0);
                self.grid.class_at(at.x_m, at.y_m)
            };
            let on_the_way: Vec<CellClass> = (0..=steps).map(along).collect();
            if on_the_way.iter().any(|class| class.is_edge()) {
                edges += 1;
            } else if on_the_way.contains(&CellClass::Occupied)
                || !matches!(on_the_way.last(), Some(CellClass::Unknown | CellClass::FlatFree))
            {
                // Ground, or an obstacle that hides it: neither is a hole.
                seen += 1;
            }
        }
        let share = f64::from(seen) / f64::from(samples);
        let gap = format!("ground nearer than {ring_m:.2} m cannot be seen from here");
        if edges > 0 || share < RING_SEEN {
            desk.info(format!(
                "{gap}, and what lies beyond, {widest}° to either side, is not whole ({:.0} % known, \
                 {edges} edges): it is not assumed",
                100.0 * share
            ));
            return false;
        }
        self.bridged.push(pose);
        desk.warn(format!(
            "{gap}; what lies beyond, {widest}° to either side, is whole, so the gap is assumed"
        ));
        self.belief.assume_ahead(ring_m, half_angle_rad);
        self.refresh_grid(desk.now);
        true
    }

    /// The same for an operator who does not wait for a sweep: the way as far as the guard line, if that
    /// met ground all across it.
    pub(super) fn bridge_to_guard_line(&mut self, desk: &mut Desk<'_>) -> bool {
        let pose = self.pose2();
        let Some(ahead_m) = self.pilot.confirmed_ahead_m(desk.now) else { return false };
        if !self.may_bridge(&pose) || !self.pilot.assume_way(&pose, ahead_m) {
            return false;
        }
        self.bridged.push(pose);
        desk.warn(format!(
            "ground nearer than {ahead_m:.2} m cannot be seen from here; the line there is whole, so \
             the way to it is assumed"
        ));
        true
    }
}
