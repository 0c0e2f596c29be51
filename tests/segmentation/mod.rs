//! Segmentation against worlds whose surfaces are known.

mod campaign;
mod covariance;
mod errors;
mod fans;
mod robustness;
pub mod scanner;
mod scenes;
mod score;
mod unevenness;
pub mod world;
