//! One client's end: bytes in, commands out; lines in, bytes out, as faults allow.

use super::fault::Shaping;
use crate::protocol::command::Query;
use crate::protocol::{Command, Dialect, Framed, LineSplitter, parse_command};
use crate::sim::physics::RobotKey;
use crate::time::{Span, Stamp};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Identifies a connection in one session; never used twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct ConnectionId(pub u32);

/// Commands that wait for the next tick; a client that floods loses the rest.
const MOST_PENDING: usize = 4096;

/// Octets that wait to be taken; a client that never reads is cut off.
const MOST_UNREAD: usize = 32 << 20;

/// The longest command line.
const LONGEST_COMMAND: usize = 64 << 10;

/// A question that waits its turn: UT2004 answers one of each kind per tick.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Question {
    Geo(Query),
    Conf(Query),
}

pub(super) struct Connection {
    dialect: Dialect,
    pub(super) robot: Option<RobotKey>,
    /// Robots that this client made before its present one; they go when it goes.
    pub(super) earlier: Vec<RobotKey>,
    pub(super) closed: bool,
    /// The client has sent its last.
    pub(super) finished: bool,
    /// It is a world controller.
    pub(super) controller: bool,
    /// It splits the screen (UT2004).
    pub(super) multi_view: bool,
    pub(super) geo: VecDeque<Query>,
    pub(super) conf: VecDeque<Query>,
    splitter: LineSplitter,
    commands: VecDeque<Command>,
    ready: Vec<u8>,
    /// Pieces under way, in the order in which they arrive.
    under_way: VecDeque<(Stamp, Vec<u8>)>,
}

impl Connection {
    pub(super) fn new(dialect: Dialect) -> Self {
        Self {
            dialect,
            robot: None,
            earlier: Vec::new(),
            closed: false,
            finished: false,
            controller: false,
            multi_view: false,
            geo: VecDeque::new(),
            conf: VecDeque::new(),
            splitter: LineSplitter::new(LONGEST_COMMAND),
            commands: VecDeque::new(),
            ready: Vec::new(),
            under_way: VecDeque::new(),
        }
    }

    pub(super) fn receive(&mut self, bytes: &[u8]) {
        if self.closed {
            return;
        }
        self.splitter.push(bytes);
        while let Some(framed) = self.splitter.next_line() {
            if let Framed::Line(line) = framed
                && self.commands.len() < MOST_PENDING
            {
                let seen = match self.dialect {
                    Dialect::Ut2004 => line,
                    Dialect::Udk => before_keyless(line),
                };
                self.commands.push_back(parse_command(seen).command);
            }
        }
    }

    /// The commands that came since the last tick.
    pub(super) fn take_commands(&mut self) -> VecDeque<Command> {
        std::mem::take(&mut self.commands)
    }

    pub(super) fn ask(&mut self, question: Question) {
        let (queue, query) = match question {
            Question::Geo(query) => (&mut self.geo, query),
            Question::Conf(query) => (&mut self.conf, query),
        };
        if queue.len() < MOST_PENDING {
            queue.push_back(query);
        }
    }

    /// Sends one whole line, as the faults of the moment shape it.
    pub(super) fn send(&mut self, line: Vec<u8>, now: Stamp, shaping: &mut Shaping<'_>) {
        if self.closed {
            return;
        }
        for (late, piece) in shaping.shape(line) {
            self.put(piece, now, late);
        }
        let unread: usize =
            self.ready.len() + self.under_way.iter().map(|(_, piece)| piece.len()).sum::<usize>();
        if unread > MOST_UNREAD {
            self.close();
        }
    }

    fn put(&mut self, piece: Vec<u8>, now: Stamp, late: Span) {
        let due = now + late;
        if late == Span::ZERO && self.under_way.is_empty() {
            self.ready.extend(piece);
            return;
        }
        // TCP keeps the order: what is sent later arrives no earlier.
        let due = self.under_way.back().map_or(due, |(last, _)| due.max(*last));
        self.under_way.push_back((due, piece));
    }

    /// Lets arrive what is due, unless the line is stalled.
    pub(super) fn deliver(&mut self, now: Stamp, stalled: bool) {
        while !stalled && self.under_way.front().is_some_and(|(due, _)| *due <= now) {
            let (_, piece) = self.under_way.pop_front().expect("the front was just seen");
            self.ready.extend(piece);
        }
    }

    pub(super) fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.ready)
    }

    pub(super) fn close(&mut self) {
        self.closed = true;
        self.commands.clear();
        self.under_way.clear();
    }

    /// All robots that this client made; it has none after that.
    pub(super) fn take_robots(&mut self) -> Vec<RobotKey> {
        self.earlier.drain(..).chain(self.robot.take()).collect()
    }
}

/// What a UDK server finds of a line: it files a segment without a value under the empty key, and its
/// look-ups stop there.
fn before_keyless(line: &[u8]) -> &[u8] {
    let mut from = 0;
    while let Some(open) = memchr::memchr(b'{', &line[from..]).map(|at| from + at) {
        let Some(close) = memchr::memchr(b'}', &line[open..]).map(|at| open + at) else { break };
        if !line[open + 1..close].trim_ascii().contains(&b' ') {
            return &line[..open];
        }
        from = close + 1;
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn udk_finds_nothing_behind_a_segment_without_a_value() {
        let seen =
            |line: &str| String::from_utf8(before_keyless(line.as_bytes()).to_vec()).unwrap();
        for whole in ["GETSTARTPOSES", "DRIVE {Left 1} { Right  1 }", "DRIVE {Left 1} {Right 1"] {
            assert_eq!(seen(whole), whole);
        }
        for (line, found) in [
            ("DRIVE {} {Left 1} {Right 1}", "DRIVE "),
            ("DRIVE {Left 1}{ None } {Right 1}", "DRIVE {Left 1}"),
            ("SET {Type Odometry} {Name }", "SET {Type Odometry} "),
        ] {
            assert_eq!(seen(line), found);
        }
    }
}
