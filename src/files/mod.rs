//! Map, scan and recording files read here and handed down as values.

pub mod agent_config;
pub mod kind;
pub mod pcd;
pub mod replace;
pub mod run;
pub mod scenario;
pub mod world;
