//! Flood fill: one label to each 4-connected region of the smooth cells.
//!
//! Four neighbours, not eight: a fill that passes diagonals leaks through borders one cell thick.

/// Labels the cells of `open` (1: smooth) from 1 upwards and gives the size of each region, which
/// stands at its label minus one. Regions are numbered by their first cell.
pub(super) fn flood_fill(
    open: &[u8],
    width: usize,
    labels: &mut Vec<u32>,
    sizes: &mut Vec<usize>,
    stack: &mut Vec<u32>,
) {
    labels.clear();
    labels.resize(open.len(), 0);
    sizes.clear();
    for start in 0..open.len() {
        if open[start] == 0 || labels[start] != 0 {
            continue;
        }
        let label = sizes.len() as u32 + 1;
        let mut size = 0;
        labels[start] = label;
        stack.clear();
        stack.push(start as u32);
        while let Some(cell) = stack.pop() {
            size += 1;
            let cell = cell as usize;
            let x = cell % width;
            let sides = [
                (x > 0).then(|| cell - 1),
                (x + 1 < width).then(|| cell + 1),
                cell.checked_sub(width),
                Some(cell + width).filter(|&below| below < open.len()),
            ];
            for neighbour in sides.into_iter().flatten() {
                if open[neighbour] != 0 && labels[neighbour] == 0 {
                    labels[neighbour] = label;
                    stack.push(neighbour as u32);
                }
            }
        }
        sizes.push(size);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_do_not_leak_through_a_diagonal() {
        let open = [1, 1, 0, 0, /**/ 0, 0, 1, 1, /**/ 1, 0, 0, 1];
        let (mut labels, mut sizes) = (Vec::new(), Vec::new());
        flood_fill(&open, 4, &mut labels, &mut sizes, &mut Vec::new());
        assert_eq!(labels, [1, 1, 0, 0, 0, 0, 2, 2, 3, 0, 0, 2]);
        assert_eq!(sizes, [2, 3, 1]);
    }
}
