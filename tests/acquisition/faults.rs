//! What goes wrong with scans: each ends in a usable part of one, and a line that says so.
