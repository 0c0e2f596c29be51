//! Exact Euclidean distance to the nearest seed on a grid, cut off where it no longer matters.

/// For each cell the distance in cells to the centre of the nearest seed, at most `cap`.
///
/// Two passes (Felzenszwalb and Huttenlocher 2012): the distance along each column, then per row the
/// nearest of the columns within reach. With a cap of `k` cells the second pass looks at no more than
/// `k` columns to either side, and at none in rows without seeds in reach.
pub(super) fn distances(seeds: &[bool], width: usize, cap: f32) -> Vec<f32> {
    let height = seeds.len() / width.max(1);
    let reach = cap.ceil() as usize;
    let far = reach as u16 + 1;
    let mut along = vec![far; seeds.len()];
    for y in 0..height {
        for x in 0..width {
            let at = y * width + x;
            along[at] = if seeds[at] {
                0
            } else if y > 0 {
                far.min(along[at - width] + 1)
            } else {
                far
            };
        }
    }
    for y in (0..height.saturating_sub(1)).rev() {
        for x in 0..width {
            let at = y * width + x;
            along[at] = along[at].min(along[at + width] + 1);
        }
    }
    let mut distances = vec![cap; seeds.len()];
    let mut envelope = Envelope::default();
    for y in 0..height {
        let row = y * width..(y + 1) * width;
        envelope.row(&along[row.clone()], far, cap, &mut distances[row]);
    }
    distances
}

/// Lower envelope of the parabolas that a row's columns put up.
#[derive(Default)]
struct Envelope {
    /// Column of each parabola on the envelope, and where it begins to be the lowest.
    parabolas: Vec<(usize, f32)>,
}

impl Envelope {
    fn row(&mut self, along: &[u16], far: u16, cap: f32, out: &mut [f32]) {
        self.parabolas.clear();
        let value = |x: usize| f32::from(along[x]).powi(2) + (x as f32).powi(2);
        for (x, &height) in along.iter().enumerate() {
            if height >= far {
                continue;
            }
            let mut begins = f32::NEG_INFINITY;
            while let Some(&(other, other_begins)) = self.parabolas.last() {
                begins = (value(x) - value(other)) / (2.0 * (x - other) as f32);
                if begins > other_begins {
                    break;
                }
                self.parabolas.pop();
                begins = f32::NEG_INFINITY;
            }
            self.parabolas.push((x, begins));
        }
        if self.parabolas.is_empty() {
            return;
        }
        let mut current = 0;
        for (x, out) in out.iter_mut().enumerate() {
            while current + 1 < self.parabolas.len() && self.parabolas[current + 1].1 <= x as f32 {
                current += 1;
            }
            let column = self.parabolas[current].0;
            let squared = (x as f32 - column as f32).powi(2) + f32::from(along[column]).powi(2);
            *out = squared.sqrt().min(cap);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_equal_the_brute_force(
            width in 1_usize..24,
            seeds in prop::collection::vec(prop::bool::weighted(0.05), 1..400),
            cap in 1.0_f32..20.0,
        ) {
            let height = seeds.len() / width;
            prop_assume!(height > 0);
            let seeds = &seeds[..width * height];
            let distances = distances(seeds, width, cap);
            for (at, distance) in distances.iter().enumerate() {
                let (x, y) = ((at % width) as f32, (at / width) as f32);
                let nearest = (0..seeds.len())
                    .filter(|&seed| seeds[seed])
                    .map(|seed| (x - (seed % width) as f32).hypot(y - (seed / width) as f32))
                    .fold(cap, f32::min);
                prop_assert!((distance - nearest).abs() < 1e-3);
            }
        }
    }
}
