//! Deliverables from a run or a recording.

pub mod canvas;
mod font;
pub mod map_picture;
pub mod map_scene;
pub mod map_server;
pub mod ply;
pub mod report;
pub mod scene3d;
pub mod segment_images;
pub mod tum;
