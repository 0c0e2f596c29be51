//! Deliverables from a run or a recording.

pub mod canvas;
mod font;
pub mod scene3d;
