//! Ranges that a sensor or its server cut to a decimal grid.

/// Grids that readings are looked for on, in metres, the coarsest first.
const STEPS_M: [f64; 3] = [0.1, 0.01, 0.001];
/// Fewest readings that tell a grid.
const FEWEST: usize = 30;
/// Most that a reading on the grid is beside it, in steps: 32-bit floats of ten metres are off by a
/// thousandth of a millimetre.
const BESIDE: f64 = 0.02;
/// Marks a cell without a reading.
const NONE: u32 = u32::MAX;

/// The coarsest grid that ranges lie on, in metres, whatever its zero; `None` where they lie on none, or
/// are too few to tell.
pub fn range_step_m(ranges_m: &[f64]) -> Option<f64> {
    step_of(|| ranges_m.iter().copied()).map(|(step_m, _)| step_m)
}

/// Whether all ranges lie on the grid of `step_m` through zero.
pub fn are_whole_steps(ranges_m: &[f64], step_m: f64) -> bool {
    ranges_m.iter().copied().filter(is_reading).all(|range_m| is_on_grid(range_m, step_m))
}

fn is_reading(range_m: &f64) -> bool {
    range_m.is_finite() && *range_m > 0.0
}

fn is_on_grid(from_zero_m: f64, step_m: f64) -> bool {
    let steps = from_zero_m / step_m;
    (steps - steps.round()).abs() < BESIDE
}

/// The coarsest grid, and a reading on it.
fn step_of<I: Iterator<Item = f64>>(ranges_m: impl Fn() -> I) -> Option<(f64, f64)> {
    let readings = || ranges_m().filter(is_reading);
    let first = readings().nth(FEWEST - 1)?;
    let is_grid = |step_m: f64| readings().all(|range_m| is_on_grid(range_m - first, step_m));
    STEPS_M.into_iter().find(|&step_m| is_grid(step_m)).map(|step_m| (step_m, first))
}

/// The grid that the ranges of a scan lie on, and the place of each cell's range on it.
///
/// Neighbours with the same place err alike: that part of their error does not average out.
#[derive(Clone, Debug, PartialEq)]
pub struct Rounding {
    step_m: f64,
    places: Vec<u32>,
}

impl Rounding {
    /// The coarsest grid that all finite ranges lie on, in metres, whatever its zero; `None` where they
    /// lie on none.
    pub(super) fn of_ranges(ranges_m: &[f32]) -> Option<Self> {
        let (step_m, first) = step_of(|| ranges_m.iter().copied().map(f64::from))?;
        // Steps may be counted from any place below the nearest.
        let lowest = (first / step_m).ceil();
        let place = |range_m: f64| match is_reading(&range_m) {
            true => (((range_m - first) / step_m).round() + lowest) as u32,
            false => NONE,
        };
        let places = ranges_m.iter().copied().map(f64::from).map(place).collect();
        Some(Self { step_m, places })
    }

    /// Standard deviation of what a reading is off by, in metres: all within a step are as likely.
    pub fn sigma_m(&self) -> f64 {
        self.step_m / 12_f64.sqrt()
    }

    /// Whether two cells, by their numbers row after row, have the same reading.
    pub fn are_alike(&self, a: usize, b: usize) -> bool {
        self.places[a] != NONE && self.places[a] == self.places[b]
    }

    /// How many neighbouring readings agree on average: down the columns of a grid `width` columns wide,
    /// along its rows, and over an area.
    pub fn runs(&self, width: usize) -> [f64; 3] {
        let (mut readings, mut begun) = (0_u32, [0_u32; 3]);
        for cell in (0..self.places.len()).filter(|&cell| self.places[cell] != NONE) {
            let above = cell >= width && self.are_alike(cell, cell - width);
            let left = cell % width > 0 && self.are_alike(cell, cell - 1);
            readings += 1;
            begun[0] += u32::from(!above);
            begun[1] += u32::from(!left);
            begun[2] += u32::from(!above && !left);
        }
        begun.map(|begun| f64::from(readings) / f64::from(begun.max(1)))
    }

    /// The same for the columns `columns` of a grid that is `width` columns wide.
    pub(super) fn columns_only(&self, columns: std::ops::Range<usize>, width: usize) -> Self {
        let rows = self.places.chunks(width.max(1));
        let places = rows.flat_map(|row| row[columns.clone()].iter().copied()).collect();
        Self { step_m: self.step_m, places }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walls(cut: impl Fn(f64) -> f64) -> Vec<f32> {
        let range_m = |i: i32| cut(1.0 + 3.7 * (0.013 * f64::from(i)).sin().abs()) as f32;
        (0..400).map(|i| if i % 9 == 0 { f32::NAN } else { range_m(i) }).collect()
    }

    #[test]
    fn a_grid_is_found_whatever_its_zero() {
        for (step_m, zero_m) in [(0.01, 0.0), (0.01, 0.005), (0.001, 0.0), (0.1, 0.03)] {
            let ranges = walls(|range_m| (range_m / step_m).floor() * step_m + zero_m);
            let found = Rounding::of_ranges(&ranges).expect("all ranges lie on a grid");
            assert_eq!(found.step_m, step_m);
            for (i, pair) in ranges.windows(2).enumerate() {
                assert_eq!(found.are_alike(i, i + 1), (pair[0] - pair[1]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn the_steps_of_a_line_are_told_before_and_after_half_a_step_is_added() {
        let printed: Vec<f64> = walls(|range_m| (100.0 * range_m).floor() / 100.0)
            .into_iter()
            .map(|range_m| (100.0 * f64::from(range_m)).round() / 100.0)
            .collect();
        let meant: Vec<f64> = printed.iter().map(|range_m| range_m + 0.005).collect();
        assert_eq!((range_step_m(&printed), range_step_m(&meant)), (Some(0.01), Some(0.01)));
        assert!(are_whole_steps(&printed, 0.01) && !are_whole_steps(&meant, 0.01));
        assert_eq!(range_step_m(&meant[..20]), None);
    }

    #[test]
    fn ranges_on_no_grid_or_too_few_tell_none() {
        assert_eq!(Rounding::of_ranges(&walls(|range_m| range_m)), None);
        assert_eq!(Rounding::of_ranges(&walls(|range_m| (range_m * 1e4).round() / 1e4)), None);
        assert_eq!(Rounding::of_ranges(&[2.0; 20]), None);
    }
}
