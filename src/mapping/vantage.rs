//! From where the cells of a landmark were seen: what would have stood in the way then was not there.

use super::estimate::{Drawn, Estimate};
use super::landmark::LandmarkId;
use super::mask::PlaneMask;
use nalgebra::{Isometry3, Point2, Point3};

/// Most sightings of a landmark that are asked, the newest.
const MOST_VANTAGES: usize = 30;

/// One sighting of a landmark, in its frame.
pub(super) struct Vantage<'a> {
    /// Where the sensor was.
    pub(super) eye: Point3<f64>,
    /// The cells that it saw, in the observation's own frame.
    pub(super) seen: &'a PlaneMask,
    pub(super) observed_from_plane: Isometry3<f64>,
}

impl Vantage<'_> {
    /// Whether a surface so many metres before the plane would have hidden a point of it that was seen from here,
    /// if it `is_there` where the line of sight comes through it.
    pub(super) fn is_denied(
        &self,
        at: &Point2<f64>,
        before_m: f64,
        is_there: impl Fn(&Point3<f64>) -> bool,
    ) -> bool {
        let at = Point3::new(at.x, at.y, 0.0);
        let was_seen = || self.seen.contains(&(self.observed_from_plane * at).xy());
        let crossing = || at + (self.eye - at) * (before_m / self.eye.z);
        self.eye.z > before_m && was_seen() && is_there(&crossing())
    }
}

impl Estimate {
    /// From where a landmark was seen, newest first.
    pub(super) fn vantages<'a>(&'a self, landmark: LandmarkId) -> Vec<Vantage<'a>> {
        let sightings = self.sightings_of(landmark).take(MOST_VANTAGES);
        let vantage = |drawn: Drawn<'a>| {
            let observed_from_robot = drawn.observation.robot_from_plane.inverse();
            Vantage {
                eye: drawn.plane_from_observed * observed_from_robot * drawn.robot_from_eye,
                seen: &drawn.observation.mask,
                observed_from_plane: drawn.plane_from_observed.inverse(),
            }
        };
        sightings.map(vantage).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_hides_what_is_behind_it_only_from_where_it_is_in_the_way() {
        let mut seen = PlaneMask::default();
        let at = Point2::new(1.0, 0.0);
        seen.insert(&at);
        let from = |x: f64, height_m: f64| Vantage {
            eye: Point3::new(x, 0.0, height_m),
            seen: &seen,
            observed_from_plane: Isometry3::identity(),
        };
        // A board 0.2 m deep and 0.5 m over the point.
        let is_there = |crossing: &Point3<f64>| (crossing.x - 1.0).abs() < 0.1;
        assert!(from(1.0, 2.0).is_denied(&at, 0.5, is_there));
        // From beside it one looks past it, and from under it nothing is in the way.
        assert!(!from(-1.0, 2.0).is_denied(&at, 0.5, is_there));
        assert!(!from(1.0, 0.4).is_denied(&at, 0.5, is_there));
        // What was not seen from there says nothing.
        assert!(!from(1.0, 2.0).is_denied(&Point2::new(1.5, 0.0), 0.5, |_| true));
    }
}
