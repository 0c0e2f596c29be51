//! Frames, planes, angles, rotations and convex hulls: the mathematics that everything else shares.
//!
//! Core frames are right-handed with x forward, y left, z up (REP 103). A transform is named
//! `target_from_source`, so that inner names meet in a product.

mod angle;
mod euler;
mod hull;
pub mod lie;
mod plane;

pub use angle::{AngleSpan, wrap_pi};
pub use euler::EulerPose;
pub use hull::{
    clip_convex, contains_point, convex_gap_m, convex_hull, polygon_area, polygon_centroid,
};
pub use plane::Plane;
