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
    Recording { header, entries: answers_first(entries), loss: None }
}

/// What the server said in a recording, and nothing of what was answered.
pub fn server_side(recording: &Recording) -> Recording {
    let heard = |what: &What| match what {
        What::Connected | What::Disconnected(_) => true,
        what => matches!(what.line(), Some((Direction::Received, _))),
    };
    let entries = recording.entries.iter().filter(|entry| heard(&entry.what)).cloned().collect();
    let entries = answers_first(entries);
    Recording { header: recording.header.clone(), entries, loss: recording.loss.clone() }
}

/// What the robot is made of, told before it does anything: the client asked while it was already
/// running, and a rig cannot be changed in the middle of a session.
fn answers_first(entries: Vec<Entry>) -> Vec<Entry> {
    let is_answer = |entry: &Entry| match &entry.what {
        What::Received(line) => line.starts_with(b"GEO ") || line.starts_with(b"CONF "),
        _ => false,
    };
    let begun = entries.iter().take_while(|entry| entry.what == What::Connected).count();
    let (answers, rest): (Vec<Entry>, Vec<Entry>) = entries.into_iter().partition(is_answer);
    let arrival = rest.first().map_or_else(Arrival::default, |first| first.arrival);
    let answers = answers.into_iter().map(|answer| Entry { arrival, ..answer });
    let (before, after) = rest.split_at(begun.min(rest.len()));
    before.iter().cloned().chain(answers).chain(after.iter().cloned()).collect()
}

/// A configuration for looking on: nothing is sent, and the mission lasts as long as the recording.
pub fn observing(mut config: AgentConfig) -> AgentConfig {
    config.mission.observe = true;
    config.mission.time_limit_s = 0.0;
    config
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_come_before_everything_that_the_robot_did() {
        let text = "STA {Time 1.00}\r\nSEN {Time 1.50} {Type Sonar} {Name F1 Range 1.0}\r\n\
                    GEO {Type Robot}\r\nSTA {Time 2.00}\r\n";
        let recording = recording_of_text(&Capture::read(text.as_bytes()), Header::default());
        let lines: Vec<String> = recording
            .entries
            .iter()
            .filter_map(|entry| entry.what.line())
            .map(|(_, line)| String::from_utf8_lossy(line).into_owned())
            .collect();
        assert_eq!(recording.entries[0].what, What::Connected);
        assert_eq!(lines[..2], ["GEO {Type Robot}", "STA {Time 1.00}"]);
        let arrivals: Vec<f64> = recording.entries.iter().map(|e| e.arrival.seconds()).collect();
        assert_eq!(arrivals, [0.0, 0.0, 0.0, 0.5, 1.0]);
    }
}
