//! The three ways to run an agent: live, lockstep, replay.
