//! The tree of cliques: which part an update renews, and how.

use super::dense::factorise_leading;
use super::ordering::{Symbolic, eliminate};
use super::{Graph, GraphUpdate, Key, Value};
use nalgebra::{DMatrix, DVector, Point3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Information below which a direction counts as unknown (1 per km² or per (10⁴ rad)²): far below
/// any prior.
const UNKNOWN: f64 = 1e-8;

/// Change of a variable's solution.
type Step = [f64; 6];

/// Part of the second order at which one variable is linearised again that takes others along with it:
/// where neighbours are linearised at turns that differ, a turn of the whole looks as if it were measured.
const WITH_THEM: f64 = 0.01;
/// Part of a negligible correction that a variable must move by to be told as changed.
const WORTH_TELLING: f64 = 0.1;
/// How far away a scan's surfaces lie as a rule, in metres.
const RAY_M: f64 = 5.0;

/// Variables eliminated together, with what they say about one another and about the rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Clique {
    pub(super) frontals: Vec<Key>,
    pub(super) separators: Vec<Key>,
    pub(super) parent: Option<usize>,
    pub(super) children: Vec<usize>,
    /// The factor's columns of the frontal variables: rows of frontals, separators, right-hand side.
    pub(super) columns: DMatrix<f64>,
    /// What remains for the separators: lower triangle of their information, then the right-hand
    /// side as the last row.
    pub(super) remainder: DMatrix<f64>,
    /// The separators' solution with which the frontal variables were solved.
    pub(super) solved_with: Vec<f64>,
}

impl Graph {
    /// Takes in all changes since the last update and solves again, linearising anew what moved.
    pub fn update(&mut self) -> GraphUpdate {
        self.update_finely(1.0)
    }

    /// The same where a measurement may be wrong by a share of what the settings allow only.
    pub fn update_finely(&mut self, share: f64) -> GraphUpdate {
        let nonlinear_m = share * self.config.nonlinear_m;
        let mut done = GraphUpdate::default();
        while !self.stale.is_empty() && done.rounds < self.config.max_rounds {
            done.rounds += 1;
            let stale = std::mem::take(&mut self.stale);
            let roots = self.renew(&stale, &mut done);
            let mut changed = self.solve_down(&roots);
            if changed.iter().any(|key| self.second_order_m(*key) > nonlinear_m) {
                // Neighbours are linearised anew together or not at all, so all must be up to date.
                changed.extend(self.carry_down(0.0));
                let all = (0..self.variables.len() as u32).map(Key);
                let least_m = WITH_THEM * nonlinear_m;
                self.stale = all.filter(|key| self.second_order_m(*key) > least_m).collect();
            }
            done.changed.extend(changed);
            if done.rounds < self.config.max_rounds {
                self.relinearise();
            }
        }
        // What still wants another round keeps its solution; the next update continues.
        self.stale.clear();
        done
    }

    /// What the second order of a variable's step amounts to, in metres. A shift alone has none: a
    /// measurement depends on its variables' places by their difference only. A turn bends what is seen
    /// at the end of a ray, and it turns the directions along which the shift was reckoned.
    fn second_order_m(&self, key: Key) -> f64 {
        let variable = &self.variables[key.0 as usize];
        let norm = |part: &[f64]| part.iter().map(|x| x * x).sum::<f64>().sqrt();
        let delta = variable.delta();
        let (shift_m, turn_rad, arm_m) = match variable.at {
            Value::Pose(_) => (norm(&delta[..3]), norm(&delta[3..]), RAY_M),
            Value::Plane(_) => (delta[0].abs(), norm(&delta[1..]), variable.reach_m),
            Value::Axis(_) => (norm(&delta[..2]), norm(&delta[2..]), RAY_M),
            // Centres enter linearly, and common errors almost: in units of sigma they never matter.
            Value::Centre(_) | Value::Errors(_) => (0.0, 0.0, 0.0),
        };
        turn_rad * (shift_m + 0.5 * turn_rad * arm_m)
    }

    /// Moves the linearisation point of every stale variable to its solution and renews the factors
    /// around it; their other variables become stale too, as their cliques hold those factors.
    fn relinearise(&mut self) {
        let mut factors = BTreeSet::new();
        for key in &self.stale {
            let variable = &mut self.variables[key.0 as usize];
            variable.at = variable.at.perturbed(&variable.delta[..variable.at.dimension()]);
            variable.delta = [0.0; 6];
            factors.extend(variable.factors.iter().copied());
        }
        for id in factors {
            if let Some(held) = self.factors[id.0 as usize].as_mut() {
                held.linear = held.factor.linearise(|key| &self.variables[key.0 as usize].at);
                self.stale.extend(held.factor.keys());
            }
        }
    }

    /// Removes the cliques of the stale variables and all above them, and eliminates their variables
    /// again. Returns the new cliques from the root down.
    fn renew(&mut self, stale: &BTreeSet<Key>, done: &mut GraphUpdate) -> Vec<usize> {
        let (removed, orphans) = self.remove_to_root(stale);
        let mut keys: BTreeSet<Key> =
            removed.iter().flat_map(|clique| clique.frontals.iter().copied()).collect();
        keys.extend(stale.iter().copied().filter(|key| {
            let variable = &self.variables[key.0 as usize];
            variable.clique.is_none() && !variable.factors.is_empty()
        }));
        // A variable that lost its last factor leaves the tree.
        keys.retain(|key| !self.variables[key.0 as usize].factors.is_empty());
        done.eliminated += keys.len();

        let local: BTreeMap<Key, usize> =
            keys.iter().enumerate().map(|(index, key)| (*key, index)).collect();
        let keys: Vec<Key> = keys.into_iter().collect();
        // Factors whose first variable is renewed have all their variables renewed: the others are
        // nearer to the root.
        let mut factors = BTreeSet::new();
        for key in &keys {
            // Every measurement has a pose or a scan's errors among its variables; a floor's own list
            // would name all places from which it was ever seen.
            let variable = &self.variables[key.0 as usize];
            if !matches!(variable.at, Value::Pose(_) | Value::Errors(_)) {
                continue;
            }
            for id in &variable.factors {
                let held = self.factors[id.0 as usize].as_ref().expect("listed factors exist");
                if held.factor.keys().iter().all(|other| local.contains_key(other)) {
                    factors.insert(*id);
                }
            }
        }
        let mut groups: Vec<Vec<usize>> = factors
            .iter()
            .map(|id| {
                let held = self.factors[id.0 as usize].as_ref().expect("listed factors exist");
                held.factor.keys().iter().map(|key| local[key]).collect()
            })
            .collect();
        groups.extend(orphans.iter().map(|&orphan| {
            let clique = self.cliques[orphan].as_ref().expect("orphans exist");
            clique.separators.iter().map(|key| local[key]).collect::<Vec<_>>()
        }));
        let dimensions: Vec<usize> =
            keys.iter().map(|key| self.variables[key.0 as usize].dimension()).collect();
        // What was just touched is likely to be touched next: it goes to the root.
        let group: Vec<u8> = keys.iter().map(|key| u8::from(stale.contains(key))).collect();
        let symbolic = eliminate(&dimensions, &group, &groups);
        let slots = self.place(&symbolic, &keys);
        self.adopt(&orphans, &slots);

        let mut by_clique: Vec<Vec<super::FactorId>> = vec![Vec::new(); symbolic.len()];
        let mut home = vec![0; keys.len()];
        let mut position = vec![0; keys.len()];
        let mut at = 0;
        for (index, clique) in symbolic.iter().enumerate() {
            for &variable in &clique.frontals {
                (home[variable], position[variable]) = (index, at);
                at += 1;
            }
        }
        for (id, group) in factors.iter().zip(&groups) {
            let first = group.iter().copied().min_by_key(|&v| position[v]);
            let first = first.expect("a factor has a variable");
            by_clique[home[first]].push(*id);
        }
        for (index, &slot) in slots.iter().enumerate() {
            done.weak_pivots += self.eliminate_clique(slot, &by_clique[index]);
        }
        slots.into_iter().rev().collect()
    }

    /// Takes out the cliques of `stale` and their ancestors; returns them, and the cliques below
    /// that lost their parent.
    fn remove_to_root(&mut self, stale: &BTreeSet<Key>) -> (Vec<Clique>, Vec<usize>) {
        let mut doomed = BTreeSet::new();
        for key in stale {
            let mut at = self.variables[key.0 as usize].clique;
            while let Some(clique) = at {
                if !doomed.insert(clique) {
                    break;
                }
                at = self.cliques[clique].as_ref().and_then(|clique| clique.parent);
            }
        }
        let mut removed = Vec::new();
        let mut orphans = Vec::new();
        for &slot in &doomed {
            let clique = self.cliques[slot].take().expect("a variable's clique exists");
            for key in &clique.frontals {
                self.variables[key.0 as usize].clique = None;
            }
            orphans.extend(clique.children.iter().copied().filter(|c| !doomed.contains(c)));
            self.free_cliques.push(slot);
            removed.push(clique);
        }
        orphans.sort_unstable();
        (removed, orphans)
    }

    /// Makes empty cliques of the symbolic ones; returns their slots.
    fn place(&mut self, symbolic: &[Symbolic], keys: &[Key]) -> Vec<usize> {
        let slots: Vec<usize> = symbolic
            .iter()
            .map(|_| {
                self.free_cliques.pop().unwrap_or_else(|| {
                    self.cliques.push(None);
                    self.cliques.len() - 1
                })
            })
            .collect();
        for (clique, &slot) in symbolic.iter().zip(&slots) {
            let named = |list: &[usize]| list.iter().map(|&v| keys[v]).collect::<Vec<_>>();
            for &variable in &clique.frontals {
                self.variables[keys[variable].0 as usize].clique = Some(slot);
            }
            self.cliques[slot] = Some(Clique {
                frontals: named(&clique.frontals),
                separators: named(&clique.separators),
                parent: clique.parent.map(|parent| slots[parent]),
                children: Vec::new(),
                columns: DMatrix::zeros(0, 0),
                remainder: DMatrix::zeros(0, 0),
                solved_with: Vec::new(),
            });
        }
        for (clique, &slot) in symbolic.iter().zip(&slots) {
            if let Some(parent) = clique.parent {
                self.clique_mut(slots[parent]).children.push(slot);
            }
        }
        slots
    }

    /// Hangs each orphan below the clique that now eliminates the first of its separators; `slots`
    /// are the renewed cliques in order of elimination, which hold all of them.
    fn adopt(&mut self, orphans: &[usize], slots: &[usize]) {
        let position: BTreeMap<usize, usize> =
            slots.iter().enumerate().map(|(at, &slot)| (slot, at)).collect();
        for &orphan in orphans {
            let parent = self
                .clique(orphan)
                .separators
                .iter()
                .filter_map(|key| self.variables[key.0 as usize].clique)
                .min_by_key(|slot| position.get(slot).copied());
            self.clique_mut(orphan).parent = parent;
            if let Some(parent) = parent {
                self.clique_mut(parent).children.push(orphan);
            }
        }
    }

    pub(super) fn clique(&self, slot: usize) -> &Clique {
        self.cliques[slot].as_ref().expect("slots in the tree are filled")
    }

    fn clique_mut(&mut self, slot: usize) -> &mut Clique {
        self.cliques[slot].as_mut().expect("slots in the tree are filled")
    }

    /// Row of each variable of a clique in its front, and the sizes of both parts.
    pub(super) fn layout(&self, clique: &Clique) -> (BTreeMap<Key, usize>, usize, usize) {
        let mut rows = BTreeMap::new();
        let mut at = 0;
        for key in &clique.frontals {
            rows.insert(*key, at);
            at += self.variables[key.0 as usize].dimension();
        }
        let frontal = at;
        for key in &clique.separators {
            rows.insert(*key, at);
            at += self.variables[key.0 as usize].dimension();
        }
        (rows, frontal, at)
    }

    /// Assembles a clique's front from its factors and its children's remainders and eliminates its
    /// frontal variables. Returns the number of unknown directions.
    fn eliminate_clique(&mut self, slot: usize, factors: &[super::FactorId]) -> usize {
        let clique = self.clique(slot);
        let (rows, frontal, size) = self.layout(clique);
        let mut front = DMatrix::zeros(size + 1, size);
        for id in factors {
            self.assemble_factor(*id, &rows, &mut front);
        }
        for &child in &clique.children {
            self.assemble_child(child, &rows, &mut front);
        }
        let weak = factorise_leading(&mut front, frontal, UNKNOWN);
        let rest = size - frontal;
        // By whole columns: an owned view is copied entry by entry.
        let mut remainder = Vec::with_capacity((rest + 1) * rest);
        for column in front.as_slice().chunks_exact(size + 1).skip(frontal) {
            remainder.extend_from_slice(&column[frontal..]);
        }
        let clique = self.clique_mut(slot);
        clique.remainder = DMatrix::from_vec(rest + 1, rest, remainder);
        clique.columns = front.resize_horizontally(frontal, 0.0);
        weak
    }

    /// Adds `Jᵀ J` and `-Jᵀ r` of a factor to a front's lower triangle and last row.
    fn assemble_factor(
        &self,
        id: super::FactorId,
        rows: &BTreeMap<Key, usize>,
        front: &mut DMatrix<f64>,
    ) {
        let held = self.factors[id.0 as usize].as_ref().expect("listed factors exist");
        let (jacobian, residual) = (&held.linear.jacobian, &held.linear.residual);
        let last = front.nrows() - 1;
        let mut column_of = Vec::with_capacity(jacobian.ncols());
        for key in held.factor.keys() {
            let start = rows[&key];
            column_of.extend(start..start + self.variables[key.0 as usize].dimension());
        }
        for (i, &row) in column_of.iter().enumerate() {
            let left = jacobian.column(i);
            for (j, &column) in column_of.iter().enumerate() {
                if column <= row {
                    front[(row, column)] += left.dot(&jacobian.column(j));
                }
            }
            front[(last, row)] -= left.dot(residual);
        }
    }

    fn assemble_child(&self, child: usize, rows: &BTreeMap<Key, usize>, front: &mut DMatrix<f64>) {
        let child = self.clique(child);
        let mut target = Vec::with_capacity(child.remainder.ncols());
        for key in &child.separators {
            let start = rows[key];
            target.extend(start..start + self.variables[key.0 as usize].dimension());
        }
        let last = front.nrows() - 1;
        for (j, &column) in target.iter().enumerate() {
            for (i, &row) in target.iter().enumerate().skip(j) {
                // The child's order of the separators may differ from the parent's.
                let (low, high) = if row >= column { (row, column) } else { (column, row) };
                front[(low, high)] += child.remainder[(i, j)];
            }
            front[(last, column)] += child.remainder[(target.len(), j)];
        }
    }

    /// Solves from the root down: all of `renewed` (parents first), and below them as far as
    /// corrections matter. Returns the variables whose solution changed.
    fn solve_down(&mut self, renewed: &[usize]) -> BTreeSet<Key> {
        let mut steps = BTreeMap::new();
        for &slot in renewed {
            self.solve_clique(slot, &mut steps);
        }
        self.solved.clear();
        self.solved.extend(renewed);
        let mut changed = self.worth_telling(&steps);
        changed.extend(self.carry_down(self.config.negligible));
        changed
    }

    /// Solves below the cliques that are up to date, as far as their variables have moved by more than
    /// `negligible`. Returns the variables whose solution changed.
    fn carry_down(&mut self, negligible: f64) -> BTreeSet<Key> {
        let below = |slot: &usize| self.clique(*slot).children.iter();
        let mut pending: Vec<usize> = self.solved.iter().flat_map(below).copied().collect();
        pending.retain(|slot| !self.solved.contains(slot));
        let mut steps = BTreeMap::new();
        while let Some(slot) = pending.pop() {
            if self.matters(slot, negligible) {
                pending.extend(self.clique(slot).children.iter().copied());
                self.solve_clique(slot, &mut steps);
                self.solved.insert(slot);
            }
        }
        self.worth_telling(&steps)
    }

    fn worth_telling(&self, steps: &BTreeMap<Key, Step>) -> BTreeSet<Key> {
        let least = WORTH_TELLING * self.config.negligible;
        let told = steps.iter().filter(|(key, step)| self.amount(**key, step) > least);
        told.map(|(key, _)| *key).collect()
    }

    /// What a step of a variable amounts to, in metres or radians: of a plane's tilt what it moves the
    /// plane by where that was seen.
    fn amount(&self, key: Key, step: &Step) -> f64 {
        let variable = &self.variables[key.0 as usize];
        let reach_m = if matches!(variable.at, Value::Plane(_)) { variable.reach_m } else { 1.0 };
        let rest = step[1..].iter().fold(0.0_f64, |most, part| most.max(part.abs()));
        step[0].abs().max(reach_m * rest)
    }

    /// Whether what a clique's separators have moved by since it was solved changes what it holds: trifles
    /// are left to add up. A floor that all rooms share is among the separators of each; that it tilts by
    /// a trifle about one of them is nothing to another through whose place it still goes.
    fn matters(&self, slot: usize, negligible: f64) -> bool {
        let Clique { frontals, separators, solved_with, .. } = self.clique(slot);
        let value = |key: &Key| &self.variables[key.0 as usize].at;
        let place = frontals.iter().chain(separators).find_map(|key| match value(key) {
            Value::Pose(pose) => Some(Point3::from(pose.translation.vector)),
            _ => None,
        });
        let mut solved_with = solved_with.as_slice();
        separators.iter().any(|key| {
            let delta = self.variables[key.0 as usize].delta();
            let (before, rest) = solved_with.split_at(delta.len());
            solved_with = rest;
            let mut step = [0.0; 6];
            for ((step, now), before) in step.iter_mut().zip(delta).zip(before) {
                *step = now - before;
            }
            let amount = match (value(key), place) {
                (Value::Plane(frame), Some(place)) => {
                    let at = frame.inverse_transform_point(&place);
                    let [offset, about_y, about_x, ..] = step;
                    let tilt = RAY_M * about_x.hypot(about_y);
                    (offset + about_x * at.y - about_y * at.x).abs() + tilt
                }
                _ => self.amount(*key, &step),
            };
            amount > negligible
        })
    }

    /// The solution of a clique's frontal variables given that of its separators.
    fn solution(&self, slot: usize, above: &DVector<f64>) -> DVector<f64> {
        let clique = self.clique(slot);
        let frontal = clique.columns.ncols();
        let size = clique.columns.nrows() - 1;
        let mut solution = clique.columns.row(size).transpose();
        if size > frontal {
            solution.gemv_tr(-1.0, &clique.columns.rows(frontal, size - frontal), above, 1.0);
        }
        let solved = clique.columns.rows(0, frontal).tr_solve_lower_triangular_mut(&mut solution);
        debug_assert!(solved, "pivots are positive after elimination");
        solution
    }

    fn solve_clique(&mut self, slot: usize, steps: &mut BTreeMap<Key, Step>) {
        let separators = self.clique(slot).separators.iter();
        let above: Vec<f64> = separators
            .flat_map(|key| self.variables[key.0 as usize].delta().iter().copied())
            .collect();
        let above = DVector::from_vec(above);
        let solution = self.solution(slot, &above);
        let clique = self.clique_mut(slot);
        clique.solved_with = above.data.into();
        let frontals = clique.frontals.clone();
        let mut at = 0;
        for key in frontals {
            let variable = &mut self.variables[key.0 as usize];
            let dimension = variable.at.dimension();
            let new = &solution.as_slice()[at..at + dimension];
            let old = &mut variable.delta[..dimension];
            let mut step = [0.0; 6];
            for ((step, old), new) in step.iter_mut().zip(&*old).zip(new) {
                *step = new - old;
            }
            steps.insert(key, step);
            old.copy_from_slice(new);
            at += dimension;
        }
    }

    /// The present solution of variables to the last digit: what was left to add up is carried down to
    /// them, which costs the cliques between them and those that were solved last.
    pub fn values_now(&self, keys: &[Key]) -> Vec<Value> {
        let mut deltas: BTreeMap<Key, Vec<f64>> = BTreeMap::new();
        let mut done: BTreeSet<usize> = BTreeSet::new();
        for key in keys {
            let mut path = Vec::new();
            let mut at = self.variables[key.0 as usize].clique;
            while let Some(slot) = at.filter(|slot| !self.solved.contains(slot)) {
                if !done.insert(slot) {
                    break;
                }
                path.push(slot);
                at = self.clique(slot).parent;
            }
            for slot in path.into_iter().rev() {
                let clique = self.clique(slot);
                let delta = |key: &Key| match deltas.get(key) {
                    Some(delta) => delta.as_slice(),
                    None => self.variables[key.0 as usize].delta(),
                };
                let above: Vec<f64> =
                    clique.separators.iter().flat_map(|key| delta(key).iter().copied()).collect();
                if above == clique.solved_with {
                    continue;
                }
                let solution = self.solution(slot, &DVector::from_vec(above));
                let mut at = 0;
                for key in &clique.frontals {
                    let dimension = self.variables[key.0 as usize].dimension();
                    deltas.insert(*key, solution.as_slice()[at..at + dimension].to_vec());
                    at += dimension;
                }
            }
        }
        keys.iter()
            .map(|key| match deltas.get(key) {
                Some(delta) => self.variables[key.0 as usize].at.perturbed(delta),
                None => self.value(*key),
            })
            .collect()
    }
}
