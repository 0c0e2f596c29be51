//! Ground between ground points: stretches and quads whose corners were measured in one scan.

use super::config::{RobotShape, TerrainConfig};
use super::fan::{Fan, Sample};
use super::ground::Labels;
use super::lattice::CellIndex;
use nalgebra::Point3;

/// Neighbouring beams nearer than this need no neighbours to agree with.
const SHORT_M: f64 = 0.20;
/// Slopes across agree within this, beyond their noise.
const SLOPE_SLACK: f64 = 0.06;

/// Calls `emit(cell, z_m, distance_m)` for each cell that lies on a seen stretch between two ground
/// points of one column or one row, or within a quad of two such columns and rows.
pub(super) fn fill(
    fan: &Fan,
    labels: &Labels,
    config: &TerrainConfig,
    shape: &RobotShape,
    mut emit: impl FnMut(CellIndex, f64, f64),
) {
    let columns = fan.columns.len();
    let across = across(fan, labels, config, shape);
    let raster = Raster { cell_m: config.cell_m };
    for at in 0..fan.samples.len() {
        let Sample::Hit { p, away_m } = fan.samples[at] else { continue };
        if !labels.ground[at] {
            continue;
        }
        let column = at % columns;
        let next = match usize::from(labels.next[at]) {
            0 => None,
            row => Some(row * columns + column),
        };
        if let Some(next) = next
            && let Some(q) = point(fan, next)
        {
            raster.segment(&p, &q, |cell, z| emit(cell, z, away_m));
        }
        if !across[at] {
            continue;
        }
        let Some(beside) = point(fan, at + 1) else { continue };
        raster.segment(&p, &beside, |cell, z| emit(cell, z, away_m));
        if let Some(next) = next
            && labels.next[at + 1] == labels.next[at]
            && across[next]
            && let (Some(q), Some(q_beside)) = (point(fan, next), point(fan, next + 1))
        {
            raster.triangle([&p, &q, &beside], |cell, z| emit(cell, z, away_m));
            raster.triangle([&beside, &q, &q_beside], |cell, z| emit(cell, z, away_m));
        }
    }
}

fn point(fan: &Fan, at: usize) -> Option<Point3<f64>> {
    match fan.samples[at] {
        Sample::Hit { p, .. } => Some(p),
        Sample::Nothing | Sample::Missing => None,
    }
}

/// For each sample, whether the stretch to the next beam of its row counts as seen.
fn across(fan: &Fan, labels: &Labels, config: &TerrainConfig, shape: &RobotShape) -> Vec<bool> {
    let columns = fan.columns.len();
    let tan_max = shape.max_slope_rad.tan();
    let mut across = vec![false; fan.samples.len()];
    // Per stretch of one row: length, slope, noise of the slope; `None` where an end is no ground.
    let mut stretches: Vec<Option<(f64, f64, f64)>> = vec![None; columns];
    for row in 0..fan.rows.len() {
        for (column, stretch) in stretches.iter_mut().take(columns.saturating_sub(1)).enumerate() {
            let at = row * columns + column;
            *stretch = match (&fan.samples[at], &fan.samples[at + 1]) {
                (Sample::Hit { p, away_m }, Sample::Hit { p: q, .. })
                    if labels.ground[at] && labels.ground[at + 1] =>
                {
                    let length_m = (q.x - p.x).hypot(q.y - p.y);
                    let sigma_m = config.relative_sigma_at(*away_m);
                    let slack_m = (3.5 * sigma_m).min(shape.max_step_m);
                    ((q.z - p.z).abs() <= tan_max * length_m + slack_m).then(|| {
                        let run_m = length_m.max(1e-3);
                        (length_m, (q.z - p.z) / run_m, 3.5 * sigma_m / run_m)
                    })
                }
                _ => None,
            };
        }
        for column in 0..columns.saturating_sub(1) {
            let Some((length_m, slope, noise)) = stretches[column] else { continue };
            let neighbours = [column.checked_sub(1), Some(column + 1)].map(|neighbour| {
                neighbour.and_then(|n| stretches.get(n).copied().flatten()).map(|s| s.1)
            });
            let slack = SLOPE_SLACK + noise;
            let agrees = match neighbours {
                [Some(a), Some(b)] => slope >= a.min(b) - slack && slope <= a.max(b) + slack,
                [Some(a), None] | [None, Some(a)] => (slope - a).abs() <= slack,
                [None, None] => false,
            };
            across[row * columns + column] =
                length_m <= SHORT_M || (length_m <= config.interpolate_across_m && agrees);
        }
    }
    across
}

struct Raster {
    cell_m: f64,
}

impl Raster {
    /// Cells along a segment, ends left out: they hold the measured points themselves.
    fn segment(&self, p: &Point3<f64>, q: &Point3<f64>, mut emit: impl FnMut(CellIndex, f64)) {
        let length_m = (q.x - p.x).hypot(q.y - p.y);
        // Steps of half a cell touch every cell that a substantial part of the segment crosses.
        let steps = (2.0 * length_m / self.cell_m).ceil() as i32;
        let first = CellIndex::at(p.x, p.y, self.cell_m);
        let end = CellIndex::at(q.x, q.y, self.cell_m);
        let mut before = first;
        for step in 1..steps {
            let t = f64::from(step) / f64::from(steps);
            let at = p + (q - p) * t;
            let cell = CellIndex::at(at.x, at.y, self.cell_m);
            if cell != before && cell != first && cell != end {
                emit(cell, at.z);
            }
            before = cell;
        }
    }

    /// Cells whose centre lies in a triangle, with the height of its plane there.
    fn triangle(&self, corners: [&Point3<f64>; 3], mut emit: impl FnMut(CellIndex, f64)) {
        let [a, b, c] = corners;
        let twice_area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if twice_area.abs() < 1e-9 {
            return;
        }
        let low = |u: f64, v: f64, w: f64| (u.min(v).min(w) / self.cell_m - 0.5).ceil() as i32;
        let high = |u: f64, v: f64, w: f64| (u.max(v).max(w) / self.cell_m - 0.5).floor() as i32;
        for y in low(a.y, b.y, c.y)..=high(a.y, b.y, c.y) {
            for x in low(a.x, b.x, c.x)..=high(a.x, b.x, c.x) {
                let cell = CellIndex { x, y };
                let [px, py] = cell.centre_m(self.cell_m);
                let u = ((px - a.x) * (c.y - a.y) - (py - a.y) * (c.x - a.x)) / twice_area;
                let v = ((b.x - a.x) * (py - a.y) - (b.y - a.y) * (px - a.x)) / twice_area;
                if u >= 0.0 && v >= 0.0 && u + v <= 1.0 {
                    emit(cell, a.z + u * (b.z - a.z) + v * (c.z - a.z));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_triangle_covers_the_centres_within_it_and_no_others(
            coordinates in prop::array::uniform6(-1.0_f64..1.0),
        ) {
            let [ax, ay, bx, by, cx, cy] = coordinates;
            let plane = |x: f64, y: f64| 0.3 * x - 0.2 * y + 1.0;
            let corners = [(ax, ay), (bx, by), (cx, cy)].map(|(x, y)| Point3::new(x, y, plane(x, y)));
            let mut covered = Vec::new();
            Raster { cell_m: 0.05 }.triangle([&corners[0], &corners[1], &corners[2]], |cell, z| {
                covered.push((cell, z));
            });
            let side = |p: &Point3<f64>, q: &Point3<f64>, x: f64, y: f64| {
                (q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)
            };
            for (cell, z) in &covered {
                let [x, y] = cell.centre_m(0.05);
                prop_assert!((z - plane(x, y)).abs() < 1e-6);
            }
            for x in -21..21 {
                for y in -21..21 {
                    let cell = CellIndex { x, y };
                    let [px, py] = cell.centre_m(0.05);
                    let sides = [
                        side(&corners[0], &corners[1], px, py),
                        side(&corners[1], &corners[2], px, py),
                        side(&corners[2], &corners[0], px, py),
                    ];
                    let inside = sides.iter().all(|s| *s > 1e-9) || sides.iter().all(|s| *s < -1e-9);
                    let outside = sides.iter().any(|s| *s > 1e-9) && sides.iter().any(|s| *s < -1e-9);
                    let found = covered.iter().any(|(other, _)| *other == cell);
                    let area = side(&corners[0], &corners[1], corners[2].x, corners[2].y);
                    prop_assert!(!inside || found || area.abs() < 1e-8);
                    prop_assert!(!outside || !found);
                }
            }
        }
    }
}
