//! Victim candidates, their confirmation and keep-out.
