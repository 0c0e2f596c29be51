//! What a truth was rounded to by the wire that told it.

use super::tum::TimedPose;
use crate::geometry::lie::skew;
use nalgebra::{Isometry3, Matrix6, Vector6};

/// Digits behind the point that are looked for; a trajectory file has six.
const MOST_DIGITS: i32 = 4;
/// How far from a grid, in its steps, a number on it may be: what files cut off.
const OFF_GRID: f64 = 0.02;
/// Fewest different numbers that can be on a grid otherwise than by chance.
const FEWEST: usize = 6;

/// The steps of the decimal grids that places and angles lie on; 0 where they lie on none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Steps {
    pub place_m: f64,
    pub angle_rad: f64,
}

impl Steps {
    /// The steps of a truth, from its numbers alone. A wire tells angles between 0 and a whole turn or
    /// between half turns; both are rounded before they are anything else.
    pub fn of(truth: &[TimedPose]) -> Self {
        let places = truth.iter().flat_map(|timed| {
            let t = timed.pose.translation.vector;
            [t.x, t.y, t.z]
        });
        let angles = truth.iter().flat_map(|timed| {
            let (roll, pitch, yaw) = timed.pose.rotation.euler_angles();
            [roll, pitch, yaw]
        });
        let turn = std::f64::consts::TAU;
        Self {
            place_m: step_of(places.collect(), is_on),
            angle_rad: step_of(angles.collect(), |v, step| {
                [v, v + turn, v - turn].into_iter().any(|v| is_on(v, step))
            }),
        }
    }

    /// Covariance of a motion between two poses that were rounded, as a perturbation in the frame of the
    /// first: each number is off by up to half a step.
    pub fn of_motion(&self, first: &Isometry3<f64>, last: &Isometry3<f64>) -> Matrix6<f64> {
        let [place, angle] = [self.place_m, self.angle_rad].map(|step| step * step / 12.0);
        let each = Matrix6::from_diagonal(&Vector6::new(place, place, place, angle, angle, angle));
        let into_first = first.rotation.to_rotation_matrix().into_inner().transpose();
        let lever = last.translation.vector - first.translation.vector;
        let mut of_last = Matrix6::zeros();
        of_last.fixed_view_mut::<3, 3>(0, 0).copy_from(&into_first);
        of_last.fixed_view_mut::<3, 3>(3, 3).copy_from(&into_first);
        let mut of_first = -of_last;
        // A turn δ of the first pose moves the other by -δ × lever beside it.
        of_first.fixed_view_mut::<3, 3>(0, 3).copy_from(&(into_first * skew(&lever)));
        of_first * each * of_first.transpose() + of_last * each * of_last.transpose()
    }
}

fn is_on(value: f64, step: f64) -> bool {
    let steps = value / step;
    (steps - steps.round()).abs() <= OFF_GRID
}

/// The coarsest decimal step that all values are whole numbers of.
fn step_of(mut values: Vec<f64>, is_on: impl Fn(f64, f64) -> bool) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    values.dedup();
    if values.len() < FEWEST {
        return 0.0;
    }
    (0..=MOST_DIGITS)
        .map(|digits| 10_f64.powi(-digits))
        .find(|&step| values.iter().all(|&value| is_on(value, step)))
        .unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::perturbation::{perturbed_pose, pose_error};
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    fn truth(round: impl Fn(f64) -> f64) -> Vec<TimedPose> {
        let pose = |i: i32| {
            let s = f64::from(i);
            let turn = round((0.137_123_4 * s + 6.1).rem_euclid(std::f64::consts::TAU));
            let rotation = UnitQuaternion::from_euler_angles(round(0.012_345_67 * s), 0.0, turn);
            let place =
                Translation3::new(round(1.234_567_8 * s), round(-0.321_765_4 * s), round(0.181_7));
            TimedPose { time_s: s, pose: Isometry3::from_parts(place, rotation) }
        };
        (0..40).map(pose).collect()
    }

    #[test]
    fn what_a_wire_rounded_to_is_told_from_the_numbers() {
        let steps = Steps::of(&truth(|v| (v * 100.0).round() / 100.0));
        assert_eq!((steps.place_m, steps.angle_rad), (0.01, 0.01));
        assert_eq!(Steps::of(&truth(|v| v)), Steps::default());
        // A robot that stands tells nothing of it.
        assert_eq!(Steps::of(&truth(|_| 0.5)), Steps::default());
    }

    #[test]
    fn the_covariance_of_a_motion_is_that_of_its_ends() {
        let steps = Steps { place_m: 0.01, angle_rad: 0.02 };
        let [first, last] = [(1.0, 0.4), (7.0, -0.9)]
            .map(|(x, yaw)| Isometry3::new(Vector3::new(x, 2.0, 0.3), Vector3::z() * yaw));
        let motion = |a: &Vector6<f64>, b: &Vector6<f64>| {
            perturbed_pose(&first, a).inverse() * perturbed_pose(&last, b)
        };
        let still = motion(&Vector6::zeros(), &Vector6::zeros());
        let mut sum = Matrix6::zeros();
        for k in 0..6 {
            let mut unit = Vector6::zeros();
            unit[k] = 1e-6;
            let step = if k < 3 { steps.place_m } else { steps.angle_rad };
            for moved in [motion(&unit, &Vector6::zeros()), motion(&Vector6::zeros(), &unit)] {
                let effect = pose_error(&still, &moved) / 1e-6;
                sum += effect * effect.transpose() * (step * step / 12.0);
            }
        }
        assert!((steps.of_motion(&first, &last) - sum).amax() < 1e-6 * sum.amax());
    }
}
