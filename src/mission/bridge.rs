//! The gap about the start: ground that the rig cannot see from where the robot was set down.

use super::autonomy::{START_M, STAYS_M};
use super::running::{Desk, Running};
use crate::geometry::wrap_pi;
use crate::navigation::Pose2;
use crate::robot::Visibility;
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

/// Sides that are looked over for whole ground.
const SIDES: u32 = 24;

/// A robot that stands by this much beside its start has been moved off it, in metres.
const DISPLACED_M: f64 = 0.05;

/// Ground that a way needs beside the turning circle, in metres.
const BESIDE_WAY_M: f64 = 0.1;

/// What is known of the ground beyond a gap, as shares of the directions looked at.
struct Beyond {
    /// Ground or an obstacle.
    known: f64,
    /// Ground that was seen.
    ground: f64,
    /// Directions with an edge.
    edges: u32,
}

/// A gap before whole ground.
struct Gap {
    towards: Pose2,
    ring_m: f64,
    /// How far the ground was found whole to either side, in degrees.
    widest: u32,
}

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

    /// Where the robot has come to stand beside its start, off what it was set down on, the ground that it turns
    /// over is none that was assumed: it is taken for ground, too, if all about it is whole, or if its wheels stay
    /// on what was assumed about the start and no edge is seen where it turns. Once for each such place.
    pub(super) fn assume_turning_room(&mut self, desk: &mut Desk<'_>) -> bool {
        let pose = self.pose2();
        let start = self.belief.start().translation.vector.xy().into();
        let beside_m = pose.distance_m(&start);
        let is_done =
            self.turning_room.is_some_and(|at| at.distance_m(&pose.point()) < DISPLACED_M);
        if beside_m < DISPLACED_M || self.belief.path_m() >= START_M || is_done {
            return false;
        }
        let turning_m = self.shape.circumscribed_radius_m() + desk.config.mission.assumed_margin_m;
        let Beyond { known, edges, .. } = self.beyond(&pose, turning_m + BRIDGE_M, 180);
        let is_whole = edges == 0 && known >= RING_SEEN;
        let wheels_m =
            self.shape.contacts().iter().map(|p| p.xy().coords.norm()).fold(0.0, f64::max);
        let stays_on = beside_m + wheels_m <= turning_m && !self.is_edge_within(&pose, turning_m);
        if !(is_whole || stays_on) {
            return false;
        }
        self.turning_room = Some(pose);
        desk.warn(format!(
            "the robot stands {beside_m:.2} m beside where it was set down, and no edge is seen within {turning_m:.2} m, \
             so it may turn here"
        ));
        self.belief.assume_towards(0.0, turning_m, std::f64::consts::PI);
        self.refresh_grid(desk.now);
        true
    }

    fn is_edge_within(&self, pose: &Pose2, radius_m: f64) -> bool {
        self.grid.iter().any(|(cell, known)| {
            known.class.is_edge() && pose.distance_m(&self.grid.centre(cell)) < radius_m
        })
    }

    /// Takes the gap ahead, between the robot's own disc and the nearest ground that it can see, for
    /// ground, if what lies beyond is whole: the committee does not put robots on the lip of a hole.
    /// To the sides the rig sees only farther ground now, which is no reason to assume anything there.
    ///
    /// What an earlier look to another side showed may lie nearer than anything that can be seen now, as
    /// when the tilt has come to reach less since: where that is not whole ahead, the gap before the
    /// nearest whole ground to any side is assumed, if it is no wider.
    pub(super) fn bridge_blind_ring(&mut self, desk: &mut Desk<'_>) -> bool {
        let Some(sight) = self.rig.visibility() else { return false };
        let Some(blind_m) = sight.nearest_from_centre_m else { return false };
        let pose = self.pose2();
        let ring_m = blind_m + BRIDGE_M;
        if self.may_bridge(&pose) && self.bridge_ahead(&sight, &pose, ring_m, desk) {
            return true;
        }
        let Some(gap) = self.nearest_gap(&pose, ring_m) else { return false };
        let turn_rad = wrap_pi(gap.towards.yaw_rad - pose.yaw_rad);
        self.bridged.push(gap.towards);
        desk.warn(format!(
            "ground was seen from {:.2} m on, {:.0}° to the {}, and is whole, so the gap before it is assumed",
            gap.ring_m,
            turn_rad.abs().to_degrees(),
            if turn_rad < 0.0 { "right" } else { "left" }
        ));
        let half_angle_rad = f64::from(gap.widest).to_radians();
        self.belief.assume_towards(turn_rad, gap.ring_m, half_angle_rad);
        self.refresh_grid(desk.now);
        true
    }

    fn bridge_ahead(
        &mut self,
        sight: &Visibility,
        pose: &Pose2,
        ring_m: f64,
        desk: &mut Desk<'_>,
    ) -> bool {
        let visible = |degrees: &u32| {
            let bearing_rad = f64::from(*degrees).to_radians();
            [bearing_rad, -bearing_rad].iter().all(|bearing_rad| {
                let nearest_m = sight.nearest_m(*bearing_rad);
                nearest_m.is_some_and(|near_m| near_m < ring_m - 0.5 * BRIDGE_M)
            })
        };
        let Some(widest) = (0..=90).take_while(visible).last() else { return false };
        let Beyond { known, edges, .. } = self.beyond(pose, ring_m, widest);
        let gap = format!("ground nearer than {ring_m:.2} m cannot be seen from here");
        if edges > 0 || known < RING_SEEN {
            desk.info(format!(
                "{gap}, and what lies beyond, {widest}° to either side, is not whole ({:.0} % known, \
                 {edges} edges): it is not assumed",
                100.0 * known
            ));
            return false;
        }
        self.bridged.push(*pose);
        desk.warn(format!(
            "{gap}; what lies beyond, {widest}° to either side, is whole, so the gap is assumed"
        ));
        self.belief.assume_towards(0.0, ring_m, f64::from(widest).to_radians());
        self.refresh_grid(desk.now);
        true
    }

    /// What is known of the ground about `ring_m` away, up to `widest` degrees to either side.
    fn beyond(&self, towards: &Pose2, ring_m: f64, widest: u32) -> Beyond {
        let half_angle_rad = f64::from(widest).to_radians();
        let (mut seen, mut ground, mut edges) = (0_u32, 0_u32, 0_u32);
        let inner_m = (ring_m - RING_SHADE_M).max(0.1);
        let steps = ((ring_m - inner_m) / self.grid.cell_m().max(0.01)).ceil() as u32;
        let samples = 2 * widest + 1;
        for i in 0..samples {
            let angle = f64::from(i).to_radians() - half_angle_rad;
            let along = |step: u32| {
                let away_m = inner_m + (ring_m - inner_m) * f64::from(step) / f64::from(steps);
                let at = towards.driven(0.0, angle).driven(away_m, 0.0);
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
                ground += u32::from(on_the_way.last() == Some(&CellClass::Free));
            }
        }
        let share = |count: u32| f64::from(count) / f64::from(samples);
        Beyond { known: share(seen), ground: share(ground), edges }
    }

    /// The nearest whole ground to any side, at most `most_m` away, before which a gap may be assumed.
    fn nearest_gap(&self, pose: &Pose2, most_m: f64) -> Option<Gap> {
        let half_way_m = self.shape.circumscribed_radius_m() + BESIDE_WAY_M;
        let mut nearest: Option<Gap> = None;
        for side in 0..SIDES {
            // The least turn first.
            let turns = f64::from(side.div_ceil(2)) * if side % 2 == 0 { -1.0 } else { 1.0 };
            let turn_rad = turns * std::f64::consts::TAU / f64::from(SIDES);
            let towards = Pose2 { yaw_rad: wrap_pi(pose.yaw_rad + turn_rad), ..*pose };
            if !self.may_bridge(&towards) {
                continue;
            }
            let mut ring_m = half_way_m + BRIDGE_M;
            while ring_m < nearest.as_ref().map_or(most_m, |nearest| nearest.ring_m) {
                let widest = (half_way_m / ring_m).atan().to_degrees().ceil() as u32;
                let beyond = self.beyond(&towards, ring_m, widest);
                if beyond.edges > 0 {
                    break;
                }
                if beyond.ground >= RING_SEEN {
                    nearest = Some(Gap { towards, ring_m, widest });
                    break;
                }
                ring_m += self.grid.cell_m().max(0.01);
            }
        }
        nearest
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
