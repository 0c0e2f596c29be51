//! The way that an inertial unit's places show, between them by the wheels.
//!
//! USARSim's unit adds up its way in the world's axes, step by step, each coordinate off by 5 % of the step
//! (protocol reference, section 5.2): over some metres that is centimetres, where skid-steered wheels err by
//! decimetres. Places come to the hundredth of a metre. The wheels carry the reckoned place along, and a place
//! that is read pulls it half way towards the middle of the square that rounds to it, and always into that
//! square, while the wheels turn: what rounding adds is smoothed, and a robot that stands does not creep.

use super::leaps::Leaps;
use crate::geometry::wrap_pi;
use crate::robot::InertialPlace;
use nalgebra::{Rotation2, Vector2};
use serde::{Deserialize, Serialize};

/// Half the resolution of a place, in metres.
const HALF_STEP_M: f64 = 0.005;
/// Share of the way to the middle of that square that is taken: the wheels err about as much from one
/// reading to the next as rounding does.
const PULL: f64 = 0.5;
/// Half the resolution of a heading, in radians, with what rounding adds.
const HALF_STEP_RAD: f64 = 0.0051;
/// A robot drives no farther than this between two places, unless some were lost.
const LEAP_M: f64 = 2.0;
/// A way by the wheels, in metres, that a unit must have shown too before it is believed, and the share of it
/// by which both may differ: a unit that always tells one place tells nothing.
const PROOF_M: f64 = 0.3;
const PROOF_SHARE: f64 = 0.3;
/// Increments by the wheels after which a unit that says nothing more is no source of them.
const STALE: u32 = 12;

/// Follows the places of an inertial unit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct InertialWay {
    /// Turn about the vertical from the unit's axes to the map's, once a pose has told it.
    map_from_unit_rad: Option<f64>,
    /// The last place read, and whether no increment has used it yet.
    last: Option<InertialPlace>,
    is_fresh: bool,
    leaps: Leaps<InertialPlace>,
    /// Where the robot is reckoned to be from the last place read, in the unit's axes, in metres.
    from_last: Vector2<f64>,
    proof: Proof,
    /// Increments since a place was read.
    silent: u32,
}

/// Whether a unit has been seen to go where the wheels go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Proof {
    by_wheels: Vector2<f64>,
    by_unit: Vector2<f64>,
    is_given: bool,
}

impl Proof {
    fn look(&mut self) {
        let (apart_m, way_m) = ((self.by_unit - self.by_wheels).norm(), self.by_wheels.norm());
        if way_m >= PROOF_M {
            let is_given = apart_m <= PROOF_SHARE * way_m;
            *self = Self { is_given, ..Self::default() };
        }
    }
}

impl InertialWay {
    /// Takes in a place.
    pub(super) fn place(&mut self, place: InertialPlace) {
        let is_near = |a: &InertialPlace, b: &InertialPlace| b.since(a).norm() <= LEAP_M;
        if !self.leaps.believes(self.last.as_ref(), &place, is_near) {
            return;
        }
        self.silent = 0;
        self.is_fresh = true;
        let Some(last) = self.last.replace(place) else { return };
        // Places that are counted from elsewhere by now tell no way.
        if is_near(&last, &place) {
            let way = place.since(&last).xy();
            self.from_last -= way;
            self.proof.by_unit += way;
        }
    }

    /// Takes in how the robot is headed in the map while the unit reads `read_rad`, a sweep having told where
    /// it is: what was reckoned wrong before is mended by now.
    pub(super) fn settle(&mut self, known_rad: f64, read_rad: f64) {
        self.map_from_unit_rad.get_or_insert_with(|| {
            let turn = wrap_pi(known_rad - read_rad);
            // A map with the world's axes is the rule, and the reading is rounded.
            if turn.abs() <= HALF_STEP_RAD { 0.0 } else { turn }
        });
        if !self.is_believed() {
            self.from_last = Vector2::zeros();
        }
    }

    fn is_believed(&self) -> bool {
        self.proof.is_given && self.silent <= STALE
    }

    /// The way since the last increment in the map's axes, where it is `by_wheels` by the wheels. `None` while
    /// the unit says nothing or is not believed.
    pub(super) fn way(&mut self, by_wheels: Vector2<f64>) -> Option<Vector2<f64>> {
        let map_from_unit = Rotation2::new(self.map_from_unit_rad?);
        self.last?;
        let by_wheels = map_from_unit.inverse() * by_wheels;
        self.silent = self.silent.saturating_add(1);
        let reckoned = self.from_last + by_wheels;
        self.from_last = reckoned;
        if !self.proof.is_given {
            self.proof.by_wheels += by_wheels;
            self.proof.look();
        }
        if !self.is_believed() {
            return None;
        }
        if std::mem::take(&mut self.is_fresh) {
            let pull = if by_wheels == Vector2::zeros() { 0.0 } else { PULL };
            let held = |apart_m: f64| ((1.0 - pull) * apart_m).clamp(-HALF_STEP_M, HALF_STEP_M);
            self.from_last = reckoned.map(held);
        }
        Some(map_from_unit * (by_wheels + self.from_last - reckoned))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit's reading of a place on a straight way.
    fn rounded(x_m: f64) -> InertialPlace {
        InertialPlace::new((x_m * 100.0).round() / 100.0, 0.0, 0.0)
    }

    /// Drives `metres` ahead by steps of 4 cm, the wheels turning `slip` times as far; gives the way told and
    /// the longest way back in it.
    fn drive(way: &mut InertialWay, from_m: f64, metres: f64, slip: f64) -> (f64, f64) {
        let (mut told_m, mut back_m) = (0.0, 0.0_f64);
        for step in 1..=(metres / 0.04).round() as u32 {
            way.place(rounded(from_m + 0.04 * f64::from(step)));
            let by_wheels = Vector2::new(0.04 * slip, 0.0);
            let step_m = way.way(by_wheels).unwrap_or(by_wheels).x;
            told_m += step_m;
            back_m = back_m.max(-step_m);
        }
        (told_m, back_m)
    }

    #[test]
    fn slipping_wheels_are_pulled_along_by_the_places() {
        let mut way = InertialWay::default();
        way.place(rounded(7.0));
        way.settle(0.0, 0.004);
        drive(&mut way, 7.0, 1.0, 1.1);
        way.settle(0.0, 0.0);
        let (told_m, back_m) = drive(&mut way, 8.0, 5.0, 1.1);
        assert!((told_m - 5.0).abs() <= 2.0 * HALF_STEP_M, "{told_m}");
        assert_eq!(back_m, 0.0);
    }

    #[test]
    fn a_map_with_other_axes_gets_the_way_in_its_own() {
        let mut way = InertialWay::default();
        way.place(rounded(0.0));
        way.settle(1.0, 0.0);
        let ahead = Rotation2::new(1.0) * Vector2::new(0.5, 0.0);
        way.place(rounded(0.5));
        way.way(ahead);
        way.place(rounded(0.98));
        let told = way.way(ahead).unwrap();
        assert!((told - Rotation2::new(1.0) * Vector2::new(0.485, 0.0)).norm() < 1e-9, "{told}");
    }

    #[test]
    fn a_unit_that_always_tells_one_place_is_not_believed() {
        let mut way = InertialWay::default();
        way.settle(0.0, 0.0);
        for _ in 0..200 {
            way.place(rounded(0.0));
            assert_eq!(way.way(Vector2::new(0.04, 0.0)), None);
        }
    }

    #[test]
    fn a_garbled_place_and_one_counted_from_elsewhere_tell_no_way() {
        let mut way = InertialWay::default();
        way.place(rounded(0.0));
        way.settle(0.0, 0.0);
        drive(&mut way, 0.0, 1.0, 1.0);
        way.place(rounded(1.0e6));
        assert!((way.way(Vector2::new(0.04, 0.0)).unwrap().x - 0.04).abs() < 1e-9);
        way.place(rounded(1.08));
        let told = way.way(Vector2::new(0.04, 0.0)).unwrap();
        assert!((told.x - 0.04).abs() <= HALF_STEP_M, "{told}");
        // Somebody sets the unit to another place: twice the same is believed, and moves nothing.
        way.place(rounded(50.0));
        way.place(rounded(50.0));
        assert!(way.way(Vector2::zeros()).unwrap().norm() <= HALF_STEP_M);
    }

    #[test]
    fn where_the_unit_falls_silent_the_wheels_tell_the_way() {
        let mut way = InertialWay::default();
        way.place(rounded(0.0));
        way.settle(0.0, 0.0);
        drive(&mut way, 0.0, 1.0, 1.0);
        let told: Vec<bool> =
            (0..2 * STALE).map(|_| way.way(Vector2::new(0.04, 0.0)).is_some()).collect();
        let believed = told.iter().take_while(|&&told| told).count();
        assert!((1..=STALE as usize).contains(&believed), "{told:?}");
        assert!(told[believed..].iter().all(|told| !told), "{told:?}");
        // What a sweep has mended meanwhile is not mended again.
        way.settle(0.0, 0.0);
        way.place(rounded(1.0));
        way.place(rounded(1.0));
        assert!(way.way(Vector2::zeros()).unwrap().norm() <= HALF_STEP_M);
    }
}
