//! Scores a label image against truth, by the definitions of Hoover et al. 1996 (tolerance 0.8).

use std::collections::BTreeMap;

const TOLERANCE: f64 = 0.8;

/// 8-connected components of equal positive labels that have at least `fewest` cells, from 1.
pub fn components(labels: &[usize], columns: usize, fewest: usize) -> Vec<usize> {
    let rows = labels.len() / columns;
    let mut out = vec![0; labels.len()];
    let mut seen = vec![false; labels.len()];
    let mut next = 0;
    for start in 0..labels.len() {
        if labels[start] == 0 || seen[start] {
            continue;
        }
        let mut cells = vec![start];
        seen[start] = true;
        let mut at = 0;
        while at < cells.len() {
            let (row, column) = (cells[at] / columns, cells[at] % columns);
            at += 1;
            for r in row.saturating_sub(1)..=(row + 1).min(rows - 1) {
                for c in column.saturating_sub(1)..=(column + 1).min(columns - 1) {
                    let cell = r * columns + c;
                    if !seen[cell] && labels[cell] == labels[start] {
                        seen[cell] = true;
                        cells.push(cell);
                    }
                }
            }
        }
        if cells.len() >= fewest {
            next += 1;
            for cell in cells {
                out[cell] = next;
            }
        }
    }
    out
}

/// Counts of one comparison; sums over scenes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Score {
    pub truths: usize,
    pub correct: usize,
    pub over: usize,
    pub under: usize,
    pub missed: usize,
    pub noise: usize,
    /// Correct pairs as (true region, found region), both of the split images.
    pub pairs: Vec<(usize, usize)>,
}

/// Compares regions; both images hold components as [`components`] makes them. True regions of
/// fewer than `fewest` cells count for nobody.
pub fn score(truth: &[usize], found: &[usize], fewest: usize) -> Score {
    let mut sizes: BTreeMap<usize, usize> = BTreeMap::new();
    for &t in truth {
        *sizes.entry(t).or_default() += 1;
    }
    let ignored = |t: usize| t != 0 && sizes[&t] < fewest;
    let mut overlap: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    let mut truth_size: BTreeMap<usize, usize> = BTreeMap::new();
    let mut found_size: BTreeMap<usize, usize> = BTreeMap::new();
    for (&t, &f) in truth.iter().zip(found) {
        if ignored(t) {
            continue;
        }
        *overlap.entry((t, f)).or_default() += 1;
        *truth_size.entry(t).or_default() += 1;
        *found_size.entry(f).or_default() += 1;
    }
    truth_size.remove(&0);
    found_size.remove(&0);
    found_size.retain(|_, size| *size >= fewest);

    let shared = |t: usize, f: usize| overlap.get(&(t, f)).copied().unwrap_or(0) as f64;
    let size = |sizes: &BTreeMap<usize, usize>, k: usize| sizes[&k] as f64;
    // (mean measure, kind, truths, founds), kind 0 correct, 1 over, 2 under.
    let mut instances: Vec<(f64, u8, Vec<usize>, Vec<usize>)> = Vec::new();
    for &t in truth_size.keys() {
        for &f in found_size.keys() {
            let o = shared(t, f);
            let (a, b) = (o / size(&found_size, f), o / size(&truth_size, t));
            if a >= TOLERANCE && b >= TOLERANCE {
                instances.push((0.5 * (a + b), 0, vec![t], vec![f]));
            }
        }
        let parts: Vec<usize> = found_size
            .keys()
            .copied()
            .filter(|&f| shared(t, f) > 0.0 && shared(t, f) >= TOLERANCE * size(&found_size, f))
            .collect();
        let o: f64 = parts.iter().map(|&f| shared(t, f)).sum();
        if parts.len() >= 2 && o >= TOLERANCE * size(&truth_size, t) {
            let all: f64 = parts.iter().map(|&f| size(&found_size, f)).sum();
            instances.push((0.5 * (o / all + o / size(&truth_size, t)), 1, vec![t], parts));
        }
    }
    for &f in found_size.keys() {
        let parts: Vec<usize> = truth_size
            .keys()
            .copied()
            .filter(|&t| shared(t, f) > 0.0 && shared(t, f) >= TOLERANCE * size(&truth_size, t))
            .collect();
        let o: f64 = parts.iter().map(|&t| shared(t, f)).sum();
        if parts.len() >= 2 && o >= TOLERANCE * size(&found_size, f) {
            let all: f64 = parts.iter().map(|&t| size(&truth_size, t)).sum();
            instances.push((0.5 * (o / all + o / size(&found_size, f)), 2, parts, vec![f]));
        }
    }
    instances.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut result = Score { truths: truth_size.len(), ..Score::default() };
    let (mut used_truth, mut used_found) = (Vec::new(), Vec::new());
    for (_, kind, ts, fs) in instances {
        if ts.iter().any(|t| used_truth.contains(t)) || fs.iter().any(|f| used_found.contains(f)) {
            continue;
        }
        match kind {
            0 => {
                result.correct += 1;
                result.pairs.push((ts[0], fs[0]));
            }
            1 => result.over += 1,
            _ => result.under += 1,
        }
        used_truth.extend(ts);
        used_found.extend(fs);
    }
    result.missed = truth_size.len() - used_truth.len();
    result.noise = found_size.len() - used_found.len();
    result
}

impl Score {
    /// Adds the counts of another scene.
    pub fn add(&mut self, other: &Score) {
        self.truths += other.truths;
        self.correct += other.correct;
        self.over += other.over;
        self.under += other.under;
        self.missed += other.missed;
        self.noise += other.noise;
    }
}

#[test]
fn the_scorer_counts_as_defined() {
    let half = |split: usize| -> Vec<usize> {
        (0..800).map(|i| if i % 40 < split { 1 } else { 2 }).collect()
    };
    let truth = half(20);
    let count = |s: &Score| (s.correct, s.over, s.under, s.missed, s.noise);
    assert_eq!(count(&score(&truth, &truth, 40)), (2, 0, 0, 0, 0));
    let mut cut = truth.clone();
    (0..10).for_each(|row| cut[row * 40..row * 40 + 20].fill(3));
    assert_eq!(count(&score(&truth, &cut, 40)), (1, 1, 0, 0, 0));
    assert_eq!(count(&score(&truth, &[1; 800], 40)), (0, 0, 1, 0, 0));
    assert_eq!(count(&score(&truth, &[0; 800], 40)), (0, 0, 0, 2, 0));
    assert_eq!(count(&score(&truth, &half(12), 40)), (0, 0, 0, 2, 2));
    assert_eq!(components(&[1, 0, 0, 1, 1, 0, 1, 0, 1], 3, 2), [1, 0, 0, 1, 1, 0, 1, 0, 1]);
}
