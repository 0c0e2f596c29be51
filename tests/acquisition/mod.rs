//! Taking scans from the stand-in simulator, scored against its truth.

mod bench;
mod desync;
mod faults;
mod nod;
mod planes;
mod profiles;
mod slow_line;
mod triggered;
