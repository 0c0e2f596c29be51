//! The scan as segmentation works on it: arrays by coordinate, the finer direction first.
//!
//! Nothing is assumed about which end of the grid is up or left, or whether rows or columns are the
//! tilts. Neighbours in the grid are neighbours in angle, and one of the two directions is sampled
//! more finely than the other: that one is *along*, the other *across*. A *lane* is a line of cells
//! along; a *step* is a position on all lanes. On the project's own scanner the lanes are the
//! columns (beams) and the steps are the rows (tilts).

use super::near::Rim;
use super::noise::ReadingErrors;
use super::positions::StepFinder;
use crate::scan::PointGrid;
use pulp::{Arch, Simd, WithSimd};

/// Nearer points than this are the zeros that some drivers give for "no return", in metres.
const NEAREST_M: f32 = 1e-3;
/// Share of the greatest range from which on a return may be a saturated reading.
const SATURATED: f32 = 0.9985;
/// Fewest saturated readings that are believed to be some.
const FEWEST_SATURATED: u32 = 32;
/// Pairs of cells that are looked at to measure one angular pitch.
const PITCH_SAMPLES: usize = 64;

/// One scan, step after step; all arrays are `steps * lanes` long.
#[derive(Clone, Debug, Default)]
pub(super) struct Field {
    pub steps: usize,
    pub lanes: usize,
    /// Whether the lanes are rows of the grid, not columns.
    pub transposed: bool,
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    pub z: Vec<f32>,
    /// Distance from the origin in metres; zero where there is no return.
    pub range: Vec<f32>,
    /// One over the range; zero where there is no return.
    pub inverse: Vec<f32>,
    /// Angle from the first step to each step in radians, as far as it can be told.
    pub positions: Vec<f32>,
    pub along_rad: f32,
    pub across_rad: f32,
    /// Readings at the scanner's limit that were taken as no return.
    pub saturated: usize,
    /// What the readings err by.
    pub errors: ReadingErrors,
    /// The same for regions of several lanes: with what all of a lane errs by alike.
    pub lane_errors: ReadingErrors,
    /// Range over its standard deviation; zero where there is no return.
    pub gain: Vec<f32>,
    /// What is known of the errors of the grid's rows, see [`PointGrid::row_sigmas_rad`].
    pub row_sigmas_rad: Vec<f32>,
    /// Which cells are on its rim.
    pub rim: Rim,
    /// Ranges of the nearest and of the farthest return.
    pub extent: [f32; 2],
    step_finder: StepFinder,
    samples: Vec<f32>,
    turned: Vec<[f32; 3]>,
}

impl Field {
    pub fn len(&self) -> usize {
        self.steps * self.lanes
    }

    pub fn is_valid(&self, cell: usize) -> bool {
        self.range[cell] > 0.0
    }

    /// Whether it is known what the tilts of the grid's rows are off by.
    pub fn knows_row_errors(&self) -> bool {
        self.row_sigmas_rad.iter().any(|&sigma| sigma > 0.0)
    }

    /// Standard deviation of the range of a cell in metres.
    pub fn sigma_m(&self, cell: usize) -> f64 {
        f64::from(self.range[cell] / self.gain[cell])
    }

    /// Sets what the readings err by, and the gains that follow from it.
    pub fn set_errors(&mut self, errors: ReadingErrors) {
        (self.errors, self.lane_errors) = (errors, errors);
        let noise = errors.noise;
        let [constant, square, fourth] =
            [noise.constant, noise.square, noise.fourth].map(|factor| factor as f32);
        self.gain.resize(self.range.len(), 0.0);
        let factors = [constant, square, fourth];
        Arch::new().dispatch(Gains { range: &self.range, factors, gain: &mut self.gain });
        self.allow_for_turns();
    }

    /// Cells with a return.
    pub fn returns(&self) -> usize {
        Arch::new().dispatch(Count { range: &self.range, least: f32::MIN_POSITIVE }) as usize
    }

    /// Weight of a cell in [`Moments`](super::moments::Moments): `r² / σ²`.
    pub fn weight(&self, cell: usize) -> f64 {
        let gain = f64::from(self.gain[cell]);
        gain * gain
    }

    pub fn point(&self, cell: usize) -> [f64; 3] {
        [f64::from(self.x[cell]), f64::from(self.y[cell]), f64::from(self.z[cell])]
    }

    /// The index in the grid of a cell of the field.
    pub fn grid_index(&self, cell: usize) -> usize {
        if self.transposed { (cell % self.lanes) * self.steps + cell / self.lanes } else { cell }
    }

    /// Takes over a grid.
    pub fn load(&mut self, grid: &PointGrid) {
        let (rows, columns) = (grid.rows(), grid.columns());
        let down = median_pitch(grid.points(), columns, 1, 0, &mut self.samples);
        let right = median_pitch(grid.points(), columns, 0, 1, &mut self.samples);
        // Equal pitches, or none that can be told, leave the columns as lanes.
        self.transposed = right < down;
        let points = grid.points();
        if self.transposed {
            (self.steps, self.lanes) = (columns, rows);
            self.turned.clear();
            self.turned
                .extend((0..columns).flat_map(|c| (0..rows).map(move |r| points[r * columns + c])));
            let turned = std::mem::take(&mut self.turned);
            self.fill(&turned);
            self.turned = turned;
            (self.along_rad, self.across_rad) = (right, down);
        } else {
            (self.steps, self.lanes) = (rows, columns);
            self.fill(points);
            (self.along_rad, self.across_rad) = (down, right);
        }
        if !self.along_rad.is_finite() {
            self.along_rad = if self.across_rad.is_finite() { self.across_rad } else { 0.01 };
        }
        if !self.across_rad.is_finite() {
            self.across_rad = self.along_rad;
        }
        let length = self.len();
        self.rim.set_size(self.lanes, length);
        self.row_sigmas_rad.clear();
        self.row_sigmas_rad.extend_from_slice(grid.row_sigmas_rad());
        self.drop_saturated();
        let Self { x, y, z, inverse, steps, lanes, along_rad, step_finder, positions, .. } = self;
        step_finder.find([x, y, z, inverse], (*steps, *lanes), *along_rad, positions);
    }

    fn fill(&mut self, points: &[[f32; 3]]) {
        let length = self.len();
        for array in [&mut self.x, &mut self.y, &mut self.z, &mut self.range, &mut self.inverse] {
            array.resize(length, 0.0);
        }
        let Self { x, y, z, range, inverse, .. } = self;
        Arch::new().dispatch(Fill { points: &points[..length], arrays: [x, y, z, range, inverse] });
    }

    fn find_extent(&self) -> [f32; 2] {
        // Positive numbers are in the order of their bits, which can be compared many at a time; with
        // one less of them a range of none is beyond all.
        let (low, high) = Arch::new().dispatch(Extent(&self.range));
        let nearest = if low == u32::MAX { f32::MAX } else { f32::from_bits(low + 1) };
        [nearest, f32::from_bits(high)]
    }

    /// Takes readings at the scanner's limit out.
    ///
    /// Some drivers give the limit where nothing came back. Those points lie on a sphere about the
    /// sensor. A wall can have many points within 0.15 % of the greatest range too, but only within
    /// acos(1 / 1.0015) = 3.1° of its foot: the mean of their directions is nearly of unit length.
    fn drop_saturated(&mut self) {
        self.saturated = 0;
        self.extent = self.find_extent();
        let [_, greatest] = self.extent;
        let limit = (SATURATED * greatest).max(f32::MIN_POSITIVE);
        let near = Arch::new().dispatch(Count { range: &self.range, least: limit });
        if near < FEWEST_SATURATED {
            return;
        }
        let mut sum = [0.0_f64; 3];
        let mut count = 0_usize;
        for cell in 0..self.len() {
            if self.range[cell] >= limit {
                let scale = f64::from(self.inverse[cell]);
                for (sum, value) in sum.iter_mut().zip(self.point(cell)) {
                    *sum += value * scale;
                }
                count += 1;
            }
        }
        let length = sum.iter().map(|s| s * s).sum::<f64>().sqrt();
        if length > 0.998 * count as f64 {
            return;
        }
        for cell in 0..self.len() {
            if self.range[cell] >= limit {
                (self.x[cell], self.y[cell], self.z[cell]) = (0.0, 0.0, 0.0);
                (self.range[cell], self.inverse[cell]) = (0.0, 0.0);
            }
        }
        self.saturated = count;
        self.extent = self.find_extent();
    }

    /// Distance of the unit directions of two valid cells.
    pub fn chord(&self, a: usize, b: usize) -> f32 {
        self.square_chord(a, b).sqrt()
    }

    #[inline]
    fn square_chord(&self, a: usize, b: usize) -> f32 {
        square_chord(
            [self.x[a], self.y[a], self.z[a]].map(|v| v * self.inverse[a]),
            [self.x[b], self.y[b], self.z[b]].map(|v| v * self.inverse[b]),
        )
    }
}

/// Points into arrays of x, y, z, ranges and inverse ranges of their length.
struct Fill<'a> {
    points: &'a [[f32; 3]],
    arrays: [&'a mut [f32]; 5],
}

impl WithSimd for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let [x, y, z, range, inverse] = self.arrays;
        let outputs = x.iter_mut().zip(y).zip(z).zip(range).zip(inverse);
        for (&[px, py, pz], ((((x, y), z), range), inverse)) in self.points.iter().zip(outputs) {
            // NaN fails both comparisons.
            let square = px * px + py * py + pz * pz;
            let valid = (square > NEAREST_M * NEAREST_M) & (square < f32::MAX);
            let root = square.sqrt();
            *x = if valid { px } else { 0.0 };
            *y = if valid { py } else { 0.0 };
            *z = if valid { pz } else { 0.0 };
            *range = if valid { root } else { 0.0 };
            *inverse = if valid { 1.0 / root } else { 0.0 };
        }
    }
}

/// The bits, less one, of the least range above zero, and the bits of the greatest.
struct Extent<'a>(&'a [f32]);

impl WithSimd for Extent<'_> {
    type Output = (u32, u32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> (u32, u32) {
        let (mut low, mut high) = (u32::MAX, 0);
        for range in self.0 {
            low = low.min(range.to_bits().wrapping_sub(1));
            high = high.max(range.to_bits());
        }
        (low, high)
    }
}

/// Ranges over their standard deviations, of which the variance has these factors.
struct Gains<'a> {
    range: &'a [f32],
    factors: [f32; 3],
    gain: &'a mut [f32],
}

impl WithSimd for Gains<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let [constant, square, fourth] = self.factors;
        if square == 0.0 && fourth == 0.0 {
            let sigma = constant.sqrt();
            for (gain, &range) in self.gain.iter_mut().zip(self.range) {
                *gain = range / sigma;
            }
            return;
        }
        for (gain, &range) in self.gain.iter_mut().zip(self.range) {
            let r2 = range * range;
            *gain = range / (constant + r2 * (square + r2 * fourth)).sqrt();
        }
    }
}

/// How many ranges are no less than one.
struct Count<'a> {
    range: &'a [f32],
    least: f32,
}

impl WithSimd for Count<'_> {
    type Output = u32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> u32 {
        self.range.iter().map(|&range| u32::from(range >= self.least)).sum()
    }
}

#[inline]
fn square_chord(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

/// Median angle between neighbours `(down, right)` cells apart; infinite where there are none.
fn median_pitch(
    points: &[[f32; 3]],
    columns: usize,
    down: usize,
    right: usize,
    samples: &mut Vec<f32>,
) -> f32 {
    samples.clear();
    let rows = points.len().checked_div(columns).unwrap_or(0);
    let (rows_left, columns_left) = (rows.saturating_sub(down), columns.saturating_sub(right));
    let pairs = rows_left * columns_left;
    // A stride without a factor in common with the row length visits all columns.
    let mut stride = (pairs / (4 * PITCH_SAMPLES)).max(1);
    while stride > 1 && columns_left.is_multiple_of(stride) {
        stride += 1;
    }
    // The pairs that there are fill the front; squares of chords are in the chords' order.
    samples.resize(pairs.div_ceil(stride), 0.0);
    let (apart, mut row, mut column, mut count) = (down * columns + right, 0, 0, 0);
    let is_return = |square: f32| (square > NEAREST_M * NEAREST_M) & (square < f32::MAX);
    for _ in 0..samples.len() {
        let cell = row * columns + column;
        let (a, b) = (points[cell], points[cell + apart]);
        let squares = [a, b].map(|[x, y, z]| x * x + y * y + z * z);
        let [per_a, per_b] = squares.map(|square| 1.0 / square.sqrt());
        samples[count] = square_chord(a.map(|v| v * per_a), b.map(|v| v * per_b));
        count += usize::from(is_return(squares[0]) & is_return(squares[1]));
        column += stride;
        while column >= columns_left {
            column -= columns_left;
            row += 1;
        }
    }
    samples.truncate(count);
    median(samples).map_or(f32::INFINITY, |square| square.sqrt().max(1e-6))
}

/// So many values are counted faster than parted.
const FEW_VALUES: usize = 16;

/// The middle value (the upper of two); reorders `values`.
pub(super) fn median(values: &mut [f32]) -> Option<f32> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    if values.len() <= FEW_VALUES {
        return Some(value_of_rank(values, middle));
    }
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// The value that so many of few others come before: each is compared with all, which no branch depends
/// on.
fn value_of_rank(values: &[f32], rank: usize) -> f32 {
    // In the order of their bits, as total_cmp has it; what there is none of comes after all.
    let mut keys = [i32::MAX; FEW_VALUES];
    for (key, value) in keys.iter_mut().zip(values) {
        let bits = value.to_bits() as i32;
        *key = bits ^ ((bits >> 31) as u32 >> 1) as i32;
    }
    let mut found = values[0];
    for (&value, &own) in values.iter().zip(&keys) {
        let (mut before, mut equal) = (0, 0);
        for &key in &keys {
            before += i32::from(key < own);
            equal += i32::from(key == own);
        }
        let ranks = before as usize..(before + equal) as usize;
        found = if ranks.contains(&rank) { value } else { found };
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall at x = 3 m seen through `rows x columns` beams of the given pitches.
    fn wall(rows: usize, columns: usize, row_rad: f32, column_rad: f32) -> Vec<[f32; 3]> {
        (0..rows * columns)
            .map(|i| {
                let tilt = (i / columns) as f32 * row_rad;
                let bearing = (i % columns) as f32 * column_rad;
                [3.0, 3.0 * bearing.tan(), -3.0 * tilt.tan() / bearing.cos()]
            })
            .collect()
    }

    #[test]
    fn the_finer_direction_is_along() {
        let mut field = Field::default();
        field.load(&PointGrid::new(40, 30, wall(40, 30, 0.004, 0.017)));
        assert!(!field.transposed);
        assert!((field.along_rad - 0.004).abs() < 2e-4 && (field.across_rad - 0.017).abs() < 6e-4);
        field.load(&PointGrid::new(40, 30, wall(40, 30, 0.017, 0.004)));
        assert!(field.transposed);
        assert_eq!((field.steps, field.lanes), (30, 40));
        assert_eq!(field.grid_index(1), 30);
    }

    #[test]
    fn readings_at_the_limit_in_all_directions_are_no_returns() {
        let mut points = wall(40, 30, 0.004, 0.017);
        for (i, point) in points.iter_mut().enumerate() {
            if i % 30 < 20 {
                let range = point.iter().map(|v| v * v).sum::<f32>().sqrt();
                *point = point.map(|v| v * 20.0 / range);
            }
        }
        let mut field = Field::default();
        field.load(&PointGrid::new(40, 30, points));
        assert_eq!(field.saturated, 800);
        assert_eq!((0..field.len()).filter(|&cell| field.is_valid(cell)).count(), 400);
    }

    #[test]
    fn a_far_wall_is_not_taken_for_the_limit() {
        let mut field = Field::default();
        field.load(&PointGrid::new(40, 30, wall(40, 30, 0.002, 0.004)));
        assert_eq!(field.saturated, 0);
    }

    #[test]
    fn empty_and_zero_grids_load() {
        let mut field = Field::default();
        for points in [vec![[f32::NAN; 3]; 6], vec![[0.0; 3]; 6], vec![[f32::INFINITY; 3]; 6]] {
            field.load(&PointGrid::new(2, 3, points));
            assert!((0..6).all(|cell| !field.is_valid(cell)));
        }
        field.load(&PointGrid::new(0, 0, Vec::new()));
        assert_eq!(field.len(), 0);
    }

    #[test]
    fn uneven_steps_are_measured() {
        let points = (0..20 * 8)
            .map(|i| {
                let step = i / 8;
                let tilt =
                    if step < 10 { step as f32 * 0.004 } else { 0.04 + (step - 10) as f32 * 0.01 };
                let bearing = (i % 8) as f32 * 0.02;
                [3.0, 3.0 * bearing.tan(), -3.0 * tilt.tan() / bearing.cos()]
            })
            .collect();
        let mut field = Field::default();
        field.load(&PointGrid::new(20, 8, points));
        let gaps: Vec<f32> = field.positions.windows(2).map(|p| p[1] - p[0]).collect();
        assert!((gaps[2] - 0.004).abs() < 2e-4 && (gaps[15] - 0.01).abs() < 6e-4, "{gaps:?}");
    }
}
