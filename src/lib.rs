//! `usar-agent`: an autonomous rescue-robot agent for USARSim.
//!
//! The core is synchronous and deterministic; the shell owns sockets, files and clocks. Modules are
//! listed from the bottom layer to the top; `tests/layering.rs` holds the rule which may use which.

#![warn(missing_docs)]

pub mod geometry;
pub mod time;

pub mod protocol;
pub mod scan;

pub mod robot;
pub mod segmentation;

pub mod mapping;
pub mod terrain;

pub mod acquisition;
pub mod navigation;

pub mod exploration;
pub mod victims;

pub mod mission;

pub mod sim;

pub mod export;
pub mod link;
pub mod record;

pub mod config;

pub mod files;

pub mod driver;

pub mod cli;
