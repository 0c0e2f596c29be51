//! What errors of the rays' angles mean for the ranges: on a floor at a grazing angle a tilt that is off by
//! 0.05° moves a reading by more than its own noise does, and all readings of its row alike.

use super::field::{Field, median};
use super::segments::SEGMENT;

/// Angle over which slopes are told, and the steepest that is believed, in ranges per radian.
const SLOPE_RAD: f32 = 0.03;
const STEEPEST: f32 = 10.0;
/// Most lines over which a slope is told.
const MOST_LINES: usize = 8;
/// Cells that are looked at to measure the angle between two lanes.
const ANGLE_SAMPLES: usize = 9;

impl Field {
    /// Lowers the gains by what the errors of the angles mean for the ranges: those along, which the scan
    /// itself shows, and those of the grid's rows as far as they are known.
    pub(super) fn allow_for_turns(&mut self) {
        let shown = self.errors.angle_rad as f32;
        let is_known = self.knows_row_errors();
        let known = std::mem::take(&mut self.row_sigmas_rad);
        if shown > 0.0 || (is_known && !self.transposed) {
            let of_step = |step: usize| {
                let known = if self.transposed { None } else { known.get(step) };
                known.map_or(shown, |&known| known.max(shown))
            };
            let sigmas: Vec<f32> = (0..self.steps).map(of_step).collect();
            let positions = std::mem::take(&mut self.positions);
            self.lower_gains(&sigmas, &positions, (self.lanes, 1), self.along_rad);
            self.positions = positions;
        }
        if is_known && self.transposed {
            let positions = self.lane_positions();
            self.lower_gains(&known, &positions, (1, self.lanes), self.across_rad);
            self.set_lane_errors();
        }
        self.row_sigmas_rad = known;
    }

    /// Tells what the readings of a lane have in common where lanes are the grid's rows: each is off by its
    /// tilt as a whole, and no number of its readings averages that out.
    fn set_lane_errors(&mut self) {
        let (mut common, mut count) = (0.0, 0.0);
        for (&range, &gain) in self.range.iter().zip(&self.gain) {
            if range > 0.0 {
                let range = f64::from(range);
                let own = self.errors.noise.variance(range) * (f64::from(gain) / range).powi(2);
                common += (1.0 - own).max(0.0);
                count += 1.0;
            }
        }
        let common = (common / f64::max(count, 1.0)).max(self.errors.common);
        let alike = 1.0 + common * (SEGMENT as f64 - 1.0);
        let errors = &mut self.lane_errors;
        (errors.common, errors.run) = (common, errors.run.max(alike));
        errors.patch = errors.patch.max(alike);
    }

    /// Lowers the gains by the errors of the angles of parallel lines, whose cells lie `next` apart from line
    /// to line and `within` apart in a line; `pitch_rad` is the usual angle between two.
    fn lower_gains(
        &mut self,
        sigmas_rad: &[f32],
        positions_rad: &[f32],
        (next, within): (usize, usize),
        pitch_rad: f32,
    ) {
        let lines = sigmas_rad.len();
        let reach = ((SLOPE_RAD / pitch_rad) as usize).clamp(1, MOST_LINES);
        for (line, &sigma_rad) in sigmas_rad.iter().enumerate() {
            if sigma_rad <= 0.0 {
                continue;
            }
            for place in 0..self.len() / lines {
                let cell = line * next + place * within;
                if !self.is_valid(cell) {
                    continue;
                }
                // The smaller of the slopes to both sides: an edge has one on one side. At the end of the
                // grid, or of what came back, that of the next stretch stands for the missing side.
                let slope_of = |a: usize, b: usize| {
                    if a.max(b) >= lines {
                        return f32::INFINITY;
                    }
                    let cells = [a, b].map(|line| line * next + place * within);
                    if cells.into_iter().any(|cell| !self.is_valid(cell)) {
                        return f32::INFINITY;
                    }
                    let rise = self.inverse[cells[1]] - self.inverse[cells[0]];
                    (rise / (positions_rad[b] - positions_rad[a])).abs()
                };
                let (before, after) = (line.wrapping_sub(reach), line + reach);
                let [back, ahead] = [slope_of(before, line), slope_of(line, after)];
                let slope = if back.is_infinite() {
                    ahead.min(slope_of(after, after + reach))
                } else if ahead.is_infinite() {
                    back.min(slope_of(before.wrapping_sub(reach), before))
                } else {
                    back.min(ahead)
                };
                let slope = slope * self.range[cell];
                let slope = if slope.is_finite() { slope.min(STEEPEST) } else { 0.0 };
                let error = slope * sigma_rad * self.gain[cell];
                self.gain[cell] /= (1.0 + error * error).sqrt();
            }
        }
    }

    /// The angle of each lane from the first in radians, as far as it can be told.
    fn lane_positions(&self) -> Vec<f32> {
        let mut samples = Vec::with_capacity(ANGLE_SAMPLES);
        let mut position = 0.0;
        let stride = self.steps.div_ceil(ANGLE_SAMPLES).max(1);
        let gaps = (1..self.lanes).map(|lane| {
            samples.clear();
            for step in (stride / 2..self.steps).step_by(stride) {
                let (a, b) = (step * self.lanes + lane - 1, step * self.lanes + lane);
                if self.is_valid(a) && self.is_valid(b) {
                    samples.push(self.chord(a, b));
                }
            }
            let gap = median(&mut samples).unwrap_or(self.across_rad);
            position += gap.max(0.05 * self.across_rad).max(1e-6);
            position
        });
        std::iter::once(0.0).chain(gaps).take(self.lanes).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::scan::PointGrid;
    use crate::segmentation::{SegmentationConfig, Segmenter, Shape};
    use nalgebra::Vector3;
    use rand_core::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    const HEIGHT_M: f64 = 0.6;
    const BEAMS: i32 = 65;
    const OFF: f64 = 0.04;

    /// A floor under a fan of uneven rows whose tilts are off by a share of their spacing, and the standard
    /// deviations of those.
    fn fan(seed: u64) -> (PointGrid, Vec<f32>) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut even =
            |half: f64| half * (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0);
        let mut points = Vec::new();
        let mut tilt_rad: f64 = 0.09;
        let mut sigmas = Vec::new();
        while tilt_rad < 0.78 {
            let spacing_rad = if tilt_rad < 0.13 { 0.008 } else { 0.036 };
            let error_rad = even(OFF * spacing_rad);
            sigmas.push((OFF * spacing_rad / 3_f64.sqrt()) as f32);
            for beam in -BEAMS..=BEAMS {
                let bearing = f64::from(beam).to_radians();
                let range = HEIGHT_M / ((tilt_rad + error_rad).sin() * bearing.cos());
                let range = range * (1.0 + even(0.001));
                let (along, aside) = (range * bearing.cos(), range * bearing.sin());
                let point = [along * tilt_rad.cos(), aside, -along * tilt_rad.sin()];
                points.push(point.map(|v| if range < 18.0 { v as f32 } else { f32::NAN }));
            }
            tilt_rad += spacing_rad;
        }
        (PointGrid::new(sigmas.len(), 2 * BEAMS as usize + 1, points), sigmas)
    }

    /// Largest plane: its share of the points, and the angle of its normal to the vertical.
    fn largest(grid: &PointGrid) -> (f64, f64) {
        let mut segmenter = Segmenter::new(SegmentationConfig::default());
        let result = segmenter.segment(grid);
        let largest = result.surfaces.iter().max_by_key(|surface| surface.points);
        let largest = largest.expect("a floor is a surface");
        let Shape::Plane(patch) = &largest.shape else { panic!("{:?}", largest.shape) };
        let valid = grid.points().iter().filter(|point| point[0].is_finite()).count();
        (largest.points as f64 / valid as f64, patch.plane().normal.angle(&Vector3::z()))
    }

    #[test]
    fn rows_that_are_off_by_more_than_the_ranges_are_of_one_floor() {
        const SEEDS: u64 = 6;
        let (mut known, mut unknown) = (0.0, 0.0);
        for seed in 0..SEEDS {
            let (grid, sigmas) = fan(seed);
            unknown += largest(&grid).0 / SEEDS as f64;
            let (share, angle_rad) = largest(&grid.with_row_sigmas(sigmas));
            assert!(angle_rad < 0.003, "seed {seed}: {angle_rad}");
            known += share / SEEDS as f64;
        }
        assert!(known > unknown + 0.1 && known > 0.95, "{known} beside {unknown}");
    }
}
