//! The laser as its own tilt meter: at which tilt was this line taken, judged by lines of known tilt?

use crate::scan::{LaserLine, RangeImage, Return};
use serde::{Deserialize, Serialize};

/// Lines of one place under known tilts, to compare other lines of the same place with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltReference {
    tilts_rad: Vec<f64>,
    beams: usize,
    /// Inverse ranges in 1/m, row by row; NaN where a beam hit nothing.
    inverse: Vec<f64>,
}

/// A tilt found by comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltFix {
    /// Tilt in radians.
    pub tilt_rad: f64,
    /// Its standard deviation in radians.
    pub sigma_rad: f64,
}

/// Neighbouring rows that differ by more than this (in the logarithm of the range) saw different
/// surfaces, between which nothing can be interpolated.
const SAME_SURFACE: f64 = 0.2;
/// Relative range noise: USARSim's ±0.1 % evenly spread, and a floor for what interpolation leaves.
const NOISE: f64 = 8e-4;
/// Residuals beyond this many deviations count as much and no more: edges, other robots.
const CUT: f64 = 4.0;
/// Fewest beams that make a fix.
const FEWEST_BEAMS: usize = 12;
/// A fix less certain than this is none.
const WORST_SIGMA_RAD: f64 = 0.0018;

impl TiltReference {
    /// The rows of a scan taken at rest, sorted by tilt; gaps are left out. `None` with fewer than two.
    pub fn of(image: &RangeImage) -> Option<Self> {
        let mut rows: Vec<usize> =
            (0..image.rows().len()).filter(|&row| image.rows()[row].stamp.is_some()).collect();
        rows.sort_by(|&a, &b| image.rows()[a].tilt_rad.total_cmp(&image.rows()[b].tilt_rad));
        rows.dedup_by(|&mut a, &mut b| image.rows()[a].tilt_rad == image.rows()[b].tilt_rad);
        if rows.len() < 2 {
            return None;
        }
        let beams = image.columns();
        let inverse = rows
            .iter()
            .flat_map(|&row| (0..beams).map(move |beam| image.at(row, beam)))
            .map(|seen| match seen {
                Return::Hit(range) => 1.0 / range,
                Return::Nothing | Return::Missing => f64::NAN,
            })
            .collect();
        let tilts_rad = rows.iter().map(|&row| image.rows()[row].tilt_rad).collect();
        Some(Self { tilts_rad, beams, inverse })
    }

    /// Lowest and highest tilt of the reference, in radians.
    pub fn span_rad(&self) -> (f64, f64) {
        (self.tilts_rad[0], self.tilts_rad[self.tilts_rad.len() - 1])
    }

    /// The tilt at which `line` was taken, if it was taken from the same place within the reference's
    /// span and what it sees tells tilts apart.
    pub fn fix(&self, line: &LaserLine) -> Option<TiltFix> {
        if line.len() != self.beams {
            return None;
        }
        let logs: Vec<Option<f64>> = (0..line.len())
            .map(|beam| match line.classify(beam) {
                Return::Hit(range) => Some(range.ln()),
                Return::Nothing | Return::Missing => None,
            })
            .collect();
        let (low, high) = self.span_rad();
        const COARSE_RAD: f64 = 0.001;
        let steps = ((high - low) / COARSE_RAD).ceil() as usize;
        let at = |i: usize| low + (high - low) * i as f64 / steps as f64;
        // The valley of the true noise is narrower than any affordable grid: the search begins with a
        // noise that widens it to a grid step, and sharpens.
        let costs: Vec<f64> =
            (0..=steps).map(|i| self.fit(&logs, at(i), 16.0 * NOISE).cost).collect();
        let best = (0..=steps).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
        // Where another tilt, well away, fits about as well, the place does not tell them apart.
        const APART_RAD: f64 = 0.009;
        const CLEARLY: f64 = 0.4;
        let ambiguous = (0..=steps)
            .any(|i| (at(i) - at(best)).abs() > APART_RAD && costs[i] < costs[best] + CLEARLY);
        if !costs[best].is_finite() || ambiguous {
            return None;
        }
        let mut tilt_rad = at(best);
        for widening in [16.0, 8.0, 4.0, 2.0, 1.0, 1.0, 1.0] {
            let fit = self.fit(&logs, tilt_rad, widening * NOISE);
            let step = (-fit.gradient / fit.curvature.max(1e-12)).clamp(-COARSE_RAD, COARSE_RAD);
            tilt_rad = (tilt_rad + step).clamp(low, high);
        }
        let fit = self.fit(&logs, tilt_rad, NOISE);
        // The cost is in units of the supposed noise; a worse fit makes a less certain tilt.
        let sigma_rad = (fit.cost.max(1.0) / fit.curvature).sqrt();
        // At either end the true tilt may lie beyond.
        let inside = tilt_rad > low && tilt_rad < high;
        (inside && fit.cost < 0.25 * CUT * CUT && sigma_rad < WORST_SIGMA_RAD)
            .then_some(TiltFix { tilt_rad, sigma_rad })
    }

    /// How well `logs` fit the reference at `tilt_rad`, supposing a relative `noise`.
    fn fit(&self, logs: &[Option<f64>], tilt_rad: f64, noise: f64) -> Fit {
        let last = self.tilts_rad.len() - 1;
        let upper = self.tilts_rad.partition_point(|&tilt| tilt <= tilt_rad).clamp(1, last);
        let (t0, t1) = (self.tilts_rad[upper - 1], self.tilts_rad[upper]);
        let share = (tilt_rad - t0) / (t1 - t0);
        let row = |index: usize| &self.inverse[index * self.beams..(index + 1) * self.beams];
        let (mut sum, mut gradient, mut curvature, mut used) = (0.0, 0.0, 0.0, 0_usize);
        for ((&u0, &u1), log) in row(upper - 1).iter().zip(row(upper)).zip(logs) {
            let Some(log) = log else { continue };
            // NaN in either row fails the comparison and leaves the beam out.
            let same = (u0 / u1).ln().abs() < SAME_SURFACE;
            if !same {
                continue;
            }
            used += 1;
            let u = u0 + share * (u1 - u0);
            let residual = (log + u.ln()) / noise;
            if residual.abs() >= CUT {
                sum += CUT * CUT;
                continue;
            }
            let slope = (u1 - u0) / (t1 - t0) / u / noise;
            sum += residual * residual;
            gradient += residual * slope;
            curvature += slope * slope;
        }
        let hits = logs.iter().flatten().count();
        let enough = used >= FEWEST_BEAMS && 3 * used >= hits;
        let cost = if enough { sum / used as f64 } else { f64::INFINITY };
        Fit { cost, gradient, curvature }
    }
}

struct Fit {
    /// Mean squared residual in deviations, cut; infinite if too few beams can be compared.
    cost: f64,
    /// Half the derivative of the summed squares by the tilt.
    gradient: f64,
    /// Its Gauss-Newton curvature.
    curvature: f64,
}

#[cfg(test)]
mod tests {
    use super::super::testbed::{World, head, line_at};
    use super::*;
    use crate::robot::HeadPose;
    use crate::scan::ImageRow;
    use crate::time::Stamp;
    use nalgebra::Isometry3;

    fn reference(world: &World, from_deg: f64, rows: usize) -> TiltReference {
        let lines: Vec<_> = (0..rows)
            .map(|i| {
                let tilt = (from_deg + i as f64).to_radians();
                (tilt, line_at(world, &head(None, None), HeadPose::tilted(tilt), 1.0))
            })
            .collect();
        let first = &lines[0].1;
        let bearings = (0..first.len()).map(|i| first.bearing_rad(i)).collect();
        let mut image = RangeImage::new(Isometry3::identity(), bearings, 20.0);
        for (tilt_rad, line) in &lines {
            let row = ImageRow {
                tilt_rad: *tilt_rad,
                tilt_sigma_rad: 0.0,
                scan_from_sensor: Isometry3::identity(),
                stamp: Some(Stamp(1)),
            };
            image.push_line(row, line);
        }
        TiltReference::of(&image).unwrap()
    }

    #[test]
    fn ground_and_walls_tell_the_tilt_to_a_few_hundredths_of_a_degree() {
        let world = World::default();
        let reference = reference(&world, 6.0, 9);
        for i in 1..40 {
            let truth = (6.0 + 0.19 * f64::from(i)).to_radians();
            // The noise of the last digit, different for every line.
            let line = line_at(
                &world,
                &head(None, None),
                HeadPose::tilted(truth),
                1.0 + 4e-4 * truth.sin(),
            );
            let fix = reference.fix(&line).unwrap();
            let error = (fix.tilt_rad - truth).to_degrees();
            assert!(error.abs() < 0.03, "{error}° at {}°", truth.to_degrees());
            assert!(fix.sigma_rad < 0.001);
        }
    }

    #[test]
    fn a_line_beyond_the_span_or_of_another_place_gives_no_fix() {
        let world = World::default();
        let reference = reference(&world, 6.0, 9);
        let at = |world: &World, deg: f64| {
            line_at(world, &head(None, None), HeadPose::tilted(f64::to_radians(deg)), 1.0)
        };
        assert_eq!(reference.fix(&at(&world, 20.0)), None);
        let elsewhere = World { room: [2.0, 1.0], ..World::default() };
        assert_eq!(reference.fix(&at(&elsewhere, 9.0)), None);
    }

    #[test]
    fn a_place_that_looks_the_same_under_all_tilts_gives_no_fix() {
        let mut reference = reference(&World::default(), 6.0, 9);
        reference.inverse.fill(0.25);
        let mut line = line_at(&World::default(), &head(None, None), HeadPose::tilted(0.15), 1.0);
        line.ranges_m.fill(4.0);
        assert_eq!(reference.fix(&line), None);
    }
}
