use crate::mission::Placement;
use crate::time::Arrival;
use serde::{Deserialize, Serialize};

/// What a recording says about itself before the first entry.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Seed of the mission; zero where the server is not ours.
    pub seed: u64,
    /// Name of the scenario, or of the server's level; may be empty.
    pub scenario: String,
    /// Effective configuration of the agent as TOML: what a replay runs with.
    pub config: String,
    /// Where the robot was to be put.
    pub placement: Placement,
}

/// One event of a session, in the order in which the agent met it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Session time of the event.
    pub arrival: Arrival,
    /// The event.
    pub what: What,
}

/// Which way a line went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the server to the agent.
    Received,
    /// From the agent to the server.
    Sent,
}

/// The kinds of entries.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum What {
    /// A line from the server, without its line end.
    Received(Vec<u8>),
    /// A line to the server, with its line end.
    Sent(Vec<u8>),
    /// An operator event as `mission` encodes it.
    Operator(Vec<u8>),
    /// The agent was woken because its next wake-up had come.
    Wake,
    /// The link came up.
    Connected,
    /// The link went down, with the reason.
    Disconnected(String),
    /// The session was asked to end (time limit, Ctrl-C).
    Ended(String),
}

impl What {
    /// The line of an entry that is one.
    pub fn line(&self) -> Option<(Direction, &[u8])> {
        match self {
            Self::Received(line) => Some((Direction::Received, line)),
            Self::Sent(line) => Some((Direction::Sent, line)),
            _ => None,
        }
    }
}
