//! One integration binary, so that link time is paid once.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking; helpers count as tests too")]

mod acquisition;
mod cli;
mod layering;
mod mapping;
mod mission;
mod protocol;
mod replay;
mod scripted;
mod segmentation;
mod session;
mod terrain;
mod truth;
