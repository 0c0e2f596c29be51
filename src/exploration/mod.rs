//! Where to look next, with reasons.
