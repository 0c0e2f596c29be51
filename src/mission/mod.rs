//! The agent: events in, actions out.
