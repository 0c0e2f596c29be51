//! A recording through the same agent: every action computed again and compared.

use super::host::event_of;
use crate::export::score::Bystander;
use crate::mission::{Action, Agent, Event};
use crate::protocol::encode_command;
use crate::record::{Entry, Recording, What};
use crate::time::Arrival;

/// The first place where an agent did something else than the recorded one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("entry {entry} at {arrival}: {what}")]
pub struct Difference {
    /// Number of the entry in the recording, from 0.
    pub entry: usize,
    /// Its time.
    pub arrival: Arrival,
    /// The field and both values.
    pub what: String,
}

/// A replay that goes entry by entry.
pub struct Replay<'a> {
    agent: Agent,
    entries: &'a [Entry],
    next: usize,
    expected: Vec<Vec<u8>>,
    difference: Option<Difference>,
    bystander: Bystander,
}

impl<'a> Replay<'a> {
    /// A replay of `recording` through `agent`, which is to be as fresh as the recorded one was.
    pub fn new(agent: Agent, recording: &'a Recording) -> Self {
        Self {
            agent,
            entries: &recording.entries,
            next: 0,
            expected: Vec::new(),
            difference: None,
            bystander: Bystander::default(),
        }
    }

    /// The agent.
    pub fn agent(&self) -> &Agent {
        &self.agent
    }

    /// Readings of the session that are only compared, never used.
    pub fn bystander(&self) -> &Bystander {
        &self.bystander
    }

    /// Time of the next entry; `None` at the end.
    pub fn next_arrival(&self) -> Option<Arrival> {
        self.entries.get(self.next).map(|entry| entry.arrival)
    }

    /// Replays one entry; false at the end.
    ///
    /// # Errors
    ///
    /// When an operator event of the recording is not readable.
    pub fn step(&mut self) -> Result<bool, crate::mission::OperatorDecodeError> {
        let Some(entry) = self.entries.get(self.next) else { return Ok(false) };
        match (&entry.what, event_of(&entry.what)?) {
            (What::Sent(recorded), _) => self.compare(entry, recorded),
            (_, Some(event)) => {
                self.nothing_left_over(entry);
                if let Event::Line(line) = &event {
                    self.bystander.note(line);
                }
                for action in self.agent.handle(&event, entry.arrival) {
                    if let Action::Send(command) = action {
                        self.expected.push(encode_command(&command, self.agent.dialect()));
                    }
                }
                // Taken from the front by the entries that follow.
                self.expected.reverse();
            }
            (_, None) => {}
        }
        self.next += 1;
        Ok(true)
    }

    /// The first difference found so far.
    pub fn difference(&self) -> Option<&Difference> {
        self.difference.as_ref()
    }

    /// Ends the replay; gives the agent back. Where the recording does not say how the mission ended,
    /// it ends with the recording.
    pub fn finish(mut self) -> (Agent, Bystander, Option<Difference>) {
        if let Some(last) = self.entries.last() {
            self.nothing_left_over(last);
            if self.agent.outcome().is_none() {
                let end = Event::End("end of the recording".into());
                self.agent.handle(&end, last.arrival);
            }
        }
        (self.agent, self.bystander, self.difference)
    }

    fn compare(&mut self, entry: &Entry, recorded: &[u8]) {
        let text = |line: &[u8]| String::from_utf8_lossy(line).trim_end().to_owned();
        let what = match self.expected.pop() {
            Some(computed) if computed == recorded => return,
            Some(computed) => describe(&text(recorded), &text(&computed)),
            None => format!("recorded `{}`, computed nothing", text(recorded)),
        };
        self.note(entry.arrival, what);
    }

    fn nothing_left_over(&mut self, entry: &Entry) {
        if let Some(computed) = self.expected.pop() {
            let line = String::from_utf8_lossy(&computed).trim_end().to_owned();
            self.note(entry.arrival, format!("recorded nothing, computed `{line}`"));
            self.expected.clear();
        }
    }

    fn note(&mut self, arrival: Arrival, what: String) {
        let entry = self.next;
        self.difference.get_or_insert(Difference { entry, arrival, what });
    }
}

/// The first word in which two lines differ, then both lines.
fn describe(recorded: &str, computed: &str) -> String {
    let pair = recorded.split(' ').zip(computed.split(' ')).find(|(a, b)| a != b);
    let field = pair.map_or(String::new(), |(a, b)| format!("`{a}` against `{b}` in "));
    format!("{field}recorded `{recorded}`, computed `{computed}`")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_names_field_and_values() {
        let text = describe("DRIVE {Left 1.0} {Right 2.0}", "DRIVE {Left 1.0} {Right 2.5}");
        assert!(text.starts_with("`2.0}` against `2.5}`"), "{text}");
    }
}
