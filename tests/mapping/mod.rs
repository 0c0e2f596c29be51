//! Localisation and mapping, from the outside.

mod consistency;
mod curves;
mod drive;
mod situations;
mod world;
