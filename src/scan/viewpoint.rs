//! Where a scan was made from, told by its points alone: a cloud may have been moved since.
//!
//! Seen from there, directions turn evenly from one reading of a line to the next, whatever lies at their
//! ends: the beams of a scanner know nothing of depth. Seen from elsewhere every edge bends the line of
//! directions, and so does the noise of ranges. The viewpoint is where the third differences of successive
//! directions are least; second ones would be those of a camera's pixels, too, which lie even in its image and
//! not in angle.
//!
//! The lines of a scanner, rows or columns, lie in planes through it, and the planes of a nodding laser or of
//! a camera meet in one axis: along this axis the search begins.

use super::PointGrid;
use nalgebra::{Matrix3, Point3, Vector3};

/// Most runs of four neighbours that are looked at, and that the search along the axis looks at.
const RUNS: usize = 4000;
const RUNS_ALONG: usize = 200;
/// Fewest that tell anything.
const FEWEST_RUNS: usize = 50;
/// Most points that tell a line's plane, and the fewest.
const POINTS_PER_LINE: usize = 64;
const FEWEST_PER_LINE: usize = 8;
/// A run spans three times this share of its line: neighbours lie closer together than noise across the beams,
/// or the rounding of coordinates, lets directions be known.
const STRIDES_PER_LINE: usize = 32;
/// Share of the runs that bend less than what is told of all: those over edges of depth bend most from elsewhere.
const USUAL: f64 = 0.8;
/// How much straighter the directions must be from another point than from the origin before that is taken
/// for the viewpoint: real scanners are a little uneven from wherever they are seen.
const STRAIGHTER: f64 = 2.0;
/// Points along the axis that are tried, over so many root mean squares of the cloud's extent to either side.
const ALONG: u32 = 120;
const REACH: f64 = 3.0;
/// A viewpoint farther away, in the same measure, would be that of parallel beams.
const TOO_FAR: f64 = 10.0;
/// Rounds of the refinement, and the step in metres that ends it.
const ROUNDS: usize = 30;
const CONVERGED_M: f64 = 1e-6;
/// Least bend that is told, in radians for each radian between the neighbours: that of 32-bit floats.
const LEAST_BEND: f64 = 1e-7;

/// The point that an organised cloud was made from, where its points tell that it is not the frame's origin.
pub fn viewpoint(grid: &PointGrid) -> Option<Point3<f64>> {
    let found = [Lines::Rows, Lines::Columns].into_iter().filter_map(|lines| {
        let runs = runs(grid, lines);
        let axis = Axis::of_lines(grid, lines)?;
        let few: Vec<Run> =
            runs.iter().step_by(runs.len().div_ceil(RUNS_ALONG).max(1)).copied().collect();
        let (start, bend) = axis.straightest(&few)?;
        let as_told = usual_bend(&few, &Vector3::zeros());
        // Beside a viewpoint even a step along the axis bends directions by more.
        if as_told <= bend {
            return Some((as_told, None));
        }
        let point = refined(&runs, start);
        let is_near = (point - axis.middle).norm() < TOO_FAR * axis.extent_m;
        let bend = usual_bend(&runs, &point);
        let as_told = usual_bend(&runs, &Vector3::zeros());
        is_near.then_some((bend, (bend * STRAIGHTER < as_told).then_some(Point3::from(point))))
    });
    // Which lines bend least says which way the scanner's run, and whether from the origin.
    found.min_by(|a, b| a.0.total_cmp(&b.0))?.1
}

/// Which way the lines of a grid run.
#[derive(Clone, Copy, Debug)]
enum Lines {
    Rows,
    Columns,
}

impl Lines {
    /// Number of lines and of places in each.
    fn size(self, grid: &PointGrid) -> (usize, usize) {
        match self {
            Self::Rows => (grid.rows(), grid.columns()),
            Self::Columns => (grid.columns(), grid.rows()),
        }
    }

    fn point(self, grid: &PointGrid, line: usize, place: usize) -> Option<Vector3<f64>> {
        let (row, column) = match self {
            Self::Rows => (line, place),
            Self::Columns => (place, line),
        };
        grid.point(row, column).map(|point| point.coords)
    }
}

/// Four neighbours in a line.
type Run = [Vector3<f64>; 4];
/// Weights of their third difference.
const THIRD: [f64; 4] = [1.0, -3.0, 3.0, -1.0];

fn runs(grid: &PointGrid, lines: Lines) -> Vec<Run> {
    let (count, length) = lines.size(grid);
    let stride = length.div_ceil(STRIDES_PER_LINE).max(1);
    let places = length.saturating_sub(3 * stride);
    // Steps that are no divisor of the length do not keep to the same places.
    let step = (count * places).div_ceil(RUNS).max(1);
    let step = if step > 1 && places.is_multiple_of(step) { step + 1 } else { step };
    let run = |cell: usize| {
        let at = |k: usize| lines.point(grid, cell / places, cell % places + k * stride);
        Some([at(0)?, at(1)?, at(2)?, at(3)?])
    };
    (0..count * places).step_by(step).filter_map(run).collect()
}

/// How the directions of a run bend, as seen from a point.
struct Bend {
    /// Their third difference, across the middle one.
    across: Vector3<f64>,
    /// Distance of the outer directions.
    chord: f64,
    middle: Vector3<f64>,
    directions: [Vector3<f64>; 4],
    ranges_m: [f64; 4],
}

impl Bend {
    /// `None` for a point at one of the four, or from which they are one.
    fn seen_from(run: &Run, from: &Vector3<f64>) -> Option<Self> {
        let rays = run.map(|point| point - from);
        let ranges_m = rays.map(|ray| ray.norm());
        if ranges_m.iter().any(|range_m| *range_m < 1e-6) {
            return None;
        }
        let directions: [Vector3<f64>; 4] = std::array::from_fn(|k| rays[k] / ranges_m[k]);
        let third: Vector3<f64> = std::iter::zip(THIRD, directions).map(|(w, u)| u * w).sum();
        let middle = (directions[1] + directions[2]).try_normalize(1e-9)?;
        let across = third - middle * middle.dot(&third);
        let chord = (directions[3] - directions[0]).norm();
        (chord > 1e-9).then_some(Self { across, chord, middle, directions, ranges_m })
    }

    /// In radians for each radian between the neighbours.
    fn size(&self) -> f64 {
        self.across.norm() / self.chord
    }

    /// Derivative of `across` by the point that it is seen from.
    fn jacobian(&self) -> Matrix3<f64> {
        let terms = THIRD.into_iter().zip(self.directions).zip(self.ranges_m);
        let sum: Matrix3<f64> = terms
            .map(|((weight, u), range_m)| {
                (u * u.transpose() - Matrix3::identity()) * (weight / range_m)
            })
            .sum();
        sum - self.middle * (self.middle.transpose() * sum)
    }
}

/// The bend that all but the most bent runs stay below.
fn usual_bend(runs: &[Run], from: &Vector3<f64>) -> f64 {
    let mut sizes: Vec<f64> =
        runs.iter().filter_map(|run| Some(Bend::seen_from(run, from)?.size())).collect();
    if sizes.len() < FEWEST_RUNS.min(runs.len()) || sizes.is_empty() {
        return f64::INFINITY;
    }
    let usual = (USUAL * sizes.len() as f64) as usize;
    *sizes.select_nth_unstable_by(usual, f64::total_cmp).1
}

/// The line that the planes of a scanner's lines meet in.
struct Axis {
    /// Centre of gravity of the points.
    middle: Vector3<f64>,
    /// Root mean square of their distance from it, in metres.
    extent_m: f64,
    /// The axis' point that is nearest to it.
    foot: Vector3<f64>,
    direction: Vector3<f64>,
}

impl Axis {
    fn of_lines(grid: &PointGrid, lines: Lines) -> Option<Self> {
        let (count, length) = lines.size(grid);
        let step = length.div_ceil(POINTS_PER_LINE).max(1);
        let line = |line| {
            let places = (0..length).step_by(step);
            places.filter_map(move |place| lines.point(grid, line, place))
        };
        let all = || (0..count).flat_map(line);
        let points = all().count();
        let middle = all().sum::<Vector3<f64>>() / points as f64;
        let extent_m =
            (all().map(|p| (p - middle).norm_squared()).sum::<f64>() / points as f64).sqrt();
        let (mut normals, mut offsets) = (Matrix3::zeros(), Vector3::zeros());
        for index in 0..count {
            let (points, mean) = (line(index).count(), line(index).sum::<Vector3<f64>>());
            if points < FEWEST_PER_LINE {
                continue;
            }
            let mean = mean / points as f64;
            let scatter: Matrix3<f64> =
                line(index).map(|p| (p - mean) * (p - mean).transpose()).sum();
            let eigen = scatter.symmetric_eigen();
            let mut order = [0, 1, 2];
            order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
            let [least, next] = [order[0], order[1]].map(|k| eigen.eigenvalues[k].max(0.0));
            let normal = eigen.eigenvectors.column(order[0]);
            // A straight line of points lies in many planes.
            let weight = next / (least + 1e-6 * next + 1e-12);
            normals += normal * normal.transpose() * weight;
            offsets += normal * (normal.dot(&(mean - middle)) * weight);
        }
        let eigen = normals.symmetric_eigen();
        let along = eigen.eigenvalues.imin();
        let foot = (0..3).filter(|k| *k != along).map(|k| {
            let axis: Vector3<f64> = eigen.eigenvectors.column(k).into();
            axis * (axis.dot(&offsets) / eigen.eigenvalues[k])
        });
        let foot = middle + foot.sum::<Vector3<f64>>();
        let direction = eigen.eigenvectors.column(along).into();
        let is_told = extent_m > 0.0 && foot.iter().all(|v: &f64| v.is_finite());
        is_told.then_some(Self { middle, extent_m, foot, direction })
    }

    /// The point along the axis from which the runs bend least, and by how much.
    fn straightest(&self, runs: &[Run]) -> Option<(Vector3<f64>, f64)> {
        if runs.len() < FEWEST_RUNS {
            return None;
        }
        let place = |k: u32| {
            let share = 2.0 * f64::from(k) / f64::from(ALONG) - 1.0;
            self.foot + self.direction * (share * REACH * self.extent_m)
        };
        let bends = (0..=ALONG).map(|k| (place(k), usual_bend(runs, &place(k))));
        bends.min_by(|a, b| a.1.total_cmp(&b.1))
    }
}

/// Where the runs bend least about a start: Levenberg and Marquardt's steps, with weights by which what
/// bends more than usual, such as a line that was put together of two, counts little.
fn refined(runs: &[Run], start: Vector3<f64>) -> Vector3<f64> {
    let mut point = start;
    let mut damping = 1e-3;
    for _ in 0..ROUNDS {
        let usual = 1.5 * usual_bend(runs, &point).max(LEAST_BEND);
        let cost = |from: &Vector3<f64>| -> f64 {
            let bends = runs.iter().map(|t| {
                let share = Bend::seen_from(t, from).map_or(1e3, |bend| bend.size() / usual);
                share * share / (1.0 + share * share)
            });
            bends.sum()
        };
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for bend in runs.iter().filter_map(|t| Bend::seen_from(t, &point)) {
            let share = bend.size() / usual;
            let weight = ((1.0 + share * share) * bend.chord).powi(-2);
            let jacobian = bend.jacobian();
            normal += jacobian.transpose() * jacobian * weight;
            right += jacobian.transpose() * bend.across * weight;
        }
        let before = cost(&point);
        let step = std::iter::repeat_with(|| {
            let damped = normal + Matrix3::from_diagonal(&(normal.diagonal() * damping));
            let step = damped.try_inverse().map(|inverse| -(inverse * right));
            damping *= 8.0;
            step
        });
        let better = step.take(8).flatten().find(|step| cost(&(point + step)) <= before);
        let Some(step) = better else { break };
        damping = (damping / 40.0).max(1e-9);
        point += step;
        if step.norm() < CONVERGED_M {
            break;
        }
    }
    point
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, UnitQuaternion};

    /// Range along a direction to a room's walls or to a pillar in it, with noise of 10 mm.
    fn range_m(u: &Vector3<f64>, noise: &mut u32) -> f64 {
        let (low, high) = (Vector3::new(-3.0, -2.0, -0.6), Vector3::new(4.0, 3.0, 2.0));
        let wall = (0..3)
            .map(|k| (if u[k] > 0.0 { high[k] } else { low[k] }) / u[k].abs() * u[k].signum());
        let wall = wall.fold(f64::INFINITY, f64::min);
        let is_pillar = (u.y.atan2(u.x) - 0.3).abs() < 0.15 && u.z < 0.3;
        *noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let jitter = f64::from(*noise >> 8) / f64::from(1_u32 << 24) - 0.5;
        0.035 * jitter + if is_pillar { 1.5 } else { wall }
    }

    fn cloud(directions: &[Vec<Vector3<f64>>], moved: &Isometry3<f64>) -> PointGrid {
        let mut noise = 7;
        let point = |u: &Vector3<f64>| {
            let point = moved * Point3::from(u * range_m(u, &mut noise));
            point.coords.map(|v| v as f32).into()
        };
        let points: Vec<[f32; 3]> = directions.iter().flatten().map(point).collect();
        PointGrid::new(directions.len(), directions[0].len(), points)
    }

    /// Beams 2° apart under tilts 1° apart, as of a nodding laser.
    fn nodding() -> Vec<Vec<Vector3<f64>>> {
        let tilts = (0..50).map(|i| (f64::from(i) - 25.0).to_radians());
        let row = |tilt: f64| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt);
            let bearings = (0..60).map(|k| (2.0 * f64::from(k) - 59.0).to_radians());
            bearings.map(|b| turn * Vector3::new(b.cos(), b.sin(), 0.0)).collect()
        };
        tilts.map(row).collect()
    }

    /// Those of a camera that looks along x.
    fn pinhole() -> Vec<Vec<Vector3<f64>>> {
        let pixel = |i: u32| (f64::from(i) - 29.5) / 40.0;
        let row = |i| (0..60).map(move |k| Vector3::new(1.0, pixel(k), pixel(i)).normalize());
        (0..60).map(|i| row(i).collect()).collect()
    }

    /// Those of a spinning scanner: each row is a cone.
    fn spinning() -> Vec<Vec<Vector3<f64>>> {
        let row = |i: u32| {
            let (sin, cos) = (f64::from(i) - 12.0).to_radians().sin_cos();
            let turns = (0..120).map(|k| (3.0 * f64::from(k) + 0.5).to_radians());
            turns.map(|a| Vector3::new(cos * a.cos(), cos * a.sin(), sin)).collect()
        };
        (0..24).map(row).collect()
    }

    #[test]
    fn a_scan_that_was_moved_tells_where_it_was_made() {
        for (name, directions) in
            [("nodding", nodding()), ("pinhole", pinhole()), ("spinning", spinning())]
        {
            for [x, y, yaw] in
                [[0.4, -0.2, 0.1], [-1.0, 0.7, -0.5], [6.0, 3.0, 2.0], [0.0, -15.0, -3.0]]
            {
                let turn = UnitQuaternion::from_euler_angles(0.05, -0.1, yaw);
                let moved = Isometry3::from_parts(Vector3::new(x, y, 0.3).into(), turn);
                let found = viewpoint(&cloud(&directions, &moved));
                let off_m = found.map(|p| (p.coords - moved.translation.vector).norm());
                assert!(off_m.is_some_and(|off_m| off_m < 1e-3), "{name} {x} {y}: {off_m:?}");
            }
        }
    }

    #[test]
    fn coordinates_written_with_three_decimals_tell_it_to_millimetres() {
        for (name, directions) in [("nodding", nodding()), ("spinning", spinning())] {
            for moved in [Isometry3::translation(0.5, -0.3, 0.1), Isometry3::identity()] {
                let grid = cloud(&directions, &moved);
                let rounded = grid.points().iter().map(|p| p.map(|v| (1e3 * v).round() / 1e3));
                let found =
                    viewpoint(&PointGrid::new(grid.rows(), grid.columns(), rounded.collect()));
                let off_m = (found.unwrap_or_default().coords - moved.translation.vector).norm();
                assert!(off_m < 5e-3, "{name} {moved}: {found:?}");
            }
        }
    }

    #[test]
    fn a_scan_in_the_frame_of_its_sensor_is_left_alone() {
        let turned = UnitQuaternion::from_euler_angles(0.3, 0.2, -1.0);
        for directions in [nodding(), pinhole(), spinning()] {
            for turn in [UnitQuaternion::identity(), turned] {
                let moved = Isometry3::from_parts(Vector3::zeros().into(), turn);
                assert_eq!(viewpoint(&cloud(&directions, &moved)), None);
            }
        }
    }

    #[test]
    fn what_no_scanner_made_has_no_viewpoint() {
        // Heights over a level grid: beams that never meet.
        let height = |i: u16, k: u16| if (i / 7 + k / 9).is_multiple_of(2) { 0.5 } else { -0.2 };
        let cell = |i, k| [f32::from(i) * 0.05, f32::from(k) * 0.05, height(i, k)];
        let level = (0..60).flat_map(|i| (0..60).map(move |k| cell(i, k)));
        assert_eq!(viewpoint(&PointGrid::new(60, 60, level.collect())), None);
        for point in [[f32::NAN; 3], [0.0; 3], [1.0, 2.0, 3.0]] {
            assert_eq!(viewpoint(&PointGrid::new(60, 60, vec![point; 3600])), None);
        }
        assert_eq!(viewpoint(&PointGrid::new(0, 0, Vec::new())), None);
        assert_eq!(viewpoint(&PointGrid::new(1, 2, vec![[1.0, 2.0, 3.0]; 2])), None);
    }
}
