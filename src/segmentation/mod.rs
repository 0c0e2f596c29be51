//! From an organised scan to fitted surfaces with covariances and hulls.

mod surface;

pub use surface::{Cylinder, PlanePatch, Rejected, Segmentation, Shape, Sphere, Surface};
