//! The three ways to run an agent: live over TCP, in lockstep with the simulator, from a recording.

pub mod host;
pub mod lockstep;
pub mod replay;
pub mod simulated;
