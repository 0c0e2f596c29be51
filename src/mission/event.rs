use super::operator::OperatorEvent;
use crate::protocol::Command;
use serde::{Deserialize, Serialize};

/// What the agent is told.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The link is up; nothing was read yet.
    Connected,
    /// A line from the server, without its line end.
    Line(Vec<u8>),
    /// An operator did something.
    Operator(OperatorEvent),
    /// The time the agent asked to be woken at has come, or a little more.
    Wake,
    /// The link is down, and why.
    Disconnected(String),
    /// The session is to end, and why.
    End(String),
}

/// What the agent wants done, in this order.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Send a command in the agent's dialect.
    Send(Command),
    /// The mission is over; nothing more will come.
    Finish(Outcome),
}

/// How a mission ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// Its time was up.
    Time,
    /// Nothing was left that can be explored.
    Explored,
    /// The robot lies on its side or back, or hangs, and cannot go on.
    Fallen,
    /// An operator, or whoever runs the program, ended it.
    Stopped(String),
    /// There was never a robot, and why.
    NoRobot(String),
    /// The link went down and did not come back.
    LinkLost(String),
}

impl Outcome {
    /// One word for the report.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Explored => "explored",
            Self::Fallen => "fallen",
            Self::Stopped(_) => "stopped",
            Self::NoRobot(_) => "no robot",
            Self::LinkLost(_) => "link lost",
        }
    }

    /// Whether a robot was run at all: what decides the exit code.
    pub fn is_done(&self) -> bool {
        !matches!(self, Self::NoRobot(_) | Self::LinkLost(_))
    }
}
