//! What is believed about the pose and the landmarks at hand while a scan is being associated: a
//! small dense error-state filter, updated pair by pair in Joseph's form.

use super::innovation::Innovation;
use super::observation::Observation;
use super::perturbation::{perturbed_plane, perturbed_pose, pose_error};
use super::scan_errors::{COMMON, CommonColumns, CommonErrors};
use nalgebra::{
    Const, DMatrix, DVector, Dyn, Isometry3, Matrix2, Matrix2x6, Matrix3, Matrix3xX, Matrix6,
    OMatrix, SMatrix, Vector2, Vector3, Vector6,
};

/// Components of the pose's error.
const POSE: usize = 6;
/// Cosine of a normal's angle to the vertical above which a plane lies.
const LYING_COSINE: f64 = 0.8;
/// Most points of linearisation of one update.
const MOST_LINEARISATIONS: usize = 4;
/// A turn below which an update counts as linear: over ten metres it bends a way by 0.1 mm.
const LINEAR_TURN_RAD: f64 = 0.005;

/// A tall matrix of R columns.
type MatrixXxR<const R: usize> = OMatrix<f64, Dyn, Const<R>>;

/// Joint estimate of a pose, the common errors of its scan and some planes.
#[derive(Clone, Debug)]
pub(super) struct Belief {
    pub(super) world_from_robot: Isometry3<f64>,
    errors: Option<CommonErrors>,
    pub(super) planes: Vec<Isometry3<f64>>,
    /// Rows: pose, errors if there are any, planes.
    covariance: DMatrix<f64>,
}

/// Where a pair is linearised.
struct Linearisation {
    world_from_robot: Isometry3<f64>,
    errors: Option<CommonErrors>,
    world_from_plane: Isometry3<f64>,
}

/// The rows of one pair at the present belief.
pub(super) struct PairRows {
    /// Innovation.
    pub(super) h: Vector3<f64>,
    /// Its covariance.
    pub(super) s: Matrix3<f64>,
    h_pose: nalgebra::Matrix3x6<f64>,
    h_errors: Option<CommonColumns<3>>,
    h_plane: Matrix3<f64>,
}

impl PairRows {
    /// Squared Mahalanobis distance, equation (8); infinite where S is not positive.
    pub(super) fn distance_squared(&self) -> f64 {
        self.s.cholesky().map_or(f64::INFINITY, |cholesky| self.h.dot(&cholesky.solve(&self.h)))
    }

    /// Logarithm of the determinant of S.
    pub(super) fn log_determinant(&self) -> f64 {
        self.s.determinant().max(f64::MIN_POSITIVE).ln()
    }

    /// The angle between both normals.
    pub(super) fn angle_rad(&self) -> f64 {
        self.h.y.hypot(self.h.z)
    }
}

impl Belief {
    /// A belief over a pose and planes with their joint covariance (pose first), and over common
    /// errors of unit variance where the scan has any.
    pub(super) fn new(
        world_from_robot: Isometry3<f64>,
        planes: Vec<Isometry3<f64>>,
        joint: &DMatrix<f64>,
        with_errors: bool,
    ) -> Self {
        let covariance = if with_errors {
            let size = joint.nrows() + COMMON;
            let mut wide = DMatrix::zeros(size, size);
            let rest = joint.nrows() - POSE;
            wide.view_mut((0, 0), (POSE, POSE)).copy_from(&joint.view((0, 0), (POSE, POSE)));
            wide.view_mut((POSE, POSE), (COMMON, COMMON)).fill_with_identity();
            let after = POSE + COMMON;
            wide.view_mut((after, after), (rest, rest))
                .copy_from(&joint.view((POSE, POSE), (rest, rest)));
            wide.view_mut((0, after), (POSE, rest)).copy_from(&joint.view((0, POSE), (POSE, rest)));
            wide.view_mut((after, 0), (rest, POSE)).copy_from(&joint.view((POSE, 0), (rest, POSE)));
            wide
        } else {
            joint.clone()
        };
        Self { world_from_robot, errors: with_errors.then(CommonErrors::zeros), planes, covariance }
    }

    /// The belief over the same pose and some of the planes, in the order given.
    pub(super) fn among(&self, planes: &[usize]) -> Self {
        let first = self.first_plane();
        let rows: Vec<usize> = (0..first)
            .chain(planes.iter().flat_map(|plane| (0..3).map(move |i| first + 3 * plane + i)))
            .collect();
        Self {
            world_from_robot: self.world_from_robot,
            errors: self.errors,
            planes: planes.iter().map(|&plane| self.planes[plane]).collect(),
            covariance: self.covariance.select_rows(&rows).select_columns(&rows),
        }
    }

    fn first_plane(&self) -> usize {
        POSE + if self.errors.is_some() { COMMON } else { 0 }
    }

    /// Traces of the pose's covariance: of its translation in m², of its rotation in rad².
    pub(super) fn pose_spread(&self) -> (f64, f64) {
        let p = &self.covariance;
        (p[(0, 0)] + p[(1, 1)] + p[(2, 2)], p[(3, 3)] + p[(4, 4)] + p[(5, 5)])
    }

    /// Variances of the pose within a plane: of its translation along the axis along which it is known worse,
    /// in m², of its rotation over all axes, in rad².
    pub(super) fn spread_within(&self, plane: usize) -> (f64, f64) {
        let axes = self.planes[plane].rotation;
        let shift = self.covariance.fixed_view::<3, 3>(0, 0);
        let along = |axis: Vector3<f64>| (axes * axis).dot(&(shift * (axes * axis)));
        (along(Vector3::x()).max(along(Vector3::y())), self.pose_spread().1)
    }

    /// Variance of one component of the pose.
    pub(super) fn pose_variance(&self, component: usize) -> f64 {
        self.covariance[(component, component)]
    }

    /// Whether a plane lies, as floors and ceilings do.
    pub(super) fn lies(&self, plane: usize) -> bool {
        (self.planes[plane].rotation * Vector3::z()).z.abs() > LYING_COSINE
    }

    /// Variance of a plane's offset along its normal, in m².
    pub(super) fn offset_variance(&self, plane: usize) -> f64 {
        let at = self.first_plane() + 3 * plane;
        self.covariance[(at, at)]
    }

    /// Variance of a plane's tilt about whichever of its axes it is known worse.
    pub(super) fn tilt_variance(&self, plane: usize) -> f64 {
        let at = self.first_plane() + 3 * plane;
        self.covariance[(at + 1, at + 1)].max(self.covariance[(at + 2, at + 2)])
    }

    /// Covariance of the pose.
    pub(super) fn pose_covariance(&self) -> Matrix6<f64> {
        self.covariance.fixed_view::<POSE, POSE>(0, 0).into_owned()
    }

    /// The common errors as far as they are known, in units of their standard deviations.
    pub(super) fn errors(&self) -> CommonErrors {
        self.errors.unwrap_or_else(CommonErrors::zeros)
    }

    /// Innovation and its covariance for an observation taken as plane `plane`, equations (3) to (7)
    /// with the map's own covariance. `common` are the observation's columns for the scan's errors.
    pub(super) fn pair(
        &self,
        observation: &Observation,
        common: Option<&CommonColumns<3>>,
        plane: usize,
    ) -> PairRows {
        self.pair_at(&self.moved(plane, None), observation, common, plane)
    }

    /// The same linearised elsewhere than at the mean.
    fn pair_at(
        &self,
        at: &Linearisation,
        observation: &Observation,
        common: Option<&CommonColumns<3>>,
        plane: usize,
    ) -> PairRows {
        let observed = match (common, &at.errors) {
            (Some(jacobian), Some(errors)) => {
                perturbed_plane(&observation.robot_from_plane, &-(jacobian * errors))
            }
            _ => observation.robot_from_plane,
        };
        let Innovation { h, h_x, h_z, h_f } =
            Innovation::new(&at.world_from_plane, &at.world_from_robot, &observed);
        let h_errors = common.filter(|_| self.errors.is_some()).map(|jacobian| -(h_z * jacobian));
        let noise = h_z * observation.covariance * h_z.transpose();
        let at = self.first_plane() + 3 * plane;
        let p = &self.covariance;
        let on_pose = p.fixed_view::<POSE, POSE>(0, 0);
        let on_plane = p.fixed_view::<3, 3>(at, at);
        let cross = h_x * p.fixed_view::<POSE, 3>(0, at) * h_f.transpose();
        let mut s = h_x * on_pose * h_x.transpose()
            + h_f * on_plane * h_f.transpose()
            + cross
            + cross.transpose()
            + noise;
        if let Some(h_e) = &h_errors {
            let with_pose = h_x * p.fixed_view::<POSE, COMMON>(0, POSE) * h_e.transpose();
            let with_plane = h_f * p.fixed_view::<3, COMMON>(at, POSE) * h_e.transpose();
            s += h_e * p.fixed_view::<COMMON, COMMON>(POSE, POSE) * h_e.transpose()
                + with_pose
                + with_pose.transpose()
                + with_plane
                + with_plane.transpose();
        }
        PairRows { h, s: (s + s.transpose()) * 0.5, h_pose: h_x, h_errors, h_plane: h_f }
    }

    /// Takes a pair in: an error-state update in Joseph's form, linearised where the belief is and
    /// again where it comes to lie, as long as that turns the robot by more than a little.
    pub(super) fn absorb(
        &mut self,
        observation: &Observation,
        common: Option<&CommonColumns<3>>,
        plane: usize,
    ) {
        let mut at = self.moved(plane, None);
        let mut step: DVector<f64> = DVector::zeros(self.covariance.nrows());
        for _ in 0..MOST_LINEARISATIONS {
            // The covariance is that of before; only the point of linearisation moves.
            let rows = self.pair_at(&at, observation, common, plane);
            let Some(s) = rows.s.cholesky() else { return };
            let cross = self.covariance_times_rows(&rows, plane);
            let gain: MatrixXxR<3> = s.solve(&cross.transpose()).transpose();
            // Innovation of the belief before, carried along the present linearisation.
            let innovation = rows.h - self.rows_times(&rows, plane, &step);
            let next = -(&gain * innovation);
            let turn = (next.rows(3, 3) - step.rows(3, 3)).norm();
            step = next;
            if turn < LINEAR_TURN_RAD {
                self.joseph(&gain, &cross, &rows.s);
                break;
            }
            at = self.moved(plane, Some(&step));
        }
        self.shift(&step);
    }

    /// `P Hᵀ` of a pair, from the few columns that H touches.
    fn covariance_times_rows(&self, rows: &PairRows, plane: usize) -> MatrixXxR<3> {
        let at = self.first_plane() + 3 * plane;
        let p = &self.covariance;
        let mut cross: MatrixXxR<3> = p.fixed_columns::<POSE>(0) * rows.h_pose.transpose();
        cross += p.fixed_columns::<3>(at) * rows.h_plane.transpose();
        if let Some(h_e) = &rows.h_errors {
            cross += p.fixed_columns::<COMMON>(POSE) * h_e.transpose();
        }
        cross
    }

    /// `H δ` of a pair.
    fn rows_times(&self, rows: &PairRows, plane: usize, error: &DVector<f64>) -> Vector3<f64> {
        let at = self.first_plane() + 3 * plane;
        let mut product =
            rows.h_pose * error.fixed_rows::<POSE>(0) + rows.h_plane * error.fixed_rows::<3>(at);
        if let Some(h_e) = &rows.h_errors {
            product += h_e * error.fixed_rows::<COMMON>(POSE);
        }
        product
    }

    /// The means that a pair with a plane depends on, moved by `error`.
    fn moved(&self, plane: usize, error: Option<&DVector<f64>>) -> Linearisation {
        let mut at = Linearisation {
            world_from_robot: self.world_from_robot,
            errors: self.errors,
            world_from_plane: self.planes[plane],
        };
        if let Some(error) = error {
            let pose: Vector6<f64> = error.fixed_view::<POSE, 1>(0, 0).into_owned();
            at.world_from_robot = perturbed_pose(&self.world_from_robot, &pose);
            if let Some(errors) = &mut at.errors {
                *errors += error.fixed_view::<COMMON, 1>(POSE, 0);
            }
            let row = self.first_plane() + 3 * plane;
            let part: Vector3<f64> = error.fixed_view::<3, 1>(row, 0).into_owned();
            at.world_from_plane = perturbed_plane(&self.planes[plane], &part);
        }
        at
    }

    /// Takes a measured attitude in.
    pub(super) fn absorb_attitude(
        &mut self,
        residual: &Vector2<f64>,
        rows: &Matrix2x6<f64>,
        sigma_rad: f64,
    ) {
        let noise = Matrix2::identity() * (sigma_rad * sigma_rad);
        let p = self.pose_covariance();
        let s = rows * p * rows.transpose() + noise;
        let Some(inverse) = s.try_inverse() else { return };
        let cross: MatrixXxR<2> = self.covariance.fixed_columns::<POSE>(0) * rows.transpose();
        let gain = &cross * inverse;
        self.joseph(&gain, &cross, &s);
        self.shift(&-(gain * residual));
    }

    /// `(I - K H) P (I - K H)ᵀ + K N Kᵀ`, from `P Hᵀ` and `S = H P Hᵀ + N` alone.
    fn joseph<const R: usize>(
        &mut self,
        gain: &MatrixXxR<R>,
        cross: &MatrixXxR<R>,
        s: &SMatrix<f64, R, R>,
    ) {
        // Multiplied out, Joseph's form is P - K (P Hᵀ)ᵀ - (P Hᵀ - K S) Kᵀ; the last term vanishes
        // for the exact gain and is what makes up for the rounding of the computed one.
        let right = cross - gain * s;
        let products = [(gain.as_slice(), cross.as_slice()), (right.as_slice(), gain.as_slice())];
        let size = self.covariance.nrows();
        subtract_products(self.covariance.as_mut_slice(), size, &products);
    }

    fn shift(&mut self, error: &DVector<f64>) {
        let pose: Vector6<f64> = error.fixed_view::<POSE, 1>(0, 0).into_owned();
        self.world_from_robot = perturbed_pose(&self.world_from_robot, &pose);
        if let Some(errors) = &mut self.errors {
            *errors += error.fixed_view::<COMMON, 1>(POSE, 0);
        }
        let first = self.first_plane();
        for (i, plane) in self.planes.iter_mut().enumerate() {
            let part: Vector3<f64> = error.fixed_view::<3, 1>(first + 3 * i, 0).into_owned();
            *plane = perturbed_plane(plane, &part);
        }
    }

    /// The same belief linearised at another pose, and what its own pose is from there.
    pub(super) fn linearised_at(&self, world_from_robot: &Isometry3<f64>) -> (Self, Vector6<f64>) {
        let mut moved = self.clone();
        moved.world_from_robot = *world_from_robot;
        (moved, pose_error(world_from_robot, &self.world_from_robot))
    }

    /// The joint normalised innovation squared of pairs (observation, plane); `from_pose` is the error
    /// of the believed pose as seen from the point of linearisation.
    pub(super) fn joint_nis(&self, pairs: &[(PairRows, usize)], from_pose: &Vector6<f64>) -> f64 {
        let size = 3 * pairs.len();
        let mut h = DVector::zeros(size);
        let mut s = DMatrix::zeros(size, size);
        for (i, (rows, plane)) in pairs.iter().enumerate() {
            h.fixed_rows_mut::<3>(3 * i).copy_from(&(rows.h + rows.h_pose * from_pose));
            s.fixed_view_mut::<3, 3>(3 * i, 3 * i).copy_from(&rows.s);
            let carried = self.rows_times_covariance(rows, *plane);
            for (j, (other, other_plane)) in pairs.iter().enumerate().skip(i + 1) {
                let block = self.block(&carried, other, *other_plane);
                s.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&block);
                s.fixed_view_mut::<3, 3>(3 * j, 3 * i).copy_from(&block.transpose());
            }
        }
        s.cholesky().map_or(f64::INFINITY, |cholesky| h.dot(&cholesky.solve(&h)))
    }

    /// `H P` of a pair.
    fn rows_times_covariance(&self, rows: &PairRows, plane: usize) -> Matrix3xX<f64> {
        let at = self.first_plane() + 3 * plane;
        let p = &self.covariance;
        let mut product: Matrix3xX<f64> = rows.h_pose * p.fixed_rows::<POSE>(0);
        product += rows.h_plane * p.fixed_rows::<3>(at);
        if let Some(h_e) = &rows.h_errors {
            product += h_e * p.fixed_rows::<COMMON>(POSE);
        }
        product
    }

    /// `(H P) H'ᵀ` with the rows of another pair.
    fn block(&self, carried: &Matrix3xX<f64>, rows: &PairRows, plane: usize) -> Matrix3<f64> {
        let at = self.first_plane() + 3 * plane;
        let mut block = carried.fixed_view::<3, POSE>(0, 0) * rows.h_pose.transpose()
            + carried.fixed_view::<3, 3>(0, at) * rows.h_plane.transpose();
        if let Some(h_e) = &rows.h_errors {
            block += carried.fixed_view::<3, COMMON>(0, POSE) * h_e.transpose();
        }
        block
    }
}

/// Takes `left factorsᵀ` of each product, whose sum is symmetric, off a symmetric matrix of `size` rows:
/// below the diagonal, column by column while that is at hand, and mirrored.
fn subtract_products(matrix: &mut [f64], size: usize, products: &[(&[f64], &[f64])]) {
    for (j, column) in matrix.chunks_exact_mut(size).enumerate() {
        let column = &mut column[j..];
        for (left, factors) in products {
            for (left, factors) in left.chunks_exact(size).zip(factors.chunks_exact(size)) {
                let factor = factors[j];
                for (entry, left) in column.iter_mut().zip(&left[j..]) {
                    *entry -= left * factor;
                }
            }
        }
    }
    for column in 0..size {
        for row in 0..column {
            matrix[column * size + row] = matrix[row * size + column];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::mask::PlaneMask;
    use super::super::perturbation::tests::any_pose;
    use super::*;
    use nalgebra::{Point2, SymmetricEigen};
    use proptest::prelude::*;

    fn observation(robot_from_plane: Isometry3<f64>) -> Observation {
        Observation {
            robot_from_plane,
            covariance: Matrix3::from_diagonal(&Vector3::new(1e-5, 4e-6, 9e-6)),
            hull: vec![Point2::new(0.0, 0.0), Point2::new(1.0, 0.0), Point2::new(0.0, 1.0)],
            mask: PlaneMask::default(),
            points: 10,
            rms_m: 0.003,
        }
    }

    fn random_covariance(size: usize, seed: u64, scale: f64) -> DMatrix<f64> {
        let mut state = seed | 1;
        let root = DMatrix::from_fn(size, size, |_, _| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            ((state >> 33) as f64 / f64::from(1_u32 << 31) - 0.5) * scale
        });
        &root * root.transpose() + DMatrix::identity(size, size) * (1e-3 * scale * scale)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        /// The sparse update against the textbook with whole matrices, and one pair after the other
        /// against both at once.
        #[test]
        fn absorbing_equals_the_dense_filter(
            pose in any_pose(), a in any_pose(), b in any_pose(), seed in any::<u64>(), common in any::<bool>()
        ) {
            let joint = random_covariance(12, seed, 0.01);
            let planes = vec![pose * a, pose * b];
            let belief = Belief::new(pose, planes, &joint, common);
            let jacobian = CommonColumns::from_element(2e-4);
            let common = common.then_some(&jacobian);
            let shifted = perturbed_plane(&a, &Vector3::new(0.002, 0.001, -0.003));
            let rows = belief.pair(&observation(shifted), common, 0);
            let size = belief.covariance.nrows();
            let mut h = DMatrix::zeros(3, size);
            h.view_mut((0, 0), (3, 6)).copy_from(&rows.h_pose);
            if let Some(h_e) = &rows.h_errors {
                h.view_mut((0, 6), (3, COMMON)).copy_from(h_e);
            }
            h.view_mut((0, belief.first_plane()), (3, 3)).copy_from(&rows.h_plane);
            let seen = belief.errors.map_or(shifted, |errors| perturbed_plane(&shifted, &-(jacobian * errors)));
            let h_z = Innovation::new(&belief.planes[0], &belief.world_from_robot, &seen).h_z;
            let noise = h_z * observation(shifted).covariance * h_z.transpose();
            let s = &h * &belief.covariance * h.transpose() + DMatrix::from_column_slice(3, 3, noise.as_slice());
            prop_assert!((&s - DMatrix::from_column_slice(3, 3, rows.s.as_slice())).norm() < 1e-12);
            let gain = &belief.covariance * h.transpose() * s.try_inverse().unwrap();
            let keep = DMatrix::identity(size, size) - &gain * &h;
            let expected = &keep * &belief.covariance;
            let mut updated = belief.clone();
            updated.absorb(&observation(shifted), common, 0);
            prop_assert!((&updated.covariance - &expected).norm() < 1e-10 * (1.0 + expected.norm()));
            prop_assert!(SymmetricEigen::new(updated.covariance.clone()).eigenvalues.min() > 0.0);
            let moved = pose_error(&belief.world_from_robot, &updated.world_from_robot);
            let step = -(&gain * rows.h);
            prop_assert!((DVector::from_column_slice(moved.as_slice()) - step.rows(0, 6)).norm() < 1e-9);

            let second = belief.pair(&observation(b), common, 1);
            let first_distance = rows.distance_squared();
            let after = updated.pair(&observation(b), common, 1).distance_squared();
            let joint_distance = belief.joint_nis(&[(rows, 0), (second, 1)], &Vector6::zeros());
            // Equal up to the second order of a millimetre's correction.
            prop_assert!((first_distance + after - joint_distance).abs() < 0.05 * (1.0 + joint_distance));
        }
    }

    /// A heading that is off by 20°: one linearisation would leave centimetres.
    #[test]
    fn a_large_turn_is_iterated_away() {
        let truth = Isometry3::new(Vector3::new(1.0, 0.5, 0.0), Vector3::z() * 0.3);
        let facing = |at: Vector3<f64>, normal: Vector3<f64>| {
            let turn = nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &normal).unwrap();
            Isometry3::from_parts(at.into(), turn)
        };
        let planes = vec![
            facing(Vector3::new(9.0, 2.0, 0.0), -Vector3::x()),
            facing(Vector3::new(2.0, 7.0, 0.0), -Vector3::y()),
            facing(Vector3::new(3.0, 0.0, -0.5), Vector3::z()),
        ];
        let mut joint = DMatrix::identity(15, 15) * 1e-10;
        for (i, sigma) in [0.3, 0.3, 0.05, 0.05, 0.05, 0.35_f64].into_iter().enumerate() {
            joint[(i, i)] = sigma * sigma;
        }
        let start = perturbed_pose(&truth, &Vector6::new(0.2, -0.3, 0.02, 0.02, -0.02, 0.35));
        let mut belief = Belief::new(start, planes.clone(), &joint, false);
        for (i, plane) in planes.iter().enumerate() {
            let seen = observation(truth.inverse() * plane);
            assert!(belief.pair(&seen, None, i).distance_squared() < 16.0);
            belief.absorb(&seen, None, i);
        }
        let left = pose_error(&truth, &belief.world_from_robot);
        assert!(
            left.fixed_rows::<3>(0).norm() < 0.01 && left.fixed_rows::<3>(3).norm() < 0.002,
            "{left}"
        );
    }

    #[test]
    fn ten_thousand_updates_keep_the_covariance_symmetric_and_positive() {
        let pose = Isometry3::translation(1.0, 2.0, 0.5);
        let planes: Vec<_> = (0..4)
            .map(|i| {
                pose * Isometry3::new(
                    Vector3::new(3.0, f64::from(i), 0.0),
                    Vector3::y() * f64::from(i),
                )
            })
            .collect();
        let seen: Vec<_> = planes.iter().map(|plane| observation(pose.inverse() * plane)).collect();
        let mut belief = Belief::new(pose, planes, &random_covariance(18, 5, 0.1), false);
        for round in 0..10_000 {
            let at = round % 4;
            belief.absorb(&seen[at], None, at);
        }
        assert_eq!(belief.covariance, belief.covariance.transpose());
        assert!(SymmetricEigen::new(belief.covariance.clone()).eigenvalues.min() > 0.0);
    }
}
