//! Seeded noise: each consumer draws from its own stream, so that adding a sensor to a robot does
//! not change what the others read.

use rand_core::Rng;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A seeded source of uniform and normal numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    generator: Pcg32,
    spare: Option<f64>,
}

impl Noise {
    /// The stream `stream` of the scenario's `seed`.
    pub fn new(seed: u64, stream: u64) -> Self {
        Self { generator: Pcg32::new(seed, stream), spare: None }
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        const STEPS: f64 = (1_u64 << 53) as f64;
        (self.generator.next_u64() >> 11) as f64 / STEPS
    }

    /// Uniform in [-half_width, half_width).
    pub fn symmetric(&mut self, half_width: f64) -> f64 {
        half_width * (2.0 * self.unit() - 1.0)
    }

    /// Normal with mean 0 and standard deviation 1 (Box and Muller's transform, both values used).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        // 1 - u lies in (0, 1], where the logarithm is finite.
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let (sin, cos) = (TAU * self.unit()).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut noise = Noise::new(7, 3);
        let n = 40_000;
        let uniform: Vec<f64> = (0..n).map(|_| noise.symmetric(0.001)).collect();
        let normal: Vec<f64> = (0..n).map(|_| noise.normal()).collect();
        let moments = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / n as f64;
            (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n as f64).sqrt())
        };
        let (mean, deviation) = moments(&uniform);
        assert!(mean.abs() < 2e-5 && (deviation - 0.001 / 3_f64.sqrt()).abs() < 1e-5);
        let (mean, deviation) = moments(&normal);
        assert!(mean.abs() < 0.02 && (deviation - 1.0).abs() < 0.02);
    }

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let draw = |seed, stream| {
            let mut noise = Noise::new(seed, stream);
            [noise.unit(), noise.unit(), noise.normal()]
        };
        assert_eq!(draw(1, 2), draw(1, 2));
        assert_ne!(draw(1, 2), draw(1, 3));
        assert_ne!(draw(1, 2), draw(2, 2));
    }
}
