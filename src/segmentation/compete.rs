//! Neighbouring surfaces compete for the cells at their borders.
//!
//! Growth decides by whole sticks; here each cell near a border goes to the surface that explains
//! its reading best, among those of its neighbours, with a preference for the label that most
//! neighbours have. Cells that nothing explains are left without a label.

use super::field::Field;
use super::fit::Model;
use super::morphology::neighbours8;
use nalgebra::Vector3;

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

/// Buffers of the competition.
#[derive(Clone, Debug, Default)]
pub(super) struct Competition {
    /// One over the noise relative to the range, at each cell.
    weight: Vec<f32>,
    front: Vec<u32>,
    changes: Vec<(u32, u32)>,
    queued: Vec<bool>,
}

impl Competition {
    /// Settles the borders of `labels`; `rivals` stand at their label.
    pub fn settle(&mut self, field: &Field, rivals: &[Rival], labels: &mut [u32]) {
        let (width, length) = (field.lanes, field.len());
        self.weight.clear();
        self.weight.extend(
            field
                .range
                .iter()
                .map(|&r| if r > 0.0 { r / field.noise.sigma_m(f64::from(r)) as f32 } else { 0.0 }),
        );
        self.front.clear();
        self.front.extend((0..length as u32).filter(|&cell| {
            let cell = cell as usize;
            field.is_valid(cell)
                && neighbours8(cell, width, length).any(|n| labels[n] != labels[cell])
        }));
        self.queued.clear();
        self.queued.resize(length, false);
        for _ in 0..ROUNDS {
            self.changes.clear();
            for &cell in &self.front {
                let label = self.best_label(field, rivals, labels, cell as usize);
                if label != labels[cell as usize] {
                    self.changes.push((cell, label));
                }
            }
            if self.changes.is_empty() {
                break;
            }
            for &(cell, label) in &self.changes {
                labels[cell as usize] = label;
            }
            self.front.clear();
            for &(cell, _) in &self.changes {
                for n in neighbours8(cell as usize, width, length) {
                    if field.is_valid(n) && !self.queued[n] {
                        self.queued[n] = true;
                        self.front.push(n as u32);
                    }
                }
            }
            for &cell in &self.front {
                self.queued[cell as usize] = false;
            }
        }
    }

    fn best_label(&self, field: &Field, rivals: &[Rival], labels: &[u32], cell: usize) -> u32 {
        // Distinct labels around the cell and how often they stand there.
        let mut seen = [(0_u32, 0.0_f32); 10];
        seen[1] = (labels[cell], 0.0);
        let mut count = 2;
        let mut around = 0.0;
        for n in neighbours8(cell, field.lanes, field.len()) {
            if !field.is_valid(n) {
                continue;
            }
            around += 1.0;
            let label = labels[n];
            match seen[..count].iter_mut().find(|s| s.0 == label) {
                Some(s) => s.1 += 1.0,
                None => {
                    seen[count] = (label, 1.0);
                    count += 1;
                }
            }
        }
        let cost = |(label, votes): (u32, f32)| {
            let error = if label == 0 {
                UNEXPLAINED
            } else {
                let p = [field.x[cell], field.y[cell], field.z[cell]];
                let e = rivals[label as usize].error(p, field.range[cell]);
                (e * self.weight[cell]).powi(2)
            };
            error + DISAGREEMENT * (around - votes)
        };
        let mut best = (cost(seen[1]) - LEAST_GAIN, seen[1].0);
        for &candidate in &seen[..count] {
            let cost = cost(candidate);
            if cost < best.0 {
                best = (cost, candidate.0);
            }
        }
        best.1
    }
}
