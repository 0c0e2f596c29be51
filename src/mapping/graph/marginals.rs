//! Covariances out of the tree.

use super::{Graph, Key};
use nalgebra::DMatrix;
use std::collections::BTreeMap;

impl Graph {
    /// Joint covariance of variables, in the order given, each with its own dimension.
    ///
    /// With information `L Lᵀ` the covariance of a selection E is `Wᵀ W`, `L W = E`: a forward
    /// substitution that begins in the variables' own cliques and rises to the root, so it costs the
    /// paths from those cliques and nothing else. The result is symmetric and not negative whatever
    /// the rounding. A variable outside the tree has an infinite variance; so has its row here a NaN.
    pub fn covariance(&self, keys: &[Key]) -> DMatrix<f64> {
        let dimension = |key: &Key| self.variables[key.0 as usize].dimension();
        let columns: usize = keys.iter().map(dimension).sum();
        let mut covariance = DMatrix::zeros(columns, columns);
        // Right-hand sides of the cliques still to come, deepest first.
        let mut waiting: BTreeMap<(std::cmp::Reverse<usize>, usize), DMatrix<f64>> =
            BTreeMap::new();
        let mut depths: BTreeMap<usize, usize> = BTreeMap::new();
        let mut first = 0;
        let mut outside = Vec::new();
        for key in keys {
            let size = dimension(key);
            match self.variables[key.0 as usize].clique {
                Some(slot) => {
                    let depth = self.cached_depth(slot, &mut depths);
                    let clique = self.clique(slot);
                    let (rows, frontal, _) = self.layout(clique);
                    let side = waiting
                        .entry((std::cmp::Reverse(depth), slot))
                        .or_insert_with(|| DMatrix::zeros(frontal, columns));
                    for i in 0..size {
                        side[(rows[key] + i, first + i)] += 1.0;
                    }
                }
                None => outside.extend(first..first + size),
            }
            first += size;
        }
        while let Some(((_, slot), mut side)) = waiting.pop_first() {
            let clique = self.clique(slot);
            let frontal = clique.columns.ncols();
            let solved = clique.columns.rows(0, frontal).solve_lower_triangular_mut(&mut side);
            debug_assert!(solved, "pivots are positive after elimination");
            covariance.gemm_tr(1.0, &side, &side, 1.0);
            let rest = clique.columns.nrows() - 1 - frontal;
            if rest == 0 {
                continue;
            }
            let below = clique.columns.rows(frontal, rest) * &side;
            self.pass_up(slot, &below, columns, &mut waiting, &mut depths);
        }
        for index in outside {
            covariance.row_mut(index).fill(f64::NAN);
            covariance.column_mut(index).fill(f64::NAN);
        }
        covariance
    }

    /// Subtracts the rows of a clique's separators from the sides of the cliques that eliminate them.
    fn pass_up(
        &self,
        slot: usize,
        below: &DMatrix<f64>,
        columns: usize,
        waiting: &mut BTreeMap<(std::cmp::Reverse<usize>, usize), DMatrix<f64>>,
        depths: &mut BTreeMap<usize, usize>,
    ) {
        let mut at = 0;
        let mut layouts = BTreeMap::new();
        for key in &self.clique(slot).separators {
            let size = self.variables[key.0 as usize].dimension();
            let home = self.variables[key.0 as usize]
                .clique
                .expect("separators are eliminated nearer to the root");
            let (rows, frontal) = layouts.entry(home).or_insert_with(|| {
                let (rows, frontal, _) = self.layout(self.clique(home));
                (rows, frontal)
            });
            let depth = self.cached_depth(home, depths);
            let side = waiting
                .entry((std::cmp::Reverse(depth), home))
                .or_insert_with(|| DMatrix::zeros(*frontal, columns));
            let start = rows[key];
            let mut target = side.rows_mut(start, size);
            target -= below.rows(at, size);
            at += size;
        }
    }

    fn cached_depth(&self, slot: usize, depths: &mut BTreeMap<usize, usize>) -> usize {
        let mut path = Vec::new();
        let mut at = slot;
        let mut depth = loop {
            if let Some(&known) = depths.get(&at) {
                break known;
            }
            path.push(at);
            match self.clique(at).parent {
                Some(parent) => at = parent,
                None => {
                    path.pop();
                    depths.insert(at, 0);
                    break 0;
                }
            }
        };
        for slot in path.into_iter().rev() {
            depth += 1;
            depths.insert(slot, depth);
        }
        depth
    }
}
