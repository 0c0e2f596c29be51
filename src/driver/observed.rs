//! Recordings of others: what a client printed, and own recordings that are only looked at.

use crate::mission::AgentConfig;
use crate::protocol::capture::Capture;
use crate::protocol::parse;
use crate::record::{Direction, Entry, Header, Recording, What};
use crate::time::{Arrival, Stamp};

/// Captured text as a recording of its server lines. Times are those of the lines themselves; a line
/// without one comes at the time of the line before.
pub fn recording_of_text(capture: &Capture, header: Header) -> Recording {
    let mut entries = vec![Entry { arrival: Arrival::default(), what: What::Connected }];
    let mut first: Option<Stamp> = None;
    let mut arrival = Arrival::default();
    for line in &capture.lines {
        if let Some(stamp) = parse(&line.octets).message.time() {
            let first = *first.get_or_insert(stamp);
            arrival = arrival.max(Arrival::default() + (stamp - first));
        }
        entries.push(Entry { arrival, what: What::Received(line.octets.clone()) });
    }
    Recording { header, entries, loss: None }
}

/// What the server said in a recording, and nothing of what was answered.
pub fn server_side(recording: &Recording) -> Recording {
    let heard = |what: &What| match what {
        What::Connected | What::Disconnected(_) => true,
        what => matches!(what.line(), Some((Direction::Received, _))),
    };
    let entries = recording.entries.iter().filter(|entry| heard(&entry.what)).cloned().collect();
    Recording { header: recording.header.clone(), entries, loss: recording.loss.clone() }
}

/// A configuration for looking on: nothing is sent, and the mission lasts as long as the recording.
pub fn observing(mut config: AgentConfig) -> AgentConfig {
    config.mission.observe = true;
    config.mission.time_limit_s = 0.0;
    config
}
