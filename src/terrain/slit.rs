//! Slits in the ground, too narrow to be missed as ground that is due and wide enough to take a
//! wheel: between a platform and a train, beside a buffer, along a rail.
//!
//! Seen from a robot's height a slit is hardly a gap in the rows. A ray that enters it ends on its far
//! side, a few centimetres below the ground, and the rays above climb that side. That climb is what
//! tells it from a slope, a step down or noise, and its neighbours on either side must show it too.

use super::config::{RobotShape, TerrainConfig};
use super::fan::{Fan, FloorPlane, Sample};
use super::ground::{Labels, Missing};
use nalgebra::{Point3, Vector3};

/// Ground before the slit over which its slope is taken, in metres, and what the least may be.
const TREND_M: f64 = 0.5;
const LEAST_TREND_M: f64 = 0.12;
/// Points that a slope is taken from, at least.
const LEAST_POINTS: usize = 4;
/// The far side rises within this, in metres: ground that does so is steeper than any robot climbs.
const SIDE_M: f64 = 0.05;
/// No wheel enters what is narrower than the first; what is wider than the second is judged as ground that
/// is missing.
const NARROWEST_M: f64 = 0.06;
const WIDEST_M: f64 = 0.5;
/// A point is lower than the ground before it beyond this, and this many times what that scatters by.
const DEEP_M: f64 = 0.012;
const DEEP_SCATTERS: f64 = 4.0;
/// Slits of neighbouring columns belong together within this, in metres.
const BESIDE_M: f64 = 0.2;
/// Columns in a row that must show the slit.
const COLUMNS: usize = 3;

/// A slit as one column shows it.
#[derive(Clone, Copy)]
struct Slit {
    /// Row and place of the last ground before it.
    near_row: usize,
    near: Point3<f64>,
    /// Rows of the points on its far side, first and last, and the place of the first at the
    /// height of the ground.
    side: (usize, usize),
    far: Point3<f64>,
}

/// Finds slits, takes the points on their far sides out of the ground and adds each to what is
/// missing.
pub(super) fn find(
    fan: &Fan,
    floor: &FloorPlane,
    config: &TerrainConfig,
    shape: &RobotShape,
    labels: &mut Labels,
) {
    let columns = fan.columns.len();
    let seen: Vec<Vec<Slit>> = (0..columns)
        .map(|column| Column { fan, floor, config, shape, column }.slits(labels))
        .collect();
    for column in 0..columns {
        for slit in seen[column].iter().filter(|slit| is_shared(&seen, column, slit)) {
            labels.next[slit.near_row * columns + column] = 0;
            for row in slit.side.0..=slit.side.1 {
                labels.ground[row * columns + column] = false;
                labels.next[row * columns + column] = 0;
            }
            labels.missing.push(Missing { from: slit.near, to: slit.far, proven: true });
        }
    }
}

/// Whether enough columns in a row show the slit, this one among them.
fn is_shared(seen: &[Vec<Slit>], column: usize, slit: &Slit) -> bool {
    let follow = |columns: &mut dyn Iterator<Item = usize>| -> usize {
        let mut at = slit.far;
        let mut count = 0;
        for column in columns {
            let Some(next) = seen[column].iter().find(|other| (other.far - at).norm() < BESIDE_M)
            else {
                break;
            };
            at = next.far;
            count += 1;
        }
        count
    };
    let below = follow(&mut (0..column).rev().take(COLUMNS - 1));
    let above = follow(&mut (column + 1..seen.len()).take(COLUMNS - 1));
    1 + below + above >= COLUMNS
}

/// The ground before a place.
#[derive(Clone, Copy)]
struct Trend {
    slope: f64,
    /// What a point must be lower by to be below it, in metres.
    noise_m: f64,
}

struct Column<'a> {
    fan: &'a Fan,
    floor: &'a FloorPlane,
    config: &'a TerrainConfig,
    shape: &'a RobotShape,
    column: usize,
}

impl Column<'_> {
    fn slits(&self, labels: &Labels) -> Vec<Slit> {
        let mut slits = Vec::new();
        let mut before: Vec<(f64, f64)> = Vec::new();
        let mut last: Option<(usize, Point3<f64>, f64)> = None;
        let mut row = 0;
        while row < self.fan.rows.len() {
            let (p, away_m) = match *self.fan.sample(row, self.column) {
                Sample::Hit { p, away_m } => (p, away_m),
                Sample::Missing => {
                    row += 1;
                    continue;
                }
                Sample::Nothing => {
                    last = None;
                    row += 1;
                    continue;
                }
            };
            if away_m > self.config.ground_range_m {
                break;
            }
            if let Some((near_row, near, near_away_m)) = last
                && let Some(trend) = self.trend(&before, &near)
                && let Some(slit) = self.slit(near_row, near, near_away_m, trend, row)
            {
                row = slit.side.1 + 1;
                slits.push(slit);
                before.clear();
                last = None;
                continue;
            }
            if labels.ground[row * self.fan.columns.len() + self.column] {
                before.push((away_m, p.z));
                before.retain(|(before_m, _)| (away_m - before_m).abs() <= TREND_M);
                last = Some((row, p, away_m));
            } else {
                before.clear();
                last = None;
            }
            row += 1;
        }
        slits
    }

    /// The ground up to its last point.
    fn trend(&self, before: &[(f64, f64)], last: &Point3<f64>) -> Option<Trend> {
        let (first_m, last_m) = (before.first()?.0, before.last()?.0);
        if before.len() < LEAST_POINTS || last_m - first_m < LEAST_TREND_M {
            let noise_m = 2.5 * self.config.relative_sigma_at(last_m);
            let on_floor = (last.z - self.floor.z_at(last.x, last.y)).abs() < noise_m;
            return on_floor.then(|| Trend { slope: self.floor.slope(&self.along(last)), noise_m });
        }
        let count = before.len() as f64;
        let sum = before.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
        let mean = (sum.0 / count, sum.1 / count);
        let (mut xx, mut xz, mut zz) = (0.0, 0.0, 0.0);
        for (x, z) in before {
            xx += (x - mean.0).powi(2);
            xz += (x - mean.0) * (z - mean.1);
            zz += (z - mean.1).powi(2);
        }
        let slope = xz / xx.max(1e-9);
        let scatter_m = ((zz - slope * xz).max(0.0) / (count - 2.0)).sqrt();
        Some(Trend { slope, noise_m: DEEP_M.max(DEEP_SCATTERS * scatter_m) })
    }

    fn along(&self, p: &Point3<f64>) -> Vector3<f64> {
        let origin = self.fan.rows[self.fan.rows.len() / 2].origin;
        let flat = Vector3::new(p.x - origin.x, p.y - origin.y, 0.0);
        flat / flat.norm().max(1e-9)
    }

    /// The slit that begins behind `near`, if the point of `row` lies on its far side.
    fn slit(
        &self,
        near_row: usize,
        near: Point3<f64>,
        near_away_m: f64,
        trend: Trend,
        row: usize,
    ) -> Option<Slit> {
        let Sample::Hit { p, away_m } = *self.fan.sample(row, self.column) else { return None };
        let gap_m = away_m - near_away_m;
        let Trend { slope, noise_m } = trend;
        let deep_m = near.z + slope * gap_m - p.z;
        if !(NARROWEST_M..WIDEST_M).contains(&gap_m)
            || deep_m < noise_m
            || !self.fan.aligned(near_row, row)
        {
            return None;
        }
        // The rows above climb the far side, steeper than is driven.
        let climbed_m = noise_m.max(1.2 * self.shape.max_slope_rad.tan() * SIDE_M);
        let mut last = None;
        for above in row + 1..self.fan.rows.len() {
            match *self.fan.sample(above, self.column) {
                Sample::Missing => {}
                Sample::Nothing => break,
                Sample::Hit { p: q, away_m: q_away_m } => {
                    if (q_away_m - away_m).abs() > SIDE_M {
                        break;
                    }
                    if q.z - p.z >= climbed_m {
                        last = Some(above);
                        break;
                    }
                }
            }
        }
        let top = last?;
        // The point that has climbed it may be ground of the far side already.
        let side = (row, top - 1);
        let far = Point3::new(p.x, p.y, near.z + slope * gap_m);
        Some(Slit { near_row, near, side, far })
    }
}
