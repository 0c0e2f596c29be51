//! Neighbouring planar regions that one plane explains become one.

use super::field::Field;
use super::moments::Moments;

/// Rise of the error, in units of the noise, that a merge may always cost: three parameters fewer.
const FREE_RISE: f64 = 30.0;
/// Further rise per reading of the smaller region: surfaces and sensors are not perfect.
const RISE_PER_READING: f64 = 0.1;
/// Cells between two regions that are still neighbours.
const REACH: usize = 2;

/// Buffers of the merge.
#[derive(Clone, Debug, Default)]
pub(super) struct Merger {
    moments: Vec<Moments>,
    errors: Vec<f64>,
    parents: Vec<u32>,
    pairs: Vec<(u32, u32)>,
}

impl Merger {
    /// Merges regions of `labels` (1 to `count`), in place; `flat` says which are planes. Pairs are
    /// tried in order of their labels until nothing changes, so the result does not depend on chance.
    pub fn merge(&mut self, field: &Field, labels: &mut [u32], count: usize, flat: &[bool]) {
        self.measure(field, labels, count);
        self.find_pairs(field, labels);
        let mut changed = true;
        while changed {
            changed = false;
            for i in 0..self.pairs.len() {
                let (a, b) = self.pairs[i];
                let (a, b) = (self.root(a), self.root(b));
                if a == b || !flat[a as usize - 1] || !flat[b as usize - 1] {
                    continue;
                }
                let (keep, drop) = (a.min(b) as usize, a.max(b) as usize);
                let sum = self.moments[keep].plus(&self.moments[drop]);
                let error = sum.least_error();
                let fewer = self.moments[keep].n.min(self.moments[drop].n);
                let rise = error - self.errors[keep] - self.errors[drop];
                if rise < FREE_RISE + RISE_PER_READING * fewer {
                    self.moments[keep] = sum;
                    self.errors[keep] = error;
                    self.parents[drop] = keep as u32;
                    changed = true;
                }
            }
        }
        for label in labels.iter_mut() {
            *label = self.root(*label);
        }
    }

    fn measure(&mut self, field: &Field, labels: &[u32], count: usize) {
        self.moments.clear();
        self.moments.resize(count + 1, Moments::default());
        for (cell, &label) in labels.iter().enumerate() {
            if label != 0 {
                let range = f64::from(field.range[cell]);
                let weight = range * range / field.noise.variance(range);
                self.moments[label as usize].add_point(field.point(cell), weight);
            }
        }
        self.errors.clear();
        self.errors.extend(self.moments.iter().map(Moments::least_error));
        self.parents.clear();
        self.parents.extend(0..=count as u32);
    }

    fn find_pairs(&mut self, field: &Field, labels: &[u32]) {
        self.pairs.clear();
        let (steps, lanes) = (field.steps, field.lanes);
        for step in 0..steps {
            for lane in 0..lanes {
                let label = labels[step * lanes + lane];
                if label == 0 {
                    continue;
                }
                for reach in 1..=REACH {
                    for (s, l) in
                        [(step + reach, lane), (step, lane + reach), (step + reach, lane + reach)]
                    {
                        if s < steps && l < lanes {
                            self.push_pair(label, labels[s * lanes + l]);
                        }
                    }
                    if step + reach < steps && lane >= reach {
                        self.push_pair(label, labels[(step + reach) * lanes + lane - reach]);
                    }
                }
            }
        }
        self.pairs.sort_unstable();
        self.pairs.dedup();
    }

    fn push_pair(&mut self, a: u32, b: u32) {
        let pair = (a.min(b), a.max(b));
        if a != b && b != 0 && self.pairs.last() != Some(&pair) {
            self.pairs.push(pair);
        }
    }

    fn root(&self, mut label: u32) -> u32 {
        while self.parents[label as usize] != label {
            label = self.parents[label as usize];
        }
        label
    }
}
