use super::*;
use crate::protocol::message::Sen;
use crate::protocol::{Framed, LineSplitter, parse};
use crate::sim::map_file::MapFile;

mod faults;
mod gauges;
mod hearing;
mod rangers;
mod station;
mod udk;
mod ut2004;

/// A client of a session with the lines it has read.
struct Client {
    session: Session,
    id: ConnectionId,
    lines: Vec<String>,
    splitter: LineSplitter,
}

fn session(map: &str, scenario: &str) -> Session {
    let world = World::new(&MapFile::parse(map).unwrap(), &BTreeMap::new()).unwrap();
    let catalogue = RobotCatalogue::parse(include_str!("../../../maps/robots.toml")).unwrap();
    Session::new(&world, &Scenario::parse(scenario).unwrap(), &catalogue).unwrap()
}

const BOX: &str = include_str!("../../../maps/box.toml");
const YELLOW: &str = include_str!("../../../maps/yellow.toml");

fn scenario(more: &str) -> String {
    format!("map = \"m.toml\"\n{more}\n[[robot]]\nname = \"R1\"\nclass = \"USARBot.P3AT\"\n")
}

impl Client {
    fn new(map: &str, scenario: &str) -> Self {
        let mut session = session(map, scenario);
        let id = session.connect();
        Self { session, id, lines: Vec::new(), splitter: LineSplitter::default() }
    }

    /// A robot in the box world that has settled, its lines so far forgotten.
    fn spawned(class: &str, more: &str) -> Self {
        let mut client = Self::new(BOX, &scenario(more));
        client.send(&format!("INIT {{ClassName USARBot.{class}}} {{Name R1}} {{Start StartA}}"));
        client.run(1.0);
        client.lines.clear();
        client
    }

    fn send(&mut self, line: &str) {
        self.session.receive(self.id, format!("{line}\r\n").as_bytes());
    }

    /// Lets time pass in pieces, as a lockstep driver does, and reads.
    fn run(&mut self, seconds: f64) {
        let pieces = (seconds / 0.02).round() as usize;
        for _ in 0..pieces {
            self.session.advance(Span::from_millis(20));
            let bytes = self.session.take_output(self.id);
            self.splitter.push(&bytes);
            while let Some(framed) = self.splitter.next_line() {
                if let Framed::Line(line) = framed {
                    self.lines.push(String::from_utf8(line.to_vec()).unwrap());
                }
            }
        }
    }

    /// Sends a line and gives the first line within a second that begins with `verb`.
    fn ask(&mut self, line: &str, verb: &str) -> String {
        self.lines.clear();
        self.send(line);
        self.run(1.0);
        let found = self.lines.iter().find(|line| line.starts_with(verb));
        found.unwrap_or_else(|| panic!("{line} got no {verb}")).clone()
    }

    fn of_type(&self, sensor: &str) -> Vec<&String> {
        let mark = format!("{{Type {sensor}}}");
        self.lines.iter().filter(|line| line.contains(&mark)).collect()
    }

    fn truth(&self) -> Truth {
        self.session.truth(self.id).unwrap()
    }
}

fn ranges(line: &str) -> Vec<f64> {
    match parse(line.as_bytes()).message {
        Message::Sen(Sen::RangeScanner(scanner)) => scanner.ranges_m,
        other => panic!("{other:?}"),
    }
}
