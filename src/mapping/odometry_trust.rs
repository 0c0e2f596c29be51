//! How much worse than its noise model odometry turns out to be: on carpet, with a flat tyre, with another
//! robot's numbers.

use super::claims::{SAME_M, SAME_RAD, moves_far};
use super::odometry::{is_nothing, unmeasured_motion};
use super::perturbation::pose_error;
use super::report::{LEVER_M, WeakDirection};
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Components of a motion's error `[δt; δr]` that wheels measure: the way over the ground and the heading.
const MEASURED: [usize; 3] = [0, 1, 5];
/// Motions that the noise model counts for.
const PRIOR: f64 = 10.0;
/// Part of what earlier motions count for that is left after one more.
const KEPT: f64 = 0.95;
/// Most that one motion says: a push or a stuck wheel is no noise.
const MOST: f64 = 25.0;

/// Part of a direction below which it says nothing of what wheels measure.
const HARDLY: f64 = 0.1;

/// The motions so far, held against where planes put the robot after them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct OdometryTrust {
    /// Sum of the squared errors in units of what was expected, and the motions that it is of.
    sum: f64,
    count: f64,
    /// Whether it told of rest when the robot had moved last.
    dead: bool,
}

impl OdometryTrust {
    /// Takes in a motion as told, with the covariance that the noise model gives it, and as found, but for the
    /// directions that stay `open`: a corridor tells of what wheels err by to its sides.
    pub(super) fn learn(
        &mut self,
        told: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
        found: &Isometry3<f64>,
        open: &[WeakDirection],
    ) {
        self.dead = is_nothing(told) && moves_far(told, found, SAME_M, SAME_RAD);
        if self.dead {
            return;
        }
        let error = pose_error(told, found);
        let error = Vector3::from_fn(|i, _| error[MEASURED[i]]);
        let expected = Matrix3::from_fn(|i, j| covariance[(MEASURED[i], MEASURED[j])]);
        let Some(root) = expected.cholesky() else { return };
        let in_deviations = |v: &Vector3<f64>| root.l().solve_lower_triangular(v);
        let Some(mut error) = in_deviations(&error) else { return };
        let mut left_out: Vec<Vector3<f64>> = Vec::new();
        for direction in open.iter().map(|weak| of_motion(&weak.direction, found)) {
            let Some(mut direction) = direction.as_ref().and_then(in_deviations) else { continue };
            for other in &left_out {
                direction -= other * other.dot(&direction);
            }
            left_out.extend(direction.try_normalize(1e-6));
        }
        for direction in &left_out {
            error -= direction * direction.dot(&error);
        }
        let seen = MEASURED.len().saturating_sub(left_out.len());
        if seen == 0 {
            return;
        }
        let square = error.norm_squared() / seen as f64;
        self.sum = KEPT * self.sum + square.min(MOST);
        self.count = KEPT * self.count + 1.0;
    }

    /// The covariance of a motion with what the wheels measure as wrong as it has turned out to be, never less
    /// than the noise model says; rest told by encoders that are dead is no measurement.
    pub(super) fn widened(&self, told: &Isometry3<f64>, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        if self.dead && is_nothing(told) {
            return unmeasured_motion();
        }
        let variance = (PRIOR + self.sum) / (PRIOR + self.count);
        let factor = variance.max(1.0).sqrt();
        let mut scale = Vector6::repeat(1.0);
        for component in MEASURED {
            scale[component] = factor;
        }
        let scale = Matrix6::from_diagonal(&scale);
        scale * covariance * scale
    }
}

/// A direction in the frame of the robot after a motion, rotations in units of [`LEVER_M`], as one of the motion's
/// error in what wheels measure; `None` if it is hardly one of that.
fn of_motion(direction: &Vector6<f64>, before_from_after: &Isometry3<f64>) -> Option<Vector3<f64>> {
    let part = |from: usize| before_from_after.rotation * direction.fixed_rows::<3>(from);
    let (way, turn) = (part(0), part(3).z);
    let measured = Vector3::new(way.x, way.y, turn);
    (measured.norm() > HARDLY).then(|| Vector3::new(way.x, way.y, turn / LEVER_M))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.5, 0.0, 0.0), Vector3::z() * 0.1)
    }

    fn covariance() -> Matrix6<f64> {
        Matrix6::from_diagonal(&Vector6::new(1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 4e-5))
    }

    /// After motions that err by `share` of their standard deviation in x.
    fn after(share: f64, motions: usize) -> Matrix6<f64> {
        let mut trust = OdometryTrust::default();
        let found = told() * Isometry3::translation(share * 0.01, 0.0, 0.0);
        for _ in 0..motions {
            trust.learn(&told(), &covariance(), &found, &[]);
        }
        trust.widened(&told(), &covariance())
    }

    #[test]
    fn rest_is_no_measurement_once_the_robot_has_moved_in_it() {
        let (rest, mut trust) = (Isometry3::identity(), OdometryTrust::default());
        trust.learn(&rest, &covariance(), &Isometry3::translation(1e-3, 0.0, 0.0), &[]);
        assert_eq!(trust.widened(&rest, &covariance()), covariance());
        trust.learn(&rest, &covariance(), &told(), &[]);
        assert_eq!(trust.widened(&rest, &covariance()), unmeasured_motion());
        // What does tell of a motion is believed, and rest after it.
        assert_eq!(trust.widened(&told(), &covariance()), covariance());
        trust.learn(&told(), &covariance(), &told(), &[]);
        assert_eq!(trust.widened(&rest, &covariance()), covariance());
    }

    #[test]
    fn odometry_as_good_as_told_or_better_is_left_as_it_is() {
        assert_eq!(after(1.0, 30), covariance());
        assert_eq!(after(0.0, 30), covariance());
    }

    #[test]
    fn odometry_that_is_worse_is_found_out_and_only_where_wheels_measure() {
        let wide = after(6.0, 30);
        // Twelve times the expected mean square, less what the model still counts for.
        assert!((7.0..12.0).contains(&(wide[(0, 0)] / 1e-4)), "{wide}");
        assert_eq!(wide[(2, 2)], 1e-4);
        assert_eq!(wide[(3, 3)], 1e-5);
    }

    #[test]
    fn a_corridor_tells_of_errors_to_its_sides_and_of_no_others() {
        let along = WeakDirection { direction: Vector6::x(), sigma_m: f64::INFINITY };
        let learned = |error: Vector3<f64>| {
            let mut trust = OdometryTrust::default();
            let told = Isometry3::translation(0.5, 0.0, 0.0);
            let found = told * Isometry3::new(error, Vector3::zeros());
            (0..30).for_each(|_| trust.learn(&told, &covariance(), &found, &[along]));
            trust.widened(&told, &covariance())[(0, 0)] / 1e-4
        };
        assert_eq!(learned(Vector3::new(0.3, 0.0, 0.0)), 1.0);
        // Six deviations to the side, which is one of two directions that are seen.
        assert!((9.0..18.0).contains(&learned(Vector3::new(0.0, 0.06, 0.0))));
        // Nothing is seen of it.
        let mut trust = OdometryTrust::default();
        let open: Vec<WeakDirection> = [0, 1, 5]
            .map(|axis| WeakDirection {
                direction: Vector6::ith(axis, 1.0),
                sigma_m: f64::INFINITY,
            })
            .to_vec();
        let found = told() * Isometry3::translation(0.3, 0.3, 0.0);
        trust.learn(&told(), &covariance(), &found, &open);
        assert_eq!(trust, OdometryTrust::default());
    }

    #[test]
    fn one_push_is_no_noise() {
        let wide = after(60.0, 1);
        assert!(wide[(0, 0)] < 4.0 * 1e-4, "{wide}");
    }
}
