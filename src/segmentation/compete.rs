//! Neighbouring surfaces compete for the cells at their borders.
//!
//! Growth decides by whole sticks; here each cell near a border goes to the surface that explains
//! its reading best, among those of its neighbours, with a preference for the label that most
//! neighbours have. Cells that nothing explains are left without a label.

use super::field::Field;
use super::morphology::neighbours8;

/// Squared error, in units of the noise, at which a cell is better left without a label.
const UNEXPLAINED: f32 = 12.0;
/// Price of each of the eight neighbours that has another label, in the same units.
const DISAGREEMENT: f32 = 1.0;
/// Gain below which a label is not changed, so that ties do not alternate.
const LEAST_GAIN: f32 = 0.25;
/// Rounds at most; each moves a border by one cell.
const ROUNDS: usize = 16;

/// A plane as the competition evaluates it: `q · p = 1`.
pub(super) type FlatPlane = [f32; 3];

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
    /// Settles the borders of `labels`; `planes` stand at their label.
    pub fn settle(&mut self, field: &Field, planes: &[FlatPlane], labels: &mut [u32]) {
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
                let label = self.best_label(field, planes, labels, cell as usize);
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

    fn best_label(&self, field: &Field, planes: &[FlatPlane], labels: &[u32], cell: usize) -> u32 {
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
                let q = planes[label as usize];
                let e = q[0] * field.x[cell] + q[1] * field.y[cell] + q[2] * field.z[cell] - 1.0;
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
