//! How uneven the surface of a fitted plane is, told from the residuals of its fit.
//!
//! Plaster, boards and floors wave by millimetres. Readings on one wave err alike, so a thousand of them
//! may tell a plane no better than ten, and a look at another part of the surface finds another plane. The
//! scatter of single readings does not show it, that is the noise that each has for itself; sums over
//! blocks of readings do.
//!
//! For a plane fitted with the normal matrix `A = Σ A_b`, let `g_b` be what block b leaves in the right
//! side at the solution. Of independent readings `E[g_b g_bᵀ] = A_b - A_b A⁻¹ A_b`, so that the sum of
//! `g_bᵀ A⁻¹ g_b` is known, and nearly χ² distributed. Errors that a block has in common enlarge it (Liang
//! and Zeger's estimator for clusters, as a test). What the means of blocks then scatter by beyond what
//! noise explains is the unevenness.

use super::GATED_VARIANCE;
use super::packed::Packed;
use super::plane::{Axes, prior};
use super::sums::{Columns, PlaneSums, Reference, place};
use nalgebra::{Isometry3, Matrix2, Matrix3, Matrix6, Vector3, Vector6};
use std::ops::Range;

/// Bands of steps, and parts of the lanes in each, that a region is divided into.
const SIDE: usize = 4;
/// How many bands and parts the test takes together: waves may be as long as a block, or longer.
const MERGED: [(usize, usize); 4] = [(1, 1), (2, 1), (1, 2), (2, 2)];
/// Fewest readings of a region that is divided, four in a block.
const FEWEST: usize = 4 * SIDE * SIDE;
/// Deviations of a normal variable that one in ten thousand exceeds. A scan has ten large planes, and an
/// even one that is called uneven is told worse than it is known.
const SURE: f64 = 3.72;
/// Parameters of a plane.
const UNKNOWNS: f64 = 3.0;
/// Share of the blocks' scatter that one bend must explain to be taken for the cause of it.
const BENT_SHARE: f64 = 0.5;

/// What readings are known to have in common on an even surface.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Common {
    /// Readings over an area that tell as much as one whose error is its own.
    pub patch: f64,
    /// Share of the variance across the plane that all readings of a row of the grid have in common.
    pub row_share: f64,
    /// Whether these rows are the field's lanes, not its steps.
    pub rows_are_lanes: bool,
}

/// What blocks of readings tell of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct Unevenness {
    /// Variance of their means about the plane beyond what noise explains, in m²; less than none where
    /// chance has it.
    pub excess_m2: f64,
    /// What noise explains, in m².
    pub noise_m2: f64,
    /// Whether noise does not explain all.
    pub is_sure: bool,
    /// What two rotations of the plane, about y and about x, change by per metre along the frame's x and y:
    /// the part of a vault or of a bending corridor that is flat to the noise is no plane elsewhere. None
    /// where the surface waves rather than bends.
    pub bend: Matrix2<f64>,
}

impl Unevenness {
    /// The best guess of the variance, in m², where surfaces usually have `usual_m2` and vary by about as
    /// much: what was measured, as far as noise let it be measured. What is sure is not guessed down.
    pub fn told_m2(&self, usual_m2: f64) -> f64 {
        let degrees = (SIDE * SIDE) as f64 - UNKNOWNS;
        let error = 2.0 * (usual_m2 + self.noise_m2).powi(2) / degrees;
        let trust = usual_m2 * usual_m2 / (usual_m2 * usual_m2 + error).max(f64::MIN_POSITIVE);
        let guess = (usual_m2 + trust * (self.excess_m2 - usual_m2)).max(0.0);
        if self.is_sure { guess.max(self.excess_m2) } else { guess }
    }
}

/// Divides regions into blocks. The buffers are kept from region to region.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Blocks {
    runs: Vec<Run>,
    sums: Vec<PlaneSums>,
}

/// Successive cells of one step.
#[derive(Clone, Copy, Debug)]
struct Run {
    step: usize,
    /// The first cell of the step.
    row: usize,
    /// First and one beyond the last of its lanes.
    lanes: (usize, usize),
}

impl Run {
    fn len(&self) -> usize {
        self.lanes.1 - self.lanes.0
    }
}

/// The lanes that runs lie between.
fn ends(runs: &[Run]) -> (usize, usize) {
    runs.iter()
        .fold((usize::MAX, 0), |(left, right), run| (left.min(run.lanes.0), right.max(run.lanes.1)))
}

impl Blocks {
    /// The sums over a region, about a plane that is nearly its own; where it has enough readings, those over
    /// its blocks are kept.
    ///
    /// `runs` are its successive cells in a field so many `lanes` wide.
    pub fn sum_up(
        &mut self,
        reference: Reference,
        columns: Columns,
        (runs, lanes): (impl Iterator<Item = Range<usize>> + Clone, usize),
        packed: &mut Packed,
    ) -> PlaneSums {
        self.sums.clear();
        self.runs.clear();
        self.runs.extend(runs.clone().map(|run| {
            let step = run.start / lanes;
            let row = step * lanes;
            Run { step, row, lanes: (run.start - row, run.end - row) }
        }));
        let cells: usize = self.runs.iter().map(Run::len).sum();
        if cells < FEWEST {
            return PlaneSums::over(reference, columns, runs, packed);
        }
        self.divide(reference, columns, cells, packed);
        let mut all = PlaneSums::none(reference);
        self.sums.iter().for_each(|sums| all.add(sums));
        all
    }

    /// How uneven the region is that was summed up last, and whose plane was found to be `grid_from_plane`;
    /// `None` for too few readings.
    pub fn unevenness(
        &self,
        grid_from_plane: &Isometry3<f64>,
        common: &Common,
    ) -> Option<Unevenness> {
        let reference = self.sums.first()?.reference;
        let cells = self.sums.iter().map(|sums| sums.readings).sum();
        let rows = if common.rows_are_lanes {
            let (left, right) = ends(&self.runs);
            right - left
        } else {
            self.runs[self.runs.len() - 1].step - self.runs[0].step + 1
        };
        self.judge(&Axes::of(grid_from_plane, &reference), common, (cells, rows))
    }

    /// Divides the runs into bands of equal numbers of cells, these into parts of equal width, and sums
    /// each up.
    fn divide(
        &mut self,
        reference: Reference,
        columns: Columns,
        cells: usize,
        packed: &mut Packed,
    ) {
        let Self { runs, sums } = self;
        let (mut end, mut taken) = (0, 0);
        let bands: [(&[Run], usize, usize); SIDE] = std::array::from_fn(|band| {
            let begin = end;
            let (mut left, mut right) = (usize::MAX, 0);
            while end < runs.len() {
                let is_same_step = end > begin && runs[end].step == runs[end - 1].step;
                if taken >= (band + 1) * cells / SIDE && !is_same_step {
                    break;
                }
                let lanes = runs[end].lanes;
                (left, right) = (left.min(lanes.0), right.max(lanes.1));
                taken += lanes.1 - lanes.0;
                end += 1;
            }
            (&runs[begin..end], left.min(right), right)
        });
        let blocks = (0..SIDE * SIDE).map(|at| {
            let (runs, left, right) = bands[at / SIDE];
            let cut = |part: usize| left + part * (right - left) / SIDE;
            let (from, to) = (cut(at % SIDE), cut(at % SIDE + 1));
            runs.iter().map(move |run| {
                let (a, b) = (run.lanes.0.max(from), run.lanes.1.min(to));
                run.row + a..run.row + b
            })
        });
        sums.resize(SIDE * SIDE, PlaneSums::none(reference));
        PlaneSums::add_blocks(sums, columns, blocks, packed);
    }

    fn judge(
        &self,
        axes: &Axes,
        common: &Common,
        (cells, rows): (usize, usize),
    ) -> Option<Unevenness> {
        let blocks: [(Matrix3<f64>, Vector3<f64>); SIDE * SIDE] =
            std::array::from_fn(|at| axes.equations(&self.sums[at].totals));
        let all: Matrix3<f64> = blocks.iter().map(|block| block.0).sum();
        let right: Vector3<f64> = blocks.iter().map(|block| block.1).sum();
        let root = (all + prior()).cholesky()?;
        let fit = Fit { covariance: root.inverse(), correction: root.solve(&right) };
        let total = |at: usize| self.sums.iter().map(|sums| sums.totals[at]).sum::<f64>();
        let left = (total(place::WSS) - right.dot(&fit.correction)).max(0.0);
        let free = (total(place::INLIERS) - UNKNOWNS).max(1.0);
        // In units of what is told of single readings, as the plane's covariance is.
        let scatter = (left / (free * GATED_VARIANCE)).max(1.0);
        // Times that a block's variance is as large as if its readings erred each for itself.
        let alike = |parts: usize| {
            let in_row = (cells as f64 / (rows * parts) as f64).max(1.0);
            scatter * common.patch.max(1.0 + common.row_share * (in_row - 1.0))
        };
        let whitened = fit.whitened(&blocks, &root.unpack());
        let is_sure = MERGED.into_iter().any(|(bands, parts)| {
            let beside = SIDE / if common.rows_are_lanes { bands } else { parts };
            let few_rows = if common.row_share > 0.0 {
                UNKNOWNS * (rows as f64 - 1.0).max(1.0)
            } else {
                f64::INFINITY
            };
            is_exceeded(&whitened, (bands, parts), alike(beside), few_rows)
        });
        let (mut square, mut noise, mut count) = (0.0, 0.0, 0.0);
        for (a, g) in blocks.iter().filter(|(a, _)| a[(0, 0)] > 0.0) {
            let (weight, first) = (a[(0, 0)], a.column(0));
            square += ((g[0] - first.dot(&fit.correction)) / weight).powi(2);
            let taken = first.dot(&(fit.covariance * first));
            noise += alike(SIDE) * ((weight - taken) / (weight * weight)).max(0.0);
            count += 1.0;
        }
        let free = (count - UNKNOWNS).max(1.0);
        let bend = if is_sure { fit.bend(&blocks, square) } else { None };
        Some(Unevenness {
            excess_m2: (square - noise) / free,
            noise_m2: noise / free,
            is_sure,
            bend: bend.unwrap_or_default(),
        })
    }
}

/// Of a block, the upper triangle of its share in the fit, row by row, and what it leaves in the right side;
/// both in coordinates in which the fit's covariance is the identity.
type Whitened = [f64; 9];

/// The plane through all blocks, beside the one that their sums were taken about.
struct Fit {
    covariance: Matrix3<f64>,
    correction: Vector3<f64>,
}

impl Fit {
    /// The bend that explains most of what the blocks' means scatter by, the sum of whose squares is given;
    /// `None` where none does.
    fn bend(
        &self,
        blocks: &[(Matrix3<f64>, Vector3<f64>)],
        square_m2: f64,
    ) -> Option<Matrix2<f64>> {
        let means = blocks.iter().filter(|(a, _)| a[(0, 0)] > 0.0).map(|(a, g)| {
            let per_weight = 1.0 / a[(0, 0)];
            // Where a block lies, by what the rotations move it by.
            let (p, q) = (a[(0, 1)] * per_weight, a[(0, 2)] * per_weight);
            let row = Vector6::new(1.0, p, q, 0.5 * p * p, p * q, 0.5 * q * q);
            (row, (g - a * self.correction)[0] * per_weight)
        });
        let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
        for (row, mean) in means.clone() {
            normal += row * row.transpose();
            right += row * mean;
        }
        let shape = normal.cholesky()?.solve(&right);
        let left_m2: f64 = means.map(|(row, mean)| (mean - row.dot(&shape)).powi(2)).sum();
        let bend = Matrix2::new(shape[3], shape[4], shape[4], shape[5]);
        (left_m2 < (1.0 - BENT_SHARE) * square_m2).then_some(bend)
    }

    /// The blocks in coordinates in which the normal matrix `L Lᵀ` is the identity: sums over blocks, and
    /// traces of products with the covariance, are cheap there.
    fn whitened(
        &self,
        blocks: &[(Matrix3<f64>, Vector3<f64>); SIDE * SIDE],
        lower: &Matrix3<f64>,
    ) -> [Whitened; SIDE * SIDE] {
        // The inverse of L, row by row.
        let (p, r, u) = (1.0 / lower.m11, 1.0 / lower.m22, 1.0 / lower.m33);
        let q = -lower.m21 * p * r;
        let (s, t) = (-(lower.m31 * p + lower.m32 * q) * u, -lower.m32 * r * u);
        let whiten = |v: [f64; 3]| [p * v[0], q * v[0] + r * v[1], s * v[0] + t * v[1] + u * v[2]];
        std::array::from_fn(|at| {
            let (a, g) = &blocks[at];
            let columns = [a.column(0), a.column(1), a.column(2)];
            // The columns of L⁻¹ A, of which the rows of L⁻¹ A L⁻ᵀ are made.
            let [x, y, z] = columns.map(|column| whiten([column[0], column[1], column[2]]));
            let [xx, xy, xz] = whiten([x[0], y[0], z[0]]);
            let [_, yy, yz] = whiten([x[1], y[1], z[1]]);
            let [_, _, zz] = whiten([x[2], y[2], z[2]]);
            let left = g - a * self.correction;
            let [gx, gy, gz] = whiten(left.into());
            [xx, xy, xz, yy, yz, zz, gx, gy, gz]
        })
    }
}

/// Whether so many bands and parts taken together leave more in the right side than independent readings,
/// of which so many are worth one, explain; no more degrees of freedom are believed than so many.
fn is_exceeded(
    blocks: &[Whitened; SIDE * SIDE],
    (bands, parts): (usize, usize),
    alike: f64,
    most_degrees: f64,
) -> bool {
    let mut merged = [[0.0; 9]; SIDE * SIDE];
    let across = SIDE / parts;
    for (at, block) in blocks.iter().enumerate() {
        let sums = &mut merged[at / SIDE / bands * across + at % SIDE / parts];
        for (sum, value) in sums.iter_mut().zip(block) {
            *sum += value;
        }
    }
    let merged = &merged[..SIDE / bands * across];
    let (mut seen, mut free) = (0.0, 0.0);
    for &[xx, xy, xz, yy, yz, zz, x, y, z] in merged {
        seen += x * x + y * y + z * z;
        let taken = xx * xx + yy * yy + zz * zz + 2.0 * (xy * xy + xz * xz + yz * yz);
        free += xx + yy + zz - taken;
    }
    // Where the fit takes nearly all, nothing is told. What is sure exceeds what is explained, whatever the
    // degrees of freedom, which take more to reckon.
    if !(free > 1.0 && seen > alike * free) {
        return false;
    }
    let squares = merged.iter().map(|&[xx, xy, xz, yy, yz, zz, ..]| {
        let share = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        (share - share * share).norm_squared()
    });
    // A sum of squares of normal variables is nearly χ² of so many degrees (Satterthwaite).
    let degrees = free * free / squares.sum::<f64>();
    seen > free * alike * least_sure(degrees.min(most_degrees))
}

/// What a χ² variable, divided by its degrees of freedom, exceeds once in ten thousand times (Wilson and
/// Hilferty).
fn least_sure(degrees: f64) -> f64 {
    let variance = 2.0 / (9.0 * degrees);
    (1.0 - variance + SURE * variance.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_of_the_test_is_the_quantile_of_the_tables() {
        for (degrees, quantile) in [(3.0, 21.108), (7.0, 29.878), (25.0, 60.140), (43.0, 86.281)] {
            let ratio = least_sure(degrees) * degrees / quantile;
            // The approximation errs to the careful side, by 3.5 % at three degrees.
            assert!((1.0..1.04).contains(&ratio), "{degrees}: {ratio}");
        }
    }

    #[test]
    fn what_is_measured_badly_is_what_is_usual_and_what_is_sure_is_kept() {
        let of = |excess_m2: f64, noise_m2: f64, is_sure: bool| Unevenness {
            excess_m2,
            noise_m2,
            is_sure,
            bend: Matrix2::zeros(),
        };
        assert_eq!(of(-1e-6, 1e-6, false).told_m2(0.0), 0.0);
        assert_eq!(of(4e-6, 1e-8, true).told_m2(0.0), 4e-6);
        assert!((of(-1e-4, 1e-3, false).told_m2(1e-6) - 1e-6).abs() < 1e-8);
        assert!(of(0.0, 1e-9, false).told_m2(1e-6) < 2e-7);
    }
}
