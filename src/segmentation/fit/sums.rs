//! Sums over the readings of one region, from which its plane, frame and errors follow.
//!
//! All are taken in one pass, four readings at a time, about a plane that is nearly right already:
//! what the region's additive moments gave. Then the errors are small numbers and single precision
//! holds them; a Newton step from there is exact, as the problem is linear.

use super::{CAP, GATE, LEAST_COSINE};
use std::ops::Range;
use wide::f32x4;

/// Blocks of four readings that are added up in single precision.
const LONGEST_SUM: usize = 64;
/// Relative error beyond which a reading's place on the plane is not followed.
const FARTHEST: f32 = 0.5;

/// The arrays of a field that fits read.
#[derive(Clone, Copy)]
pub(in super::super) struct Columns<'a> {
    pub x: &'a [f32],
    pub y: &'a [f32],
    pub z: &'a [f32],
    /// One over the range.
    pub inverse: &'a [f32],
    /// Range over its standard deviation.
    pub gain: &'a [f32],
    /// The same, zero for readings that a fit leaves out.
    pub fit_gain: &'a [f32],
}

/// A plane `q · p = 1` that errors are measured by, and a point that sums are taken about.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Reference {
    pub q: [f32; 3],
    pub anchor: [f32; 3],
}

/// Each place in [`PlaneSums::totals`] that a sum over readings has. `s` is the error relative to the
/// range, `d` the place on the plane that the reading's ray meets, from the anchor, `w` its weight.
pub(in super::super) mod place {
    pub const W: usize = 0;
    pub const WS: usize = 1;
    pub const WSS: usize = 2;
    /// Three each.
    pub const WD: usize = 3;
    pub const WSD: usize = 6;
    /// Six: xx, xy, xz, yy, yz, zz.
    pub const WDD: usize = 9;
    pub const S: usize = 15;
    pub const SS: usize = 16;
    pub const D: usize = 17;
    pub const SD: usize = 20;
    pub const DD: usize = 23;
    /// Squared errors in units of the noise, each cut.
    pub const ERROR: usize = 29;
    /// Readings that have a weight.
    pub const INLIERS: usize = 30;
    /// Squared gains.
    pub const GAIN: usize = 31;
    pub const COUNT: usize = 32;
}

/// The sums.
#[derive(Clone, Debug)]
pub(in super::super) struct PlaneSums {
    pub reference: Reference,
    pub totals: [f64; place::COUNT],
    pub readings: usize,
    least: f32x4,
    block: [f32x4; place::COUNT],
    blocks: usize,
}

impl PlaneSums {
    pub fn new(reference: Reference) -> Self {
        let [x, y, z] = reference.q;
        let offset_m = 1.0 / (x * x + y * y + z * z).sqrt();
        Self {
            reference,
            totals: [0.0; place::COUNT],
            readings: 0,
            least: f32x4::splat(offset_m / LEAST_COSINE as f32),
            block: [f32x4::ZERO; place::COUNT],
            blocks: 0,
        }
    }

    /// Adds the readings of successive cells.
    pub fn add_run(&mut self, columns: &Columns, run: Range<usize>) {
        let arrays =
            [columns.x, columns.y, columns.z, columns.inverse, columns.gain, columns.fit_gain]
                .map(|array| &array[run.clone()]);
        let [x, y, z, inverse, gain, fit_gain] = arrays.map(|array| array.as_chunks::<4>());
        let whole = x.0.iter().zip(y.0).zip(z.0).zip(inverse.0).zip(gain.0).zip(fit_gain.0);
        for (((((x, y), z), inverse), gain), fit_gain) in whole {
            let four = [x, y, z, inverse, gain, fit_gain].map(|&values| f32x4::new(values));
            self.add_block::<false>(four, f32x4::ZERO);
        }
        let left = x.1.len();
        if left > 0 {
            let four = [x, y, z, inverse, gain, fit_gain].map(|(_, rest)| {
                let mut values = [0.0; 4];
                values[..left].copy_from_slice(rest);
                f32x4::new(values)
            });
            let present = std::array::from_fn(|i| f32::from_bits(if i < left { !0 } else { 0 }));
            self.add_block::<true>(four, f32x4::new(present));
        }
        self.readings += run.len();
        if self.blocks > LONGEST_SUM {
            self.flush();
        }
    }

    /// Adds one reading.
    pub fn add(&mut self, [x, y, z]: [f32; 3], inverse: f32, gain: f32, fit_gain: f32) {
        let four = [x, y, z, inverse, gain, fit_gain].map(|v| f32x4::new([v, 0.0, 0.0, 0.0]));
        self.add_block::<true>(four, f32x4::new([f32::from_bits(!0), 0.0, 0.0, 0.0]));
        self.readings += 1;
        if self.blocks > LONGEST_SUM {
            self.flush();
        }
    }

    #[inline(always)]
    fn add_block<const SOME: bool>(&mut self, four: [f32x4; 6], present: f32x4) {
        let [x, y, z, inverse, gain, fit_gain] = four;
        let [qx, qy, qz] = self.reference.q.map(f32x4::splat);
        let [ax, ay, az] = self.reference.anchor.map(f32x4::splat);
        let one = f32x4::ONE;
        let mut s = qx * x + qy * y + qz * z - one;
        if SOME {
            s &= present;
        }
        // Where the ray meets the plane: what follows from it does not depend on the reading's error.
        let near = s.fast_max(f32x4::splat(-FARTHEST)).fast_min(f32x4::splat(FARTHEST));
        let shrink = one - near * (one - near);
        let mut d = [x * shrink - ax, y * shrink - ay, z * shrink - az];
        if SOME {
            d = d.map(|d| d & present);
        }
        let grazing = (self.least * inverse).fast_min(one);
        let error = s * gain * grazing;
        let square = error * error;
        let inside = square.simd_le(f32x4::splat((GATE * GATE) as f32));
        let weight = fit_gain * shrink * grazing;
        let w = (weight * weight) & inside;
        let counted = w.simd_ne(f32x4::ZERO) & one;
        let sums = &mut self.block;
        let ws = w * s;
        sums[place::W] += w;
        sums[place::WS] += ws;
        sums[place::WSS] += ws * s;
        sums[place::S] += s;
        sums[place::SS] += s * s;
        sums[place::ERROR] += square.fast_min(f32x4::splat((CAP * CAP) as f32));
        sums[place::INLIERS] += counted;
        sums[place::GAIN] += gain * gain;
        let mut pair = 0;
        for i in 0..3 {
            sums[place::WD + i] += w * d[i];
            sums[place::WSD + i] += ws * d[i];
            sums[place::D + i] += d[i];
            sums[place::SD + i] += s * d[i];
            for j in i..3 {
                let product = d[i] * d[j];
                sums[place::WDD + pair] += w * product;
                sums[place::DD + pair] += product;
                pair += 1;
            }
        }
        self.blocks += 1;
    }

    /// Moves what was added in single precision to the totals.
    pub fn flush(&mut self) {
        for (total, block) in self.totals.iter_mut().zip(&mut self.block) {
            let [a, b, c, d] = block.to_array().map(f64::from);
            *total += (a + b) + (c + d);
            *block = f32x4::ZERO;
        }
        self.blocks = 0;
    }
}
