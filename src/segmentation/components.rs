//! Labels to regions: each 8-connected component of equal labels is a region of its own.

use super::around::{Around, Code, Label, WORD, bits, list_bits, words};
use super::compete::NO_RETURN;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;
use wide::u8x16;

/// The components of a label image, as runs of cells.
#[derive(Clone, Debug, Default)]
pub(super) struct Components {
    /// Cells of each component.
    pub sizes: Vec<usize>,
    /// Cells of each component that have a neighbour with a return which is none of its cells.
    pub border_cells: Vec<usize>,
    /// All runs, component by component.
    sorted: Vec<(u32, u32)>,
    /// Start of each component in `sorted`, and the end of the last.
    starts: Vec<usize>,
    runs: Vec<Run>,
    around: Around,
    /// What [`Change`] tells of each cell.
    codes: Vec<u8>,
    /// Which of the cells of a word are at a border, and how many were before.
    at_border: Vec<(u64, u32)>,
    /// The last cells of all runs and gaps.
    lasts: Vec<u32>,
    /// First run of each row, and the end of the last.
    row_starts: Vec<usize>,
    width: usize,
    /// Where the next run of each component goes.
    filled: Vec<usize>,
}

/// A run of equal labels in a row: `first..end`.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: u32,
    end: u32,
    label: u32,
    /// Its cells at a border.
    border: u32,
    /// A run of the same component that comes before, or the run itself; in the end the component.
    parent: u32,
}

/// Whether a cell is at the border of a region, and whether its label differs from that of the next cell.
struct Change;

/// The bit of cells at a border.
pub(super) const BORDER: u8 = 1;
/// The bit that is brought together for many cells.
const LAST: u8 = 1 << 7;

impl Code for Change {
    #[inline(always)]
    fn of<T: Label>(own: T, right: T, same: T, none: T) -> u8 {
        let is_region = (own != T::from(false)) & (own != T::narrow(NO_RETURN));
        let border = is_region & (same + none != T::from(8));
        u8::from(border) * BORDER + u8::from(own != right) * LAST
    }
}

/// Cells that are filled at a time.
const FILLED: usize = 32;

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

/// How many cells of a region are on each line of one direction, of which there are no more than that.
#[derive(Default)]
struct LineCounts {
    lines: [(usize, usize); COUNTED_LINES],
    count: usize,
}

impl LineCounts {
    fn add(&mut self, line: usize, cells: usize) {
        if let Some(known) = self.lines[..self.count].iter_mut().find(|known| known.0 == line) {
            known.1 += cells;
        } else {
            self.lines[self.count] = (line, cells);
            self.count += 1;
        }
    }

    fn beyond_two(&self) -> usize {
        let (mut first, mut second, mut all) = (0, 0, 0);
        for &(_, cells) in &self.lines[..self.count] {
            all += cells;
            (first, second) =
                if cells > first { (cells, first) } else { (first, second.max(cells)) };
        }
        all - first - second
    }
}

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

    /// As many runs of a component come before this one as after it, or one more.
    pub fn middle_run(&self, component: usize) -> Range<usize> {
        let [start, end] = [self.starts[component], self.starts[component + 1]];
        let (first, end) = self.sorted[start + (end - start) / 2];
        first as usize..end as usize
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
        let width = self.width;
        let mut beams = LineCounts::default();
        // A component is on all lines from its first to its last one, and nearly all are on many.
        let (mut first, mut last) = (usize::MAX, 0);
        for run in self.runs(component) {
            let lines = if transposed {
                [run.start / width, run.start / width]
            } else {
                [run.start % width, (run.end - 1) % width]
            };
            (first, last) = (first.min(lines[0]), last.max(lines[1]));
            if last - first >= COUNTED_LINES {
                return usize::MAX;
            }
        }
        for run in self.runs(component) {
            if transposed {
                beams.add(run.start / width, run.len());
            } else {
                run.for_each(|cell| beams.add(cell % width, 1));
            }
        }
        beams.beyond_two()
    }

    /// Finds the components of `labels`, which are below `count`; 0 and that of cells without a return are
    /// none. They are numbered by their first cell, and list their runs in order.
    ///
    /// Runs of equal labels are joined row by row (union-find), so the cost of a cell is that of
    /// comparing it with those around it, many at a time.
    pub fn find(&mut self, labels: &[u32], (width, count): (usize, usize)) {
        let Self { around, codes, at_border, lasts, runs, row_starts, .. } = self;
        self.width = width;
        around.look::<Change>(labels, (width, count), codes);
        for row in codes[..labels.len()].chunks_exact_mut(width.max(1)) {
            row[width - 1] |= LAST;
        }
        lasts.resize(codes.len(), 0);
        row_starts.clear();
        Arch::new().dispatch(ListRuns { labels, width, codes, at_border, lasts, runs, row_starts });
        self.join_runs();
        self.number_runs();
        self.sorted.resize(self.runs.len(), (0, 0));
        for run in &self.runs {
            let at = &mut self.filled[run.parent as usize];
            self.sorted[*at] = (run.first, run.end);
            *at += 1;
        }
    }

    /// The component of a cell, if it has one.
    pub fn of(&self, cell: usize) -> Option<usize> {
        let row = cell / self.width;
        let runs = &self.runs[self.row_starts[row]..self.row_starts[row + 1]];
        let run = runs.get(runs.partition_point(|run| run.end as usize <= cell));
        run.filter(|run| run.first as usize <= cell).map(|run| run.parent as usize)
    }

    /// For each cell whether it has a neighbour with a return that is not of its component: not zero if so;
    /// only the lowest bit is to be looked at.
    pub fn borders(&self) -> &[u8] {
        &self.codes[..self.codes.len() - WORD]
    }

    /// Joins runs of one label that touch, corners included, to trees whose root comes first.
    fn join_runs(&mut self) {
        let width = self.width as u32;
        for rows in 1..self.row_starts.len().saturating_sub(1) {
            let (mut above, end) = (self.row_starts[rows - 1], self.row_starts[rows]);
            for here in end..self.row_starts[rows + 1] {
                let run = self.runs[here];
                let (low, high) = (run.first - width, run.end - width);
                while above < end && self.runs[above].end < low {
                    above += 1;
                }
                let mut root = here as u32;
                for other in above..end {
                    let Run { first, label, .. } = self.runs[other];
                    if first > high {
                        break;
                    }
                    if label == run.label {
                        let found = self.root(other as u32);
                        // The run itself comes after all others.
                        let later = root.max(found);
                        root = root.min(found);
                        self.runs[later as usize].parent = root;
                    }
                }
                self.runs[here].parent = root;
            }
        }
    }

    fn root(&mut self, mut run: u32) -> u32 {
        loop {
            let parent = self.runs[run as usize].parent;
            let above = self.runs[parent as usize].parent;
            if above == parent {
                return parent;
            }
            self.runs[run as usize].parent = above;
            run = above;
        }
    }

    /// Replaces the parent of each run by the number of its component, and counts cells and runs.
    fn number_runs(&mut self) {
        self.filled.clear();
        self.sizes.clear();
        self.border_cells.clear();
        for k in 0..self.runs.len() {
            let Run { first, end, parent, border, .. } = self.runs[k];
            // A parent comes before its children, so it has its number already.
            let component = if parent as usize == k {
                self.filled.push(0);
                self.sizes.push(0);
                self.border_cells.push(0);
                self.filled.len() as u32 - 1
            } else {
                self.runs[parent as usize].parent
            };
            self.runs[k].parent = component;
            self.filled[component as usize] += 1;
            self.sizes[component as usize] += (end - first) as usize;
            self.border_cells[component as usize] += border as usize;
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
}

/// Lists the runs of equal labels in every row.
struct ListRuns<'a> {
    labels: &'a [u32],
    width: usize,
    codes: &'a [u8],
    at_border: &'a mut Vec<(u64, u32)>,
    lasts: &'a mut [u32],
    runs: &'a mut Vec<Run>,
    row_starts: &'a mut Vec<usize>,
}

impl WithSimd for ListRuns<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { labels, width, codes, at_border, lasts, runs, row_starts } = self;
        let words = words(codes);
        let count = list_bits(words.iter().map(|codes| bits(codes, |codes| codes)), lasts);
        let mut before = 0;
        at_border.clear();
        at_border.extend(words.iter().map(|codes| {
            let border = u8x16::splat(BORDER);
            let word = bits(codes, |codes| (codes & border).simd_eq(border));
            before += word.count_ones();
            (word, before - word.count_ones())
        }));
        let borders_before = |cell: u32| {
            let (word, before) = at_border[cell as usize / WORD];
            before + (word & ((1 << (cell as usize % WORD)) - 1)).count_ones()
        };
        runs.resize(count, Run { first: 0, end: 0, label: 0, border: 0, parent: 0 });
        let (mut first, mut listed) = (0, 0);
        let mut lasts = lasts[..count].iter();
        for row in 1..=labels.len() / width.max(1) {
            row_starts.push(listed);
            let row_end = (row * width) as u32;
            for last in lasts.by_ref() {
                let (end, label) = (last + 1, labels[first as usize]);
                let border = borders_before(end) - borders_before(first);
                // Written over by the next one where there is no label: that is hard to foretell.
                runs[listed] = Run { first, end, label, border, parent: listed as u32 };
                listed += usize::from((label != 0) & (label != NO_RETURN));
                first = end;
                if end == row_end {
                    break;
                }
            }
        }
        runs.truncate(listed);
        row_starts.push(listed);
    }
}

#[cfg(test)]
mod tests {
    use super::super::morphology::neighbours8;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn components_are_those_of_a_flood(
            labels in prop::collection::vec(
                prop::sample::select(vec![0, 1, 2, NO_RETURN]),
                0..160,
            ),
            width in 1..50_usize,
            count in prop::sample::select(vec![3_u32, 255, 256, 65_535, 65_536]),
        ) {
            // 1 and 2 stand for the greatest labels that there are.
            let labels = labels[..labels.len() / width * width].iter();
            let labels: Vec<u32> = labels
                .map(|&label| if matches!(label, 1 | 2) { label + count - 3 } else { label })
                .collect();
            let mut components = Components::default();
            components.find(&labels, (width, count as usize));

            let mut seen = vec![false; labels.len()];
            let mut next = 0;
            for start in 0..labels.len() {
                let is_none = labels[start] == 0 || labels[start] == NO_RETURN;
                if is_none {
                    prop_assert_eq!(components.of(start), None);
                }
                if is_none || seen[start] {
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
                prop_assert!(cells.iter().all(|&c| components.of(c) == Some(next)));
                let others = |c: usize| {
                    neighbours8(c, width, labels.len())
                        .any(|n| labels[n] != labels[c] && labels[n] != NO_RETURN)
                };
                let border = cells.iter().filter(|&&c| others(c)).count();
                prop_assert_eq!(components.border_cells[next], border);
                next += 1;
            }
            prop_assert_eq!(components.len(), next);
        }
    }

    #[test]
    fn a_label_in_two_places_is_two_components() {
        let labels = [1, 0, 1, /**/ 0, 1, 0, /**/ 2, 0, 0, /**/ 0, 0, 2];
        let mut components = Components::default();
        components.find(&labels, (3, 3));
        assert_eq!(components.len(), 3);
        let cells = [0, 1, 2].map(|component| components.cells(component).collect::<Vec<_>>());
        assert_eq!(cells, [vec![0, 2, 4], vec![6], vec![11]]);
        assert_eq!(components.sizes, [3, 1, 1]);
    }
}
