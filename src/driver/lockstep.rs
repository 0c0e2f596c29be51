//! Agent and simulator in one process, in one time: a mission as fast as the machine allows, and the
//! same bytes for the same seed.

use super::host::Host;
use crate::export::score::Bystander;
use crate::mission::{Agent, Event};
use crate::protocol::{Framed, LineSplitter, MAX_LINE_OCTETS};
use crate::sim::{ConnectionId, Session, Truth};
use crate::time::{Arrival, Span};
use std::io::{self, Write};

/// How far the simulator runs between two looks at its output: a simulated wire this long.
const STEP: Span = Span::from_millis(5);

/// How long after a lost connection an agent is connected again, if it wants to be.
const CONNECT_AGAIN: Span = Span::from_millis(500);

/// One robot's agent joined to one connection of a session.
pub struct Pair<W: Write> {
    /// The agent and its recorder.
    pub host: Host<W>,
    connection: ConnectionId,
    splitter: LineSplitter,
    /// When to connect again; `None` while connected.
    reconnect: Option<Arrival>,
}

/// A session and its agents.
pub struct Lockstep<W: Write> {
    session: Session,
    pairs: Vec<Pair<W>>,
    now: Arrival,
}

impl<W: Write> Lockstep<W> {
    /// Connects one agent after the other.
    ///
    /// # Errors
    ///
    /// When a recording cannot be written.
    pub fn new(mut session: Session, hosts: Vec<Host<W>>) -> io::Result<Self> {
        let now = Arrival::default();
        let mut pairs = Vec::with_capacity(hosts.len());
        for host in hosts {
            let connection = session.connect();
            let splitter = LineSplitter::new(MAX_LINE_OCTETS);
            let mut pair = Pair { host, connection, splitter, reconnect: None };
            pair.feed(&mut session, &Event::Connected, now)?;
            pairs.push(pair);
        }
        Ok(Self { session, pairs, now })
    }

    /// Runs one step of 5 ms; false once every mission is over.
    ///
    /// # Errors
    ///
    /// When a recording cannot be written.
    pub fn step(&mut self) -> io::Result<bool> {
        self.session.advance(STEP);
        self.now = self.now + STEP;
        let mut alive = false;
        for pair in &mut self.pairs {
            if pair.host.outcome().is_some() {
                continue;
            }
            pair.step(&mut self.session, self.now)?;
            alive |= pair.host.outcome().is_none();
        }
        Ok(alive)
    }

    /// Session time.
    pub fn now(&self) -> Arrival {
        self.now
    }

    /// The agents, in the order of their connections.
    pub fn agents(&self) -> impl Iterator<Item = &Agent> {
        self.pairs.iter().map(|pair| pair.host.agent())
    }

    /// The truth about the robot of an agent: for scoring only.
    pub fn truth(&self, index: usize) -> Option<Truth> {
        self.session.truth(self.pairs[index].connection)
    }

    /// Readings of an agent's session that are only compared.
    pub fn bystander(&self, index: usize) -> &Bystander {
        self.pairs[index].host.bystander()
    }

    /// The session, for scoring.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Ends every mission that still runs.
    ///
    /// # Errors
    ///
    /// When a recording cannot be written.
    pub fn end(&mut self, reason: &str) -> io::Result<()> {
        for pair in &mut self.pairs {
            if pair.host.outcome().is_none() {
                pair.feed(&mut self.session, &Event::End(reason.to_owned()), self.now)?;
            }
        }
        Ok(())
    }

    /// Feeds an event to an agent from outside: an operator's.
    ///
    /// # Errors
    ///
    /// When the recording cannot be written.
    pub fn feed(&mut self, index: usize, event: &Event) -> io::Result<()> {
        self.pairs[index].feed(&mut self.session, event, self.now)
    }

    /// Closes all recordings; gives the agents back, in the order of their connections.
    ///
    /// # Errors
    ///
    /// When a recording cannot be closed.
    pub fn finish(self) -> io::Result<Vec<Agent>> {
        Ok(self.finish_recordings()?.into_iter().map(|(agent, _)| agent).collect())
    }

    /// As [`finish`](Self::finish), with the sinks of the recordings.
    ///
    /// # Errors
    ///
    /// When a recording cannot be closed.
    pub fn finish_recordings(self) -> io::Result<Vec<(Agent, Option<W>)>> {
        self.pairs.into_iter().map(|pair| pair.host.finish()).collect()
    }
}

impl<W: Write> Pair<W> {
    fn step(&mut self, session: &mut Session, now: Arrival) -> io::Result<()> {
        let output = session.take_output(self.connection);
        if !output.is_empty() {
            self.splitter.push(&output);
            let mut lines = Vec::new();
            while let Some(framed) = self.splitter.next_line() {
                if let Framed::Line(line) = framed {
                    lines.push(line.to_vec());
                }
            }
            for line in lines {
                self.feed(session, &Event::Line(line), now)?;
            }
        }
        match self.reconnect {
            None if session.is_closed(self.connection) && self.host.outcome().is_none() => {
                let event = Event::Disconnected("the server closed the connection".into());
                self.reconnect = Some(now + CONNECT_AGAIN);
                return self.feed(session, &event, now);
            }
            Some(at) if now >= at => {
                self.connection = session.connect();
                self.splitter = LineSplitter::new(MAX_LINE_OCTETS);
                self.reconnect = None;
                return self.feed(session, &Event::Connected, now);
            }
            _ => {}
        }
        if self.host.agent().next_wakeup().is_some_and(|at| now >= at) {
            self.feed(session, &Event::Wake, now)?;
        }
        Ok(())
    }

    fn feed(&mut self, session: &mut Session, event: &Event, now: Arrival) -> io::Result<()> {
        for line in self.host.feed(event, now)? {
            session.receive(self.connection, &line);
        }
        Ok(())
    }
}
