//! The three ways to run an agent: live over TCP, in lockstep with the simulator, from a recording.

pub mod host;
pub mod live;
pub mod lockstep;
pub mod observed;
pub mod replay;
pub mod results;
pub mod simulated;
pub mod triples;
