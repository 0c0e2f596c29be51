//! Neighbouring planar regions that one plane explains become one.

use super::moments::Moments;
use super::morphology::neighbours8;
use super::near::Rim;
use super::noise::ReadingErrors;
use super::pairs::{Touching, sort};
use pulp::{Arch, Simd, WithSimd};

/// Rise of the error, in units of the noise, that a merge may always cost: three parameters and an
/// outline fewer.
const FREE_RISE: f64 = 25.0;
/// Further rise per reading of the smaller region: surfaces and sensors are not perfect.
const RISE_PER_READING: f64 = 0.1;

/// Merges regions, which are numbered from 1.
#[derive(Clone, Debug, Default)]
pub(super) struct Merger {
    /// Regions that touch, each pair once, the smaller number first.
    pub pairs: Vec<(u32, u32)>,
    touching: Touching,
    parents: Vec<u32>,
    costs: Vec<f64>,
    /// Round in which each region last took another in.
    grew: Vec<u32>,
    /// Labels that are another's now, and whose.
    moved: Vec<(u32, u32)>,
}

/// Replacements for which all labels are gone through once for each: more are looked up.
const FEW_MOVED: usize = 12;

/// Labels that are replaced at a time.
const REPLACED: usize = 32;

/// Replaces labels, many at a time.
struct Replace<'a> {
    labels: &'a mut [u32],
    moved: &'a [(u32, u32)],
}

impl WithSimd for Replace<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // All of them for some labels, then for others: labels are loaded once.
        let (parts, rest) = self.labels.as_chunks_mut::<REPLACED>();
        for part in parts {
            for &(from, to) in self.moved {
                for label in &mut *part {
                    *label = if *label == from { to } else { *label };
                }
            }
        }
        for label in rest {
            for &(from, to) in self.moved {
                *label = if *label == from { to } else { *label };
            }
        }
    }
}

impl Merger {
    /// Lists the pairs of labels that touch in an image, corners included; all are below `count`.
    /// `borders` holds the cells at which labels meet, `rim` those at the image's.
    pub fn pairs_of_labels(
        &mut self,
        labels: &[u32],
        count: usize,
        width: usize,
        rim: &Rim,
        borders: &[u32],
    ) {
        self.touching.start(count);
        for &cell in borders {
            let cell = cell as usize;
            let label = labels[cell];
            // The neighbours before it have looked at it.
            if rim.is_on(cell) {
                let near = neighbours8(cell, width, labels.len()).filter(|&n| n > cell);
                self.touching.add(label, near.map(|n| labels[n]));
            } else {
                let below = &labels[cell + width - 1..cell + width + 2];
                let others = [labels[cell + 1], below[0], below[1], below[2]];
                self.touching.add(label, others.into_iter());
            }
        }
        self.touching.list(&mut self.pairs);
    }

    /// Lists pairs of regions below `count` that `find` finds to touch.
    pub fn list_pairs(&mut self, count: usize, find: impl FnOnce(&mut Touching)) {
        self.touching.start(count);
        find(&mut self.touching);
        self.touching.list(&mut self.pairs);
    }

    /// Merges the listed pairs as long as one plane explains both of two regions, in the order of
    /// their numbers; `moments` of a region that is gone are left as they were. Only regions for
    /// which `flat` holds take part. Afterwards the pairs are those of what is left.
    pub fn merge(
        &mut self,
        moments: &mut [Moments],
        errors: &ReadingErrors,
        flat: impl Fn(u32) -> bool,
    ) {
        self.parents.clear();
        self.parents.extend(0..moments.len() as u32);
        self.costs.clear();
        self.costs.extend(moments.iter().map(|m| m.cost(&m.solve())));
        self.grew.clear();
        self.grew.resize(moments.len(), 0);
        let mut round = 0;
        let mut changed = true;
        while changed {
            changed = false;
            round += 1;
            for i in 0..self.pairs.len() {
                let (a, b) = self.pairs[i];
                let (a, b) = (self.root(a), self.root(b));
                // A pair that did not merge will not, until one of the two has grown.
                let latest = self.grew[a as usize].max(self.grew[b as usize]);
                if a == b || (round > 1 && latest + 1 < round) || !flat(a) || !flat(b) {
                    continue;
                }
                let (keep, drop) = (a.min(b) as usize, a.max(b) as usize);
                let sum = moments[keep].plus(&moments[drop]);
                let cost = sum.cost(&sum.solve());
                let fewer = moments[keep].n.min(moments[drop].n);
                let rise = cost - self.costs[keep] - self.costs[drop];
                if rise < errors.price(FREE_RISE, fewer) + RISE_PER_READING * fewer {
                    moments[keep] = sum;
                    self.costs[keep] = cost;
                    self.parents[drop] = keep as u32;
                    self.grew[keep] = round;
                    changed = true;
                }
            }
        }
        for i in 0..self.pairs.len() {
            let (a, b) = self.pairs[i];
            let (a, b) = (self.root(a), self.root(b));
            self.pairs[i] = (a.min(b), a.max(b));
        }
        self.pairs.retain(|&(a, b)| a != b);
        sort(&mut self.pairs);
    }

    /// Replaces labels by those of the regions that theirs have become part of.
    pub fn follow(&mut self, labels: &mut [u32]) {
        self.moved.clear();
        for label in 0..self.parents.len() {
            // A parent has a smaller number, so it is a root already.
            let root = self.parents[self.parents[label] as usize];
            self.parents[label] = root;
            if root != label as u32 {
                self.moved.push((label as u32, root));
            }
        }
        if self.moved.len() <= FEW_MOVED {
            Arch::new().dispatch(Replace { labels, moved: &self.moved });
        } else {
            for label in labels {
                *label = self.parents.get(*label as usize).copied().unwrap_or(*label);
            }
        }
    }

    /// Whether a region has taken others in.
    pub fn has_grown(&self, label: u32) -> bool {
        self.grew[label as usize] > 0
    }

    /// The region that a region has become part of.
    pub fn root(&self, mut label: u32) -> u32 {
        while self.parents[label as usize] != label {
            label = self.parents[label as usize];
        }
        label
    }
}
