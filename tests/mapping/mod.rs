//! Localisation and mapping, from the outside.

mod consistency;
mod curves;
mod drive;
mod long_loop;
mod recognition;
mod situations;
mod world;
