//! Segmentation against worlds whose surfaces are known.

mod campaign;
mod covariance;
mod robustness;
mod scanner;
mod scenes;
mod score;
mod world;
