use super::perturbation::{first_jacobian, second_jacobian, symmetric};
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// Metres or radians that are none: what rounding leaves of the increments of a robot that stands.
const NOTHING: f64 = 1e-9;
/// Share of the fixed part of a motion's error that stays when there was none.
const REST_SHARE: f64 = 0.1;

/// How wrong wheel odometry of a skid-steered robot is, per way driven and angle turned.
///
/// Each standard deviation is the root of the sum of the squares of a fixed part, a part per metre
/// of path and a part per radian of turning. The wheels measure x, y and heading; height, pitch and
/// roll are not measured at all, so their spread is what the ground may do to the robot within a
/// metre (ramps, kerbs), not an accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OdometryNoise {
    /// Position and height, fixed part of any motion, in metres: starting and stopping. Valid: above 0.
    pub fixed_m: f64,
    /// Heading, pitch and roll, fixed part of any motion, in radians. Valid: above 0.
    pub fixed_rad: f64,
    /// Position error per metre of path. Valid: 0 to 1.
    pub position_per_m: f64,
    /// Position error in metres per radian turned: a skid-steered robot walks while it turns.
    /// Valid: 0 to 1.
    pub position_per_rad: f64,
    /// Heading error in radians per metre of path. Valid: 0 to 1.
    pub heading_per_m: f64,
    /// Heading error per radian turned: wheels slip sideways. Valid: 0 to 1.
    pub heading_per_rad: f64,
    /// The same while nothing has told how much of the turns that the wheels count the robot makes: skid-steered
    /// ones turn it by half to all of that. Valid: 0 to 1.
    pub heading_unproven_per_rad: f64,
    /// Height error per metre of path. Valid: 0 to 1.
    pub height_per_m: f64,
    /// Pitch and roll error in radians per metre of path. Valid: 0 to 1.
    pub attitude_per_m: f64,
    /// What replaces the wheels' heading, height and attitude where an inertial unit gave the turn.
    pub inertial: InertialNoise,
}

/// How wrong the changes of attitude and place are that an inertial unit gives, and what follows from them.
///
/// USARSim's unit errs by 5 % of each step's change of each angle and by 5 % of its length in each coordinate,
/// independently from step to step, and writes two decimals (protocol reference, section 5.2): the spread
/// grows with the root of the sum of the squared steps, not with time or way.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct InertialNoise {
    /// Each angle, fixed part of any motion, in radians: the resolution of the two readings that a
    /// motion lies between. Valid: above 0.
    pub fixed_rad: f64,
    /// Error of a step's change of angle as a share of it. Valid: 0 to 1.
    pub step_share: f64,
    /// Height, fixed part of any motion, in metres: how the body sits on its springs. Valid: above 0.
    pub height_fixed_m: f64,
    /// Height error per metre of path: slopes too small for the resolution of the pitch, and what the ground
    /// does between two readings. What pitch itself has erred by on the way comes on top. Valid: 0 to 1.
    pub height_per_m: f64,
    /// Height error in metres per radian that the body tilts: about which of its wheels it does, none knows.
    /// Valid: 0 to 1.
    pub height_per_rad: f64,
    /// Pitch and roll error in radians per metre of path: the body rocks between readings.
    /// Valid: 0 to 1.
    pub attitude_per_m: f64,
    /// Place, fixed part of any motion, in metres: the resolution of two readings. Valid: above 0.
    pub fixed_m: f64,
    /// Place for each root of a metre of path, in metres: a step's share times the root of its length, which
    /// is 0.1 m at half a metre a second. Valid: 0 to 1.
    pub place_per_root_m: f64,
    /// Place per metre of path: the turn of the unit's frame in the map's, which the resolution of the heading
    /// leaves open. Valid: 0 to 1.
    pub place_per_m: f64,
}

impl Default for InertialNoise {
    fn default() -> Self {
        Self {
            fixed_rad: 0.006,
            step_share: 0.06,
            height_fixed_m: 0.004,
            height_per_m: 0.004,
            height_per_rad: 0.2,
            attitude_per_m: 0.004,
            fixed_m: 0.006,
            place_per_root_m: 0.02,
            place_per_m: 0.006,
        }
    }
}

/// What an increment of motion was measured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MotionSource {
    /// The wheels of both sides.
    Wheels,
    /// The same, where nothing has told yet how much of the turns that they count the robot makes.
    UnprovenWheels,
    /// The way by the wheels, the turn by an inertial unit.
    InertialTurn,
    /// Way and turn by an inertial unit.
    Inertial,
}

impl MotionSource {
    /// Whether an inertial unit had a part in it.
    pub fn is_inertial(self) -> bool {
        matches!(self, Self::InertialTurn | Self::Inertial)
    }
}

impl Default for OdometryNoise {
    fn default() -> Self {
        Self {
            fixed_m: 0.01,
            fixed_rad: 0.005,
            position_per_m: 0.05,
            position_per_rad: 0.05,
            heading_per_m: 0.05,
            heading_per_rad: 0.12,
            heading_unproven_per_rad: 0.3,
            height_per_m: 0.08,
            attitude_per_m: 0.06,
            inertial: InertialNoise::default(),
        }
    }
}

/// Standard deviations of a heading of which nothing is known, all being as likely, and of the tilts of a body of
/// which no more is known than that it stands: no motion leaves more open, however long it is told to be.
const UNKNOWN_HEADING_RAD: f64 = 1.8;
const UNKNOWN_TILT_RAD: f64 = 0.5;
/// The same for a place, in metres: a leap of kilometres is a broken line of odometry, and a map in which one step
/// is open by as much is too stiff elsewhere to be solved.
const UNKNOWN_PLACE_M: f64 = 100.0;

/// Motion gathered between two scans.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Pose of the robot now in its own frame at the beginning.
    pub before_from_after: Isometry3<f64>,
    /// Length of the path in metres, turns back included.
    pub path_m: f64,
    /// Sum of the absolute turns in radians.
    pub turn_rad: f64,
    /// Part of the turns that wheels gave of which no turn has been proven, in radians.
    pub unproven_turn_rad: f64,
    /// Part of the path whose attitude an inertial unit gave, in metres.
    pub inertial_path_m: f64,
    /// Part of the turns that an inertial unit gave, in radians.
    pub inertial_turn_rad: f64,
    /// Sum of the squares of those turns, step by step, in rad².
    pub inertial_steps_rad2: f64,
    /// Sum of the squares of those about level axes, in rad².
    pub inertial_tilts_rad2: f64,
    /// Part of the path that an inertial unit's places gave, in metres.
    pub inertial_way_m: f64,
    /// Turns on that part, in radians.
    pub inertial_way_turn_rad: f64,
    /// Covariance of parts of the motion that were measured otherwise, in the frame at the beginning.
    pub measured: Matrix6<f64>,
}

impl Default for Motion {
    fn default() -> Self {
        Self {
            before_from_after: Isometry3::identity(),
            path_m: 0.0,
            turn_rad: 0.0,
            unproven_turn_rad: 0.0,
            inertial_path_m: 0.0,
            inertial_turn_rad: 0.0,
            inertial_steps_rad2: 0.0,
            inertial_tilts_rad2: 0.0,
            inertial_way_m: 0.0,
            inertial_way_turn_rad: 0.0,
            measured: Matrix6::zeros(),
        }
    }
}

impl Motion {
    /// Appends one increment that `source` measured.
    pub fn append(&mut self, before_from_after: &Isometry3<f64>, source: MotionSource) {
        if self.measured != Matrix6::zeros() {
            self.append_measured(before_from_after, &Matrix6::zeros());
        } else {
            self.before_from_after *= before_from_after;
            self.before_from_after.rotation.renormalize();
        }
        let path_m = before_from_after.translation.vector.norm();
        let turn_rad = before_from_after.rotation.angle();
        self.path_m += path_m;
        self.turn_rad += turn_rad;
        if source == MotionSource::UnprovenWheels {
            self.unproven_turn_rad += turn_rad;
        }
        if source.is_inertial() {
            self.inertial_path_m += path_m;
            self.inertial_turn_rad += turn_rad;
            self.inertial_steps_rad2 += turn_rad * turn_rad;
            let tilt = before_from_after.rotation.scaled_axis().xy();
            self.inertial_tilts_rad2 += tilt.norm_squared();
        }
        if source == MotionSource::Inertial {
            self.inertial_way_m += path_m;
            self.inertial_way_turn_rad += turn_rad;
        }
    }

    /// Appends a motion that was not measured by the wheels, with the covariance of its perturbation in
    /// the frame before it.
    pub fn append_measured(
        &mut self,
        before_from_after: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) {
        self.measured = predicted_covariance(
            &self.before_from_after,
            &self.measured,
            before_from_after,
            covariance,
        );
        self.before_from_after *= before_from_after;
        self.before_from_after.rotation.renormalize();
    }

    /// Whether nothing was appended that moved the robot.
    pub fn is_still(&self) -> bool {
        self.path_m < NOTHING && self.turn_rad < NOTHING && self.measured == Matrix6::zeros()
    }
}

impl OdometryNoise {
    /// The paper's Q with the covariance of what was measured otherwise: covariance of a motion's error `[δt; δr]` in the frame at its beginning.
    pub fn covariance(&self, motion: &Motion) -> Matrix6<f64> {
        let sum = |parts: &[f64]| parts.iter().map(|part| part * part).sum::<f64>();
        let (path, turn) = (motion.path_m, motion.turn_rad);
        let (told_path, steps) = (motion.inertial_path_m, motion.inertial_steps_rad2.sqrt());
        let (wheel_path, wheel_turn) = (path - told_path, turn - motion.inertial_turn_rad);
        // A robot that was not told to move still rocks a little on its wheels.
        let rest = if motion.is_still() { REST_SHARE } else { 1.0 };
        let fixed_m = rest * self.fixed_m;
        let inertial = &self.inertial;
        let unit_way = motion.inertial_way_m;
        let (wheel_way, wheel_way_turn) = (path - unit_way, turn - motion.inertial_way_turn_rad);
        let only_unit_way = !motion.is_still() && wheel_way == 0.0 && wheel_way_turn == 0.0;
        let place_fixed_m = if only_unit_way { inertial.fixed_m } else { fixed_m };
        let only_inertial = !motion.is_still() && wheel_path == 0.0 && wheel_turn == 0.0;
        let fixed_rad = if only_inertial { inertial.fixed_rad } else { rest * self.fixed_rad };
        let position = sum(&[
            place_fixed_m,
            self.position_per_m * wheel_way,
            self.position_per_rad * wheel_way_turn,
            inertial.place_per_root_m * unit_way.sqrt(),
            inertial.place_per_m * unit_way,
        ])
        .min(UNKNOWN_PLACE_M.powi(2));
        let heading = sum(&[
            fixed_rad,
            self.heading_per_m * wheel_path,
            self.heading_per_rad * wheel_turn,
            self.heading_unproven_per_rad * motion.unproven_turn_rad,
            inertial.step_share * steps,
        ])
        .min(UNKNOWN_HEADING_RAD.powi(2));
        let tilts = motion.inertial_tilts_rad2.sqrt();
        let height_fixed_m = if only_inertial { inertial.height_fixed_m } else { fixed_m };
        let height = sum(&[
            height_fixed_m,
            self.height_per_m * wheel_path,
            inertial.height_per_m * told_path,
            inertial.step_share * tilts * told_path,
            inertial.height_per_rad * tilts,
        ])
        .min(UNKNOWN_PLACE_M.powi(2));
        let attitude = sum(&[
            fixed_rad,
            self.attitude_per_m * wheel_path,
            inertial.attitude_per_m * told_path,
            inertial.step_share * steps,
        ])
        .min(UNKNOWN_TILT_RAD.powi(2));
        let mut covariance = Matrix6::from_diagonal(&Vector6::new(
            position, position, height, attitude, attitude, heading,
        ));
        // A heading error that grows along the way displaces the end sideways by half the way; when
        // it grew is not known, so as much again is added that is not tied to the final heading. An
        // inertial unit's places do not hang on its heading.
        let by_wheels = if path > 0.0 { wheel_way / path } else { 0.0 };
        let reach = motion.before_from_after.translation.vector * by_wheels;
        let reach = reach.cap_magnitude(UNKNOWN_PLACE_M);
        let (along_y, along_x) = (0.5 * reach.x, -0.5 * reach.y);
        let twice = 2.0 * heading;
        covariance[(0, 0)] += twice * along_x * along_x;
        covariance[(1, 1)] += twice * along_y * along_y;
        covariance[(0, 1)] += twice * along_x * along_y;
        covariance[(1, 0)] += twice * along_x * along_y;
        for (row, lever) in [(0, along_x), (1, along_y)] {
            covariance[(row, 5)] += heading * lever;
            covariance[(5, row)] += heading * lever;
        }
        covariance + motion.measured
    }
}

/// Whether a motion is none at all: encoders that count tell at least of rocking.
pub(super) fn is_nothing(before_from_after: &Isometry3<f64>) -> bool {
    before_from_after.translation.vector.norm() < NOTHING
        && before_from_after.rotation.angle() < NOTHING
}

/// Covariance `[δt; δr]` of what is known of a motion that nobody measured: scans that are to be matched lie
/// within a step of each other.
pub fn unmeasured_motion() -> Matrix6<f64> {
    let (step_m, turn_rad, tilt_rad) = (0.5_f64, 0.25_f64, 0.05_f64);
    let sigmas = Vector6::new(step_m, step_m, 0.1, tilt_rad, tilt_rad, turn_rad);
    Matrix6::from_diagonal(&sigmas.map(|sigma| sigma * sigma))
}

/// A planar odometry increment on ground that an inertial unit sees sloping: the way driven lies in
/// the robot's own plane, and its attitude changes from `before` to `after` (roll, pitch).
///
/// `forward_m` and `left_m` are along the axes before the motion; `turn_rad` is the change of heading.
pub fn tilted_increment(
    forward_m: f64,
    left_m: f64,
    turn_rad: f64,
    before: (f64, f64),
    after: (f64, f64),
) -> Isometry3<f64> {
    let rotation_before = UnitQuaternion::from_euler_angles(before.0, before.1, 0.0);
    let rotation_after = UnitQuaternion::from_euler_angles(after.0, after.1, turn_rad);
    // Half of the way is driven under each attitude.
    let way = Vector3::new(forward_m, left_m, 0.0);
    let level_after = UnitQuaternion::from_euler_angles(after.0, after.1, 0.0);
    let world = (rotation_before * way + level_after * way) * 0.5;
    Isometry3::from_parts(
        Translation3::from(rotation_before.inverse() * world),
        rotation_before.inverse() * rotation_after,
    )
}

/// Covariance of `world_from_before ⊕ motion`, equation (2) of the paper.
pub fn predicted_covariance(
    world_from_before: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
    motion: &Isometry3<f64>,
    motion_covariance: &Matrix6<f64>,
) -> Matrix6<f64> {
    let f_x = first_jacobian(world_from_before, &(world_from_before * motion));
    let f_u = second_jacobian(world_from_before);
    symmetric(&(f_x * covariance * f_x.transpose() + f_u * motion_covariance * f_u.transpose()))
}

#[cfg(test)]
mod tests {
    use super::super::perturbation::least_eigenvalue;
    use super::*;
    use nalgebra::Quaternion;
    use proptest::prelude::*;

    #[test]
    fn what_rounding_leaves_of_a_standing_robots_increments_is_no_motion() {
        let turn = UnitQuaternion::new_unchecked(Quaternion::new(1.0, 0.0, 2.5e-17, 0.0));
        let mut motion = Motion::default();
        for _ in 0..400 {
            let rounded = Isometry3::from_parts(Translation3::identity(), turn);
            motion.append(&rounded, MotionSource::InertialTurn);
        }
        let noise = OdometryNoise::default();
        assert_eq!(noise.covariance(&motion), noise.covariance(&Motion::default()));
    }

    proptest! {
        #[test]
        fn covariance_is_positive_for_any_motion(
            t in prop::array::uniform3(-8.0..8.0f64), turn in -3.0..3.0f64
        ) {
            let mut motion = Motion::default();
            motion.append(&Isometry3::new(Vector3::from(t), Vector3::z() * turn), MotionSource::Wheels);
            prop_assert!(least_eigenvalue(&OdometryNoise::default().covariance(&motion)) > 0.0);
        }

        #[test]
        fn noise_does_not_depend_on_how_a_straight_way_is_cut(pieces in 1..40_usize) {
            let mut whole = Motion::default();
            whole.append(&Isometry3::translation(2.0, 0.0, 0.0), MotionSource::Wheels);
            let mut cut = Motion::default();
            for _ in 0..pieces {
                let piece = Isometry3::translation(2.0 / pieces as f64, 0.0, 0.0);
                cut.append(&piece, MotionSource::Wheels);
            }
            let noise = OdometryNoise::default();
            prop_assert!((noise.covariance(&whole) - noise.covariance(&cut)).norm() < 1e-9);
        }
    }

    #[test]
    fn an_inertial_units_places_are_as_uncertain_as_their_steps_whatever_the_heading() {
        let noise = OdometryNoise::default();
        let covariance = |source: MotionSource| {
            let mut motion = Motion::default();
            for _ in 0..40 {
                motion.append(&Isometry3::new(Vector3::x() * 0.1, Vector3::z() * 0.02), source);
            }
            noise.covariance(&motion)
        };
        let [by_wheels, by_unit] =
            [MotionSource::InertialTurn, MotionSource::Inertial].map(covariance);
        let unit = &noise.inertial;
        let parts = [unit.fixed_m, 2.0 * unit.place_per_root_m, 4.0 * unit.place_per_m];
        let expected: f64 = parts.iter().map(|part| part * part).sum();
        assert!(
            (by_unit[(0, 0)] - expected).abs() < 1e-12
                && (by_unit[(1, 1)] - expected).abs() < 1e-12
        );
        assert!(by_unit[(1, 5)].abs() < 1e-12 && by_wheels[(1, 5)].abs() > 1e-6);
        assert_eq!(by_unit[(5, 5)], by_wheels[(5, 5)], "the turn is the unit's in both");
        assert!(by_wheels[(0, 0)] > 9.0 * by_unit[(0, 0)]);
    }

    #[test]
    fn a_body_that_tilts_on_the_spot_is_at_no_sure_height() {
        let height_m = |tilt_rad: f64| {
            let mut motion = Motion::default();
            motion.append(&Isometry3::rotation(Vector3::y() * tilt_rad), MotionSource::Inertial);
            OdometryNoise::default().covariance(&motion)[(2, 2)].sqrt()
        };
        assert!(height_m(0.2) > 0.04 && height_m(0.001) < 0.005);
    }

    #[test]
    fn driving_up_a_slope_climbs() {
        let up = (0.0, -0.2);
        let level = tilted_increment(1.0, 0.0, 0.3, (0.0, 0.0), (0.0, 0.0));
        assert_eq!(level.translation.vector, Vector3::x());
        let world = UnitQuaternion::from_euler_angles(up.0, up.1, 0.0)
            * tilted_increment(1.0, 0.0, 0.0, up, up).translation.vector;
        assert!((world.z - 0.2_f64.sin()).abs() < 1e-12);
        let turned = UnitQuaternion::from_euler_angles(up.0, up.1, 0.0)
            * tilted_increment(0.0, 0.0, 0.3, up, (0.05, 0.1)).rotation;
        assert!(turned.angle_to(&UnitQuaternion::from_euler_angles(0.05, 0.1, 0.3)) < 1e-12);
    }

    #[test]
    fn a_way_out_and_back_is_not_certain() {
        let mut motion = Motion::default();
        motion.append(&Isometry3::translation(3.0, 0.0, 0.0), MotionSource::Wheels);
        motion.append(&Isometry3::translation(-3.0, 0.0, 0.0), MotionSource::Wheels);
        assert!(motion.before_from_after.translation.vector.norm() < 1e-12);
        assert!(OdometryNoise::default().covariance(&motion)[(0, 0)] > 0.2 * 0.2);
    }

    #[test]
    fn an_inertial_turn_is_as_uncertain_as_its_steps() {
        let step = Isometry3::rotation(Vector3::z() * 0.1);
        let heading_sigma = |source: MotionSource| {
            let mut motion = Motion::default();
            for _ in 0..16 {
                motion.append(&step, source);
            }
            OdometryNoise::default().covariance(&motion)[(5, 5)].sqrt()
        };
        // 16 steps of 0.1 rad: the root of the sum of the squares is 0.4 rad.
        let expected = 0.006_f64.hypot(0.06 * 0.4);
        assert!((heading_sigma(MotionSource::InertialTurn) - expected).abs() < 1e-12);
        assert!(heading_sigma(MotionSource::Wheels) > 5.0 * expected);
    }

    #[test]
    fn one_step_without_the_inertial_unit_is_charged_to_the_wheels() {
        let metre = Isometry3::translation(1.0, 0.0, 0.0);
        let mut motion = Motion::default();
        motion.append(&metre, MotionSource::InertialTurn);
        let told = OdometryNoise::default().covariance(&motion)[(2, 2)];
        motion.append(&metre, MotionSource::Wheels);
        assert!(OdometryNoise::default().covariance(&motion)[(2, 2)] > 4.0 * told);
    }
}
