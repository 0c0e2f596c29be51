//! One integration binary, so that link time is paid once.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking; helpers count as tests too")]

mod acquisition;
mod layering;
mod mapping;
mod protocol;
mod scripted;
mod segmentation;
mod terrain;
mod truth;
