//! Everything that was measured, as a graph of factors, and its solution as a tree of cliques.
//!
//! Poses, planes and the common errors of scans are variables; odometry, observations and attitudes
//! are factors. The graph keeps the square root of its information matrix as a tree (a multifrontal
//! Cholesky factor): a new scan touches the cliques between its variables and the root, which is what
//! the robot sees now, and nothing else. So an update costs what is visible, not what is mapped, and
//! yet equals the solution of the whole problem. Revisiting a place re-eliminates the path to it,
//! which is what closes a loop; a factor can be taken out again, which is what undoes one.
//!
//! Covariances come out of triangular solves with that factor, so they are symmetric and positive by
//! construction after any number of updates, without Joseph's form. A dense filter in Joseph's form
//! (in the tests) gives the same numbers.
//!
//! The idea of an incrementally maintained tree of cliques is that of Kaess et al., "iSAM2" (IJRR
//! 2012); here the cliques hold Cholesky fronts, and a variable's error is that of
//! [`perturbation`](super::perturbation).

mod curved_rows;
mod dense;
mod factor;
mod marginals;
mod ordering;
#[cfg(test)]
mod tests;
mod tree;

pub use factor::{Factor, Linearised, positive, scaled_errors};

use super::scan_errors::CommonErrors;
use nalgebra::{DMatrix, DVector, Isometry3, Point3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use tree::Clique;

/// Identity of a variable within one graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Key(pub u32);

/// Identity of a factor within one graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FactorId(pub u32);

/// The value of a variable.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Value {
    /// A pose of the robot in the world; its error is `[δt; δr]` in the world frame.
    Pose(Isometry3<f64>),
    /// A plane's frame in the world; its error is (offset, tilt about y, tilt about x) in the frame.
    Plane(Isometry3<f64>),
    /// A cylinder's axis in the world, z along it; its error is (offset along x, offset along y, tilt
    /// towards x, tilt towards y) in the frame.
    Axis(Isometry3<f64>),
    /// A sphere's centre in the world; its error is a shift there.
    Centre(Point3<f64>),
    /// Common errors of a scan, in units of their standard deviations.
    Errors(CommonErrors),
}

/// When a variable is linearised again, and how far corrections are carried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GraphConfig {
    /// What a measurement may be wrong by, in metres, because its variables have moved away from where
    /// it was linearised; beyond it they are linearised again. Valid: above 0.
    pub nonlinear_m: f64,
    /// A correction smaller than this (metres or radians) is not carried further down the tree: far
    /// places wait until as much has added up. Valid: 0 or more.
    pub negligible: f64,
    /// Most rounds of linearisation in one update. Valid: at least 1.
    pub max_rounds: usize,
}

impl Default for GraphConfig {
    fn default() -> Self {
        Self { nonlinear_m: 5e-5, negligible: 2e-5, max_rounds: 6 }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Variable {
    /// Linearisation point.
    at: Value,
    /// Solution relative to it.
    delta: [f64; 6],
    /// Of a plane: how far from its frame's origin it was seen, in metres, at least 1. A tilt moves it
    /// by so much there.
    reach_m: f64,
    /// Clique that eliminates it.
    clique: Option<usize>,
    /// Factors that involve it, in the order of their ids.
    factors: Vec<FactorId>,
}

impl Variable {
    fn dimension(&self) -> usize {
        self.at.dimension()
    }

    fn delta(&self) -> &[f64] {
        &self.delta[..self.dimension()]
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Held {
    factor: Factor,
    linear: Linearised,
}

/// What an update of the graph did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GraphUpdate {
    /// Rounds of linearisation.
    pub rounds: usize,
    /// Variables that were eliminated again, over all rounds.
    pub eliminated: usize,
    /// Variables whose solution changed by a tenth of the negligible amount or more.
    pub changed: BTreeSet<Key>,
    /// Directions about which nothing was known; zero in a well-posed graph.
    pub weak_pivots: usize,
}

/// Variables, factors and the tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Graph {
    config: GraphConfig,
    variables: Vec<Variable>,
    factors: Vec<Option<Held>>,
    cliques: Vec<Option<Clique>>,
    free_cliques: Vec<usize>,
    /// Variables whose cliques are out of date.
    stale: BTreeSet<Key>,
    /// Cliques that the last update solved, from the root down as far as corrections mattered.
    solved: BTreeSet<usize>,
}

impl Graph {
    /// A graph without variables.
    pub fn new(config: GraphConfig) -> Self {
        Self {
            config,
            variables: Vec::new(),
            factors: Vec::new(),
            cliques: Vec::new(),
            free_cliques: Vec::new(),
            stale: BTreeSet::new(),
            solved: BTreeSet::new(),
        }
    }

    /// Adds a variable with a first guess of its value. It must be tied by a factor before the next
    /// [`update`](Self::update).
    pub fn add_variable(&mut self, guess: Value) -> Key {
        let key = Key(self.variables.len() as u32);
        self.variables.push(Variable {
            at: guess,
            delta: [0.0; 6],
            reach_m: 1.0,
            clique: None,
            factors: Vec::new(),
        });
        self.stale.insert(key);
        key
    }

    /// Adds a measurement; [`update`](Self::update) takes it in.
    pub fn add_factor(&mut self, factor: Factor) -> FactorId {
        let id = FactorId(self.factors.len() as u32);
        let linear = factor.linearise(|key| &self.variables[key.0 as usize].at);
        for key in factor.keys() {
            self.variables[key.0 as usize].factors.push(id);
            self.stale.insert(key);
        }
        if let Factor::Plane { pose, plane, robot_from_plane, .. } = &factor {
            let seen_at = (self.pose(*pose) * robot_from_plane).translation.vector;
            let reach_m = (seen_at - self.plane(*plane).translation.vector).norm();
            let variable = &mut self.variables[plane.0 as usize];
            variable.reach_m = variable.reach_m.max(reach_m);
        }
        self.factors.push(Some(Held { factor, linear }));
        id
    }

    /// Takes a measurement out again. A variable that keeps no factor stays where it is and ties
    /// nothing.
    pub fn remove_factor(&mut self, id: FactorId) {
        let Some(held) = self.factors[id.0 as usize].take() else { return };
        for key in held.factor.keys() {
            self.variables[key.0 as usize].factors.retain(|other| *other != id);
            self.stale.insert(key);
        }
    }

    /// A measurement that is in the graph.
    pub fn factor(&self, id: FactorId) -> Option<&Factor> {
        self.factors.get(id.0 as usize)?.as_ref().map(|held| &held.factor)
    }

    /// The measurements that involve a variable.
    pub fn factors_of(&self, key: Key) -> impl Iterator<Item = (FactorId, &Factor)> {
        self.variables[key.0 as usize]
            .factors
            .iter()
            .filter_map(|&id| self.factor(id).map(|factor| (id, factor)))
    }

    /// How a measurement that is not in the graph compares with what is believed: its whitened residual
    /// and the covariance of that, from its own noise and from its variables' joint covariance.
    pub fn innovation(&self, factor: &Factor) -> (DVector<f64>, DMatrix<f64>) {
        let Linearised { jacobian, residual } = self.linearised_now(factor);
        let mut spread = &jacobian * self.covariance(&factor.keys()) * jacobian.transpose();
        for i in 0..spread.nrows() {
            spread[(i, i)] += 1.0;
        }
        (residual, spread)
    }

    /// Number of measurements.
    pub fn factor_count(&self) -> usize {
        self.factors.iter().flatten().count()
    }

    /// Number of variables.
    pub fn variable_count(&self) -> usize {
        self.variables.len()
    }

    /// The present solution of a variable.
    pub fn value(&self, key: Key) -> Value {
        let variable = &self.variables[key.0 as usize];
        variable.at.perturbed(variable.delta())
    }

    /// Where a variable is linearised. What is added beside it should begin beside that, not beside its
    /// solution, or its neighbours would have to be linearised anew.
    pub fn linearised_at(&self, key: Key) -> &Value {
        &self.variables[key.0 as usize].at
    }

    /// The present solution of a pose.
    pub fn pose(&self, key: Key) -> Isometry3<f64> {
        *self.value(key).pose()
    }

    /// The present solution of a plane.
    pub fn plane(&self, key: Key) -> Isometry3<f64> {
        *self.value(key).plane()
    }

    /// Whitened residual of a measurement at the present solution: its squared norm is the squared
    /// Mahalanobis distance under the measurement's own noise.
    pub fn residual(&self, id: FactorId) -> Option<DVector<f64>> {
        Some(self.linearised(id)?.residual)
    }

    /// A measurement linearised at the present solution.
    pub fn linearised(&self, id: FactorId) -> Option<Linearised> {
        Some(self.linearised_now(self.factor(id)?))
    }

    fn linearised_now(&self, factor: &Factor) -> Linearised {
        let values: Vec<(Key, Value)> =
            factor.keys().into_iter().map(|key| (key, self.value(key))).collect();
        let value_of = |key: Key| {
            values
                .iter()
                .find(|(known, _)| *known == key)
                .map(|(_, value)| value)
                .expect("a factor asks for its own keys only")
        };
        factor.linearise(value_of)
    }

    /// Sum of the squared whitened residuals of all measurements.
    pub fn chi_squared(&self) -> f64 {
        (0..self.factors.len())
            .filter_map(|id| self.residual(FactorId(id as u32)))
            .map(|residual| residual.norm_squared())
            .sum()
    }
}
