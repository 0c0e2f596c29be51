//! Deliverables from a run or a recording.

pub mod canvas;
mod font;
pub mod map_scene;
pub mod scene3d;
