//! Sticks to planar regions: seeds of neighbouring sticks grow while the next stick fits.
//!
//! A region is its [`Moments`]; taking a stick in is an addition, and the test whether it fits knows
//! how well the plane is known so far.

use super::cut::LONGEST;
use super::field::Field;
use super::merge::Merger;
use super::moments::Moments;
use super::noise::ReadingErrors;
use super::sticks::{Stick, Sticks};

/// Gate of the growth in standard deviations of what is being compared.
const GATE: f64 = 3.0;
/// Deviation that is always allowed, in standard deviations of one reading: surfaces and sensors
/// have errors that do not average out.
const SLACK: f64 = 0.5;
/// Error of a seed's plane, over its three degrees of freedom, beyond which it is none.
const SEED_ERROR: f64 = 16.0;
/// Gate of the growth, in standard deviations of one reading, beyond which the plane is not known
/// well enough where the stick lies: anything would fit.
const WIDEST_GATE: f64 = 8.0;
/// Fewest readings of a region that is kept.
const FEWEST: f64 = 6.0;
/// Growth of a region's readings after which its plane is solved anew.
const NEWS: f64 = 1.1;
/// Readings beyond which a plane can wait longer for that, and how much longer.
const MANY: f64 = 200.0;
const OLD_NEWS: f64 = 1.3;
/// Most that a plane is in doubt by common errors, in variances of one reading: it is told beside
/// where it is asked for.
const MOST_COMMON: f64 = 2.0;
/// Scatter of a stick about its own line, per reading, beyond which it is no seed.
const ROUGH: f64 = 2.5;

/// A planar region.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Region {
    pub moments: Moments,
    pub plane: Plane,
}

/// A plane `q · p = 1` and how well it is known.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Plane {
    pub q: [f64; 3],
    /// Covariance of `q`: xx, xy, xz, yy, yz, zz.
    pub covariance: [f64; 6],
}

impl Plane {
    pub fn of(moments: &Moments) -> Self {
        let (q, covariance) = moments.solve_with_covariance();
        Self { q, covariance }
    }

    /// Whether a stick lies on the plane.
    #[inline]
    pub fn fits(&self, stick: &Stick, errors: &ReadingErrors) -> bool {
        let [xx, xy, xz, yy, yz, zz] = self.covariance;
        let deviations = stick.ends.map(|[x, y, z]| {
            (self.q[0] * x + self.q[1] * y + self.q[2] * z - 1.0).abs() * stick.root_gain
        });
        // No gate lets this pass.
        if deviations[0].max(deviations[1]) >= WIDEST_GATE {
            return false;
        }
        let unit = stick.gain;
        // Both ends at once: one that is told first spares less than a branch costs.
        let variances = stick.ends.map(|[x, y, z]| {
            let known =
                xx * x * x + yy * y * y + zz * z * z + 2.0 * (xy * x * y + xz * x * z + yz * y * z);
            // Each end stands for half the readings.
            let mut variance = 2.0 * stick.per_reading + unit * known;
            if errors.common > 0.0 {
                let common = 1.0 + (errors.patch * unit * known).min(MOST_COMMON);
                variance = (1.0 - errors.common) * variance + errors.common * common;
            }
            variance
        });
        // `deviation < GATE √variance + SLACK`, and that gate below the widest, without a root.
        const WIDEST: f64 = (WIDEST_GATE - SLACK) / GATE;
        let passes = |k: usize| {
            let beyond = (deviations[k] - SLACK).max(0.0) * (1.0 / GATE);
            (variances[k] < WIDEST * WIDEST) & (beyond * beyond < variances[k])
        };
        passes(0) & passes(1)
    }
}

/// Grows regions of sticks.
#[derive(Clone, Debug, Default)]
pub(super) struct Grower {
    /// Region of each stick, from 1; 0 for none.
    pub region_of: Vec<u32>,
    /// Regions; the first is none.
    pub regions: Vec<Region>,
    order: Vec<u32>,
    front: Vec<u32>,
    /// Sticks beside one that have no region yet.
    free: Vec<u32>,
    moments: Vec<Moments>,
    pub merger: Merger,
}

/// On how many sides a seed needs a neighbour. Two sides prove a plane; narrow surfaces have one
/// neighbour, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sides {
    Both,
    Either,
    None,
}

impl Grower {
    pub fn grow(&mut self, field: &Field, sticks: &Sticks) {
        self.region_of.clear();
        self.region_of.resize(sticks.sticks.len(), 0);
        self.regions.clear();
        self.regions.push(Region::default());
        self.sort_by_length(sticks);
        for sides in [Sides::Both, Sides::Either, Sides::None] {
            for k in 0..self.order.len() {
                let stick = self.order[k];
                if self.region_of[stick as usize] == 0 {
                    self.try_seed(field, sticks, stick, sides);
                }
            }
        }
        self.merge(field, sticks);
    }

    /// Long sticks first, equal ones in their order.
    fn sort_by_length(&mut self, sticks: &Sticks) {
        // Where the sticks of each length begin, from the longest on.
        let mut starts = [0; LONGEST + 2];
        let place = |[first, last]: [u32; 2]| LONGEST - 1 - (last - first) as usize;
        for &span in &sticks.spans {
            starts[place(span) + 1] += 1;
        }
        for place in 0..LONGEST {
            starts[place + 1] += starts[place];
        }
        self.order.resize(sticks.sticks.len(), 0);
        for (s, &span) in sticks.spans.iter().enumerate() {
            let start = &mut starts[place(span)];
            self.order[*start] = s as u32;
            *start += 1;
        }
    }

    /// Starts a region from a stick and the sticks that overlap it most on the lanes beside it.
    fn try_seed(&mut self, field: &Field, sticks: &Sticks, seed: u32, sides: Sides) {
        let [left, right] = [0, 1].map(|side| self.best_overlap(sticks, seed, side));
        let members = match sides {
            Sides::Both if left.is_some() && right.is_some() => [left, Some(seed), right],
            Sides::Either => {
                let n = |s: Option<u32>| s.map_or(0.0, |s| sticks.sticks[s as usize].n);
                [Some(seed), if n(right) > n(left) { right } else { left }, None]
            }
            Sides::None => [Some(seed), None, None],
            Sides::Both => return,
        };
        let mut region = Region::default();
        for s in members.into_iter().flatten() {
            let stick = &sticks.sticks[s as usize];
            stick.add_to(&mut region.moments);
            if stick.error > ROUGH * stick.n {
                return;
            }
        }
        region.plane = Plane::of(&region.moments);
        if region.moments.error(&region.plane.q) > SEED_ERROR * field.lane_errors.run {
            return;
        }
        self.front.clear();
        self.front.extend(members.into_iter().flatten());
        self.grow_front(field, sticks, &mut region);
        if region.moments.n < FEWEST {
            for &s in &self.front {
                self.region_of[s as usize] = 0;
            }
        } else {
            self.regions.push(region);
        }
    }

    /// Takes in what fits, starting from the sticks in `front`, which ends up with all of them.
    fn grow_front(&mut self, field: &Field, sticks: &Sticks, region: &mut Region) {
        let label = self.regions.len() as u32;
        for &s in &self.front {
            self.region_of[s as usize] = label;
        }
        let mut at = 0;
        let after = |n: f64| if n < MANY { NEWS * n } else { OLD_NEWS * n };
        let mut next = after(region.moments.n);
        while at < self.front.len() {
            let stick = self.front[at];
            at += 1;
            // Which of them are free is hard to foretell, so they are listed without a branch for each.
            let around = sticks.around(stick);
            let count: usize = around.iter().map(ExactSizeIterator::len).sum();
            self.free.resize(self.free.len().max(count), 0);
            let mut free = 0;
            for range in around {
                for (&region, s) in
                    self.region_of[range.start as usize..range.end as usize].iter().zip(range)
                {
                    self.free[free] = s;
                    free += usize::from(region == 0);
                }
            }
            for &s in &self.free[..free] {
                let other = &sticks.sticks[s as usize];
                if !region.plane.fits(other, &field.lane_errors) {
                    continue;
                }
                self.region_of[s as usize] = label;
                other.add_to(&mut region.moments);
                self.front.push(s);
                // A few more readings hardly move a plane; its covariance says what it is
                // known to, so a plane that lags behind is only a little more careful.
                if region.moments.n > next {
                    region.plane = Plane::of(&region.moments);
                    next = after(region.moments.n);
                }
            }
        }
        region.plane = Plane::of(&region.moments);
    }

    /// Merges neighbouring regions that one plane explains.
    fn merge(&mut self, field: &Field, sticks: &Sticks) {
        let Self { merger, region_of, regions, .. } = self;
        merger.list_pairs(regions.len(), |touching| {
            for s in 0..sticks.sticks.len() as u32 {
                let region = region_of[s as usize];
                if region != 0 {
                    for others in sticks.after(s) {
                        let others = &region_of[others.start as usize..others.end as usize];
                        touching.add(region, others.iter().copied());
                    }
                }
            }
        });
        self.moments.clear();
        self.moments.extend(self.regions.iter().map(|region| region.moments));
        self.merger.merge(&mut self.moments, &field.lane_errors, |_| true);
        for (region, moments) in self.regions.iter_mut().zip(&self.moments) {
            if region.moments.n != moments.n {
                *region = Region { moments: *moments, plane: Plane::of(moments) };
            }
        }
        self.merger.follow(&mut self.region_of);
    }

    /// The free stick beside a stick that most of it touches.
    fn best_overlap(&self, sticks: &Sticks, stick: u32, side: usize) -> Option<u32> {
        let here = &sticks.sticks[stick as usize];
        let mut best = (0, None);
        for s in sticks.beside(stick)[side].clone() {
            let other = &sticks.sticks[s as usize];
            let low = here.first.max(other.first);
            let overlap = (here.last.min(other.last) + 1).saturating_sub(low);
            if self.region_of[s as usize] == 0 && overlap > best.0 {
                best = (overlap, Some(s));
            }
        }
        best.1
    }
}
