//! A run of cells of one lane whose inverse range is a straight line.

/// The line of least squares through the readings of a run.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Run {
    /// First step, and the one after the last.
    pub first: u32,
    pub end: u32,
    /// Mean of the steps' positions in radians, and the sum of their squared distances from it.
    pub middle: f32,
    pub scatter: f32,
    /// Inverse range there, per metre, and its slope over the position; none of a single cell.
    pub inverse: f32,
    pub slope: f32,
    /// Sum of the readings' squared errors, per square metre.
    pub error: f32,
}

impl Run {
    /// The line through readings at some positions, from one step on.
    #[inline]
    pub fn through(
        step: usize,
        positions: &[f32],
        mut readings: impl Iterator<Item = f32>,
    ) -> Self {
        let n = positions.len() as f64;
        let first = readings.next().map_or(0.0, f64::from);
        let origin = f64::from(positions[0]);
        let (mut t1, mut t2, mut f1, mut tf, mut f2) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (&position, reading) in positions[1..].iter().zip(readings) {
            let (t, f) = (f64::from(position) - origin, f64::from(reading) - first);
            t1 += t;
            t2 += t * t;
            f1 += f;
            tf += t * f;
            f2 += f * f;
        }
        let share = 1.0 / n;
        let (mean_t, mean_f) = (t1 * share, f1 * share);
        let scatter = (t2 - t1 * mean_t).max(0.0);
        let product = tf - t1 * mean_f;
        let slope = if positions.len() > 1 { product / scatter } else { 0.0 };
        Self {
            first: step as u32,
            end: (step + positions.len()) as u32,
            middle: (origin + mean_t) as f32,
            scatter: scatter as f32,
            inverse: (first + mean_f) as f32,
            slope: slope as f32,
            error: (f2 - f1 * mean_f - slope * product).max(0.0) as f32,
        }
    }

    pub fn len(&self) -> usize {
        (self.end - self.first) as usize
    }

    /// The line through the readings of two runs, of which the other one goes on where this one ends, and
    /// what it leaves more of squared errors than both.
    #[inline]
    pub fn joined(&self, other: &Self) -> (Self, f32) {
        let (n, m) = (self.len() as f32, other.len() as f32);
        let share = m / (n + m);
        let weight = n * share;
        // Lines are told from the longer one: with its slope taken away no large squares are subtracted.
        let slope = if n < m { other.slope } else { self.slope };
        let (own, others) = (self.slope - slope, other.slope - slope);
        let apart = other.middle - self.middle;
        let rise = other.inverse - self.inverse;
        let step = rise - slope * apart;
        let scatter = self.scatter + other.scatter + weight * apart * apart;
        let product = self.scatter * own + other.scatter * others + weight * apart * step;
        let turn = product / scatter;
        let squares =
            self.scatter * own * own + other.scatter * others * others + weight * step * step;
        let more = (squares - turn * product).max(0.0);
        let joined = Self {
            first: self.first,
            end: other.end,
            middle: self.middle + share * apart,
            scatter,
            inverse: self.inverse + share * rise,
            slope: slope + turn,
            error: self.error + other.error + more,
        };
        (joined, more)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_line_through_two_runs_is_that_through_all_their_readings(
            readings in prop::collection::vec(0.1..0.5_f32, 2..40),
            part in 0.0..1.0_f64,
            steep in -9.0..9.0_f32,
        ) {
            let count = readings.len();
            let positions: Vec<f32> = (0..count).map(|i| 0.3 + 0.004 * i as f32).collect();
            let sloped = readings.iter().zip(&positions).map(|(f, t)| f + steep * t);
            let sloped: Vec<f32> = sloped.collect();
            let line = |a: usize, b: usize| {
                Run::through(a, &positions[a..b], sloped[a..b].iter().copied())
            };
            let middle = (1 + (part * (count - 1) as f64) as usize).min(count - 1);
            let (parts, whole) = ([line(0, middle), line(middle, count)], line(0, count));
            let (joined, more) = parts[0].joined(&parts[1]);
            let scale = readings.iter().map(|f| f * f).sum::<f32>();
            prop_assert_eq!((joined.first, joined.end), (0, count as u32));
            prop_assert!((joined.middle - whole.middle).abs() < 1e-5);
            prop_assert!((joined.scatter / whole.scatter - 1.0).abs() < 1e-3);
            prop_assert!((joined.inverse - whole.inverse).abs() < 1e-4);
            prop_assert!((joined.error - whole.error).abs() < 1e-3 * scale);
            prop_assert!((more - (whole.error - parts[0].error - parts[1].error)).abs() < 1e-3 * scale);
        }
    }
}
