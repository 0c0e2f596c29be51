//! In which order variables are eliminated, and which of them share a clique.

use std::collections::BTreeSet;

/// A set of variables that is eliminated together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Symbolic {
    /// Variables eliminated here, in order.
    pub frontals: Vec<usize>,
    /// Variables that are left connected by it, in order of their own elimination.
    pub separators: Vec<usize>,
    /// Index of the clique that eliminates the first separator; `None` for a root. Greater than the
    /// own index.
    pub parent: Option<usize>,
}

/// Eliminates variables `0..dimensions.len()` that are connected by `cliques` (each a set of
/// variables that appear in one factor), those with a lower `group` first, within a group the one
/// with the smallest neighbourhood, ties by index. Returns cliques in order of elimination.
pub fn eliminate(dimensions: &[usize], group: &[u8], cliques: &[Vec<usize>]) -> Vec<Symbolic> {
    let separators = eliminate_one_by_one(dimensions, group, cliques);
    join_cliques(&separators)
}

/// For each variable in order of elimination, itself and its neighbours at that time.
fn eliminate_one_by_one(
    dimensions: &[usize],
    group: &[u8],
    cliques: &[Vec<usize>],
) -> Vec<(usize, Vec<usize>)> {
    let count = dimensions.len();
    let mut neighbours: Vec<Vec<usize>> = vec![Vec::new(); count];
    for clique in cliques {
        for &a in clique {
            neighbours[a].extend(clique.iter().copied().filter(|&b| b != a));
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    let degree = |list: &[usize]| list.iter().map(|&v| dimensions[v]).sum::<usize>();
    let mut queue: BTreeSet<(u8, usize, usize)> =
        (0..count).map(|v| (group[v], degree(&neighbours[v]), v)).collect();
    let mut order = Vec::with_capacity(count);
    let mut merged = Vec::new();
    while let Some((_, _, variable)) = queue.pop_first() {
        let adjacent = std::mem::take(&mut neighbours[variable]);
        for &other in &adjacent {
            queue.remove(&(group[other], degree(&neighbours[other]), other));
            merge_sorted(&neighbours[other], &adjacent, &[variable, other], &mut merged);
            std::mem::swap(&mut neighbours[other], &mut merged);
            queue.insert((group[other], degree(&neighbours[other]), other));
        }
        order.push((variable, adjacent));
    }
    order
}

/// The union of two sorted lists without the variables of `skip`.
fn merge_sorted(a: &[usize], b: &[usize], skip: &[usize], merged: &mut Vec<usize>) {
    merged.clear();
    let (mut i, mut j) = (0, 0);
    while i < a.len() || j < b.len() {
        let next = match (a.get(i), b.get(j)) {
            (Some(&x), Some(&y)) if x == y => {
                (i, j) = (i + 1, j + 1);
                x
            }
            (Some(&x), Some(&y)) if x < y => {
                i += 1;
                x
            }
            (_, Some(&y)) => {
                j += 1;
                y
            }
            (Some(&x), None) => {
                i += 1;
                x
            }
            (None, None) => break,
        };
        if !skip.contains(&next) {
            merged.push(next);
        }
    }
}

/// Joins a variable to the clique of its first separator where that adds nothing to the clique.
fn join_cliques(order: &[(usize, Vec<usize>)]) -> Vec<Symbolic> {
    let mut position = vec![0; order.len()];
    for (at, (variable, _)) in order.iter().enumerate() {
        position[*variable] = at;
    }
    // From the last to the first, so that a parent exists before its children.
    let mut reversed: Vec<Symbolic> = Vec::new();
    let mut clique_of = vec![0; order.len()];
    for (variable, adjacent) in order.iter().rev() {
        let mut separators = adjacent.clone();
        separators.sort_unstable_by_key(|&v| position[v]);
        let parent = separators.first().map(|&first| clique_of[first]);
        if let Some(parent) = parent {
            let clique = &mut reversed[parent];
            // The separators are a subset of the parent's variables: equal size means equal sets.
            if clique.frontals.len() + clique.separators.len() == separators.len() {
                clique.frontals.insert(0, *variable);
                clique_of[*variable] = parent;
                continue;
            }
        }
        clique_of[*variable] = reversed.len();
        reversed.push(Symbolic { frontals: vec![*variable], separators, parent });
    }
    let last = reversed.len().saturating_sub(1);
    reversed.reverse();
    for clique in &mut reversed {
        clique.parent = clique.parent.map(|parent| last - parent);
    }
    reversed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_chain_becomes_a_path_of_small_cliques() {
        let links: Vec<Vec<usize>> = (0..9).map(|i| vec![i, i + 1]).collect();
        let mut group = vec![0; 10];
        group[9] = 1;
        let cliques = eliminate(&[1; 10], &group, &links);
        assert!(cliques.iter().all(|c| c.frontals.len() + c.separators.len() <= 3));
        assert!(cliques.last().unwrap().frontals.contains(&9));
    }

    proptest! {
        #[test]
        fn every_factor_lies_within_the_clique_of_its_first_variable(
            raw in prop::collection::vec(prop::collection::vec(0..25_usize, 1..4), 0..60),
            group in prop::collection::vec(0..3_u8, 25),
        ) {
            let cliques = eliminate(&[3; 25], &group, &raw);
            let mut position = [usize::MAX; 25];
            let mut clique_of = [usize::MAX; 25];
            let mut at = 0;
            for (index, clique) in cliques.iter().enumerate() {
                for &v in &clique.frontals {
                    prop_assert_eq!(position[v], usize::MAX);
                    position[v] = at;
                    clique_of[v] = index;
                    at += 1;
                }
            }
            prop_assert_eq!(at, 25);
            for clique in &raw {
                let first = *clique.iter().min_by_key(|&&v| position[v]).unwrap();
                let home = &cliques[clique_of[first]];
                for v in clique {
                    prop_assert!(home.frontals.contains(v) || home.separators.contains(v));
                }
            }
            for (index, clique) in cliques.iter().enumerate() {
                // Running intersection: separators are all in the parent.
                match clique.parent {
                    Some(parent) => {
                        prop_assert!(parent > index);
                        let above = &cliques[parent];
                        prop_assert!(above.frontals.contains(&clique.separators[0]));
                        for v in &clique.separators {
                            prop_assert!(above.frontals.contains(v) || above.separators.contains(v));
                        }
                    }
                    None => prop_assert!(clique.separators.is_empty()),
                }
            }
        }
    }
}
