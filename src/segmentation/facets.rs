//! The planar regions of a growth as facets: their sticks, their neighbours, their size.

use super::grow::Grower;
use super::moments::Moments;
use super::sticks::Sticks;
use nalgebra::Vector3;

/// Facets at a mean distance of more than this, in units of their mean length, only meet in the
/// image: one is before the other.
const FARTHEST: f64 = 1.5;

/// Lists of members and neighbours, each in one array.
#[derive(Clone, Debug, Default)]
pub(super) struct Facets {
    starts: Vec<usize>,
    sticks: Vec<u32>,
    near_starts: Vec<usize>,
    near: Vec<u32>,
    sizes: Vec<Size>,
    /// Sticks that each region still has.
    pub left: Vec<usize>,
}

/// Where a facet is and how large.
#[derive(Clone, Copy, Debug, Default)]
struct Size {
    first_lane: u32,
    last_lane: u32,
    centroid: Vector3<f64>,
    /// Greater and lesser extent in metres.
    length_m: f64,
    width_m: f64,
    /// Standard deviation of a reading in metres.
    sigma_m: f64,
}

impl Facets {
    /// Takes over the regions of a growth.
    pub fn load(&mut self, sticks: &Sticks, grower: &Grower) {
        let count = grower.regions.len();
        self.starts.clear();
        self.starts.resize(count + 1, 0);
        for &region in &grower.region_of {
            self.starts[region as usize + 1] += 1;
        }
        self.left.clear();
        self.left.extend_from_slice(&self.starts[1..]);
        let members = grower.region_of.iter().zip(0..).map(|(&region, stick)| (region, stick));
        list(&mut self.starts, &mut self.sticks, members);
        self.near_starts.clear();
        self.near_starts.resize(count + 1, 0);
        for &(a, b) in &grower.merger.pairs {
            self.near_starts[a as usize + 1] += 1;
            self.near_starts[b as usize + 1] += 1;
        }
        let near = grower.merger.pairs.iter().flat_map(|&(a, b)| [(a, b), (b, a)]);
        list(&mut self.near_starts, &mut self.near, near);
        self.sizes.clear();
        for (region, grown) in grower.regions.iter().enumerate() {
            let mut size = Size::of(&grown.moments);
            let members = &self.sticks[self.starts[region]..self.starts[region + 1]];
            if let (Some(&first), Some(&last)) = (members.first(), members.last()) {
                // Sticks are in the order of their lanes.
                size.first_lane = sticks.sticks[first as usize].lane;
                size.last_lane = sticks.sticks[last as usize].lane;
            }
            self.sizes.push(size);
        }
    }

    /// The sticks of a region when it was taken over.
    pub fn sticks(&self, region: u32) -> &[u32] {
        &self.sticks[self.starts[region as usize]..self.starts[region as usize + 1]]
    }

    /// The regions that touch a region.
    pub fn near(&self, region: u32) -> &[u32] {
        &self.near[self.near_starts[region as usize]..self.near_starts[region as usize + 1]]
    }

    /// First and last lane of a region.
    pub fn lanes(&self, region: u32) -> (u32, u32) {
        let size = &self.sizes[region as usize];
        (size.first_lane, size.last_lane)
    }

    /// Whether a region is one lane wide, so that its plane is not known across it.
    pub fn is_one_lane(&self, region: u32) -> bool {
        let (first, last) = self.lanes(region);
        first == last
    }

    /// Whether a region is two lanes wide at most.
    pub fn is_narrow(&self, region: u32) -> bool {
        let (first, last) = self.lanes(region);
        last - first < 2
    }

    /// Whether a region may be a facet of a surface of at most `radius_m`.
    ///
    /// A plane of width w errs by up to w² / 12 R from a cylinder, and growth stops at about twice
    /// the noise; merging may double that. A wider region is a plane of its own.
    pub fn may_curve(&self, region: u32, radius_m: f64) -> bool {
        let size = &self.sizes[region as usize];
        size.width_m * size.width_m < 40.0 * radius_m * size.sigma_m
    }

    /// Distance between the middles of two regions.
    pub fn apart_m(&self, a: u32, b: u32) -> f64 {
        (self.sizes[a as usize].centroid - self.sizes[b as usize].centroid).norm()
    }

    /// Whether two regions meet in space, not in the image alone.
    pub fn meet(&self, a: u32, b: u32) -> bool {
        let (a, b) = (&self.sizes[a as usize], &self.sizes[b as usize]);
        let reach = 0.5 * FARTHEST * (a.length_m + b.length_m);
        (a.centroid - b.centroid).norm() < reach + 4.0 * (a.sigma_m + b.sigma_m)
    }
}

impl Size {
    /// From the sums of a region, whose weights hardly vary over it.
    fn of(moments: &Moments) -> Self {
        if moments.c <= 0.0 {
            return Self::default();
        }
        let centroid = Vector3::from(moments.b) / moments.c;
        let [xx, xy, xz, yy, yz, zz] = moments.a.map(|a| a / moments.c);
        let square_range = xx + yy + zz;
        let [x, y, z] = centroid.into();
        let (xx, xy, xz) = (xx - x * x, xy - x * y, xz - x * z);
        let (yy, yz, zz) = (yy - y * y, yz - y * z, zz - z * z);
        // Without the least eigenvalue, which is noise, the other two follow from two invariants.
        let trace = xx + yy + zz;
        let minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz;
        let root = (trace * trace - 4.0 * minors).max(0.0).sqrt();
        let extent = |variance: f64| (12.0 * variance.max(0.0)).sqrt();
        Self {
            centroid,
            length_m: extent(0.5 * (trace + root)),
            width_m: extent(0.5 * (trace - root)),
            sigma_m: (square_range * moments.n / moments.c).sqrt(),
            ..Self::default()
        }
    }
}

/// Turns counts, each one place after its list, into starts, and fills the lists with what is given with the
/// list that it belongs to.
fn list(starts: &mut [usize], items: &mut Vec<u32>, given: impl Iterator<Item = (u32, u32)>) {
    for k in 1..starts.len() {
        starts[k] += starts[k - 1];
    }
    items.clear();
    items.resize(starts.last().copied().unwrap_or(0), 0);
    for (list, item) in given {
        let start = &mut starts[list as usize];
        items[*start] = item;
        *start += 1;
    }
    // Each start has moved to its list's end, which is the next list's start.
    for k in (1..starts.len()).rev() {
        starts[k] = starts[k - 1];
    }
    if let Some(first) = starts.first_mut() {
        *first = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_filled_in_order() {
        let (mut starts, mut items) = (vec![0, 2, 0, 1], Vec::new());
        list(&mut starts, &mut items, [(2, 7), (0, 8), (0, 9)].into_iter());
        assert_eq!((starts, items), (vec![0, 2, 2, 3], vec![8, 9, 7]));
    }

    #[test]
    fn the_size_of_a_strip_is_its_own() {
        let mut moments = Moments::default();
        for i in 0..1000 {
            let (a, b) = (f64::from(i / 10) / 100.0, f64::from(i % 10) / 50.0);
            moments.add_point([5.0, a, b], 25.0 / 1e-4);
        }
        let size = Size::of(&moments);
        assert!((size.length_m - 1.0).abs() < 0.02, "{size:?}");
        assert!((size.width_m - 0.2).abs() < 0.02, "{size:?}");
        assert!((size.sigma_m - 0.01).abs() < 1e-3, "{size:?}");
    }
}
