//! Localisation and mapping, from the outside.

mod consistency;
mod drive;
mod situations;
mod world;
