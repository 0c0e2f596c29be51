use super::super::attitude::attitude_rows;
use super::super::curved::perturbed_axis;
use super::super::innovation::Innovation;
use super::super::perturbation::{perturbed_plane, perturbed_pose, pose_error, rotation_matrix};
use super::super::scan_errors::{COMMON, CommonColumns, CommonErrors};
use super::curved_rows::{axis_rows, centre_rows};
use super::{Key, Value};
use crate::geometry::lie::{skew, so3_left_jacobian_inverse};
use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2, Matrix3, Matrix4, Matrix6, Point3, SMatrix, Vector3,
    Vector4, Vector6,
};
use serde::{Deserialize, Serialize};

/// A measurement that ties variables together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Factor {
    /// A pose is known: mean and covariance of its perturbation.
    Prior {
        /// The pose.
        pose: Key,
        /// Mean.
        world_from_robot: Isometry3<f64>,
        /// Covariance of `[δt; δr]`.
        covariance: Matrix6<f64>,
    },
    /// Motion between two poses was measured: odometry or scan alignment.
    Between {
        /// Earlier pose.
        before: Key,
        /// Later pose.
        after: Key,
        /// Measured motion.
        before_from_after: Isometry3<f64>,
        /// Covariance of its perturbation `[δt; δr]` in the earlier frame.
        covariance: Matrix6<f64>,
    },
    /// A plane was observed from a pose.
    Plane {
        /// The pose.
        pose: Key,
        /// The plane.
        plane: Key,
        /// Common errors of the scan and how they move this observation, if there are any.
        errors: Option<(Key, CommonColumns<3>)>,
        /// Observed frame in the robot frame.
        robot_from_plane: Isometry3<f64>,
        /// Covariance of (offset, tilt about y, tilt about x) in the observed frame.
        covariance: Matrix3<f64>,
    },
    /// The axis of a cylinder was observed from a pose.
    Axis {
        /// The pose.
        pose: Key,
        /// The axis.
        axis: Key,
        /// Common errors of the scan and how they move this observation, if there are any.
        errors: Option<(Key, CommonColumns<4>)>,
        /// Observed frame in the robot frame, z along the axis.
        robot_from_axis: Isometry3<f64>,
        /// Covariance of (offset along x and y, tilt towards x and y) in the observed frame.
        covariance: Matrix4<f64>,
    },
    /// The centre of a sphere was observed from a pose.
    Centre {
        /// The pose.
        pose: Key,
        /// The centre.
        centre: Key,
        /// Common errors of the scan and how they move this observation, if there are any.
        errors: Option<(Key, CommonColumns<3>)>,
        /// Observed point in the robot frame.
        robot_point: Point3<f64>,
        /// Its covariance in the robot frame, m².
        covariance: Matrix3<f64>,
    },
    /// Roll and pitch of a pose were measured.
    Attitude {
        /// The pose.
        pose: Key,
        /// Roll of `Rz Ry Rx`.
        roll_rad: f64,
        /// Pitch.
        pitch_rad: f64,
        /// Standard deviation of each.
        sigma_rad: f64,
    },
    /// Size of the common errors of a scan.
    ErrorPrior {
        /// The errors, in units of their own standard deviation.
        errors: Key,
    },
}

/// A factor at the present values: whitened residual and Jacobians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Linearised {
    /// Rows of the residual by the columns of all keys in order.
    pub jacobian: DMatrix<f64>,
    /// Residual, whitened.
    pub residual: DVector<f64>,
}

impl Factor {
    /// The variables, in the order of the Jacobian's columns.
    pub fn keys(&self) -> Vec<Key> {
        match self {
            Self::Prior { pose, .. } | Self::Attitude { pose, .. } => vec![*pose],
            Self::Between { before, after, .. } => vec![*before, *after],
            Self::Plane { pose, plane: seen, errors, .. }
            | Self::Centre { pose, centre: seen, errors, .. } => {
                let errors = errors.as_ref().map(|(key, _)| *key);
                [*pose, *seen].into_iter().chain(errors).collect()
            }
            Self::Axis { pose, axis, errors, .. } => {
                let errors = errors.as_ref().map(|(key, _)| *key);
                [*pose, *axis].into_iter().chain(errors).collect()
            }
            Self::ErrorPrior { errors } => vec![*errors],
        }
    }

    /// Root of the noise of a sighted axis or centre, and how many of its components are lengths.
    pub fn curve_noise(&self) -> Option<(DMatrix<f64>, usize)> {
        let dense = |columns: &[f64], size| DMatrix::from_column_slice(size, size, columns);
        match self {
            Self::Axis { covariance, .. } => {
                Some((dense(covariance.cholesky()?.l().as_slice(), 4), 2))
            }
            Self::Centre { covariance, .. } => {
                Some((dense(covariance.cholesky()?.l().as_slice(), 3), 3))
            }
            _ => None,
        }
    }

    /// Whitened residual and Jacobians; `value` gives a variable's value.
    pub fn linearise<'a>(&self, value: impl Fn(Key) -> &'a Value) -> Linearised {
        match self {
            Self::Prior { pose, world_from_robot, covariance } => {
                let error = pose_error(world_from_robot, value(*pose).pose());
                let turn = Vector3::new(error[3], error[4], error[5]);
                let mut jacobian = Matrix6::identity();
                jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&so3_left_jacobian_inverse(&turn));
                whitened6(covariance, &error, &[jacobian])
            }
            Self::Between { before, after, before_from_after, covariance } => {
                let (before, after) = (value(*before).pose(), value(*after).pose());
                between_rows(before, after, before_from_after, covariance)
            }
            Self::Plane { pose, plane, errors, robot_from_plane, covariance } => {
                let common =
                    errors.as_ref().map(|(key, jacobian)| (jacobian, value(*key).errors()));
                plane_rows(
                    value(*pose).pose(),
                    value(*plane).plane(),
                    common,
                    robot_from_plane,
                    covariance,
                )
            }
            Self::Axis { pose, axis, errors, robot_from_axis, covariance } => {
                let common =
                    errors.as_ref().map(|(key, jacobian)| (jacobian, value(*key).errors()));
                let (pose, axis) = (value(*pose).pose(), value(*axis).axis());
                axis_rows(pose, axis, common, robot_from_axis, covariance)
            }
            Self::Centre { pose, centre, errors, robot_point, covariance } => {
                let common =
                    errors.as_ref().map(|(key, jacobian)| (jacobian, value(*key).errors()));
                let (pose, centre) = (value(*pose).pose(), value(*centre).centre());
                centre_rows(pose, centre, common, robot_point, covariance)
            }
            Self::Attitude { pose, roll_rad, pitch_rad, sigma_rad } => {
                let (residual, rows) = attitude_rows(value(*pose).pose(), *roll_rad, *pitch_rad);
                let weight = Matrix2::identity() / *sigma_rad;
                Linearised {
                    jacobian: DMatrix::from_iterator(2, 6, (weight * rows).iter().copied()),
                    residual: DVector::from_column_slice((weight * residual).as_slice()),
                }
            }
            Self::ErrorPrior { errors } => Linearised {
                jacobian: DMatrix::identity(COMMON, COMMON),
                residual: DVector::from_column_slice(value(*errors).errors().as_slice()),
            },
        }
    }
}

/// `L⁻¹` of a covariance `L Lᵀ`; `None` where it is not positive.
fn whitener6(covariance: &Matrix6<f64>) -> Option<Matrix6<f64>> {
    covariance.cholesky()?.l().solve_lower_triangular(&Matrix6::identity())
}

fn whitened6(
    covariance: &Matrix6<f64>,
    residual: &Vector6<f64>,
    blocks: &[Matrix6<f64>],
) -> Linearised {
    let weight = whitener6(covariance).expect("covariances are made positive when they enter");
    let mut jacobian = DMatrix::zeros(6, 6 * blocks.len());
    for (i, block) in blocks.iter().enumerate() {
        jacobian.fixed_view_mut::<6, 6>(0, 6 * i).copy_from(&(weight * block));
    }
    Linearised { jacobian, residual: DVector::from_column_slice((weight * residual).as_slice()) }
}

fn between_rows(
    before: &Isometry3<f64>,
    after: &Isometry3<f64>,
    measured: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
) -> Linearised {
    let error = pose_error(measured, &(before.inverse() * after));
    let turn = Vector3::new(error[3], error[4], error[5]);
    let before_from_world = rotation_matrix(before).transpose();
    let log = so3_left_jacobian_inverse(&turn) * before_from_world;
    let lever = after.translation.vector - before.translation.vector;
    let mut on_after = Matrix6::zeros();
    on_after.fixed_view_mut::<3, 3>(0, 0).copy_from(&before_from_world);
    on_after.fixed_view_mut::<3, 3>(3, 3).copy_from(&log);
    let mut on_before = -on_after;
    on_before.fixed_view_mut::<3, 3>(0, 3).copy_from(&(before_from_world * skew(&lever)));
    whitened6(covariance, &error, &[on_before, on_after])
}

fn plane_rows(
    pose: &Isometry3<f64>,
    plane: &Isometry3<f64>,
    common: Option<(&CommonColumns<3>, &CommonErrors)>,
    robot_from_plane: &Isometry3<f64>,
    covariance: &Matrix3<f64>,
) -> Linearised {
    // The scan's common errors have moved the observation by `jacobian * errors`: take that back.
    let corrected = common.map_or(*robot_from_plane, |(jacobian, errors)| {
        perturbed_plane(robot_from_plane, &-(jacobian * errors))
    });
    let innovation = Innovation::as_observed(plane, pose, &corrected);
    let noise = innovation.h_z * covariance * innovation.h_z.transpose();
    // Where odometry leaps by kilometres a pose may be linearised with a plane edge on: the noise is
    // then told as if both lay flat on one another.
    let weight = ((noise + noise.transpose()) * 0.5)
        .cholesky()
        .or_else(|| covariance.cholesky())
        .and_then(|cholesky| cholesky.l().solve_lower_triangular(&Matrix3::identity()))
        .expect("an observation's covariance is positive");
    let mut jacobian = DMatrix::zeros(3, 9 + if common.is_some() { COMMON } else { 0 });
    jacobian.fixed_view_mut::<3, 6>(0, 0).copy_from(&(weight * innovation.h_x));
    jacobian.fixed_view_mut::<3, 3>(0, 6).copy_from(&(weight * innovation.h_f));
    if let Some((errors, _)) = common {
        jacobian
            .fixed_view_mut::<3, COMMON>(0, 9)
            .copy_from(&(-(weight * innovation.h_z * errors)));
    }
    let residual = weight * innovation.h;
    Linearised { jacobian, residual: DVector::from_column_slice(residual.as_slice()) }
}

/// A covariance with `floor` added to its diagonal where it would not be positive else.
pub fn positive(covariance: &Matrix6<f64>, floor: &Vector6<f64>) -> Matrix6<f64> {
    let symmetric = (covariance + covariance.transpose()) * 0.5;
    symmetric + Matrix6::from_diagonal(floor)
}

impl Value {
    /// Number of components of its error.
    pub fn dimension(&self) -> usize {
        match self {
            Self::Pose(_) => 6,
            Self::Plane(_) | Self::Centre(_) => 3,
            Self::Axis(_) => 4,
            Self::Errors(_) => COMMON,
        }
    }

    /// The pose.
    ///
    /// # Panics
    ///
    /// When the variable is of another kind: keys of kinds are never mixed by the graph's builder.
    pub fn pose(&self) -> &Isometry3<f64> {
        match self {
            Self::Pose(pose) => pose,
            other => panic!("a pose was expected, not {other:?}"),
        }
    }

    /// The plane frame. Panics as [`pose`](Self::pose) does.
    pub fn plane(&self) -> &Isometry3<f64> {
        match self {
            Self::Plane(frame) => frame,
            other => panic!("a plane was expected, not {other:?}"),
        }
    }

    /// The axis frame. Panics as [`pose`](Self::pose) does.
    pub fn axis(&self) -> &Isometry3<f64> {
        match self {
            Self::Axis(frame) => frame,
            other => panic!("an axis was expected, not {other:?}"),
        }
    }

    /// The centre. Panics as [`pose`](Self::pose) does.
    pub fn centre(&self) -> &Point3<f64> {
        match self {
            Self::Centre(point) => point,
            other => panic!("a centre was expected, not {other:?}"),
        }
    }

    /// The common errors of a scan. Panics as [`pose`](Self::pose) does.
    pub fn errors(&self) -> &CommonErrors {
        match self {
            Self::Errors(errors) => errors,
            other => panic!("errors of a scan were expected, not {other:?}"),
        }
    }

    /// The value moved by an error of its [`dimension`](Self::dimension).
    #[must_use]
    pub fn perturbed(&self, error: &[f64]) -> Self {
        match self {
            Self::Pose(pose) => {
                Self::Pose(perturbed_pose(pose, &Vector6::from_column_slice(error)))
            }
            Self::Plane(frame) => {
                Self::Plane(perturbed_plane(frame, &Vector3::from_column_slice(error)))
            }
            Self::Axis(frame) => {
                Self::Axis(perturbed_axis(frame, &Vector4::from_column_slice(error)))
            }
            Self::Centre(point) => Self::Centre(point + Vector3::from_column_slice(error)),
            Self::Errors(errors) => Self::Errors(errors + CommonErrors::from_column_slice(error)),
        }
    }
}

/// Scales the columns of a common-error Jacobian by the errors' standard deviations, so that the
/// errors become variables of unit variance.
pub fn scaled_errors<const N: usize>(
    jacobian: &CommonColumns<N>,
    sigmas: &CommonErrors,
) -> CommonColumns<N> {
    jacobian * SMatrix::<f64, COMMON, COMMON>::from_diagonal(sigmas)
}

#[cfg(test)]
mod tests {
    use super::super::super::perturbation::tests::any_pose;
    use super::*;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    fn check(factor: &Factor, values: &[Value]) -> Result<(), TestCaseError> {
        let linear = factor.linearise(|key| &values[key.0 as usize]);
        let step = 1e-6;
        let mut column = 0;
        for key in factor.keys() {
            let at = key.0 as usize;
            for axis in 0..values[at].dimension() {
                let shifted = |by: f64| {
                    let mut error = vec![0.0; values[at].dimension()];
                    error[axis] = by;
                    let mut moved = values.to_vec();
                    moved[at] = values[at].perturbed(&error);
                    factor.linearise(|key| &moved[key.0 as usize]).residual
                };
                let numeric = (shifted(step) - shifted(-step)) / (2.0 * step);
                let analytic = linear.jacobian.column(column).into_owned();
                let gap = (&analytic - &numeric).norm();
                prop_assert!(
                    gap < 2e-5 * (1.0 + numeric.norm()),
                    "{factor:?} {analytic} {numeric}"
                );
                column += 1;
            }
        }
        prop_assert_eq!(column, linear.jacobian.ncols());
        Ok(())
    }

    proptest! {
        #[test]
        fn pose_factors_match_central_differences(
            a in any_pose(), b in any_pose(), e in prop::array::uniform6(-0.3..0.3f64)
        ) {
            let covariance = Matrix6::from_diagonal(&Vector6::new(0.1, 0.2, 0.3, 0.01, 0.02, 0.04));
            let values = [Value::Pose(a), Value::Pose(b)];
            let error = Vector6::from_row_slice(&e);
            check(&Factor::Prior { pose: Key(0), world_from_robot: perturbed_pose(&a, &error), covariance }, &values)?;
            let before_from_after = perturbed_pose(&(a.inverse() * b), &error);
            check(&Factor::Between { before: Key(0), after: Key(1), before_from_after, covariance }, &values)?;
            check(&Factor::Attitude { pose: Key(1), roll_rad: e[0], pitch_rad: e[1], sigma_rad: 0.01 }, &values)?;
        }

        /// Tilts are kept at zero here: the weight depends on them at second order, which a filter
        /// that whitens at its linearisation point leaves out.
        #[test]
        fn plane_factors_match_central_differences(
            pose in any_pose(), observed in any_pose(),
            shift in prop::array::uniform3(-1.0..1.0f64), turn in -3.0..3.0f64,
            common in prop::collection::vec(-1.0..1.0f64, 3 * COMMON),
        ) {
            let near = Isometry3::from_parts(
                Vector3::new(shift[0], shift[1], 0.1 * shift[2]).into(),
                UnitQuaternion::from_scaled_axis(Vector3::z() * turn),
            );
            let values = [
                Value::Pose(pose), Value::Plane(pose * observed * near), Value::Errors(CommonErrors::zeros()),
            ];
            let covariance = Matrix3::from_diagonal(&Vector3::new(0.02, 0.01, 0.01));
            let factor = |errors| Factor::Plane {
                pose: Key(0), plane: Key(1), errors, robot_from_plane: observed, covariance,
            };
            check(&factor(None), &values)?;
            check(&factor(Some((Key(2), CommonColumns::from_row_slice(&common) * 0.01))), &values)?;
        }

        #[test]
        fn curve_factors_match_central_differences(
            pose in any_pose(), observed in any_pose(),
            shift in prop::array::uniform3(-1.0..1.0f64), tilt in prop::array::uniform3(-0.3..0.3f64),
            errors in prop::array::uniform6(-1.0..1.0f64),
            common in prop::collection::vec(-1.0..1.0f64, 4 * COMMON),
        ) {
            let near = Isometry3::new(Vector3::from(shift), Vector3::from(tilt));
            let frame = pose * observed * near;
            let values = [
                Value::Pose(pose), Value::Axis(frame),
                Value::Centre(Point3::from(frame.translation.vector)),
                Value::Errors(CommonErrors::from(errors)),
            ];
            let by_errors = CommonColumns::<4>::from_row_slice(&common) * 0.01;
            let covariance = Matrix4::from_diagonal(&Vector4::new(0.02, 0.03, 0.01, 0.04));
            let axis = |errors| Factor::Axis {
                pose: Key(0), axis: Key(1), errors, robot_from_axis: observed, covariance,
            };
            check(&axis(None), &values)?;
            check(&axis(Some((Key(3), by_errors))), &values)?;
            let centre = |errors| Factor::Centre {
                pose: Key(0), centre: Key(2), errors,
                robot_point: Point3::from(observed.translation.vector),
                covariance: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            };
            check(&centre(None), &values)?;
            check(&centre(Some((Key(3), by_errors.fixed_rows::<3>(0).into_owned()))), &values)?;
        }
    }
}
