//! The `usar` binary.

use clap::Parser;
use std::process::ExitCode;
use usar_agent::cli::{Arguments, run};

fn main() -> ExitCode {
    run(&Arguments::parse())
}
