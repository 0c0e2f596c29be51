//! The angles between the steps of a scan: tilts need not be evenly spaced.

/// Lanes that are looked at to measure the pitch between two steps.
const SAMPLES: usize = 9;

/// Finds where the steps of a scan are. The buffers are kept from scan to scan.
#[derive(Clone, Debug, Default)]
pub(super) struct StepFinder {
    /// Directions of the sampled lanes at each step, lane after lane; not a number where there is no return.
    rays: [Vec<f32>; 3],
    /// Squared chords from each step to the next one, lane after lane.
    squares: Vec<f32>,
    /// Their median over the lanes, not a number where no lane has one.
    middles: Vec<f32>,
}

impl StepFinder {
    /// Writes the angle of each step from the first, for arrays of coordinates and inverse ranges so many
    /// lanes wide; `pitch_rad` is the usual angle between two steps.
    pub fn find(
        &mut self,
        arrays: [&[f32]; 4],
        (steps, lanes): (usize, usize),
        pitch_rad: f32,
        positions: &mut Vec<f32>,
    ) {
        positions.clear();
        if steps == 0 {
            return;
        }
        self.take_rays(arrays, steps, lanes);
        self.measure(steps);
        self.take_medians(steps);
        let mut position = 0.0;
        positions.push(position);
        for &middle in &self.middles {
            let gap = if middle.is_nan() { pitch_rad } else { middle.sqrt() };
            // Equal rows would make filters singular.
            position += gap.max(0.05 * pitch_rad).max(1e-6);
            positions.push(position);
        }
    }

    fn take_rays(&mut self, arrays: [&[f32]; 4], steps: usize, lanes: usize) {
        for ray in &mut self.rays {
            ray.clear();
            ray.resize(SAMPLES * steps, f32::NAN);
        }
        let stride = lanes.div_ceil(SAMPLES).max(1);
        let [rx, ry, rz] = &mut self.rays;
        let [x, y, z, inverse] = arrays.map(|array| array.chunks_exact(lanes.max(1)));
        for (step, (((x, y), z), inverse)) in x.zip(y).zip(z).zip(inverse).enumerate() {
            let mut place = step;
            for lane in (stride / 2..lanes).step_by(stride) {
                let scale = if inverse[lane] > 0.0 { inverse[lane] } else { f32::NAN };
                rx[place] = x[lane] * scale;
                ry[place] = y[lane] * scale;
                rz[place] = z[lane] * scale;
                place += steps;
            }
        }
    }

    fn measure(&mut self, steps: usize) {
        let gaps = steps - 1;
        self.squares.resize(SAMPLES * gaps, 0.0);
        if gaps == 0 {
            return;
        }
        let [rx, ry, rz] = self.rays.each_ref().map(|ray| ray.chunks_exact(steps));
        for (((x, y), z), squares) in rx.zip(ry).zip(rz).zip(self.squares.chunks_exact_mut(gaps)) {
            let [x, y, z] = [x, y, z].map(|ray| ray[..gaps].iter().zip(&ray[1..]));
            for (((x, y), z), square) in x.zip(y).zip(z).zip(squares) {
                let [x, y, z] = [x, y, z].map(|(before, here)| before - here);
                *square = x * x + y * y + z * z;
            }
        }
    }

    fn take_medians(&mut self, steps: usize) {
        let gaps = steps - 1;
        self.middles.resize(gaps, 0.0);
        for (gap, middle) in self.middles.iter_mut().enumerate() {
            let squares: [f32; SAMPLES] = std::array::from_fn(|k| self.squares[k * gaps + gap]);
            let sum: f32 = squares.iter().sum();
            *middle = middle_of_nine(if sum.is_nan() { filled_up(squares) } else { squares });
        }
    }
}

/// Puts numbers below all and above all in the places of those that there are not, so that the middle one is
/// still that of the others, the upper one of two; none at all are left as they are.
fn filled_up(mut values: [f32; SAMPLES]) -> [f32; SAMPLES] {
    let known = values.iter().filter(|value| !value.is_nan()).count();
    if known == 0 {
        return values;
    }
    let mut low = SAMPLES / 2 - known / 2;
    for value in &mut values {
        if value.is_nan() {
            *value = if low > 0 { f32::NEG_INFINITY } else { f32::INFINITY };
            low = low.saturating_sub(1);
        }
    }
    values
}

/// The fifth of nine numbers by their size: the middle one of the greatest of the least of three groups of
/// three, of the middle one of their middles, and of the least of their greatest.
#[inline]
fn middle_of_nine(values: [f32; SAMPLES]) -> f32 {
    let least = |a: f32, b: f32| if a < b { a } else { b };
    let greatest = |a: f32, b: f32| if a < b { b } else { a };
    let ordered = |a: f32, b: f32, c: f32| {
        let (low, high) = (least(a, b), greatest(a, b));
        [least(low, c), greatest(low, least(high, c)), greatest(high, c)]
    };
    let [a, b, c, d, e, f, g, h, i] = values;
    let (first, second, third) = (ordered(a, b, c), ordered(d, e, f), ordered(g, h, i));
    let low = greatest(greatest(first[0], second[0]), third[0]);
    let middle = ordered(first[1], second[1], third[1])[1];
    let high = least(least(first[2], second[2]), third[2]);
    ordered(low, middle, high)[1]
}

#[cfg(test)]
mod tests {
    use super::super::field::median;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_middle_of_nine_is_their_median(
            values in prop::array::uniform9(0.0..4.0_f32),
            equal in 0..9_usize,
            missing in 0..9_usize,
        ) {
            let mut values = values;
            values[equal] = values[0];
            let expected = median(&mut values.clone());
            prop_assert_eq!(Some(middle_of_nine(values)), expected);
            values[..missing].fill(f32::NAN);
            let expected = median(&mut values[missing..].to_vec());
            prop_assert_eq!(Some(middle_of_nine(filled_up(values))), expected);
        }
    }

    #[test]
    fn uneven_steps_are_told_by_lanes_that_see_either_part_of_them() {
        let (steps, lanes) = (40, 9);
        let mut arrays = [const { Vec::new() }; 4];
        for i in 0..steps * lanes {
            let (step, lane): (usize, usize) = (i / lanes, i % lanes);
            let tilt = 0.004 * step.min(20) as f32 + 0.01 * step.saturating_sub(20) as f32;
            let bearing = (lane as f32 - 4.0) * 0.02;
            let ray = [tilt.cos() * bearing.cos(), bearing.sin(), -tilt.sin() * bearing.cos()];
            let is_seen = if lane < 5 { step < 24 } else { step >= 16 };
            for (array, value) in arrays.iter_mut().zip(ray) {
                array.push(if is_seen { 2.0 * value } else { 0.0 });
            }
            arrays[3].push(if is_seen { 0.5 } else { 0.0 });
        }
        let mut positions = Vec::new();
        let arrays = arrays.each_ref().map(|array| &array[..]);
        StepFinder::default().find(arrays, (steps, lanes), 0.005, &mut positions);
        let gap = |step: usize| positions[step + 1] - positions[step];
        assert!((gap(4) / 0.004 - 1.0).abs() < 0.01, "{}", gap(4));
        assert!((gap(31) / 0.01 - 1.0).abs() < 0.01, "{}", gap(31));
    }
}
