//! The readings of one region by column, so that fits go through them a vector at a time.

use super::packed::{COLUMNS, Packed};
use super::{Columns, START_READINGS};
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};
use std::ops::Range;

/// Readings that columns are filled up to a multiple of; as many as the vectors of any processor can share.
pub(super) const BLOCK: usize = 8;

/// The readings of one region.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct Readings {
    /// Points and, for cells, inverse ranges, gains and those of the readings that a plane is fitted to, filled
    /// up with zeros to whole blocks. Which region a reading at a border to another surface belongs to was
    /// decided by its error, so it would bias a plane.
    columns: [Vec<f32>; COLUMNS],
    /// Unit vectors of the rays, and ones over the standard deviations of the ranges, which places without a
    /// reading have zero of.
    rays: [Vec<f32>; 3],
    per_sigma: Vec<f32>,
    count: usize,
    centroid: Vector3<f64>,
    packed: Packed,
}

impl Readings {
    /// Takes cells of a field, whose ranges are given, in the place of the readings before.
    pub fn gather(&mut self, columns: Columns, ranges: &[f32], cells: impl Iterator<Item = usize>) {
        self.clear();
        for cell in cells {
            for (column, value) in self.columns.iter_mut().zip(columns.reading(cell)) {
                column.push(value);
            }
            self.per_sigma.push(ranges[cell]);
        }
        self.derive();
    }

    /// Takes runs of cells.
    pub fn gather_runs(
        &mut self,
        columns: Columns,
        ranges: &[f32],
        runs: impl Iterator<Item = Range<usize>>,
    ) {
        self.clear();
        let (all, _) = columns.all();
        for run in runs {
            for (column, all) in self.columns.iter_mut().zip(all) {
                column.extend_from_slice(&all[run.clone()]);
            }
            self.per_sigma.extend_from_slice(&ranges[run]);
        }
        self.derive();
    }

    /// Takes pairs of points that are no cells, with their standard deviations along the ray. No plane is
    /// fitted to them.
    pub fn gather_pairs(&mut self, pairs: impl Iterator<Item = [([f64; 3], f64); 2]>) {
        self.clear();
        self.rays.iter_mut().for_each(Vec::clear);
        let mut sum = Vector3::zeros();
        for pair in pairs {
            let rays = pair.map(|(point, _)| {
                let point = Vector3::from(point);
                sum += point;
                point * (1.0 / point.norm())
            });
            let [(first, sigma), (second, other)] = pair;
            for k in 0..3 {
                self.columns[k].extend_from_slice(&[first[k] as f32, second[k] as f32]);
                self.rays[k].extend_from_slice(&[rays[0][k] as f32, rays[1][k] as f32]);
            }
            self.per_sigma.extend_from_slice(&[(1.0 / sigma) as f32, (1.0 / other) as f32]);
        }
        let end = self.fill_up();
        self.rays.iter_mut().for_each(|ray| ray.resize(end, 0.0));
        self.per_sigma.resize(end, 0.0);
        self.centroid = sum / self.count.max(1) as f64;
    }

    fn clear(&mut self) {
        self.columns.iter_mut().for_each(Vec::clear);
        self.per_sigma.clear();
    }

    /// Fills the last block up; returns where it ends.
    fn fill_up(&mut self) -> usize {
        self.count = self.columns[0].len();
        let end = self.count.next_multiple_of(BLOCK);
        self.columns.iter_mut().for_each(|column| column.resize(end, 0.0));
        end
    }

    /// Fills up what has the columns of cells, and their ranges for deviations, and computes the rest.
    fn derive(&mut self) {
        let end = self.fill_up();
        self.rays.iter_mut().for_each(|ray| ray.resize(end, 0.0));
        // Without a gain the deviation is infinite.
        self.per_sigma.resize(end, 1.0);
        let Self { columns, rays, per_sigma, .. } = self;
        let sums = Arch::new().dispatch(Derive { columns, rays, per_sigma });
        self.centroid = Vector3::from(sums) / self.count.max(1) as f64;
    }

    /// Number of readings.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Their centroid.
    pub fn centroid(&self) -> Vector3<f64> {
        self.centroid
    }

    /// What a plane is fitted to, and where it may be put together.
    pub(super) fn for_plane(&mut self) -> (Columns<'_>, &mut Packed) {
        let [x, y, z, inverse, gain, fit_gain] =
            self.columns.each_ref().map(|column| &column[..self.count]);
        (Columns { x, y, z, inverse, gain, fit_gain }, &mut self.packed)
    }

    /// Points, rays and ones over deviations in whole vectors, all as many.
    #[inline(always)]
    pub(super) fn vectors<S: Simd>(&self) -> [&[S::f32s]; 7] {
        const { assert!(BLOCK.is_multiple_of(S::F32_LANES), "blocks are whole vectors") };
        let ([x, y, z, ..], [u, v, w]) = (&self.columns, &self.rays);
        let columns = [x, y, z, u, v, w, &self.per_sigma];
        let vectors = columns.map(|column| S::as_simd_f32s(column).0);
        // The compiler does not know that they are.
        vectors.map(|column| &column[..vectors[0].len()])
    }

    /// Gains, with the points, of cells.
    pub(super) fn gains(&self) -> impl Iterator<Item = (Vector3<f64>, f64)> + '_ {
        self.every(1).zip(&self.columns[4]).map(|((point, ..), &gain)| (point, f64::from(gain)))
    }

    /// Every so-many-th point with its ray and one over its deviation.
    pub(super) fn every(
        &self,
        stride: usize,
    ) -> impl Iterator<Item = (Vector3<f64>, Vector3<f64>, f64)> + '_ {
        let [x, y, z, ..] = &self.columns;
        let [u, v, w] = &self.rays;
        let vector = |[x, y, z]: [&[f32]; 3], i: usize| {
            Vector3::new(f64::from(x[i]), f64::from(y[i]), f64::from(z[i]))
        };
        (0..self.count).step_by(stride).map(move |i| {
            let per_sigma = f64::from(self.per_sigma[i]);
            (vector([x, y, z], i), vector([u, v, w], i), per_sigma)
        })
    }

    /// Step through the readings that takes as many of them as an iteration starts with.
    pub(super) fn start_stride(&self) -> usize {
        self.count.div_ceil(START_READINGS).max(1)
    }
}

/// Rays and deviations of whole blocks, and the sum of their points.
struct Derive<'a> {
    columns: &'a [Vec<f32>; COLUMNS],
    rays: &'a mut [Vec<f32>; 3],
    /// The ranges at first.
    per_sigma: &'a mut [f32],
}

impl WithSimd for Derive<'_> {
    type Output = [f64; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 3] {
        let Self { columns: [x, y, z, inverse, gain, _], rays, per_sigma } = self;
        let mut totals = [0.0; 3];
        for ((total, column), ray) in totals.iter_mut().zip([x, y, z]).zip(rays) {
            let mut sums = [0.0; BLOCK];
            let blocks = column.chunks_exact(BLOCK).zip(inverse.chunks_exact(BLOCK));
            for ((column, inverse), ray) in blocks.zip(ray.chunks_exact_mut(BLOCK)) {
                for k in 0..BLOCK {
                    sums[k] += f64::from(column[k]);
                    ray[k] = column[k] * inverse[k];
                }
            }
            *total = sums.iter().sum();
        }
        for (per_sigma, &gain) in per_sigma.iter_mut().zip(gain) {
            *per_sigma = 1.0 / (*per_sigma / gain);
        }
        totals
    }
}
