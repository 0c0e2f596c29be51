//! Neighbouring surfaces compete for the cells at their borders.
//!
//! Growth decides by whole sticks; here each cell near a border goes to the surface that explains
//! its reading best, among those of its neighbours, with a preference for the label that most
//! neighbours have. Cells that nothing explains are left without a label.

use super::borders::Borders;
use super::field::Field;
use super::fit::Model;
use super::morphology::neighbours8;
use super::near::{ALL, Near, neighbour};
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

/// Squared error, in units of the noise, at which a cell is better left without a label.
const UNEXPLAINED: f32 = 12.0;
/// Price of each of the eight neighbours that has another label, in the same units.
const DISAGREEMENT: f32 = 1.0;
/// Gain below which a label is not changed, so that ties do not alternate.
const LEAST_GAIN: f32 = 0.25;
/// Rounds at most; each moves a border by one cell.
const ROUNDS: usize = 16;
/// Most changes of a round of which it is asked whether they undo those of the round before.
const FEW_CHANGES: usize = 16;
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
    #[inline(always)]
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

/// Label of a cell without a return while a chain finds regions.
pub(super) const NO_RETURN: u32 = u32::MAX;

/// Buffers of the competition.
#[derive(Clone, Debug, Default)]
pub(super) struct Competition {
    borders: Borders,
    /// Cells that are at a border now or were at one before.
    pub border: Vec<u32>,
    /// The labels that they had when they were first settled.
    pub before: Vec<u32>,
    front: Vec<u32>,
    /// The plane of each label, and of those without a return; no numbers where there is none.
    planes: Vec<[f32; 3]>,
    changes: Vec<(u32, u32)>,
    /// Changes of the round before, with the labels that they undid.
    undone: Vec<(u32, u32)>,
    queued: Vec<bool>,
}

impl Competition {
    /// Settles the borders of `labels`; `rivals` stand at their label.
    pub fn settle(&mut self, field: &Field, rivals: &[Rival], labels: &mut [u32]) {
        self.borders.find(labels, (field.lanes, rivals.len()), &mut self.border);
        self.before.clear();
        self.before.extend(self.border.iter().map(|&cell| labels[cell as usize]));
        self.planes.clear();
        self.planes.extend(rivals.iter().map(|rival| match rival {
            Rival::Plane(q) => *q,
            Rival::Round { .. } => NO_PLANE,
        }));
        self.planes.push(NO_PLANE);
        self.planes[0] = NO_PLANE;
        let Self { front, border, planes, borders, .. } = self;
        let leads = borders.leads();
        Arch::new().dispatch(ListOpen { field, labels, planes, border, leads, front });
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
        // All are down between calls.
        self.queued.resize(field.len(), false);
        for &cell in &self.front {
            // What the rounds did not come to an end with is in the front still.
            self.queued[cell as usize] = true;
        }
        if changed.contains(&true) {
            let mut count = self.front.len();
            // Which cells are to be settled is hard to foretell, so they are written one over the other.
            self.front.resize(self.border.len() + 1, 0);
            for &cell in &self.border {
                let has_changed = changed.get(labels[cell as usize] as usize);
                if has_changed.is_some_and(|&changed| changed) {
                    let mut look_at = |n: usize| {
                        let is_new = self.borders.is_listed(n) & !self.queued[n];
                        self.queued[n] |= is_new;
                        self.front[count] = n as u32;
                        count += usize::from(is_new);
                    };
                    let (cell, width) = (cell as usize, field.lanes);
                    if field.rim.is_on(cell) {
                        neighbours8(cell, width, field.len()).chain([cell]).for_each(look_at);
                    } else {
                        for first in [cell - width - 1, cell - 1, cell + width - 1] {
                            (first..first + 3).for_each(&mut look_at);
                        }
                    }
                }
            }
            self.front.truncate(count);
        }
        for &cell in &self.front {
            self.queued[cell as usize] = false;
        }
        self.settle_front(field, rivals, labels);
    }

    /// Settles the labels of the cells in the front, and of those whose neighbours change.
    fn settle_front(&mut self, field: &Field, rivals: &[Rival], labels: &mut [u32]) {
        let (width, length) = (field.lanes, field.len());
        self.queued.resize(length, false);
        self.undone.clear();
        let mut left = ROUNDS;
        while left > 0 {
            left -= 1;
            self.changes.clear();
            Arch::new().dispatch(Round {
                field,
                rivals,
                labels,
                front: &self.front,
                changes: &mut self.changes,
            });
            if self.changes.is_empty() {
                self.front.clear();
                break;
            }
            // Cells that undo what they did go on like that, so whole pairs of rounds can be left out.
            let undoes = |change| self.undone.contains(change);
            if self.changes.len() == self.undone.len()
                && self.changes.len() <= FEW_CHANGES
                && self.changes.iter().all(undoes)
            {
                left %= 2;
            }
            self.undone.clear();
            for &(cell, label) in &self.changes {
                let label_now = &mut labels[cell as usize];
                self.undone.push((cell, *label_now));
                *label_now = label;
            }
            self.front.clear();
            for &(cell, _) in &self.changes {
                for n in neighbours8(cell as usize, width, length) {
                    if !self.queued[n] {
                        self.queued[n] = true;
                        self.front.push(n as u32);
                        if !self.borders.is_listed(n) {
                            self.borders.add(n);
                            self.border.push(n as u32);
                            self.before.push(labels[n]);
                        }
                    }
                }
            }
            for &cell in &self.front {
                self.queued[cell as usize] = false;
            }
        }
    }
}

/// Lists the cells at borders that may cost less with another label: one without any error, that all
/// neighbours have which have not its own.
///
/// Most keep theirs. Which ones do is hard to foretell, so they are told from the others without a branch.
struct ListOpen<'a> {
    field: &'a Field,
    labels: &'a [u32],
    planes: &'a [[f32; 3]],
    border: &'a [u32],
    /// Neighbours of each cell at a border with its label less those with another.
    leads: &'a [u8],
    front: &'a mut Vec<u32>,
}

impl WithSimd for ListOpen<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { field, labels, planes, border, leads, front } = self;
        // Of one length, so that one comparison bounds them all.
        let [x, y, z, gain] =
            [&field.x, &field.y, &field.z, &field.gain].map(|array| &array[..labels.len()]);
        let leads = &leads[..labels.len()];
        front.resize(border.len(), 0);
        let mut count = 0;
        for &listed in border {
            front[count] = listed;
            let cell = listed as usize;
            let [qx, qy, qz] = planes[(labels[cell] as usize).min(planes.len() - 1)];
            let e = (qx * x[cell] + qy * y[cell] + qz * z[cell] - 1.0) * gain[cell];
            let is_kept = e * e - LEAST_GAIN <= DISAGREEMENT * f32::from(leads[cell] as i8);
            // What is no number is not below anything.
            count += usize::from(!is_kept);
        }
        front.truncate(count);
    }
}

/// Stands for a plane where there is none: no error from it is small.
const NO_PLANE: [f32; 3] = [f32::NAN; 3];

/// One round; vectors of the processor's own compare the neighbours.
struct Round<'a> {
    field: &'a Field,
    rivals: &'a [Rival],
    labels: &'a [u32],
    front: &'a [u32],
    /// Cells that get another label.
    changes: &'a mut Vec<(u32, u32)>,
}

impl WithSimd for Round<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { field, rivals, labels, front, changes } = self;
        // Of one length, so that one comparison bounds them all.
        let columns = [&field.x, &field.y, &field.z, &field.range, &field.gain]
            .map(|array| &array[..labels.len()]);
        for &cell in front {
            let own = labels[cell as usize];
            if own != NO_RETURN {
                let readings = columns.map(|column| column[cell as usize]);
                let label = best_label(field, rivals, labels, (cell as usize, own), readings);
                if label != own {
                    changes.push((cell, label));
                }
            }
        }
    }
}

/// The label at which a cell costs least.
#[inline(always)]
fn best_label(
    field: &Field,
    rivals: &[Rival],
    labels: &[u32],
    (cell, own): (usize, u32),
    [x, y, z, range, gain]: [f32; 5],
) -> u32 {
    let near = if field.rim.is_on(cell) {
        Near::on_rim(labels, cell, field.lanes, NO_RETURN)
    } else {
        Near::of(labels, cell, field.lanes)
    };
    let returns = ALL & !near.with(NO_RETURN);
    let (around, agree) = (returns.count_ones(), near.with(own));
    let error = |label: u32| {
        if label == 0 {
            UNEXPLAINED
        } else {
            let e = rivals[label as usize].error([x, y, z], range) * gain;
            e * e
        }
    };
    let cost = |error: f32, votes: u32| error + DISAGREEMENT * (around - votes) as f32;
    let kept = cost(error(own), agree.count_ones()) - LEAST_GAIN;
    // Another label has an error of zero at best, and at most the votes that are left.
    let mut others = returns & !agree;
    if kept <= cost(0.0, others.count_ones()) {
        return own;
    }
    let mut best = (kept, own);
    // Zero comes first, whether a neighbour has it or not.
    if own != 0 {
        let without = others & near.with(0);
        others &= !without;
        let cost = cost(UNEXPLAINED, without.count_ones());
        if cost < best.0 {
            best = (cost, 0);
        }
    }
    while others != 0 {
        let label = labels[neighbour(cell, field.lanes, others.trailing_zeros())];
        let votes = others & near.with(label);
        others &= !votes;
        let cost = cost(error(label), votes.count_ones());
        if cost < best.0 {
            best = (cost, label);
        }
    }
    best.1
}
