//! What a plane is wrong by because its ranges were cut to a decimal grid.
//!
//! Neighbours on a surface that hardly comes nearer from beam to beam are cut to one value, and all by
//! nearly the same: such a level errs once, however many points it has. Rounding errors average out over
//! the levels of a patch, not over its points. A level that a surface passes through from one end of its
//! step to the other errs less than that: what is told here is an upper bound.

use crate::scan::Rounding;
use nalgebra::{Matrix3, Vector3};

/// Most of a point's own noise that is taken for the cutting of its range. Where neighbours err alike they fit
/// one another better than each of them is known, so that their noise is less than what cutting does.
const COUNTED: f64 = 0.5;

/// Connected cells of one patch with the same reading.
#[derive(Clone, Copy, Debug)]
struct Level {
    /// Another level that this one has turned out to be part of, or itself.
    parent: usize,
    /// The patch.
    slot: usize,
    /// What the cutting of one range adds to the right side of the patch's normal equations, by its standard
    /// deviation, summed over the points.
    pull: Vector3<f64>,
    /// What the points' own noise adds for it already: the sum of the squares of what each is moved by, up to
    /// [`COUNTED`] of that noise.
    each: Matrix3<f64>,
}

impl Level {
    fn add(&mut self, other: &Self) {
        self.pull += other.pull;
        self.each += other.each;
    }
}

/// The levels of the patches of one scan.
#[derive(Clone, Debug)]
pub(super) struct RoundingErrors<'a> {
    rounding: &'a Rounding,
    columns: usize,
    levels: Vec<Level>,
    level_of_cell: Vec<Option<usize>>,
}

impl<'a> RoundingErrors<'a> {
    /// Nothing yet of a scan of that many columns.
    pub(super) fn new(rounding: &'a Rounding, columns: usize) -> Self {
        Self { rounding, columns, levels: Vec::new(), level_of_cell: Vec::new() }
    }

    /// Adds the cell at `row` and `column`, row after row, as a point of the patch `slot` that moves the right
    /// side of the patch's normal equations by `pull` a metre across the patch, its range by `slope` of that. By
    /// itself it errs across it by a variance of `own_m2`.
    pub(super) fn add(
        &mut self,
        (row, column): (usize, usize),
        slot: usize,
        (pull, slope, own_m2): (Vector3<f64>, f64, f64),
    ) {
        let cut_m = slope * self.rounding.sigma_m();
        let counted_m2 = (cut_m * cut_m).min(COUNTED * own_m2);
        let cell = row * self.columns + column;
        let left = if column > 0 { self.level_alike(cell, cell - 1, slot) } else { None };
        let above = cell.checked_sub(self.columns);
        let above = above.and_then(|above| self.level_alike(cell, above, slot));
        let level = match (left, above) {
            (Some(a), Some(b)) => self.joined(a, b),
            (Some(only), None) | (None, Some(only)) => only,
            (None, None) => self.levels.len(),
        };
        let each = pull * pull.transpose() * counted_m2;
        let point = Level { parent: level, slot, pull: pull * cut_m, each };
        match self.levels.get_mut(level) {
            Some(known) => known.add(&point),
            None => self.levels.push(point),
        }
        self.level_of_cell.resize(cell, None);
        self.level_of_cell.push(Some(level));
    }

    /// The level of a neighbour that is of the same patch and reads the same.
    fn level_alike(&mut self, cell: usize, neighbour: usize, slot: usize) -> Option<usize> {
        let level = self.level_of_cell.get(neighbour).copied().flatten()?;
        let is_alike = self.levels[level].slot == slot && self.rounding.are_alike(cell, neighbour);
        is_alike.then(|| self.root(level))
    }

    fn joined(&mut self, a: usize, b: usize) -> usize {
        if a != b {
            let other = self.levels[b];
            self.levels[a].add(&other);
            self.levels[b].parent = a;
        }
        a
    }

    fn root(&mut self, mut level: usize) -> usize {
        while self.levels[level].parent != level {
            let parent = self.levels[level].parent;
            self.levels[level].parent = self.levels[parent].parent;
            level = parent;
        }
        level
    }

    /// Covariance of the right side of each of `patches` normal equations, beyond what the points' own noise
    /// gives it: negative by at most [`COUNTED`] of that.
    pub(super) fn of_right_sides(&self, patches: usize) -> Vec<Matrix3<f64>> {
        let mut right = vec![Matrix3::zeros(); patches];
        for (place, level) in self.levels.iter().enumerate() {
            if level.parent == place {
                right[level.slot] += level.pull * level.pull.transpose() - level.each;
            }
        }
        right
    }
}

#[cfg(test)]
mod tests {
    use super::super::observations;
    use crate::scan::PointGrid;
    use crate::segmentation::{SegmentationConfig, Segmenter, Shape, Surface};
    use nalgebra::{Isometry3, Vector3};
    use rand_core::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    const STEP_M: f64 = 0.01;

    /// A wall ahead as a laser sees it, its ranges cut to the middle of their step or left as they are.
    fn wall(offset_m: f64, normal: &Vector3<f64>, is_cut: bool, rng: &mut Pcg64) -> PointGrid {
        wall_of((40, 17), offset_m, normal, is_cut, rng)
    }

    fn wall_of(
        (rows, columns): (u16, u16),
        offset_m: f64,
        normal: &Vector3<f64>,
        is_cut: bool,
        rng: &mut Pcg64,
    ) -> PointGrid {
        let (mut points, mut ranges) = (Vec::new(), Vec::new());
        for row in 0..rows {
            let tilt = (0.3 * f64::from(row) - 0.15 * f64::from(rows)).to_radians();
            for column in 0..columns {
                let bearing = f64::from(column) - f64::from(columns / 2);
                let (sin, cos) = bearing.to_radians().sin_cos();
                let ray = Vector3::new(cos * tilt.cos(), sin, -cos * tilt.sin());
                let noise: f64 = (0..12).map(|_| f64::from(rng.next_u32()) / 2_f64.powi(32)).sum();
                let mut range = offset_m / normal.dot(&ray) + 2e-4 * (noise - 6.0);
                if is_cut {
                    range = ((range / STEP_M).floor() + 0.5) * STEP_M;
                }
                let point = ray * range;
                points.push([point.x as f32, point.y as f32, point.z as f32]);
                ranges.push(range as f32);
            }
        }
        PointGrid::new(rows.into(), columns.into(), points).with_ranges(&ranges)
    }

    #[test]
    fn ranges_that_are_cut_alike_do_not_make_a_plane_better_known() {
        let mut noise = Pcg64::seed_from_u64(13);
        let mut segmenter = Segmenter::new(SegmentationConfig::default());
        let mut planes = 0_isize;
        for (rows, columns) in [(4, 9), (8, 5), (8, 9), (16, 7)] {
            for step in 0..50 {
                let offset_m = 1.0 + 0.0637 * f64::from(step);
                let normal = Vector3::new(1.0, 0.02, 0.01).normalize();
                let grid = wall_of((rows, columns), offset_m, &normal, true, &mut noise);
                let segmentation = segmenter.segment(&grid);
                for seen in observations(segmentation, &grid, &Isometry3::identity()) {
                    let surface = segmentation.surfaces.iter().find(|it| it.points == seen.points);
                    let Shape::Plane(fit) = &surface.unwrap().shape else { panic!("a plane") };
                    let more = seen.covariance - 0.4 * fit.covariance;
                    assert!(more.cholesky().is_some(), "{rows} x {columns}, {offset_m}: {more}");
                    planes += 1;
                }
                let fitted = |it: &&Surface| matches!(it.shape, Shape::Plane(_));
                planes -= segmentation.surfaces.iter().filter(fitted).count() as isize;
            }
        }
        assert_eq!(planes, 0, "no plane goes unseen for want of a covariance");
    }

    #[test]
    fn planes_of_cut_ranges_err_by_no_more_than_they_are_told_to() {
        const WALLS: usize = 200;
        let mut rng = Pcg64::seed_from_u64(11);
        let mut uniform = move || f64::from(rng.next_u32()) / 2_f64.powi(32);
        let mut noise = Pcg64::seed_from_u64(12);
        let mut segmenter = Segmenter::new(SegmentationConfig::default());
        for is_cut in [false, true] {
            let mut ratios = [const { Vec::new() }; 3];
            for _ in 0..WALLS {
                let offset_m = 2.0 + 2.0 * uniform();
                let turned = Vector3::new(1.0, 0.1 * uniform() - 0.05, 0.1 * uniform() - 0.05);
                let normal = turned.normalize();
                let grid = wall(offset_m, &normal, is_cut, &mut noise);
                assert_eq!(grid.rounding().is_some(), is_cut);
                let found = observations(segmenter.segment(&grid), &grid, &Isometry3::identity());
                let [seen] = &found[..] else { panic!("one wall, not {}", found.len()) };
                let local = seen.robot_from_plane.rotation.inverse() * -normal;
                let gap = (normal.dot(&seen.centroid().coords) - offset_m) / local.z;
                let error = Vector3::new(gap, local.x, -local.y);
                for i in 0..3 {
                    ratios[i].push(error[i].abs() / seen.covariance[(i, i)].sqrt());
                }
            }
            for (i, mut ratios) in ratios.into_iter().enumerate() {
                ratios.sort_by(f64::total_cmp);
                let (median, most) = (ratios[WALLS / 2], ratios[WALLS * 95 / 100]);
                // 1.96 of normal errors; counted point by point, the offset's would be 2.3.
                assert!(median > 0.05 && most < 1.96, "cut: {is_cut}, {i}: {median} {most}");
            }
        }
    }
}
