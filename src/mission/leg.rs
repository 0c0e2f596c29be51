//! A leg: the way between two sweeps, with the lines taken on it.
//!
//! Dead reckoning draws a leg; the sweeps at its ends say where it began and where it came out. What
//! is between is bent to fit, each time anew: when a later sweep moves the ends, the leg follows.

use crate::scan::RangeImage;
use crate::time::Stamp;
use nalgebra::{Isometry3, Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};

/// Way that a turn counts for, in metres per radian: a skid-steered robot errs in both.
const TURN_M_PER_RAD: f64 = 0.5;

/// Way that a displacement counts for which nothing measured, in metres: what the ends disagree by is
/// put down to it.
const UNMEASURED_M: f64 = 1000.0;

/// A place on a leg by dead reckoning.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Step {
    stamp: Stamp,
    begin_from_robot: Isometry3<f64>,
    /// Metres driven and turned up to here.
    effort_m: f64,
}

/// An image taken on the way, tied to the step before it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct WayImage {
    /// Number of the step that it was taken at or after; `None` before the first.
    step: Option<usize>,
    step_from_robot: Isometry3<f64>,
    image: RangeImage,
}

/// The way since a sweep, or between two. Poses are the robot's in its own frame at the beginning.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Leg {
    steps: Vec<Step>,
    images: Vec<WayImage>,
    end: Isometry3<f64>,
    effort_m: f64,
    path_m: f64,
}

/// A leg between the places of its ends.
pub(super) struct BentLeg<'a> {
    leg: &'a Leg,
    world_from_begin: Isometry3<f64>,
    /// Of the robot at each step.
    poses: Vec<Isometry3<f64>>,
}

impl Leg {
    /// Length of the way, in metres.
    pub(super) fn path_m(&self) -> f64 {
        self.path_m
    }

    /// The robot now, in its own frame at the beginning.
    pub(super) fn begin_from_robot(&self) -> Isometry3<f64> {
        self.end
    }

    /// Appends a measured motion that ended at `stamp`. Returns whether it is a new place.
    pub(super) fn drive(&mut self, stamp: Stamp, increment: &Isometry3<f64>) -> bool {
        let (step_m, turn_rad) = (increment.translation.vector.norm(), increment.rotation.angle());
        self.displace(increment);
        self.path_m += step_m;
        self.effort_m += step_m + TURN_M_PER_RAD * turn_rad;
        let is_new = step_m > 0.0 || turn_rad > 0.0 || self.steps.is_empty();
        if is_new {
            self.steps.push(Step { stamp, begin_from_robot: self.end, effort_m: self.effort_m });
        }
        is_new
    }

    /// Appends a motion that nothing measured.
    pub(super) fn put(&mut self, increment: &Isometry3<f64>) {
        self.displace(increment);
        self.effort_m += UNMEASURED_M;
    }

    /// Puts the robot where lines have it now, instead of where it was reckoned to be.
    pub(super) fn correct(&mut self, begin_from_robot: &Isometry3<f64>) {
        self.end = *begin_from_robot;
    }

    fn displace(&mut self, increment: &Isometry3<f64>) {
        self.end *= increment;
        self.end.rotation.renormalize();
    }

    /// Keeps an image taken at `begin_from_robot` about the time `stamp`.
    pub(super) fn keep(
        &mut self,
        stamp: Option<Stamp>,
        begin_from_robot: &Isometry3<f64>,
        image: RangeImage,
    ) {
        let after = stamp.map_or(self.steps.len(), |stamp| {
            self.steps.partition_point(|step| step.stamp <= stamp)
        });
        let step = after.checked_sub(1);
        let reckoned = step.map_or(Isometry3::identity(), |at| self.steps[at].begin_from_robot);
        let step_from_robot = reckoned.inverse() * begin_from_robot;
        self.images.push(WayImage { step, step_from_robot, image });
    }

    /// The leg drawn from `world_from_begin` as reckoned, not bent.
    pub(super) fn from(&self, world_from_begin: &Isometry3<f64>) -> BentLeg<'_> {
        self.between(world_from_begin, &(world_from_begin * self.end))
    }

    /// The leg drawn from where it began to where it came out.
    ///
    /// An error of heading grows with the way and the turns, and so does what then is left of the
    /// error of position: each place takes its share of both.
    pub(super) fn between(
        &self,
        world_from_begin: &Isometry3<f64>,
        world_from_end: &Isometry3<f64>,
    ) -> BentLeg<'_> {
        let reckoned_end = world_from_begin * self.end;
        let turn = (world_from_end.rotation * reckoned_end.rotation.inverse()).scaled_axis();
        let share = |effort_m: f64| {
            if self.effort_m > 0.0 { effort_m / self.effort_m } else { 1.0 }
        };
        let mut position = world_from_begin.translation.vector;
        let (mut before, mut share_before) = (Isometry3::identity(), 0.0);
        let mut advance = |to: &Isometry3<f64>, effort_m: f64| {
            let way =
                world_from_begin.rotation * (to.translation.vector - before.translation.vector);
            let half_way = 0.5 * (share_before + share(effort_m));
            position += UnitQuaternion::from_scaled_axis(turn * half_way) * way;
            (before, share_before) = (*to, share(effort_m));
            position
        };
        let turned: Vec<_> =
            self.steps.iter().map(|step| advance(&step.begin_from_robot, step.effort_m)).collect();
        let left_over = world_from_end.translation.vector - advance(&self.end, self.effort_m);
        let poses = self
            .steps
            .iter()
            .zip(turned)
            .map(|(step, position)| {
                let share = share(step.effort_m);
                Isometry3::from_parts(
                    Translation3::from(position + left_over * share),
                    UnitQuaternion::from_scaled_axis(turn * share)
                        * world_from_begin.rotation
                        * step.begin_from_robot.rotation,
                )
            })
            .collect();
        BentLeg { leg: self, world_from_begin: *world_from_begin, poses }
    }
}

impl BentLeg<'_> {
    /// Where the robot was, and when.
    pub(super) fn track(&self) -> impl Iterator<Item = (Stamp, Isometry3<f64>)> + '_ {
        self.leg.steps.iter().zip(&self.poses).map(|(step, pose)| (step.stamp, *pose))
    }

    /// The images taken on the way and where the robot was.
    pub(super) fn images(&self) -> impl Iterator<Item = (&RangeImage, Isometry3<f64>)> + '_ {
        self.leg.images.iter().map(|item| {
            let step = item.step.map_or(self.world_from_begin, |at| self.poses[at]);
            (&item.image, step * item.step_from_robot)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn metre_by_metre(count: usize) -> Leg {
        let mut leg = Leg::default();
        for second in 1..=count {
            leg.drive(Stamp::from_seconds(second as f64), &Isometry3::translation(1.0, 0.0, 0.0));
        }
        leg
    }

    #[test]
    fn a_leg_ends_where_its_ends_say() {
        let mut leg = metre_by_metre(4);
        leg.drive(Stamp::from_seconds(5.0), &Isometry3::rotation(Vector3::z() * 1.5));
        leg.drive(Stamp::from_seconds(6.0), &Isometry3::translation(2.0, 0.0, 0.0));
        let begin = Isometry3::new(Vector3::new(1.0, -2.0, 0.3), Vector3::new(0.0, 0.05, 2.0));
        let off = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.02, -0.03, 0.2));
        let end = begin * leg.begin_from_robot() * off;
        let bent = leg.between(&begin, &end);
        let (_, last) = bent.track().last().expect("it was driven");
        assert!((last.translation.vector - end.translation.vector).norm() < 1e-9);
        assert!(last.rotation.angle_to(&end.rotation) < 1e-9);
        let straight = leg.from(&begin);
        let (_, last) = straight.track().last().expect("it was driven");
        assert!((last.inverse() * begin * leg.begin_from_robot()).translation.vector.norm() < 1e-9);
    }

    #[test]
    fn a_heading_error_that_grew_evenly_is_taken_out_of_every_place() {
        // Each metre turned left by 0.02 rad that the wheels did not tell.
        let leg = metre_by_metre(20);
        let mut truth = Isometry3::identity();
        let places: Vec<_> = (0..20)
            .map(|_| {
                truth = truth
                    * Isometry3::rotation(Vector3::z() * 0.01)
                    * Isometry3::translation(1.0, 0.0, 0.0)
                    * Isometry3::rotation(Vector3::z() * 0.01);
                truth
            })
            .collect();
        let bent = leg.between(&Isometry3::identity(), &truth);
        for ((_, pose), place) in bent.track().zip(&places) {
            assert!((pose.translation.vector - place.translation.vector).norm() < 0.01);
        }
    }

    #[test]
    fn an_image_goes_with_the_step_before_it() {
        let mut leg = metre_by_metre(2);
        let image = RangeImage::new(Isometry3::identity(), vec![0.0], 20.0);
        let taken_at = Isometry3::translation(1.5, 0.0, 0.0);
        leg.keep(Some(Stamp::from_seconds(1.5)), &taken_at, image);
        let begin = Isometry3::identity();
        let bent = leg.between(&begin, &Isometry3::translation(2.0, 0.4, 0.0));
        let (_, pose) = bent.images().next().expect("one was kept");
        assert!((pose.translation.vector - Vector3::new(1.5, 0.2, 0.0)).norm() < 0.1);
        let straight = leg.from(&begin);
        let (_, pose) = straight.images().next().expect("one was kept");
        assert!((pose.translation.vector - Vector3::new(1.5, 0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn a_server_that_puts_the_robot_elsewhere_takes_the_blame() {
        let mut leg = metre_by_metre(3);
        leg.put(&Isometry3::translation(-8.0, 2.0, 0.0));
        leg.drive(Stamp::from_seconds(4.0), &Isometry3::translation(1.0, 0.0, 0.0));
        let end = leg.begin_from_robot() * Isometry3::translation(0.0, 0.5, 0.0);
        let bent = leg.between(&Isometry3::identity(), &end);
        let places: Vec<f64> = bent.track().map(|(_, pose)| pose.translation.y).collect();
        assert!(places[2].abs() < 0.01, "before it nothing moved: {places:?}");
        assert!((places[3] - 2.5).abs() < 0.01, "after it all did: {places:?}");
    }
}
