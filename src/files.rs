//! Map, scan and recording files read here and handed down as values.

pub mod pcd;
pub mod replace;
pub mod world;
