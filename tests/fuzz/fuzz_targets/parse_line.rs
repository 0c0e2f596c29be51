//! One line, read as a message, as a command and as captured text.

#![no_main]

#[path = "../invariants.rs"]
mod invariants;

libfuzzer_sys::fuzz_target!(|line: &[u8]| invariants::line(line));
