//! Residual of the local least-squares plane, in units of the range noise: the paper's curvature.
//!
//! The paper fits a plane to the eight neighbours of each point in space. Here the fit is made to
//! the inverse range, which for a plane is linear in the ray's direction and so, over a few cells,
//! in the indices: the residual is a fixed linear filter, without an eigenvalue for each cell.
//! What it leaves out is the curvature of the grid itself, below 0.1 mm for 3 x 9 cells of
//! 1° x 0.25° at 3 m.
//!
//! The window is three lanes wide and follows the grid's pitch along: on cells of 4:1 a 3 x 3
//! window would make borders four times thicker one way.

use super::field::Field;

/// Cells that have no usable window: they are borders.
pub(super) const NO_WINDOW: f32 = f32::INFINITY;
/// Share of a window that must be there, nine cells being the paper's: 6 of 9.
const FEWEST_SHARE: f64 = 2.0 / 3.0;

/// The residual of each cell and what it was computed with.
#[derive(Clone, Debug, Default)]
pub(super) struct Residual {
    /// Root mean square of the residual over the window divided by the noise; [`NO_WINDOW`] where a
    /// fit is impossible.
    pub scaled: Vec<f32>,
    /// Cells from the middle of the window to its end along.
    pub reach: usize,
    columns: Vec<[f64; 4]>,
}

impl Residual {
    /// Degrees of freedom that a full window leaves.
    pub fn freedom(&self) -> f64 {
        (3 * (2 * self.reach + 1) - 3) as f64
    }

    /// Computes the residual of every cell.
    pub fn compute(&mut self, field: &Field) {
        let aspect = field.across_rad / field.along_rad;
        self.reach = (aspect.round() as usize).clamp(1, 4);
        self.scaled.clear();
        self.scaled.resize(field.len(), NO_WINDOW);
        let lanes = field.lanes;
        for step in 0..field.steps {
            self.sum_columns(field, step);
            for lane in 0..lanes {
                let cell = step * lanes + lane;
                if !field.is_valid(cell) {
                    continue;
                }
                let square = self
                    .full_window(lane, lanes)
                    .or_else(|| partial_window(field, step, lane, self.reach));
                if let Some(square) = square {
                    let range = f64::from(field.range[cell]);
                    let residual = square.max(0.0).sqrt() * range * range;
                    self.scaled[cell] = (residual / field.sigma_m(cell)) as f32;
                }
            }
        }
    }

    /// For each lane the sums over the window's steps: f, k f, f² and the number of cells.
    fn sum_columns(&mut self, field: &Field, step: usize) {
        let lanes = field.lanes;
        self.columns.clear();
        self.columns.resize(lanes, [0.0; 4]);
        let first = step.saturating_sub(self.reach);
        let last = (step + self.reach).min(field.steps - 1);
        for other in first..=last {
            let k = other as f64 - step as f64;
            let row = &field.inverse[other * lanes..(other + 1) * lanes];
            for (sums, &f) in self.columns.iter_mut().zip(row) {
                let f = f64::from(f);
                sums[0] += f;
                sums[1] += k * f;
                sums[2] += f * f;
                sums[3] += if f > 0.0 { 1.0 } else { 0.0 };
            }
        }
    }

    /// Mean square of the residual where the whole window is there.
    fn full_window(&self, lane: usize, lanes: usize) -> Option<f64> {
        if lane == 0 || lane + 1 >= lanes {
            return None;
        }
        let [left, middle, right] =
            [&self.columns[lane - 1], &self.columns[lane], &self.columns[lane + 1]];
        let height = (2 * self.reach + 1) as f64;
        let n = 3.0 * height;
        if left[3] + middle[3] + right[3] < n {
            return None;
        }
        let sum = left[0] + middle[0] + right[0];
        let along = left[1] + middle[1] + right[1];
        let across = right[0] - left[0];
        let squares = left[2] + middle[2] + right[2];
        let reach = self.reach as f64;
        let along_norm = 3.0 * (reach * (reach + 1.0) * (2.0 * reach + 1.0) / 3.0);
        let left_over =
            squares - sum * sum / n - along * along / along_norm - across * across / (2.0 * height);
        Some(left_over / n)
    }
}

/// Mean square of the residual over the part of a window that is there.
fn partial_window(field: &Field, step: usize, lane: usize, reach: usize) -> Option<f64> {
    let lanes = field.lanes;
    let mut normal = nalgebra::Matrix3::<f64>::zeros();
    let mut right = nalgebra::Vector3::<f64>::zeros();
    let (mut squares, mut n) = (0.0, 0.0);
    let centre = f64::from(field.inverse[step * lanes + lane]);
    for s in step.saturating_sub(reach)..=(step + reach).min(field.steps - 1) {
        for l in lane.saturating_sub(1)..=(lane + 1).min(lanes - 1) {
            let f = f64::from(field.inverse[s * lanes + l]);
            if f > 0.0 {
                let row =
                    nalgebra::Vector3::new(1.0, s as f64 - step as f64, l as f64 - lane as f64);
                normal += row * row.transpose();
                right += row * (f - centre);
                squares += (f - centre) * (f - centre);
                n += 1.0;
            }
        }
    }
    if n < FEWEST_SHARE * (3 * (2 * reach + 1)) as f64 {
        return None;
    }
    let solution = normal.cholesky()?.solve(&right);
    Some((squares - right.dot(&solution)) / n)
}

/// The residual as a grey image: 0 for none, 255 for `white` standard deviations and more, and for
/// cells without a window.
pub(super) fn scale(scaled: &[f32], white: f32, grey: &mut Vec<u8>) {
    grey.clear();
    grey.extend(scaled.iter().map(|s| (255.0 * (s / white).min(1.0)).round() as u8));
}
