//! One client's end: bytes in, commands out; lines in, bytes out, as faults allow.

use super::fault::{Piece, Shaping};
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
    /// Whole lines that others overtake, in the order in which they arrive.
    strays: VecDeque<(Stamp, Vec<u8>)>,
    /// The last octet delivered was not the end of a line.
    mid_line: bool,
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
            strays: VecDeque::new(),
            mid_line: false,
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
        for piece in shaping.shape(line) {
            self.put(piece, now);
        }
        let waiting = self.under_way.iter().chain(&self.strays);
        let unread: usize = self.ready.len() + waiting.map(|(_, bytes)| bytes.len()).sum::<usize>();
        if unread > MOST_UNREAD {
            self.close();
        }
    }

    fn put(&mut self, piece: Piece, now: Stamp) {
        let Piece { bytes, late, overtaken } = piece;
        let due = now + late;
        if overtaken {
            // Not TCP's doing: a server that sends its lines in another order than it made them.
            let at = self.strays.partition_point(|(other, _)| *other <= due);
            self.strays.insert(at, (due, bytes));
            return;
        }
        if late == Span::ZERO && self.under_way.is_empty() {
            self.make_ready(&bytes);
            return;
        }
        // TCP keeps the order: what is sent later arrives no earlier.
        let due = self.under_way.back().map_or(due, |(last, _)| due.max(*last));
        self.under_way.push_back((due, bytes));
    }

    fn make_ready(&mut self, bytes: &[u8]) {
        self.ready.extend(bytes);
        self.mid_line = bytes.last().is_some_and(|&last| last != b'\n');
    }

    /// Lets arrive what is due, unless the line is stalled.
    pub(super) fn deliver(&mut self, now: Stamp, stalled: bool) {
        while !stalled && self.under_way.front().is_some_and(|(due, _)| *due <= now) {
            let (_, bytes) = self.under_way.pop_front().expect("the front was just seen");
            self.make_ready(&bytes);
        }
        while !stalled && !self.mid_line && self.strays.front().is_some_and(|(due, _)| *due <= now)
        {
            let (_, bytes) = self.strays.pop_front().expect("the front was just seen");
            self.make_ready(&bytes);
        }
    }

    pub(super) fn take_output(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.ready)
    }

    pub(super) fn close(&mut self) {
        self.closed = true;
        self.commands.clear();
        self.under_way.clear();
        self.strays.clear();
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
    use super::super::fault::Faults;
    use super::*;
    use crate::sim::scenario::{FaultKind, FaultSpec};

    #[test]
    fn lines_overtake_those_that_are_held_back_and_none_is_lost() {
        let spec = FaultSpec {
            at_s: 0.0,
            for_s: None,
            robot: None,
            kind: FaultKind::Reorder,
            what: Some("MISSTA".to_owned()),
            value: Some(1.0),
        };
        let mut faults = Faults::new(vec![spec], Stamp(0), 1);
        let mut connection = Connection::new(Dialect::Ut2004);
        let mut came = Vec::new();
        for i in 0..40 {
            let now = Stamp::from_seconds(0.2 * f64::from(i));
            if i < 30 {
                for verb in ["MISSTA", "STA"] {
                    let line = format!("{verb} {i}\r\n").into_bytes();
                    connection.send(line, now, &mut faults.shaping("R1", now));
                }
            }
            connection.deliver(now, false);
            came.extend(connection.take_output());
        }
        let text = String::from_utf8(came).unwrap();
        let of = |verb: &str| -> Vec<u32> {
            let lines = text.lines().filter_map(|line| line.strip_prefix(verb));
            lines.map(|number| number.trim().parse().unwrap()).collect()
        };
        let (mut strays, others) = (of("MISSTA "), of("STA "));
        assert!(others.is_sorted() && others.len() == 30, "{others:?}");
        assert!(!strays.is_sorted(), "{strays:?}");
        strays.sort_unstable();
        assert_eq!(strays, (0..30).collect::<Vec<_>>());
    }

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
