//! Deliverables from a run or a recording.

pub mod canvas;
pub mod cloud;
pub mod consistency;
pub mod coverage;
pub mod evaluate;
mod font;
pub mod keyframes;
pub mod landmarks;
pub mod map3d;
pub mod map_picture;
pub mod map_scene;
pub mod map_server;
pub mod ply;
pub mod report;
pub mod run_folder;
pub mod scene3d;
pub mod score;
pub mod segment_images;
pub mod timeline;
mod truth_steps;
pub mod tum;
