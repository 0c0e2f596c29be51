//! Labels to regions: each 8-connected component of equal labels is a region of its own.

use super::field::Field;
use super::morphology::neighbours8;

/// The components of a label image: cell lists one after the other.
#[derive(Clone, Debug, Default)]
pub(super) struct Components {
    /// Component of each cell, `NONE` for unlabelled cells.
    pub of_cell: Vec<u32>,
    /// All labelled cells, component by component.
    pub cells: Vec<u32>,
    /// Start of each component in `cells`, and the end of the last.
    pub starts: Vec<usize>,
}

/// No component.
pub(super) const NONE: u32 = u32::MAX;

impl Components {
    pub fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    pub fn cells(&self, component: usize) -> &[u32] {
        &self.cells[self.starts[component]..self.starts[component + 1]]
    }

    /// Finds the components of `labels`; 0 is no label.
    pub fn find(&mut self, labels: &[u32], width: usize) {
        self.of_cell.clear();
        self.of_cell.resize(labels.len(), NONE);
        self.cells.clear();
        self.starts.clear();
        self.starts.push(0);
        for start in 0..labels.len() {
            if labels[start] == 0 || self.of_cell[start] != NONE {
                continue;
            }
            let component = self.starts.len() as u32 - 1;
            let mut at = self.cells.len();
            self.cells.push(start as u32);
            self.of_cell[start] = component;
            while at < self.cells.len() {
                let cell = self.cells[at] as usize;
                at += 1;
                for neighbour in neighbours8(cell, width, labels.len()) {
                    if labels[neighbour] == labels[start] && self.of_cell[neighbour] == NONE {
                        self.of_cell[neighbour] = component;
                        self.cells.push(neighbour as u32);
                    }
                }
            }
            self.starts.push(self.cells.len());
        }
    }

    /// Whether a cell has no valid neighbour of another component.
    pub fn is_core(&self, cell: usize, field: &Field) -> bool {
        let component = self.of_cell[cell];
        neighbours8(cell, field.lanes, field.len())
            .all(|n| self.of_cell[n] == component || !field.is_valid(n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_in_two_places_is_two_components() {
        let labels = [1, 0, 1, /**/ 0, 1, 0, /**/ 2, 0, 0, /**/ 0, 0, 2];
        let mut components = Components::default();
        components.find(&labels, 3);
        assert_eq!(components.len(), 3);
        assert_eq!(components.cells(0), [0, 4, 2]);
        assert_eq!((components.cells(1), components.cells(2)), (&[6][..], &[11][..]));
    }
}
