//! Labels to regions: each 8-connected component of equal labels is a region of its own.

use super::field::Field;
use super::morphology::neighbours8;
use super::near::{ALL, Near, neighbour};
use std::ops::Range;

/// The components of a label image, as runs of cells.
#[derive(Clone, Debug, Default)]
pub(super) struct Components {
    /// Component of each cell, `NONE` for unlabelled cells.
    pub of_cell: Vec<u32>,
    /// Cells of each component.
    pub sizes: Vec<usize>,
    /// All runs, component by component.
    sorted: Vec<(u32, u32)>,
    /// Start of each component in `sorted`, and the end of the last.
    starts: Vec<usize>,
    runs: Vec<Run>,
    /// The columns of a row in which its runs begin, and its end.
    changes: Vec<u32>,
    /// First run of each row, and the end of the last.
    row_starts: Vec<usize>,
    width: u32,
    /// Where the next run of each component goes.
    filled: Vec<usize>,
}

/// A run of equal labels in a row: `first..end`.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: u32,
    end: u32,
    label: u32,
    /// A run of the same component that comes before, or the run itself; in the end the component.
    parent: u32,
}

/// Cells that are compared with the next ones at a time.
const COMPARED: usize = 8;
/// Cells that are filled at a time.
const FILLED: usize = 16;

/// Fills a range, and some of what comes after it: what that is to hold is written later.
#[inline]
pub(super) fn fill_ahead<T: Copy>(array: &mut [T], range: Range<usize>, value: T) {
    let Range { start: mut at, end } = range;
    while at < end {
        match array[at..].first_chunk_mut::<FILLED>() {
            Some(part) => *part = [value; FILLED],
            None => array[at..end].fill(value),
        }
        at += FILLED;
    }
}

/// Lines of one direction that are counted; a region on more of them is no strip.
const COUNTED_LINES: usize = 8;

/// How many cells of a region are on each line of one direction.
#[derive(Default)]
struct LineCounts {
    lines: [(usize, usize); COUNTED_LINES],
    count: usize,
    many: bool,
}

impl LineCounts {
    fn add(&mut self, line: usize, cells: usize) {
        if self.many {
            return;
        }
        if let Some(known) = self.lines[..self.count].iter_mut().find(|known| known.0 == line) {
            known.1 += cells;
        } else if self.count < COUNTED_LINES {
            self.lines[self.count] = (line, cells);
            self.count += 1;
        } else {
            self.many = true;
        }
    }

    fn beyond_two(&self) -> usize {
        if self.many {
            return usize::MAX;
        }
        let (mut first, mut second, mut all) = (0, 0, 0);
        for &(_, cells) in &self.lines[..self.count] {
            all += cells;
            (first, second) =
                if cells > first { (cells, first) } else { (first, second.max(cells)) };
        }
        all - first - second
    }
}

/// No component.
pub(super) const NONE: u32 = u32::MAX;

impl Components {
    pub fn len(&self) -> usize {
        self.sizes.len()
    }

    /// The runs of successive cells of a component, in order.
    pub fn runs(
        &self,
        component: usize,
    ) -> impl DoubleEndedIterator<Item = Range<usize>> + Clone + '_ {
        let runs = &self.sorted[self.starts[component]..self.starts[component + 1]];
        runs.iter().map(|&(first, end)| first as usize..end as usize)
    }

    /// All runs in order, with their components.
    pub fn all_runs(&self) -> impl Iterator<Item = (Range<usize>, usize)> + '_ {
        self.runs.iter().map(|run| (run.first as usize..run.end as usize, run.parent as usize))
    }

    /// The cells of a component, in order.
    pub fn cells(&self, component: usize) -> impl Iterator<Item = usize> + Clone + '_ {
        self.runs(component).flatten()
    }

    /// Cells of a component that are on neither of the two beams that have most of them; the field's lanes
    /// are the beams unless it is turned.
    pub fn beyond_two_beams(&self, component: usize, transposed: bool) -> usize {
        let width = self.width as usize;
        let mut beams = LineCounts::default();
        for run in self.runs(component) {
            if transposed {
                beams.add(run.start / width, run.len());
            } else {
                run.for_each(|cell| beams.add(cell % width, 1));
            }
            if beams.many {
                break;
            }
        }
        beams.beyond_two()
    }

    /// Finds the components of `labels`; 0 is no label. They are numbered by their first cell, and
    /// list their runs in order.
    ///
    /// Runs of equal labels are joined row by row (union-find), so the cost of a cell is that of
    /// comparing it with the one before it.
    pub fn find(&mut self, labels: &[u32], width: usize) {
        self.find_runs(labels, width);
        self.join_runs();
        self.number_runs();
        self.of_cell.resize(labels.len(), NONE);
        self.sorted.resize(self.runs.len(), (0, 0));
        let mut end = 0;
        for run in &self.runs {
            let at = &mut self.filled[run.parent as usize];
            fill_ahead(&mut self.of_cell, end..run.first as usize, NONE);
            end = run.end as usize;
            fill_ahead(&mut self.of_cell, run.first as usize..end, run.parent);
            self.sorted[*at] = (run.first, run.end);
            *at += 1;
        }
        self.of_cell[end..].fill(NONE);
    }

    /// Lists the runs of equal labels in every row.
    fn find_runs(&mut self, labels: &[u32], width: usize) {
        self.runs.clear();
        self.row_starts.clear();
        self.width = width as u32;
        self.changes.resize(width + 1, 0);
        for (row, labels) in labels.chunks_exact(width.max(1)).enumerate() {
            self.row_starts.push(self.runs.len());
            // Where labels change is hard to foretell, so no branch depends on it but for several at once.
            let mut count = 1;
            let (here, next) = (labels, labels.get(1..).unwrap_or_default());
            let (here_parts, next_parts) = (here.as_chunks::<COMPARED>().0, next.as_chunks().0);
            for (part, (here, next)) in here_parts.iter().zip(next_parts).enumerate() {
                if here != next {
                    for (column, (a, b)) in (part * COMPARED + 1..).zip(here.iter().zip(next)) {
                        self.changes[count] = column as u32;
                        count += usize::from(a != b);
                    }
                }
            }
            for column in next.len() / COMPARED * COMPARED + 1..width {
                self.changes[count] = column as u32;
                count += usize::from(labels[column - 1] != labels[column]);
            }
            self.changes[count] = width as u32;
            let first = (row * width) as u32;
            for ends in self.changes[..=count].windows(2) {
                let label = labels[ends[0] as usize];
                if label != 0 {
                    let parent = self.runs.len() as u32;
                    let (first, end) = (first + ends[0], first + ends[1]);
                    self.runs.push(Run { first, end, label, parent });
                }
            }
        }
        self.row_starts.push(self.runs.len());
    }

    /// Joins runs of one label that touch, corners included, to trees whose root comes first.
    fn join_runs(&mut self) {
        for row in 1..self.row_starts.len().saturating_sub(1) {
            let (mut above, end) = (self.row_starts[row - 1], self.row_starts[row]);
            for here in end..self.row_starts[row + 1] {
                let run = self.runs[here];
                let (low, high) = (run.first - self.width, run.end - self.width);
                while above < end && self.runs[above].end < low {
                    above += 1;
                }
                let mut other = above;
                while other < end && self.runs[other].first <= high {
                    if self.runs[other].label == run.label {
                        let (a, b) = (self.root(here as u32), self.root(other as u32));
                        self.runs[a.max(b) as usize].parent = a.min(b);
                    }
                    other += 1;
                }
            }
        }
    }

    fn root(&mut self, mut run: u32) -> u32 {
        while self.runs[run as usize].parent != run {
            let parent = self.runs[run as usize].parent;
            let above = self.runs[parent as usize].parent;
            self.runs[run as usize].parent = above;
            run = above;
        }
        run
    }

    /// Replaces the parent of each run by the number of its component, and counts cells and runs.
    fn number_runs(&mut self) {
        self.filled.clear();
        self.sizes.clear();
        for k in 0..self.runs.len() {
            let Run { first, end, parent, .. } = self.runs[k];
            // A parent comes before its children, so it has its number already.
            let component = if parent as usize == k {
                self.filled.push(0);
                self.sizes.push(0);
                self.filled.len() as u32 - 1
            } else {
                self.runs[parent as usize].parent
            };
            self.runs[k].parent = component;
            self.filled[component as usize] += 1;
            self.sizes[component as usize] += (end - first) as usize;
        }
        self.starts.clear();
        let mut sum = 0;
        for count in &mut self.filled {
            self.starts.push(sum);
            sum += *count;
            *count = sum - *count;
        }
        self.starts.push(sum);
    }

    /// Whether a cell has no valid neighbour of another component.
    pub fn is_core(&self, cell: usize, field: &Field) -> bool {
        let component = self.of_cell[cell];
        let is_same = |n: usize| self.of_cell[n] == component || !field.is_valid(n);
        if field.rim.is_on(cell) {
            return neighbours8(cell, field.lanes, field.len()).all(is_same);
        }
        let near = Near::of(&self.of_cell, cell, field.lanes);
        // Whatever is of a component has a return.
        let other = near.with(component) | near.with(NONE) != ALL;
        let mut unlabelled = if other { 0 } else { near.with(NONE) };
        if unlabelled == 0 {
            return !other;
        }
        while unlabelled != 0 {
            if field.is_valid(neighbour(cell, field.lanes, unlabelled.trailing_zeros())) {
                return false;
            }
            unlabelled &= unlabelled - 1;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn components_are_those_of_a_flood(
            labels in prop::collection::vec(0..3_u32, 0..160),
            width in 1..12_usize,
        ) {
            let labels = &labels[..labels.len() / width * width];
            let mut components = Components::default();
            components.find(labels, width);
            let mut seen = vec![false; labels.len()];
            let mut next = 0;
            for start in 0..labels.len() {
                if labels[start] == 0 {
                    prop_assert_eq!(components.of_cell[start], NONE);
                }
                if labels[start] == 0 || seen[start] {
                    continue;
                }
                let mut cells = vec![start];
                seen[start] = true;
                let mut at = 0;
                while at < cells.len() {
                    for n in neighbours8(cells[at], width, labels.len()) {
                        if labels[n] == labels[start] && !seen[n] {
                            seen[n] = true;
                            cells.push(n);
                        }
                    }
                    at += 1;
                }
                cells.sort_unstable();
                let found: Vec<usize> = components.cells(next).collect();
                prop_assert_eq!(&found, &cells);
                prop_assert!(cells.iter().all(|&c| components.of_cell[c] == next as u32));
                next += 1;
            }
            prop_assert_eq!(components.len(), next);
        }
    }

    #[test]
    fn a_label_in_two_places_is_two_components() {
        let labels = [1, 0, 1, /**/ 0, 1, 0, /**/ 2, 0, 0, /**/ 0, 0, 2];
        let mut components = Components::default();
        components.find(&labels, 3);
        assert_eq!(components.len(), 3);
        let cells = [0, 1, 2].map(|component| components.cells(component).collect::<Vec<_>>());
        assert_eq!(cells, [vec![0, 2, 4], vec![6], vec![11]]);
        assert_eq!(components.sizes, [3, 1, 1]);
    }
}
