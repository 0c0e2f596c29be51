//! Covariances out of the tree.

use super::{Graph, Key};
use nalgebra::DMatrix;
use std::collections::BTreeMap;

/// Rows of sides that are multiplied at once.
const GATHERED: usize = 192;

/// A right-hand side on its way to the root: of the selection's columns those that are not zero in a
/// clique. Far from the root these are the few of the variables below it.
struct Side {
    /// Ascending.
    columns: Vec<usize>,
    matrix: DMatrix<f64>,
}

impl Side {
    fn new(rows: usize) -> Self {
        Self { columns: Vec::new(), matrix: DMatrix::zeros(rows, 0) }
    }

    /// Makes room for columns, given in ascending order; returns their places.
    fn widen(&mut self, wanted: impl Iterator<Item = usize> + Clone) -> Vec<usize> {
        let known = |columns: &[usize], column| columns.binary_search(&column).is_ok();
        if !wanted.clone().all(|column| known(&self.columns, column)) {
            let before = std::mem::take(&mut self.columns);
            self.columns = before.iter().copied().chain(wanted.clone()).collect();
            self.columns.sort_unstable();
            self.columns.dedup();
            let mut matrix = DMatrix::zeros(self.matrix.nrows(), self.columns.len());
            for (from, column) in before.iter().enumerate() {
                let to = self.columns.partition_point(|other| other < column);
                matrix.set_column(to, &self.matrix.column(from));
            }
            self.matrix = matrix;
        }
        wanted.map(|column| self.columns.partition_point(|other| *other < column)).collect()
    }

    /// Adds `sideᵀ side` to the lower triangle of the whole.
    fn add_square(&self, whole: &mut DMatrix<f64>) {
        for (j, &column) in self.columns.iter().enumerate() {
            for (i, &row) in self.columns.iter().enumerate().skip(j) {
                whole[(row, column)] += self.matrix.column(i).dot(&self.matrix.column(j));
            }
        }
    }
}

/// The sum of `sideᵀ side` over all sides. Those of many columns, which all are near the root, are gathered and
/// multiplied in one go.
struct Squares {
    whole: DMatrix<f64>,
    /// A column for each row of a side.
    gathered: DMatrix<f64>,
    filled: usize,
}

impl Squares {
    fn new(columns: usize) -> Self {
        Self {
            whole: DMatrix::zeros(columns, columns),
            gathered: DMatrix::zeros(columns, GATHERED),
            filled: 0,
        }
    }

    fn add(&mut self, side: &Side) {
        let rows = side.matrix.nrows();
        if 2 * side.columns.len() < self.whole.ncols() || rows > GATHERED {
            side.add_square(&mut self.whole);
            return;
        }
        if self.filled + rows > GATHERED {
            self.multiply();
        }
        for (&column, values) in side.columns.iter().zip(side.matrix.column_iter()) {
            let mut target = self.gathered.row_mut(column);
            target.columns_mut(self.filled, rows).tr_copy_from(&values);
        }
        self.filled += rows;
    }

    fn multiply(&mut self) {
        let gathered = self.gathered.columns(0, self.filled);
        self.whole.gemm(1.0, &gathered, &gathered.transpose(), 1.0);
        self.gathered.columns_mut(0, self.filled).fill(0.0);
        self.filled = 0;
    }

    /// The sum: of what was added narrowly only the lower triangle is there.
    fn finish(mut self) -> DMatrix<f64> {
        self.multiply();
        self.whole.fill_upper_triangle_with_lower_triangle();
        self.whole
    }
}

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
        let mut squares = Squares::new(columns);
        // Right-hand sides of the cliques still to come, deepest first.
        let mut waiting: BTreeMap<(std::cmp::Reverse<usize>, usize), Side> = BTreeMap::new();
        let mut depths: BTreeMap<usize, usize> = BTreeMap::new();
        let mut first = 0;
        let mut outside = Vec::new();
        for key in keys {
            let size = dimension(key);
            match self.variables[key.0 as usize].clique {
                Some(slot) => {
                    let depth = self.cached_depth(slot, &mut depths);
                    let (rows, frontal, _) = self.layout(self.clique(slot));
                    let side = waiting
                        .entry((std::cmp::Reverse(depth), slot))
                        .or_insert_with(|| Side::new(frontal));
                    let at = side.widen(first..first + size);
                    for (i, at) in at.into_iter().enumerate() {
                        side.matrix[(rows[key] + i, at)] += 1.0;
                    }
                }
                None => outside.extend(first..first + size),
            }
            first += size;
        }
        while let Some(((_, slot), mut side)) = waiting.pop_first() {
            let clique = self.clique(slot);
            let frontal = clique.columns.ncols();
            let solved =
                clique.columns.rows(0, frontal).solve_lower_triangular_mut(&mut side.matrix);
            debug_assert!(solved, "pivots are positive after elimination");
            squares.add(&side);
            let rest = clique.columns.nrows() - 1 - frontal;
            if rest == 0 {
                continue;
            }
            let below = clique.columns.rows(frontal, rest) * &side.matrix;
            self.pass_up(slot, &side.columns, &below, &mut waiting, &mut depths);
        }
        let mut covariance = squares.finish();
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
        columns: &[usize],
        below: &DMatrix<f64>,
        waiting: &mut BTreeMap<(std::cmp::Reverse<usize>, usize), Side>,
        depths: &mut BTreeMap<usize, usize>,
    ) {
        let mut at = 0;
        // Where the separators lie and the columns in the side of the clique that eliminates them.
        let mut homes = BTreeMap::new();
        for key in &self.clique(slot).separators {
            let size = self.variables[key.0 as usize].dimension();
            let home = self.variables[key.0 as usize]
                .clique
                .expect("separators are eliminated nearer to the root");
            let depth = self.cached_depth(home, depths);
            let (rows, places) = homes.entry(home).or_insert_with(|| {
                let (rows, frontal, _) = self.layout(self.clique(home));
                let side = waiting
                    .entry((std::cmp::Reverse(depth), home))
                    .or_insert_with(|| Side::new(frontal));
                (rows, side.widen(columns.iter().copied()))
            });
            let side = waiting.get_mut(&(std::cmp::Reverse(depth), home));
            let side = side.expect("a home was given a side");
            let start = rows[key];
            for (from, to) in places.iter().enumerate() {
                let mut target = side.matrix.column_mut(*to);
                let mut target = target.rows_mut(start, size);
                target -= below.column(from).rows(at, size);
            }
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
