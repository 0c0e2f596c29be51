//! Deliverables from a run or a recording.

pub mod map_server;
pub mod ply;
pub mod report;
pub mod tum;
