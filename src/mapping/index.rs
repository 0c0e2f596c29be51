use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Edge of an index cell in metres.
const CELL_M: f64 = 4.0;
/// A box over more cells than this is kept in one list that every query reads: floors and long walls.
const MOST_CELLS: i64 = 64;

/// Which landmarks lie in which part of space, by their bounding boxes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct SpatialIndex {
    cells: BTreeMap<[i32; 3], Vec<u32>>,
    wide: BTreeSet<u32>,
    boxes: BTreeMap<u32, Bounds>,
}

/// A box along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Bounds {
    low: Point3<f64>,
    high: Point3<f64>,
}

impl Bounds {
    /// The smallest box around points, widened by `margin_m`; `None` without points.
    pub(super) fn around(
        points: impl IntoIterator<Item = Point3<f64>>,
        margin_m: f64,
    ) -> Option<Self> {
        let mut points = points.into_iter();
        let first = points.next()?;
        let (low, high) = points.fold((first, first), |(low, high), p| (low.inf(&p), high.sup(&p)));
        Some(Self { low, high }.widened(margin_m))
    }

    /// The box with its faces moved out to quarter metres, so that small changes leave it alone.
    pub(super) fn coarse(&self) -> Self {
        let step = |x: f64, round: fn(f64) -> f64| round(x * 4.0) / 4.0;
        Self {
            low: self.low.map(|x| step(x, f64::floor)),
            high: self.high.map(|x| step(x, f64::ceil)),
        }
    }

    /// The box with its faces moved out.
    pub(super) fn widened(&self, margin_m: f64) -> Self {
        let margin = nalgebra::Vector3::repeat(margin_m);
        Self { low: self.low - margin, high: self.high + margin }
    }

    /// Its lowest and highest corner.
    pub(super) fn corners(self) -> [Point3<f64>; 2] {
        [self.low, self.high]
    }

    pub(super) fn meets(&self, other: &Self) -> bool {
        (0..3).all(|k| self.low[k] <= other.high[k] && other.low[k] <= self.high[k])
    }

    /// The cells that it reaches into, from the lowest to the highest, unless they are more than `most`.
    fn cells(&self, most: i64) -> Option<([i32; 3], [i32; 3])> {
        let cell = |x: f64| (x / CELL_M).floor().clamp(-1e8, 1e8) as i32;
        let low: [i32; 3] = std::array::from_fn(|k| cell(self.low[k]));
        let high: [i32; 3] = std::array::from_fn(|k| cell(self.high[k]));
        let count: i64 =
            (0..3).map(|k| i64::from(high[k]) - i64::from(low[k]) + 1).fold(1, i64::saturating_mul);
        (count <= most).then_some((low, high))
    }
}

impl SpatialIndex {
    /// Files `item` under `bounds`, in place of where it was.
    pub(super) fn insert(&mut self, item: u32, bounds: Bounds) {
        if let Some(known) = self.boxes.get(&item) {
            if *known == bounds {
                return;
            }
            self.remove(item);
        }
        match bounds.cells(MOST_CELLS) {
            Some((low, high)) => {
                for cell in cells_between(low, high) {
                    self.cells.entry(cell).or_default().push(item);
                }
            }
            None => {
                self.wide.insert(item);
            }
        }
        self.boxes.insert(item, bounds);
    }

    /// Takes `item` out.
    pub(super) fn remove(&mut self, item: u32) {
        let Some(bounds) = self.boxes.remove(&item) else { return };
        match bounds.cells(MOST_CELLS) {
            Some((low, high)) => {
                for cell in cells_between(low, high) {
                    if let Some(items) = self.cells.get_mut(&cell) {
                        items.retain(|other| *other != item);
                        if items.is_empty() {
                            self.cells.remove(&cell);
                        }
                    }
                }
            }
            None => {
                self.wide.remove(&item);
            }
        }
    }

    /// The box under which `item` is filed.
    pub(super) fn bounds(&self, item: u32) -> Option<&Bounds> {
        self.boxes.get(&item)
    }

    /// The items whose boxes meet `bounds`, in ascending order.
    pub(super) fn query(&self, bounds: &Bounds) -> Vec<u32> {
        let most = MOST_CELLS.max(self.boxes.len() as i64);
        let mut found: Vec<u32> = match bounds.cells(most) {
            Some((low, high)) => cells_between(low, high)
                .filter_map(|cell| self.cells.get(&cell))
                .flatten()
                .chain(&self.wide)
                .copied()
                .collect(),
            // More cells than boxes: every box is looked at.
            None => self.boxes.keys().copied().collect(),
        };
        found.sort_unstable();
        found.dedup();
        found.retain(|item| self.boxes[item].meets(bounds));
        found
    }
}

fn cells_between(low: [i32; 3], high: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (low[0]..=high[0]).flat_map(move |x| {
        (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn bounds() -> impl Strategy<Value = Bounds> {
        (prop::array::uniform3(-40.0..40.0f64), prop::array::uniform3(0.0..30.0f64)).prop_map(
            |(low, size)| {
                let low = Point3::from(low);
                Bounds { low, high: low + nalgebra::Vector3::from(size) }
            },
        )
    }

    proptest! {
        #[test]
        fn a_query_finds_what_a_search_through_all_finds(
            boxes in prop::collection::vec(bounds(), 0..40),
            moved in prop::collection::vec((0..40_u32, bounds()), 0..20),
            removed in prop::collection::vec(0..40_u32, 0..10),
            query in bounds(),
        ) {
            let mut index = SpatialIndex::default();
            let mut plain = BTreeMap::new();
            for (item, bounds) in boxes.into_iter().enumerate().map(|(i, b)| (i as u32, b)).chain(moved) {
                index.insert(item, bounds);
                plain.insert(item, bounds);
            }
            for item in removed {
                index.remove(item);
                plain.remove(&item);
            }
            let expected: Vec<u32> =
                plain.iter().filter(|(_, b)| b.meets(&query)).map(|(item, _)| *item).collect();
            prop_assert_eq!(index.query(&query), expected);
        }
    }
}
