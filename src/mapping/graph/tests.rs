//! The tree against dense algebra: same solution, same covariance, whatever the order of events.

use super::super::perturbation::perturbed_plane;
use super::*;
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use proptest::prelude::*;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::FRAC_PI_2;

/// A standard normal number, by adding twelve uniform ones.
fn normal(rng: &mut Pcg64) -> f64 {
    (0..12).map(|_| (rng.next_u32() as f64 + 0.5) / 4_294_967_296.0).sum::<f64>() - 6.0
}

fn drawn<const N: usize>(rng: &mut Pcg64, sigmas: [f64; N]) -> [f64; N] {
    sigmas.map(|sigma| sigma * normal(rng))
}

const STEP_SIGMAS: [f64; 6] = [0.05, 0.05, 0.02, 0.01, 0.01, 0.02];
const PLANE_SIGMAS: [f64; 3] = [0.005, 0.003, 0.003];

/// A robot that walks among planes, sees the next few at each step and now and then old ones.
struct Walk {
    graph: Graph,
    poses: Vec<Key>,
    planes: Vec<Key>,
    truth: Vec<Isometry3<f64>>,
    true_planes: Vec<Isometry3<f64>>,
    rng: Pcg64,
}

impl Walk {
    fn new(seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let true_planes = (0..40)
            .map(|i| {
                let at = Vector3::new(f64::from(i) * 0.5, 3.0 * normal(&mut rng), normal(&mut rng));
                let turn = Vector3::from(drawn(&mut rng, [1.0, 1.0, 1.0]));
                Isometry3::from_parts(at.into(), UnitQuaternion::from_scaled_axis(turn))
            })
            .collect();
        let mut graph = Graph::new(GraphConfig::default());
        let pose = graph.add_variable(Value::Pose(Isometry3::identity()));
        graph.add_factor(Factor::Prior {
            pose,
            world_from_robot: Isometry3::identity(),
            covariance: Matrix6::identity() * 1e-10,
        });
        Self {
            graph,
            poses: vec![pose],
            planes: Vec::new(),
            truth: vec![Isometry3::identity()],
            true_planes,
            rng,
        }
    }

    fn step(&mut self) {
        let motion = Isometry3::new(Vector3::new(1.0, 0.1, 0.0), Vector3::new(0.0, 0.02, 0.2));
        let last = *self.truth.last().unwrap();
        let noise = Vector6::from(drawn(&mut self.rng, STEP_SIGMAS));
        let measured = super::super::perturbation::perturbed_pose(&motion, &noise);
        let before = *self.poses.last().unwrap();
        let after = self.graph.add_variable(Value::Pose(self.graph.pose(before) * measured));
        self.graph.add_factor(Factor::Between {
            before,
            after,
            before_from_after: measured,
            covariance: Matrix6::from_diagonal(&Vector6::from(STEP_SIGMAS.map(|s| s * s))),
        });
        self.poses.push(after);
        self.truth.push(last * motion);
    }

    fn see(&mut self, index: usize) {
        let pose = *self.poses.last().unwrap();
        let exact = self.truth.last().unwrap().inverse() * self.true_planes[index];
        let noise = Vector3::from(drawn(&mut self.rng, PLANE_SIGMAS));
        let robot_from_plane = super::super::perturbation::perturbed_plane(&exact, &noise);
        while self.planes.len() <= index {
            let guess = self.graph.pose(pose) * robot_from_plane;
            self.planes.push(self.graph.add_variable(Value::Plane(guess)));
        }
        self.graph.add_factor(Factor::Plane {
            pose,
            plane: self.planes[index],
            errors: None,
            robot_from_plane,
            covariance: Matrix3::from_diagonal(&Vector3::from(PLANE_SIGMAS.map(|s| s * s))),
        });
    }

    fn begin(&mut self) {
        for index in 0..4 {
            self.see(index);
        }
        self.graph.update();
    }

    fn go_on(&mut self, k: usize) {
        self.step();
        for index in k..k + 4 {
            self.see(index);
        }
        if k % 7 == 3 {
            self.see(k / 2);
        }
        self.graph.update();
    }

    fn run(seed: u64, steps: usize) -> Self {
        let mut walk = Self::new(seed);
        walk.begin();
        for k in 1..=steps {
            walk.go_on(k);
        }
        walk
    }
}

/// Information matrix and right-hand side of all factors at the present solution, and the first
/// column of each variable.
fn dense(graph: &Graph) -> (DMatrix<f64>, DVector<f64>, Vec<usize>) {
    let mut first = Vec::new();
    let mut size = 0;
    for index in 0..graph.variable_count() {
        first.push(size);
        size += graph.value(Key(index as u32)).dimension();
    }
    let keys: Vec<Key> = (0..graph.variable_count() as u32).map(Key).collect();
    let values = graph.values_now(&keys);
    let mut information = DMatrix::zeros(size, size);
    let mut side = DVector::zeros(size);
    for held in graph.factors.iter().flatten() {
        let linear = held.factor.linearise(|key| &values[key.0 as usize]);
        let columns: Vec<usize> = held
            .factor
            .keys()
            .iter()
            .flat_map(|key| {
                let start = first[key.0 as usize];
                start..start + values[key.0 as usize].dimension()
            })
            .collect();
        for (i, &row) in columns.iter().enumerate() {
            side[row] -= linear.jacobian.column(i).dot(&linear.residual);
            for (j, &column) in columns.iter().enumerate() {
                information[(row, column)] +=
                    linear.jacobian.column(i).dot(&linear.jacobian.column(j));
            }
        }
    }
    (information, side, first)
}

#[test]
fn the_incremental_solution_is_the_solution_of_the_whole() {
    for seed in 0..6 {
        let walk = Walk::run(seed, 30);
        let (information, side, first) = dense(&walk.graph);
        // A further step of the whole problem would move nothing.
        let step = information.cholesky().unwrap().solve(&side);
        for (index, &at) in first.iter().enumerate() {
            let size = walk.graph.value(Key(index as u32)).dimension();
            let move_by = step.rows(at, size).norm();
            assert!(move_by < 5e-4, "seed {seed}, variable {index}: {move_by}");
        }
    }
}

#[test]
fn covariances_are_those_of_the_dense_inverse() {
    let walk = Walk::run(11, 25);
    let (information, _, first) = dense(&walk.graph);
    let inverse = information.cholesky().unwrap().inverse();
    let keys = [walk.poses[25], walk.planes[3], walk.poses[4], walk.planes[26], walk.planes[12]];
    let ours = walk.graph.covariance(&keys);
    let columns: Vec<usize> = keys
        .iter()
        .flat_map(|key| {
            let start = first[key.0 as usize];
            start..start + walk.graph.value(*key).dimension()
        })
        .collect();
    for (i, &row) in columns.iter().enumerate() {
        for (j, &column) in columns.iter().enumerate() {
            let scale = (inverse[(row, row)] * inverse[(column, column)]).sqrt();
            // Linearised a little differently: old variables keep their points until they move.
            let gap = (ours[(i, j)] - inverse[(row, column)]).abs();
            assert!(gap < 0.01 * scale, "({i}, {j}): {} {}", ours[(i, j)], inverse[(row, column)]);
        }
    }
}

#[test]
fn a_factor_taken_out_again_leaves_no_trace() {
    let mut walk = Walk::run(5, 20);
    let before: Vec<Value> = walk.poses.iter().map(|key| walk.graph.value(*key)).collect();
    let covariance = walk.graph.covariance(&walk.poses[18..20]);
    // A wrong loop: the robot at the end claims to see the first plane where it is not.
    let wrong = walk.graph.add_factor(Factor::Plane {
        pose: walk.poses[20],
        plane: walk.planes[0],
        errors: None,
        robot_from_plane: Isometry3::translation(1.0, 0.0, 0.0),
        covariance: Matrix3::identity() * 1e-6,
    });
    walk.graph.update();
    let moved =
        super::super::perturbation::pose_error(before[20].pose(), &walk.graph.pose(walk.poses[20]));
    assert!(moved.norm() > 0.1, "the wrong factor must have had an effect: {}", moved.norm());
    walk.graph.remove_factor(wrong);
    walk.graph.update();
    for (key, value) in walk.poses.iter().zip(&before) {
        let gap = super::super::perturbation::pose_error(value.pose(), &walk.graph.pose(*key));
        assert!(gap.norm() < 2e-3, "{gap}");
    }
    let again = walk.graph.covariance(&walk.poses[18..20]);
    assert!((again - &covariance).norm() < 0.01 * covariance.norm());
}

#[test]
fn an_ordinary_step_renews_only_what_is_near() {
    let mut walk = Walk::run(8, 30);
    walk.step();
    for index in 31..35 {
        walk.see(index);
    }
    let update = walk.graph.update();
    assert!(update.eliminated < 40, "{} of {}", update.eliminated, walk.graph.variable_count());
    assert_eq!(update.weak_pivots, 0);
}

#[test]
fn what_is_left_to_add_up_far_away_is_there_when_it_is_asked_for() {
    for seed in 0..4 {
        let (mut lazy, mut eager) = (Walk::new(seed), Walk::new(seed));
        (lazy.graph.config.negligible, eager.graph.config.negligible) = (2e-3, 0.0);
        for walk in [&mut lazy, &mut eager] {
            // Linearising anew brings everything up to date.
            walk.graph.config.nonlinear_m = 1.0;
        }
        for walk in [&mut lazy, &mut eager] {
            walk.begin();
        }
        let mut behind = 0.0_f64;
        for step in 1..25 {
            for walk in [&mut lazy, &mut eager] {
                walk.go_on(step);
            }
            let keys: Vec<Key> = (0..lazy.graph.variable_count() as u32).map(Key).collect();
            let gap = |a: &Value, b: &Value| match (a, b) {
                (Value::Pose(a), Value::Pose(b)) | (Value::Plane(a), Value::Plane(b)) => {
                    super::super::perturbation::pose_error(a, b).norm()
                }
                _ => 0.0,
            };
            for (key, now) in keys.iter().zip(lazy.graph.values_now(&keys)) {
                let expected = eager.graph.value(*key);
                // Either is linearised where it was when it moved.
                assert!(gap(&now, &expected) < 2e-4, "seed {seed}, step {step}, {key:?}");
                let known = gap(&lazy.graph.value(*key), &expected);
                behind = behind.max(known);
            }
        }
        assert!(behind > 2e-4 && behind < 2e-2, "{behind}");
    }
}

/// No number of looks at walls, each turned by its noise, is a measurement of how the world lies.
#[test]
fn looking_says_nothing_about_the_attitude_of_the_whole() {
    let mut rng = Pcg64::seed_from_u64(5);
    let mut graph = Graph::new(GraphConfig::default());
    let walls: Vec<Isometry3<f64>> = (0..4)
        .map(|i| {
            let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * f64::from(i) * FRAC_PI_2);
            let upright = UnitQuaternion::from_scaled_axis(Vector3::y() * FRAC_PI_2);
            Isometry3::from_parts((turn * Vector3::new(3.0, 0.0, 0.0)).into(), turn * upright)
        })
        .collect();
    let start = graph.add_variable(Value::Pose(Isometry3::identity()));
    let sigmas = Vector6::new(1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1);
    let covariance = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
    let world_from_robot = Isometry3::identity();
    graph.add_factor(Factor::Prior { pose: start, world_from_robot, covariance });
    let planes: Vec<Key> =
        walls.iter().map(|wall| graph.add_variable(Value::Plane(*wall))).collect();
    let mut pose = start;
    for look in 0..200 {
        for (wall, &plane) in walls.iter().zip(&planes) {
            let error = Vector3::from(drawn(&mut rng, [1e-3, 5e-3, 5e-3]));
            let robot_from_plane = perturbed_plane(wall, &error);
            let covariance = Matrix3::from_diagonal(&Vector3::new(1e-6, 25e-6, 25e-6));
            graph.add_factor(Factor::Plane {
                pose,
                plane,
                errors: None,
                robot_from_plane,
                covariance,
            });
        }
        graph.update();
        if look + 1 < 200 {
            let after = graph.add_variable(Value::Pose(graph.pose(pose)));
            let covariance = Matrix6::identity();
            let before_from_after = Isometry3::identity();
            graph.add_factor(Factor::Between {
                before: pose,
                after,
                before_from_after,
                covariance,
            });
            pose = after;
        }
    }
    let first = graph.covariance(&[start]);
    for i in 3..6 {
        let sigma = first[(i, i)].sqrt();
        assert!((sigma / 0.1 - 1.0).abs() < 1e-6, "{i}: {sigma}");
    }
}

#[test]
fn errors_stay_within_their_covariance() {
    // Normalised squared errors of the last pose over seeded runs: χ² with 6 degrees of freedom.
    let runs = 60;
    let mut sum = 0.0;
    for seed in 100..100 + runs {
        let walk = Walk::run(seed, 15);
        let error = super::super::perturbation::pose_error(
            &walk.graph.pose(walk.poses[15]),
            &walk.truth[15],
        );
        let covariance = walk.graph.covariance(&walk.poses[15..16]);
        let error = DVector::from_column_slice(error.as_slice());
        sum += error.dot(&covariance.cholesky().unwrap().solve(&error));
    }
    let mean = sum / runs as f64;
    // 6 ± 2.6 standard deviations of the mean of 60.
    assert!((4.8..7.2).contains(&mean), "{mean}");
}

#[test]
fn a_graph_reads_back_from_bytes_and_goes_on_alike() {
    let mut walk = Walk::run(21, 12);
    let bytes = postcard::to_stdvec(&walk.graph).unwrap();
    let mut copy: Graph = postcard::from_bytes(&bytes).unwrap();
    walk.step();
    walk.see(13);
    for held in walk.graph.factors[walk.graph.factors.len() - 2..].iter().flatten() {
        if let Factor::Between { before_from_after, .. } = &held.factor {
            let guess = copy.pose(walk.poses[12]) * before_from_after;
            copy.add_variable(Value::Pose(guess));
        }
        copy.add_factor(held.factor.clone());
    }
    walk.graph.update();
    copy.update();
    assert_eq!(walk.graph, copy);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn marginals_stay_symmetric_and_positive(seed in any::<u64>(), steps in 2..20_usize) {
        let walk = Walk::run(seed, steps);
        let mut keys = walk.poses.clone();
        keys.extend(&walk.planes);
        let covariance = walk.graph.covariance(&keys);
        prop_assert_eq!(&covariance, &covariance.transpose());
        let least = nalgebra::SymmetricEigen::new(covariance).eigenvalues.min();
        prop_assert!(least > 0.0, "{}", least);
    }
}
