//! The agent as a whole: phases of a session, from waiting for a link to the end of the mission.

use super::config::AgentConfig;
use super::event::{Action, Event, Outcome};
use super::journal::{Journal, Level};
use super::ledger::Pastime;
use super::opening::{Opening, OpeningStep, Placement};
use super::operator::{Mode, OperatorEvent};
use super::resume::{Put, placeable};
use super::running::{Desk, Running, Verdict};
use super::tally::Tally;
use crate::protocol::{Command, Dialect, WirePose, parse};
use crate::robot::{RigBuilder, core_pose};
use crate::time::{Arrival, Span};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Damaged lines in a row that end a session: whatever speaks there, it is not this protocol.
const HOPELESS: usize = 1_000;

/// The agent: a deterministic value that is told events and answers with actions.
///
/// Its methods are of three kinds. [`handle`](Self::handle) is the one door for everything that
/// happens; [`next_wakeup`](Self::next_wakeup) names the time at which it wants to be told
/// [`Event::Wake`] if nothing else happens before; all others only look. It has no clock, no socket
/// and no file, so that a live run, a simulated one and a replay are the same computation.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Agent {
    config: AgentConfig,
    placement: Placement,
    journal: Journal,
    tally: Tally,
    dialect: Option<Dialect>,
    phase: Phase,
    began: Option<Arrival>,
    last_line: Option<Arrival>,
    silent: bool,
    level: Option<String>,
    operator_acts: usize,
    /// Time in which it was not the robot that decided.
    operated: Span,
    clock: Arrival,
    /// Since when there is no robot in service because the link was lost, and why.
    lost: Option<(Arrival, String)>,
    /// The robot that was in service when the link was lost, until another takes its place.
    kept: Option<Box<Running>>,
    /// Whether the map frame is the level's own, so that a place in it can be named to the server.
    map_is_level: bool,
    /// Whether a new robot is to be asked for at the start: where the old one was, none came.
    from_start: bool,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum Phase {
    /// No link yet, or none any more.
    Waiting,
    /// The session is being opened, or opened again.
    Opening(Box<Opening>),
    /// The robot is in service.
    Running(Box<Running>),
    /// All is over; what the robot believed stays.
    Ended(Outcome, Option<Box<Running>>),
}

impl Agent {
    /// An agent that waits for its link.
    pub fn new(config: AgentConfig, placement: Placement) -> Self {
        Self {
            config,
            placement,
            journal: Journal::default(),
            tally: Tally::default(),
            dialect: None,
            phase: Phase::Waiting,
            began: None,
            last_line: None,
            silent: false,
            level: None,
            operator_acts: 0,
            operated: Span::ZERO,
            clock: Arrival::default(),
            lost: None,
            kept: None,
            map_is_level: false,
            from_start: false,
        }
    }

    /// Takes in one event that happened at `now`; times must not decrease.
    pub fn handle(&mut self, event: &Event, now: Arrival) -> Vec<Action> {
        self.account(now);
        let mut out = Vec::new();
        let outcome = match event {
            Event::Connected => {
                self.connected(now);
                None
            }
            Event::Line(line) => self.line(line, now, &mut out),
            Event::Operator(event) => self.operator(event, now, &mut out),
            Event::Wake => self.wake(now, &mut out),
            Event::Disconnected(reason) => self.disconnected(reason, now),
            Event::End(reason) => Some(match reason.as_str() {
                "time" => Outcome::Time,
                _ => Outcome::Stopped(reason.clone()),
            }),
        };
        let outcome = outcome
            .or_else(|| self.time_is_up(now).then_some(Outcome::Time))
            .or_else(|| self.is_given_up(now));
        let mut actions: Vec<Action> = out.into_iter().map(Action::Send).collect();
        if let Some(outcome) = outcome
            && !matches!(self.phase, Phase::Ended(..))
        {
            actions.extend(self.end(outcome, now));
        }
        actions
    }

    /// When the agent wants to be told [`Event::Wake`] if nothing happens before.
    pub fn next_wakeup(&self) -> Option<Arrival> {
        let watchdog = self
            .last_line
            .filter(|_| !self.silent && !matches!(self.phase, Phase::Waiting))
            .map(|at| at + Span::from_seconds(self.config.mission.silence_s));
        let end = self.end_time();
        let inner = match &self.phase {
            Phase::Ended(..) => return None,
            Phase::Waiting => None,
            Phase::Opening(opening) => opening.next_wakeup(),
            Phase::Running(running) => running.next_wakeup(),
        };
        let given_up = self.lost.as_ref().map(|(since, _)| *since + self.reconnect());
        [inner, watchdog, end, given_up].into_iter().flatten().min()
    }

    /// The dialect to encode commands in.
    pub fn dialect(&self) -> Dialect {
        self.dialect.unwrap_or_default()
    }

    /// The settings.
    pub fn config(&self) -> &AgentConfig {
        &self.config
    }

    /// The diary.
    pub fn journal(&self) -> &Journal {
        &self.journal
    }

    /// What came over the link.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Name of the server's level.
    pub fn level(&self) -> Option<&str> {
        self.level.as_deref()
    }

    /// What did not go as told, each different warning once.
    pub fn warnings(&self) -> &[String] {
        self.journal.warnings()
    }

    /// How the mission ended, if it has.
    pub fn outcome(&self) -> Option<&Outcome> {
        match &self.phase {
            Phase::Ended(outcome, _) => Some(outcome),
            _ => None,
        }
    }

    /// The robot in service, also after the mission's end and while a lost link is sought.
    pub fn running(&self) -> Option<&Running> {
        match &self.phase {
            Phase::Running(running) => Some(running),
            Phase::Ended(_, running) => running.as_deref(),
            Phase::Waiting | Phase::Opening(_) => self.kept.as_deref(),
        }
    }

    /// Whether a robot is in service now.
    pub fn is_in_service(&self) -> bool {
        matches!(self.phase, Phase::Running(_))
    }

    /// Acts of an operator so far.
    pub fn operator_acts(&self) -> usize {
        self.operator_acts
    }

    /// Time so far in which an operator held the drive lease, or nobody but an operator might drive.
    pub fn operated(&self) -> Span {
        self.operated
    }

    /// Session time since the link came up.
    pub fn mission_time(&self) -> Span {
        self.began.map_or(Span::ZERO, |began| self.clock - began)
    }

    /// Books the time since the last event.
    fn account(&mut self, now: Arrival) {
        let since = now - self.clock;
        self.clock = self.clock.max(now);
        let operated = match &mut self.phase {
            Phase::Running(running) => {
                let pastime = running.pastime();
                running.ledger.spend(now, pastime);
                running.mode == Mode::Teleop || running.lease.command(now).is_some()
            }
            Phase::Ended(..) => false,
            Phase::Waiting | Phase::Opening(_) => {
                let mode = self.kept.as_ref().map_or(self.config.mission.mode, |kept| kept.mode);
                self.began.is_some() && mode == Mode::Teleop
            }
        };
        if operated {
            self.operated += since;
        }
    }

    fn connected(&mut self, now: Arrival) {
        self.began.get_or_insert(now);
        if self.config.mission.observe {
            self.journal.note(now, Level::Info, "observing: nothing will be sent");
            self.phase = Phase::Opening(Box::new(Opening::observing(&self.config.mission.class)));
            return;
        }
        let placement = match &self.kept {
            // The old robot is gone with its connection: a new one takes its place.
            Some(running) if self.map_is_level && !self.from_start => {
                let pose = running.belief().world_from_robot();
                let place = placeable(&pose);
                self.journal.note(
                    now,
                    Level::Info,
                    format!(
                        "connected again; asking for a robot at ({:.2}, {:.2})",
                        pose.translation.x, pose.translation.y
                    ),
                );
                Placement::At(place)
            }
            Some(_) => {
                self.journal.note(now, Level::Warn, "asking for a robot at the start");
                self.placement.clone()
            }
            None => {
                self.journal.note(now, Level::Info, "connected; opening the session");
                self.placement.clone()
            }
        };
        let mission = &self.config.mission;
        self.phase = Phase::Opening(Box::new(Opening::new(
            self.config.opening,
            &mission.class,
            &mission.name,
            placement,
            now,
        )));
    }

    /// The link is down. What was believed is kept for the robot that the next link brings.
    fn disconnected(&mut self, reason: &str, now: Arrival) -> Option<Outcome> {
        if self.config.mission.observe {
            return None;
        }
        self.journal.note(now, Level::Warn, format!("link lost: {reason}"));
        match std::mem::replace(&mut self.phase, Phase::Waiting) {
            Phase::Running(mut running) => {
                running.ledger.spend(now, Pastime::Think);
                self.kept = Some(running);
            }
            ended @ Phase::Ended(..) => {
                self.phase = ended;
                return None;
            }
            Phase::Waiting | Phase::Opening(_) => {}
        }
        // Another server may answer next.
        self.dialect = None;
        self.last_line = None;
        self.silent = false;
        self.lost.get_or_insert_with(|| (now, reason.to_owned()));
        None
    }

    /// How long a lost link is sought: where there never was a robot, no longer than one is waited for.
    fn reconnect(&self) -> Span {
        let patience_s = self.config.mission.reconnect_s;
        Span::from_seconds(match self.kept {
            Some(_) => patience_s,
            None => patience_s.min(self.config.opening.sta_timeout_s),
        })
    }

    /// The outcome once a lost link was sought long enough.
    fn is_given_up(&self, now: Arrival) -> Option<Outcome> {
        let (since, reason) = self.lost.as_ref()?;
        (now - *since >= self.reconnect()).then(|| Outcome::LinkLost(reason.clone()))
    }

    fn line(&mut self, line: &[u8], now: Arrival, out: &mut Vec<Command>) -> Option<Outcome> {
        self.last_line = Some(now);
        if std::mem::take(&mut self.silent) {
            self.journal.note(now, Level::Info, "the server speaks again");
        }
        if self.dialect.is_none() {
            self.dialect = Dialect::of_line(line);
        }
        let parsed = parse(line);
        self.tally.take(line, &parsed.message, &parsed.problems);
        if self.tally.bad_in_a_row >= HOPELESS {
            return Some(Outcome::LinkLost(format!(
                "{HOPELESS} damaged lines in a row, the first: {}",
                self.tally.quoted.join(" | ")
            )));
        }
        let end = self.end_time();
        match &mut self.phase {
            Phase::Opening(opening) => {
                let steps = opening.message(&parsed.message, self.dialect, now);
                self.opening_steps(steps, now, out)
            }
            Phase::Running(running) => {
                let mut desk =
                    Desk { config: &self.config, journal: &mut self.journal, out, now, end };
                match running.message(&parsed.message, &mut desk) {
                    Verdict::GoOn => None,
                    Verdict::Explored => Some(Outcome::Explored),
                    Verdict::Fallen => Some(Outcome::Fallen),
                }
            }
            Phase::Waiting | Phase::Ended(..) => None,
        }
    }

    fn opening_steps(
        &mut self,
        steps: Vec<OpeningStep>,
        now: Arrival,
        out: &mut Vec<Command>,
    ) -> Option<Outcome> {
        for step in steps {
            match step {
                OpeningStep::Send(command) => out.push(command),
                OpeningStep::Warn(text) => self.warn(now, text),
                OpeningStep::Failed(reason) if self.kept.is_some() => {
                    if self.from_start || !self.map_is_level {
                        return Some(Outcome::LinkLost(format!("no robot came back: {reason}")));
                    }
                    self.warn(now, reason);
                    self.from_start = true;
                    self.connected(now);
                }
                OpeningStep::Failed(reason) => {
                    let reason = self.tally.gibberish().unwrap_or(reason);
                    return Some(Outcome::NoRobot(reason));
                }
                OpeningStep::Open => self.open(now, out),
            }
        }
        None
    }

    /// The opening is done: the rig is built and put into service.
    fn open(&mut self, now: Arrival, out: &mut Vec<Command>) {
        let Phase::Opening(opening) = &self.phase else { return };
        self.level = opening.level().map(str::to_owned);
        let placed = opening.placed_at();
        let builder = opening
            .rig()
            .cloned()
            .unwrap_or_else(|| RigBuilder::new(self.dialect(), &self.config.mission.class));
        let (rig, warnings) = builder.build();
        for warning in warnings {
            self.warn(now, warning.to_string());
        }
        self.lost = None;
        let end = self.end_time();
        let mut desk = Desk { config: &self.config, journal: &mut self.journal, out, now, end };
        desk.info(format!("in service: {} on {:?}", rig.class, rig.dialect));
        let running = match self.kept.take() {
            Some(mut running) => {
                let put = match placed {
                    Some(pose) if self.from_start => Put::At(level_start(pose)),
                    Some(_) if self.map_is_level => Put::Back,
                    _ => Put::AtStart,
                };
                self.from_start = false;
                running.resume(rig, put, &mut desk);
                running
            }
            None => {
                self.map_is_level = placed.is_some();
                let start = placed.map_or_else(Isometry3::identity, level_start);
                Box::new(Running::new(rig, start, &mut desk))
            }
        };
        self.phase = Phase::Running(running);
    }

    fn warn(&mut self, now: Arrival, text: String) {
        self.journal.note(now, Level::Warn, text);
    }

    fn operator(
        &mut self,
        event: &OperatorEvent,
        now: Arrival,
        out: &mut Vec<Command>,
    ) -> Option<Outcome> {
        self.operator_acts += 1;
        if *event == OperatorEvent::Quit {
            return Some(Outcome::Stopped("by the operator".into()));
        }
        let end = self.end_time();
        if let Phase::Running(running) = &mut self.phase {
            let mut desk = Desk { config: &self.config, journal: &mut self.journal, out, now, end };
            running.operator(event, &mut desk);
        }
        None
    }

    fn wake(&mut self, now: Arrival, out: &mut Vec<Command>) -> Option<Outcome> {
        let silence = Span::from_seconds(self.config.mission.silence_s);
        let end = self.end_time();
        if !self.silent && self.last_line.is_some_and(|at| now - at >= silence) {
            self.silent = true;
            self.journal.note(now, Level::Warn, "the server is silent; wheels stopped");
            if let Phase::Running(running) = &mut self.phase {
                let mut desk =
                    Desk { config: &self.config, journal: &mut self.journal, out, now, end };
                running.stop(&mut desk);
            }
        }
        match &mut self.phase {
            Phase::Opening(opening) => {
                let steps = opening.wake(now);
                self.opening_steps(steps, now, out)
            }
            Phase::Running(running) => {
                let mut desk =
                    Desk { config: &self.config, journal: &mut self.journal, out, now, end };
                running.wake(&mut desk);
                None
            }
            Phase::Waiting | Phase::Ended(..) => None,
        }
    }

    /// When the mission's time is up.
    fn end_time(&self) -> Option<Arrival> {
        let limit_s = self.config.mission.time_limit_s;
        let began = self.began.filter(|_| limit_s > 0.0)?;
        Some(began + Span::from_seconds(limit_s))
    }

    fn time_is_up(&self, now: Arrival) -> bool {
        self.end_time().is_some_and(|end| now >= end)
    }

    /// Stops the wheels and ends the mission.
    fn end(&mut self, outcome: Outcome, now: Arrival) -> Vec<Action> {
        if let Some(text) = self.tally.warning() {
            self.warn(now, text);
        }
        self.journal.note(now, Level::Info, format!("mission over: {}", outcome.word()));
        let mut actions = Vec::new();
        let running = match std::mem::replace(&mut self.phase, Phase::Waiting) {
            Phase::Running(mut running) => {
                running.ledger.spend(now, Pastime::Think);
                if self.config.mission.observe {
                    let out = &mut Vec::new();
                    let (config, journal) = (&self.config, &mut self.journal);
                    running.finish_observed_sweep(&mut Desk {
                        config,
                        journal,
                        out,
                        now,
                        end: Some(now),
                    });
                }
                running.refresh_grid(now);
                if !self.config.mission.observe {
                    actions.push(Action::Send(running.rig.stop_command()));
                }
                Some(running)
            }
            _ => self.kept.take(),
        };
        self.phase = Phase::Ended(outcome.clone(), running);
        actions.push(Action::Finish(outcome));
        actions
    }
}

/// Where the map begins: the place that INIT named, standing level.
fn level_start(placed: WirePose) -> Isometry3<f64> {
    let [_, _, yaw] = placed.orientation;
    core_pose(placed.location, [0.0, 0.0, yaw])
}
