//! Cells beside a region that fit its surface join it.
//!
//! Borders found in a residual image are as thick as its window: without this step every region
//! loses a rim, and surfaces a few cells wide vanish.

use super::field::Field;
use super::fit::Model;
use super::morphology::neighbours8;
use nalgebra::Vector3;

/// Buffers of the absorption.
#[derive(Clone, Debug, Default)]
pub(super) struct Absorber {
    front: Vec<u32>,
    next: Vec<u32>,
    changes: Vec<(u32, u32)>,
}

impl Absorber {
    /// Gives each unlabelled cell that touches a region to the neighbouring region whose model it
    /// fits best, within `gate` standard deviations, ring after ring up to `rings`.
    ///
    /// `models` stand at their label minus one; a region without one takes nothing. Changes of a
    /// ring take effect together, so the order of cells does not matter.
    pub fn absorb(
        &mut self,
        field: &Field,
        models: &[Option<Model>],
        labels: &mut [u32],
        gate: f64,
        rings: usize,
    ) {
        let (width, length) = (field.lanes, field.len());
        self.front.clear();
        self.front.extend((0..length as u32).filter(|&cell| {
            labels[cell as usize] == 0
                && field.is_valid(cell as usize)
                && neighbours8(cell as usize, width, length).any(|n| labels[n] != 0)
        }));
        for _ in 0..rings {
            self.changes.clear();
            for &cell in &self.front {
                let best = best_model(field, models, labels, cell as usize, gate);
                if let Some(label) = best {
                    self.changes.push((cell, label));
                }
            }
            if self.changes.is_empty() {
                break;
            }
            for &(cell, label) in &self.changes {
                labels[cell as usize] = label;
            }
            self.next.clear();
            for &(cell, _) in &self.changes {
                for n in neighbours8(cell as usize, width, length) {
                    if labels[n] == 0 && field.is_valid(n) {
                        self.next.push(n as u32);
                    }
                }
            }
            self.next.sort_unstable();
            self.next.dedup();
            std::mem::swap(&mut self.front, &mut self.next);
        }
    }
}

fn best_model(
    field: &Field,
    models: &[Option<Model>],
    labels: &[u32],
    cell: usize,
    gate: f64,
) -> Option<u32> {
    let p = Vector3::from(field.point(cell));
    let ray = p * f64::from(field.inverse[cell]);
    let sigma = field.sigma_m(cell);
    let mut best = (gate, 0);
    for n in neighbours8(cell, field.lanes, field.len()) {
        let label = labels[n];
        if label == 0 || label == best.1 {
            continue;
        }
        if let Some(model) = &models[label as usize - 1] {
            let error = model.error(&p, &ray, sigma).abs();
            if error < best.0 {
                best = (error, label);
            }
        }
    }
    (best.1 != 0).then_some(best.1)
}
