//! The paper's posterior check: regions that leaked into one another are parted where the angle
//! between neighbouring local normals is too large.
//!
//! A normal from 3 x 3 cells is mostly noise (18° down the rows at 3 m, for 10 mm and 0.25°), so the
//! normals are taken from windows of five lanes and as much in the other direction, at every cell
//! across and at every such pitch along. They come from the gradient of the inverse range.

use super::field::Field;
use nalgebra::{Matrix3, Vector3};

/// Lanes from the middle of a window to its side.
const REACH: usize = 2;
/// Smallest part that a split leaves standing, in nodes; smaller ones are noise at a border.
const FEWEST_NODES: usize = 6;

/// Sums over one lane of a window: n, k, k², f, k f.
type LaneSums = [f64; 5];

/// Buffers of the split.
#[derive(Clone, Debug, Default)]
pub(super) struct Splitter {
    sums: Vec<LaneSums>,
    normals: Vec<Vector3<f64>>,
    labels: Vec<u32>,
    parts: Vec<u32>,
    stack: Vec<u32>,
    /// How many regions were parted in the last run.
    pub parted: usize,
}

impl Splitter {
    /// Splits `labels` in place; new labels continue after `last`, and the new last one is returned.
    /// Cells of parts that are too small lose their label.
    pub fn split(&mut self, field: &Field, labels: &mut [u32], last: u32, angle_rad: f64) -> u32 {
        let stride = ((field.across_rad / field.along_rad).round() as usize).clamp(1, 8);
        let rows = field.steps.div_ceil(stride);
        self.find_normals(field, labels, stride, rows);
        let next = self.link(rows, field.lanes, last, angle_rad.cos());
        for (cell, label) in labels.iter_mut().enumerate() {
            if *label == 0 {
                continue;
            }
            let (step, lane) = (cell / field.lanes, cell % field.lanes);
            let node = (step / stride) * field.lanes + lane;
            // A cell whose node belongs to another region keeps its label: it is at a border.
            if self.labels[node] == *label {
                *label = self.parts[node];
            }
        }
        next
    }

    fn find_normals(&mut self, field: &Field, labels: &[u32], stride: usize, rows: usize) {
        let lanes = field.lanes;
        self.normals.clear();
        self.normals.resize(rows * lanes, Vector3::zeros());
        self.labels.clear();
        self.labels.resize(rows * lanes, 0);
        let half = REACH * stride;
        for row in 0..rows {
            let step = row * stride;
            self.sums.clear();
            for lane in 0..lanes {
                let label = labels[step * lanes + lane];
                self.labels[row * lanes + lane] = label;
                let mut sums = [0.0; 5];
                if label != 0 {
                    for s in step.saturating_sub(half)..=(step + half).min(field.steps - 1) {
                        let cell = s * lanes + lane;
                        if labels[cell] == label {
                            let (k, f) = (s as f64 - step as f64, f64::from(field.inverse[cell]));
                            for (sum, term) in sums.iter_mut().zip([1.0, k, k * k, f, k * f]) {
                                *sum += term;
                            }
                        }
                    }
                }
                self.sums.push(sums);
            }
            for lane in 0..lanes {
                if self.labels[row * lanes + lane] != 0 {
                    self.normals[row * lanes + lane] =
                        self.normal(field, row, step, lane, stride).unwrap_or_default();
                }
            }
        }
    }

    /// Unit normal at a node, or `None` where too little of its window is there.
    fn normal(
        &self,
        field: &Field,
        row: usize,
        step: usize,
        lane: usize,
        stride: usize,
    ) -> Option<Vector3<f64>> {
        let lanes = field.lanes;
        let label = self.labels[row * lanes + lane];
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Vector3::<f64>::zeros();
        for other in lane.saturating_sub(REACH)..=(lane + REACH).min(lanes - 1) {
            if self.labels[row * lanes + other] != label {
                continue;
            }
            let l = other as f64 - lane as f64;
            let [n, k, kk, f, kf] = self.sums[other];
            normal += Matrix3::new(n, k, l * n, k, kk, l * k, l * n, l * k, l * l * n);
            right += Vector3::new(f, kf, l * f);
        }
        let [f, along, across] = normal.cholesky()?.solve(&right).into();
        let ray = |s: usize, l: usize| {
            let cell = s * lanes + l;
            field
                .is_valid(cell)
                .then(|| Vector3::from(field.point(cell)) * f64::from(field.inverse[cell]))
        };
        let middle = ray(step, lane)?;
        let along_ray = if step + stride < field.steps {
            (ray(step + stride, lane)? - middle) / stride as f64
        } else {
            (middle - ray(step.checked_sub(stride)?, lane)?) / stride as f64
        };
        let across_ray = if lane + 1 < lanes {
            ray(step, lane + 1)? - middle
        } else {
            middle - ray(step, lane.checked_sub(1)?)?
        };
        // q with q·u = f and the same for both derivatives; its direction is the normal's.
        let rows = Matrix3::from_rows(&[middle, along_ray, across_ray].map(|v| v.transpose()));
        (rows.try_inverse()? * Vector3::new(f, along, across)).try_normalize(1e-12)
    }

    /// Numbers the parts of nodes linked by like normals; small parts get 0.
    fn link(&mut self, rows: usize, lanes: usize, last: u32, least_cosine: f64) -> u32 {
        self.parts.clear();
        self.parts.resize(rows * lanes, 0);
        self.parted = 0;
        let mut next = last;
        let mut seen = std::mem::take(&mut self.stack);
        for start in 0..rows * lanes {
            if self.labels[start] == 0 || self.parts[start] != 0 {
                continue;
            }
            next += 1;
            seen.clear();
            seen.push(start as u32);
            self.parts[start] = next;
            let mut at = 0;
            while at < seen.len() {
                let node = seen[at] as usize;
                at += 1;
                let lane = node % lanes;
                let sides = [
                    (lane > 0).then(|| node - 1),
                    (lane + 1 < lanes).then(|| node + 1),
                    node.checked_sub(lanes),
                    Some(node + lanes).filter(|&below| below < rows * lanes),
                ];
                for other in sides.into_iter().flatten() {
                    if self.parts[other] == 0
                        && self.labels[other] == self.labels[node]
                        && self.normals[other].dot(&self.normals[node]) > least_cosine
                    {
                        self.parts[other] = next;
                        seen.push(other as u32);
                    }
                }
            }
            if seen.len() < FEWEST_NODES {
                // Marked so that it is not started again; cleared below.
                for &node in &seen {
                    self.parts[node as usize] = u32::MAX;
                }
                next -= 1;
            }
        }
        self.stack = seen;
        for part in &mut self.parts {
            if *part == u32::MAX {
                *part = 0;
            }
        }
        self.parted = (next - last) as usize;
        next
    }
}
