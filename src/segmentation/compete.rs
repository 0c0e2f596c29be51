//! Neighbouring surfaces compete for the cells at their borders.
//!
//! Growth decides by whole sticks; here each cell near a border goes to the surface that explains
//! its reading best, among those of its neighbours, with a preference for the label that most
//! neighbours have. Cells that nothing explains are left without a label.

use super::borders::Borders;
use super::field::Field;
use super::fit::Model;
use super::morphology::{inner8, neighbours8};
use nalgebra::Vector3;
use wide::u32x8;

/// Squared error, in units of the noise, at which a cell is better left without a label.
const UNEXPLAINED: f32 = 12.0;
/// Price of each of the eight neighbours that has another label, in the same units.
const DISAGREEMENT: f32 = 1.0;
/// Gain below which a label is not changed, so that ties do not alternate.
const LEAST_GAIN: f32 = 0.25;
/// Rounds at most; each moves a border by one cell.
const ROUNDS: usize = 16;
/// Least cosine of incidence on a curved surface that is believed.
const LEAST_COSINE: f32 = 0.15;

/// A surface as the competition evaluates it.
#[derive(Clone, Copy, Debug)]
pub(super) enum Rival {
    /// A plane `q · p = 1`.
    Plane([f32; 3]),
    /// A sphere, or a cylinder about the axis that the vector gives.
    Round { centre: [f32; 3], axis: [f32; 3], radius_m: f32 },
}

impl Rival {
    pub fn of(model: &Model) -> Self {
        let narrow = |v: &Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        match model {
            Model::Plane { normal, offset_m } => Self::Plane(narrow(&(normal / *offset_m))),
            Model::Sphere { centre, radius_m } => {
                Self::Round { centre: narrow(centre), axis: [0.0; 3], radius_m: *radius_m as f32 }
            }
            Model::Cylinder { foot, axis, radius_m } => {
                Self::Round { centre: narrow(foot), axis: narrow(axis), radius_m: *radius_m as f32 }
            }
        }
    }

    /// Error of a reading relative to its range.
    #[inline]
    fn error(&self, p: [f32; 3], range: f32) -> f32 {
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        match *self {
            Self::Plane(q) => dot(q, p) - 1.0,
            Self::Round { centre, axis, radius_m } => {
                let d = [p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]];
                let height = dot(axis, d);
                let radial: [f32; 3] = std::array::from_fn(|i| d[i] - axis[i] * height);
                let length = dot(radial, radial).sqrt();
                let cosine = (dot(radial, p) / (length * range)).abs().max(LEAST_COSINE);
                (length - radius_m) / (cosine * range)
            }
        }
    }
}

/// Label of a cell without a return while a competition runs.
const NO_RETURN: u32 = u32::MAX;

/// Buffers of the competition.
#[derive(Clone, Debug, Default)]
pub(super) struct Competition {
    borders: Borders,
    /// Cells that are at a border now or were at one before.
    pub border: Vec<u32>,
    at_border: Vec<bool>,
    front: Vec<u32>,
    changes: Vec<(u32, u32)>,
    queued: Vec<bool>,
}

impl Competition {
    /// Settles the borders of `labels`; `rivals` stand at their label.
    pub fn settle(&mut self, field: &Field, rivals: &[Rival], labels: &mut [u32]) {
        self.borders.find(labels, field.lanes, &mut self.border);
        self.at_border.clear();
        self.at_border.resize(field.len(), false);
        for &cell in &self.border {
            self.at_border[cell as usize] = true;
        }
        self.front.clone_from(&self.border);
        self.mark_no_returns(field, labels);
        self.settle_front(field, rivals, labels);
    }

    /// Settles labels of which no more than some, for which `changed` holds, became equal or were
    /// given other rivals since all were last settled.
    pub fn settle_again(
        &mut self,
        field: &Field,
        rivals: &[Rival],
        labels: &mut [u32],
        changed: &[bool],
    ) {
        if self.front.is_empty() && !changed.contains(&true) {
            return;
        }
        self.mark_no_returns(field, labels);
        let has_changed = |label: u32| changed.get(label as usize).is_some_and(|&changed| changed);
        // What the rounds did not come to an end with is in the front still.
        self.front.extend(self.border.iter().filter(|&&cell| {
            has_changed(labels[cell as usize])
                || near_labels(labels, cell as usize, field.lanes).into_iter().any(has_changed)
        }));
        self.settle_front(field, rivals, labels);
    }

    fn mark_no_returns(&self, field: &Field, labels: &mut [u32]) {
        for (label, &range) in labels.iter_mut().zip(&field.range) {
            *label = if range > 0.0 { *label } else { NO_RETURN };
        }
    }

    /// Settles the labels of the cells in the front, and of those whose neighbours change.
    fn settle_front(&mut self, field: &Field, rivals: &[Rival], labels: &mut [u32]) {
        let (width, length) = (field.lanes, field.len());
        // All are down between calls.
        self.queued.resize(length, false);
        for _ in 0..ROUNDS {
            self.changes.clear();
            for &cell in &self.front {
                let own = labels[cell as usize];
                if own != NO_RETURN {
                    let label = best_label(field, rivals, labels, cell as usize);
                    if label != own {
                        self.changes.push((cell, label));
                    }
                }
            }
            if self.changes.is_empty() {
                self.front.clear();
                break;
            }
            for &(cell, label) in &self.changes {
                labels[cell as usize] = label;
            }
            self.front.clear();
            for &(cell, _) in &self.changes {
                for n in neighbours8(cell as usize, width, length) {
                    if !self.queued[n] {
                        self.queued[n] = true;
                        self.front.push(n as u32);
                        if !self.at_border[n] {
                            self.at_border[n] = true;
                            self.border.push(n as u32);
                        }
                    }
                }
            }
            for &cell in &self.front {
                self.queued[cell as usize] = false;
            }
        }
        for label in labels.iter_mut() {
            *label = if *label == NO_RETURN { 0 } else { *label };
        }
    }
}

/// The label at which a cell costs least.
fn best_label(field: &Field, rivals: &[Rival], labels: &[u32], cell: usize) -> u32 {
    let own = labels[cell];
    let near = near_labels(labels, cell, field.lanes);
    let all = u32x8::new(near);
    // Each that is equal adds one less than nothing.
    let count = |label: u32| all.simd_eq(u32x8::splat(label)).reduce_add().wrapping_neg();
    let (around, agree) = (8 - count(NO_RETURN), count(own));
    let p = [field.x[cell], field.y[cell], field.z[cell]];
    let (range, gain) = (field.range[cell], field.gain[cell]);
    let error = |label: u32| {
        if label == 0 {
            UNEXPLAINED
        } else {
            let e = rivals[label as usize].error(p, range) * gain;
            e * e
        }
    };
    let cost = |error: f32, votes: u32| error + DISAGREEMENT * (around - votes) as f32;
    let kept = cost(error(own), agree) - LEAST_GAIN;
    // Another label has an error of zero at best, and at most the votes that are left.
    if kept <= cost(0.0, around - agree) {
        return own;
    }
    let mut best = (kept, own);
    // Zero comes first, whether a neighbour has it or not.
    let mut last = NO_RETURN;
    for label in std::iter::once(0).chain(near) {
        // A label that is tried twice is no better the second time.
        if label == own || label == last || label == NO_RETURN || (label == 0 && last != NO_RETURN)
        {
            continue;
        }
        last = label;
        let cost = cost(error(label), count(label));
        if cost < best.0 {
            best = (cost, label);
        }
    }
    best.1
}

/// The labels around a cell; none where there is no cell or no return.
#[inline]
fn near_labels(labels: &[u32], cell: usize, width: usize) -> [u32; 8] {
    match inner8(cell, width, labels.len()) {
        Some([a, .., d, e, f, _, h]) => {
            let (above, below) = (&labels[a..a + 3], &labels[f..=h]);
            let (left, right) = (labels[d], labels[e]);
            [above[0], above[1], above[2], left, right, below[0], below[1], below[2]]
        }
        None => {
            let mut near = [NO_RETURN; 8];
            for (near, n) in near.iter_mut().zip(neighbours8(cell, width, labels.len())) {
                *near = labels[n];
            }
            near
        }
    }
}
