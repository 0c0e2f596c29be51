//! Readings that leap: one garbled digit must not carry the robot to the next town.

use serde::{Deserialize, Serialize};

/// Believes a reading that is far from the one before only once the next is near it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Leaps<T> {
    doubted: Option<T>,
}

impl<T> Default for Leaps<T> {
    fn default() -> Self {
        Self { doubted: None }
    }
}

impl<T: Copy> Leaps<T> {
    /// Whether a reading that follows `before` is believed. Those that came between are lost either way:
    /// the server may have been silent for a while.
    pub(super) fn believes(
        &mut self,
        before: Option<&T>,
        now: &T,
        is_near: impl Fn(&T, &T) -> bool,
    ) -> bool {
        let doubted = self.doubted.take();
        let fits = before.is_none_or(|before| is_near(before, now))
            || doubted.is_some_and(|doubted| is_near(&doubted, now));
        if !fits {
            self.doubted = Some(*now);
        }
        fits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Those of the readings that are believed, where leaps are of more than one.
    fn believed(readings: &[f64]) -> Vec<f64> {
        let mut leaps = Leaps::default();
        let mut last: Option<f64> = None;
        let mut kept = Vec::new();
        for reading in readings {
            if leaps.believes(last.as_ref(), reading, |a, b| (a - b).abs() <= 1.0) {
                last = Some(*reading);
                kept.push(*reading);
            }
        }
        kept
    }

    #[test]
    fn a_reading_that_leaps_is_believed_once_the_next_is_near_it() {
        assert_eq!(believed(&[0.0, 0.5, 900.0, 0.9]), [0.0, 0.5, 0.9]);
        assert_eq!(believed(&[0.0, 5.0, 5.2, 5.4]), [0.0, 5.2, 5.4]);
        assert_eq!(believed(&[0.0, f64::NAN, f64::NAN, 0.1]), [0.0, 0.1]);
    }
}
