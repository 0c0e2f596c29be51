//! What a laser saw: one [`LaserLine`], many of them as a [`RangeImage`], and the [`PointGrid`] that
//! segmentation works on.
//!
//! *Sensor frame*: x along the middle beam, y left, z up, origin at the optical centre; it moves
//! with the tilt. *Scan frame*: the sensor frame at zero pan and tilt while the robot stood still;
//! it is what all rows of one image share.

mod cones;
mod grid;
mod image;
mod line;
mod points;
mod rounding;
mod viewpoint;

pub use grid::PointGrid;
pub use image::{ImageRow, RangeImage};
pub use line::{LaserLine, Return};
pub use rounding::{Rounding, are_whole_steps, range_step_m};
pub use viewpoint::viewpoint;
