//! Localisation and mapping, from the outside.

mod consistency;
mod world;
