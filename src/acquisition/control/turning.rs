//! Whether the tilt turns as told, and how far it reaches.

use super::HeadControl;
use crate::acquisition::reach::Reach;
use crate::acquisition::servo::{HINGE_GAP_RAD, ServoLaw};
use crate::acquisition::stillness::{Expected, StillWatch, Unmoved};
use crate::robot::{Demand, HeadPose};
use crate::time::{Span, Stamp};
use nalgebra::{Isometry3, Vector3};

/// What stamps of lines and commands may be off by before they are calibrated: a burst and more.
const TIMES_UNSURE: Span = Span::from_millis(350);
/// The same afterwards, besides what is left of them: a frame or two, and a stamp's rounding.
const CALIBRATED_UNSURE: Span = Span::from_millis(120);

/// A tilt whose end was found by the laser is given this long to go where it is told then.
const UNSURE_FOR: Span = Span::from_millis(3_000);

/// The longest way that a spring is told at once, in radians.
const LONGEST_JUMP_RAD: f64 = std::f64::consts::FRAC_PI_2;

/// How long an end of the tilt's reach is believed when it is found for the first time.
const BELIEVED: Span = Span::from_millis(180_000);

/// The tilt at which a laser on this body looks level, in radians: its nose up is made up for by a tilt
/// down.
fn looks_level_rad(frame_from_robot: &Isometry3<f64>) -> f64 {
    (frame_from_robot.rotation * Vector3::x()).z.clamp(-1.0, 1.0).asin()
}

impl HeadControl {
    /// Where the tilt should be by its law alone, or by having been told long ago; `None` where its
    /// readings tell.
    pub(super) fn unread_tilt_rad(&self, cast: Stamp) -> Option<f64> {
        if self.reads_at(cast) {
            return None;
        }
        if self.tilt.law().is_some() {
            return self.tilt.estimate(cast).map(|estimate| estimate.angle_rad);
        }
        let told_long_ago = |&(told, _): &(Stamp, Demand)| cast - told >= self.unknown_settle;
        let rests = self.tilt.commands().last().is_none_or(told_long_ago);
        self.tilt.target_rad().filter(|_| rests)
    }

    /// What is expected of a line cast at `cast`; `None` where nothing is or readings tell.
    pub(super) fn expected_of(&self, cast: Stamp) -> Option<Expected> {
        let tilt_rad = self.unread_tilt_rad(cast)?;
        let sensor_z = self.head.robot_from_device(HeadPose::default()).translation.z;
        let before = self.still.newest();
        let unsure = self.times_unsure();
        let law_rad = |at: Stamp| self.unread_tilt_rad(at).unwrap_or(tilt_rad);
        let around = [cast - unsure, cast + unsure].map(law_rad);
        Some(Expected {
            tilt_rad,
            unsure,
            span_rad: around
                .into_iter()
                .fold((tilt_rad, tilt_rad), |(least, most), rad| (least.min(rad), most.max(rad))),
            before_rad: before.map(|before| law_rad(before + unsure)),
            level_rad: self.body.at(cast).map_or(0.0, |body| looks_level_rad(&body)),
            height_m: self.origin_height_m.map(|origin_m| origin_m + sensor_z),
            stood: before.is_none_or(|before| self.body.stood(before, cast)),
        })
    }

    /// What the law's times may be wrong by, either way.
    fn times_unsure(&self) -> Span {
        let sigma = self.timing.sigma;
        match self.timing.calibrated {
            true => CALIBRATED_UNSURE + sigma + sigma + sigma,
            false => TIMES_UNSURE + self.latency,
        }
    }

    /// The tilt, if by all that the laser sees it does not turn although it was told to.
    ///
    /// A joint slows down before its limit, and while it does the law, which knows of no limit there,
    /// runs ahead: where the joint surely got to is where the law had it a settling time before, and
    /// what its times may be wrong by. A
    /// spring does so all the way of a jump, for its speed is that of the way it has left.
    pub(in crate::acquisition) fn unmoved(&self) -> Option<Unmoved> {
        let unmoved = self.still.unmoved(self.latency)?;
        let slows_from = unmoved.since - self.slowing() - self.times_unsure();
        let reached = self.tilt.estimate(slows_from).map_or(unmoved.rest_rad, |e| e.angle_rad);
        let ran_ahead = (unmoved.rest_rad - reached) * unmoved.towards > 0.0;
        let rest_rad = if ran_ahead { reached } else { unmoved.rest_rad };
        Some(Unmoved { rest_rad, slows_from, ..unmoved })
    }

    /// How long before it is seen to rest the tilt may have begun to slow down for an end of its reach.
    fn slowing(&self) -> Span {
        // Of a surface seen at a slant, a creep of this in a line's time is still seen.
        const VISIBLE_RAD: f64 = 0.0003;
        let slows_s = self.tilt.law().map_or(0.0, |law| {
            let slowing_rad = match law {
                ServoLaw::Hinge { gap_rad, .. } => gap_rad.max(HINGE_GAP_RAD),
                ServoLaw::Spring { .. } => LONGEST_JUMP_RAD,
            };
            law.settle_s(slowing_rad, VISIBLE_RAD)
        });
        Span::from_seconds(slows_s)
    }

    /// Whether a line cast at `cast` is not believed: the laser saw no turn then, or soon after.
    pub(in crate::acquisition) fn doubts(&self, cast: Stamp) -> bool {
        // Nearer than this, in radians, the tilt has caught up: half a row.
        const CAUGHT_UP_RAD: f64 = 0.002;
        let catches_up = |behind_rad: f64| {
            let law_s = self.tilt.law().map_or(0.0, |law| law.settle_s(behind_rad, CAUGHT_UP_RAD));
            Span::from_seconds(law_s) + self.times_unsure()
        };
        self.still.doubts(cast, self.slowing(), catches_up)
    }

    /// Until then it is unsure where the tilt is, an end of its reach having been found by the laser.
    pub(in crate::acquisition) fn unsure_until(&self) -> Option<Stamp> {
        self.unsure_until
    }

    /// What the laser sees of the tilt's motion.
    pub(in crate::acquisition) fn still(&self) -> &StillWatch {
        &self.still
    }

    /// What the laser has seen so far of the tilt's motion is no longer held against it.
    pub(in crate::acquisition) fn watch_anew(&mut self) {
        let expected = self.still.newest().and_then(|cast| self.unread_tilt_rad(cast));
        match expected {
            Some(tilt_rad) => self.still.restart_at(tilt_rad),
            None => self.still.forget(),
        }
    }

    /// The tilt was found to go no farther than `rest_rad` when it was told to turn to the side of the
    /// sign `towards`: from now on it is not asked to. One that goes no farther to either side is stuck.
    pub(in crate::acquisition) fn rests_at(&mut self, rest_rad: f64, towards: f64) {
        let read = self.clock().latest().is_some_and(|latest| self.reads_at(latest));
        let rest_rad = match read {
            true => rest_rad,
            false => self.reach.no_less_than_earlier(rest_rad, towards),
        };
        let reach = self.reach.ending_at(rest_rad, towards);
        let believed = self.ended.map_or(BELIEVED, |(_, before)| before);
        self.ended = self.clock().latest().map(|now| (now, believed));
        self.unsure_until = self.clock().latest().filter(|_| !read).map(|now| now + UNSURE_FOR);
        self.set_reach(reach, Some(rest_rad).filter(|_| !read));
    }

    /// A tilt at an end of its reach that the laser found, and that turned only when by the law it was well
    /// on its way back: the end lies where it began to turn. Of a jump, or of a limit that came to be
    /// while it was beyond it, the laser tells no better.
    pub(super) fn note_came_free(&mut self, cast: Stamp) {
        let Some(stayed) = self.still.came_free() else { return };
        let Some(free) = self.tilt.estimate(cast + self.times_unsure()) else { return };
        if let Some(reach) = self.reach.ending_before(stayed, free.angle_rad) {
            self.set_reach(reach, None);
        }
    }

    /// An end that was found some minutes ago may have been a moment's: the next sweep tries once more
    /// what the server told. Each time that fails it is believed twice as long.
    pub(in crate::acquisition) fn try_again(&mut self) {
        let Some((found, believed)) = self.ended.filter(|_| self.is_worth_a_try()) else { return };
        self.ended = Some((found, believed + believed));
        self.set_reach(self.reach.tried_again(), None);
    }

    /// Whether an end of the reach was found so long ago that it is to be tried again.
    pub(in crate::acquisition) fn is_worth_a_try(&self) -> bool {
        let is_old = |(found, believed): (Stamp, Span)| {
            self.clock().latest().is_some_and(|now| now - found > believed)
        };
        self.reach.is_narrowed() && self.ended.is_some_and(is_old)
    }

    pub(super) fn set_reach(&mut self, reach: Reach, rests_rad: Option<f64>) {
        self.reach = reach;
        self.head.limit_tilt(reach.limits());
        self.tilt.limit(reach.limits(), rests_rad);
        self.watch_anew();
    }

    /// What the tilt reaches.
    pub fn reach(&self) -> &Reach {
        &self.reach
    }

    /// What the tilt reaches, if that has been found to be something else since the last call.
    pub(in crate::acquisition) fn new_reach(&mut self) -> Option<Reach> {
        self.reach.take_news()
    }
}
