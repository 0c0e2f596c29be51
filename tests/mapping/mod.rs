//! Localisation and mapping, from the outside.

mod bent;
mod closures;
mod consistency;
mod curves;
mod drive;
mod long_loop;
mod long_run;
mod movers;
mod real_scan;
mod recognition;
mod shelves;
mod situations;
mod slips;
mod turned;
mod united;
mod world;
