//! What the tilt was told to reach, and what it was found to.

use crate::geometry::AngleSpan;
use serde::{Deserialize, Serialize};

/// The angles that the tilt joint reaches.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reach {
    /// As the server tells; `None` without limits.
    told: Option<AngleSpan>,
    /// As far as was found, within that.
    found: Option<AngleSpan>,
    /// What was found before the joint was tried again.
    earlier: Option<AngleSpan>,
    /// Whether it has been found to be something else since anyone asked.
    is_news: bool,
}

/// A joint that turns less than this, in radians, is stuck.
const STUCK_RAD: f64 = 0.018;
/// A reading this far beyond what was found, in radians, shows that the joint is free again.
const FREE_RAD: f64 = 0.02;
/// A joint without limits.
const TURN: AngleSpan = AngleSpan { min_rad: -std::f64::consts::PI, max_rad: std::f64::consts::PI };

impl Reach {
    /// As told.
    pub(super) fn told(limits: Option<AngleSpan>) -> Self {
        Self { told: limits, found: None, earlier: None, is_news: false }
    }

    /// The limits to go by.
    pub fn limits(&self) -> Option<AngleSpan> {
        self.found.or(self.told)
    }

    /// Whether the joint was found to reach less than told.
    pub fn is_narrowed(&self) -> bool {
        self.found.is_some()
    }

    /// The angle in radians at which the joint was found stuck, if it was.
    pub fn stuck_rad(&self) -> Option<f64> {
        let found = self.found?;
        (found.max_rad - found.min_rad < STUCK_RAD).then_some(0.5 * (found.min_rad + found.max_rad))
    }

    /// The same, the joint going no farther than `rest_rad` to the side of the sign `towards`.
    pub(super) fn ending_at(self, rest_rad: f64, towards: f64) -> Self {
        let before = self.limits().unwrap_or(TURN);
        let rest_rad = before.clamp(rest_rad);
        let found = match towards > 0.0 {
            true => AngleSpan { max_rad: rest_rad, ..before },
            false => AngleSpan { min_rad: rest_rad, ..before },
        };
        Self { found: Some(found), earlier: None, is_news: true, ..self }
    }

    /// The same with an end nearer that was found already: while by the law the tilt went between the
    /// least and the greatest angle of `stayed` it did not turn, and at `free_rad` it did. `None` where
    /// that says nothing of an end that was found.
    pub(super) fn ending_before(self, (least, most): (f64, f64), free_rad: f64) -> Option<Self> {
        let found = self.found.filter(|_| self.stuck_rad().is_none())?;
        let told = self.told.unwrap_or(TURN);
        let inside = free_rad - found.min_rad > STUCK_RAD && found.max_rad - free_rad > STUCK_RAD;
        let nearer = if found.max_rad < told.max_rad && most >= found.max_rad - FREE_RAD {
            AngleSpan { max_rad: free_rad, ..found }
        } else if found.min_rad > told.min_rad && least <= found.min_rad + FREE_RAD {
            AngleSpan { min_rad: free_rad, ..found }
        } else {
            return None;
        };
        inside.then_some(Self { found: Some(nearer), is_news: true, ..self })
    }

    /// The end that was not known `before`: where it lies in radians, and on which side, as a sign.
    pub(super) fn new_end(&self, before: Option<AngleSpan>) -> Option<(f64, f64)> {
        let before = before.unwrap_or(TURN);
        let found = self.found?;
        if found.max_rad < before.max_rad {
            return Some((found.max_rad, 1.0));
        }
        (found.min_rad > before.min_rad).then_some((found.min_rad, -1.0))
    }

    /// `rest_rad`, at which the joint was found to go no farther to the side of the sign `towards`, or
    /// the end that was found there before: where it got to then it gets to now, and what the laser
    /// tells of a jump is short of the truth.
    pub(super) fn no_less_than_earlier(&self, rest_rad: f64, towards: f64) -> f64 {
        let Some(earlier) = self.earlier else { return rest_rad };
        let told = self.told.unwrap_or(TURN);
        match towards > 0.0 {
            true if earlier.max_rad < told.max_rad => rest_rad.max(earlier.max_rad),
            false if earlier.min_rad > told.min_rad => rest_rad.min(earlier.min_rad),
            _ => rest_rad,
        }
    }

    /// The same as told again, to be tried once more.
    pub(super) fn tried_again(self) -> Self {
        Self { found: None, earlier: self.found, is_news: true, ..self }
    }

    /// The same as told again, the joint having been read beyond what was found.
    pub(super) fn as_told(self) -> Self {
        Self { found: None, earlier: None, is_news: true, ..self }
    }

    /// Whether an angle read lies where the joint was found not to go.
    pub(super) fn is_exceeded_by(&self, angle_rad: f64) -> bool {
        self.found.is_some_and(|found| (found.clamp(angle_rad) - angle_rad).abs() > FREE_RAD)
    }

    /// What the joint reaches, if that is news.
    pub(super) fn take_news(&mut self) -> Option<Self> {
        std::mem::take(&mut self.is_news).then_some(*self)
    }
}

impl std::fmt::Display for Reach {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Adding zero makes the -0 of a small negative angle 0.
        let deg = |rad: f64| (10.0 * rad.to_degrees()).round() / 10.0 + 0.0;
        if let Some(stuck_rad) = self.stuck_rad() {
            return write!(f, "the tilt is stuck, last seen at {:.1}°", deg(stuck_rad));
        }
        let Some(limits) = self.limits() else { return f.write_str("the tilt has no limits") };
        let (least, most) = (deg(limits.min_rad), deg(limits.max_rad));
        match self.found {
            Some(_) => write!(f, "the tilt was found to reach {least:.1}° to {most:.1}° only"),
            None => write!(f, "the tilt is taken to reach {least:.1}° to {most:.1}° again"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_found_on_either_side_is_a_joint_that_is_stuck() {
        let mut reach = Reach::told(Some(AngleSpan::new(-0.5, 0.5)));
        assert_eq!((reach.take_news(), reach.stuck_rad()), (None, None));
        reach = reach.ending_at(0.2, 1.0);
        assert_eq!(reach.limits(), Some(AngleSpan::new(-0.5, 0.2)));
        assert!(reach.take_news().is_some() && reach.take_news().is_none());
        reach = reach.ending_at(0.19, -1.0);
        assert!(reach.stuck_rad().is_some_and(|at| (at - 0.195).abs() < 1e-9), "{reach}");
        assert!(reach.is_exceeded_by(0.3) && !reach.is_exceeded_by(0.205));
        assert_eq!(reach.as_told().limits(), Some(AngleSpan::new(-0.5, 0.5)));
    }

    #[test]
    fn an_end_is_where_the_joint_comes_free() {
        let found = Reach::told(Some(AngleSpan::new(-0.5, 0.9))).ending_at(0.4, 1.0);
        let nearer = found.ending_before((0.3, 0.4), 0.28).unwrap();
        assert_eq!(nearer.limits(), Some(AngleSpan::new(-0.5, 0.28)));
        assert_eq!(found.ending_before((0.1, 0.2), 0.05), None, "it was not at that end");
        assert_eq!(found.ending_before((-0.5, -0.4), -0.3), None, "nothing was found there");
        assert_eq!(found.ending_before((0.39, 0.4), 0.395), None, "it turned at once");
    }

    #[test]
    fn a_joint_that_is_tried_again_in_vain_reaches_what_it_did() {
        let told = Reach::told(Some(AngleSpan::new(-0.5, 0.5)));
        let again = told.ending_at(0.2, 1.0).tried_again();
        assert_eq!(again.no_less_than_earlier(-0.1, 1.0), 0.2);
        assert_eq!(again.no_less_than_earlier(0.3, 1.0), 0.3, "it may have come free in part");
        assert_eq!(again.no_less_than_earlier(-0.1, -1.0), -0.1, "nothing is known of that side");
        assert_eq!(again.ending_at(0.2, 1.0).no_less_than_earlier(-0.1, 1.0), -0.1);
    }
}
