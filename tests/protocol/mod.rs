//! The protocol from outside: the reference's own lines, properties and captured text.

mod vectors;
