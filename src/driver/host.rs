//! An agent and its recorder: what every driver feeds.

use crate::export::score::Bystander;
use crate::mission::{Action, Agent, Event, Outcome};
use crate::protocol::encode_command;
use crate::record::{Entry, What, Writer};
use crate::time::Arrival;
use std::io::{self, Write};

/// Records each event before the agent sees it, and each line it answers with.
pub struct Host<W: Write> {
    agent: Agent,
    recorder: Option<Writer<W>>,
    bystander: Bystander,
}

impl<W: Write> Host<W> {
    /// A host that records to `recorder`, if there is one.
    pub fn new(agent: Agent, recorder: Option<Writer<W>>) -> Self {
        Self { agent, recorder, bystander: Bystander::default() }
    }

    /// The agent.
    pub fn agent(&self) -> &Agent {
        &self.agent
    }

    /// Readings that are only compared, never used.
    pub fn bystander(&self) -> &Bystander {
        &self.bystander
    }

    /// Feeds one event; gives the lines to be sent, with their line ends.
    ///
    /// # Errors
    ///
    /// When the recording cannot be written. The agent has taken the event all the same.
    pub fn feed(&mut self, event: &Event, now: Arrival) -> io::Result<Vec<Vec<u8>>> {
        if let Event::Line(line) = event {
            self.bystander.note(line);
        }
        let mut written = self.record(now, what_of(event));
        let mut lines = Vec::new();
        for action in self.agent.handle(event, now) {
            if let Action::Send(command) = action {
                let line = encode_command(&command, self.agent.dialect());
                written = written.and(self.record(now, What::Sent(line.clone())));
                lines.push(line);
            }
        }
        written.map(|()| lines)
    }

    fn record(&mut self, arrival: Arrival, what: What) -> io::Result<()> {
        match &mut self.recorder {
            Some(recorder) => recorder.push(&Entry { arrival, what }),
            None => Ok(()),
        }
    }

    /// How the mission ended, if it has.
    pub fn outcome(&self) -> Option<&Outcome> {
        self.agent.outcome()
    }

    /// Closes the recording; gives the agent and the sink back.
    ///
    /// # Errors
    ///
    /// When the last block cannot be written.
    pub fn finish(self) -> io::Result<(Agent, Option<W>)> {
        let sink = self.recorder.map(Writer::finish).transpose()?;
        Ok((self.agent, sink))
    }
}

/// An event as a recording keeps it.
pub fn what_of(event: &Event) -> What {
    match event {
        Event::Connected => What::Connected,
        Event::Line(line) => What::Received(line.clone()),
        Event::Operator(event) => What::Operator(event.encode()),
        Event::Wake => What::Wake,
        Event::Disconnected(reason) => What::Disconnected(reason.clone()),
        Event::End(reason) => What::Ended(reason.clone()),
    }
}

/// The event that a recording keeps; `None` for what the agent itself sent.
///
/// # Errors
///
/// When an operator event is not readable.
pub fn event_of(what: &What) -> Result<Option<Event>, crate::mission::OperatorDecodeError> {
    Ok(Some(match what {
        What::Connected => Event::Connected,
        What::Received(line) => Event::Line(line.clone()),
        What::Operator(bytes) => Event::Operator(crate::mission::OperatorEvent::decode(bytes)?),
        What::Wake => Event::Wake,
        What::Disconnected(reason) => Event::Disconnected(reason.clone()),
        What::Ended(reason) => Event::End(reason.clone()),
        What::Sent(_) => return Ok(None),
    }))
}
