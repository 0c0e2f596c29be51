//! Deliverables from a run or a recording.

pub mod segment_images;
