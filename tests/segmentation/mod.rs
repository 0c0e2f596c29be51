//! Segmentation against worlds whose surfaces are known.

mod campaign;
mod scanner;
mod scenes;
mod score;
mod world;
