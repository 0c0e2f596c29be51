//! Taking scans from the stand-in simulator, scored against its truth.

mod bench;
mod faults;
mod profiles;
